"""Simulation of an arm that follows commands: bodies and dry friction by MuJoCo, servos beside it.

MuJoCo shares no formula with the package: dry friction is a constraint there, joints are
integrated implicitly, and bodies come from its own format.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from .commanded_arms import Arm, mjcf_text

TIMESTEP = 5e-4  # [s]
MASS_TOLERANCE, GAIN_TOLERANCE, FRICTION_TOLERANCE = 0.02, 0.03, 0.1
# Standard deviations within which nominal values lie.
_MAX_DEVIATIONS = 2.0
# Teeth of a gear with backlash: their stiffness lets the lighter side ring at this angular
# frequency [rad/s], with this share of critical damping.
_TOOTH_FREQUENCY, _TOOTH_DAMPING = 400.0, 0.3


@dataclass
class State:
    """Link angles and rates, what the servo reads, torque at the links of the step before."""

    q: np.ndarray
    v: np.ndarray
    reading: np.ndarray
    link_torque: np.ndarray
    tool: np.ndarray
    jacobian: np.ndarray


@dataclass
class World:
    """True arm.

    Parameters
    ----------
    arm : Arm
        Nominal.
    scale, kp, kd, armature, coulomb, viscous, torque_max, delay : array (n,)
        True values; `scale` is that of the links' masses.
    gravity : array (3,)
    zero : array (n,)
        Reading less angle [rad].
    coupling : array (n,)
        Share of the angle of the joint before in the reading.
    backlash : array (n,)
        Width between the flanks [rad].
    deadband : array (n,)
        Position error up to which the servo gives no torque [rad].
    payload : tuple, optional
        Mass [kg] and place in the last link's frame [m].
    forces, friction : list of callable
        Torques on the links (n,) and dry friction beside Coulomb's (n,), of the state [N m].
    """

    arm: Arm
    scale: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    armature: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    torque_max: np.ndarray
    delay: np.ndarray
    gravity: np.ndarray
    zero: np.ndarray
    coupling: np.ndarray
    backlash: np.ndarray
    deadband: np.ndarray
    payload: tuple[float, np.ndarray] | None = None
    forces: list[Callable[[State], np.ndarray]] = field(default_factory=list)
    friction: list[Callable[[State], np.ndarray]] = field(default_factory=list)


def nominal_world(arm: Arm, delay: float) -> World:
    """Return the arm as its nominal model has it, with a delay of commands [s]."""
    n = arm.n
    names = ("kp", "kd", "armature", "coulomb", "viscous")
    return World(
        arm,
        scale=np.ones(n),
        **{name: np.array(getattr(arm, name)) for name in names},
        torque_max=arm.torque_max,
        delay=np.full(n, delay),
        gravity=np.array([0.0, 0.0, -9.81]),
        zero=np.zeros(n),
        coupling=np.zeros(n),
        backlash=np.zeros(n),
        deadband=np.zeros(n),
    )


def true_world(arm: Arm, delay: float, rng: np.random.Generator, *, gains: bool) -> World:
    """Return an arm within the tolerances of its nominal model.

    `gains`: stated gains deviate by their tolerance; otherwise only masses and friction do.
    """
    world = nominal_world(arm, delay)

    def factors(tolerance: float) -> np.ndarray:
        # What lies further out is an effect, and would be named with right.
        return 1.0 + tolerance * np.clip(rng.normal(size=arm.n), -_MAX_DEVIATIONS, _MAX_DEVIATIONS)

    world.scale = factors(MASS_TOLERANCE)
    for name in ("armature", "coulomb", "viscous"):
        setattr(world, name, getattr(world, name) * factors(FRICTION_TOLERANCE))
    of_gains = factors(GAIN_TOLERANCE), factors(GAIN_TOLERANCE)
    if gains:
        world.kp, world.kd = world.kp * of_gains[0], world.kd * of_gains[1]
    return world


def _build(world: World) -> Any:
    arm = world.arm
    rotors = frozenset(np.flatnonzero(world.backlash > 0.0).tolist())
    model = mujoco.MjModel.from_xml_string(mjcf_text(arm, world.scale, rotors))
    model.opt.timestep, model.opt.integrator = TIMESTEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.gravity[:] = world.gravity
    # By default dry friction of MuJoCo creeps for 20 ms: at a leg's speeds it is hardly dry.
    model.dof_solref[:], model.dof_solimp[:, :2] = [2.0 * TIMESTEP, 1.0], 0.999
    if world.payload is not None:
        mass, place = world.payload
        body, own = model.body(f"l{arm.n - 1}").id, model.body(f"l{arm.n - 1}").mass[0]
        apart = place - model.body_ipos[body]
        # The principal axes stay those of the rod: the payload lies on its line.
        about = own * mass / (own + mass) * (apart @ apart * np.ones(3) - apart**2)
        model.body_inertia[body] += about
        model.body_ipos[body] += mass / (own + mass) * apart
        model.body_mass[body] = own + mass
    return model


def _inverse_inertia(model: Any, data: Any) -> np.ndarray:
    """Return the acceleration of every degree of freedom under a unit torque of its own."""
    inertia = np.zeros((model.nv, model.nv))
    for column, unit in zip(inertia, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    return np.diagonal(np.linalg.inv(inertia))


def simulate(world: World, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return readings and servo torques (K, n) under commands (K, n), one a time step."""
    arm, model = world.arm, _build(world)
    data, n = mujoco.MjData(model), arm.n
    link = np.array([model.joint(f"j{k}").dofadr[0] for k in range(n)])
    geared = np.flatnonzero(world.backlash > 0.0)
    motor = link.copy()
    motor[geared] = [model.joint(f"r{k}").dofadr[0] for k in geared]
    model.dof_armature[motor] = world.armature
    model.dof_damping[motor], model.dof_frictionloss[motor] = world.viscous, world.coulomb
    half = 0.5 * world.backlash[geared]
    late = np.round(world.delay / TIMESTEP).astype(int)
    site, columns = model.site("tool").id, np.arange(n)
    jacobian = np.zeros((3, model.nv))

    def read(angles: np.ndarray) -> np.ndarray:
        before = np.concatenate([[0.0], angles[:-1]])
        return np.asarray(angles + world.zero + world.coupling * before)

    start = command[0] - world.zero
    for k in range(1, n):
        start[k] -= world.coupling[k] * start[k - 1]
    data.qpos[link] = data.qpos[motor] = start
    mujoco.mj_forward(model, data)
    light = np.minimum(world.armature, 1.0 / _inverse_inertia(model, data)[link])[geared]
    tooth, tooth_damping = (
        light * _TOOTH_FREQUENCY**2,
        2.0 * _TOOTH_DAMPING * light * _TOOTH_FREQUENCY,
    )
    readings, torques = np.empty_like(command), np.empty_like(command)
    link_torque = np.zeros(n)
    for k in range(len(command)):
        q, v = data.qpos[link], data.qvel[link]
        readings[k] = read(q)
        wanted = command[np.maximum(k - late, 0), columns]
        rate = v + world.coupling * np.concatenate([[0.0], v[:-1]])
        error = wanted - readings[k]
        error = np.sign(error) * np.maximum(np.abs(error) - world.deadband, 0.0)
        torque = world.kp * error - world.kd * rate
        torque = np.clip(torque, -world.torque_max, world.torque_max)
        torques[k] = torque
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[motor] = torque
        # By virtual work the joint before carries its share of a coupled joint's torque.
        data.qfrc_applied[motor[:-1]] += (world.coupling * torque)[1:]
        if len(geared):
            gap = data.qpos[motor[geared]] - q[geared]
            closing = data.qvel[motor[geared]] - v[geared]
            beyond = gap - np.clip(gap, -half, half)
            push = (tooth * beyond + tooth_damping * closing) * (beyond != 0.0)
            data.qfrc_applied[motor[geared]] -= push
            data.qfrc_applied[link[geared]] += push
        if world.forces or world.friction:
            mujoco.mj_jacSite(model, data, jacobian, None, site)
            state = State(q, v, readings[k], link_torque, data.site_xpos[site], jacobian[:, link])
            for force in world.forces:
                data.qfrc_applied[link] += force(state)
            dry = world.coulomb + sum(own(state) for own in world.friction)
            model.dof_frictionloss[motor] = np.maximum(dry, 0.0)
        mujoco.mj_step(model, data)
        if world.friction:
            link_torque = (
                torque
                + data.qfrc_constraint[motor]
                - world.viscous * data.qvel[motor]
                - world.armature * data.qacc[motor]
            )
    if (
        data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
        or np.abs(readings - command).max() > np.pi
    ):
        raise FloatingPointError("the simulated arm does not follow its commands")
    return readings, torques
