"""Forward simulation of an elastic arm whose motors follow a motion.

The tool error is measured from the planned path (`ElasticArm.tool_error`): it includes the lag of a
servo, but not the sag under weight. Elastic bearings are joints of their own (`BearingJoints`).
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from stiffopt.elastic import native
from stiffopt.elastic.arm import MIN_FOLLOWING_FREQUENCY, ElasticArm
from stiffopt.elastic.bearings import BearingJoints
from stiffopt.elastic.modes import modes
from stiffopt.elastic.motor import SAMPLE_INTERVAL, MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.errors import NotSimulatedError
from stiffopt.result.simulation import SETTLING_BAND, SimulatedMotion
from stiffopt.result.tool_error import join_tool_errors

# Simulated time after arrival [s].
REST = 1.0
# Of the integrator; absolute ones of position [rad], velocity [rad/s] and hysteresis state.
# Errors at the tool stay below 0.07 um on the UR10 and the ER3A, whatever the motion; DOP853 has
# up to 0.5 um where the motors' acceleration jumps often (toppra), in a third more time.
_RELATIVE_TOLERANCE = 2e-10
_ABSOLUTE_TOLERANCES = (2e-9, 2e-7, 1e-4)
# Between two samples.
_MAX_INTEGRATOR_STEPS = 10000
# Half width of a reducer's hysteresis where none is stated [rad]: 45 to 56 urad were measured.
TYPICAL_HALF_LOOP = 50e-6
# Corrections of the load without laws by the torque of laws of that load: each is to it as this
# torque is to the load, a few percent.
_LOAD_CORRECTIONS = 3
# Faster modes [Hz] would take the integrator minutes.
_MAX_MODE_FREQUENCY = 5e3


def simulate(
    arm: ElasticArm,
    motion: MotorMotion,
    *,
    servo: Servo | None = None,
    ahead: float = 0.0,
    band: float = SETTLING_BAND,
    method: str = "",
    plan: MotorMotion | None = None,
    changes: Sequence[tuple[float, ElasticArm]] = (),
) -> SimulatedMotion:
    """Simulate the arm on a motor motion, then at rest for a second.

    Parameters
    ----------
    arm : ElasticArm
    motion : MotorMotion
        The command.
    servo : Servo, optional
        Response of the motors to it; None follows exactly.
    ahead : float
        Time by which the set-points are sent ahead of the plan [s].
    band : float
        Settling band of the tool [m].
    method : str
        Of `scipy.integrate.solve_ivp`; default LSODA by `odeint`.
    plan : MotorMotion, optional
        Planned motion of the links, from whose path the tool error is measured; default the
        command.
    changes : sequence of (time [s], ElasticArm)
        Arms that take over in flight, in order: the same one with another payload, process force or
        tool. Positions and velocities carry on, so that the arm vibrates about its new
        equilibrium, from whose pose the tool error is measured from then on.

    Returns
    -------
    SimulatedMotion

    Raises
    ------
    NotSimulatedError
        A mode of the arm is too fast for the integrator, or it does not finish.
    """
    plan = motion if plan is None else plan
    settings: dict[str, Any] = {"servo": servo, "ahead": ahead, "band": band, "method": method}
    if not arm.robot.tilts:
        return _simulate_joints(arm, motion, plan=plan, changes=changes, **settings)
    start = motion.at(0.0)[0]
    joints = BearingJoints(arm, start)
    found = _simulate_joints(
        joints.arm,
        joints.motion(motion),
        plan=joints.motion(plan),
        changes=[(time, BearingJoints(each, start).arm) for time, each in changes],
        **settings,
    )
    driven = {
        name: getattr(found, name)[:, joints.driven]
        for name in ("position", "velocity", "windup", "spring_torque")
    }
    return replace(found, **driven)


def _simulate_joints(
    arm: ElasticArm,
    motion: MotorMotion,
    *,
    servo: Servo | None,
    ahead: float,
    band: float,
    method: str,
    plan: MotorMotion,
    changes: Sequence[tuple[float, ElasticArm]],
) -> SimulatedMotion:
    """Simulate an arm with rigid bearings."""
    end = motion.duration + (REST if motion.ends_at_rest else 0.0)
    motor = motion if servo is None else servo.follow(motion, end, ahead)
    # At rest the integrator would choose steps too long to notice the onset of vibration.
    start, speed = motor.at(0.0)
    arms = [arm, *(each for _, each in changes)]
    longest = 1.0 / max(check_reach(each, start) for each in arms)
    n = arm.robot.n
    times = _sample_times(motion.duration, end)
    equations = [_Equations(each, motor) for each in arms]
    resting = arm.at_first_instant().static_equilibrium(start[None])[0]
    state = np.concatenate([resting, speed, np.zeros(equations[0].loops)])
    parts, errors = [], []
    breaks = [0.0, *(time for time, _ in changes), motion.duration]
    spans = [
        (begin, stop, number)
        for number, (begin, stop) in enumerate(itertools.pairwise(breaks))
        if stop > begin
    ]
    if end > motion.duration:
        spans.append((motion.duration, end, len(arms) - 1))
    followed = motor.position(times)
    for begin, stop, number in spans:
        # Restarted just after arrival and changes: accelerations may jump there.
        begin = begin if begin == 0.0 else float(np.nextafter(begin, np.inf))
        chosen = (times >= begin) & (times <= stop)
        found = _integrate_states(
            equations[number], begin, state, np.append(times[chosen], stop), longest, method
        )
        state = found[-1]
        parts.append(found[:-1])
    states = np.concatenate(parts)
    q = np.where(arm.elastic, states[:, :n], followed)
    for number, each in enumerate(arms):
        after, until = breaks[number], breaks[number + 1] if number + 1 < len(arms) else np.inf
        chosen = ((times > after) | (number == 0)) & (times <= until)
        if not chosen.any():
            continue
        at = times[chosen]
        errors.append(each.tool_error(at, plan.duration, q[chosen], plan.position(at)))
    windup = followed - q
    torque = equations[0].spring_torque(windup, states[:, 2 * n :])
    error = errors[0] if len(errors) == 1 else join_tool_errors(errors)
    return SimulatedMotion(
        error=error,
        position=q,
        velocity=states[:, n : 2 * n],
        windup=windup,
        spring_torque=torque,
        band=band,
        notes=(
            *_note_rigid_joints(arm),
            *_note_following_joints(arm),
            *_note_torques_beyond_law(arm, times, torque),
            *_note_laws(arm),
            *_note_hysteresis(arm, q[-1], float(error.distance.max())),
        ),
    )


def _integrate_states(
    equations: _Equations,
    begin: float,
    state: np.ndarray,
    times: np.ndarray,
    longest: float,
    method: str,
) -> np.ndarray:
    """Integrate to states (K, m) at the times, in steps of at most `longest`."""
    errors = np.repeat(_ABSOLUTE_TOLERANCES, equations.joints)[: len(state)]
    if method:
        span, limits = (
            (begin, times[-1]),
            {"rtol": _RELATIVE_TOLERANCE, "atol": errors, "max_step": longest},
        )
        solved = scipy.integrate.solve_ivp(
            equations, span, state, method, t_eval=np.unique(times), **limits
        )
        reached, message = float(solved.t[-1]), "" if solved.success else solved.message
        states = solved.y.T[np.searchsorted(solved.t, times)] if solved.success else solved.y.T
    else:
        with warnings.catch_warnings():
            # Reported by the message below.
            warnings.simplefilter("ignore", scipy.integrate.ODEintWarning)
            states, told = scipy.integrate.odeint(
                equations.slope(),
                state,
                np.append(begin, times),
                tfirst=True,
                rtol=_RELATIVE_TOLERANCE,
                atol=errors,
                hmax=longest,
                mxstep=_MAX_INTEGRATOR_STEPS,
                tcrit=times[-1:],
                full_output=True,
            )
        states, reached = states[1:], float(told["tcur"][-1])
        message = "" if told["message"].startswith("Integration success") else told["message"]
    if message:
        raise NotSimulatedError(
            f"the elastic arm could not be followed beyond {reached:.4g} s: {message} Check "
            "stiffness, masses and hysteresis."
        )
    return np.asarray(states)


class _Equations:
    """Time derivative of the state: link positions, velocities, hysteresis if any.

    Attributes
    ----------
    joints : int
    loops : int
        State variables of the hysteresis.
    """

    def __init__(self, arm: ElasticArm, motor: MotorMotion) -> None:
        self._arm, self._motor = arm, motor
        self._note_rigid_joints = np.flatnonzero(~arm.elastic)
        self._free = np.flatnonzero(arm.elastic)
        springs = list(enumerate(arm.springs))
        self._springs = [(j, spring) for j, spring in springs if spring is not None]
        self._law = [
            _zero_torque if spring is None else spring.torque_alone for spring in arm.springs
        ]
        # Friction torque that gives the loop its half width.
        self._friction = np.array(
            [
                0.0 if spring is None else spring.torque_at(half)[0]
                for spring, half in zip(arm.springs, arm.hysteresis.tolist(), strict=True)
            ]
        )
        self._loops = np.flatnonzero(self._friction > 0.0)
        self.joints = arm.robot.n
        self.loops = self.joints if self._loops.size else 0
        self._pushed = bool(arm.process_force.any())

    def slope(self) -> native.StateDerivative:
        """Function (t, state) -> time derivative, of the compiled core where available."""
        made = native.core(self.joints)
        arm = self._arm
        on_work = arm.path_force is not None and arm.robot.tool.seen_from is not None
        if made is None or on_work or arm.robot.added_torques:
            return self.__call__
        return native.state_derivative(made, self._arm, self._motor, self._friction, self.loops)

    def __call__(self, t: float, state: np.ndarray) -> np.ndarray:
        arm, n = self._arm, self.joints
        motor, speed = self._motor.at(t)
        q, v = state[:n], state[n : 2 * n]
        if self._note_rigid_joints.size:
            q, v = np.where(arm.elastic, q, motor), np.where(arm.elastic, v, speed)
        rate = speed - v
        # Python floats: faster than arrays for six springs.
        turns = (motor - q).tolist()
        torque = np.array([spring(turn) for spring, turn in zip(self._law, turns, strict=True)])
        if arm.robot.added_torques:
            torque -= self._added_torque(t, motor, speed, torque)
        torque += arm.damping * rate
        slope = np.zeros(len(state))
        if self._loops.size:
            loop, own = state[2 * n :], self._loops
            torque += self._friction * loop
            turned = rate[own] / arm.hysteresis[own]
            slope[2 * n + own] = turned - loop[own] * np.abs(turned)
        if self._pushed:
            torque += arm.force_torque(q)
        if arm.path_force is not None:
            force = arm.path_force(np.array(t))
            torque += arm.bodies.jacobian(arm.robot.tool, q)[:3].T @ force
        slope[:n] = v
        slope[n : 2 * n] = self._link_acceleration(t, q, v, torque)
        return slope

    def _added_torque(
        self, t: float, motor: np.ndarray, speed: np.ndarray, spring: np.ndarray
    ) -> np.ndarray:
        """Torque (n,) of the laws on the links, which the springs (n,) carry too."""
        accelerated = self._motor.acceleration(t)
        added = np.zeros_like(spring)
        for _ in range(_LOAD_CORRECTIONS):
            added = self._arm.added_torque(motor, speed, accelerated, spring - added)
        return added

    def _link_acceleration(
        self, t: float, q: np.ndarray, v: np.ndarray, torque: np.ndarray
    ) -> np.ndarray:
        bodies, free = self._arm.bodies, self._free
        if not self._note_rigid_joints.size:
            return bodies.acceleration(q, v, torque)
        # Accelerations of rigid joints are prescribed by their motors.
        driven = np.where(self._arm.elastic, 0.0, self._motor.acceleration(t))
        if free.size:
            left = (torque - bodies.torque(q, v, driven))[free]
            driven[free] = np.linalg.solve(bodies.inertia_matrix(q)[np.ix_(free, free)], left)
        return driven

    def spring_torque(self, windup: np.ndarray, loop: np.ndarray) -> np.ndarray:
        """Torques (K, n) [N m] of the springs with their hysteresis, without damping."""
        torque = self._friction * loop if self.loops else np.zeros_like(windup)
        for j, spring in self._springs:
            torque[:, j] += spring.torque(windup[:, j])
        return torque


def _zero_torque(_: float) -> float:
    return 0.0


def _sample_times(duration: float, end: float) -> np.ndarray:
    flight = np.linspace(0.0, duration, max(2, int(np.ceil(duration / SAMPLE_INTERVAL)) + 1))
    if end <= duration:
        return flight
    rest = np.linspace(duration, end, int(np.ceil((end - duration) / SAMPLE_INTERVAL)) + 1)
    return np.concatenate([flight, rest[1:]])


def check_reach(arm: ElasticArm, motor: np.ndarray) -> float:
    """Frequency [Hz] of the fastest mode at a motor position (n,), at least 1 Hz.

    Raises `NotSimulatedError`: too fast for the integrator.
    """
    fastest = max(modes(arm, motor), key=lambda mode: mode.frequency, default=None)
    if fastest is None:
        return 1.0
    if fastest.frequency > _MAX_MODE_FREQUENCY:
        joint = arm.robot.joint_names[int(np.argmax(fastest.shares))]
        raise NotSimulatedError(
            f"a mode of {fastest.frequency:.4g} Hz, mostly of {joint}, lies beyond the reach of "
            f"the integration, {_MAX_MODE_FREQUENCY:g} Hz. Leave the drivetrain of that joint out "
            "(rigid), or check its stiffness and the inertia behind it."
        )
    return max(fastest.frequency, 1.0)


def _note_rigid_joints(arm: ElasticArm) -> list[str]:
    stiff = [
        name
        for j, name in enumerate(arm.robot.joint_names, start=1)
        if arm.springs[j - 1] is None and j not in arm.following
    ]
    if not stiff:
        return []
    return [
        f"Taken as rigid, since the robot file gives no elements: {', '.join(stiff)}. Their"
        " elasticity adds to the deviation."
    ]


def _note_following_joints(arm: ElasticArm) -> list[str]:
    if not arm.following:
        return []
    names = ", ".join(arm.robot.joint_names[j - 1] for j in arm.following)
    return [
        f"{names}: single-joint vibration above {MIN_FOLLOWING_FREQUENCY:g} Hz, taken as rigid."
    ]


def _note_torques_beyond_law(arm: ElasticArm, times: np.ndarray, torque: np.ndarray) -> list[str]:
    notes = []
    for j, spring in enumerate(arm.springs):
        beyond = np.array([]) if spring is None else np.abs(torque[:, j]) > spring.torque_reach
        if spring is not None and beyond.any():
            notes.append(
                f"{arm.robot.joint_names[j]} passes {spring.torque_reach:.4g} N m at "
                f"{times[int(np.argmax(beyond))]:.3f} s, where its connections slip or the table "
                "of its law ends; beyond, its spring is linear."
            )
    return notes


def _note_laws(arm: ElasticArm) -> list[str]:
    notes = []
    for in_spring, text in (
        (True, "Torques on the links by laws of the motors' motion and the load"),
        (False, "Without influence, since the motors are position-controlled"),
    ):
        own = [each.label for each in arm.robot.added_torques if each.in_spring == in_spring]
        if own:
            notes.append(f"{text}: {', '.join(own)}.")
    return notes


def typical_hysteresis(arm: ElasticArm, q: np.ndarray) -> float | None:
    """Largest tool offset from equilibrium at q (n,) by hysteresis of typical width [m].

    None where the arm's own hysteresis is known, or no elastic joint is revolute.
    """
    turning = arm.elastic & ~arm.robot.prismatic
    if arm.hysteresis.any() or not turning.any():
        return None
    return _tool_offset_of_loops(arm, q, TYPICAL_HALF_LOOP * turning)


def _tool_offset_of_loops(arm: ElasticArm, q: np.ndarray, half: np.ndarray) -> float:
    columns = np.abs(arm.bodies.jacobian(arm.robot.tool, q)[:3] * half)
    return float(np.linalg.norm(columns.sum(axis=1)))


def _note_hysteresis(arm: ElasticArm, q: np.ndarray, peak: float) -> list[str]:
    if not arm.hysteresis.any():
        return []
    reach = _tool_offset_of_loops(arm, q, arm.hysteresis)
    share = f", {100.0 * reach / peak:.0f} % of the peak" if peak > 0.0 else ""
    return [
        f"The hysteresis of the joints alone may hold the tool up to {1e3 * reach:.3g} mm from "
        f"its static equilibrium at the end{share}."
    ]
