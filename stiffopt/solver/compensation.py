"""The command that makes the links of an elastic arm do what was planned, judged by the worst case.

The links are to do the plan; the motors lead them by the wind-up of the torque that this needs
(decision 0028). A plan that is not smooth enough is replaced by the nearest spline that is. How
fine the spline is, and how much of the nominal wind-up the motors lead by, is chosen so that the
tool deviates least on the worst arm that the problem's uncertainties allow: wind-up goes with one
over the stiffness, so that its middle lies above the nominal one.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from stiffopt.certificate.assess import assess, drive_history
from stiffopt.certificate.violations import CERTIFIED, find_drive_violations
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import REST, simulate
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.elastic.uncertain_arms import (
    ArmDeviations,
    Member,
    SimulationRequest,
    UncertainArms,
    simulate_uncertain_arms,
)
from stiffopt.elastic.uncertainty import (
    Departure,
    corners,
    departure_at_bounds,
    draw_departures,
    one_at_a_time,
)
from stiffopt.problem.motor_model import LEADS_MORE, MotorLaw, law_smoothing
from stiffopt.result.compensation import CompensatedMotion, Compensation, Spread, Spreads
from stiffopt.result.compensation_store import COMMAND_FILE
from stiffopt.result.store import export_times
from stiffopt.result.trajectory import JointMotion, Trajectory
from stiffopt.solver.corners import widened

if TYPE_CHECKING:
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.elastic.motor import Servo
    from stiffopt.elastic.uncertainty import Uncertainty
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Violation
    from stiffopt.result.simulation import SimulatedMotion
    from stiffopt.solver.simulation import PlannedMotion

# Of the knots of the splines that are tried [s], and shares of the nominal wind-up: a plan that is
# chosen for other arms leaves room for the second.
_SPACINGS = (0.005, 0.01, 0.02, 0.04)
_SHARES = (1.0, 1.0 + LEADS_MORE, 1.06, 1.09)
# Of the grid on which the splines are tried; the chosen one is judged on the certificate's.
_COARSE = 1001

# Objectives whose links are planned.
_OF_LINKS = ("shaped_deviation", "tool_deviation")

Progress = Callable[[str], object]
Answer = TypeVar("Answer")
# What asks for the swings of members on the way to its answer: those of several are simulated
# together, which costs little more than one alone.
Asking = Generator[SimulationRequest, ArmDeviations, Answer]


def compensate(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motions: Sequence[PlannedMotion],
    *,
    known: CommandOnArms | None = None,
    progress: Progress | None = None,
) -> Compensation:
    """Command of the first motion, and what compensation gives of all of them.

    Parameters
    ----------
    problem : TrajectoryProblem
        At rest at both ends.
    arm : ElasticArm
    motions : sequence of PlannedMotion
        The optimised one first.
    known : CommandOnArms, optional
        Of the first motion, where that is known already.
    progress : callable, optional
        Called with the name of each motion before it is compensated.

    Raises
    ------
    NotSimulatedError
        The arm cannot be simulated.
    RobotError
        An uncertainty takes a joint's damping above critical.
    """
    first, law = ([], None) if known is None else ([known], known.law)
    others = motions[len(first) :]
    found = [*first, *commands_on_arms(problem, arm, others, law, progress=progress)]
    own = found[0]
    refusal, command = _refusal(problem, own.excess), None
    if not refusal:
        command = assess(problem, own.motors, times=export_times(own.motors.duration))
    return Compensation(
        motions=tuple(each.shown() for each in found),
        command=command,
        refusal=refusal,
        uncertainty=problem.uncertainty.statements(arm.robot.payload is not None),
        draws=problem.uncertainty.draws,
    )


def recompensated(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motions: Sequence[PlannedMotion],
    made: MadeCommand,
    *,
    uncertainty: Uncertainty | None = None,
    damping: float | None = None,
    servo: Servo | None = None,
    file: str = COMMAND_FILE,
) -> Compensation:
    """As `compensate`, with a command of the first motion that exists already.

    Commands of the others are chosen as its own was: by the problem's uncertainties and the arm as
    modelled. All are judged by what is asked now.

    Parameters
    ----------
    problem, arm, motions : as of `compensate`
    made : MadeCommand
    uncertainty : Uncertainty, optional
        To judge by, in place of the problem's.
    damping : float, optional
        Of all joints that yield, as a share of critical, to judge by.
    servo : Servo, optional
        How the motors of every arm follow; what is uncertain of servos does not count then.
    file : str
        Where the command lies, for reports.
    """
    law = MotorLaw(problem.robot, problem.process_force)
    own, *others = motions
    chosen = _answered([_begun(_Compensator(problem, arm, each, law).chosen()) for each in others])
    problem = problem if uncertainty is None else replace(problem, uncertainty=uncertainty)
    arm = arm if damping is None else arm.damped(damping)
    asking = [_begun(_Compensator(problem, arm, own, law, made.plan, servo).given(made))]
    asking += [
        _begun(_Compensator(problem, arm, motion, law, servo=servo).given(command))
        for motion, command in zip(others, chosen, strict=True)
    ]
    found = _answered(asking)
    return Compensation(
        motions=tuple(each.shown() for each in found),
        command=None,
        refusal="",
        uncertainty=problem.uncertainty.statements(
            arm.robot.payload is not None, servo=servo is None
        ),
        draws=problem.uncertainty.draws,
        loop="" if servo is None else str(servo),
        file=file,
    )


def commands_on_arms(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    motions: Sequence[PlannedMotion],
    law: MotorLaw | None = None,
    *,
    progress: Progress | None = None,
) -> list[CommandOnArms]:
    """Commands of motions on all arms, without what only reports show.

    Parameters as above; `law` is that of the problem's motors, where it is made already.
    """
    law = law or MotorLaw(problem.robot, problem.process_force)
    asking = []
    for motion in motions:
        if progress is not None:
            progress(motion.name)
        asking.append(_begun(_Compensator(problem, arm, motion, law).on_arms()))
    return _answered(asking)


def compensated(
    problem: TrajectoryProblem, arm: ElasticArm, motion: PlannedMotion
) -> tuple[CompensatedMotion, JointMotion]:
    """What compensation gives of one motion, and the motors' command; parameters as above."""
    (found,) = commands_on_arms(problem, arm, [motion])
    return found.shown(), found.motors


