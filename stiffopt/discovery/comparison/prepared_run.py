"""Recorded runs with filtered signals, nominal predictions and samples for the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from math import comb

import numpy as np

from stiffopt.discovery.comparison.filtering import (
    PoseFilter,
    ZeroPhaseFilter,
    bridge_gaps,
    derivative,
    interpolate_motion,
    near_gaps,
    resample_uniform,
)
from stiffopt.discovery.comparison.nominal_robot import LazyArmSignals, RobotModel
from stiffopt.discovery.comparison.springs import SpringLaw, Springs
from stiffopt.discovery.comparison.vibration import LinkMotion, Vibration, slow_filter
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.signals import (
    JointSignals,
    RobotConstants,
    RobotSignals,
    mean_sign,
    smooth_sign,
)
from stiffopt.recording.channel import DEVIATION_PER_MAD, resolution
from stiffopt.recording.run import Interval, RecordedRun, delayed_command

# Range of the cutoff of the motors' motion [Hz]: wider than the fit's filter, which all derived
# signals pass later.
MIN_MOTOR_CUTOFF, MAX_MOTOR_CUTOFF = 60.0, 150.0
# Largest share of the rated torque that noise of the motor acceleration may reach; largest cutoff
# over the sampling rate.
_MAX_NOISE_TORQUE_SHARE, _MAX_CUTOFF_OVER_RATE = 1e-3, 0.36
# Order of the difference of samples in which only noise remains.
_NOISE_DIFFERENCES = 5
# Highest mode of an initial vibration over the cutoff of the fit's filter.
_MODE_BAND_OVER_CUTOFF = 1.5
# Iterations of link motion = motor motion - wind-up; each reduces the error by (f/resonance)^2.
_WINDUP_ITERATIONS = 3


def motor_cutoff(robot: RobotModel, position: np.ndarray, dt: float) -> float:
    """Return the cutoff of the motors' motion [Hz], as high as encoder noise allows.

    At reversals friction and acceleration torque jump against each other within milliseconds:
    filtering one and not the other leaves a residual. Encoder noise limits the cutoff, since
    accelerations multiply it by the square of the frequency.

    `position` (K, n): recorded motor positions [rad]. `dt` [s].
    """
    # Torque of white encoder noise after two derivatives and a filter [N m/Hz^2.5].
    noise = (2.0 * np.pi) ** 2 * np.sqrt(0.4 * dt) * robot.rotor_inertia * _sample_noise(position)
    borne = np.array(
        [_MAX_NOISE_TORQUE_SHARE * joint.torque_rated for joint in robot.constants.joints]
    )
    if not np.all(np.isfinite(borne) & np.isfinite(noise)):
        return min(MIN_MOTOR_CUTOFF, _MAX_CUTOFF_OVER_RATE / dt)
    with np.errstate(divide="ignore"):
        bears = float(np.min(borne / noise)) ** 0.4
    return min(
        float(np.clip(bears, MIN_MOTOR_CUTOFF, MAX_MOTOR_CUTOFF)), _MAX_CUTOFF_OVER_RATE / dt
    )


def _sample_noise(samples: np.ndarray) -> np.ndarray:
    """Return the standard deviations (n,) of white noise estimated from high-order differences."""
    apart = np.diff(samples, _NOISE_DIFFERENCES, axis=0)
    size = [
        np.median(np.abs(moved)) if (moved := own[np.isfinite(own) & (own != 0.0)]).size else 0.0
        for own in apart.T
    ]
    return np.asarray(
        DEVIATION_PER_MAD
        * np.array(size)
        / np.sqrt(comb(2 * _NOISE_DIFFERENCES, _NOISE_DIFFERENCES))
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedRun:
    """Run with filtered signals and the nominal prediction."""

    robot: RobotModel
    name: str
    role: str
    index: int  # index among the compared runs
    time: np.ndarray  # (K,) uniform clock [s]
    signals: RobotSignals  # filtered motion and nominal torques
    # torque, deflection (K, n): measured drive torque, and motor minus link angle; not filtered;
    # nan where missing.
    torque: np.ndarray
    deflection: np.ndarray
    # (n,) one count of a quantised torque [N m]; 0 where it lies on no grid.
    torque_count: np.ndarray
    # torque_used, deflection_used (K, n) of bool: samples that a fit uses.
    torque_used: np.ndarray
    deflection_used: np.ndarray
    moving: np.ndarray  # (K, n) of bool, True where the joint is faster than `settings.slow`
    low_pass: ZeroPhaseFilter  # filter of the fit
    # Filter of the motion and of friction torques: the motor acceleration at a jump of friction
    # would otherwise leave a residual.
    motion_filter: ZeroPhaseFilter
    # Linear vibration response of the links; None where they follow quasi-statically.
    vibration: Vibration | None = None
    # (K, n) deflection from extensions in addition to the nominal wind-up of the spring torque
    # [rad].
    added_deflection: np.ndarray | float = 0.0
    # (K, n) share of the deflection that is free travel between flanks [rad].
    play: np.ndarray | float = 0.0
    # (2 n,) initial displacement and velocity of the links relative to their slow motion, where
    # known.
    initial_state: np.ndarray | None = None
    at_rest: bool = False  # samples are poses at rest
    # This run with the extensions that were simulated last.
    extension_cache: dict[tuple[object, ...], PreparedRun] = field(default_factory=dict, init=False)
    _joints: dict[int, JointSignals] = field(default_factory=dict, init=False)
    _compliance: dict[int, np.ndarray] = field(default_factory=dict, init=False)

    @property
    def links(self) -> LinkMotion:
        """Motion of the links and its torques."""
        s = self.signals
        return LinkMotion(
            s.link_position,
            s.link_velocity,
            s.link_acceleration,
            s.transmitted_torque,
            s.spring_torque,
        )

    def of_joint(self, index: int) -> JointSignals:
        """Return the signals of one joint (0-based), contiguous in memory."""
        if index not in self._joints:
            self._joints[index] = self.signals.of_joint(index)
        return self._joints[index]

    def compliance(self, index: int) -> np.ndarray:
        """Return the nominal tangent compliance of one joint (0-based) (K,) [rad/(N m)]."""
        if index not in self._compliance:
            torque = self.of_joint(index).spring_torque
            self._compliance[index] = np.asarray(
                self.robot.constants.joints[index].compliance(torque)
            )
        return self._compliance[index]

    def shows_displacement(self, joint: int) -> bool:
        """Return True where a displaced link shows by its torque alone: no encoder measures it.

        Links that vibrate respond to a displacement themselves.
        """
        return self.vibration is None and not self.deflection_used[:, joint].any()

    def initial_states(self, band: float | None = None) -> np.ndarray:
        """Return initial states (2 n, m) of likely vibrations up to a band [Hz].

        Displacements, then velocities. Default band: modes that the filter of the fit passes in
        part.
        """
        assert self.vibration is not None
        wound = self.signals.motor_position - self.signals.link_position
        return self.vibration.initial_states(
            wound, band or _MODE_BAND_OVER_CUTOFF * self.low_pass.cutoff
        )

    def head(self, count: int) -> PreparedRun:
        """Return the run up to a sample."""
        added, play = (
            each[:count] if isinstance(each, np.ndarray) else each
            for each in (self.added_deflection, self.play)
        )
        return replace(
            self,
            time=self.time[:count],
            signals=self.signals.head(count),
            torque=self.torque[:count],
            deflection=self.deflection[:count],
            torque_used=self.torque_used[:count],
            deflection_used=self.deflection_used[:count],
            moving=self.moving[:count],
            added_deflection=added,
            play=play,
        )

    def springs(
        self, damping: np.ndarray | None = None, laws: Mapping[int, SpringLaw] | None = None
    ) -> Springs:
        """Return the springs of this run, with other damping and laws if given."""
        s = self.signals
        return Springs(self.robot, s.motor_position, s.motor_velocity, s.dt, damping, laws)

    def respond(
        self, loads: Sequence[tuple[np.ndarray | None, np.ndarray | None]]
    ) -> list[tuple[np.ndarray | None, np.ndarray | None]]:
        """Return changes of torque and deflection between motor and link (K, n), or None, by load.

        `loads` (K, n): added torque on the links [N m], and displacement of the springs' ends
        [rad].
        """
        if self.vibration is not None:
            return self.vibration.respond(loads)
        if all(link_torque is None for link_torque, _ in loads):
            return list(loads)
        compliance = self.robot.compliance(self.signals.spring_torque)
        found: list[tuple[np.ndarray | None, np.ndarray | None]] = []
        for link_torque, deflection in loads:
            wound = deflection
            if link_torque is not None:
                wound = compliance * link_torque
                wound = wound if deflection is None else wound + deflection
            found.append((link_torque, wound))
        return found


def _within_intervals(time: np.ndarray, intervals: Sequence[Interval]) -> np.ndarray | None:
    """Return 1 at the instants (K,) within intervals, else 0; None without intervals."""
    if not intervals:
        return None
    inside = np.zeros(len(time))
    for begin, end in intervals:
        inside[(time >= begin) & (time <= end)] = 1.0
    return inside


def prepare_run(
    robot: RobotModel,
    run: RecordedRun,
    index: int,
    constants: RobotConstants | None,
    settings: Settings,
    *,
    vibrating: bool = True,
) -> PreparedRun:
    """Filter a run and evaluate the nominal model along it.

    `constants`: constants of the training runs; None takes the ranges of this run alone.
    `vibrating`: let links vibrate where the nominal model determines how; else they follow
    quasi-statically.
    """
    if run.at_rest:
        return _prepare_poses(robot, run, index, constants)
    time, position, link, torque = resample_uniform(run)
    dt = float(time[1] - time[0])
    low_pass = ZeroPhaseFilter(1.0 / dt, min(settings.fit_band, 0.2 / dt))
    followed = interpolate_motion(time, position, time)
    vibrating = vibrating and robot.vibrates
    wide = low_pass
    if vibrating:
        # All derived signals pass the fit's filter later: once, as the readings do.
        cutoff = max(low_pass.cutoff, motor_cutoff(robot, position, dt))
        wide = ZeroPhaseFilter(1.0 / dt, cutoff)
    motor = wide.filter_motion(followed)
    velocity = derivative(motor, dt)
    acceleration = derivative(velocity, dt)
    slow = slow_filter(dt) if vibrating else low_pass
    followed = slow.filter_motion(followed)
    links, vibration = quasi_static_links(robot, followed, dt, slow), None
    if vibrating:
        links, vibration = _vibrating_links(robot, motor, followed - links.position, links, slow)
    if vibration is None:
        # Contiguous columns spare a copy for the effects of each joint.
        links = LinkMotion(
            *(np.asfortranarray(getattr(links, part.name)) for part in fields(LinkMotion))
        )
        motor, velocity, acceleration = map(np.asfortranarray, (motor, velocity, acceleration))
    direction = smooth_sign(velocity) if vibration is None else mean_sign(velocity)
    friction = robot.friction(velocity, direction)
    if vibration is not None:
        friction = wide(friction)
    drive = robot.rotor_inertia * acceleration + links.torque + friction
    signals = _nominal_signals(
        robot, run, constants, time, dt, (motor, velocity, acceleration), links
    )
    signals = replace(
        signals,
        motor_direction=direction,
        drive_torque=drive,
        drive_torque_rate=derivative(low_pass(drive), dt),
        asked_torque=np.where(np.isfinite(torque), torque, drive),
        carrying=_within_intervals(time, run.carried),
    )
    if (law := robot.recordings.actuator) is not None and law.known and run.command is not None:
        sent = np.nan_to_num(bridge_gaps(delayed_command(run, law.delay)))
        sent = np.column_stack([np.interp(time, run.time, own) for own in sent.T])
        rate = law.stiffness * derivative(low_pass(sent), dt)
        signals = replace(signals, command_rate=rate, position_error=sent - position)
    moving = np.abs(velocity) >= settings.slow
    inside = np.zeros(len(time), dtype=bool)
    inside[low_pass.settling : max(len(time) - low_pass.settling, 0)] = True
    gap = near_gaps(run.time, run.step, time, low_pass.settling)
    used = inside & ~gap
    deflection = position - link
    standing = _dilate_flags(~moving, int(1.0 / (low_pass.cutoff * dt)))
    # By the samples as recorded: a uniform clock has values between the counts.
    torque_count = np.array([resolution(own) or 0.0 for own in run.torque.T])
    return PreparedRun(
        torque_count=torque_count,
        robot=robot,
        name=run.name,
        role=run.role,
        index=index,
        time=time,
        signals=signals,
        torque=torque,
        deflection=deflection,
        torque_used=used[:, None] & ~standing & np.isfinite(torque),
        deflection_used=used[:, None] & np.isfinite(deflection),
        moving=moving,
        low_pass=low_pass,
        motion_filter=wide,
        vibration=vibration,
    )


def _nominal_signals(
    robot: RobotModel,
    run: RecordedRun,
    constants: RobotConstants | None,
    time: np.ndarray,
    dt: float,
    motor: tuple[np.ndarray, np.ndarray, np.ndarray],
    links: LinkMotion,
) -> RobotSignals:
    """Return the signals of motors, by derivative, and links, without friction and rotors."""
    rest = np.zeros_like(motor[0])
    return RobotSignals(
        time=time,
        run=run.name,
        run_number=run.number,
        dt=dt,
        session_time=time - time[0] + (run.session_time or 0.0),
        temperature_rise=robot.temperature_rise(run, len(time)),
        motor_position=motor[0],
        motor_velocity=motor[1],
        motor_acceleration=motor[2],
        motor_direction=rest,
        link_position=links.position,
        link_velocity=links.velocity,
        link_acceleration=links.acceleration,
        transmitted_torque=links.torque,
        spring_torque=links.spring,
        windup=robot.windup(links.spring),
        drive_torque=links.torque,
        drive_torque_rate=rest,
        arm=LazyArmSignals(robot, links.position, links.velocity, links.acceleration),
        last_link=robot.n - 1,
        link=robot.n - 1,
        constants=constants or robot.constants,
    )


def _prepare_poses(
    robot: RobotModel, run: RecordedRun, index: int, constants: RobotConstants | None
) -> PreparedRun:
    """Evaluate the nominal model in poses at rest: without motion, filter or vibration."""
    low_pass, shape = PoseFilter(), run.position.shape
    rest = np.zeros(shape, order="F")
    q = np.asfortranarray(run.position)
    for _ in range(_WINDUP_ITERATIONS if robot.elastic else 0):
        q = np.asfortranarray(run.position - robot.windup(robot.spring_torque(q, rest, rest)))
    spring = np.asfortranarray(robot.spring_torque(q, rest, rest))
    motor = (np.asfortranarray(run.position), rest, rest)
    links = LinkMotion(q, rest, rest, spring, spring)
    signals = _nominal_signals(robot, run, constants, run.time, 1.0, motor, links)
    signals = replace(signals, session_time=np.full(len(run.time), run.session_time or 0.0))
    link = np.full(shape, np.nan) if run.link_position is None else run.link_position
    return PreparedRun(
        robot=robot,
        name=run.name,
        role=run.role,
        index=index,
        time=run.time,
        signals=signals,
        torque=run.torque,
        deflection=run.position - link,
        torque_used=np.isfinite(run.torque),
        deflection_used=np.isfinite(link),
        moving=np.zeros(shape, dtype=bool),
        low_pass=low_pass,
        motion_filter=low_pass,
        torque_count=np.array([resolution(own) or 0.0 for own in run.torque.T]),
        at_rest=True,
    )


def with_link_torque(prepared: PreparedRun, added: np.ndarray) -> PreparedRun:
    """Return the run with a link torque (K, n) added to its nominal spring torque."""
    signals = prepared.signals
    spring = signals.spring_torque + added
    return replace(
        prepared,
        signals=replace(
            signals,
            transmitted_torque=signals.transmitted_torque + added,
            spring_torque=spring,
            windup=prepared.robot.windup(spring),
            drive_torque=signals.drive_torque + added,
        ),
    )


def quasi_static_links(
    robot: RobotModel, motor: np.ndarray, dt: float, low_pass: ZeroPhaseFilter
) -> LinkMotion:
    """Return link motion and torque consistent with the motors, without vibration."""
    q = motor
    for _ in range(_WINDUP_ITERATIONS if robot.elastic else 0):
        v = derivative(q, dt)
        spring = low_pass.filter_motion(robot.spring_torque(q, v, derivative(v, dt)))
        q = low_pass.filter_motion(motor - robot.windup(spring))
    v = derivative(q, dt)
    a = derivative(v, dt)
    torque = robot.spring_torque(q, v, a)
    return LinkMotion(q, v, a, torque, torque)


def _vibrating_links(
    robot: RobotModel,
    motor: np.ndarray,
    deflection: np.ndarray,
    balanced: LinkMotion,
    slow: ZeroPhaseFilter,
) -> tuple[LinkMotion, Vibration | None]:
    """Return links that vibrate behind the motors, starting nearest to a slow deflection."""
    dt = 1.0 / slow.rate
    speed = derivative(motor, dt)
    rate = derivative(deflection, dt)
    springs = Springs(robot, motor, speed, dt)
    begin = springs.with_torques(
        motor - deflection, speed - rate, derivative(speed, dt) - derivative(rate, dt)
    )
    vibration = springs.linearise(begin)
    links = springs.solve_from_slow(begin, vibration)
    return (balanced, None) if links is None else (links, vibration)


def _dilate_flags(flags: np.ndarray, reach: int) -> np.ndarray:
    """Return flags (K, n) extended by `reach` samples on either side."""
    padded = np.cumsum(np.vstack([np.zeros((1, flags.shape[1])), flags.astype(float)]), axis=0)
    places = np.arange(len(flags))
    low, high = np.maximum(places - reach, 0), np.minimum(places + reach + 1, len(flags))
    return np.asarray(padded[high] - padded[low] > 0.0)
