"""Laws that no catalogue has, of forms chosen for themselves: none of them is drawn in sealed cases
of the catalogue.

What each depends on is in its law as `signals`, in the words of the tool's answers: q, w, a, T of a
joint, dT (temperature), t_on (time since power-on), z (height of the tool).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .effects import Outcome, effect, sign, spread
from .world import IDENTIFIED_AT, Signals, State, World


def _outcome(world: World, signals: list[str], **law: float) -> Outcome:
    return Outcome(law={"signals": signals, **law})


def _other(world: World, joint: int, rng: np.random.Generator) -> int:
    others = [j for j in range(world.robot.joints) if j != joint]
    return int(rng.choice([j for j in others if abs(j - joint) <= 2]))


def _session(world: World) -> np.ndarray:
    return np.array([plan.session_time for plan in world.plans])


@effect("law", outside=True, drawn=False)
def dragging_bundle(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A cable bundle that rubs more the further it is bent: drag by speed and angle."""
    centre, reach = world.robot.centre[joint], world.robot.reach[joint]
    size = 1.5 * severity * spread(rng) * world.robot.viscous[joint]
    way = sign(rng)

    def load(state: State, torque: np.ndarray) -> None:
        bent = np.maximum(way * (state.motor[:, joint] - centre) / reach + 0.4, 0.0)
        torque[:, joint] += size * state.motor_velocity[:, joint] * bent**1.5

    world.motor_loads.append(load)
    return _outcome(world, [f"w_{joint + 1}", f"q_{joint + 1}"], size=size)


