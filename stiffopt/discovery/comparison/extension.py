"""What was found, beside the nominal model: calibrated values and effects along a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stiffopt.discovery.comparison.filtering import derivative
from stiffopt.discovery.comparison.located_effect import Contribution, LocatedEffect
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import (
    MOVES_LINKS,
    OF_BODIES,
    OF_SPRINGS,
    changed_bodies,
    nuisance_columns,
)
from stiffopt.discovery.comparison.prepare import PreparedRun, with_link_torque
from stiffopt.discovery.comparison.swing import LinkMotion, Swing, damping_of, slow_filter
from stiffopt.recording.nominal import Tolerance

# Of the slope of a spring's law, over the rated torque.
_SLOPE_STEP = 0.01
# Times that the links' motion is found with all that was found, nominal values about it.
_PASSES = 2
# Such motions that are kept with a run, since the next extension often differs in drives alone.
_KEPT = 2
# Between inertia matrices, which change with posture only [s].
_POSTURE = 0.02
# Any tolerance above zero makes a column; its size does not matter here.
_EVERY = Tolerance(
    mass=1.0,
    com=1.0,
    rotor_inertia=1.0,
    coulomb=1.0,
    viscous=1.0,
    stiffness=1.0,
    joint_damping=1.0,
    torque_constant=1.0,
    encoder_zero=1.0,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatedEffect:
    """An effect at a place, with its amplitudes.

    Parameters
    ----------
    located : LocatedEffect
    amplitudes : tuple of float
        In the amplitudes' own units.
    step : float
        Of the first amplitude, from what the fit found to what all moving samples say.
    """

    located: LocatedEffect
    amplitudes: tuple[float, ...]
    step: float = 0.0

    @property
    def fitted(self) -> EstimatedEffect:
        """The effect as the fit found it."""
        first, *others = self.amplitudes
        return replace(self, amplitudes=(first - self.step, *others), step=0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Extension:
    """Change of a nominal model.

    Parameters
    ----------
    calibration : mapping of str to float
        Change of nominal values by their names ("coulomb 3", "com 2 x", "body 2 mx"): relative,
        [m], [rad], or of the inertial parameters of a body.
    effects : tuple of EstimatedEffect
    """

    calibration: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[EstimatedEffect, ...] = ()

    def followed_by(self, later: Extension) -> Extension:
        """Both in one."""
        names = {**self.calibration, **later.calibration}
        return Extension(
            calibration={
                name: self.calibration.get(name, 0.0) + later.calibration.get(name, 0.0)
                for name in names
            },
            effects=(*self.effects, *later.effects),
        )

    def less(self, other: Extension) -> Extension:
        """What this one has beyond another."""
        names = {**self.calibration, **other.calibration}
        taken = (
            replace(e, amplitudes=tuple(-value for value in e.amplitudes)) for e in other.effects
        )
        return Extension(
            calibration={
                name: self.calibration.get(name, 0.0) - other.calibration.get(name, 0.0)
                for name in names
            },
            effects=(*self.effects, *taken),
        )

    @property
    def fitted(self) -> Extension:
        """The extension as the fit found it, without steps to all moving samples."""
        return replace(self, effects=tuple(each.fitted for each in self.effects))

    @property
    def empty(self) -> bool:
        """Whether nothing is changed."""
        return not self.effects and not any(self.calibration.values())


@dataclass(frozen=True, eq=False)
class _Change:
    """Sum of what changes the channels, (K, n) each; as `Contribution`."""

    torque: np.ndarray
    link_torque: np.ndarray
    deflection: np.ndarray
    reading: np.ndarray

    def add(self, part: Contribution, times: float = 1.0) -> None:
        """Add a contribution."""
        for name, total in vars(self).items():
            own = getattr(part, name)
            if own is not None:
                total += times * own


def extended(run: PreparedRun, robot: RobotModel, *extensions: Extension) -> PreparedRun:
    """Run whose nominal torques and wind-up have extensions in them.

    Parameters
    ----------
    run : PreparedRun
        With the nominal model.
    robot : RobotModel
    extensions : Extension
        Each on top of those before it.

    Notes
    -----
    Where links swing, they do so with all that was found: on springs as soft, and as heavy. Else
    terms are evaluated with the link torque that was found in the springs, as they were when they
    were fitted; the joints wind up by the exact law under it.
    """
    if run.swing is None:
        for extension in extensions:
            run = _wound_up(run, robot, extension)
        return run
    whole = Extension()
    for extension in extensions:
        whole = whole.followed_by(extension)
    if whole.empty:
        return run
    moved = swung(run, robot, whole)
    change = _change(moved, robot, whole)
    drive = moved.signals.drive_torque + change.torque
    rate = derivative(run.low_pass(drive), moved.signals.dt)
    return replace(
        moved,
        signals=replace(moved.signals, drive_torque=drive, drive_torque_rate=rate),
        beside=moved.beside + change.reading,
    )


def around(
    run: PreparedRun, robot: RobotModel, start: Extension, found: Extension
) -> tuple[PreparedRun, np.ndarray | float, np.ndarray | float]:
    """Run about what was found, for laws that bend and modes that move.

    Parameters
    ----------
    run : PreparedRun
        With the nominal model.
    robot : RobotModel
    start : Extension
        Whole in the prediction of the run.
    found : Extension
        In it by what moves the links.

    Returns
    -------
    run : PreparedRun
    torque, deflection : array (K, n) or float
        What the amplitudes of the found extension add by the columns about this run, which is in
        its prediction already [N m], [rad].
    """
    if start.empty and found.empty:
        return run, 0.0, 0.0
    if run.swing is None:
        base = extended(run, robot, start)
        change = _change(base, robot, replace(found, calibration={}))
        if not change.link_torque.any():
            return base, 0.0, 0.0
        bent = with_link_torque(base, robot, change.link_torque)
        wound = robot.compliance(bent.signals.spring_torque) * change.link_torque
        return bent, change.link_torque, wound
    whole = start.followed_by(found)
    moved = swung(run, robot, whole)
    softer = _softer(moved, robot, whole)
    heavier = _heavier(moved, robot, whole)
    springs = moved.springs(robot, _damping(robot, whole))
    own = springs.swing(moved.links, softer, heavier, moved.swing)
    moved = replace(moved, swing=own)
    change = _change(moved, robot, found)
    torque, deflection = moved.answer(robot, change.link_torque, change.deflection)
    assert torque is not None
    assert deflection is not None
    if not start.empty:
        stated = _change(moved, robot, start)
        drive = moved.signals.drive_torque + stated.torque
        moved = replace(
            moved,
            signals=replace(moved.signals, drive_torque=drive),
            beside=moved.beside + stated.reading,
        )
    return moved, torque, deflection


def swung(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    """Run whose links swing with an extension: what it does to drives and readings is left out.

    Parameters
    ----------
    run : PreparedRun
        With the nominal model and its swing.
    robot : RobotModel
    extension : Extension

    Notes
    -----
    Where no such motion is found, nominal values stand in for what is missing yet, further than
    springs can follow: they count to first order then, and effects too where that is not enough.
    """
    moving = _that_moves_links(run, extension)
    key = _key(moving)
    if key not in run.swung:
        while len(run.swung) >= _KEPT:
            run.swung.pop(next(iter(run.swung)))
        run.swung[key] = _swung(run, robot, moving)
    return run.swung[key]


def _that_moves_links(run: PreparedRun, extension: Extension) -> Extension:
    values = extension.calibration.items()
    return Extension(
        calibration={n: v for n, v in values if v and n.split()[0] in MOVES_LINKS},
        effects=tuple(e for e in extension.effects if moves_links(run, e)),
    )


def moves_links(run: PreparedRun, each: EstimatedEffect) -> bool:
    """Whether an effect moves the links of a run, or bends them where they do not swing."""
    added = each.located.contribution(run, each.amplitudes)
    swung = run.swing is not None and added.deflection is not None
    return swung or added.link_torque is not None


def _key(extension: Extension) -> tuple[object, ...]:
    effects = ((e.located.key, e.amplitudes) for e in extension.effects)
    return (*extension.calibration.items(), *effects)


def _swung(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    found = _followed(run, robot, extension)
    if found is not None:
        return found
    values = replace(extension, effects=())
    if extension.effects and not values.empty:
        found = _followed(run, robot, replace(extension, calibration={}))
        if found is not None:
            return _nearly(found, robot, values)
    return _nearly(run, robot, extension)


def _followed(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun | None:
    """Run whose links swing with an extension; None where no motion of such an arm is found.

    Springs and damping are those of the motion that is looked for; regressors are taken about the
    one before, what else the bodies need goes with their inertia. The swing of the result is one
    near by.
    """
    assert run.swing is not None
    springs = run.springs(robot, _damping(robot, extension))
    bodies = _values(extension, OF_BODIES)
    sprung = replace(
        extension,
        calibration=_values(extension, OF_SPRINGS).calibration,
        effects=tuple(e for e in extension.effects if not _damps(e)),
    )
    effects = replace(sprung, calibration={})
    heavier = _heavier(run, robot, effects)
    nominal = _softer(run, robot, replace(sprung, effects=()))
    swing = springs.swing(run.links, nominal * _softer(run, robot, effects), heavier, run.swing)
    begin = _slowly(run, robot, extension, swing)
    moved = run
    for again in range(_PASSES if effects.effects else 1):
        weight = _change(moved, robot, bodies).link_torque

        def softer(links: LinkMotion, moved: PreparedRun = moved) -> np.ndarray:
            now = _softer(_with_links(moved, robot, links), robot, effects)
            return np.asarray(nominal * now)

        def added(
            links: LinkMotion, moved: PreparedRun = moved, weight: np.ndarray = weight
        ) -> tuple[np.ndarray, np.ndarray]:
            change = _change(_with_links(moved, robot, links), robot, sprung)
            if isinstance(heavier, np.ndarray):
                away = (links.acceleration - moved.signals.link_acceleration)[..., None]
                change.link_torque[:] += (heavier @ away)[..., 0]
            return change.link_torque + weight, change.deflection

        links = (
            springs.follow(moved.links, swing, added, softer)
            if again
            else springs.started(begin, swing, added, softer)
        )
        if links is None:
            return None
        moved = _with_links(moved, robot, links)
        if isinstance(heavier, np.ndarray):
            moved = _with_regressor(moved, robot)
    return replace(
        moved,
        swing=swing,
        beside=springs.motor - moved.signals.link_position - moved.signals.windup,
    )


def _values(extension: Extension, words: tuple[str, ...]) -> Extension:
    """Those nominal values whose names begin with some words."""
    values = extension.calibration.items()
    return Extension(calibration={n: v for n, v in values if n.split()[0] in words})


def _damps(each: EstimatedEffect) -> bool:
    return each.located.effect.nominal == "joint_damping"


def _damping(robot: RobotModel, extension: Extension) -> np.ndarray:
    """Damping of the joints (n,) with an extension, none of it below zero [N m s/rad]."""
    damping = damping_of(robot)
    factors = [extension.calibration.get(f"joint_damping {j + 1}", 0.0) for j in range(robot.n)]
    added = np.zeros(robot.n)
    for each in extension.effects:
        if _damps(each) and each.located.joint is not None:
            added[each.located.joint] += each.amplitudes[0]
    return np.asarray(np.maximum(damping * (1.0 + np.array(factors)) + added, 0.0))


def _slowly(run: PreparedRun, robot: RobotModel, extension: Extension, swing: Swing) -> LinkMotion:
    """Slow motion of the links with an extension."""
    assert run.swing is not None
    slow = run.swing.begin
    here = _with_links(run, robot, slow)
    if any(e.located.effect.family == "inertial" for e in extension.effects):
        here = _with_regressor(here, robot)
    change = _change(here, robot, extension)
    low_pass = slow_filter(run.signals.dt)
    wound = low_pass(change.link_torque / swing.stiffness + change.deflection)
    rate = derivative(wound, run.signals.dt)
    return slow.moved(-wound, -rate, -derivative(rate, run.signals.dt))


def _nearly(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    """The run with an extension to first order."""
    assert run.swing is not None
    change = _change(run, robot, extension)
    torque, deflection = run.swing.answer(change.link_torque, change.deflection)
    signals = replace(run.signals, drive_torque=run.signals.drive_torque + torque)
    return replace(run, signals=signals, beside=run.beside + deflection)


def _with_regressor(run: PreparedRun, robot: RobotModel) -> PreparedRun:
    """The run with the regressor of its links' motion."""
    s = run.signals
    arm = s.arm.with_bodies(s.link_position, s.link_velocity, s.link_acceleration)
    return replace(run, signals=replace(s, arm=arm))


