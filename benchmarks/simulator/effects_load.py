"""Inertia and external torques: what the links carry and what pulls at them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .effects import Outcome, effect, sign, spread
from .world import State, World


@effect("inertia")
def rotor_inertia(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    nominal = world.robot.rotor_inertia[joint]
    change = max(sign(rng, 0.7) * 0.16 * severity * spread(rng), -0.45) * nominal
    world.rotor_inertia[joint] += change
    return Outcome(parameters={"dJ": change})


@effect("inertia", "robot")
def payload(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A further rigid body on the last link: a block off the middle of the known payload."""
    mass = 0.1 * severity * spread(rng) * world.robot.payload_mass
    place = np.array(world.robot.payload_com) + rng.uniform(-0.03, 0.03, 3)
    edges = rng.uniform(0.03, 0.08, 3)
    block = pin.Inertia.FromBox(mass, *edges.tolist())
    world.model.inertias[world.robot.joints] += pin.Inertia(mass, place, block.inertia)
    return Outcome(
        parameters={"dm": mass, "cx": place[0], "cy": place[1], "cz": place[2]},
        law={"edges": edges.tolist()},
    )


@effect("inertia", "link")
def inertial_error(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A link that is heavier or lighter than drawn, with its middle elsewhere."""
    body = pin.Inertia(world.model.inertias[joint + 1])
    share = sign(rng, 0.6) * 0.1 * severity * spread(rng)
    mass = body.mass * (1.0 + share)
    shift = rng.uniform(-1.0, 1.0, 3) * 0.008 * severity
    world.model.inertias[joint + 1] = pin.Inertia(
        mass, body.lever + shift, body.inertia * (1.0 + share)
    )
    moment = mass * (body.lever + shift) - body.mass * body.lever
    # Motions show only some combinations of these, so no value is one to be compared.
    return Outcome(law={"dm": mass - body.mass, "dmc": moment.tolist()})


@effect("spring")
def gravity_spring(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A coil spring between a crank on the link and an anchor behind it.

    Its torque is tension times lever arm; near the offset it is a torsion spring of stiffness k.
    """
    stiffness = 0.12 * severity * spread(rng) * world.robot.torque_rated[joint]
    offset = world.robot.centre[joint] + sign(rng) * rng.uniform(0.3, 0.7)
    crank, anchor = 0.08, 0.4
    slack = 0.3 * (anchor - crank)
    short = anchor - crank  # length of the spring where it holds the link at its offset
    rate = stiffness / (crank * anchor * (1.0 - slack / short))

    def load(state: State, torque: np.ndarray) -> None:
        angle = state.link[:, joint] - offset
        length = np.sqrt(crank**2 + anchor**2 - 2 * crank * anchor * np.cos(angle))
        arm = crank * anchor * np.sin(angle) / length
        torque[:, joint] -= rate * (length - slack) * arm

    world.link_loads.append(load)
    return Outcome(law={"stiffness_at_offset": stiffness, "offset": offset, "crank": crank})


@effect("spring")
def cable_spring(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A dress pack that stiffens towards the ends of the stroke: straight pieces of a cubic."""
    rated = world.robot.torque_rated[joint]
    linear = 0.04 * severity * spread(rng) * rated
    cubic = 0.05 * severity * spread(rng) * rated
    rest = world.robot.centre[joint] + rng.uniform(-0.3, 0.3)
    knots = np.linspace(-4.0, 4.0, 49)
    torque_at = linear * knots + cubic * knots**3

    def load(state: State, torque: np.ndarray) -> None:
        torque[:, joint] -= np.interp(state.link[:, joint] - rest, knots, torque_at)

    world.link_loads.append(load)
    return Outcome(parameters={"k1": linear, "k3": cubic, "q0": rest})


@effect("mounting", "robot")
def base_tilt(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """The base leans: gravity turns in its frame, about x and then about y."""
    size = np.deg2rad(0.5) * severity * spread(rng)
    direction = rng.uniform(-np.pi, np.pi)
    rx, ry = float(size * np.cos(direction)), float(size * np.sin(direction))
    if world.robot.name == "planar2":  # its axes are parallel to y: nothing else shows
        rx, ry = 0.0, sign(rng) * float(size)
    base = pin.utils.rpyToMatrix(rx, ry, 0.0)
    world.model.gravity.linear = base.T @ world.model.gravity.linear
    return Outcome(parameters={"rx": rx, "ry": ry})


@effect("mounting")
def joint_zero(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A joint mastered beside its mark: where both encoders say q, the link stands at q + dq."""
    off = sign(rng) * np.deg2rad(1.0) * severity * spread(rng)
    model = world.model
    q = pin.neutral(model)
    axis = pin.computeJointJacobian(model, model.createData(), q, joint + 1)[3:, joint]
    moved = pin.SE3(pin.exp3(off * axis), np.zeros(3))
    model.jointPlacements[joint + 1] = model.jointPlacements[joint + 1] * moved
    return Outcome(parameters={"dq": float(off)})


@effect("contact", "robot")
def external_contact(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """The tool presses on a cushion below a height: elastic, with damping that fades to its rim."""
    model, data = world.model, world.model.createData()
    tool = model.getFrameId("tool0")
    heights = []
    for motion, plan in zip(world.reference, world.plans, strict=True):
        if plan.role == "train":
            for q in motion[:: 20 * world.spec.substeps]:
                pin.framesForwardKinematics(model, data, q)
                heights.append(data.oMf[tool].translation[2])
    low = np.quantile(heights, [0.02, 0.15])
    top = float(low[1])
    force = 0.3 * severity * spread(rng) * 9.81 * world.robot.payload_mass
    stiffness = max(force / max(float(low[1] - low[0]), 1e-3), 100.0)
    damping = 0.03 * stiffness
    rim = 0.2 * float(low[1] - low[0]) + 1e-4

    def load(state: State, torque: np.ndarray) -> None:
        for r, q in enumerate(state.link):
            pin.framesForwardKinematics(model, data, q)
            depth = top - data.oMf[tool].translation[2]
            if depth <= 0.0:
                continue
            jacobian = pin.computeFrameJacobian(
                model, data, q, tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )[2]
            rate = -float(jacobian @ state.link_velocity[r])
            push = stiffness * depth + damping * rate * min(depth / rim, 1.0)
            torque[r] += jacobian * max(push, 0.0)

    world.link_loads.append(load)
    return Outcome(parameters={"k": stiffness, "z": top}, law={"damping": damping, "rim": rim})


def _pull_at_tool(
    world: World, severity: float, rng: np.random.Generator, turning: bool
) -> Outcome:
    """Pull at the tool with a force that is constant in the base, or in the tool."""
    model, data = world.model, world.model.createData()
    tool = model.getFrameId("tool0")
    way = rng.standard_normal(3)
    if world.robot.name == "planar2":  # its axes are parallel to y
        way[1] = 0.0
    force = 0.3 * severity * spread(rng) * 9.81 * world.robot.payload_mass
    force = force * way / np.linalg.norm(way)
    axes = pin.ReferenceFrame.LOCAL if turning else pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

    def load(state: State, torque: np.ndarray) -> None:
        for r, q in enumerate(state.link):
            torque[r] += pin.computeFrameJacobian(model, data, q, tool, axes)[:3].T @ force

    world.link_loads.append(load)
    return Outcome(parameters=dict(zip(("fx", "fy", "fz"), map(float, force), strict=True)))


@effect("contact", "robot")
def tool_force(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """A weight on a cord over a pulley, far away: its pull keeps its direction."""
    return _pull_at_tool(world, severity, rng, turning=False)


@effect("contact", "robot")
def turning_tool_force(
    world: World, joint: int, severity: float, rng: np.random.Generator
) -> Outcome:
    """A jet or a spring in the tool: its force turns with the tool."""
    return _pull_at_tool(world, severity, rng, turning=True)


@effect("contact", "robot", drawn=False)
def touched(world: World, joint: int, severity: float, rng: np.random.Generator) -> Outcome:
    """Somebody pushes at the tool for a while, in one training run and in one held-out run."""
    model, data = world.model, world.model.createData()
    tool = model.getFrameId("tool0")
    force = 0.6 * severity * spread(rng) * 9.81 * world.robot.payload_mass
    held_out = [r for r in range(world.runs) if r not in world.training]
    pushes = []
    for runs in (world.training, held_out):
        if runs:
            length = float(rng.uniform(0.5, 1.0))
            begin = float(rng.uniform(0.15, 0.65)) * world.spec.seconds
            way = rng.standard_normal(3)
            pushes.append((int(rng.choice(runs)), begin, length, way / np.linalg.norm(way)))

    def load(state: State, torque: np.ndarray) -> None:
        if state.step == 0.0:
            return
        for r, begin, length, way in pushes:
            phase = (state.time - begin) / length
            if not 0.0 < phase < 1.0:
                continue
            hand = min(phase, 1.0 - phase, 0.2) / 0.2 * (1.0 + 0.2 * np.sin(9.0 * phase))
            jacobian = pin.computeFrameJacobian(
                model, data, state.link[r], tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )[:3]
            torque[r] += jacobian.T @ (force * hand * way)

    world.link_loads.append(load)
    return Outcome(
        law={
            "force": force,
            "pushes": [
                {"run": world.plans[r].name, "begin": begin, "end": begin + length}
                for r, begin, length, _ in pushes
            ],
        }
    )
