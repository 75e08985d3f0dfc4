"""Change of a run by an extension: channels, spring compliance, inertia and damping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.filtering import derivative
from stiffopt.discovery.comparison.located_effect import Contribution, EstimatedEffect, Extension
from stiffopt.discovery.comparison.nuisance import (
    BODY_VALUES,
    COMMAND_DELAY,
    LINK_MOVING_VALUES,
    body_parameter_changes,
    joint_columns,
)
from stiffopt.discovery.comparison.prepared_run import PreparedRun, with_link_torque
from stiffopt.discovery.comparison.springs import SpringLaw, nominal_damping
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.settings import DEFAULT_TOLERANCE
from stiffopt.discovery.signals import JointSignals
from stiffopt.recording.nominal import Tolerance

# Step of the spring torque for tangent compliances over the rated torque.
_SLOPE_STEP = 0.01
# Share of the first step: it sets the state of lagging effects, which they forget soon.
_FIRST_STEP_SHARE = 1e-3

# Range of the tabulated torques over the largest one in the recordings, and entries per decade:
# interpolation errors are far below any encoder's noise.
_MIN_TABLE_TORQUE, _MAX_TABLE_TORQUE, _ENTRIES_PER_DECADE = 1e-6, 1e2, 200

# Interval of inertia matrices, which depend on posture only [s].
_INERTIA_INTERVAL = 0.02

# Tolerances above zero select columns; their size is not used here.
_ALL_TOLERANCES = Tolerance(**dict.fromkeys(vars(DEFAULT_TOLERANCE), 1.0))


@dataclass(frozen=True, eq=False)
class Change:
    """Sum of contributions to the channels, (K, n) each; fields as of `Contribution`."""

    torque: np.ndarray
    link_torque: np.ndarray
    deflection: np.ndarray
    reading: np.ndarray

    def add(self, part: Contribution) -> None:
        """Add a contribution."""
        for name, total in vars(self).items():
            own = getattr(part, name)
            if own is not None:
                total += own


def extension_change(run: PreparedRun, extension: Extension) -> Change:
    """Return the contributions of an extension to the channels of a run."""
    change = Change(*(np.zeros_like(run.signals.spring_torque) for _ in range(4)))
    values = {name: value for name, value in extension.calibration.items() if value}
    bodies = {name for name in values if name.kind in BODY_VALUES}
    if bodies:
        parameters = body_parameter_changes(run.robot, values)
        change.link_torque[:] += run.signals.body_regressor.torque(parameters)
    others = values.keys() - bodies
    if COMMAND_DELAY in others and run.signals.command_rate is not None:
        change.torque[:] += values[COMMAND_DELAY] * run.signals.command_rate
    for own in joint_columns(run, _ALL_TOLERANCES, others.__contains__) if others else ():
        getattr(change, own.field)[:, own.name.place] += values[own.name] * own.values
    # Readings show the torque with the other effects.
    for each in extension.acting.effects:
        change.add(each.located.contribution(run, each.amplitudes))
    read = [each for each in extension.effects if each.effect.reads_torque]
    seen = with_drive_torque(run, change.torque) if read else run
    for each in read:
        change.add(each.located.contribution(seen, each.amplitudes))
    return change


def with_drive_torque(run: PreparedRun, added: np.ndarray) -> PreparedRun:
    """Return the run with added drive torques (K, n)."""
    signals = run.signals
    drive = signals.drive_torque + added
    rate = derivative(run.low_pass(drive), signals.dt)
    return replace(run, signals=replace(signals, drive_torque=drive, drive_torque_rate=rate))


def with_changed_geometry(run: PreparedRun, extension: Extension) -> PreparedRun:
    """Return the run with changes of bodies under gravity that is turned, at zeros that moved."""
    signals = run.signals
    stated = signals.constants.gravity
    gravity, zeros = np.zeros(3), np.zeros(run.robot.n)
    for each in extension.effects:
        if not each.located.acts_in(run.name):
            continue
        if each.effect.turned_gravity is not None:
            gravity += each.effect.turned_gravity(each.amplitudes, stated) - stated
        if each.effect.moves_zero and each.located.joint is not None:
            zeros[each.located.joint] += each.amplitudes[0]
    if not (gravity.any() or zeros.any()):
        return run
    return replace(run, signals=replace(signals, arm=signals.arm.with_geometry(gravity, zeros)))


def link_moving_part(runs: Sequence[PreparedRun], extension: Extension) -> Extension:
    """Return the part of an extension that moves the links or loads their springs."""
    swings = runs[0].vibration is not None

    def moves(run: PreparedRun, each: EstimatedEffect) -> bool:
        added = each.located.contribution(run, each.amplitudes)
        return (swings and added.deflection is not None) or added.link_torque is not None

    kinds = LINK_MOVING_VALUES if swings else BODY_VALUES
    return Extension(
        calibration={n: v for n, v in extension.calibration.items() if v and n.kind in kinds},
        effects=tuple(e for e in extension.effects if any(moves(run, e) for run in runs)),
    )


def select_calibration(extension: Extension, kinds: tuple[str, ...]) -> Extension:
    """Return the nominal values of some kinds."""
    values = extension.calibration.items()
    return Extension(calibration={n: v for n, v in values if n.kind in kinds})


def is_damping(each: EstimatedEffect) -> bool:
    """Return True where an effect changes the damping of a joint."""
    return each.effect.nominal == "joint_damping"


def extended_damping(run: PreparedRun, extension: Extension) -> np.ndarray:
    """Return the damping of the joints (n,) in a run, extended, at least zero [N m s/rad]."""
    damping = nominal_damping(run.robot)
    factors = [
        extension.calibration.get(ValueName("joint_damping", j), 0.0) for j in range(run.robot.n)
    ]
    added = np.zeros(run.robot.n)
    for each in extension.effects:
        if is_damping(each) and each.located.joint is not None and each.located.acts_in(run.name):
            added[each.located.joint] += each.amplitudes[0]
    return np.asarray(np.maximum(damping * (1.0 + np.array(factors)) + added, 0.0))


def relative_compliance(run: PreparedRun, extension: Extension) -> np.ndarray:
    """Return the tangent compliance (K, n) with an extension over the nominal one."""
    effects = tuple(e for e in extension.effects if not is_damping(e))
    if not any(e.effect.yields for e in effects):
        effects = ()
    if not effects and not extension.calibration:
        return np.ones(run.torque.shape)
    step = _SLOPE_STEP * np.array([j.torque_rated for j in run.signals.constants.joints])
    steps = np.broadcast_to(step, run.torque.shape)
    instant = replace(extension, effects=tuple(e for e in effects if not e.effect.lags))
    softer = 1.0 + _added_compliance(run, instant, steps)
    lagging = tuple(e for e in effects if e.effect.lags)
    if lagging:
        # Alternate the step between samples, which lagging effects do not follow.
        sign = np.where(np.arange(len(steps)) % 2, -1.0, 1.0)
        sign[0] = _FIRST_STEP_SHARE
        softer += _added_compliance(run, Extension(effects=lagging), sign[:, None] * steps)
    slope = np.zeros_like(softer)
    for each in effects:
        joint, own = each.located.joint, each.effect.deflection_slope
        if own is not None and joint is not None and each.located.acts_in(run.name):
            shapes = each.located.shapes
            slope[:, joint] += own(run.of_joint(joint), each.amplitudes, shapes)
    return softer / (1.0 - slope)


def _added_compliance(run: PreparedRun, extension: Extension, steps: np.ndarray) -> np.ndarray:
    """Return the relative compliance of an extension by steps of the load (K, n)."""
    loaded = with_link_torque(run, steps)
    ends = [extension_change(each, extension).deflection for each in (run, loaded)]
    nominal = loaded.signals.windup - run.signals.windup
    return np.asarray((ends[1] - ends[0]) / nominal)


def spring_laws(run: PreparedRun, extension: Extension) -> tuple[dict[int, SpringLaw], Extension]:
    """Return springs with play by joint (from 0), and the rest of an extension."""
    by_joint: dict[int, list[EstimatedEffect]] = {}
    others = []
    for each in extension.effects:
        joint = each.located.joint
        if not each.located.acts_in(run.name):
            continue
        if each.effect.is_play and joint is not None:
            by_joint.setdefault(joint, []).append(each)
        else:
            others.append(each)
    laws = {joint: _tabulate_spring(run.of_joint(joint), own) for joint, own in by_joint.items()}
    return laws, replace(extension, effects=tuple(others))


def _tabulate_spring(signals: JointSignals, own: Sequence[EstimatedEffect]) -> SpringLaw:
    """Return the nominal spring of a joint with effects in series."""
    constants = signals.constants
    decades = np.log10(_MAX_TABLE_TORQUE / _MIN_TABLE_TORQUE)
    above = constants.largest_torque * np.geomspace(
        _MIN_TABLE_TORQUE, _MAX_TABLE_TORQUE, round(decades * _ENTRIES_PER_DECADE)
    )
    above = np.unique(np.concatenate([above, constants.corners or ()]))
    carried = np.concatenate([-above[::-1], [0.0], above])
    windup = np.asarray(constants.windup(carried))
    along = replace(signals, spring_torque=carried, windup=windup)
    deflection = windup.copy()
    for each in own:
        term = each.effect.term(along, each.amplitudes, each.shapes)
        deflection += np.asarray(term.deflection)
    # A negative play, as during a fit, counts as none.
    kept = np.flatnonzero(deflection > np.maximum.accumulate(np.append(-np.inf, deflection[:-1])))
    return SpringLaw(carried[kept], deflection[kept], windup[kept])


def added_inertia_along(run: PreparedRun, extension: Extension) -> np.ndarray | float:
    """Return the inertia (K, n, n) that an extension adds to the links [kg m^2]."""
    effects = tuple(e for e in extension.effects if e.effect.family == "inertial")
    if not effects:
        return 0.0
    every = max(1, round(_INERTIA_INTERVAL / run.signals.dt))
    added = added_inertia(run, [Extension(effects=effects)], every)
    return np.repeat(added, every, axis=0)[: len(run.time)]


def added_inertia(run: PreparedRun, extensions: Sequence[Extension], every: int) -> np.ndarray:
    """Return the inertia that extensions add to the links, by the bodies' regressor.

    `run`: run with the nominal model. `every`: samples between matrices. Returns (K / every, n, n)
    added inertia [kg m^2].
    """
    few = replace(run, signals=run.signals.decimate(every))
    q = few.signals.link_position
    if not extensions:
        return np.zeros((*q.shape, run.robot.n))
    rest = np.zeros_like(q)

    def link_torque(acceleration: np.ndarray) -> np.ndarray:
        signals = replace(
            few.signals,
            link_velocity=rest,
            link_acceleration=acceleration,
            arm=few.signals.arm.with_bodies(q, rest, acceleration),
        )
        here = replace(few, signals=signals)
        return sum((extension_change(here, each).link_torque for each in extensions), rest)

    held = link_torque(rest)
    units = (np.broadcast_to(unit, q.shape) for unit in np.eye(run.robot.n))
    return np.stack([link_torque(unit) - held for unit in units], axis=2)