def _with_links(run: PreparedRun, robot: RobotModel, links: LinkMotion) -> PreparedRun:
    """The run with another motion of its links."""
    signals = run.signals
    return replace(
        run,
        signals=replace(
            signals,
            link_position=links.position,
            link_velocity=links.velocity,
            link_acceleration=links.acceleration,
            transmitted_torque=links.torque,
            spring_torque=links.spring,
            windup=robot.windup(links.spring),
            drive_torque=signals.drive_torque - signals.transmitted_torque + links.torque,
        ),
    )


def _wound_up(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    """The run with an extension, its links in balance."""
    bent = with_link_torque(run, robot, _change(run, robot, extension).link_torque)
    change = _change(bent, robot, extension)
    wound = with_link_torque(run, robot, change.link_torque).signals
    drive = wound.drive_torque + change.torque
    return replace(
        run,
        signals=replace(
            wound, drive_torque=drive, drive_torque_rate=derivative(run.low_pass(drive), wound.dt)
        ),
        beside=run.beside + change.deflection + change.reading,
    )


def _softer(run: PreparedRun, robot: RobotModel, extension: Extension) -> np.ndarray:
    """Compliance of the springs (K, n) with an extension over the nominal one."""
    effects = tuple(e for e in extension.effects if not _damps(e))
    if not any(e.located.effect.family == "elastic" for e in effects):
        effects = ()
    extension = replace(extension, effects=effects)
    step = _SLOPE_STEP * np.array([j.torque_rated for j in run.signals.constants.joints])
    loaded = with_link_torque(run, robot, np.broadcast_to(step, run.torque.shape))
    ends = [_change(each, robot, extension).deflection for each in (run, loaded)]
    nominal = loaded.signals.windup - run.signals.windup
    return np.asarray(1.0 + (ends[1] - ends[0]) / nominal)


def _heavier(run: PreparedRun, robot: RobotModel, extension: Extension) -> np.ndarray | float:
    """What an extension adds to the inertia matrices of the links (K, n, n) [kg m^2]."""
    effects = tuple(e for e in extension.effects if e.located.effect.family == "inertial")
    if not effects:
        return 0.0
    every = max(1, round(_POSTURE / run.signals.dt))
    added = added_inertia(run, robot, [Extension(effects=effects)], every)
    return np.repeat(added, every, axis=0)[: len(run.time)]


def added_inertia(
    run: PreparedRun, robot: RobotModel, extensions: Sequence[Extension], every: int
) -> np.ndarray:
    """What extensions add to the inertia matrices of the links.

    Parameters
    ----------
    run : PreparedRun
        With the nominal model.
    robot : RobotModel
    extensions : sequence of Extension
    every : int
        Samples from one matrix to the next.

    Returns
    -------
    array (K / every, n, n)
        [kg m^2]; of effects that act through the bodies' regressor.
    """
    few = replace(run, signals=run.signals.thinned(every))
    q = few.signals.link_position
    if not extensions:
        return np.zeros((*q.shape, robot.n))
    rest = np.zeros_like(q)

    def link_torque(acceleration: np.ndarray) -> np.ndarray:
        signals = replace(
            few.signals,
            link_velocity=rest,
            link_acceleration=acceleration,
            arm=few.signals.arm.with_bodies(q, rest, acceleration),
        )
        here = replace(few, signals=signals)
        return sum((_change(here, robot, each).link_torque for each in extensions), rest)

    held = link_torque(rest)
    units = (np.broadcast_to(unit, q.shape) for unit in np.eye(robot.n))
    return np.stack([link_torque(unit) - held for unit in units], axis=2)


def _change(run: PreparedRun, robot: RobotModel, extension: Extension) -> _Change:
    change = _Change(*(np.zeros_like(run.signals.spring_torque) for _ in range(4)))
    values = {name: value for name, value in extension.calibration.items() if value}
    bodies = {name for name in values if name.split()[0] in OF_BODIES}
    if bodies:
        parameters = changed_bodies(robot, values)
        change.link_torque[:] += run.signals.body_regressor.torque(parameters)
    others = values.keys() - bodies
    if others:
        for column in nuisance_columns(run, robot, _EVERY, asked=others.__contains__):
            # What knees share is asked for by one of them.
            change.add(column.added, values.get(column.name, 0.0))
    for each in extension.effects:
        change.add(each.located.contribution(run, each.amplitudes))
    return change


def with_amplitudes(
    effects: Sequence[LocatedEffect], scaled: np.ndarray, sizes: Sequence[np.ndarray]
) -> tuple[EstimatedEffect, ...]:
    """Effects with amplitudes given over their sizes, one effect's after another's."""
    out, begin = [], 0
    for located, size in zip(effects, sizes, strict=True):
        own = scaled[begin : begin + len(size)] * size
        out.append(EstimatedEffect(located=located, amplitudes=tuple(float(v) for v in own)))
        begin += len(size)
    return tuple(out)
