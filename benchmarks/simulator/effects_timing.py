"""What changes with time: clocks of the recording, warming motors and gears; drag and rubbing."""

from __future__ import annotations

import numpy as np

from .effects import Outcome, effect, sign, spread
from .world import Signals, State, World


def resampled(values: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Values (runs, steps, n) of a number of steps ago at every step, on a straight line."""
    count = values.shape[1]
    place = np.clip(np.arange(count) - steps, 0.0, count - 1.0)
    before = np.minimum(place.astype(int), count - 2)
    part = (place - before)[:, None]
    return np.asarray((1.0 - part) * values[:, before] + part * values[:, before + 1])


@effect("sensor", "robot")
def clock_drift(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The torques have a clock of their own, which runs fast or slow."""
    rate = sign(rng) * 1.5e-3 * severity * spread(rng)

    def read(signals: Signals) -> None:
        steps = rate * np.arange(signals.torque.shape[1])
        signals.torque[...] = resampled(signals.torque, steps)

    world.sensors.append(read)
    return Outcome(parameters={"e": rate})


@effect("sensor", "recording")
def run_clock(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The torques of one recording were started on another clock."""
    delay = sign(rng) * 8e-3 * severity * spread(rng)
    run = int(rng.choice(world.training))

    def read(signals: Signals) -> None:
        own = signals.torque[run : run + 1]
        steps = np.full(own.shape[1], delay / signals.step)
        signals.torque[run] = resampled(own, steps)[0]

    world.sensors.append(read)
    return Outcome(parameters={"d": delay}, run=world.plans[run].name)


def _factors_of_runs(world: World, severity: float, rng: np.random.Generator) -> np.ndarray:
    """Factors of the torque reading that fall from training run to training run, with scatter."""
    rate = 0.015 * severity * spread(rng) * sign(rng)
    place = np.zeros(world.runs)
    place[world.training] = np.arange(len(world.training))
    place[world.training] -= place[world.training].mean()
    scatter = 0.5 * rate * rng.standard_normal(world.runs)
    return np.exp(rate * place + scatter)


@effect("sensor", "robot")
def common_gain_drift(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """All motors warm from run to run, and give another torque a current."""
    factors = _factors_of_runs(world, severity, rng)

    def read(signals: Signals) -> None:
        signals.torque[...] *= factors[:, None, None]

    world.sensors.append(read)
    return Outcome(law={"factors": factors.tolist()})


@effect("sensor")
def gain_drift(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """One motor warms from run to run."""
    factors = _factors_of_runs(world, severity, rng)

    def read(signals: Signals) -> None:
        signals.torque[:, :, joint] *= factors[:, None]

    world.sensors.append(read)
    return Outcome(law={"factors": factors.tolist()})


def _settled(elapsed: np.ndarray | float, world: World, half: float) -> np.ndarray:
    """Share of a warm-up at a time, 1 at the end of a run; a rational function of time."""
    whole = world.spec.seconds
    return np.asarray(elapsed * (half + whole) / (whole * (half + elapsed)))


@effect("sensor")
def gain_warmup(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The winding warms within each run."""
    change = sign(rng) * 0.05 * severity * spread(rng)
    half = rng.uniform(2.0, 10.0)

    def read(signals: Signals) -> None:
        elapsed = signals.step * np.arange(signals.torque.shape[1])
        signals.torque[:, :, joint] *= 1.0 + change * _settled(elapsed, world, half)

    world.sensors.append(read)
    return Outcome(parameters={"eps": change}, law={"half": half})


@effect("friction")
def friction_warmup(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Grease that is cold at the begin of each run, or a seal that seizes."""
    side = sign(rng)
    dry = side * 0.5 * severity * spread(rng) * world.robot.coulomb[joint]
    wet = side * 0.5 * severity * spread(rng) * world.robot.viscous[joint]
    # Friction that falls leaves a fifth.
    dry = max(dry, -0.8 * world.robot.coulomb[joint])
    wet = max(wet, -0.8 * world.robot.viscous[joint])
    half = rng.uniform(2.0, 10.0)

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        share = float(_settled(state.time, world, half))
        more = share * (dry + wet * np.abs(state.motor_velocity[:, joint]))
        up[:, joint] += more
        down[:, joint] += more

    world.friction.append(law)
    return Outcome(parameters={"dFc": dry, "dFv": wet}, law={"half": half})


@effect("friction")
def stroke_friction(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Something rubs from one angle on, up to the end of the stroke."""
    height = 0.6 * severity * spread(rng) * world.robot.coulomb[joint]
    train = np.concatenate([world.reference[r, :, joint] for r in world.training])
    place = float(np.quantile(train, rng.uniform(0.35, 0.65)))
    beyond = sign(rng)

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        inside = np.clip(beyond * (state.link[:, joint] - place) / 0.03 + 0.5, 0.0, 1.0)
        up[:, joint] += height * inside
        down[:, joint] += height * inside

    world.friction.append(law)
    return Outcome(parameters={"A": height}, law={"place": place, "beyond": beyond})


@effect("friction")
def quadratic_drag(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Churned oil: drag with the square of speed."""
    fastest = float(np.abs(np.diff(world.reference[world.training, :, joint], axis=1)).max())
    fastest /= world.step
    drag = 0.8 * severity * spread(rng) * world.robot.viscous[joint] / fastest

    def load(state: State, torque: np.ndarray) -> None:
        speed = state.motor_velocity[:, joint]
        torque[:, joint] += drag * np.abs(speed) * speed

    world.motor_loads.append(load)
    return Outcome(parameters={"D": drag})
