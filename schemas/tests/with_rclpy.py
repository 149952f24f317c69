"""Decodes bytes with rclpy, ROS 2's own library, compares every value, and writes the messages back.

Input, output and exit code are those of independent.py. Exit code 77: rclpy or a package of messages is missing.
"""

import importlib
import json
import sys

from comparison import compare

try:
    from rclpy.serialization import deserialize_message, serialize_message
except ImportError as missing:
    print(f"missing: {missing}")
    sys.exit(77)


def type_of(name):
    """The generated class of `PACKAGE/msg/NAME`."""
    package, _, short = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), short)
    except ImportError as missing:
        print(f"missing: {missing}")
        sys.exit(77)


def main():
    """Reads the cases from standard input, and compares them."""
    answers = []
    for case in json.load(sys.stdin)["cases"]:
        message = deserialize_message(bytes.fromhex(case["hex"]), type_of(case["name"]))
        compare(f"rclpy: {case['name']}", case["value"], message)
        answers.append({"rclpy": serialize_message(message).hex()})
    json.dump(answers, sys.stdout)


main()
