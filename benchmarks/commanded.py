"""Arms that follow commands, without torque: MuJoCo simulates them, diagnoses name what is missing.

MuJoCo shares no formula with the package: dry friction is a constraint there, joints are integrated
implicitly, and bodies come from its own reading of the URDF. Run from the root of the repository:

    python -m benchmarks.commanded OUT [ARM ...] [--seeds N]

Each case is a recording set in OUT/ARM_EFFECT_SEED with three runs for training and one held out; a
table of effect and joint found first, false findings, gain, delay and held-out error is printed and
written to OUT/commanded.csv. Needs the package `mujoco`.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.recording.recording_set import load_recordings

_TIMESTEP = 5e-4  # of MuJoCo [s]
_RUNS, _SECONDS = 4, 10.0
_MASS_TOLERANCE, _FRICTION_TOLERANCE = 0.03, 0.1


@dataclass(frozen=True, kw_only=True)
class Arm:
    """A kind of arm: links as uniform rods, controllers, logging; one number a joint.

    Parameters
    ----------
    axes : str
        Axis of each joint, "x", "y" or "z".
    lengths, masses : tuple of float
        Of the rods [m], [kg].
    kp, kd, armature, coulomb, viscous : tuple of float
        SI, at the joints.
    rate, held : float
        Of the log [Hz], and interval of the commands [s].
    count : float
        Of the encoders [rad].
    delay : float
        Of commands [s].
    known_gains : bool
        The recording set states kp and kd.
    """

    axes: str
    lengths: tuple[float, ...]
    masses: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    armature: tuple[float, ...]
    coulomb: tuple[float, ...]
    viscous: tuple[float, ...]
    rate: float
    held: float
    count: float
    delay: float
    known_gains: bool = True

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.axes)


ARMS = {
    "servo": Arm(
        axes="zyyyxz", lengths=(0.06, 0.12, 0.13, 0.06, 0.04, 0.08),
        masses=(0.15, 0.18, 0.15, 0.08, 0.06, 0.1), kp=(18.0, 18.0, 18.0, 12.0, 12.0, 12.0),
        kd=(0.6, 0.6, 0.6, 0.3, 0.3, 0.3), armature=(0.03, 0.03, 0.03, 0.02, 0.02, 0.02),
        coulomb=(0.06, 0.06, 0.06, 0.04, 0.04, 0.04), viscous=(0.2, 0.2, 0.2, 0.1, 0.1, 0.1),
        rate=50.0, held=0.02, count=2.0 * np.pi / 4096, delay=0.015,
    ),
    "leg": Arm(
        axes="xyy", lengths=(0.1, 0.21, 0.21), masses=(0.7, 1.1, 0.25), kp=(20.0, 20.0, 25.0),
        kd=(1.0, 1.0, 1.0), armature=(0.012, 0.012, 0.03), coulomb=(0.2, 0.2, 0.4),
        viscous=(0.15, 0.15, 0.2), rate=200.0, held=0.02, count=1e-4, delay=0.004,
    ),
    "industrial": Arm(
        axes="zyyxyx", lengths=(0.4, 0.6, 0.5, 0.15, 0.12, 0.1),
        masses=(12.0, 14.0, 9.0, 3.0, 2.0, 1.0), kp=(9e3, 9e3, 6e3, 900.0, 900.0, 500.0),
        kd=(300.0, 300.0, 200.0, 25.0, 25.0, 12.0), armature=(4.0, 4.0, 2.5, 0.3, 0.3, 0.2),
        coulomb=(15.0, 16.0, 10.0, 2.5, 2.5, 2.0), viscous=(14.0, 14.0, 9.0, 1.8, 1.8, 1.4),
        rate=250.0, held=0.004, count=1e-5, delay=0.008,
    ),
}  # fmt: skip


@dataclass
class Simulation:
    """MuJoCo model of an arm with what MuJoCo's own model does not hold."""

    model: Any
    kp: np.ndarray
    kd: np.ndarray
    zero: np.ndarray
    offset: np.ndarray


def _add(array: str, share: str, factor: float) -> Callable[[Simulation, Arm, int], None]:
    """Return an effect that adds a multiple of a nominal value of the arm."""

    def act(simulation: Simulation, arm: Arm, joint: int) -> None:
        getattr(simulation.model, array)[joint] += factor * getattr(arm, share)[joint]

    return act


def _spring(simulation: Simulation, arm: Arm, joint: int) -> None:
    simulation.model.jnt_stiffness[joint] = 0.1 * arm.kp[joint]


def _payload(simulation: Simulation, arm: Arm, joint: int) -> None:
    body, mass = simulation.model.nbody - 1, 0.15 * sum(arm.masses)
    model, own = simulation.model, simulation.model.body_mass[-1]
    tip = np.array([0.0, 0.0, -arm.lengths[-1]])
    centre = (own * model.body_ipos[body] + mass * tip) / (own + mass)
    apart = tip - model.body_ipos[body]
    about = own * mass / (own + mass) * (apart @ apart * np.ones(3) - apart**2)
    model.body_inertia[body] += about
    model.body_ipos[body], model.body_mass[body] = centre, own + mass


