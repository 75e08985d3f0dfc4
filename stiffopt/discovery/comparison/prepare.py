"""From a recorded run to filtered signals, nominal predictions and what is left of the channels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.interpolate import CubicSpline

from stiffopt.discovery.comparison.arm_along import ArmAlong
from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter, derivative
from stiffopt.discovery.comparison.followed import followed_to, mean_sign
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.signals import (
    JointSignals,
    RobotConstants,
    RobotSignals,
    smooth_sign,
)
from stiffopt.discovery.comparison.spring_law import SpringLaw
from stiffopt.discovery.comparison.springs import Springs
from stiffopt.discovery.comparison.swing import LinkMotion, Swing, slow_filter
from stiffopt.discovery.settings import Settings
from stiffopt.recording.clock import MIN_GAP_STEPS
from stiffopt.recording.run import RecordedRun

# Steps between samples up to which a motion is bridged along itself: two may be missing.
_BRIDGED = 3.5
# Of modes that a run may begin to swing in, over the filter's cutoff.
_BEYOND_CUTOFF = 1.5
# Rounds of link motion = motor motion - wind-up; each shrinks the error by (f/resonance)^2.
_ROUNDS = 3


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
    swing : Swing or None
        How links answer small changes; None where they follow at once, by the springs alone.
    beside : array (K, n) or float
        Deflection beside the nominal wind-up of the spring torque, of what an extension adds [rad].
    play : array (K, n) or float
        Of the deflection, what is free travel between flanks [rad].
    begun : array (2 n,), optional
        Displacement and speed by which links are known to begin beside their slow motion.
    swung : dict
        This run as its links swing with extensions that were asked for last.
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
    followed: ZeroPhaseFilter
    swing: Swing | None = None
    beside: np.ndarray | float = 0.0
    play: np.ndarray | float = 0.0
    begun: np.ndarray | None = None
    swung: dict[tuple[object, ...], PreparedRun] = field(default_factory=dict, init=False)
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

    def starts(self, band: float | None = None) -> np.ndarray:
        """Displacements and speeds (2 n, m) of swings it may begin with, modes up to a band [Hz].

        Default: those that a fit's filter lets pass in part.
        """
        assert self.swing is not None
        wound = self.signals.motor_position - self.signals.link_position
        return self.swing.starts(wound, band or _BEYOND_CUTOFF * self.low_pass.cutoff)

    def until(self, count: int) -> PreparedRun:
        """Its first samples, for what is asked of the signals of each."""
        beside, play = (
            each[:count] if isinstance(each, np.ndarray) else each
            for each in (self.beside, self.play)
        )
        return replace(
            self,
            time=self.time[:count],
            signals=self.signals.until(count),
            torque=self.torque[:count],
            deflection=self.deflection[:count],
            torque_used=self.torque_used[:count],
            deflection_used=self.deflection_used[:count],
            moving=self.moving[:count],
            beside=beside,
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

    def answer(
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
        if self.swing is not None:
            return self.swing.answer(link_torque, deflection)
        if link_torque is None:
            return None, deflection
        wound = robot.compliance(self.signals.spring_torque) * link_torque
        return link_torque, wound if deflection is None else wound + deflection


def prepare(
    robot: RobotModel,
    run: RecordedRun,
    index: int,
    constants: RobotConstants | None,
    settings: Settings,
    *,
    swinging: bool = True,
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
    swinging : bool
        Links swing where the nominal model tells how; else they are in balance all the time.
    """
    time, position, link, torque = uniform(run)
    dt = float(time[1] - time[0])
    low_pass = ZeroPhaseFilter(1.0 / dt, min(settings.fit_band, 0.2 / dt))
    followed = smoothly(time, position, time)
    swinging = swinging and robot.swings
    wide = low_pass
    if swinging:
        # All that comes of the motion passes the fit's filter later: once, as the readings do.
        cutoff = max(low_pass.cutoff, followed_to(robot, position, dt))
        wide = ZeroPhaseFilter(1.0 / dt, cutoff)
    motor = wide.motion(followed)
    velocity = derivative(motor, dt)
    acceleration = derivative(velocity, dt)
    slow = slow_filter(dt) if swinging else low_pass
    followed = slow.motion(followed)
    links, swing = link_motion(robot, followed, dt, slow), None
    if swinging:
        links, swing = _swinging(robot, motor, followed - links.position, links, slow)
    if swing is None:
        # Each joint in one piece of memory, of which no copy is made for its effects.
        links = LinkMotion(
            *(np.asfortranarray(getattr(links, part.name)) for part in fields(LinkMotion))
        )
        motor, velocity, acceleration = map(np.asfortranarray, (motor, velocity, acceleration))
    q, v, a = links.position, links.velocity, links.acceleration
    windup = robot.windup(links.spring)
    direction = smooth_sign(velocity) if swing is None else mean_sign(velocity)
    friction = robot.friction(velocity, direction)
    if swing is not None:
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
        arm=ArmAlong(robot, q, v, a),
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
    standing = _widened(~moving, int(1.0 / (low_pass.cutoff * dt)))
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
        followed=wide,
        swing=swing,
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