def _begun(asking: Asking[Answer]) -> tuple[Asking[Answer], SimulationRequest]:
    """One that has come to what it asks first."""
    return asking, next(asking)


def _answered(begun: Sequence[tuple[Asking[Answer], SimulationRequest]]) -> list[Answer]:
    """The answers of several: what all of them ask is simulated together, round by round."""
    asked = dict(begun)
    answers: dict[Asking[Answer], Answer] = {}
    while asked:
        swings = simulate_uncertain_arms(list(asked.values()))
        for asking, own in zip(list(asked), swings, strict=True):
            try:
                asked[asking] = asking.send(own)
            except StopIteration as ended:
                answers[asking] = ended.value
                del asked[asking]
    return [answers[asking] for asking, _ in begun]


def _refusal(problem: TrajectoryProblem, excess: tuple[Violation, ...]) -> str:
    if not excess:
        return ""
    limits = " and ".join(dict.fromkeys(f"limits.scale.{each.limit}" for each in excess))
    named = "; ".join(each.describe() for each in excess)
    others = [name for name in _OF_LINKS if all(name != o.name for o in problem.objectives)]
    other = f"Minimise {' or '.join(others)}, which plan{'s' * (len(others) == 1)} the links"
    return (
        f"No command.csv: to make the links do this motion, the motors would exceed {named}. "
        f"{other} within the motors' limits, give a longer duration, or plan with lower {limits}."
    )