def _tilt(simulation: Simulation, arm: Arm, joint: int) -> None:
    simulation.model.opt.gravity[:] = 9.81 * np.array([np.sin(0.05), 0.0, -np.cos(0.05)])


def _gain(simulation: Simulation, arm: Arm, joint: int) -> None:
    simulation.kp[joint] *= 0.8
    simulation.kd[joint] *= 0.8


def _zero(simulation: Simulation, arm: Arm, joint: int) -> None:
    simulation.zero[joint] = 0.06


def _offset(simulation: Simulation, arm: Arm, joint: int) -> None:
    simulation.offset[joint] = 2.0 * arm.coulomb[joint]


# Names that count as found; the joint is not judged for effects of the whole robot.
EFFECTS: dict[str, tuple[Callable[[Simulation, Arm, int], None], tuple[str, ...], bool]] = {
    "control": (lambda *_: None, (), False),
    "coulomb": (_add("dof_frictionloss", "coulomb", 1.5), ("coulomb",), True),
    "viscous": (_add("dof_damping", "viscous", 1.5), ("viscous",), True),
    "rotor_inertia": (_add("dof_armature", "armature", 1.0), ("rotor_inertia",), True),
    "gravity_spring": (_spring, ("gravity_spring", "cable_spring"), True),
    "payload": (_payload, ("payload",), False),
    "base_tilt": (_tilt, ("base_tilt",), False),
    "torque_gain": (_gain, ("torque_gain",), True),
    "joint_zero": (_zero, ("joint_zero",), True),
    "torque_offset": (_offset, ("torque_offset",), True),
}


