#!/usr/bin/env python3
"""Reads a recording with two independent implementations and prints what each found, as one JSON object.

Every message is decoded by the schema that the recording carries. Exit code 77: a package is missing.
"""

import json
import sys
from collections import Counter
from pathlib import Path

try:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.highlevel import AnyReader
except ImportError as missing:
    print(f"missing: {missing}")
    sys.exit(77)


class Numbers:
    """Some values that the writer knows."""

    def __init__(self):
        self.found = {}

    def look(self, topic, message):
        if topic == "/arm/state":
            self.found.setdefault("cycle", []).append(int(message.cycle))
            self.found.setdefault("q", []).append([float(q) for q in message.q])
        elif topic == "/health/netft":
            self.found.setdefault("rate_names", []).append(list(message.rate_names))
            self.found.setdefault("fault", []).append(message.fault)
        elif topic == "/wrench/raw/packed":
            force_z = [int(steps) * float(message.force_step_n) for steps in message.force_z]
            self.found.setdefault("raw_force_z", []).extend(force_z)


def with_mcap(path):
    """By Foxglove's reader and its ROS 2 decoder, which go by the file's index."""
    counts, numbers = Counter(), Numbers()
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        profile = reader.get_header().profile
        for schema, channel, _, message in reader.iter_decoded_messages():
            counts[f"{channel.topic} {schema.name}"] += 1
            numbers.look(channel.topic, message)
        metadata = {m.name: dict(m.metadata) for m in reader.iter_metadata()}
        attachments = {a.name: a.data.decode() for a in reader.iter_attachments()}
    return {
        "profile": profile,
        "counts": counts,
        "numbers": numbers.found,
        "metadata": metadata,
        "attachments": attachments,
    }


def with_rosbags(path):
    """By rosbags."""
    counts, numbers = Counter(), Numbers()
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            counts[f"{connection.topic} {connection.msgtype}"] += 1
            numbers.look(connection.topic, message)
    return {"counts": counts, "numbers": numbers.found}


if __name__ == "__main__":
    recording = Path(sys.argv[1])
    print(json.dumps({"mcap": with_mcap(recording), "rosbags": with_rosbags(recording)}))
