"""Physics that the nominal model of a commanded arm lacks, one function a law.

Each changes a true arm at a joint (from 0) by a size in typical units, and returns its parameters
as a diagnosis names them. None shares a formula with the package.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .commanded_world import State, World


@dataclass(frozen=True)
class Healthy:
    """Motion without the effect: largest servo torques (n,), angles and tool heights."""

    torque: np.ndarray
    low: np.ndarray
    high: np.ndarray
    heights: np.ndarray


Act = Callable[[World, int, float, np.random.Generator, Healthy], dict[str, float]]


@dataclass(frozen=True)
class CommandedEffect:
    """A law with the names of the catalogue's effects that are right for it.

    Parameters
    ----------
    act : callable
    names : tuple of str
    at_joint : bool
        The effect is of one joint.
    first : int
        First joint (from 0) at which it can be.
    """

    act: Act
    names: tuple[str, ...]
    at_joint: bool = True
    first: int = 0


def _unit(n: int, joint: int) -> np.ndarray:
    return np.eye(n)[joint]


def _coulomb(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    more = size * world.arm.coulomb[joint]
    world.coulomb[joint] += more
    return {"dFc": more}


def _viscous(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    more = size * world.arm.viscous[joint]
    world.viscous[joint] += more
    return {"dFv": more}


def _stribeck(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    rise, speed = size * world.arm.coulomb[joint], float(rng.uniform(0.05, 0.2))
    own = _unit(world.arm.n, joint)

    def more(state: State) -> np.ndarray:
        return np.asarray(own * rise * np.exp(-((state.v[joint] / speed) ** 2)))

    world.friction.append(more)
    return {"A": rise, "vs": speed, "n": 2.0}


def _load_friction(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    share, own = 0.08 * size, _unit(world.arm.n, joint)
    world.friction.append(lambda state: share * np.abs(state.link_torque) * own)
    return {"mu": share}


def _backlash(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    world.backlash[joint] = size * world.arm.backlash
    return {"width": world.backlash[joint]}


def _rotor_inertia(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    more = size * world.arm.armature[joint]
    world.armature[joint] += more
    return {"dJ": more}


def _payload(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    arm, mass = world.arm, 0.05 * size * sum(world.arm.masses)
    place = np.array([0.0, 0.0, (1.0 if arm.upward else -1.0) * arm.lengths[-1]])
    world.payload = (mass, place)
    return {"dm": mass}


def _base_tilt(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    # Not about the axis of a first joint alone, whose zero it would be.
    angle, heading = 0.03 * size, rng.uniform(0.25, 1.3) + 0.5 * np.pi * rng.integers(4)
    lean = np.array([np.cos(heading), np.sin(heading)]) * np.sin(angle)
    world.gravity = 9.81 * np.array([*lean, -np.cos(angle)])
    return {"angle": angle, "heading": float(heading)}


def _joint_zero(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    world.zero[joint] = float(0.03 * size * rng.choice([-1.0, 1.0]))
    return {"dq": -world.zero[joint]}


def _spring_rate(size: float, joint: int, healthy: Healthy) -> float:
    """Return a stiffness that takes a share of a joint's torque over its stroke [N m/rad]."""
    return float(0.3 * size * healthy.torque[joint] / (healthy.high[joint] - healthy.low[joint]))


def _gravity_spring(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    rate, own = 2.0 * _spring_rate(size, joint, healthy), _unit(world.arm.n, joint)
    # Hung between a point on the base and a crank, at rest outside the stroke.
    rest = healthy.low[joint] - float(rng.uniform(0.1, 0.4))
    world.forces.append(lambda state: -rate * np.sin(state.q[joint] - rest) * own)
    return {"rate": rate, "rest": rest}


def _cable_spring(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    rate, own = 2.0 * _spring_rate(size, joint, healthy), _unit(world.arm.n, joint)
    slack = float(rng.uniform(0.3, 0.7) * (healthy.low[joint] + healthy.high[joint]))
    cubic = rate / (healthy.high[joint] - healthy.low[joint]) ** 2

    def pull(state: State) -> np.ndarray:
        away = state.q[joint] - slack
        return np.asarray(-(rate * away + cubic * away**3) * own)

    world.forces.append(pull)
    return {"k1": rate, "k3": cubic, "q0": slack}


def _saturation(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    world.torque_max = world.torque_max.copy()
    world.torque_max[joint] = healthy.torque[joint] / (1.0 + 0.25 * size)
    return {"limit": world.torque_max[joint]}


def _delay(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    world.delay[joint] += 0.008 * size
    return {"d": 0.008 * size}


def _deadband(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    world.deadband[joint] = size * max(4.0 * world.arm.count, 2e-3)
    return {"width": world.deadband[joint]}


def _wrist_coupling(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    world.coupling[joint] = 0.03 * size
    return {"c": -world.coupling[joint]}


def _contact(
    world: World, joint: int, size: float, rng: np.random.Generator, healthy: Healthy
) -> dict[str, float]:
    arm = world.arm
    height = float(np.quantile(healthy.heights, 0.2))
    stiffness = size * float(np.median(arm.kp)) / sum(arm.lengths) ** 2

    def push(state: State) -> np.ndarray:
        depth = max(height - state.tool[2], 0.0)
        return np.asarray(stiffness * depth * state.jacobian[2])

    world.forces.append(push)
    return {"k": stiffness, "z": height}


_SPRING_EFFECTS = ("gravity_spring", "cable_spring")
COMMANDED_EFFECTS = {
    "coulomb": CommandedEffect(_coulomb, ("coulomb",)),
    "viscous": CommandedEffect(_viscous, ("viscous",)),
    "stribeck": CommandedEffect(_stribeck, ("stribeck",)),
    "load_friction": CommandedEffect(_load_friction, ("load_friction",)),
    # Between motor and encoder, which reads the link.
    "backlash": CommandedEffect(_backlash, ("backlash", "output_backlash")),
    "rotor_inertia": CommandedEffect(_rotor_inertia, ("rotor_inertia",)),
    "payload": CommandedEffect(_payload, ("payload",), at_joint=False),
    "base_tilt": CommandedEffect(_base_tilt, ("base_tilt",), at_joint=False),
    "joint_zero": CommandedEffect(_joint_zero, ("joint_zero",), first=1),
    "gravity_spring": CommandedEffect(_gravity_spring, _SPRING_EFFECTS),
    "cable_spring": CommandedEffect(_cable_spring, _SPRING_EFFECTS),
    "saturation": CommandedEffect(_saturation, ("saturation",)),
    "time_delay": CommandedEffect(_delay, ("command_delay",)),
    "deadband": CommandedEffect(_deadband, ("deadband",)),
    "wrist_coupling": CommandedEffect(_wrist_coupling, ("wrist_coupling",), first=1),
    "external_contact": CommandedEffect(_contact, ("external_contact",), at_joint=False),
}