def urdf_text(arm: Arm) -> str:
    """Return the URDF of an arm of uniform rods that hang along -z."""
    parts = ['<?xml version="1.0"?>', '<robot name="arm"><link name="base"/>']
    before, place = "base", 0.0
    for k, (axis, length, mass) in enumerate(
        zip(arm.axes, arm.lengths, arm.masses, strict=True), start=1
    ):
        across, along = mass * length**2 / 12.0 + mass * 1e-4, mass * 4e-4
        turns = " ".join("1" if axis == each else "0" for each in "xyz")
        limit = f'lower="-3" upper="3" effort="{40 * arm.kp[k - 1]:g}" velocity="12"'
        parts.append(
            f'<joint name="j{k}" type="revolute"><parent link="{before}"/><child link="l{k}"/>'
            f'<origin xyz="0 0 {-place:g}"/><axis xyz="{turns}"/><limit {limit}/></joint>'
            f'<link name="l{k}"><inertial><origin xyz="0 0 {-0.5 * length:g}"/>'
            f'<mass value="{mass:g}"/><inertia ixx="{across:g}" iyy="{across:g}" izz="{along:g}"'
            ' ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        before, place = f"l{k}", length
    return "\n".join([*parts, "</robot>"])


def simulate_run(simulation: Simulation, arm: Arm, rng: np.random.Generator) -> dict[str, Any]:
    """Return time, commands and quantised positions of one run."""
    model = simulation.model
    data = mujoco.MjData(model)
    steps = round(_SECONDS / _TIMESTEP)
    time = np.arange(steps) * _TIMESTEP
    waves = sum(
        rng.uniform(0.12, 0.3, arm.n)
        * np.sin(2.0 * np.pi * f * time[:, None] + rng.uniform(0.0, 6.0, arm.n))
        for f in (0.13, 0.31, 0.7, 1.3)
    )
    smooth = 0.3 + waves * np.minimum(time / 0.5, 1.0)[:, None]
    held, late = round(arm.held / _TIMESTEP), round(arm.delay / _TIMESTEP)
    command = smooth[(np.arange(steps) // held) * held]
    data.qpos[:] = command[0]
    every = round(1.0 / (arm.rate * _TIMESTEP))
    rows = []
    for k in range(steps):
        reading = data.qpos + simulation.zero
        if k % every == 0:
            counts = np.round(reading / arm.count) * arm.count
            rows.append([time[k], *command[k], *counts])
        error = command[max(k - late, 0)] - reading
        data.qfrc_applied[:] = simulation.kp * error - simulation.kd * data.qvel + simulation.offset
        mujoco.mj_step(model, data)
    table = np.array(rows).T
    names = ["t", *(f"cmd{j}" for j in range(arm.n)), *(f"q{j}" for j in range(arm.n))]
    return dict(zip(names, table, strict=True))


def write_case(folder: Path, arm: Arm, effect: str, seed: int) -> int:
    """Write the recording set of a case; return the joint (from 1) of its effect."""
    rng = np.random.default_rng([seed, list(EFFECTS).index(effect), arm.n, int(arm.rate)])
    folder.mkdir(parents=True, exist_ok=True)
    text = urdf_text(arm)
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = _TIMESTEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST

    def draw(values: tuple[float, ...], tolerance: float) -> np.ndarray:
        return np.array(values) * (1.0 + tolerance * rng.normal(size=arm.n))

    model.dof_armature[:] = draw(arm.armature, _FRICTION_TOLERANCE)
    model.dof_damping[:] = draw(arm.viscous, _FRICTION_TOLERANCE)
    model.dof_frictionloss[:] = draw(arm.coulomb, _FRICTION_TOLERANCE)
    # By default dry friction of MuJoCo creeps for 20 ms: at a leg's speeds it is hardly dry.
    model.dof_solref[:], model.dof_solimp[:, :2] = [2.0 * _TIMESTEP, 1.0], 0.999
    scale = 1.0 + _MASS_TOLERANCE * rng.normal(size=arm.n)
    model.body_mass[1:] *= scale
    model.body_inertia[1:] *= scale[:, None]
    simulation = Simulation(
        model, np.array(arm.kp), np.array(arm.kd), np.zeros(arm.n), np.zeros(arm.n)
    )
    joint = int(rng.integers(1, arm.n))
    EFFECTS[effect][0](simulation, arm, joint)
    lines = ["schema = 1", f'name = "{folder.name}"', 'robot = "robot.urdf"']
    lines += [f"joints = {[f'j{k}' for k in range(1, arm.n + 1)]}", 'tool_frame = "l1"']
    lines[-1] = f'tool_frame = "l{arm.n}"'
    lines += ["[signals]", 'time = "t"', f"position = {[f'q{j}' for j in range(arm.n)]}"]
    lines += [f"command = {[f'cmd{j}' for j in range(arm.n)]}", "[nominal]"]
    lines += [f"coulomb = {list(arm.coulomb)}", f"viscous = {list(arm.viscous)}"]
    lines += [f"rotor_inertia = {list(arm.armature)}", "[tolerance]"]
    lines += [f"mass = {_MASS_TOLERANCE}", "com = 0.002", f"coulomb = {_FRICTION_TOLERANCE}"]
    lines += [f"viscous = {_FRICTION_TOLERANCE}", f"rotor_inertia = {_FRICTION_TOLERANCE}"]
    if arm.known_gains:
        lines += ["[actuator]", 'kind = "position_servo"', f"kp = {list(arm.kp)}"]
        lines += [f"kd = {list(arm.kd)}"]
    for k in range(_RUNS):
        np.savez_compressed(folder / f"run{k}.npz", **simulate_run(simulation, arm, rng))
        lines += ["[[runs]]", f'file = "run{k}.npz"']
        lines += [f'role = "{"test" if k == _RUNS - 1 else "train"}"']
    (folder / "recordings.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return joint + 1


def score(found: Diagnosis, arm: Arm, effect: str, joint: int) -> dict[str, object]:
    """Return whether a diagnosis names a case's effect first, and its errors."""
    named = [f for f in found.findings if f.certainty in ("found", "likely")]
    _, names, at_joint = EFFECTS[effect]
    first = named[0] if named else None
    right = first is not None and first.effect.name in names
    delay = float("nan") if found.closed_loop is None else found.closed_loop.values["delay"][0]
    errors = [(run.before - run.measured, run.after - run.measured) for run in found.positions]
    before, after = (
        1e3 * float(np.sqrt(np.mean(np.concatenate([e[k] for e in errors]) ** 2))) if errors
        else float("nan") for k in (0, 1)
    )  # fmt: skip
    return {
        "effect": effect,
        "joint": joint,
        "first": "" if first is None else f"{first.effect.name} {first.joint or ''}".strip(),
        "effect_right": right if names else not named,
        "joint_right": (right and (not at_joint or first.joint == joint)) if names else not named,
        "named": len(named),
        "delay_error_ms": round(1e3 * (delay - arm.delay), 3),
        "before_mrad": round(before, 3),
        "after_mrad": round(after, 3),
    }


def run_cases(out: Path, arms: list[str], seeds: int) -> Iterator[dict[str, object]]:
    """Simulate, diagnose and score all cases."""
    for name in arms:
        for effect in EFFECTS:
            for seed in range(seeds):
                folder = out / f"{name}_{effect}_{seed}"
                joint = write_case(folder, ARMS[name], effect, seed)
                found = diagnose(load_recordings(folder), experiment=False)
                yield {"arm": name, **score(found, ARMS[name], effect, joint)}


def main() -> None:
    """Run the cases of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("out", type=Path)
    parser.add_argument("arms", nargs="*", choices=[*ARMS, []], default=list(ARMS))
    parser.add_argument("--seeds", type=int, default=1)
    chosen = parser.parse_args()
    rows = []
    for row in run_cases(chosen.out, chosen.arms, chosen.seeds):
        print("  ".join(f"{key}={value}" for key, value in row.items()), flush=True)
        rows.append(row)
    with (chosen.out / "commanded.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, rows[0])
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
