#!/usr/bin/env python3
"""A client of a cell: prints its status, starts and stops its task, and plots force and angle.

    pip install eclipse-zenoh==1.10.2
    python3 examples/python/client.py status
    python3 examples/python/client.py start deploy/tasks/line.toml
    python3 examples/python/client.py use my_python
    python3 examples/python/client.py plot --seconds 20
    python3 examples/python/client.py stop

`plot` uses matplotlib if it is installed and there is a screen, otherwise the terminal.
"""

import argparse
import math
import pathlib
import sys
import time

from tangent_messages import Cell

STATES = ["starting", "running", "degraded", "fault", "stopping"]


def status(cell, seconds=1.5):
    """Prints the health of every service, which is published once a second."""
    heard = {}
    cell.subscribe("health/*", "tangent_msgs/msg/Health", lambda h: heard.update({(h.service, h.instance): h}))
    time.sleep(seconds)
    for (service, instance), health in sorted(heard.items()):
        print(f"{service:<12} {STATES[health.state]:<9} on {health.host} ({instance}) {health.fault}")
    return bool(heard)


def request(cell, key, action, argument=""):
    """Sends a request and prints the answer."""
    answer = cell.ask(key, action, argument)
    print(answer.message)
    return answer.done


def screen():
    """Returns pyplot if there is a screen, otherwise None."""
    try:
        import matplotlib
        from matplotlib import pyplot
    except ImportError:
        return None
    return pyplot if matplotlib.get_backend().lower() not in ("agg", "pdf", "ps", "svg") else None


def plot(cell, seconds):
    """Shows force and alignment for this time, ten times a second."""
    newest, pyplot = {}, screen()
    rows = []
    cell.subscribe("control/state", "tangent_msgs/msg/ControlState", lambda s: newest.update(state=s))
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        time.sleep(0.1)
        state = newest.get("state")
        if state is None:
            continue
        rows.append((time.monotonic() - began, state.force_n, math.degrees(state.alignment_error_rad)))
        if pyplot:
            draw(pyplot, rows)
            continue
        full = max(state.force_reference_n, 1.0) * 1.5
        bar = "#" * max(0, min(40, round(40 * state.force_n / full)))
        print(f"{rows[-1][0]:6.1f} s {state.phase_text:<8} {state.estimator:<16} {state.force_n:6.2f} N |{bar:<40}| "
              f"{rows[-1][2]:5.2f} deg {100 * state.path_progress:3.0f} %", flush=True)
    return bool(rows)


def draw(pyplot, rows):
    """Draws two curves over time."""
    pyplot.clf()
    for place, (label, column) in enumerate([("force, N", 1), ("angle, deg", 2)]):
        axes = pyplot.subplot(2, 1, place + 1)
        axes.plot([row[0] for row in rows], [row[column] for row in rows])
        axes.set_ylabel(label)
    pyplot.pause(0.001)


def main():
    """Exit code 0 if the request was done, 1 if it was refused or no service ran."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cell", default="cell1")
    parser.add_argument("--router", default="tcp/127.0.0.1:7447")
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("status", "stop"):
        commands.add_parser(name)
    commands.add_parser("start").add_argument("task", type=pathlib.Path, help="task file (TOML)")
    commands.add_parser("use").add_argument("name", help="an estimator's name")
    commands.add_parser("plot").add_argument("--seconds", type=float, default=20.0)
    args = parser.parse_args()
    with Cell(args.cell, args.router) as cell:
        done = {
            "status": lambda: status(cell),
            "start": lambda: request(cell, "control/task", "start", args.task.read_text()),
            "stop": lambda: request(cell, "control/stop", "stop"),
            "use": lambda: request(cell, "control/select", "select", args.name),
            "plot": lambda: plot(cell, args.seconds),
        }[args.command]()
    return 0 if done else 1


if __name__ == "__main__":
    sys.exit(main())