def uniform(run: RecordedRun) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Channels on an even clock: a motion smooth between the stamps, a torque linear."""
    step = run.step
    count = int(np.floor((run.time[-1] - run.time[0]) / step + 1e-6)) + 1
    time = run.time[0] + step * np.arange(count)
    empty = np.full_like(run.position, np.nan)
    channels = (
        run.position,
        empty if run.link_position is None else run.link_position,
        run.torque,
    )
    if count == len(run.time) and np.allclose(time, run.time, rtol=0.0, atol=1e-3 * step):
        return (time, *(np.array(c, dtype=float) for c in channels))
    motor, link, torque = channels
    motion = (smoothly(run.time, position, time) for position in (motor, link))
    return (time, *motion, _resampled(run.time, torque, time))


def smoothly(stamps: np.ndarray, samples: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Positions (K, n) at other times (R, n) by cubic splines; nan where a column is empty.

    A straight line over one sample that is missing cuts a turn short by 20 um at 10 m/s^2, and
    springs swing on from there. Longer gaps are mostly motors that stand still: straight.
    """
    bridged = _resampled(stamps, samples, time)
    for out, column in zip(bridged.T, samples.T, strict=True):
        known = np.isfinite(column)
        if np.count_nonzero(known) < 2:
            out[:] = np.nan
            continue
        told = stamps[known]
        apart = np.diff(told)[np.clip(np.searchsorted(told, time) - 1, 0, len(told) - 2)]
        near = (apart < _BRIDGED * np.median(np.diff(told))) & (time > told[0]) & (time < told[-1])
        out[near] = CubicSpline(told, column[known])(time[near])
    return bridged


def _resampled(stamps: np.ndarray, samples: np.ndarray, time: np.ndarray) -> np.ndarray:
    columns = []
    for column in samples.T:
        known = np.isfinite(column)
        if not known.any():
            columns.append(np.full(len(time), np.nan))
            continue
        columns.append(np.interp(time, stamps[known], column[known]))
    return np.column_stack(columns)


def whole(samples: np.ndarray) -> np.ndarray:
    """Single missing samples bridged, so that the filter can pass."""
    out = samples.copy()
    for column in out.T:
        missing = ~np.isfinite(column)
        if missing.any() and not missing.all():
            places = np.arange(len(column))
            column[missing] = np.interp(places[missing], places[~missing], column[~missing])
    return out


def link_motion(
    robot: RobotModel, motor: np.ndarray, dt: float, low_pass: ZeroPhaseFilter
) -> LinkMotion:
    """Link motion and spring torque that agree with each other and with the motors' motion."""
    q = motor
    for _ in range(_ROUNDS if robot.elastic else 0):
        v = derivative(q, dt)
        spring = low_pass.motion(robot.spring_torque(q, v, derivative(v, dt)))
        q = low_pass.motion(motor - robot.windup(spring))
    v = derivative(q, dt)
    a = derivative(v, dt)
    torque = robot.spring_torque(q, v, a)
    return LinkMotion(q, v, a, torque, torque)


def _swinging(
    robot: RobotModel,
    motor: np.ndarray,
    deflection: np.ndarray,
    balanced: LinkMotion,
    slow: ZeroPhaseFilter,
) -> tuple[LinkMotion, Swing | None]:
    """Links that swing behind the motors; they begin as near to a slow deflection as can be."""
    dt = 1.0 / slow.rate
    speed = derivative(motor, dt)
    rate = derivative(deflection, dt)
    springs = Springs(robot, motor, speed, dt)
    begin = springs.motion(
        motor - deflection, speed - rate, derivative(speed, dt) - derivative(rate, dt)
    )
    swing = springs.swing(begin)
    links = springs.started(begin, swing)
    return (balanced, None) if links is None else (links, swing)


def _widened(flags: np.ndarray, reach: int) -> np.ndarray:
    """Flags (K, n) spread to `reach` samples on either side."""
    padded = np.cumsum(np.vstack([np.zeros((1, flags.shape[1])), flags.astype(float)]), axis=0)
    places = np.arange(len(flags))
    low, high = np.maximum(places - reach, 0), np.minimum(places + reach + 1, len(flags))
    return np.asarray(padded[high] - padded[low] > 0.0)


def near_gaps(stamps: np.ndarray, step: float, time: np.ndarray, reach: int) -> np.ndarray:
    """Whether instants (K,) lie between stamps far apart, or within `reach` steps of these."""
    near = np.zeros(len(time), dtype=bool)
    margin = reach * step
    for k in np.flatnonzero(np.diff(stamps) > MIN_GAP_STEPS * step):
        near |= (time > stamps[k] - margin) & (time < stamps[k + 1] + margin)
    return near
