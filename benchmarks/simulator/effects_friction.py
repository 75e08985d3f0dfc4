"""Friction of the motor side: levels of a set-valued dry friction, and drag."""

from __future__ import annotations

import numpy as np

from .effects import Outcome, effect, sign, spread
from .world import IDENTIFIED_AT, State, World


@effect("friction")
def coulomb(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    level = world.robot.coulomb[joint]
    change = sign(rng, 0.75) * 0.35 * severity * spread(rng) * level
    change = max(change, -0.8 * level)
    world.coulomb[joint] += change
    return Outcome(parameters={"dFc": change})


@effect("friction")
def viscous(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    nominal = world.robot.viscous[joint]
    change = sign(rng, 0.75) * 0.45 * severity * spread(rng) * nominal
    change = max(change, -0.8 * nominal)
    world.viscous[joint] += change
    return Outcome(parameters={"dFv": change})


@effect("friction", drawn=False)
def viscous_power(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Viscous friction by a power of the speed that is not one, as greases have it."""
    power = 1.0 + sign(rng) * rng.uniform(0.3, 0.4)
    change = 0.8 * severity * spread(rng) * world.robot.viscous[joint]

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        more = change * np.abs(state.motor_velocity[:, joint]) ** power
        up[:, joint] += more
        down[:, joint] += more

    world.friction.append(law)
    return Outcome(law={"power": power, "change": change})


@effect("friction")
def stribeck(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """More friction near standstill, falling as a rational function of speed."""
    height = 0.6 * severity * spread(rng) * world.robot.coulomb[joint]
    speed = rng.uniform(0.05, 0.12)

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        more = height / (1.0 + (state.motor_velocity[:, joint] / speed) ** 2)
        up[:, joint] += more
        down[:, joint] += more

    world.friction.append(law)
    return Outcome(law={"height": height, "half_speed": speed})


@effect("friction")
def load_friction(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    slope = 0.1 * severity * spread(rng)
    knee = 0.04 * world.robot.torque_rated[joint]

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        more = slope * (np.sqrt(state.spring[:, joint] ** 2 + knee**2) - knee)
        up[:, joint] += more
        down[:, joint] += more

    world.friction.append(law)
    return Outcome(parameters={"mu": slope}, law={"knee": knee})


@effect("friction")
def asym_friction(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    side = sign(rng)
    dry = side * 0.22 * severity * spread(rng) * world.robot.coulomb[joint]
    wet = side * 0.22 * severity * spread(rng) * world.robot.viscous[joint]

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        difference = dry + wet * np.abs(state.motor_velocity[:, joint])
        up[:, joint] += difference
        down[:, joint] -= difference

    world.friction.append(law)
    return Outcome(parameters={"dFc": dry, "dFv": wet})


@effect("friction")
def position_friction(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """A tight place: a raised cosine of the angle."""
    height = 0.9 * severity * spread(rng) * world.robot.coulomb[joint]
    # Where the joint comes by: between the quartiles of its angle in the training recordings.
    train = np.concatenate([world.reference[r, :, joint] for r in world.training])
    place = float(np.quantile(train, rng.uniform(0.3, 0.7)))
    # Narrower than a short stroke, as of a slider in metres.
    half = rng.uniform(0.25, 0.45) * min(float(np.ptp(train)), 1.0)

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        away = np.clip((state.link[:, joint] - place) / half, -1.0, 1.0)
        more = height * np.cos(np.pi / 2 * away) ** 2
        up[:, joint] += more
        down[:, joint] += more

    world.friction.append(law)
    return Outcome(parameters={"A": height, "q0": place}, law={"half_width": half})


@effect("friction")
def thermal_friction(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """Oil that thins with temperature as Andrade's law says: exponential in 1/T."""
    share = 0.02 * severity * spread(rng)
    absolute = IDENTIFIED_AT + 273.15
    energy = share * absolute**2  # [K]

    def load(state: State, torque: np.ndarray) -> None:
        inverse = 1.0 / (state.temperature[:, joint] + 273.15) - 1.0 / absolute
        change = np.expm1(energy * inverse)
        torque[:, joint] += world.viscous[joint] * change * state.motor_velocity[:, joint]

    world.motor_loads.append(load)
    return Outcome(parameters={"b": share}, law={"activation": energy})


@effect("friction")
def lubricated_friction(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """A film of oil: the teeth touch through it where speed and viscosity are low.

    The share of load and preload that is carried by touching teeth is a rational function of speed
    times viscosity, which falls with temperature as Andrade's law says.
    """
    slope = 0.04 * severity * spread(rng)
    touching = 0.12 * severity * spread(rng)
    warm = 0.02 * severity * spread(rng) * world.robot.coulomb[joint]  # [N m/K]
    speed = rng.uniform(0.06, 0.12)
    knee = 0.03 * world.robot.torque_rated[joint]
    share, absolute = 0.02 * severity * spread(rng), IDENTIFIED_AT + 273.15

    def viscosity(state: State) -> np.ndarray:
        kelvin = state.temperature[:, joint] + 273.15
        return np.asarray(np.exp(share * absolute**2 * (1.0 / kelvin - 1.0 / absolute)))

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        film = np.abs(state.motor_velocity[:, joint]) * viscosity(state) / speed
        touch = 1.0 / (1.0 + film**1.6)
        load = np.sqrt(state.spring[:, joint] ** 2 + knee**2) - knee
        rise = state.temperature[:, joint] - IDENTIFIED_AT
        more = slope * load + (touching * load + warm * rise) * touch
        up[:, joint] += more
        down[:, joint] += more

    def load(state: State, torque: np.ndarray) -> None:
        change = viscosity(state) - 1.0
        torque[:, joint] += world.viscous[joint] * change * state.motor_velocity[:, joint]

    world.friction.append(law)
    world.motor_loads.append(load)
    return Outcome(law={"slope": slope, "touching": touching, "warm": float(warm), "speed": speed})


@effect("friction")
def friction_drift(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Friction that is another on every day: a factor on all of it, log-normal from run to run."""
    level = world.robot.coulomb[joint]
    days = 0.15 * severity * spread(rng) * rng.standard_normal(world.runs)
    factor = np.expm1(days)

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        up[:, joint] += factor * level
        down[:, joint] += factor * level

    def load(state: State, torque: np.ndarray) -> None:
        torque[:, joint] += factor * world.viscous[joint] * state.motor_velocity[:, joint]

    world.friction.append(law)
    world.motor_loads.append(load)
    return Outcome(law={"of_runs": (factor * level).tolist()})
