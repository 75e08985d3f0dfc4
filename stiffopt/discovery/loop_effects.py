"""Findings in a closed loop: the catalogue's terms at one instant, of symbols in place of samples.

A term that needs more than an instant (memory, clocks, temperatures) has no part in it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np

from stiffopt.actuator.law import ActuatorLaw
from stiffopt.closed_loop.parameters import Parameters
from stiffopt.closed_loop.physics import Amplitudes, LoopPhysics, LoopSignals, LoopSpring
from stiffopt.discovery.catalogue.common import motor_inertia
from stiffopt.discovery.comparison.located_effect import EstimatedEffect
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.effect import Effect, Term, Values
from stiffopt.discovery.extended.model import ExtendedModel
from stiffopt.discovery.extended.planning import planner_model
from stiffopt.discovery.laws.law import law_of
from stiffopt.discovery.loop_fit import DRIVE_PARAMETERS, stated_tolerance
from stiffopt.discovery.signals import (
    JOINT_SIGNAL_NAMES,
    JointSignals,
    RobotSignals,
    smooth_sign,
)
from stiffopt.dynamics.kinematics import point_jacobian, tool_pose
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.robot.robot import Robot

# Samples at which a formula is compared with the term, over a time in which memory would show; and
# the difference allowed over its size.
_SAMPLE_COUNT, _FORMULA_TOLERANCE = 50, 1e-6
# Largest sampled position, speed and acceleration [rad], [rad/s], [rad/s^2].
_LARGEST_MOTION = 1.5
# Angular frequency of the flanks of a joint that the model holds rigid [rad/s]: above all that
# commands excite, slow beside the steps of the simulation.
_FLANK_FREQUENCY = 300.0
# Vibration on the flanks decays by itself, over critical damping.
_FLANK_DAMPING = 0.3
# Effects whose amplitude is a parameter of every loop, which a fit refines.
LOOP_VALUES = {
    "load_friction": "load_friction",
    "quadratic_drag": "drag",
    "command_delay": "lateness",
    "deadband": "deadband",
    "torque_gain": "gain",
}
# Deviation of a drive's limit before a fit, over the limit: what asks for more is seen at once.
_LIMIT_DEVIATION = 0.2
_SIGNAL_NAMES = tuple(each.name for each in fields(LoopSignals))
# Name, symbol, value, deviation, least and greatest value.
_Unknown = tuple[tuple[Any, int], ca.SX, float, float, float, float]


@dataclass(frozen=True)
class LoopParameter:
    """Parameter of every loop that an effect of a joint changes.

    `convert` turns amplitudes into values and values into amplitudes: it is its own inverse.
    """

    name: str
    convert: Callable[[Any], Any]
    slope: Callable[[Any], Any]


def loop_parameter(entry: Effect) -> LoopParameter | None:
    """Return the parameter of every loop that an effect of a joint changes."""
    if entry.moves_zero:
        return LoopParameter("zero", lambda x: -x, lambda x: -1.0 + 0.0 * x)
    name = DRIVE_PARAMETERS.get(entry.nominal) or LOOP_VALUES.get(entry.name)
    if name == "gain":  # torque is read by the stated gain, and given by the true one
        return LoopParameter(name, lambda x: 1.0 / (1.0 + x) - 1.0, lambda x: -((1.0 + x) ** -2))
    return None if name is None else LoopParameter(name, lambda x: x, lambda x: 1.0 + 0.0 * x)


def inseparable_parameters(
    law: ActuatorLaw, fitted: Parameters, name: str, joint: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return places and factors of the parameters that a motion tells as one, by a joint (from 0).

    Viscous friction and the damping of the drive are told by their sum.
    """
    names, factors = [name], [1.0]
    if name == "viscous" and law.damping[joint] > 0.0:
        names, factors = [name, "damping"], [1.0, float(law.damping[joint])]
    return np.array([fitted.place(each).start + joint for each in names]), np.array(factors)


