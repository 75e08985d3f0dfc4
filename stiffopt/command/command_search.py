"""Search for the motor command of one planned motion that deviates least on uncertain arms."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from stiffopt.certificate.assess import drive_history, drives_of
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE, find_drive_violations
from stiffopt.command.command_lead import (
    WINDUP_SHARES,
    CommandLead,
    ExistingCommand,
    force_lead,
    led_against_force,
)
from stiffopt.command.smoothing_width import KNOT_SPACINGS, motors_with_sufficient_smoothing
from stiffopt.elastic.bearings import LedPlan, bearing_lead
from stiffopt.elastic.led_error import worst_levels
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import REST, simulate
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import Departure, ParameterBox
from stiffopt.problem.formulation import law_smoothing
from stiffopt.problem.motor_model import MotorLaw
from stiffopt.result.compensation import CompensatedMotion, PartPeaks, Spread, Spreads
from stiffopt.result.trajectory import JointMotion, Trajectory

if TYPE_CHECKING:
    from stiffopt.command.simulation import PlannedMotion
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.elastic.servo import Servo
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import DriveHistory, Violation
    from stiffopt.result.simulation import SimulatedMotion

# Shares of the nominal wind-up that are tried: stiffness is not known to a hundredth.
_TRIED_SHARES = np.linspace(*WINDUP_SHARES, 11)
# Shares of the servo's known lag that are led: less where the whole exceeds a limit.
_SERVO_LEAD_SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
# Samples at which candidates are judged; the chosen one is judged on the certificate's grid.
_TRIAL_SAMPLES = 1001


# Knot spacing, share of the wind-up and share of the servo's lag of a command.
CommandChoice = tuple[float | None, float, float]


@dataclass(frozen=True, eq=False)
class CommandOnArms:
    """Command with its results on the arm as modelled, at its bounds and as drawn."""

    motion: PlannedMotion
    motors: JointMotion  # the command
    # Of the motion as it is planned, and of the command.
    planned: Spreads
    compensated: Spreads
    # The arm as modelled, and the one on which the command deviates most in flight.
    nominal: Departure
    worst: Departure
    spacing: float | None
    share: float
    servo_share: float
    excess: tuple[Violation, ...]  # limits of the motors that the command exceeds
    # Full elastic simulation of the command on an arm.
    simulated: Callable[[Departure], SimulatedMotion]
    law: MotorLaw  # by which the command was made

    @property
    def worst_case_peaks(self) -> float:
        """Sum of the command's peaks on the worst arms, in flight and after arrival [m]."""
        return np.inf if self.excess else self.compensated.worst_case

    def for_reports(self) -> CompensatedMotion:
        """Return the result for reports, with full simulations."""
        optimised = self.motion.name == "optimised"
        return CompensatedMotion(
            name=self.motion.name,
            planned=self.planned,
            compensated=self.compensated,
            simulated=self.simulated(self.nominal),
            worst=self.simulated(self.worst) if optimised else None,
            spacing=self.spacing,
            share=self.share,
            servo_share=self.servo_share,
            excess=self.excess,
        )


