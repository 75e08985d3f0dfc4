"""Compliance between motor and link: play, softening, lost preload, creep, hysteresis, gears."""

from __future__ import annotations

import numpy as np

from .effects import Outcome, effect, sign, spread
from .elasticity import Creep, Sliders
from .world import State, World


@effect("elastic")
def backlash(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A hard gap: nothing is transmitted inside it."""
    windup = world.windups[joint]
    width = 1.1 * severity * spread(rng) * windup.corners[0] / windup.slopes[0]
    windup.gap = width
    return Outcome(parameters={"width": width})


@effect("elastic")
def stiffness_linear(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    factor = 1.0 / (1.0 + 0.27 * severity * spread(rng))
    if rng.uniform() < 0.2:
        factor = 1.0 / factor
    world.windups[joint].factor *= factor
    return Outcome(parameters={"factor": factor})


@effect("elastic")
def k1_softening(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    windup = world.windups[joint]
    slope = 1.0 / (1.0 + 0.55 * severity * spread(rng))
    corner = 1.0 + 0.25 * severity * spread(rng)
    windup.slopes[0] *= slope
    windup.corners[0] = min(windup.corners[0] * corner, 0.95 * windup.corners[1])
    return Outcome(parameters={"k1_factor": slope, "t1_factor": corner})


@effect("elastic")
def preload_loss(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Two rough flanks pressed against each other, pressure exponential in their approach.

    The torque between them is the preload times twice a hyperbolic sine of the deflection, so
    that the deflection of the joint grows as its inverse; the healthy preload makes it the nominal
    contact stiffness.
    """
    windup = world.windups[joint]
    healthy = 0.5 * world.robot.torque_max[joint]
    left = healthy * max(0.5 ** (severity * spread(rng)), 0.02)
    length = 2.0 * healthy / windup.contact
    loose, tight = 2.0 * left, 1.0 / windup.contact

    def more(torque: np.ndarray) -> np.ndarray:
        return np.asarray(length * np.arcsinh(torque / loose) - torque * tight)

    def bounded(torque: np.ndarray) -> np.ndarray:
        # A torque far beyond the preload presses the flanks as hard as when they were tight.
        extra = np.abs(more(np.abs(torque)))
        peak = loose * np.sqrt(max((healthy / left) ** 2 - 1.0, 0.0))
        held = float(more(np.array(peak)))
        return np.asarray(np.sign(torque) * np.where(np.abs(torque) < peak, extra, held))

    windup.series.append(bounded)
    return Outcome(
        law={
            "preload_torque": left,
            "healthy_preload_torque": healthy,
            "added_windup_at_rated": float(bounded(np.array(world.robot.torque_rated[joint]))),
        }
    )


@effect("elastic")
def belt_creep(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A belt in series: half of it gives at once, half after two relaxation times."""
    rated = world.robot.torque_rated[joint]
    compliance = 0.3 * severity * spread(rng) * world.windup_at(joint, rated) / rated
    time = rng.uniform(0.1, 0.4)
    world.windups[joint].series.append(lambda torque: 0.5 * compliance * torque)
    world.creeps.append(Creep(joint, 0.5 * compliance, time, world.step))
    return Outcome(parameters={"C": compliance, "tau_r": time})


@effect("elastic")
def hysteresis(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    windup = world.windups[joint]
    height = 0.035 * severity * spread(rng) * world.robot.torque_rated[joint]
    reach = rng.uniform(0.3, 0.6) * windup.corners[0] / windup.slopes[0]
    world.sliders.append(Sliders(joint, height, reach))
    return Outcome(parameters={"h": height}, law={"reach": reach})


class _Waves:
    """Angle error of a gear, periodic in its input; power goes through undiminished."""

    def __init__(self, joint: int, ratio: float, size: np.ndarray, phase: np.ndarray) -> None:
        self._joint, self._size, self._phase = joint, size, phase
        self._orders = np.array([1, 2, 3, 4]) * ratio

    def _angle(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        angle = state.motor[:, self._joint, None] * self._orders + self._phase
        # What passes within one integration step averages out.
        turned = self._orders * state.motor_velocity[:, self._joint, None] * state.step
        return angle, np.sinc(turned / (2 * np.pi))

    def shift(self, state: State, end: np.ndarray) -> None:
        angle, seen = self._angle(state)
        end[:, self._joint] += (self._size * seen * np.sin(angle)).sum(axis=1)

    def back(self, state: State, spring: np.ndarray, torque: np.ndarray) -> None:
        angle, seen = self._angle(state)
        slope = (self._size * seen * self._orders * np.cos(angle)).sum(axis=1)
        torque[:, self._joint] += spring[:, self._joint] * slope


@effect("periodic")
def transmission_error(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    main = 1.25e-4 * severity * spread(rng)
    size = main * np.array([rng.uniform(0.15, 0.3), 1.0, 0.06, rng.uniform(0.2, 0.35)])
    phase = rng.uniform(-np.pi, np.pi, 4)
    world.gears.append(_Waves(joint, float(world.robot.gear_ratio[joint]), size, phase))
    return Outcome(parameters={"A1": size[0], "A2": size[1], "A4": size[3]}, law={"A3": size[2]})


class _Coupled:
    """A joint that the one before it turns along."""

    def __init__(self, joint: int, share: float) -> None:
        self._joint, self._share = joint, share

    def shift(self, state: State, end: np.ndarray) -> None:
        end[:, self._joint] += self._share * state.motor[:, self._joint - 1]

    def back(self, state: State, spring: np.ndarray, torque: np.ndarray) -> None:
        torque[:, self._joint - 1] += self._share * spring[:, self._joint]


@effect("elastic")
def wrist_coupling(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    if joint == 0:
        raise ValueError("wrist_coupling names the driven joint, which has one before it")
    # Encoders on the links see a thousandth of a turn; without them only its torque shows.
    size = 6e-4 if world.spec.link_encoders else 0.025
    share = sign(rng) * size * severity * spread(rng)
    world.gears.append(_Coupled(joint, share))
    return Outcome(parameters={"c": share})
