"""Drives and sensors: what is given is not what was asked, what is read not what is."""

from __future__ import annotations

import numpy as np

from .effects import Outcome, effect, sign, spread
from .world import Signals, State, World


@effect("periodic")
def torque_ripple(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Magnets and current sensors: torque at once and six times the electrical angle."""
    rated = world.robot.torque_rated[joint]
    size = severity * rated * np.array([0.02 * spread(rng), 0.011 * spread(rng), 0.0008])
    orders = np.array([1, 6, 12]) * world.robot.pole_pairs * world.robot.gear_ratio[joint]
    phase = rng.uniform(-np.pi, np.pi, 3)

    def load(state: State, torque: np.ndarray) -> None:
        angle = state.motor[:, joint, None] * orders + phase
        turned = orders * state.motor_velocity[:, joint, None] * state.step
        torque[:, joint] += (size * np.sinc(turned / (2 * np.pi)) * np.sin(angle)).sum(axis=1)

    world.motor_loads.append(load)
    return Outcome(parameters={"B1": size[0], "B6": size[1]}, law={"B12": size[2]})


@effect("sensor")
def torque_gain(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The drive believes in more or less torque a current than the motor gives."""
    share = sign(rng) * 0.05 * severity * spread(rng)
    world.torque_constant[joint] /= 1.0 + share
    return Outcome(parameters={"eps": share})


@effect("sensor")
def torque_offset(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    off = sign(rng) * 0.02 * severity * spread(rng) * world.robot.torque_rated[joint]

    def read(signals: Signals) -> None:
        signals.torque[:, :, joint] += off

    world.sensors.append(read)
    return Outcome(parameters={"off": off})


@effect("sensor")
def encoder_offset(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    off = sign(rng) * 1.2e-4 * severity * spread(rng)
    world.link_zero[joint] += off
    return Outcome(parameters={"off": off})


@effect("sensor")
def crosstalk(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A share of another drive's current is read in this channel."""
    others = [other for other in range(world.robot.joints) if other != joint]
    source = int(rng.choice(others))
    share = sign(rng) * 0.05 * severity * spread(rng)

    def read(signals: Signals) -> None:
        signals.torque[:, :, joint] += share * signals.torque[:, :, source]

    world.sensors.append(read)
    return Outcome(parameters={"c": share, "from_joint": source + 1.0})


@effect("sensor", "run")
def encoder_zero_change(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """A link encoder that slipped for one recording, and was set right again."""
    off = sign(rng) * 1.5e-4 * severity * spread(rng)
    run = int(rng.choice(world.training))

    def read(signals: Signals) -> None:
        signals.link[run, :, joint] += off

    world.sensors.append(read)
    return Outcome(parameters={"off": off}, run=world.plans[run].name)


def _late(values: np.ndarray, steps: float) -> np.ndarray:
    """Values of a number of steps ago, or ahead, between the steps on a straight line."""
    whole = int(np.floor(steps))
    index = np.arange(values.shape[1])
    before = values[:, np.clip(index - whole, 0, len(index) - 1)]
    earlier = values[:, np.clip(index - whole - 1, 0, len(index) - 1)]
    return np.asarray(before + (steps - whole) * (earlier - before))


@effect("sensor", "robot")
def time_delay(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The torque of all joints arrives late in the recording, or is the command, and early."""
    delay = 4e-3 * severity * spread(rng) * sign(rng)

    def read(signals: Signals) -> None:
        signals.torque[...] = _late(signals.torque, delay / signals.step)

    world.sensors.append(read)
    return Outcome(parameters={"d": delay})


@effect("sensor")
def joint_delay(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The torque of one joint passes a filter or a bus of its own."""
    delay = 8e-3 * severity * spread(rng) * sign(rng)

    def read(signals: Signals) -> None:
        late = _late(signals.torque[:, :, [joint]], delay / signals.step)
        signals.torque[:, :, joint] = late[:, :, 0]

    world.sensors.append(read)
    return Outcome(parameters={"d": delay})


@effect("sensor", "robot", drawn=False)
def reading_filter(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The torques of all joints pass a filter of first order before they are recorded."""
    constant = 8e-3 * severity * spread(rng)

    def read(signals: Signals) -> None:
        # Torques are straight lines between the samples.
        kept = np.exp(-signals.step / constant)
        late = constant / signals.step * (1.0 - kept)
        filtered = signals.torque.copy()
        for k in range(1, filtered.shape[1]):
            before, now = signals.torque[:, k - 1], signals.torque[:, k]
            filtered[:, k] = kept * filtered[:, k - 1] + (1.0 - late) * now + (late - kept) * before
        signals.torque[...] = filtered

    world.sensors.append(read)
    return Outcome(parameters={"T": constant})


@effect("sensor", "robot")
def encoder_skew(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """What the link encoders say is older than its time stamp."""
    delay = 3e-4 * severity * spread(rng)

    def read(signals: Signals) -> None:
        signals.link[...] = _late(signals.link, delay / signals.step)

    world.sensors.append(read)
    return Outcome(parameters={"d": delay})


@effect("drive")
def saturation(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The amplifier gives no more than a limit, with a knee; the recording holds what was asked."""
    # Just under what the training motions need for a hundredth of the time.
    need = np.abs(world.nominal_torque[world.training, :, joint])
    share = min(0.01 * severity * spread(rng), 0.2)
    limit, knee = float(np.quantile(need, 1.0 - share)), 14.0

    def drive(asked: np.ndarray, step: float) -> np.ndarray:
        given = asked.copy()
        size = (np.abs(asked[:, joint]) / limit) ** knee
        given[:, joint] = asked[:, joint] / (1.0 + size) ** (1.0 / knee)
        return given

    world.drive.append(drive)
    return Outcome(parameters={"limit": limit}, law={"knee": knee})


@effect("sensor")
def reading_limit(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The reading of the torque ends below what the training motions need for a while."""
    need = np.abs(world.nominal_torque[world.training, :, joint])
    limit = float(np.quantile(need, 1.0 - min(0.02 * severity * spread(rng), 0.2)))

    def read(signals: Signals) -> None:
        signals.torque[:, :, joint] = np.clip(signals.torque[:, :, joint], -limit, limit)

    world.sensors.append(read)
    return Outcome(parameters={"limit": limit})
