"""Messages of a cell for Python: classes and CDR bytes from the `.msg` files, and a session in a cell.

Only `eclipse-zenoh` is needed. A class is named after its file: `Messages().type("tangent_msgs/msg/ArmState")`.
A test (`services/runtime/tests/integration/python.rs`) compares the bytes with those of the Rust services.
"""

import ast
import dataclasses
import json
import os
import pathlib
import socket
import struct
import time

import zenoh

FOLDER = pathlib.Path(__file__).resolve().parents[2] / "schemas" / "msg"
SCALARS = {"bool": "?", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h", "uint32": "I", "int32": "i",
           "uint64": "Q", "int64": "q", "float32": "f", "float64": "d"}
HEADER = b"\0\1\0\0"  # CDR, little-endian


def rotate(q, v):
    """Rotates the vector `v` by the quaternion `q`: tool axes to base axes with a tool pose's orientation."""
    u = (q.x, q.y, q.z)
    t = _cross(u, v)
    s = _cross(u, t)
    return [v[i] + 2 * q.w * t[i] + 2 * s[i] for i in range(3)]


def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


class Messages:
    """The `.msg` files of a folder (PACKAGE/NAME.msg) as dataclasses, each read at its first use."""

    def __init__(self, folder=FOLDER):
        self.folder = pathlib.Path(folder)
        self.types = {}

    def type(self, name):
        """Class of a message, `PACKAGE/msg/NAME`. All fields have defaults: zero, empty, or a default message."""
        if name not in self.types:
            package, short = name.split("/")[0], name.split("/")[-1]
            fields = []
            for line in (self.folder / package / f"{short}.msg").read_text().splitlines():
                words = line.split("#")[0].split()
                if len(words) >= 2 and "=" not in words[1]:  # the third is a default, a `=` makes a constant
                    fields.append((words[1], self._field(package, words[0]), words[2:]))
            made = [(n, object, dataclasses.field(default_factory=lambda k=k, d=d: self._default(k, d)))
                    for n, k, d in fields]
            own = {"name": name, "kinds": [(n, k) for n, k, _ in fields]}
            self.types[name] = dataclasses.make_dataclass(short, made, namespace=own)
        return self.types[name]

    def _field(self, package, text):
        """Kind of a field: (scalar, `string` or message name; None, "" for a sequence, or the length of an array)."""
        base, _, length = text.partition("[")
        if base not in SCALARS and base != "string":
            base = f"{base.split('/')[0] if '/' in base else package}/msg/{base.split('/')[-1]}"
        return base, (length.rstrip("]") if "[" in text else None)

    def _default(self, kind, written=()):
        base, length = kind
        if written:
            return ast.literal_eval(written[0])
        if length is not None:
            return [self._default((base, None)) for _ in range(int(length or 0))]
        if base == "string":
            return ""
        return (base != "bool" and 0) if base in SCALARS else self.type(base)()

    def encode(self, message):
        """CDR bytes of a message."""
        out = bytearray()
        for name, kind in message.kinds:
            self._put(out, kind, getattr(message, name))
        return HEADER + bytes(out)

    def _put(self, out, kind, value):
        base, length = kind
        if length is not None:
            if length == "":
                self._put(out, ("uint32", None), len(value))
            elif len(value) != int(length):
                raise ValueError(f"{length} elements are needed, not {len(value)}")
            for item in value:
                self._put(out, (base, None), item)
        elif base == "string":
            text = value.encode() + b"\0"
            self._put(out, ("uint32", None), len(text))
            out += text
        elif base in SCALARS:
            form = SCALARS[base]
            out += b"\0" * (-len(out) % struct.calcsize(form)) + struct.pack("<" + form, value)
        else:
            for name, inner in value.kinds:
                self._put(out, inner, getattr(value, name))

    def decode(self, name, payload):
        """Decodes the message `name` from CDR bytes."""
        if payload[:2] != HEADER[:2]:
            raise ValueError(f"{name}: not little-endian CDR")
        value, _ = self._get(payload, 4, (name, None))
        return value

    def _get(self, data, at, kind):
        base, length = kind
        if length is not None:
            count, at = (int(length), at) if length else self._get(data, at, ("uint32", None))
            items = []
            for _ in range(count):
                item, at = self._get(data, at, (base, None))
                items.append(item)
            return items, at
        if base == "string":
            count, at = self._get(data, at, ("uint32", None))
            return bytes(data[at:at + count - 1]).decode(), at + count
        if base in SCALARS:
            form = SCALARS[base]
            at += -(at - 4) % struct.calcsize(form)
            return struct.unpack_from("<" + form, data, at)[0], at + struct.calcsize(form)
        made = self.type(base)()
        for name, inner in made.kinds:
            value, at = self._get(data, at, inner)
            setattr(made, name, value)
        return made, at