class CommandSearch:
    """Search for the command of one planned motion on many arms; a known servo is that of all.

    Commands lead the servo `led`, default that of the problem. `progress` is called with the name
    of the motion for each command.
    """

    def __init__(
        self,
        problem: TrajectoryProblem,
        arm: ElasticArm,
        motion: PlannedMotion,
        law: MotorLaw,
        servo: Servo | None = None,
        choice: CommandChoice | None = None,
        led: Servo | None = None,
        progress: Callable[[str], object] | None = None,
    ) -> None:
        self._choice, self._progress = choice, progress or (lambda _: None)
        self.problem, self._arm, self._motion, self._law = problem, arm, motion, law
        self._follows, self._plan = motion.followed, motion.planned_path
        self._servo = self._worst = servo or problem.servo
        if servo is None:
            self._worst = problem.uncertainty.worst_servo(problem.servo)
        self._led = led or problem.led_servo
        # Whatever loop follows them.
        self._ahead = self._led.dead_time
        self._many = UncertainArms(arm, self._plan, self._servo, self._worst, self._ahead)
        self._loads: WeakKeyDictionary[JointMotion, np.ndarray] = WeakKeyDictionary()
        self._worst_of: WeakKeyDictionary[JointMotion, list[Departure]] = WeakKeyDictionary()
        self._nominal = Departure.none(arm.robot.n)
        self._box = ParameterBox(problem.uncertainty, arm.robot, servo=self._worst != self._servo)

    def judge_existing(self, made: ExistingCommand) -> CommandOnArms:
        """Simulate a command on the arm as modelled, on the worst arms and as drawn."""
        self._progress(self._motion.name)
        follows, command = self._follows, MotorMotion.of(made.motors)
        worst, drawn = self._worst_arms(made.motors), self._box.drawn()
        arms = [self._nominal, *worst, *drawn]
        # Both on one arm, one after the other: they share its static equilibria.
        pairs = [Member(command=own, departure=each) for each in arms for own in (follows, command)]
        peaks = self._many.peaks(pairs)
        planned, led = (
            [{name: own[first::2] for name, own in phase.items()} for phase in peaks]
            for first in (0, 1)
        )
        return CommandOnArms(
            motion=self._motion,
            motors=made.motors,
            planned=_summarise_spreads(planned, arms, len(drawn)),
            compensated=_summarise_spreads(led, arms, len(drawn)),
            nominal=self._nominal,
            worst=arms[int(np.argmax(led[0]["position"]))],
            spacing=made.spacing,
            share=made.share,
            servo_share=made.servo_share,
            excess=self.motor_violations(made.motors),
            # Without the batch simulation, which keeps motions of minutes.
            simulated=functools.partial(
                _simulate_on,
                self._arm,
                (self._servo, self._worst),
                self._ahead,
                self._plan,
                command,
            ),
            law=self._law,
        )

    def chosen_command(self) -> ExistingCommand:
        """Choose the command of the least worst case, or as chosen before where limits allow it.

        Where none keeps the limits, the one of least excess, without a simulation.
        """
        if (made := self._command_as_chosen()) is not None:
            return made
        arms: list[Departure] = []
        kept: tuple[float, ExistingCommand | None] = (np.inf, None)  # peaks in flight and after
        # Excess of limits, of candidates and, where there is none, of whole leads.
        least: tuple[float, ExistingCommand | None] = (np.inf, None)
        beyond: tuple[float, ExistingCommand | None] = (np.inf, None)
        of_kept: _LeadWithinLimits | None = None
        for lead in map(self._lead_of, self._spacings):
            within = _LeadWithinLimits(self, lead)
            if not within.servo_shares:
                made = within.command(1.0, 0.0)
                excess = self.excess_beyond_plan(made.motors)
                beyond = (excess, made) if excess < beyond[0] else beyond
                continue
            self._progress(self._motion.name)
            arms = arms or self._worst_arms(within.command(1.0, within.servo_shares[0]).motors)
            for peaks, made in within.ranked(self._many, arms, kept[0]):
                # The trial grid may miss excesses shorter than its step, as of the jerk at an end.
                excess = self.excess_beyond_plan(made.motors)
                if excess <= CERTIFICATE_TOLERANCE:
                    kept, of_kept = (peaks, made), within
                    break
                least = (excess, made) if excess < least[0] else least
        if of_kept is not None and kept[1] is not None:
            # Other arms are the worst of it: shares are chosen again with these.
            arms = [*arms, *self._worst_arms(kept[1].motors)]
            for peaks, made in of_kept.ranked(self._many, arms):
                excess = 0.0 if made is kept[1] else self.excess_beyond_plan(made.motors)
                if excess <= CERTIFICATE_TOLERANCE:
                    kept = peaks, made
                    break
        found = kept[1] or least[1] or beyond[1]
        assert found is not None
        return found

    def _worst_arms(self, motors: JointMotion) -> list[Departure]:
        """Return the worst arms of a command, and the corners with joints alike."""
        if motors not in self._worst_of:
            worst = worst_levels(self._many, MotorMotion.of(motors), self._box)
            levels = (*worst, *self._box.alike_corners())
            self._worst_of[motors] = [self._box.departure(each) for each in levels]
        return self._worst_of[motors]

    def _command_as_chosen(self) -> ExistingCommand | None:
        """Return the command of the choice, None without one or where it exceeds a limit."""
        if self._choice is None or self._choice[0] not in self._spacings:
            return None
        spacing, share, servo_share = self._choice
        made = self._lead_of(spacing).command(share, servo_share)
        return made if self.excess_beyond_plan(made.motors) <= CERTIFICATE_TOLERANCE else None

    @property
    def _spacings(self) -> list[float | None]:
        """Knot spacings of the leads; None for the planned lead."""
        # At a limit the planned motion cannot lead by more; a smoother spline may.
        planned = self._motion.motors
        return [*([] if planned is None or planned.link is None else [None]), *KNOT_SPACINGS]

    def _lead_of(self, spacing: float | None) -> CommandLead:
        planned, own = self._motion.motors, self._bearing_lead
        if spacing is None and planned is not None and planned.link is not None:
            link, motors = planned.link, planned
            if own is not None:
                motors = planned.plus(own.held_for(planned.duration - own.duration))
        else:
            assert spacing is not None
            link = smooth_motion(self._plan if own is None else LedPlan(self._plan, own), spacing)
            motors = motors_with_sufficient_smoothing(
                functools.partial(self._law.motion, link),
                functools.partial(self.excess_beyond_plan, points=_TRIAL_SAMPLES),
                law_smoothing(self.problem),
                CERTIFICATE_TOLERANCE,
            )
        return self._against_force(CommandLead(link, motors, spacing, self._led))

    @functools.cached_property
    def _bearing_lead(self) -> Trajectory | None:
        """Motion of the joints by which the tool is led against the yielding of the bearings."""
        if not self._arm.robot.tilts:
            return None
        return bearing_lead(self._arm, self._plan)

    def _against_force(self, lead: CommandLead) -> CommandLead:
        """Return a lead that compensates the force along the path too."""
        force = self._arm.path_force
        if force is None:
            return lead
        added = force_lead(self.problem.robot, lead.link, force)
        motors = led_against_force(lead.motors, added, force)
        return replace(lead, link=replace(lead.link, force=force), motors=motors)

    def excess_beyond_plan(self, motors: JointMotion, points: int | None = None) -> float:
        """Return the largest excess of the limits that the plan keeps."""
        return self.largest_excess(self._drives(motors, points))

    def largest_excess(self, drives: DriveHistory) -> float:
        """Return the largest excess of the drives' limits that the plan keeps."""
        found = find_drive_violations(self.problem, drives)
        kept = [each.value for each in found if each.limit not in self._motion.exceeded]
        return max(kept, default=0.0)

    def motor_violations(self, motors: JointMotion) -> tuple[Violation, ...]:
        """Return the motor limits that a motion exceeds, worst first."""
        found = find_drive_violations(self.problem, self._drives(motors))
        return tuple(each for each in found if each.value > CERTIFICATE_TOLERANCE)

    def _drives(self, motors: JointMotion, points: int | None = None) -> DriveHistory:
        """Return the drives' motion and torques, by default on the certificate's grid."""
        # Spring torques follow from the links' motion: the same for all widths of the law.
        link = getattr(motors, "link", None) or motors
        times = None if points is None else np.linspace(0.0, motors.duration, points)
        known = None if points is None else self._loads.get(link)
        drives, loads = drive_history(self.problem, motors, times, known)
        if points is not None:
            self._loads[link] = loads
        return drives


