"""From a recorded run to filtered signals, nominal predictions and what is left of the channels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from math import comb

import numpy as np

from stiffopt.discovery.comparison.filtering import (
    ZeroPhaseFilter,
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
from stiffopt.recording.channel import MAD
from stiffopt.recording.run import RecordedRun

# Of the motors' motion that is followed [Hz], at least and at most: wider than a fit's filter,
# which all that comes of it passes later.
MIN_MOTOR_CUTOFF, MAX_MOTOR_CUTOFF = 60.0, 150.0
# Share of the rated torque that the noise of a motor's acceleration may come to, and of the rate of
# the samples, how high a motion they show.
_MAX_NOISE_TORQUE_SHARE, _MAX_CUTOFF_OVER_RATE = 1e-3, 0.36
# Times that samples are subtracted from their neighbours, of which noise is left alone.
_NOISE_DIFFERENCES = 5
# Of modes that a run may begin to vibration in, over the filter's cutoff.
_MODE_BAND_OVER_CUTOFF = 1.5
# Rounds of link motion = motor motion - wind-up; each shrinks the error by (f/resonance)^2.
_WINDUP_ITERATIONS = 3


def motor_cutoff(robot: RobotModel, position: np.ndarray, dt: float) -> float:
    """Cutoff of the motors' motion [Hz], as high as encoders bear.

    Where friction turns, torque and acceleration jump against each other within milliseconds: what
    is not followed of one stays of the other. The noise of an encoder sets the limit, which
    accelerations multiply by the square of the frequency.

    Parameters
    ----------
    robot : RobotModel
    position : array (K, n)
        Of the motors, as read [rad].
    dt : float
        [s]
    """
    # Of white noise at the samples' rate, after two derivatives and a filter [N m/Hz^2.5].
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
    """Standard deviations of what changes from sample to sample (n,), if it were white noise."""
    apart = np.diff(samples, _NOISE_DIFFERENCES, axis=0)
    size = [
        np.median(np.abs(moved)) if (moved := own[np.isfinite(own) & (own != 0.0)]).size else 0.0
        for own in apart.T
    ]
    return np.asarray(
        MAD * np.array(size) / np.sqrt(comb(2 * _NOISE_DIFFERENCES, _NOISE_DIFFERENCES))
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedRun:
    """One run, ready to be compared.

    Parameters
    ----------
    name, role : str
    index : int
        Among the runs that are compared.
    time : array (K,)
        Uniform clock [s].
    signals : RobotSignals
        Motion, filtered, and nominal torques.
    torque, deflection : array (K, n)
        Measured drive torque, and motor minus link angle; not filtered; nan where missing.
    torque_used, deflection_used : array (K, n) of bool
        Samples that a fit uses.
    moving : array (K, n) of bool
        The joint is faster than `settings.slow`.
    low_pass : ZeroPhaseFilter
        Of a fit.
    followed : ZeroPhaseFilter
        That the motion has passed, and what the drives give with it: a motor's acceleration answers
        a jump of its friction, which would stay alone otherwise.
    vibration : Swing or None
        How links answer small changes; None where they follow at once, by the springs alone.
    added_deflection : array (K, n) or float
        Deflection beside the nominal wind-up of the spring torque, of what an extension adds [rad].
    play : array (K, n) or float
        Of the deflection, what is free travel between flanks [rad].
    initial_state : array (2 n,), optional
        Displacement and speed by which links are known to begin beside their slow motion.
    swung : dict
        This run as its links vibration with extensions that were asked for last.
    """

    name: str
    role: str
    index: int
    time: np.ndarray
    signals: RobotSignals
    torque: np.ndarray
    deflection: np.ndarray
    torque_used: np.ndarray
    deflection_used: np.ndarray
    moving: np.ndarray
    low_pass: ZeroPhaseFilter
    motion_filter: ZeroPhaseFilter
    vibration: Vibration | None = None
    added_deflection: np.ndarray | float = 0.0
    play: np.ndarray | float = 0.0
    initial_state: np.ndarray | None = None
    extension_cache: dict[tuple[object, ...], PreparedRun] = field(default_factory=dict, init=False)
    _joints: dict[int, JointSignals] = field(default_factory=dict, init=False)
    _compliance: dict[int, np.ndarray] = field(default_factory=dict, init=False)

    @property
    def links(self) -> LinkMotion:
        """Motion of the links with the torques that belong to it."""
        s = self.signals
        return LinkMotion(
            s.link_position,
            s.link_velocity,
            s.link_acceleration,
            s.transmitted_torque,
            s.spring_torque,
        )

    def of_joint(self, index: int) -> JointSignals:
        """Signals of one joint (0-based), each in one piece of memory."""
        if index not in self._joints:
            self._joints[index] = self.signals.of_joint(index)
        return self._joints[index]

    def compliance(self, robot: RobotModel, index: int) -> np.ndarray:
        """Slope of the nominal wind-up of one joint (0-based) (K,) [rad/(N m)]."""
        if index not in self._compliance:
            torque = self.of_joint(index).spring_torque
            self._compliance[index] = np.asarray(robot.constants.joints[index].compliance(torque))
        return self._compliance[index]

    def initial_states(self, band: float | None = None) -> np.ndarray:
        """Displacements and speeds (2 n, m) of swings it may begin with, modes up to a band [Hz].

        Default: those that a fit's filter lets pass in part.
        """
        assert self.vibration is not None
        wound = self.signals.motor_position - self.signals.link_position
        return self.vibration.initial_states(
            wound, band or _MODE_BAND_OVER_CUTOFF * self.low_pass.cutoff
        )

    def head(self, count: int) -> PreparedRun:
        """Its first samples, for what is asked of the signals of each."""
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
        self,
        robot: RobotModel,
        damping: np.ndarray | None = None,
        laws: Mapping[int, SpringLaw] | None = None,
    ) -> Springs:
        """Springs between the motors and the links of this run, with damping and laws as given."""
        s = self.signals
        return Springs(robot, s.motor_position, s.motor_velocity, s.dt, damping, laws)

    def respond(
        self, robot: RobotModel, link_torque: np.ndarray | None, deflection: np.ndarray | None
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Change of torque and deflection between motor and link, (K, n) each or None.

        Parameters
        ----------
        robot : RobotModel
        link_torque : array (K, n) or None
            That the links need in addition [N m].
        deflection : array (K, n) or None
            By which the springs' ends are displaced [rad].
        """
        if link_torque is None and deflection is None:
            return None, None
        if self.vibration is not None:
            return self.vibration.respond(link_torque, deflection)
        if link_torque is None:
            return None, deflection
        wound = robot.compliance(self.signals.spring_torque) * link_torque
        return link_torque, wound if deflection is None else wound + deflection


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

    Parameters
    ----------
    robot : RobotModel
    run : RecordedRun
    index : int
    constants : RobotConstants or None
        Of the training runs; None takes the ranges met from this run alone.
    settings : Settings
    vibrating : bool
        Links vibration where the nominal model tells how; else they are in balance all the time.
    """
    time, position, link, torque = resample_uniform(run)
    dt = float(time[1] - time[0])
    low_pass = ZeroPhaseFilter(1.0 / dt, min(settings.fit_band, 0.2 / dt))
    followed = interpolate_motion(time, position, time)
    vibrating = vibrating and robot.vibrates
    wide = low_pass
    if vibrating:
        # All that comes of the motion passes the fit's filter later: once, as the readings do.
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
        # Each joint in one piece of memory, of which no copy is made for its effects.
        links = LinkMotion(
            *(np.asfortranarray(getattr(links, part.name)) for part in fields(LinkMotion))
        )
        motor, velocity, acceleration = map(np.asfortranarray, (motor, velocity, acceleration))
    q, v, a = links.position, links.velocity, links.acceleration
    windup = robot.windup(links.spring)
    direction = smooth_sign(velocity) if vibration is None else mean_sign(velocity)
    friction = robot.friction(velocity, direction)
    if vibration is not None:
        friction = wide(friction)
    drive = robot.rotor_inertia * acceleration + links.torque + friction
    signals = RobotSignals(
        time=time,
        run=run.name,
        dt=dt,
        session_time=time + (run.session_time or 0.0),
        temperature_rise=robot.temperature_rise(run, len(time)),
        motor_position=motor,
        motor_velocity=velocity,
        motor_acceleration=acceleration,
        motor_direction=direction,
        link_position=q,
        link_velocity=v,
        link_acceleration=a,
        transmitted_torque=links.torque,
        spring_torque=links.spring,
        windup=windup,
        drive_torque=drive,
        drive_torque_rate=derivative(low_pass(drive), dt),
        arm=LazyArmSignals(robot, q, v, a),
        last_link=robot.n - 1,
        link=robot.n - 1,
        constants=constants or robot.constants,
    )
    moving = np.abs(velocity) >= settings.slow
    inside = np.zeros(len(time), dtype=bool)
    inside[low_pass.settling : max(len(time) - low_pass.settling, 0)] = True
    gap = near_gaps(run.time, run.step, time, low_pass.settling)
    used = inside & ~gap
    deflection = position - link
    standing = _dilate_flags(~moving, int(1.0 / (low_pass.cutoff * dt)))
    return PreparedRun(
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


def with_link_torque(prepared: PreparedRun, robot: RobotModel, added: np.ndarray) -> PreparedRun:
    """Prepared run whose nominal spring torque has a found link torque (K, n) added."""
    signals = prepared.signals
    spring = signals.spring_torque + added
    return replace(
        prepared,
        signals=replace(
            signals,
            transmitted_torque=signals.transmitted_torque + added,
            spring_torque=spring,
            windup=robot.windup(spring),
            drive_torque=signals.drive_torque + added,
        ),
    )


def quasi_static_links(
    robot: RobotModel, motor: np.ndarray, dt: float, low_pass: ZeroPhaseFilter
) -> LinkMotion:
    """Link motion and spring torque that agree with each other and with the motors' motion."""
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
    """Links that vibration behind the motors; they begin as near to a slow deflection as can be."""
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
    """Flags (K, n) spread to `reach` samples on either side."""
    padded = np.cumsum(np.vstack([np.zeros((1, flags.shape[1])), flags.astype(float)]), axis=0)
    places = np.arange(len(flags))
    low, high = np.maximum(places - reach, 0), np.minimum(places + reach + 1, len(flags))
    return np.asarray(padded[high] - padded[low] > 0.0)
