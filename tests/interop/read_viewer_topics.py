#!/usr/bin/env python3
"""Reads the topics for viewers from a recording with other people's programs, and prints what each found as JSON.

mcap and mcap-ros2-support decode every message; rosbags decodes it again; yourdfpy reads the robot's description and
computes the pose of the tool at recorded joint states; rerun's converter turns the file into an .rrd.
Exit code 77: a package is missing.

usage: read_viewer_topics.py RECORDING FOLDER
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

try:
    import numpy
    import yourdfpy
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.highlevel import AnyReader
except ImportError as missing:
    print(f"missing: {missing}")
    sys.exit(77)

VIEWED = ["/tf", "/tf_static", "/joint_states", "/robot_description", "/markers"]


def with_mcap(path):
    """Counts, the description, joint states, the tool's poses, and the markers' names."""
    found = {"counts": {}, "states": [], "tools": {}, "names": set(), "frames": {}}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, _, message in reader.iter_decoded_messages():
            topic = channel.topic
            if topic in VIEWED:
                key = f"{topic} {schema.name}"
                found["counts"][key] = found["counts"].get(key, 0) + 1
            if topic == "/robot_description":
                found["urdf"] = message.data
            elif topic == "/joint_states":
                stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
                found["states"].append((stamp, dict(zip(message.name, message.position))))
            elif topic == "/arm/state":
                stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
                found["tools"][stamp] = message.tool_pose
            elif topic == "/markers":
                found["names"].update(marker.ns for marker in message.markers)
            elif topic in ("/tf", "/tf_static"):
                for one in message.transforms:
                    found["frames"].setdefault(one.child_frame_id, set()).add(one.header.frame_id)
    return found


def with_rosbags(path):
    """Counts by topic and type, each message decoded."""
    counts = {}
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic in VIEWED]
        for connection, _, raw in reader.messages(connections=connections):
            reader.deserialize(raw, connection.msgtype)
            key = f"{connection.topic} {connection.msgtype}"
            counts[key] = counts.get(key, 0) + 1
    return counts


def with_yourdfpy(found, folder):
    """Largest distance, m, between the tool of the description and the recorded one."""
    path = Path(folder) / "robot.urdf"
    path.write_text(found["urdf"])
    robot = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    farthest, compared = 0.0, 0
    for stamp, angles in found["states"]:
        if stamp in found["tools"]:
            robot.update_cfg(angles)
            tool = robot.get_transform("tool", "base")[:3, 3]
            there = found["tools"][stamp].position
            away = numpy.linalg.norm(tool - numpy.array([there.x, there.y, there.z]))
            farthest, compared = max(farthest, float(away)), compared + 1
    return {"farthest_m": farthest, "compared": compared, "links": sorted(robot.link_map)}


def with_rerun(path, folder):
    """Size of the converted file, the topics in it, and the shapes of the arm that it draws; None without the program."""
    own = Path(sys.executable).with_name("rerun")
    program = str(own) if own.exists() else shutil.which("rerun")
    if program is None:
        return None
    output = Path(folder) / "recording.rrd"
    ended = subprocess.run(
        [program, "mcap", "convert", str(path), "-o", str(output)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    text = ended.stdout + ended.stderr
    topics = [topic for topic in VIEWED if f" {topic}," in text]
    drawn = text.count("/visual_geometries/")
    size = output.stat().st_size if output.exists() else 0
    return {"code": ended.returncode, "bytes": size, "topics": topics, "drawn": drawn, "said": text[-2000:]}


if __name__ == "__main__":
    recording, work = Path(sys.argv[1]), sys.argv[2]
    seen = with_mcap(recording)
    print(
        json.dumps(
            {
                "mcap": seen["counts"],
                "rosbags": with_rosbags(recording),
                "frames": {child: sorted(parents) for child, parents in seen["frames"].items()},
                "markers": sorted(seen["names"]),
                "urdf": with_yourdfpy(seen, work),
                "rerun": with_rerun(recording, work),
            }
        )
    )
