"""A SCARA arm and a gantry as users have them: URDF, logs in CSV, friction that is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

Log = dict[str, np.ndarray]


def link(name: str, mass: float, com: str) -> str:
    inertia = 0.006 * mass
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f'<inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/>'
        "</inertial></link>"
    )


def joint(name: str, kind: str, links: str, xyz: str, axis: str, limits: tuple[float, ...]) -> str:
    parent, child = links.split()
    lower, upper, effort, speed = limits
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}"'
        f' effort="{effort}" velocity="{speed}"/></joint>'
    )


@dataclass(frozen=True)
class Machine:
    """A robot with the middle and size of its motions, its friction and its sensors' noise."""

    name: str
    urdf: str
    joints: tuple[str, ...]
    middle: tuple[float, ...]
    swing: tuple[float, ...]
    coulomb: tuple[float, ...]
    viscous: tuple[float, ...]
    noise: tuple[float, ...]

    def logs(self, payload: tuple[int, float] | None = None) -> list[Log]:
        """Four runs of 6 s at 200 Hz; `payload` is carried in one run (from 0) [kg]."""
        model, rng = pin.buildModelFromXML(self.urdf), np.random.default_rng(5)
        found = []
        for number in range(4):
            carried = pin.Model(model)
            if payload is not None and payload[0] == number:
                last = carried.inertias[carried.njoints - 1]
                extra = pin.Inertia(payload[1], last.lever, 1e-3 * payload[1] * np.eye(3))
                carried.inertias[carried.njoints - 1] = last + extra
            found.append(self._log(carried, rng))
        return found

    def _log(self, model: pin.Model, rng: np.random.Generator) -> Log:
        n, t = len(self.joints), np.arange(0.0, 6.0, 0.005)
        omega = 2.0 * np.pi / 3.0 * np.arange(1, 5)
        waves = np.stack([np.sin(np.outer(t, omega)), np.cos(np.outer(t, omega))])
        size = rng.normal(size=(2, 4, n)) / np.arange(1, 5)[:, None]
        size *= np.array(self.swing) / np.sqrt((size**2).sum(axis=(0, 1))) / 1.5
        turned = np.stack([waves[1], -waves[0]])
        q = np.array(self.middle) + np.einsum("stk,skj->tj", waves, size)
        v = np.einsum("stk,skj->tj", turned * omega, size)
        a = -np.einsum("stk,skj->tj", waves * omega**2, size)
        data = model.createData()
        tau = np.array([pin.rnea(model, data, *each) for each in zip(q, v, a, strict=True)])
        tau += np.array(self.coulomb) * np.tanh(v / 0.01) + np.array(self.viscous) * v
        return {
            "t": t,
            "q": q + 2e-6 * rng.normal(size=q.shape),
            "v": v + 1e-3 * rng.normal(size=q.shape),
            "tau": tau + rng.normal(size=q.shape) * self.noise,
        }

    def write(
        self,
        folder: Path,
        change: Callable[[list[Log]], object] = lambda logs: None,
        payload: tuple[int, float] | None = None,
    ) -> Path:
        """A recording set of logs that were changed; three to fit and one left out."""
        folder.mkdir()
        logs = self.logs(payload)
        change(logs)
        (folder / "robot.urdf").write_text(self.urdf)
        names = [f"{kind}_{joint}" for kind in ("q", "v", "tau") for joint in self.joints]
        for number, log in enumerate(logs, start=1):
            np.savetxt(
                folder / f"run_{number}.csv",
                np.column_stack([log[kind] for kind in ("t", "q", "v", "tau")]),
                delimiter=",", header=",".join(["t", *names]), comments="", fmt="%.9g",
            )  # fmt: skip
        listed = {kind: [f"{kind}_{joint}" for joint in self.joints] for kind in ("q", "v", "tau")}
        runs = "".join(
            f'[[runs]]\nfile = "run_{k}.csv"\nrole = "{"test" if k == 4 else "train"}"\n'
            for k in range(1, len(logs) + 1)
        )
        (folder / "recordings.toml").write_text(
            f'schema = 1\nname = "{self.name}"\nrobot = "robot.urdf"\n'
            f'joints = {list(self.joints)}\n[signals]\ntime = "t"\nposition = {listed["q"]}\n'
            f'velocity = {listed["v"]}\ntorque = {listed["tau"]}\ntorque_side = "motor"\n'
            f"[nominal]\ncoulomb = {list(self.coulomb)}\nviscous = {list(self.viscous)}\n"
            f"rotor_inertia = {[0.0] * len(self.joints)}\n"
            "[tolerance]\nmass = 0.01\ncom = 0.002\ncoulomb = 0.05\nviscous = 0.05\n"
            f"[noise]\ntorque = {list(self.noise)}\nvelocity = 0.001\n{runs}"
        )
        return folder


SCARA = Machine(
    name="scara",
    urdf="".join(
        [
            '<robot name="scara"><link name="pillar"/>',
            link("upper", 6.0, "0.15 0 0"),
            link("fore", 4.0, "0.12 0 0.02"),
            link("wrist", 1.2, "0.01 0 -0.05"),
            joint("shoulder", "revolute", "pillar upper", "0 0 0.4", "0 0 1", (-2.4, 2.4, 90, 5)),
            joint("elbow", "revolute", "upper fore", "0.325 0 0", "0 0 1", (-2.6, 2.6, 45, 6)),
            joint("roll", "revolute", "fore wrist", "0.275 0 0", "0 0 1", (-6, 6, 8, 12)),
            "</robot>",
        ]
    ),
    joints=("shoulder", "elbow", "roll"),
    middle=(0.0, 0.6, 0.0),
    swing=(1.3, 1.4, 2.5),
    coulomb=(3.0, 1.6, 0.4),
    viscous=(2.0, 0.9, 0.1),
    noise=(0.25, 0.12, 0.03),
)
GANTRY = Machine(
    name="gantry",
    urdf="".join(
        [
            '<robot name="gantry"><link name="frame"/>',
            link("bridge", 22.0, "0 0.3 0"),
            link("cart", 9.0, "0 0 0"),
            link("ram", 5.0, "0 0 -0.2"),
            joint("X", "prismatic", "frame bridge", "0 0 1", "1 0 0", (-0.1, 1.6, 400, 2)),
            joint("Y", "prismatic", "bridge cart", "0 0.1 0", "0 1 0", (-0.1, 0.9, 250, 2)),
            joint("Z", "prismatic", "cart ram", "0 0 0", "0 0 1", (-0.5, 0.1, 150, 1.5)),
            "</robot>",
        ]
    ),
    joints=("X", "Y", "Z"),
    middle=(1.0, 0.4, -0.2),
    swing=(0.5, 0.35, 0.2),
    coulomb=(25.0, 14.0, 9.0),
    viscous=(40.0, 22.0, 15.0),
    noise=(2.0, 1.2, 0.8),
)