@dataclass(frozen=True, eq=False)
class MadeCommand:
    """A command, as it was made earlier.

    Parameters
    ----------
    motors : JointMotion
        Motion of the motors, with that of the links as its `link`.
    plan : MotorMotion
        What the links are to do.
    spacing : float or None
        As of `CompensatedMotion`.
    share : float
    """

    motors: JointMotion
    plan: MotorMotion
    spacing: float | None
    share: float


@dataclass(frozen=True, eq=False)
class CommandOnArms:
    """A command on the arm as modelled, at its bounds and as drawn.

    Parameters
    ----------
    motion : PlannedMotion
    motors : JointMotion
        The command.
    planned, compensated : Spreads
        Of the motion as it is planned, and of the command.
    nominal, worst : Departure
        The arm as modelled, and the one on which the command deviates most in flight.
    spacing, share : as of `CompensatedMotion`
    excess : tuple of Violation
        Limits of the motors that the command exceeds.
    simulated : callable
        The whole swing of the command on an arm.
    law : MotorLaw
        By which the command was made.
    """

    motion: PlannedMotion
    motors: JointMotion
    planned: Spreads
    compensated: Spreads
    nominal: Departure
    worst: Departure
    spacing: float | None
    share: float
    excess: tuple[Violation, ...]
    simulated: Callable[[Departure], SimulatedMotion]
    law: MotorLaw

    @property
    def at_worst(self) -> float:
        """Peaks of the command on the worst arm, in flight and after arrival together [m]."""
        led = self.compensated
        return np.inf if self.excess else led.flight.worst + led.after.worst

    def shown(self) -> CompensatedMotion:
        """With its swings, which reports show."""
        optimised = self.motion.name == "optimised"
        return CompensatedMotion(
            name=self.motion.name,
            planned=self.planned,
            compensated=self.compensated,
            simulated=self.simulated(self.nominal),
            worst=self.simulated(self.worst) if optimised else None,
            spacing=self.spacing,
            share=self.share,
            excess=self.excess,
        )


@dataclass(frozen=True, eq=False)
class _Lead:
    """Motors that lead a smooth motion of the links.

    Parameters
    ----------
    link : Trajectory
    motors : Trajectory
        With all of the nominal wind-up.
    spacing : float or None
    """

    link: Trajectory
    motors: Trajectory
    spacing: float | None

    def command(self, share: float) -> Trajectory:
        """Motion of the motors with a share of the wind-up."""
        if share == 1.0:
            return self.motors
        times = self.motors.times
        derivatives = [
            (1.0 - share) * self.link(times, k) + share * self.motors(times, k) for k in range(4)
        ]
        return Trajectory.through(times, np.stack(derivatives), self.link)


