"""Decodes bytes with rosbags and mcap-ros2-support, compares every value, and writes the messages back.

Reads one JSON object on standard input: `files`, pairs of a message's name and its .msg text, and `cases`, each with
`name`, `definition` (everything, as in a recording), `value` and `hex`. Writes a JSON list on standard output: for each
case the bytes that the two libraries make of it, in hexadecimal. Exits with 1 and says where at the first difference,
with 77 if a library is missing.
"""

import json
import sys

from comparison import compare

try:
    from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
except ImportError as missing:
    print(f"missing: {missing}")
    sys.exit(77)


def main():
    """Reads the cases from standard input, and compares them with both libraries."""
    given = json.load(sys.stdin)
    store = get_typestore(Stores.EMPTY)
    for name, text in given["files"]:
        store.register(get_types_from_msg(text, name))
    answers = []
    for case in given["cases"]:
        name, data = case["name"], bytes.fromhex(case["hex"])
        short = name.replace("/msg/", "/")
        by_rosbags = store.deserialize_cdr(data, name)
        compare(f"rosbags: {name}", case["value"], by_rosbags)
        by_mcap = generate_dynamic(short, case["definition"])[short](data)
        compare(f"mcap-ros2-support: {name}", case["value"], by_mcap)
        answers.append(
            {
                "rosbags": bytes(store.serialize_cdr(by_rosbags, name)).hex(),
                "mcap": serialize_dynamic(short, case["definition"])[short](case["value"]).hex(),
            }
        )
    json.dump(answers, sys.stdout)


main()