def stated_value(recordings: RecordingSet, entry: Effect, joint: int) -> tuple[float, float] | None:
    """Return what a set states of an effect's amplitude at a joint (from 0) of the robot.

    The value that every joint has and its standard deviation, of viscous friction with that of the
    drive's damping; None where the set states none.
    """
    if entry.nominal:
        value = float(getattr(recordings.robot, entry.nominal)[joint])
        known = entry.nominal not in recordings.unstated
        sd = stated_tolerance(recordings, entry.nominal) * value
        if entry.nominal == "viscous" and recordings.actuator is not None:
            inside = recordings.actuator.reordered(np.argsort(recordings.order))
            sd = float(np.hypot(sd, inside.tolerance[joint] * inside.damping[joint]))
        return (value, sd) if known else None
    parameter, law = loop_parameter(entry), recordings.actuator
    if law is None or parameter is None or parameter.name != "gain":
        return None
    inside = law.reordered(np.argsort(recordings.order))
    guessed = inside.estimated is not None and inside.estimated[joint]
    return None if guessed else (0.0, float(inside.tolerance[joint]))


def robot_in_loop(
    recordings: RecordingSet, model: ExtendedModel, more: Sequence[EstimatedEffect] = ()
) -> tuple[Robot, LoopPhysics, dict[tuple[str, int], float]]:
    """Return the robot with findings, the physics that it cannot hold, and values of the loop.

    Values are by name of the loop's parameter and joint (from 0) of the robot. Effects with memory,
    of sensors and of single runs are in none of these. Amplitudes of the physics are named by the
    key of their finding and their number, shapes after amplitudes; those of `more`, which the robot
    has not, come last, without shapes.
    """
    planner = planner_model(recordings.robot, model)
    instant = _Instant(recordings, model)
    values: dict[tuple[str, int], float] = defaultdict(float)
    for each in planner.not_in_robot:
        joint = each.located.joint
        if each.located.run is not None or each.effect.only_in:
            continue
        place = -1 if joint is None else int(recordings.order[joint])
        parameter = loop_parameter(each.effect)
        if joint is not None and parameter is not None:
            # Those of a model and their changes since add up.
            values[parameter.name, place] += parameter.convert(each.amplitudes[0])
        else:
            instant.add(each)
            if each.effect.loses:
                assert joint is not None
                whole = getattr(planner.robot, each.effect.loses)[place]
                values[DRIVE_PARAMETERS[each.effect.loses], place] -= each.amplitudes[-1] * whole
    for each in more:
        instant.add(each, with_shapes=False)
    return planner.robot, instant.physics(), values


@dataclass(frozen=True, eq=False)
class _Parts:
    """Torques and deflections that a term adds at an instant, by joints in the order of the set."""

    torque: ca.SX
    deflection: ca.SX


