"""Reference values for `tangent model check`, computed by Pinocchio from URDF files.

usage: from_urdf.py NAME=FILE.urdf ... [--flange LINK] [--pose ID=q1,q2,...] [--count N] [--seed N] [--gravity X,Y,Z]

The root link of the URDF is the model's base frame, and the link `flange` its flange. Each robot gets the poses given,
which come first, and then N random ones within the limits of the URDF. Prints the JSON file of docs/robot-models.md.
Needs `pip install pin`, tried with version 4.1.0.
"""

import argparse
import json
import math

import numpy as np
import pinocchio as pin


def case(model, data, flange, ident, q, qd, qdd, fd_tau):
    """All quantities at one pose, as lists."""
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    jacobian = pin.computeFrameJacobian(model, data, q, flange, axes).copy()
    pin.forwardKinematics(model, data, q, qd, np.zeros(model.nv))
    pin.updateFramePlacements(model, data)
    pose = data.oMf[flange].homogeneous.copy()
    jdot_qd = pin.getFrameClassicalAcceleration(model, data, flange, axes).vector.copy()
    mass = np.triu(pin.crba(model, data, q))
    mass = mass + np.triu(mass, 1).T
    gravity = pin.computeGeneralizedGravity(model, data, q).copy()
    coriolis = pin.nonLinearEffects(model, data, q, qd) - gravity
    values = {
        "id": ident,
        "q": q,
        "qd": qd,
        "qdd": qdd,
        "base_from_flange": pose,
        "jacobian": jacobian,
        "jdot_qd": jdot_qd,
        "mass_matrix": mass,
        "gravity": gravity,
        "coriolis": coriolis,
        "tau": pin.rnea(model, data, q, qd, qdd).copy(),
        "fd_tau": fd_tau,
        "fd_qdd": pin.aba(model, data, q, qd, fd_tau).copy(),
        "kinetic_energy": pin.computeKineticEnergy(model, data, q, qd),
    }
    return {key: v.tolist() if isinstance(v, np.ndarray) else v for key, v in values.items()}


def robot(file, options):
    """All cases of one robot: the poses given, then random ones."""
    model = pin.buildModelFromUrdf(file)
    model.gravity.linear = np.array(options.gravity)
    data = model.createData()
    if not model.existFrame(options.flange):
        raise SystemExit(f"{file}: no link is called {options.flange}")
    flange = model.getFrameId(options.flange)
    random = np.random.default_rng(options.seed)
    lower = np.maximum(model.lowerPositionLimit, -2 * math.pi)
    upper = np.minimum(model.upperPositionLimit, 2 * math.pi)
    poses = [(ident, np.array(q)) for ident, q in options.pose]
    poses += [(f"random_{i:02}", random.uniform(lower, upper)) for i in range(options.count)]
    cases = []
    for ident, q in poses:
        qd = random.uniform(-model.velocityLimit, model.velocityLimit)
        qdd, other = random.uniform(-10.0, 10.0, (2, model.nv))
        # Torques of another acceleration: `fd_qdd` is then no copy of `qdd`.
        fd_tau = np.round(pin.rnea(model, data, q, qd, other), 3)
        cases.append(case(model, data, flange, ident, q, qd, qdd, fd_tau))
    return cases


def layout(models, options):
    """One key per line: a change to the file can be read."""
    lines = ["{", ' "format_version": 1,']
    lines.append(f' "sources": "Pinocchio {pin.__version__} on URDFs; seed {options.seed}",')
    lines.append(' "models": {')
    blocks = []
    for name, cases in models.items():
        texts = []
        for values in cases:
            rows = ",\n".join(f'    "{key}": {json.dumps(v)}' for key, v in values.items())
            texts.append("   {\n" + rows + "\n   }")
        blocks.append(f'  "{name}": [\n' + ",\n".join(texts) + "\n  ]")
    lines.append(",\n".join(blocks))
    return "\n".join(lines + [" }", "}"])


def numbers(text):
    return [float(x) for x in text.split(",")]


def pose(text):
    ident, _, values = text.partition("=")
    return ident, numbers(values)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("robots", nargs="+")
    parser.add_argument("--flange", default="flange")
    parser.add_argument("--pose", action="append", type=pose, default=[])
    parser.add_argument("--count", type=int, default=7)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--gravity", type=numbers, default=[0.0, 0.0, -9.81])
    options = parser.parse_args()
    models = {}
    for text in options.robots:
        name, _, file = text.partition("=")
        models[name] = robot(file, options)
    print(layout(models, options))


if __name__ == "__main__":
    main()