class _Compensator:
    """One planned motion on the many arms; with a servo that is known, all of them have it."""

    def __init__(
        self,
        problem: TrajectoryProblem,
        arm: ElasticArm,
        motion: PlannedMotion,
        law: MotorLaw,
        plan: MotorMotion | None = None,
        servo: Servo | None = None,
    ) -> None:
        self._problem, self._arm, self._motion, self._law = problem, arm, motion, law
        self._follows = MotorMotion(motion.time, motion.position, motion.velocity)
        if plan is None:
            plan = self._follows if motion.link is None else MotorMotion.of(motion.link)
        self._plan, self._known = plan, servo
        self._servo = problem.uncertainty.servo if servo is None else servo
        self._many = UncertainArms(arm, self._plan, self._servo)
        self._carries = arm.robot.payload is not None
        self._loads: dict[tuple[JointMotion, int], np.ndarray] = {}
        (self._nominal,) = self._driven([Departure.none(arm.robot.n)])
        self._corners = self._driven(corners(self._unsure, arm.robot.n, self._carries))

    @property
    def _unsure(self) -> Uncertainty:
        unsure = self._problem.uncertainty
        if self._known is None:
            return unsure
        # One that follows exactly differs in nothing.
        return replace(unsure, servo_feed_forward=1.0, servo_delay=0.0)

    def _driven(self, arms: list[Departure]) -> list[Departure]:
        return arms if self._known is None else [replace(each, servo=1.0) for each in arms]

    def on_arms(self) -> Asking[CommandOnArms]:
        """The command, judged."""
        lead, share, signs = yield from self._chosen()
        return (yield from self._on_all(lead.command(share), signs, lead.spacing, share))

    def chosen(self) -> Asking[MadeCommand]:
        """The command alone."""
        lead, share, _ = yield from self._chosen()
        return MadeCommand(lead.command(share), self._plan, lead.spacing, share)

    def given(self, made: MadeCommand) -> Asking[CommandOnArms]:
        """A command that exists already, judged."""
        single = self._with_single(MotorMotion.of(made.motors))
        signs = self._worst_signs(*(yield from single))
        return (yield from self._on_all(made.motors, signs, made.spacing, made.share))

    def _on_all(
        self, motors: JointMotion, signs: list[Departure], spacing: float | None, share: float
    ) -> Asking[CommandOnArms]:
        """What a command gives on the arm as modelled, at its bounds, as drawn."""
        follows, plan, command = self._follows, self._plan, MotorMotion.of(motors)
        drawn = self._driven(draw_departures(self._unsure, self._arm.robot.n, self._carries))
        arms = [self._nominal, *self._corners, *signs, *drawn]
        members = [Member(command=follows, departure=each, reference=follows) for each in arms]
        members += [Member(command=command, departure=each, reference=plan) for each in arms]
        swings = yield SimulationRequest(self._many, members)
        count = len(arms)
        return CommandOnArms(
            motion=self._motion,
            motors=motors,
            planned=_spreads(swings.peak[:count], swings.peak_after[:count], arms, len(drawn)),
            compensated=_spreads(swings.peak[count:], swings.peak_after[count:], arms, len(drawn)),
            nominal=self._nominal,
            worst=arms[int(np.argmax(swings.peak[count:]))],
            spacing=spacing,
            share=share,
            excess=self._excess(motors),
            simulated=functools.partial(self._simulated, command),
            law=self._law,
        )

    def _chosen(self) -> Asking[tuple[_Lead, float, list[Departure]]]:
        """Spline and share of the least worst case; the worst signs of the joints' stiffness."""
        leads = self._leads()
        within = [lead for lead in leads if self._within(lead.motors)] or leads
        # A plan at a limit leaves nothing for more than its own wind-up.
        tried = [
            (lead, share)
            for lead in within
            for share in _SHARES
            if share == 1.0 or self._within(lead.command(share))
        ]
        commands = [MotorMotion.of(lead.command(share)) for lead, share in tried]
        signs = self._worst_signs(*(yield from self._with_single(commands[0])))
        arms = [*self._corners, *signs]
        members = [
            Member(command=own, departure=arm, reference=self._plan)
            for own in commands
            for arm in arms
        ]
        swings = yield SimulationRequest(self._many, members)
        shape = (len(commands), len(arms))
        flight = swings.peak.reshape(shape).max(axis=1)
        after = swings.peak_after.reshape(shape).max(axis=1)
        best = [tried[k] for k in np.argsort(flight + after, kind="stable")]
        # The coarse grid may step over what lasts less than its step, such as the jerk at an end.
        lead, share = next(
            (each for each in best if self._beyond_plan(each[0].command(each[1])) <= CERTIFIED),
            best[0],
        )
        return lead, share, signs

    def _leads(self) -> list[_Lead]:
        planned, own = self._motion.motors, []
        if planned is not None and planned.link is not None:
            # At a limit it cannot lead by more; a smoother one beside it may.
            own = [_Lead(planned.link, planned, None)]
        links = [(smooth_motion(self._plan, each), each) for each in _SPACINGS]
        smoothing = law_smoothing(self._problem)
        splines = [
            _Lead(
                link,
                widened(
                    functools.partial(self._law.motion, link),
                    functools.partial(self._beyond_plan, points=_COARSE),
                    smoothing,
                    CERTIFIED,
                ),
                spacing,
            )
            for link, spacing in links
        ]
        return [*own, *splines]

    def _with_single(self, command: MotorMotion) -> Asking[tuple[ArmDeviations, int]]:
        """The nominal arm, then those with one softer joint each; how many."""
        single = self._driven(one_at_a_time(self._unsure, self._arm.robot.n))
        arms = [self._nominal, *single]
        members = [Member(command=command, departure=arm, reference=self._plan) for arm in arms]
        return (yield SimulationRequest(self._many, members)), len(arms)

    def _worst_signs(self, swings: ArmDeviations, count: int) -> list[Departure]:
        """Arms whose joints are softer and stiffer such that their errors add up, to first order.

        The first member is the nominal arm, those up to `count` have one softer joint each.
        """
        unsure, found = self._unsure, []  # type: Uncertainty, list[Departure]
        share = swings.deviation[1:count] - swings.deviation[0]
        joints = np.flatnonzero(unsure.shares(self._arm.robot.n))
        for chosen in (swings.flight, ~swings.flight):
            own = share[:, chosen]
            # Along each joint's own error, all that point to the same side are added.
            along = np.sign(np.einsum("jkx,ikx->ijk", own, own))
            sums = np.linalg.norm(np.einsum("ijk,jkx->ikx", along, own), axis=2)
            if not sums.size:
                continue
            i, k = np.unravel_index(int(np.argmax(sums)), sums.shape)
            signs = np.zeros(self._arm.robot.n)
            signs[joints] = -along[i, :, k]
            payload = float(self._carries)
            found += [
                departure_at_bounds(
                    unsure, side * signs, -1.0, payload, float(unsure.servo is not None)
                )
                for side in (-1.0, 1.0)
            ]
        return self._driven(found)

    def _within(self, motors: Trajectory) -> bool:
        """Whether the limits that the plan keeps are kept; some no method of its kind can take."""
        return self._beyond_plan(motors, _COARSE) <= CERTIFIED

    def _beyond_plan(self, motors: Trajectory, points: int | None = None) -> float:
        """Largest excess of limits that the plan keeps."""
        excess = self._excess(motors, points)
        kept = [each.value for each in excess if each.limit not in self._motion.exceeded]
        return max(kept, default=0.0)

    def _excess(self, motors: JointMotion, points: int | None = None) -> tuple[Violation, ...]:
        """Limits of the motors that a motion of theirs exceeds, worst first.

        The others are of the plan, which the links keep.
        """
        # What the links do loads the springs alike, whatever share and corners the motors have.
        link = getattr(motors, "link", None) or motors
        times = None if points is None else np.linspace(0.0, motors.duration, points)
        known = None if points is None else self._loads.get((link, points))
        drives, loads = drive_history(self._problem, motors, times, known)
        if points is not None:
            self._loads[link, points] = loads
        found = find_drive_violations(self._problem, drives)
        return tuple(each for each in found if each.value > CERTIFIED)

    def _simulated(self, command: MotorMotion, departure: Departure) -> SimulatedMotion:
        arm, servo = self._arm.with_departure(departure), self._servo
        if servo is None or departure.servo == 0.0:
            return simulate(arm, command, reference=self._plan)
        late = servo.with_lag(command, command.duration + REST, departure.servo)
        return simulate(arm, late, reference=self._plan)


def _spreads(
    flight: np.ndarray, after: np.ndarray, arms: Sequence[Departure], drawn: int
) -> Spreads:
    """Of peaks (B,) on the arms: the nominal one first, those drawn last."""
    spreads = [
        Spread(
            nominal=float(peak[0]),
            worst=float(peak.max()),
            worst_case=arms[int(np.argmax(peak))].label,
            worst_arm=arms[int(np.argmax(peak))].factors(),
            draws=peak[len(arms) - drawn :],
        )
        for peak in (flight, after)
    ]
    return Spreads(flight=spreads[0], after=spreads[1])