@effect("law", outside=True, drawn=False)
def thinning_drag(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Drag that rises with speed and falls again."""
    peak = 0.35 * severity * spread(rng) * world.robot.coulomb[joint]
    speed = rng.uniform(0.2, 0.4) * world.robot.speed_max[joint]

    def load(state: State, torque: np.ndarray) -> None:
        r = state.motor_velocity[:, joint] / speed
        torque[:, joint] += peak * r * np.exp(1.0 - np.abs(r))

    world.motor_loads.append(load)
    return _outcome(world, [f"w_{joint + 1}"], peak=peak, speed=speed)


@effect("law", outside=True, drawn=False)
def pulling_hose(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A hose from another link: torque here by the angle there."""
    other = _other(world, joint, rng)
    size = 0.06 * severity * spread(rng) * world.robot.torque_rated[joint]
    centre, reach = world.robot.centre[other], world.robot.reach[other]

    def load(state: State, torque: np.ndarray) -> None:
        u = 2.0 * (state.link[:, other] - centre) / reach
        torque[:, joint] += size * u / np.sqrt(1.0 + u**2)

    world.link_loads.append(load)
    return _outcome(world, [f"q_{other + 1}"], size=size)


@effect("law", outside=True, drawn=False)
def clocked_pump(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A pump that has run since power-on, at its own pace."""
    size = 0.04 * severity * spread(rng) * world.robot.torque_rated[joint]
    frequency, begin = rng.uniform(0.7, 3.0), _session(world)

    def load(state: State, torque: np.ndarray) -> None:
        turn = 2.0 * np.pi * frequency * (state.time + begin)
        torque[:, joint] += size * (np.sin(turn) + 0.15 * np.sin(2.0 * turn))

    world.link_loads.append(load)
    return _outcome(world, ["t_on"], size=size, frequency=frequency)


@effect("law", outside=True, drawn=False)
def trapped_liquid(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Liquid in the link that is taken along late."""
    size = 1.2 * severity * spread(rng) * world.robot.viscous[joint]
    memory = rng.uniform(0.15, 0.6)
    flow = np.zeros(world.runs)

    def load(state: State, torque: np.ndarray) -> None:
        slip = state.link_velocity[:, joint] - flow
        torque[:, joint] -= size * slip
        flow[...] += state.step * slip / memory

    world.link_loads.append(load)
    return _outcome(world, [f"w_{joint + 1}"], size=size, memory=memory)


@effect("law", outside=True, drawn=False)
def loose_weight(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A weight within the link on a spring that stiffens: it rings after every start and stop."""
    size = 1.5 * severity * spread(rng) * world.rotor_inertia[joint]
    pull = (2.0 * np.pi * rng.uniform(1.2, 5.0)) ** 2
    drag = 2.0 * rng.uniform(0.03, 0.2) * np.sqrt(pull)
    stiffens = 4.0  # [1/rad^2]
    place: list[np.ndarray] = []
    speed = np.zeros(world.runs)

    def load(state: State, torque: np.ndarray) -> None:
        if state.step == 0.0:  # at rest it hangs along
            return
        here = state.link[:, joint]
        if not place:
            place.append(here.copy())
        bent = here - place[0]
        push = pull * bent * (1.0 + stiffens * bent**2) + drag * (
            state.link_velocity[:, joint] - speed
        )
        torque[:, joint] -= size * push
        speed[...] += state.step * push
        place[0] += state.step * speed

    world.link_loads.append(load)
    return _outcome(world, [f"a_{joint + 1}"], size=size, pull=pull, drag=drag)


@effect("law", outside=True, drawn=False)
def loose_encoder(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The encoder of the link stands on a bracket that shakes with the link's acceleration."""
    pull = (2.0 * np.pi * rng.uniform(1.5, 5.0)) ** 2
    drag = 2.0 * rng.uniform(0.05, 0.2) * np.sqrt(pull)
    size = 0.02 * severity * spread(rng)
    bent, rate, before = np.zeros((3, world.runs))
    recorded: list[np.ndarray] = []

    def shake(state: State, _: np.ndarray) -> None:
        if state.step == 0.0:
            return
        speed = state.link_velocity[:, joint]
        rate[...] -= state.step * (pull * bent + drag * rate) + speed - before
        bent[...] += state.step * rate
        before[...] = speed
        if state.time > -0.5 * state.step:
            recorded.append(size * bent)

    def read(signals: Signals) -> None:
        signals.link[:, :, joint] += np.stack(recorded, axis=1)

    world.link_loads.append(shake)  # from rest on, before the recording begins
    world.sensors.append(read)
    return _outcome(world, [f"a_{joint + 1}"], size=size, pull=pull, drag=drag)


class _WarmSpring:
    """A spring that yields more the warmer it is."""

    def __init__(self, joint: int, compliance: float) -> None:
        self._joint, self._compliance = joint, compliance

    def shift(self, state: State, end: np.ndarray) -> None:
        j = self._joint
        warmth = state.temperature[:, j] - IDENTIFIED_AT
        end[:, j] -= self._compliance * warmth * state.spring[:, j]

    def back(self, state: State, spring: np.ndarray, torque: np.ndarray) -> None:
        """Nothing: the motor sees the spring's torque."""


@effect("law", outside=True, drawn=False)
def softening_by_heat(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """Stiffness that falls with the temperature."""
    rated = world.robot.torque_rated[joint]
    compliance = 0.01 * severity * spread(rng) * world.windup_at(joint, rated) / rated
    world.gears.append(_WarmSpring(joint, compliance))
    return _outcome(world, [f"T_{joint + 1}", f"dT_{joint + 1}"], compliance=compliance)


@effect("law", outside=True, drawn=False)
def odd_ripple(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Ripple of the joint's angle at an order that is of no gear."""
    size = 0.04 * severity * spread(rng) * world.robot.torque_rated[joint]
    order, phase = rng.uniform(4.0, 20.0), rng.uniform(-np.pi, np.pi)

    def load(state: State, torque: np.ndarray) -> None:
        torque[:, joint] += size * np.sin(order * state.motor[:, joint] + phase)

    world.motor_loads.append(load)
    return _outcome(world, [f"q_{joint + 1}"], size=size, order=order)


@effect("law", outside=True, drawn=False)
def balancing_rope(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A rope from the ceiling to this link that tightens as the tool goes down."""
    model, data = world.model, world.model.createData()
    tool = model.getFrameId("tool0")
    size = 0.15 * severity * spread(rng) * world.robot.torque_rated[joint]
    middle = world.robot.centre
    pin.framesForwardKinematics(model, data, middle)
    level = float(data.oMf[tool].translation[2]) + rng.uniform(-0.05, 0.1)
    length = 0.25 * float(sum(np.linalg.norm(body.origin) for body in world.robot.bodies))

    def load(state: State, torque: np.ndarray) -> None:
        for r, q in enumerate(state.link):
            pin.framesForwardKinematics(model, data, q)
            low = level - float(data.oMf[tool].translation[2])
            torque[r, joint] += size * max(low, 0.0) / length

    world.link_loads.append(load)
    return _outcome(world, ["z"], size=size, level=level)


@effect("law", outside=True, drawn=False)
def rattling_weight(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A weight that is thrown from stop to stop: torque by the sign of the acceleration."""
    size = 0.05 * severity * spread(rng) * world.robot.torque_rated[joint]
    asked = np.diff(world.reference[:, :, joint], 2, axis=1) / world.step**2
    small = 0.08 * float(np.abs(asked).max())
    begin: list[float] = []  # before the recording

    def load(state: State, torque: np.ndarray) -> None:
        if not begin:
            begin.append(state.time)
        step = round((state.time - begin[0]) / world.step)
        thrown = asked[:, min(step, asked.shape[1] - 1)]
        torque[:, joint] += size * thrown / np.sqrt(thrown**2 + small**2)

    world.motor_loads.append(load)
    return _outcome(world, [f"a_{joint + 1}"], size=size)


@effect("law", outside=True, drawn=False)
def leaning_cover(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A cover that leans on the link from one angle on: a step of torque."""
    size = 0.05 * severity * spread(rng) * world.robot.torque_rated[joint]
    centre, reach = world.robot.centre[joint], world.robot.reach[joint]
    place = centre + rng.uniform(-0.5, 0.5) * reach

    def load(state: State, torque: np.ndarray) -> None:
        past = np.clip((state.link[:, joint] - place) / (0.04 * reach), -1.0, 1.0)
        torque[:, joint] += size * (0.5 + 0.75 * past - 0.25 * past**3)

    world.link_loads.append(load)
    return _outcome(world, [f"q_{joint + 1}"], size=size, place=place)


@effect("law", outside=True, drawn=False)
def three_joint_hose(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """A hose over three joints: torque here by the angle of one times the speed of another."""
    others = [j for j in range(world.robot.joints) if j != joint]
    first, second = (int(j) for j in rng.permutation(others)[:2])
    size = 0.08 * severity * spread(rng) * world.robot.torque_rated[joint]
    centre, reach = world.robot.centre[first], world.robot.reach[first]
    fast = world.robot.speed_max[second]

    def load(state: State, torque: np.ndarray) -> None:
        bent = (state.link[:, first] - centre) / reach
        torque[:, joint] += size * bent * state.link_velocity[:, second] / (0.3 * fast)

    world.link_loads.append(load)
    return _outcome(world, [f"q_{first + 1}", f"w_{second + 1}"], size=size)


@effect("law", outside=True, drawn=False)
def shared_bearing(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Dry friction here by the load of another joint, which its bearing carries too."""
    other = _other(world, joint, rng)
    slope = 0.5 * severity * spread(rng) * world.robot.coulomb[joint]
    rated = 0.5 * world.robot.torque_rated[other]

    def law(state: State, up: np.ndarray, down: np.ndarray) -> None:
        more = slope * np.abs(state.spring[:, other]) / rated
        up[:, joint] += more
        down[:, joint] += more

    world.friction.append(law)
    return _outcome(world, [f"w_{joint + 1}", f"T_{other + 1}"], slope=slope)


@effect("law", outside=True, drawn=False)
def sticking_seal(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A seal that is bent before it slides."""
    size = 0.4 * severity * spread(rng) * world.robot.coulomb[joint]
    width = rng.uniform(0.03, 0.1) * world.robot.reach[joint]
    bent: list[np.ndarray] = []

    def load(state: State, torque: np.ndarray) -> None:
        here = state.motor[:, joint]
        if not bent:
            bent.append(here.copy())
        bent[0] = np.clip(bent[0], here - width, here + width)
        torque[:, joint] += size * (here - bent[0]) / width

    world.motor_loads.append(load)
    return _outcome(world, [f"q_{joint + 1}"], size=size, width=width)


@effect("law", outside=True, drawn=False)
def magnet_pair(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Two magnets that pass one another at one angle of another joint: a pull near it."""
    other = _other(world, joint, rng)
    size = 0.06 * severity * spread(rng) * world.robot.torque_rated[joint]
    place = world.robot.centre[other] + rng.uniform(-0.4, 0.4) * world.robot.reach[other]
    width = rng.uniform(0.15, 0.3) * world.robot.reach[other]

    def load(state: State, torque: np.ndarray) -> None:
        torque[:, joint] += size / (1.0 + ((state.link[:, other] - place) / width) ** 2) ** 2

    world.link_loads.append(load)
    return _outcome(world, [f"q_{other + 1}"], size=size, place=place)
