"""Arms for the oracle tests: one of each kind of joint and frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

ROOT = Path(__file__).resolve().parents[2]
UR10 = ROOT.parent / "shared" / "benchmarks" / "ur10_5kg.urdf"
ER3A = ROOT / "stiffopt" / "robot" / "data" / "er3a_c60" / "robot.urdf"

# A slide along a skew axis, a slide along y, turns about skew and principal axes, one fixed joint.
SKEW_URDF = """<robot name="skew">
<link name="base"/>
{links}
<joint name="a" type="revolute"><parent link="base"/><child link="l1"/>
 <origin xyz="0.1 -0.2 0.3" rpy="0.3 -0.4 0.7"/><axis xyz="1 2 -3"/>{limit}</joint>
<joint name="b" type="prismatic"><parent link="l1"/><child link="l2"/>
 <origin xyz="0.2 0.1 0.05" rpy="-0.6 0.2 0.1"/><axis xyz="-2 1 1"/>{limit}</joint>
<joint name="c" type="revolute"><parent link="l2"/><child link="l3"/>
 <origin xyz="0 0.3 0.1" rpy="1.1 0 0.5"/><axis xyz="1 0 0"/>{limit}</joint>
<joint name="d" type="prismatic"><parent link="l3"/><child link="l4"/>
 <origin xyz="0.1 0 0.2" rpy="0 0.8 0"/><axis xyz="0 1 0"/>{limit}</joint>
<joint name="weld" type="fixed"><parent link="l4"/><child link="l5"/>
 <origin xyz="0.05 0.02 0.1" rpy="0.2 0.3 0.4"/></joint>
<joint name="e" type="revolute"><parent link="l5"/><child link="l6"/>
 <origin xyz="0 0.1 0.1" rpy="0 0 0"/><axis xyz="0 0 -1"/>{limit}</joint>
</robot>"""


def skew_arm() -> pin.Model:
    rng = np.random.default_rng(3)
    link = (
        '<link name="l{i}"><inertial><origin xyz="{c}" rpy="0.1 0.2 0.3"/><mass value="{m}"/>'
        '<inertia ixx="0.2" iyy="0.25" izz="0.3" ixy="0.02" ixz="-0.01" iyz="0.03"/>'
        "</inertial></link>"
    )
    links = "".join(
        link.format(i=i, m=1.0 + i, c=" ".join(f"{x:.3f}" for x in rng.uniform(-0.2, 0.2, 3)))
        for i in range(1, 7)
    )
    limit = '<limit lower="-3" upper="3" velocity="2" effort="100"/>'
    return pin.buildModelFromXML(SKEW_URDF.format(links=links, limit=limit))


def tree() -> pin.Model:
    """Two branches (in depth-first order, as pin has it) and every joint about a main axis."""
    rng = np.random.default_rng(7)
    model = pin.Model()
    kinds = (pin.JointModelRX, pin.JointModelRY, pin.JointModelPZ, pin.JointModelPX)
    kinds += (pin.JointModelRZ, pin.JointModelPY)
    for i, (kind, parent) in enumerate(zip(kinds, (0, 1, 2, 1, 4, 5), strict=True)):
        place = pin.SE3(pin.rpy.rpyToMatrix(rng.uniform(-3, 3, 3)), rng.uniform(-0.5, 0.5, 3))
        joint = model.addJoint(parent, kind(), place, f"joint_{i + 1}")
        root = rng.uniform(-0.3, 0.3, (3, 3))
        body = pin.Inertia(2.0 + i, rng.uniform(-0.2, 0.2, 3), root @ root.T + 0.2 * np.eye(3))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    return model


def arm(name: str) -> pin.Model:
    if name == "ur10":
        if not UR10.exists():
            pytest.skip(f"{UR10} is not beside this repository")
        model = pin.buildModelFromUrdf(str(UR10))
    elif name == "er3a":
        if not ER3A.exists():
            pytest.skip(f"{ER3A} is not shipped")
        model = pin.buildModelFromUrdf(str(ER3A))
    else:
        build = {"sample": pin.buildSampleModelManipulator, "skew": skew_arm, "tree": tree}
        model = build[name]()
    return model


NAMES = ("ur10", "er3a", "sample", "skew", "tree")


def states(model: pin.Model, count: int = 20) -> np.ndarray:
    """Positions, velocities and accelerations (count, 3, n)."""
    return np.random.default_rng(11).uniform(-3.0, 3.0, (count, 3, model.nv))
