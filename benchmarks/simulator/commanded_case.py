"""Recording sets of commanded arms: drawn, simulated, written with their sealed truth beside."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .commanded_arms import ARMS, Arm, urdf_text
from .commanded_effects import COMMANDED_EFFECTS, Healthy
from .commanded_world import (
    FRICTION_TOLERANCE,
    GAIN_TOLERANCE,
    MASS_TOLERANCE,
    TIMESTEP,
    World,
    nominal_world,
    simulate,
    true_world,
)

_RUNS, _SECONDS, _SETTLE_SECONDS = 4, 10.0, 1.0
_COMMAND_FREQUENCIES = ((0.08, 0.2), (0.25, 0.45), (0.5, 0.9), (1.0, 1.6))  # [Hz]
# An effect moves some joint at least so many times as far as the tolerances do, or is enlarged.
_MIN_VISIBLE, _ENLARGED, _MAX_ENLARGEMENTS = 1.0, 1.6, 3
# Largest share of its motion by which an effect moves a joint: one that hardly moves, as where a
# servo chatters in a wide gap, is no recording that anyone diagnoses.
_MAX_SHARE_AWAY = 0.5


@dataclass(frozen=True, kw_only=True)
class CommandedSpec:
    """Choices that determine a case.

    Parameters
    ----------
    name, arm : str
    effect : str
        "" for a control.
    size : float
        In typical units.
    gains_stated : bool
        The set states kp and kd.
    seed : int
    """

    name: str
    arm: str
    effect: str
    size: float
    gains_stated: bool
    seed: int


def _commands(arm: Arm, home: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return held commands of one run, one a time step."""
    steps = round((_SECONDS + _SETTLE_SECONDS) / TIMESTEP)
    time = np.arange(steps) * TIMESTEP
    waves = np.zeros((steps, arm.n))
    for band in _COMMAND_FREQUENCIES:
        size, phase = rng.uniform(0.1, 0.3, arm.n), rng.uniform(0.0, 2.0 * np.pi, arm.n)
        waves += size * np.sin(2.0 * np.pi * rng.uniform(*band, arm.n) * time[:, None] + phase)
    smooth = home + waves * np.clip((time - _SETTLE_SECONDS) / 0.5, 0.0, 1.0)[:, None]
    held = round(arm.held / TIMESTEP)
    command = smooth[(np.arange(steps) // held) * held]
    return np.round(command / arm.count) * arm.count if arm.commands_counted else command


def _log(
    arm: Arm, readings: np.ndarray, command: np.ndarray, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    first, every = round(_SETTLE_SECONDS / TIMESTEP), round(1.0 / (arm.rate * TIMESTEP))
    rows = slice(first, None, every)
    noisy = readings[rows] + arm.noise * rng.normal(size=readings[rows].shape)
    counts = np.round(noisy / arm.count) * arm.count
    columns = {"t": np.arange(len(counts)) / arm.rate}
    columns |= {f"cmd{j + 1}": command[rows, j] for j in range(arm.n)}
    return columns | {f"q{j + 1}": counts[:, j] for j in range(arm.n)}


def write_commanded_case(spec: CommandedSpec, folder: Callable[[], Path]) -> dict[str, Any]:
    """Simulate a case and return its truth; `folder` is asked for when the truth is known."""
    rng = np.random.default_rng(spec.seed)
    arm = ARMS[spec.arm].drawn(rng)
    home = rng.uniform(-0.5, 0.5, arm.n) + 0.4
    commands = [_commands(arm, home, rng) for _ in range(_RUNS)]
    low, high = arm.delays
    delay = TIMESTEP * round(float(rng.uniform(low, high)) / TIMESTEP)
    world = true_world(arm, delay, rng, gains=spec.gains_stated)
    truth: dict[str, Any] = {"id": spec.name, "arm": spec.arm, "effect": spec.effect, "joint": None}
    if spec.effect:
        world, about = _with_effect(spec, arm, world, commands[0], rng)
        truth |= about
    columns = [_log(arm, simulate(world, own)[0], own, rng) for own in commands]
    truth |= {name: getattr(world, name).tolist() for name in ("kp", "kd", "coulomb", "viscous")}
    # A step takes angles at its middle: torques begin half a step before their command, and rates
    # are half a step old in a servo, new in a bearing.
    late = 0.5 * TIMESTEP
    truth["delay"] = (world.delay - late).tolist()
    truth["armature"] = (world.armature + late * (world.viscous - world.kd)).tolist()
    truth |= {"gains_stated": spec.gains_stated, "mass_scale": world.scale.tolist()}
    text = json.dumps(truth, indent=1, sort_keys=True, default=float) + "\n"
    own = folder()
    (own / "robot.urdf").write_text(urdf_text(arm), encoding="utf-8")
    (own / "recordings.toml").write_text(_recordings_toml(spec, arm), encoding="utf-8")
    for k, each in enumerate(columns):
        np.savez_compressed(own / f"run{k}.npz", **each)
    digest = hashlib.sha256(text.encode()).hexdigest()
    (own / "commitment.txt").write_text(digest + "\n", encoding="utf-8")
    return truth | {"text": text}


def _with_effect(
    spec: CommandedSpec, arm: Arm, healthy: World, command: np.ndarray, rng: np.random.Generator
) -> tuple[World, dict[str, Any]]:
    """Return the arm with the effect at a joint and a size at which it can be seen."""
    entry = COMMANDED_EFFECTS[spec.effect]
    plain, torque = simulate(healthy, command)
    nominal = simulate(nominal_world(arm, float(healthy.delay[0])), command)[0]
    tolerated = np.sqrt(np.mean((plain - nominal) ** 2, axis=0))
    moving = slice(round(_SETTLE_SECONDS / TIMESTEP), None)
    about = Healthy(
        np.abs(torque[moving]).max(axis=0),
        plain[moving].min(axis=0),
        plain[moving].max(axis=0),
        _tool_heights(arm, plain[moving][::40]),
    )
    joints = entry.first + rng.permutation(arm.n - entry.first)
    seed, best = int(rng.integers(2**62)), None
    for joint in joints if entry.at_joint else joints[:1]:
        for k in range(_MAX_ENLARGEMENTS):
            size = spec.size * _ENLARGED**k
            world = deepcopy(healthy)
            params = entry.act(world, int(joint), size, np.random.default_rng(seed), about)
            try:
                moved = np.sqrt(np.mean((simulate(world, command)[0] - plain) ** 2, axis=0))
            except FloatingPointError:  # e.g. a servo that chatters in a wide gap: the next joint
                break
            if np.any(moved > _MAX_SHARE_AWAY * np.std(plain, axis=0)):
                break
            seen = float(np.max(moved / tolerated))
            found = (world, int(joint), params, size, seen)
            if seen >= _MIN_VISIBLE * spec.size:
                return _told(entry.at_joint, *found)
            if best is None or seen > best[-1]:
                best = found
    if best is None:
        raise FloatingPointError(f"no joint follows its commands with {spec.effect}")
    return _told(entry.at_joint, *best)


def _told(
    at_joint: bool, world: World, joint: int, params: dict[str, float], size: float, seen: float
) -> tuple[World, dict[str, Any]]:
    place = joint + 1 if at_joint else None
    return world, {"joint": place, "params": params, "size": size, "seen": seen}


def _tool_heights(arm: Arm, q: np.ndarray) -> np.ndarray:
    """Return the height of the tool (K,) at angles (K, n) [m]."""
    height, points = np.empty(len(q)), arm.places
    for k, angles in enumerate(q):
        turn, place = np.eye(3), np.zeros(3)
        for letter, angle, ahead in zip(arm.axes, angles, points, strict=False):
            place = place + turn @ np.array([0.0, 0.0, ahead])
            i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[letter]
            own = np.eye(3)
            own[i, i] = own[j, j] = np.cos(angle)
            own[i, j], own[j, i] = -np.sin(angle), np.sin(angle)
            turn = turn @ own
        height[k] = (place + turn @ np.array([0.0, 0.0, points[-1]]))[2]
    return height


def _recordings_toml(spec: CommandedSpec, arm: Arm) -> str:
    """Return the description; nothing in it depends on the effect."""
    joints = range(1, arm.n + 1)
    lines = ["schema = 1", f'name = "{spec.name}"', 'robot = "robot.urdf"']
    lines += [f"joints = {[f'j{k}' for k in joints]}", 'tool_frame = "tool"']
    lines += ["[signals]", 'time = "t"', f"position = {[f'q{k}' for k in joints]}"]
    lines += [f"command = {[f'cmd{k}' for k in joints]}", "[nominal]"]
    lines += [f"coulomb = {list(arm.coulomb)}", f"rotor_inertia = {list(arm.armature)}"]
    if spec.gains_stated:
        lines += [f"viscous = {list(arm.viscous)}"]
    lines += ["[tolerance]", f"mass = {MASS_TOLERANCE}", "com = 0.001"]
    lines += [f"coulomb = {FRICTION_TOLERANCE}", f"rotor_inertia = {FRICTION_TOLERANCE}"]
    if spec.gains_stated:
        lines += [f"viscous = {FRICTION_TOLERANCE}"]
    lines += ["[actuator]", 'kind = "position_servo"']
    if spec.gains_stated:
        lines += [f"kp = {list(arm.kp)}", f"kd = {list(arm.kd)}", f"tolerance = {GAIN_TOLERANCE}"]
    for k in range(_RUNS):
        role = "test" if k == _RUNS - 1 else "train"
        lines += ["[[runs]]", f'file = "run{k}.npz"', f'role = "{role}"']
    return "\n".join(lines) + "\n"
