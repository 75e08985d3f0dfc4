"""Arms that bend by laws of their own, written out as static sets. Imports nothing of stiffopt.

The tool moves by turning every joint by its wind-up about its axis (Rodrigues), not by a Jacobian;
torque is lever times force.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

G = 9.81


@dataclass(frozen=True)
class BentArm:
    """Joint axes and offsets between them, all frames parallel at zero angles."""

    axes: tuple = ("z", "y", "y", "x", "y", "x")
    offsets: tuple = (
        (0.0, 0.0, 0.5),
        (0.3, 0.0, 0.2),
        (0.0, 0.0, 1.0),
        (0.4, 0.0, 0.2),
        (0.8, 0.0, 0.0),
        (0.2, 0.0, 0.0),
    )
    tool: tuple = (0.2, 0.15, 0.1)
    stiffness: tuple = (9e5, 2e6, 1.5e6, 2.5e5, 3e5, 1.5e5)
    masses: tuple = ()
    prismatic: tuple = ()

    def places(self, q):
        """Axis and origin of every joint, centre of every link, tool; base frame."""
        turn, origin = np.eye(3), np.zeros(3)
        axes, origins, centres = [], [], []
        for j, (name, offset) in enumerate(zip(self.axes, self.offsets, strict=True)):
            axis = np.eye(3)["xyz".index(name)]
            origin = origin + turn @ np.array(offset)
            axes.append(turn @ axis)
            origins.append(origin)
            if j in self.prismatic:
                origin = origin + turn @ axis * q[j]
            else:
                turn = turn @ rodrigues(axis, q[j])
            centres.append(origin + turn @ (0.3 * np.array(self.tool)))
        return axes, origins, centres, origin + turn @ np.array(self.tool)

    def tip(self, q):
        return self.places(q)[3]

    def torque(self, q, force):
        """Torque of a force on the tool about every axis (force along it for a slide)."""
        axes, origins, _, tip = self.places(q)
        return np.array(
            [
                axes[j] @ (force if j in self.prismatic else np.cross(tip - origins[j], force))
                for j in range(len(axes))
            ]
        )

    def weight(self, q):
        """Torque of all link weights about every axis."""
        axes, origins, centres, _ = self.places(q)
        total = np.zeros(len(axes))
        for link, mass in enumerate(self.masses):
            force = np.array([0.0, 0.0, -mass * G])
            for j in range(link + 1):
                lever = centres[link] - origins[j]
                total[j] += axes[j] @ (force if j in self.prismatic else np.cross(lever, force))
        return total

    def urdf(self):
        parts = ['<robot name="bent"><link name="base"/>']
        parent = "base"
        inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        centre = " ".join(str(0.3 * each) for each in self.tool)
        for j, (name, offset) in enumerate(zip(self.axes, self.offsets, strict=True), start=1):
            kind = "prismatic" if j - 1 in self.prismatic else "revolute"
            axis = " ".join("1" if each == name else "0" for each in "xyz")
            xyz = " ".join(map(str, offset))
            body = (
                f'<inertial><origin xyz="{centre}"/><mass value="{self.masses[j - 1]}"/>'
                f"{inertia}</inertial>"
                if self.masses
                else ""
            )
            parts.append(
                f'<link name="l{j}">{body}</link><joint name="j{j}" type="{kind}">'
                f'<origin xyz="{xyz}"/><parent link="{parent}"/><child link="l{j}"/>'
                f'<axis xyz="{axis}"/><limit lower="-9" upper="9" effort="1e6" velocity="9"/>'
                "</joint>"
            )
            parent = f"l{j}"
        parts.append(
            f'<link name="tool"/><joint name="fix" type="fixed"><origin xyz="'
            f'{" ".join(map(str, self.tool))}"/><parent link="{parent}"/>'
            '<child link="tool"/></joint>'
        )
        return "".join(parts) + "</robot>"


THREE = BentArm(
    axes=("z", "y", "y"),
    offsets=((0.0, 0.0, 0.5), (0.3, 0.0, 0.2), (0.0, 0.0, 1.0)),
    tool=(0.9, 0.2, 0.0),
    stiffness=(9e5, 2e6, 1.5e6),
)


@dataclass(frozen=True)
class Measured:
    """Poses, forces and displacements of an arm."""

    arm: BentArm
    q: np.ndarray
    force: np.ndarray
    displacement: np.ndarray
    difference: bool = True
    nominal: tuple = ()
    extra: dict = field(default_factory=dict)

    def write(self, folder):
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        n = self.q.shape[1]
        (folder / "robot.urdf").write_text(self.arm.urdf())
        names = [f"q{j}" for j in range(1, n + 1)]
        header = ["pose", *names, "fx", "fy", "fz", "dx", "dy", "dz"]
        table = np.column_stack([self.q, self.force, self.displacement])
        lines = [",".join(header)]
        lines += [f"{k}," + ",".join(map(repr, row)) for k, row in enumerate(table.tolist(), 1)]
        (folder / "poses.csv").write_text("\n".join(lines) + "\n")
        text = {
            "schema": "1",
            "kind": '"static"',
            "name": '"bent"',
            "robot": '"robot.urdf"',
            "joints": str([f"j{j}" for j in range(1, n + 1)]),
            "tool_frame": '"tool"',
            "poses": '"poses.csv"',
            "position": str(names),
            "force": '["fx", "fy", "fz"]',
            "displacement": '["dx", "dy", "dz"]',
            "difference": str(self.difference).lower(),
        } | self.extra
        body = "\n".join(f"{key} = {value}" for key, value in text.items())
        if self.nominal:
            body += f"\n[nominal]\nstiffness = {[float(k) for k in self.nominal]}"
        (folder / "static.toml").write_text(body + "\n")
        return folder


def measure(arm, poses, seed, *, noise=2e-5, law=None, difference=True, loads=(50.0, 900.0)):
    """Static set of random poses under random forces; `law` turns torque into wind-up."""
    random = np.random.default_rng(seed)
    stiffness = np.array(arm.stiffness)
    n = len(stiffness)
    wind = law or (lambda torque: torque / stiffness)
    q = random.uniform(-1.2, 1.2, (poses, n))
    direction = random.normal(size=(poses, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    force = direction * np.exp(random.uniform(*np.log(loads), poses))[:, None]
    moved = np.array([displacement(arm, q[k], force[k], wind, difference) for k in range(poses)])
    return Measured(arm, q, force, moved + noise * random.normal(size=moved.shape), difference)


def displacement(arm, q, force, wind, difference):
    """How far the tool moves when every joint winds up under its load."""
    held = arm.weight(q) if arm.masses else np.zeros(len(q))
    loaded = q + wind(held + arm.torque(q, force))
    before = q + wind(held) if difference else q
    return arm.tip(loaded) - arm.tip(before)


def rodrigues(axis, angle):
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
