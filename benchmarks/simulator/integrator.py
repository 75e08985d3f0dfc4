"""Two masses a joint, motor and link, integrated by leapfrog with dry friction as a set.

Positions are known at the steps, velocities between them; the recorded torque, position and
second difference of the positions of a step therefore belong to one instant, to second order.
Dry friction is solved, not approximated: a motor whose friction can hold it stands still.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .drive import Controller
from .elasticity import SpringTable
from .motion import LEAD
from .spec import Trace
from .world import State, World


class _Spring:
    """Torque between the two masses, with gears, sliders and creep."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._table = SpringTable(world.windups, world.robot.torque_max)
        self._damping = world.robot.joint_damping

    def deflection(self, state: State) -> np.ndarray:
        end = state.motor.copy()
        for gear in self._world.gears:
            gear.shift(state, end)
        deflection = end - state.link
        for creep in self._world.creeps:
            deflection[:, creep.joint] -= creep.deflection(len(deflection))
        return deflection

    def torque(self, state: State) -> np.ndarray:
        deflection = self.deflection(state)
        torque = self._table.torque(deflection)
        for sliders in self._world.sliders:
            sliders.add(deflection, torque)
        for creep in self._world.creeps:
            creep.advance(torque)
        rate = state.motor_velocity - state.link_velocity
        # A spring inside its play transmits nothing, not even its damping.
        return np.asarray(torque + self._damping * rate * (torque != 0.0))

    def wound(self, torque: np.ndarray) -> np.ndarray:
        """Deflection that carries a torque at rest, by bisection: (runs, n)."""
        low, high = np.full(torque.shape, -0.1), np.full(torque.shape, 0.1)
        for _ in range(60):
            middle = (low + high) / 2
            less = self._table.torque(middle) < torque
            low, high = np.where(less, middle, low), np.where(less, high, middle)
        for creep in self._world.creeps:
            creep.settle(torque)
            middle[:, creep.joint] += creep.deflection(len(torque))
        return middle


def _at_rest(world: World, spring: _Spring, motor: np.ndarray) -> np.ndarray:
    """Link angles that hang in balance below motors held at given angles."""
    data, zero = world.model.createData(), np.zeros(world.robot.joints)
    link = motor.copy()
    state = State(0.0, motor, 0 * motor, link, 0 * motor, 0 * motor, 0 * motor, 0.0)
    for _ in range(8):
        torque = np.array([pin.rnea(world.model, data, q, zero, zero).copy() for q in link])
        load = np.zeros_like(torque)
        state.link, state.spring = link, torque
        for law in world.link_loads:
            law(state, load)
        end = motor.copy()
        for gear in world.gears:
            gear.shift(state, end)
        link = end - spring.wound(torque - load)
    return link


def integrate(world: World) -> Trace:
    """Run all recordings of a case side by side."""
    h, model, data = world.step, world.model, world.model.createData()
    robot, inertia = world.robot, world.rotor_inertia
    runs, steps, n = world.reference.shape
    lead = round(LEAD / h)
    controller = Controller(world)
    spring = _Spring(world)
    motor = world.reference[:, 0].copy()
    link = _at_rest(world, spring, motor)
    zero = np.zeros((runs, n))
    motor_half, link_half = zero.copy(), zero.copy()
    motor_acc, link_acc = zero.copy(), zero.copy()
    command = controller.first()
    temperature = np.array([plan.temperature for plan in world.plans])
    state = State(0.0, motor, zero, link, zero, zero, temperature, h)
    kept = {name: np.empty((steps, runs, n)) for name in _KEPT}
    dry = np.tile(world.coulomb, (runs, 1))
    mobility, aba = h / inertia, pin.aba
    for k in range(steps):
        state.time = (k - lead) * h
        state.motor, state.link = motor, link
        state.motor_velocity = motor_half + 0.5 * h * motor_acc
        state.link_velocity = link_half + 0.5 * h * link_acc
        torque_in = spring.torque(state)
        state.spring = torque_in

        up = down = dry
        if world.friction:
            up, down = dry.copy(), dry.copy()
            for law in world.friction:
                law(state, up, down)
            np.maximum(up, 0.0, out=up)
            np.maximum(down, 0.0, out=down)
        against = world.viscous * state.motor_velocity
        for load in world.motor_loads:
            load(state, against)
        back = torque_in.copy() if world.gears else torque_in
        for gear in world.gears:
            gear.back(state, torque_in, back)
        given = command
        for limit in world.drive:
            given = limit(given, h)
        given = given * world.torque_constant
        # Dry friction takes what momentum it can and no more: the set-valued law, solved.
        free = motor_half + mobility * (given - back - against)
        moved = np.maximum(free - mobility * up, 0.0) + np.minimum(free + mobility * down, 0.0)
        on_link = torque_in.copy()
        for load in world.link_loads:
            load(state, on_link)
        for r in range(runs):
            link_acc[r] = aba(model, data, link[r], state.link_velocity[r], on_link[r])
        link_moved = link_half + h * link_acc
        push = given - back

        kept["motor"][k], kept["link"][k] = motor, link
        kept["motor_velocity"][k] = 0.5 * (motor_half + moved)
        kept["link_velocity"][k] = 0.5 * (link_half + link_moved)
        kept["spring"][k], kept["command"][k], kept["torque"][k] = torque_in, command, given
        motor_acc = (moved - motor_half) / h
        kept["friction"][k] = push - inertia * motor_acc
        command = controller.next(k, motor)
        motor_half, link_half = moved, link_moved
        motor, link = motor + h * moved, link + h * link_moved
    if not (np.isfinite(motor).all() and np.abs(motor - robot.centre).max() < 4.0):
        raise FloatingPointError(f"the simulation of {world.spec.case_name} ran away")
    trimmed = {name: values[lead:].swapaxes(0, 1) for name, values in kept.items()}
    return Trace(step=h, **trimmed)


_KEPT = (
    "motor",
    "motor_velocity",
    "link",
    "link_velocity",
    "spring",
    "command",
    "torque",
    "friction",
)
