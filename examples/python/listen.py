#!/usr/bin/env python3
"""Prints messages of a cell, decoded, one JSON object per line.

    pip install eclipse-zenoh==1.10.2 rosbags
    python3 examples/python/listen.py --cell cell1 --key control/state --count 5

Any language with Zenoh and a ROS 2 CDR decoder can do this. Only the .msg files are specific to this project.
"""

import argparse
import dataclasses
import json
import pathlib
import struct
import sys
import threading
import time

import numpy
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

MESSAGES = pathlib.Path(__file__).resolve().parents[2] / "schemas" / "msg"


def load_messages(folder):
    """All .msg files of a folder PACKAGE/NAME.msg as a type store."""
    store = get_typestore(Stores.EMPTY)
    for path in sorted(folder.glob("*/*.msg")):
        store.register(get_types_from_msg(path.read_text(), f"{path.parent.name}/msg/{path.stem}"))
    return store


def plain(value):
    """Converts a decoded message to types that JSON has."""
    if dataclasses.is_dataclass(value):
        fields = [field.name for field in dataclasses.fields(value) if field.name != "__msgtype__"]
        return {name: plain(getattr(value, name)) for name in fields}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, numpy.ndarray):
        return value.tolist()
    return value


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--router", default="tcp/127.0.0.1:7447")
    parser.add_argument("--cell", default="cell1", help="namespace: the cell's name")
    parser.add_argument("--key", default="**", help="key or pattern, relative to the cell")
    parser.add_argument("--count", type=int, default=0, help="number of messages after which to end; 0: never")
    parser.add_argument("--messages", type=pathlib.Path, default=MESSAGES, help="folder of .msg files")
    args = parser.parse_args()

    store = load_messages(args.messages)
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([args.router]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("namespace", json.dumps(args.cell))

    done = threading.Event()
    seen = 0

    def on_sample(sample):
        nonlocal seen
        encoding = str(sample.encoding)
        if done.is_set() or not encoding.startswith("application/cdr;"):
            return
        message_name = encoding.split(";", 1)[1]
        # i64 sequence, i64 time of publication in ns, u8 16, 16 bytes that identify the publisher.
        sequence, source_ns, _, publisher = struct.unpack("<qqB16s", bytes(sample.attachment))
        message = store.deserialize_cdr(bytes(sample.payload), message_name)
        line = {
            "key": str(sample.key_expr),
            "type": message_name,
            "sequence": sequence,
            "publisher": publisher.hex(),
            "age_ms": round((time.time_ns() - source_ns) * 1e-6, 3),
            "message": plain(message),
        }
        print(json.dumps(line), flush=True)
        seen += 1
        if args.count and seen >= args.count:
            done.set()

    # A session that is not closed keeps the interpreter from ending, hence `with`.
    with zenoh.open(config) as session:
        session.declare_subscriber(args.key, on_sample)
        print(f"listening to {args.key} of {args.cell}", file=sys.stderr, flush=True)
        try:
            done.wait()
        except KeyboardInterrupt:
            pass


main()
