"""Calls of the compiled core for elastic arms (swings.c, response.c).

The formulas are those of `uncertain_arms`, `simulate` and `response`, which also work without it:
results agree but for rounding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt import native
from stiffopt.native import ARRAY, REAL, WHOLE, Struct

if TYPE_CHECKING:
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.elastic.linearization import TabulatedSprings
    from stiffopt.elastic.motor import MotorMotion
    from stiffopt.elastic.response import Load, Matrices, Response


# Capacity of the arrays in swings.c.
MAX_JOINTS = 32

StateDerivative = Callable[[float, np.ndarray], np.ndarray]


class _Springs(Struct):
    _fields_ = (("torque", ARRAY), ("rise", ARRAY), ("scale", ARRAY), ("points", WHOLE))


class _Plan(Struct):
    _fields_ = (
        *((name, WHOLE) for name in ("first", "count", "flight", "spans")),
        *((name, WHOLE) for name in ("n", "arms", "commands")),
        ("step", REAL),
        *((name, ARRAY) for name in ("bodies", "torques", "span_of", "commanded", "of")),
        *((name, ARRAY) for name in ("stiffness", "damping")),
        *((name, ARRAY) for name in ("payload", "servo", "rigid")),
        ("springs", _Springs),
        ("links", ARRAY),
        ("rates", ARRAY),
    )


class _Arm(Struct):
    _fields_ = (
        *((name, WHOLE) for name in ("n", "loops")),
        *((name, ARRAY) for name in ("parent", "slides", "rigid", "axis", "rotation")),
        *((name, ARRAY) for name in ("translation", "mass", "centre", "inertia")),
        *((name, 3 * REAL) for name in ("gravity", "force", "tool")),
        ("carries_tool", WHOLE),
        *((name, ARRAY) for name in ("damping", "friction", "hysteresis")),
        *((name, ARRAY) for name in ("springs", "windups", "cubics")),
        ("pieces", WHOLE),
        *((name, ARRAY) for name in ("times", "motion", "last")),
        ("state", 3 * MAX_JOINTS * REAL),
        ("slope", 3 * MAX_JOINTS * REAL),
    )


def core(joints: int) -> ctypes.CDLL | None:
    """Return the compiled core; None where there is none or an arm has too many joints for it."""
    return native.loaded() if joints <= MAX_JOINTS else None


def integrate_linearized(
    made: ctypes.CDLL,
    springs: TabulatedSprings,
    rigid: np.ndarray,
    begun: np.ndarray,
    rates: np.ndarray,
    **given: object,
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate linearised arms: positions of their links (K, B, n) less those of the plan.

    And their last velocities (B, n). `made`: of `core`. `rigid`: joints that follow their motors.
    `begun`, `rates` (B, n): initial positions and velocities of the links less those of the plan.
    `given`: fields of the C code's `Plan`.
    """
    arms, n = begun.shape
    plan = _Plan()
    plan.springs.set(**springs.table())
    plan.set(n=n, arms=arms, rigid=np.isin(np.arange(n), rigid), **given)
    links = np.empty((plan.count, arms, n))
    links[0] = begun
    rates = np.array(rates)
    plan.links, plan.rates = links.ctypes.data, rates.ctypes.data
    made.swing(ctypes.byref(plan))
    return links, rates


