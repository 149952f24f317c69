#!/usr/bin/env python3
"""A normal estimator: the force without its component along the motion (friction) points out of the surface.

    pip install eclipse-zenoh==1.10.2
    python3 examples/python/estimator.py --cell cell1 --name my_python
    tangent estimator use my_python
"""

import argparse
import math
import threading

from tangent_messages import Cell, rotate

SPEED_MIN, FORCE_MIN = 0.005, 0.6  # m/s, N: below, there is no direction of sliding, and no contact
MEMORY = 0.9  # share of the last normal in the new one: 10 cycles of low pass


def normal(arm, force, last):
    """Unit normal in base axes, its standard deviation in rad, and (code, reason) if it is not valid. `force`: tool axes, N."""
    q, v = arm.tool_pose.orientation, arm.tool_twist.linear
    force, speed = rotate(q, (force.x, force.y, force.z)), math.hypot(v.x, v.y, v.z)
    if math.hypot(*force) < FORCE_MIN:
        return [-x for x in rotate(q, (0, 0, 1))], 1.0, (6, "no contact")
    if speed < SPEED_MIN and last:
        return last, 0.1, None  # friction may point anywhere now
    if speed > SPEED_MIN:
        way = (v.x / speed, v.y / speed, v.z / speed)
        friction = sum(force[i] * way[i] for i in range(3))
        force = [force[i] - friction * way[i] for i in range(3)]
    new = [x / math.hypot(*force) * (1 - MEMORY) for x in force]
    mixed = [new[i] + MEMORY * last[i] for i in range(3)] if last else new
    return [x / math.hypot(*mixed) for x in mixed], 0.05 if speed > SPEED_MIN else 0.3, None


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--cell", default="cell1")
parser.add_argument("--router", default="tcp/127.0.0.1:7447")
parser.add_argument("--name", default="my_python", help="publishes estimate/NAME/normal")
args = parser.parse_args()
with Cell(args.cell, args.router) as cell:
    Estimate = cell.messages.type("tangent_msgs/msg/NormalEstimate")
    publish = cell.publisher(f"estimate/{args.name}/normal", Estimate.name)
    status = cell.latest("wrench/status", "tangent_msgs/msg/WrenchStatus")
    wrench = cell.latest("wrench/tool", "geometry_msgs/msg/WrenchStamped")
    known = {"normal": None}
    def on_arm(arm):  # one estimate per packet of the robot, with its cycle and stamp
        felt, trust = wrench(), status()
        if felt is None or trust is None or trust.validity:
            return
        n, sigma, why = normal(arm, felt.wrench.force, known["normal"])
        known["normal"] = None if why else n
        e = Estimate(header=arm.header, cycle=arm.cycle, estimator=args.name, friction=-1.0)
        e.point, (e.normal.x, e.normal.y, e.normal.z) = arm.tool_pose.position, n
        e.covariance = [sigma**2 * ((i == j) - n[i] * n[j]) for i in range(3) for j in range(3)]
        e.validity, e.reason = why or (0, "valid")
        publish(e)
    cell.alive(f"estimate/{args.name}")
    cell.subscribe("arm/state", "tangent_msgs/msg/ArmState", on_arm)
    threading.Event().wait()
