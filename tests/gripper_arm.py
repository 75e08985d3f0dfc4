"""A URDF as a new user has it: seven axes, a hand, two fingers of which one follows the other."""

from __future__ import annotations

from pathlib import Path

# Axis, offset from the joint before [m], mass [kg], limits [rad], torque [N m], speed [rad/s].
_JOINTS = (
    ("0 0 1", "0 0 0.333", 5.0, (-2.9, 2.9), 87, 2.2),
    ("0 1 0", "0 0 0", 4.0, (-1.8, 1.8), 87, 2.2),
    ("0 0 1", "0 0 0.316", 3.5, (-2.9, 2.9), 87, 2.2),
    ("0 -1 0", "0.08 0 0", 3.5, (-3.1, -0.1), 87, 2.2),
    ("0 0 1", "-0.08 0 0.384", 3.0, (-2.9, 2.9), 12, 2.6),
    ("0 -1 0", "0 0 0", 1.7, (-0.1, 3.7), 12, 2.6),
    ("0 0 -1", "0.088 0 0", 0.7, (-2.9, 2.9), 12, 2.6),
)


def _link(name: str, mass: float, com: str = "0 0 0.03") -> str:
    inertia = 0.004 * mass
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f'<inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/>'
        "</inertial></link>"
    )


def gripper_urdf(follower: str = '<mimic joint="finger_1"/>') -> str:
    """Text of the URDF; `follower` stands in the second finger's joint."""
    lines = ['<robot name="seven">', '<link name="base"/>']
    parent = "base"
    for k, (axis, offset, mass, (lower, upper), effort, speed) in enumerate(_JOINTS, start=1):
        lines += [
            _link(f"link_{k}", mass),
            f'<joint name="axis_{k}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link_{k}"/><origin xyz="{offset}"/><axis xyz="{axis}"/>'
            f'<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{speed}"/>'
            "</joint>",
        ]
        parent = f"link_{k}"
    lines += [
        _link("hand", 0.7),
        '<joint name="hand_mount" type="fixed"><parent link="link_7"/><child link="hand"/>'
        '<origin xyz="0 0 0.107"/></joint>',
    ]
    for k, side in ((1, "0 1 0"), (2, "0 -1 0")):
        lines += [
            _link(f"finger_link_{k}", 0.02),
            f'<joint name="finger_{k}" type="prismatic"><parent link="hand"/>'
            f'<child link="finger_link_{k}"/><origin xyz="0 0 0.058"/><axis xyz="{side}"/>'
            '<limit lower="0" upper="0.04" effort="20" velocity="0.2"/>'
            f"{follower if k == 2 else ''}</joint>",
        ]
    return "\n".join([*lines, "</robot>"])


def write_gripper_urdf(folder: Path, follower: str = '<mimic joint="finger_1"/>') -> Path:
    """`seven.urdf` in a folder."""
    path = folder / "seven.urdf"
    path.write_text(gripper_urdf(follower))
    return path
