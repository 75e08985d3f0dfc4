"""Effects at a joint, link or run, their contributions, and extensions of the nominal model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Literal

import numpy as np

from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.signals import JointConstants, RobotConstants
from stiffopt.units import joint_unit

Kind = Literal["torque", "deflection"]
# Kind of channel, joint and amplitude (from 0), and the change (K,) per unit amplitude.
ChannelChange = tuple[Kind, int, int, np.ndarray]
# Amplitude (from 0), torque on the joint's link, and displacement of its spring's end.
LinkLoad = tuple[int, np.ndarray, np.ndarray]


# Largest ratio of an amplitude to the value that its term is linear about: a longer shift with a
# small amplitude is a filter, not a delay.
_MAX_LINEAR_RATIO = 3.0


@dataclass(frozen=True, eq=False)
class Contribution:
    """Contribution of an effect to the channels of one run, (K, n) each or None."""

    torque: np.ndarray | None = None  # to the drive torque, in addition to the link torque [N m]
    link_torque: np.ndarray | None = None  # to the torque between motor and link [N m]
    # To motor minus link angle, in addition to the wind-up under the link torque [rad].
    deflection: np.ndarray | None = None
    reading: np.ndarray | None = None  # to the readings of motor minus link angle [rad]

    @classmethod
    def of_joint(cls, joint: int, like: np.ndarray, **values: np.ndarray) -> Contribution:
        """Return a contribution to fields of one joint (from 0), zero in the others."""
        return cls(**{name: _as_joint_column(own, like, joint) for name, own in values.items()})


def channel_changes(
    contributions: Sequence[Contribution], run: PreparedRun
) -> list[tuple[np.ndarray | None, np.ndarray | None]]:
    """Return changes of drive torque and motor minus link angle, (K, n) each or None.

    Vibrating links respond to all contributions together.
    """
    answers = run.respond([(each.link_torque, each.deflection) for each in contributions])
    return [
        (_add_optional(each.torque, torque), _add_optional(each.reading, deflection))
        for each, (torque, deflection) in zip(contributions, answers, strict=True)
    ]


@dataclass(frozen=True, kw_only=True)
class LocatedEffect:
    """Effect at a joint, link or run, with its shapes."""

    effect: Effect
    joint: int | None = None  # 0-based
    link: int | None = None  # 0-based, for effects of a link
    run: str | None = None  # name of the run, for effects of one run
    shapes: tuple[float, ...] = ()
    # True for a value that every arm has and the nominal model does not state, such as dry
    # friction: fitted in every model, and never compared with effects in its place.
    calibrated: bool = False

    @property
    def label(self) -> str:
        """Effect and place, for messages."""
        place = ""
        if self.joint is not None:
            place = f" of joint {self.joint + 1}"
        elif self.link is not None:
            place = f" of link {self.link + 1}"
        changed = " after the change" if self.effect.only_in else ""
        return f"{self.effect.name}{place}{changed}" + (f" in {self.run}" if self.run else "")

    @property
    def key(self) -> tuple[object, ...]:
        """Name, place and shapes, which identify it."""
        return (self.effect.identity, self.joint, self.link, self.run, self.shapes)

    @property
    def is_of_one_joint(self) -> bool:
        """True where it acts on the channels of its joint, and of the one before, alone."""
        return self.joint is not None and not self.effect.couples_joints

    @property
    def is_run_specific(self) -> bool:
        """True where its contribution to a run predicts nothing of other runs."""
        effect = self.effect
        return self.run is not None or effect.of_runs is not None or effect.acts_for_a_while

    def acts_in(self, run: str) -> bool:
        """Return True where it acts in a run of this name."""
        return self.effect.acts_in(run) and self.run in (None, run)

    def is_adjacent(self, other: LocatedEffect) -> bool:
        """Return True where both are at the same or neighbouring joints, or act on several."""
        if not (self.is_of_one_joint and other.is_of_one_joint):
            return True
        assert self.joint is not None
        assert other.joint is not None
        return abs(self.joint - other.joint) <= 1

    def is_beside(self, other: LocatedEffect) -> bool:
        """Return True where both are at one joint, link or run, or of the whole robot."""
        return (self.joint, self.link, self.run) == (other.joint, other.link, other.run)

    def same_place(self, other: LocatedEffect) -> bool:
        """Return True for the same effect at the same place with any shapes."""
        return self.key[:-1] == other.key[:-1]

    def constants(self, robot: RobotConstants) -> JointConstants | RobotConstants:
        """Return the constants for sizes and reports."""
        return robot if self.joint is None else robot.joints[self.joint]

    def unit_of(self, parameter: str, robot: RobotConstants) -> str:
        """Return the unit of a reported parameter; of force and length at a prismatic joint."""
        unit = self.effect.unit_of(parameter)
        slides = self.joint is not None and robot.joints[self.joint].prismatic
        return joint_unit(unit, slides)

    def starts(self, robot: RobotConstants) -> tuple[tuple[float, ...], ...]:
        """Return the initial values of every shape in a search."""
        own = self.constants(robot)
        return tuple(shape.grid(own) for shape in self.effect.shapes)

    def sizes(self, robot: RobotConstants) -> np.ndarray:
        """Return the typical size of every amplitude."""
        own = self.constants(robot)
        return np.array([a.size(own) for a in self.effect.amplitudes])

    def changed_body(self, robot: RobotConstants) -> int | None:
        """Return the body whose inertial parameters are the amplitudes; None of other effects."""
        if "mass" not in self.effect.tolerances or self.joint is not None:
            return None
        return len(robot.masses) - 1 if self.link is None else self.link

    def possible(self, robot: RobotConstants) -> bool:
        """Return False where the shapes contradict the recordings."""
        rule = self.effect.possible
        return rule is None or rule(self.shapes, self.constants(robot))

    def bounds(self, robot: RobotConstants) -> np.ndarray:
        """Return lower and upper amplitudes over their sizes (k, 2).

        A nominal value and its change are not negative together: no friction drives a joint, and no
        link weighs less than nothing.
        """
        found = np.array([(a.lower, a.upper) for a in self.effect.amplitudes], dtype=float)
        own = self.constants(robot)
        if self.effect.nominal and isinstance(own, JointConstants):
            least = -getattr(own, self.effect.nominal) / self.sizes(robot)[0]
            found[0, 0] = max(found[0, 0], least)
        if (body := self.changed_body(robot)) is not None:
            found[0, 0] = max(found[0, 0], -robot.masses[body] / self.sizes(robot)[0])
        if self.effect.linear_about:
            about = float(self.shapes[0]) / self.sizes(robot)[0]
            low, high = sorted((about / _MAX_LINEAR_RATIO, about * _MAX_LINEAR_RATIO))
            found[0] = max(found[0, 0], low), min(found[0, 1], high)
        return found

    def contribution(self, run: PreparedRun, amplitudes: Sequence[float]) -> Contribution:
        """Return its contribution to a run, not filtered."""
        signals = run.signals
        if not self.acts_in(run.name):
            return Contribution()
        like = signals.motor_position
        if not self.is_of_one_joint:
            place = self.link if self.joint is None else self.joint
            seen = signals if place is None else replace(signals, link=place)
            term = self.effect.term(seen, amplitudes, self.shapes)
            parts = (term.drive_torque, term.link_torque, term.deflection, term.reading)
            arrays = (np.asarray(part, dtype=float) for part in parts)
            return Contribution(
                *(np.broadcast_to(each, like.shape) if each.any() else None for each in arrays)
            )
        assert self.joint is not None
        term = self.effect.term(run.of_joint(self.joint), amplitudes, self.shapes)
        parts = (term.drive_torque, term.link_torque, term.deflection, term.reading)
        drive, link, wound, reading = (_as_joint_column(part, like, self.joint) for part in parts)
        if self.joint:
            before = _as_joint_column(term.previous_torque, like, self.joint - 1)
            drive = _add_optional(drive, before)
        if wound is not None and run.shows_displacement(self.joint):
            link = _add_optional(link, signals.arm.displaced_torque(wound, signals.dt))
        return Contribution(drive, link, wound, reading)

    def unit_changes(self, run: PreparedRun) -> tuple[list[ChannelChange], list[LinkLoad]]:
        """Return changes per unit of each amplitude, and loads on vibrating links."""
        assert self.joint is not None
        if not self.acts_in(run.name):
            return [], []
        signals, count = run.of_joint(self.joint), len(self.effect.amplitudes)
        changes: list[ChannelChange] = []
        loads: list[LinkLoad] = []
        for i in range(count):
            unit = [1.0 if k == i else 0.0 for k in range(count)]
            term = self.effect.term(signals, unit, self.shapes)
            torque, deflection, link, wound = (
                np.asarray(x, dtype=float)
                for x in (term.drive_torque, term.reading, term.link_torque, term.deflection)
            )
            loaded = link.any()
            if wound.any() and run.shows_displacement(self.joint):
                every = np.zeros_like(run.signals.motor_position)
                every[:, self.joint] = wound
                moved = run.signals.arm.displaced_torque(every, run.signals.dt)
                changes += [("torque", k, i, own) for k, own in enumerate(moved.T) if own.any()]
            if run.vibration is None:
                torque, deflection = torque + link, wound + deflection
                if loaded:
                    deflection = deflection + run.compliance(self.joint) * link
            elif loaded or wound.any():
                loads.append((i, link, wound))
            added: tuple[tuple[Kind, int, np.ndarray], ...] = (
                ("torque", self.joint, torque),
                ("deflection", self.joint, deflection),
                ("torque", self.joint - 1, np.asarray(term.previous_torque, dtype=float)),
            )
            for kind, joint, values in added:
                if joint >= 0 and values.any():
                    changes.append((kind, joint, i, np.broadcast_to(values, run.time.shape)))
        return changes, loads

    def columns(self, run: PreparedRun) -> list[tuple[np.ndarray | None, np.ndarray | None]]:
        """Return the changes of torque and deflection per unit of each amplitude."""
        units = np.eye(len(self.effect.amplitudes)).tolist()
        return channel_changes([self.contribution(run, unit) for unit in units], run)


def effect_channel_changes(
    effects: Sequence[LocatedEffect], run: PreparedRun
) -> list[list[ChannelChange]]:
    """Return changes of single channels per unit amplitude, for effects of joints.

    Several changes of one channel add up. Responses of vibrating links to all effects are computed
    together.
    """
    both = [each.unit_changes(run) for each in effects]
    found, vibration = [changes for changes, _ in both], run.vibration
    loaded_links = [(k, *load) for k, (_, loads) in enumerate(both) for load in loads]
    if vibration is None or not loaded_links:
        return found
    owners, amplitudes, links, wounds = zip(*loaded_links, strict=True)
    joints = np.array([effects[k].joint for k in owners])
    answers = vibration.respond_at_joints(
        joints,
        *(np.stack([np.broadcast_to(x, run.time.shape) for x in each]) for each in (links, wounds)),
    )
    for k, i, torques, deflections in zip(owners, amplitudes, *answers, strict=True):
        for joint in range(run.robot.n):
            found[k].append(("torque", joint, i, torques[:, joint]))
            found[k].append(("deflection", joint, i, deflections[:, joint]))
    return found


def effect_places(
    effect: Effect, robot: RobotConstants, runs: Sequence[str]
) -> Iterator[LocatedEffect]:
    """Yield every place of an effect with every combination of initial shapes."""
    grids: list[LocatedEffect] = []
    n = len(robot.joints)
    if effect.scope == "joint":
        grids = [LocatedEffect(effect=effect, joint=j) for j in range(n)]
    elif effect.scope == "link":
        # Masses fixed to the last link count as payload.
        grids = [LocatedEffect(effect=effect, link=j) for j in range(n - 1)]
    elif effect.scope == "run":
        grids = [LocatedEffect(effect=effect, joint=j, run=run) for j in range(n) for run in runs]
    elif effect.scope == "recording":
        grids = [LocatedEffect(effect=effect, run=run) for run in runs]
    else:
        grids = [LocatedEffect(effect=effect)]
    for place in grids:
        own = place.constants(robot)
        if effect.applies is not None and not effect.applies(own):
            continue
        for shapes in product(*(shape.grid(own) for shape in effect.shapes)):
            yield replace(place, shapes=shapes)


def _add_optional(a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
    if a is None or b is None:
        return b if a is None else a
    return np.asarray(a + b)


def _as_joint_column(values: object, like: np.ndarray, joint: int) -> np.ndarray | None:
    array = np.asarray(values, dtype=float)
    if not array.any():
        return None
    out = np.zeros_like(like)
    out[:, joint] = array
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatedEffect:
    """Effect at a place, with fitted amplitudes."""

    located: LocatedEffect
    amplitudes: tuple[float, ...]  # in their own units
    # Part of the first amplitude, in files of earlier versions, by which it was off the fit.
    step: float = 0.0

    @property
    def effect(self) -> Effect:
        """Entry of the catalogue."""
        return self.located.effect

    @property
    def shapes(self) -> tuple[float, ...]:
        """Fitted shapes in their own units."""
        return self.located.shapes

    @property
    def fitted(self) -> EstimatedEffect:
        """Effect as the fit estimated it."""
        first, *others = self.amplitudes
        return replace(self, amplitudes=(first - self.step, *others), step=0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Extension:
    """Change of a nominal model."""

    # Changes of nominal values by name: relative, [m], [rad], or of the inertial parameters of a
    # body.
    calibration: Mapping[ValueName, float] = field(default_factory=dict)
    effects: tuple[EstimatedEffect, ...] = ()

    def plus(self, later: Extension) -> Extension:
        """Return the sum of both."""
        names = {**self.calibration, **later.calibration}
        return Extension(
            calibration={
                name: self.calibration.get(name, 0.0) + later.calibration.get(name, 0.0)
                for name in names
            },
            effects=(*self.effects, *later.effects),
        )

    def minus(self, other: Extension) -> Extension:
        """Return the difference to another one."""
        opposite = Extension(
            calibration={name: -value for name, value in other.calibration.items()},
            effects=tuple(
                replace(e, amplitudes=tuple(-value for value in e.amplitudes))
                for e in other.effects
            ),
        )
        return self.plus(opposite)

    @property
    def fitted(self) -> Extension:
        """Extension as the fit estimated it, without the steps of earlier versions."""
        return replace(self, effects=tuple(each.fitted for each in self.effects))

    @property
    def acting(self) -> Extension:
        """Extension without effects that change no more than how torques are read."""
        own = tuple(each for each in self.effects if not each.effect.reads_torque)
        return replace(self, effects=own)

    @property
    def empty(self) -> bool:
        """True without any change."""
        return not self.effects and not any(self.calibration.values())


def with_amplitudes(
    effects: Sequence[LocatedEffect], scaled: np.ndarray, sizes: Sequence[np.ndarray]
) -> tuple[EstimatedEffect, ...]:
    """Return effects with amplitudes given over their sizes, concatenated."""
    out, begin = [], 0
    for located, size in zip(effects, sizes, strict=True):
        own = scaled[begin : begin + len(size)] * size
        out.append(EstimatedEffect(located=located, amplitudes=tuple(float(v) for v in own)))
        begin += len(size)
    return tuple(out)