class _LeadWithinLimits:
    """Commands of a lead that keep the plan's limits on a trial grid.

    Attributes
    ----------
    servo_shares : list of float
        Shares of the servo's lag that the limits allow beside the nominal wind-up, largest first.
    """

    def __init__(self, search: CommandSearch, lead: CommandLead) -> None:
        self._search, self._lead, corners = search, lead, lead.corners
        # One object for the same shares: what is known of it is kept by object.
        self.command = functools.cache(lead.command)
        self._times = np.linspace(0.0, corners[0].duration, _TRIAL_SAMPLES)
        _, self._loads = drive_history(search.problem, corners[0], self._times)
        self._corners = np.array([[each(self._times, k) for k in range(4)] for each in corners])
        shares = _SERVO_LEAD_SHARES[: 1 if lead.servo.leads_exactly else None]
        self.servo_shares = [each for each in shares if self._keeps_limits(1.0, each)]

    def ranked(
        self, many: UncertainArms, arms: Sequence[Departure], below: float = np.inf
    ) -> Iterator[tuple[float, ExistingCommand]]:
        """Yield peaks [m] below a bound and commands, in increasing order of peaks.

        Peaks are the largest on the arms, in flight plus after arrival.
        """
        shares = [(float(own), each) for each in self.servo_shares for own in _TRIED_SHARES]
        weights = np.array([self._lead.weights(*each) for each in shares])
        corners = [MotorMotion.of(each) for each in self._lead.corners]
        peaks = many.mixed_peaks(corners, arms, weights, below)
        for k in np.argsort(peaks, kind="stable"):
            if peaks[k] < below and self._keeps_limits(*shares[k]):
                yield float(peaks[k]), self.command(*shares[k])

    def _keeps_limits(self, share: float, servo_share: float) -> bool:
        moves = np.tensordot(self._lead.weights(share, servo_share), self._corners, 1)
        drives = drives_of(self._search.problem.robot, self._times, moves, self._loads)
        return self._search.largest_excess(drives) <= CERTIFICATE_TOLERANCE


