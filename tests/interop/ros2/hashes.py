"""Prints the type hashes that the generator of ROS 2 wrote for every installed message and service, as one JSON object.

Packages of messages are looked for where ROS 2 looks for them: AMENT_PREFIX_PATH.
"""

import json
import os
from pathlib import Path


def main():
    """Reads the descriptions that are installed beside the definitions."""
    hashes = {}
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
        for kind in ("msg", "srv"):
            for file in Path(prefix).glob(f"share/*/{kind}/*.json"):
                for one in json.loads(file.read_text())["type_hashes"]:
                    hashes[one["type_name"]] = one["hash_string"]
    print(json.dumps(hashes))


main()
