"""Physics of no catalogue: what a tool should say that it does not know."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.signal import lfilter

from .effects import Outcome, effect, sign, spread
from .world import Signals, State, World


@effect("outside", outside=True)
def pulsing_load(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A pump on the link: a load periodic in time, not in angle, with a sharp stroke."""
    size = 0.05 * severity * spread(rng) * world.robot.torque_rated[joint]
    frequency = rng.uniform(1.1, 3.4)
    begin = rng.uniform(0.0, 1.0, world.runs)

    def load(state: State, torque: np.ndarray) -> None:
        cycle = (state.time * frequency + begin) % 1.0
        torque[:, joint] += size * np.where(cycle < 0.3, np.sin(np.pi * cycle / 0.3) ** 2, 0.0)

    world.link_loads.append(load)
    return Outcome(law={"torque": size, "frequency": frequency})


@effect("outside", outside=True)
def neighbour_friction(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """A hose pinched by another joint: dry friction here that depends on the angle there."""
    others = [j for j in range(world.robot.joints) if j != joint]
    other = int(rng.choice([j for j in others if abs(j - joint) <= 2]))
    height = 0.7 * severity * spread(rng) * world.robot.coulomb[joint]
    centre, way = world.robot.centre[other], sign(rng)

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        bend = np.maximum(way * (state.link[:, other] - centre), 0.0)
        more = height * bend**2 / (0.15 + bend**2)
        up[:, joint] += more
        down[:, joint] += more

    world.friction.append(law)
    return Outcome(law={"level": height, "other_joint": other + 1, "way": way})


@effect("outside", outside=True)
def slosh(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Something loose in the link: a lightly damped mass that swings behind its acceleration."""
    data = world.model.createData()
    felt = float(pin.crba(world.model, data, world.robot.centre)[joint, joint])
    felt += float(world.robot.rotor_inertia[joint])
    inertia = 0.05 * severity * spread(rng) * felt
    frequency = 2 * np.pi * rng.uniform(3.0, 6.0)
    stiffness, damping = inertia * frequency**2, 2 * 0.03 * inertia * frequency
    angle: list[np.ndarray] = []
    rate = np.zeros(world.runs)

    def load(state: State, torque: np.ndarray) -> None:
        if state.step == 0.0:  # at rest it hangs along
            return
        here, moving = state.link[:, joint], state.link_velocity[:, joint]
        if not angle:
            angle.append(here.copy())
        pull = stiffness * (angle[0] - here) + damping * (rate - moving)
        torque[:, joint] += pull
        rate[...] -= state.step * pull / inertia
        angle[0] = angle[0] + state.step * rate

    world.link_loads.append(load)
    return Outcome(law={"inertia": inertia, "frequency": frequency / (2 * np.pi)})


@effect("outside", outside=True)
def torque_sensor_drift(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """The reading wanders as humidity does: a slow random walk that is pulled back to zero."""
    size = 0.03 * severity * spread(rng) * world.robot.torque_rated[joint]
    memory = rng.uniform(1.0, 2.5)
    draw = np.random.default_rng(rng.integers(2**63))

    def read(signals: Signals) -> None:
        runs, steps = signals.torque.shape[:2]
        keep = np.exp(-signals.step / memory)
        kick = size * np.sqrt(1.0 - keep**2) * draw.standard_normal((runs, steps))
        kick[:, 0] = size * draw.standard_normal(runs)
        walk = lfilter([1.0], [1.0, -keep], kick, axis=1)
        signals.torque[:, :, joint] += walk

    world.sensors.append(read)
    return Outcome(law={"size": size, "memory": memory})


@effect("outside", outside=True)
def slew_limit(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The amplifier cannot change its torque fast; the recording holds what was asked."""
    asked = world.nominal_torque[world.training, :, joint]
    rate = np.abs(np.diff(asked, axis=1)) * world.spec.rate
    most = float(np.quantile(rate, 0.997)) * spread(rng) / (0.85 + 0.15 * severity)
    held: list[np.ndarray] = []

    def drive(command: np.ndarray, step: float) -> np.ndarray:
        given = command.copy()
        if held:
            before = held[0]
            given[:, joint] = before + np.clip(
                command[:, joint] - before, -most * step, most * step
            )
            held[0] = given[:, joint].copy()
        else:
            held.append(given[:, joint].copy())
        return given

    world.drive.append(drive)
    return Outcome(law={"rate": most})


@effect("outside", outside=True)
def dragging_brake(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A brake that does not open fully, for a while, at times that nothing announces."""
    level = 0.8 * severity * spread(rng) * world.robot.coulomb[joint]
    length = 0.25 * world.spec.seconds
    begin = rng.uniform(0.1, 0.65, world.runs) * world.spec.seconds
    dragging = rng.uniform(size=world.runs) < 0.75

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        now = dragging & (state.time > begin) & (state.time < begin + length)
        up[:, joint] += level * now
        down[:, joint] += level * now

    world.friction.append(law)
    return Outcome(law={"level": level, "begin": begin.tolist(), "length": length})