class _Instant:
    """Terms of findings at one instant, as formulas of the loop's signals."""

    def __init__(self, recordings: RecordingSet, model: ExtendedModel) -> None:
        self.recordings, self.n = recordings, recordings.n
        self.order = np.asarray(recordings.order)
        self.constants = model.scaled(RobotModel(recordings).constants)
        self.symbols = LoopSignals(*(ca.SX.sym(name, self.n) for name in _SIGNAL_NAMES))
        self.torque = ca.SX.zeros(self.n)
        self.displacement = ca.SX.zeros(self.n)
        self.windup: dict[int, ca.SX] = {}
        self.at_output: set[int] = set()
        self.limits: dict[int, ca.SX] = {}
        self.damped: dict[int, ca.SX] = {}
        self.unknown: list[_Unknown] = []

    def add(self, each: EstimatedEffect, *, with_shapes: bool = True) -> None:
        """Add a finding, if it is a formula of an instant; its shapes are unknown on request."""
        key, located = each.located.key, each.located
        if each.effect.limits_drive:
            assert located.joint is not None
            place = int(self.order[located.joint])
            constants = located.constants(self.constants)
            value = each.effect.parameters(each.amplitudes, each.shapes, constants)["limit"]
            self.limits[place] = ca.SX.sym("limit")
            deviation = _LIMIT_DEVIATION * value
            self.unknown.append(((key, 0), self.limits[place], value, deviation, 0.0, np.inf))
            law = self.recordings.actuator
            if law is not None and not law.damping_stated:
                self.damped[place] = ca.SX.sym("damped")
                self.unknown.append(((key, 1), self.damped[place], 0.5, 0.5, 0.0, 1.0))
            return
        amplitudes, s = ca.SX.sym("amplitude", len(each.amplitudes)), self.symbols
        shapes = self._unknown_shapes(each) if with_shapes else {}
        parts = self._parts(each, amplitudes, shapes)
        if parts is None and shapes:  # a term that takes numbers alone
            shapes, parts = {}, self._parts(each, amplitudes, {})
        if parts is None:
            return
        given = ca.vertcat(parts.torque, parts.deflection)
        unknown = self._unknowns(each, amplitudes, shapes)
        self.unknown += [own for own in unknown if ca.depends_on(given, own[1])]
        turns_other_side = each.effect.at_motor is not None
        torque = parts.torque
        if ca.depends_on(parts.deflection, s.position):
            # What the bodies' torques do on displaced links follows from the displacement.
            (torque,) = ca.substitute(
                [torque], [s.spring, s.drive], [0.0 * s.spring, s.drive - s.spring]
            )
        for j, place in enumerate(self.order.tolist()):
            wound = parts.deflection[j]
            if ca.depends_on(wound, s.spring):
                self.windup[place] = self.windup.get(place, ca.SX(0.0)) + wound
                if turns_other_side:
                    self.at_output.add(place)
            elif ca.depends_on(wound, s.position):
                self.displacement[place] += wound
            if not turns_other_side:  # otherwise by the motion of both sides
                self._add_torque(place, torque[j])

    def _unknown_shapes(self, each: EstimatedEffect) -> dict[int, ca.SX]:
        """Return symbols of the shapes that a report tells, by number.

        Their initial values of a search tell how far they may be, those of a law its bounds.
        """
        ranges = self._shape_ranges(each)
        return {
            k: ca.SX.sym(entry.name)
            for k, entry in enumerate(each.effect.shapes)
            if entry.reported and entry.fit == "free" and ranges[k] > 0.0
        }

    def _shape_ranges(self, each: EstimatedEffect) -> list[float]:
        """Return how far each shape may be from its value."""
        law = law_of(each.effect)
        if law is not None:
            return [high - low for low, high in law.bounds]
        return [float(np.ptp(own)) for own in each.located.starts(self.constants)]

    def _unknowns(
        self, each: EstimatedEffect, amplitudes: ca.SX, shapes: Mapping[int, ca.SX]
    ) -> Iterator[_Unknown]:
        """Yield the unknown amplitudes and shapes of an effect."""
        located, key = each.located, each.located.key
        sizes, bounds = located.sizes(self.constants), located.bounds(self.constants)
        for k, value in enumerate(each.amplitudes):
            size, (least, greatest) = float(sizes[k]), sizes[k] * bounds[k]
            yield (key, k), amplitudes[k], value, max(size, abs(value)), least, greatest
        for k, shape in shapes.items():
            spread = 0.5 * self._shape_ranges(each)[k]
            number, own = len(each.amplitudes) + k, each.effect.shapes[k]
            yield (key, number), shape, each.shapes[k], spread, own.lower, own.upper

    def _add_torque(self, place: int, torque: ca.SX) -> None:
        """Add a torque; one that bends with the load takes the actuator's torque for it.

        Accelerations follow from the torques: one that bends with them is left out.
        """
        s = self.symbols
        implicit = ca.vertcat(s.acceleration, s.spring, s.drive)
        if ca.depends_on(ca.jacobian(torque, implicit), implicit):
            (torque,) = ca.substitute([torque], [s.spring, s.drive], [s.torque, s.torque])
        if not ca.depends_on(ca.jacobian(torque, s.acceleration), s.acceleration):
            self.torque[place] += torque

    def physics(self) -> LoopPhysics:
        """Return the physics of all findings."""
        s = self.symbols
        inputs = [getattr(s, name) for name in _SIGNAL_NAMES]

        def added(given: LoopSignals) -> ca.SX:
            values = [getattr(given, name) for name in _SIGNAL_NAMES]
            (found,) = ca.substitute([self.torque], inputs, values)
            return found

        def displaced(position: ca.SX) -> ca.SX:
            (found,) = ca.substitute([self.displacement], [s.position], [position])
            return found

        names, symbols, *numbers = zip(*self.unknown, strict=True) if self.unknown else [()] * 6
        begun, deviations, least, greatest = (np.array(own, dtype=float) for own in numbers)
        return LoopPhysics(
            limits=self.limits,
            damped=self.damped,
            amplitudes=Amplitudes(
                names=names,
                symbols=ca.vertcat(ca.SX(0, 1), *symbols),
                values=begun,
                deviations=deviations,
                bounds=np.column_stack([np.minimum(least, begun), np.maximum(greatest, begun)]),
            ),
            torque=added if _is_given(self.torque) else None,
            displacement=displaced if _is_given(self.displacement) else None,
            springs={place: self._spring(place, wound) for place, wound in self.windup.items()},
        )

    def _spring(self, place: int, wound: ca.SX) -> LoopSpring:
        """Return the spring of a joint with its findings' wind-up."""
        own = self.constants.joints[int(np.flatnonzero(self.order == place)[0])]
        load, damping = self.symbols.spring[place], own.joint_damping
        if own.elastic:
            wound = wound + own.windup(load)
        else:
            inertia = motor_inertia(own)
            wound = wound + load / (inertia * _FLANK_FREQUENCY**2)
            damping = 2.0 * _FLANK_DAMPING * inertia * _FLANK_FREQUENCY

        def windup(torque: ca.SX) -> ca.SX:
            return ca.substitute(wound, load, torque)

        return LoopSpring(windup=windup, damping=damping, encoder_at_output=place in self.at_output)

    def _parts(
        self, each: EstimatedEffect, amplitudes: ca.SX, shapes: Mapping[int, ca.SX]
    ) -> _Parts | None:
        """Return what an effect adds; None where its term is no formula of an instant."""
        s = self.symbols
        split = [
            ca.vertsplit(getattr(s, name)[[int(k) for k in self.order]]) for name in _SIGNAL_NAMES
        ]
        try:
            inside = [np.array([own], dtype=object) for own in split]
            units = np.eye(len(each.amplitudes)).tolist()
            # Signals of one joint are single symbols, those of a robot arrays of them.
            alone = each.located.is_of_one_joint
            given_shapes = {
                k: own if alone else np.array([[own]], dtype=object)[0] for k, own in shapes.items()
            }
            symbolic: Any = tuple(given_shapes.get(k, v) for k, v in enumerate(each.shapes))
            found = [self._evaluate(each, symbolic, unit, inside, 0.0) for unit in units]
        except (TypeError, RuntimeError, ValueError, AttributeError, LookupError):
            return None  # written for arrays of samples alone
        inputs = [getattr(s, name) for name in _SIGNAL_NAMES]
        # Terms are linear in their amplitudes.
        parts = _Parts(
            *(
                ca.mtimes(
                    ca.horzcat(*[ca.vertcat(*map(ca.SX, own[0])) for own in columns]), amplitudes
                )
                for columns in zip(*found, strict=True)
            )
        )
        sizes = each.located.sizes(self.constants).tolist()
        symbols = [amplitudes, *shapes.values()]
        values = [ca.DM(sizes), *(ca.DM(each.shapes[k]) for k in shapes)]
        fitted = ca.substitute([parts.torque, parts.deflection], symbols, values)
        function = ca.Function("parts", inputs, fitted)
        rng = np.random.default_rng(0)
        limits = np.array([joint.torque_max for joint in self.constants.joints])
        largest = dict.fromkeys(("torque", "spring", "drive"), limits)
        given = {
            name: largest.get(name, _LARGEST_MOTION)
            * rng.uniform(-1.0, 1.0, (_SAMPLE_COUNT, self.n))
            for name in _SIGNAL_NAMES
        }
        given["direction"] = smooth_sign(given["velocity"])
        samples = list(given.values())
        # What a formula does not know takes any values: terms that depend on it differ.
        other = np.cumsum(rng.uniform(0.5, 1.5, _SAMPLE_COUNT))
        along = self._evaluate(each, each.shapes, sizes, samples, other)
        in_robot = [x[:, np.argsort(self.order)].T for x in samples]
        both = function.map(_SAMPLE_COUNT)(*in_robot)
        for one, two in zip(along, both, strict=True):
            least = _FORMULA_TOLERANCE * float(np.nanmax(np.abs(one), initial=0.0))
            if not np.allclose(one, np.asarray(two).T, rtol=0.0, atol=least, equal_nan=True):
                return None
        return parts if any(_is_given(own) for own in (parts.torque, parts.deflection)) else None

    def _evaluate(
        self,
        each: EstimatedEffect,
        shapes: Values,
        amplitudes: Values,
        given: Sequence[np.ndarray],
        other: Any,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return torques and deflections (K, n) by signals (K, n) in the order of the set."""
        q, v, a, direction, torque, spring, drive = given
        rest = 0.0 * q + np.asarray(other)[..., None]
        known = {
            "motor_position": q,
            "motor_velocity": v,
            "motor_acceleration": a,
            "motor_direction": direction,
            "link_position": q,
            "link_velocity": v,
            "link_acceleration": a,
            "transmitted_torque": spring,
            "spring_torque": spring,
            "windup": 0.0 * q,
            "drive_torque": drive,
        }
        values = {name: known.get(name, rest) for name in JOINT_SIGNAL_NAMES}
        located = each.located
        term: Term
        if located.is_of_one_joint:
            found = [0.0 * q, 0.0 * q]
            assert located.joint is not None
            columns = [located.joint] if located.joint == 0 else [located.joint, located.joint - 1]
            own = self._of_joint(values, torque, located.joint, rest)
            term = each.effect.at_instant(own, amplitudes, shapes)
            parts = (term.drive_torque + term.link_torque, term.previous_torque)
            for column, part in zip(columns, parts, strict=False):
                found[0][:, column] = part
            found[1][:, located.joint] = term.deflection
            return found[0], found[1]
        place = located.link if located.joint is None else located.joint
        seen = RobotSignals(
            time=rest[:, 0],
            session_time=rest[:, 0],
            dt=1.0,
            arm=_ToolAtInstant(self.recordings, q),
            last_link=self.n - 1,
            link=self.n - 1 if place is None else place,
            constants=self.constants,
            asked_torque=torque,
            **values,
        )
        term = each.effect.at_instant(seen, amplitudes, shapes)
        torques = np.broadcast_to(term.drive_torque + term.link_torque, q.shape)
        return torques, np.broadcast_to(term.deflection, q.shape)

    def _of_joint(
        self, values: Mapping[str, np.ndarray], torque: np.ndarray, joint: int, rest: np.ndarray
    ) -> JointSignals:
        """Return the signals of a joint (K,); one symbol of formulas, which NumPy takes as such."""

        def column(whole: np.ndarray, j: int) -> Any:
            return whole[0, j] if whole.dtype == object else whole[:, j]

        before: dict[str, Any] = {
            f"previous_{name}": column(values[f"motor_{name}"], joint - 1) if joint else 0.0
            for name in ("position", "velocity", "acceleration")
        }
        return JointSignals(
            time=column(rest, joint),
            session_time=column(rest, joint),
            dt=1.0,
            constants=self.constants.joints[joint],
            asked_torque=column(torque, joint),
            **before,
            **{name: column(whole, joint) for name, whole in values.items()},
        )


class _ToolAtInstant:
    """Tool of an arm in poses (K, n), or in one pose of symbols."""

    def __init__(self, recordings: RecordingSet, q: np.ndarray) -> None:
        tree, tool, order = recordings.robot.tree, recordings.robot.tool, recordings.order
        angles = ca.SX.sym("q", recordings.n)
        position, turn = tool_pose(tree, tool.joint, tool.offset, None, angles)
        jacobian = point_jacobian(tree, tool.joint, tool.offset, angles)[:, [int(k) for k in order]]
        pose = ca.Function("tool", [angles], [position, jacobian, turn])
        back = np.argsort(order)
        every = [pose(ca.vertcat(*row[back])) for row in q]
        self.tool_position, self.tool_jacobian, turns = (
            np.array([_as_rows(own, symbolic=q.dtype == object) for own in each])
            for each in zip(*every, strict=True)
        )
        self.tool_position = self.tool_position[..., 0]
        levers = np.swapaxes(self.tool_jacobian, 1, 2)
        self.tool_levers = np.concatenate([levers, levers @ turns], axis=2)


def _as_rows(matrix: Any, *, symbolic: bool) -> np.ndarray:
    """Return the entries of a matrix, numbers or symbols, as an array."""
    if not symbolic:
        return np.asarray(ca.DM(matrix))
    rows, columns = matrix.shape
    found = np.empty((rows, columns), dtype=object)
    for i in range(rows):
        for j in range(columns):
            found[i, j] = matrix[i, j]
    return found


def _is_given(value: ca.SX) -> bool:
    """Return False for an expression that is zero."""
    return not bool(ca.SX(value).is_zero())