def _simulate_on(
    arm: ElasticArm,
    servos: tuple[Servo, Servo],
    ahead: float,
    plan: MotorMotion,
    command: MotorMotion,
    departure: Departure,
) -> SimulatedMotion:
    """Simulate a command on a departure of an arm; `servos`: the nominal and the worst one."""
    late = _behind_servos(servos, ahead, command, departure.servo)
    return simulate(arm.with_departure(departure), late, plan=plan)


def _behind_servos(
    servos: tuple[Servo, Servo], ahead: float, command: MotorMotion, share: float
) -> MotorMotion:
    """Return the response to a command at a share of the way from one servo to another."""
    until = command.duration + REST
    motor = servos[0].follow(command, until, ahead)
    if share == 0.0:
        return motor
    worst, time = servos[1].follow(command, until, ahead), motor.time
    mixed = [(1.0 - share) * motor(time, order) + share * worst(time, order) for order in (0, 1)]
    return MotorMotion(time, mixed[0], mixed[1], command.duration)


def _summarise_spreads(
    phases: Sequence[dict[str, np.ndarray]], arms: Sequence[Departure], drawn: int
) -> Spreads:
    """Summarise the peaks of one command on the arms: the nominal one first, drawn ones last."""
    spreads = []
    for phase in phases:
        peak = phase["position"]
        worst = arms[int(np.argmax(peak))]
        spreads.append(
            Spread(
                nominal=float(peak[0]),
                worst=float(peak.max()),
                worst_case=worst.label,
                worst_arm=worst.factors(),
                draws=peak[len(arms) - drawn :],
                parts={
                    name: PartPeaks(nominal=float(own[0]), worst=float(own.max()))
                    for name, own in phase.items()
                    if name != "position"
                },
            )
        )
    return Spreads(flight=spreads[0], after=spreads[1])