class Cell:
    """A session in a cell. Use it as `with Cell(...) as cell:`, because an open session keeps the interpreter running."""

    def __init__(self, name="cell1", router="tcp/127.0.0.1:7447", folder=FOLDER):
        config = zenoh.Config()
        for key, value in [("mode", "client"), ("connect/endpoints", [router]), ("namespace", name),
                           ("scouting/multicast/enabled", False)]:
            config.insert_json5(key, json.dumps(value))
        self.messages = Messages(folder)
        self.session = zenoh.open(config)
        self.instance = f"{socket.gethostname()}-{os.getpid()}"
        self.kept = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.session.close()

    def alive(self, service):
        """Declares a liveliness token for `service` (for an estimator: `estimate/NAME`), until the session ends."""
        self.kept.append(self.session.liveliness().declare_token(f"alive/{service}/{self.instance}"))

    def subscribe(self, key, name, call):
        """Calls `call(message)` for every message `name` on `key`, in a separate thread. Other types are ignored."""
        def heard(sample):
            encoding = str(sample.encoding)
            if not encoding.startswith("application/cdr;") or encoding.endswith(name):
                call(self.messages.decode(name, bytes(sample.payload)))
        self.kept.append(self.session.declare_subscriber(key, heard))

    def latest(self, key, name):
        """A function that returns the newest message `name` on `key`, or None. It decodes only the returned messages."""
        newest, subscriber = None, self.session.declare_subscriber(key, zenoh.handlers.RingChannel(1))
        self.kept.append(subscriber)

        def get():
            nonlocal newest
            sample = subscriber.try_recv()
            if sample is not None:
                newest = self.messages.decode(name, bytes(sample.payload))
            return newest
        return get

    def publisher(self, key, name):
        """A function that publishes a message `name` on `key`, with the attachment from which readers count losses."""
        publisher = self.session.declare_publisher(
            key, encoding=f"application/cdr;{name}", priority=zenoh.Priority.REAL_TIME, express=True,
            congestion_control=zenoh.CongestionControl.DROP)
        ident, sequence = os.urandom(16), 0

        def publish(message):
            nonlocal sequence
            sequence += 1
            attachment = struct.pack("<qqB16s", sequence, time.time_ns(), 16, ident)
            publisher.put(self.messages.encode(message), attachment=attachment)
        self.kept.append(publisher)
        return publish

    def ask(self, key, action, argument=""):
        """Sends a request to a service. The answer has `done`, `message` and `data` (JSON or empty)."""
        request = self.messages.type("tangent_msgs/msg/Request")(action=action, argument=argument)
        encoding = "application/cdr;tangent_msgs/msg/Request"
        for reply in self.session.get(key, payload=self.messages.encode(request), encoding=encoding, timeout=5.0):
            if reply.ok is not None:
                return self.messages.decode("tangent_msgs/msg/Answer", bytes(reply.ok.payload))
        raise TimeoutError(f"no answer on {key}: is the cell running?")
