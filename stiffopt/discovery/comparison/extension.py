"""What was found, beside the nominal model: calibrated values and effects along a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stiffopt.discovery.comparison.bodies import body_torque
from stiffopt.discovery.comparison.filtering import derivative
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import nuisance_columns
from stiffopt.discovery.comparison.prepare import PreparedRun, with_link_torque
from stiffopt.recording.nominal import Tolerance

# Any tolerance above zero makes a column; its size does not matter here.
_EVERY = Tolerance(
    mass=1.0,
    com=1.0,
    rotor_inertia=1.0,
    coulomb=1.0,
    viscous=1.0,
    stiffness=1.0,
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
    """

    located: LocatedEffect
    amplitudes: tuple[float, ...]


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


@dataclass(frozen=True, eq=False)
class _Change:
    """Sum of what changes the channels, (K, n) each."""

    torque: np.ndarray
    link_torque: np.ndarray
    deflection: np.ndarray


def extended(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    """Run whose nominal torques and wind-up have an extension in them.

    Parameters
    ----------
    run : PreparedRun
        With the nominal model.
    robot : RobotModel
    extension : Extension

    Notes
    -----
    Terms are evaluated with the link torque that was found in the springs, as they were when they
    were fitted; the joints wind up by the exact law under it.
    """
    bent = with_link_torque(run, robot, _change(run, robot, extension).link_torque)
    change = _change(bent, robot, extension)
    wound = with_link_torque(run, robot, change.link_torque).signals
    drive = run.signals.drive_torque + change.torque
    return replace(
        run,
        signals=replace(
            wound,
            windup=wound.windup + change.deflection,
            drive_torque=drive,
            drive_torque_rate=derivative(run.low_pass(drive), wound.dt),
        ),
    )


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
            body_regressor=robot.body_regressor(q, rest, acceleration),
        )
        here = replace(few, signals=signals)
        return sum((_change(here, robot, each).link_torque for each in extensions), rest)

    held = link_torque(rest)
    units = (np.broadcast_to(unit, q.shape) for unit in np.eye(robot.n))
    return np.stack([link_torque(unit) - held for unit in units], axis=2)


def _change(run: PreparedRun, robot: RobotModel, extension: Extension) -> _Change:
    like = np.zeros_like(run.signals.spring_torque)
    change = _Change(like.copy(), like.copy(), like.copy())
    if extension.calibration:
        for column in nuisance_columns(run, robot, _EVERY):
            value = extension.calibration.get(column.name, 0.0)
            if not value:
                continue
            if column.torque is not None:
                change.torque[:] += value * column.torque
            # A change of both is a link torque: the joint winds up under it.
            if column.torque is not None and column.deflection is not None:
                change.link_torque[:] += value * column.torque
            elif column.deflection is not None:
                change.deflection[:] += value * column.deflection
        bodies = body_torque(robot, run.signals.body_regressor, extension.calibration)
        if bodies is not None:
            change.torque[:] += bodies
            change.link_torque[:] += bodies
    for each in extension.effects:
        _add(change, run, each)
    return change


def _add(change: _Change, run: PreparedRun, each: EstimatedEffect) -> None:
    added = each.located.contribution(run, each.amplitudes)
    for total, part in (
        (change.torque, added.torque),
        (change.link_torque, added.link_torque),
        (change.deflection, added.deflection),
    ):
        if part is not None:
            total += part


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
