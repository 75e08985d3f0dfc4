"""Random arms of six or seven axes: rigid bodies, friction of the drives, and their URDF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin

GRAVITY = 9.81  # [m/s^2]
# Axes of articulated arms from the base, and shares of the reach that lie before each joint.
AXES = {6: "zyyxyx", 7: "zyzyzyx"}
REACH_SHARES = {6: (0.2, 0.1, 0.42, 0.1, 0.3, 0.08), 7: (0.2, 0.12, 0.2, 0.2, 0.2, 0.2, 0.08)}
UNIT = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
Masses = Literal["stated", "alike", "none"]


@dataclass(frozen=True)
class Arm:
    """True arm; arrays (n,) by joint, `offsets` and `centres` (n, 3) in link axes [m]."""

    axes: str
    offsets: np.ndarray
    masses: np.ndarray
    centres: np.ndarray
    lengths: np.ndarray
    rotors: np.ndarray  # behind the gear [kg m^2]
    torques: np.ndarray  # largest of the drives [N m]
    speeds: np.ndarray  # largest [rad/s]
    dry: np.ndarray
    viscous: np.ndarray
    slow: np.ndarray  # added to dry friction at rest, falls with speed [N m]
    slow_speed: np.ndarray  # over which it falls [rad/s]

    def model(self) -> pin.Model:
        """Rigid bodies with the tool frame at the end."""
        model, parent = pin.Model(), 0
        for k, axis in enumerate(self.axes):
            place = pin.SE3(np.eye(3), self.offsets[k])
            joint = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}[axis]()
            parent = model.addJoint(parent, joint, place, f"joint{k + 1}")
            inertia = pin.Inertia(self.masses[k], self.centres[k], self.rod(k))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        tool = pin.SE3(np.eye(3), self.tool)
        model.addFrame(pin.Frame("tool", parent, 0, tool, pin.FrameType.OP_FRAME))
        return model

    @property
    def tool(self) -> np.ndarray:
        return np.array([self.lengths[-1], 0.0, 0.0])

    def rod(self, k: int) -> np.ndarray:
        """Inertia (3, 3) of a thick rod along the link."""
        m, length, width = self.masses[k], self.lengths[k], 0.35 * self.lengths[k]
        along = self.centres[k] / max(np.linalg.norm(self.centres[k]), 1e-9)
        across = m * (length**2 + 3.0 * width**2) / 12.0
        return np.asarray(
            across * np.eye(3) + (m * width**2 / 2.0 - across) * np.outer(along, along)
        )

    def urdf(self, masses: Masses) -> str:
        """What the user has: masses stated, 2 kg for every link, or none."""
        lines = ['<?xml version="1.0"?>', '<robot name="arm">', '<link name="base"/>']
        for k, axis in enumerate(self.axes):
            m, c, inertia = self.masses[k], self.centres[k], self.rod(k)
            if masses == "alike":
                m, c, inertia = 2.0, np.zeros(3), 0.01 * np.eye(3)
            size = _text(np.abs(2.0 * self.centres[k]) + 0.3 * self.lengths[k])
            shape = (
                f'<visual><origin xyz="{_text(self.centres[k])}"/>'
                f'<geometry><box size="{size}"/></geometry></visual>'
            )
            values = zip(
                ("xx", "xy", "xz", "yy", "yz", "zz"), inertia[np.triu_indices(3)], strict=True
            )
            body = (
                f'<inertial><origin xyz="{_text(c)}"/><mass value="{m:.4f}"/><inertia '
                + " ".join(f'i{name}="{value:.6g}"' for name, value in values)
                + "/></inertial>"
            )
            lines += [
                f'<link name="link{k + 1}">{shape}{"" if masses == "none" else body}</link>',
                f'<joint name="joint{k + 1}" type="revolute"><parent link="'
                f'{"base" if k == 0 else f"link{k}"}"/><child link="link{k + 1}"/>'
                f'<origin xyz="{_text(self.offsets[k])}"/><axis xyz="{_text(UNIT[axis])}"/>'
                f'<limit lower="-3.1" upper="3.1" effort="{self.torques[k]:.4g}" '
                f'velocity="{self.speeds[k]:.4g}"/></joint>',
            ]
        lines += [
            '<link name="tool0"/>',
            f'<joint name="tool" type="fixed"><parent link="link{len(self.axes)}"/>'
            f'<child link="tool0"/><origin xyz="{_text(self.tool)}"/></joint>',
        ]
        return "\n".join([*lines, "</robot>", ""])


def draw_arm(rng: np.random.Generator) -> Arm:
    """An arm of 5 to 200 kg whose drives suit its weight."""
    n = int(rng.choice([6, 7]))
    axes = AXES[n]
    mass = float(np.exp(rng.uniform(np.log(5.0), np.log(200.0))))
    reach = 0.55 * (mass / 5.0) ** 0.3 * rng.uniform(0.9, 1.1)
    lengths = reach * np.array(REACH_SHARES[n]) * rng.uniform(0.85, 1.15, n)
    upright = np.array([k < 2 or axis == "z" for k, axis in enumerate(axes)])
    along = np.where(upright[:, None], UNIT["z"], UNIT["x"])
    offsets = lengths[:, None] * along + rng.normal(0.0, 0.02 * reach, (n, 3))
    share = 0.72 ** np.arange(n) * rng.uniform(0.7, 1.3, n)
    masses = mass * share / share.sum()
    next_along = np.vstack([along[1:], UNIT["x"]])
    ahead = np.append(lengths[1:], lengths[-1])
    centres = (0.45 * ahead)[:, None] * next_along + rng.normal(0.0, 0.015 * reach, (n, 3))
    outer = np.cumsum(masses[::-1])[::-1]
    arms = np.cumsum(ahead[::-1])[::-1]
    weight = GRAVITY * outer * 0.5 * arms
    torques = 2.2 * weight * rng.uniform(0.9, 1.4, n)
    dry = torques * rng.uniform(0.03, 0.07, n)
    return Arm(
        axes=axes,
        offsets=offsets,
        masses=masses,
        centres=centres,
        lengths=ahead,
        rotors=0.25 * outer * arms**2 / 3.0 * rng.uniform(0.5, 1.5, n),
        torques=torques,
        speeds=3.0 * (5.0 / mass) ** 0.15 * np.linspace(0.8, 1.3, n),
        dry=dry,
        viscous=dry * rng.uniform(0.3, 1.0, n),
        slow=dry * rng.uniform(0.0, 0.4, n),
        slow_speed=rng.uniform(0.02, 0.12, n),
    )


def _text(values: np.ndarray | tuple[float, ...]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
