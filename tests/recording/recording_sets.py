"""A small recording set, written by plain NumPy: two joints, one run of ten seconds each role."""

from __future__ import annotations

import numpy as np

URDF = """<robot name="two">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.2"/><mass value="2.0"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.002"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 -0.1"/><mass value="1.0"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.001"/></inertial></link>
<link name="tool0"/>
<joint name="swing" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="50" velocity="4"/></joint>
<joint name="slide" type="prismatic"><parent link="upper"/><child link="lower"/>
<axis xyz="0 0 -1"/><limit lower="-1" upper="1" effort="80" velocity="2"/></joint>
<joint name="tip" type="fixed"><parent link="lower"/><child link="tool0"/></joint>
</robot>"""

TOML = """schema = 1
name = "two"
citation = "made for a test"
licence = "MIT"
robot = "robot.urdf"
joints = ["swing", "slide"]
tool_frame = "tool0"

[signals]
time = "t"
position = ["q1", "q2"]
velocity = ["qd1", "qd2"]
link_position = ["ql1", ""]
torque = ["tau1", "tau2"]
torque_side = "motor"

[nominal]
gear_ratio = [101.0, 50.0]
coulomb = [1.0, 2.0]

[tolerance]
mass = 0.01

[noise]
torque = 0.05

[[runs]]
file = "one.npz"
role = "train"
session_time = 60.0
housing_temperature = [25.0, 26.0]

[[runs]]
file = "two.npz"
role = "test"
"""

Columns = dict[str, np.ndarray]


def motion(rate: float = 250.0, duration: float = 10.0, seed: int = 1) -> Columns:
    """Columns of a run whose encoders, velocity and torque agree with one another."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / rate)
    return {"t": t, **channels(t, rng)}


def channels(t: np.ndarray, rng: np.random.Generator) -> Columns:
    """Channels at given times."""
    q1, q2 = 0.8 * np.sin(1.3 * t) + 0.2 * np.sin(5.1 * t), 0.2 * np.cos(2.1 * t)
    qd1 = 1.04 * np.cos(1.3 * t) + 1.02 * np.cos(5.1 * t)
    qd2 = -0.42 * np.sin(2.1 * t)
    torque = 9.0 * np.sin(q1) + 1.0 * np.tanh(qd1 / 0.01)
    force = -30.0 + 2.0 * np.tanh(qd2 / 0.01)
    count = 1e-6
    return {
        "q1": np.round(q1 / count) * count,
        "q2": np.round(q2 / count) * count,
        "qd1": qd1 + 1e-3 * rng.normal(size=len(t)),
        "qd2": qd2 + 1e-3 * rng.normal(size=len(t)),
        "ql1": q1 - torque / 2e4 + 1e-5 * rng.normal(size=len(t)),
        "tau1": torque + 0.05 * rng.normal(size=len(t)),
        "tau2": force + 0.05 * rng.normal(size=len(t)),
    }