def state_derivative(
    made: ctypes.CDLL, arm: ElasticArm, motor: MotorMotion, friction: np.ndarray, loops: int
) -> StateDerivative:
    """Return the time derivative of an arm's state as a function for `odeint`.

    `made`: of `core`. `friction` (n,): torque of each hysteresis [N m]. `loops`: state variables of
    the hysteresis.
    """
    bodies, tables = (
        arm.robot.tree.bodies,
        [
            (np.empty(0), np.empty((0, 4))) if spring is None else spring.by_windup
            for spring in arm.springs
        ],
    )
    own = _Arm()
    own.set(
        n=len(bodies),
        loops=loops,
        parent=[body.parent for body in bodies],
        slides=[body.prismatic for body in bodies],
        rigid=~arm.elastic,
        **{
            name: np.array([getattr(body, name) for body in bodies], dtype=float)
            for name in ("axis", "rotation", "translation", "mass", "centre", "inertia")
        },
        gravity=arm.robot.tree.gravity,
        force=arm.process_force,
        tool=arm.robot.tool.offset,
        carries_tool=arm.robot.tool.joint,
        damping=arm.damping,
        friction=friction,
        hysteresis=arm.hysteresis,
        springs=np.cumsum([0, *(len(windups) for windups, _ in tables)]),
        windups=np.concatenate([windups for windups, _ in tables]),
        cubics=np.concatenate([cubics for _, cubics in tables]),
        **motor.table(),
    )
    size = 2 * len(bodies) + loops
    # Views of the same memory: copying arguments would dominate the cost of a call.
    state = np.ctypeslib.as_array(own.state)[:size]
    found = np.ctypeslib.as_array(own.slope)[:size]
    run, place = made.slope, ctypes.byref(own)
    run.argtypes = (ctypes.c_void_p, REAL)
    force, along_path = np.ctypeslib.as_array(own.force), arm.path_force

    def at(t: float, values: np.ndarray) -> np.ndarray:
        state[:] = values
        if along_path is not None:
            force[:] = arm.process_force + along_path(np.array(t))
        run(place, t)
        return found

    return at


# Capacity of the arrays in response.c.
MAX_RESPONSE_JOINTS = 16
# Doubles of a vector register: columns of a step are padded to a multiple of it.
REGISTER_SIZE = 4


class _Response(Struct):
    _fields_ = (
        *((name, WHOLE) for name in ("steps", "n", "rows")),
        *((name, REAL) for name in ("dt", "unit")),
        *((name, ARRAY) for name in ("mobility", "rate", "stiffness")),
        *((name, ARRAY) for name in ("step", "soft", "lag")),
    )


def native_steps(matrices: Matrices) -> NativeSteps | None:
    """Compiled `ArraySteps`; None without the compiled core, or for too many joints."""
    made = core(matrices.joints)
    if made is None or matrices.joints > MAX_RESPONSE_JOINTS:
        return None
    return NativeSteps(made, matrices)


class NativeSteps:
    """Transition matrices and time integration by the compiled core."""

    def __init__(self, made: ctypes.CDLL, matrices: Matrices) -> None:
        self._made, self._n, count = made, matrices.joints, len(matrices.mobility) - 1
        rows = -(-2 * self._n // REGISTER_SIZE) * REGISTER_SIZE
        self._step_arrays = {
            "step": np.zeros((count, 2 * self._n, rows)),
            "soft": np.empty((count, self._n, self._n)),
            "lag": np.empty((count, self._n, self._n)),
        }
        self._point_to(matrices)
        self.take(0, count)

    def _point_to(self, matrices: Matrices) -> None:
        count, _, rows = self._step_arrays["step"].shape
        self._of, self._own = matrices, _Response()
        self._own.set(steps=count, n=self._n, rows=rows, **vars(matrices), **self._step_arrays)

    def take(self, first: int, last: int) -> None:
        """See `Steps`."""
        self._made.take(ctypes.byref(self._own), WHOLE(first), WHOLE(last))

    def copy(self, stiffness: np.ndarray) -> NativeSteps:
        """See `Steps`."""
        new = copy(self)
        new._step_arrays = {name: array.copy() for name, array in self._step_arrays.items()}
        new._point_to(replace(self._of, stiffness=stiffness))
        return new

    def march(self, load: Load, begin: np.ndarray | None, *, accelerated: bool) -> Response:
        """See `Steps`."""
        many, count = load.torque.shape[:2]
        z, velocity = np.empty((2, many, count, self._n))
        acceleration = np.empty(z.shape) if accelerated else None
        if begin is None:
            begin = np.zeros((many, 2 * self._n))
        arrays = (
            np.ascontiguousarray(load.links, dtype=np.int64),
            np.ascontiguousarray(load.torque, dtype=float),
            None if load.within is None else np.ascontiguousarray(load.within, dtype=float),
            np.ascontiguousarray(begin, dtype=float),
            *(z, velocity, acceleration),
        )
        self._made.march(
            ctypes.byref(self._own),
            WHOLE(many),
            WHOLE(load.links.shape[1]),
            *(ARRAY(None if each is None else each.ctypes.data) for each in arrays),
        )
        return z, velocity, acceleration
