"""Columns of a comparison over the stated noise: what each value adds, about what was found."""

from __future__ import annotations

from copy import copy
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.extension import Extension, around, moves_links
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import MOVES_LINKS, NuisanceColumn, nuisance_columns
from stiffopt.discovery.comparison.prepare import PreparedRun
from stiffopt.discovery.comparison.rows import ChannelNoise, ChannelRows
from stiffopt.recording.nominal import Tolerance

# Blocks a run is cut into where there are too few runs to leave one out.
FEW_RUNS = 3
_BLOCK_SECONDS = 2.0
_MOST_BLOCKS = 8
# Columns that are kept for the next time they are asked for: those of shapes that every search
# starts from as far as memory goes [bytes], and the latest of others.
_KEPT_BYTES, _KEPT_LATEST = 2**28, 64
# Of modes that a run may begin to swing in, over the filter's cutoff.
_BEYOND_CUTOFF = 1.5
# Earlier extensions that columns are kept about.
_FAMILY = 4
# Root mean square, over noise, of what links may do otherwise before they are followed anew.
NEAR = 0.3


class Columns:
    """Training runs about what was found, and what small changes add to their rows.

    Parameters
    ----------
    robot : RobotModel
    runs : tuple of PreparedRun
        With the nominal model.
    noise : ChannelNoise
    tolerance : Tolerance
    start : Extension
        Of the model that is compared.
    found : Extension
        What links move with besides; laws that bend are taken about it.
    """

    def __init__(
        self,
        robot: RobotModel,
        runs: tuple[PreparedRun, ...],
        noise: ChannelNoise,
        tolerance: Tolerance,
        start: Extension,
        found: Extension,
    ) -> None:
        self.robot, self.noise, self.tolerance = robot, noise, tolerance
        self.start, self.found, self.nominal_runs = start, found, runs
        about = [around(run, robot, start, found) for run in runs]
        self.runs = tuple(run for run, _, _ in about)
        self._back = [(torque, deflection) for _, torque, deflection in about]
        self.rows = ChannelRows(self.runs, noise, self._blocks())
        self._kept: dict[tuple[object, ...], np.ndarray] = {}
        self._latest: dict[tuple[object, ...], np.ndarray] = {}
        self._family = [self]
        self.bodies: np.ndarray | None = None

    def _blocks(self) -> int:
        if len(self.runs) >= FEW_RUNS:
            return 1
        seconds = min(float(run.time[-1] - run.time[0]) for run in self.runs)
        return int(np.clip(seconds / _BLOCK_SECONDS, 2, _MOST_BLOCKS))

    def about(self, found: Extension, near: float = NEAR) -> Columns:
        """Columns about another extension; earlier ones where they are near enough.

        These again about masses that cannot be, whose swing would grow without end.
        """
        found = self._that_moves(found)
        for earlier in reversed(self._family):
            if earlier._distance(found) < near:
                return earlier
        with np.errstate(over="ignore", invalid="ignore"):
            new = Columns(
                self.robot, self.nominal_runs, self.noise, self.tolerance, self.start, found
            )
        if not new._swings:
            return self
        new.bodies, new._family = self.bodies, self._family
        for other in self._family:
            other._kept.clear()
        self._family.append(new)
        del self._family[1:-_FAMILY]
        return new

    @property
    def _swings(self) -> bool:
        """Whether what swings in the runs has masses that can be."""
        swings = [run.swing for run in self.runs if run.swing is not None]
        return all(np.all(swing.response.modes(0)[0] > 0.0) for swing in swings)

    def with_bodies(self, bodies: np.ndarray | None) -> Columns:
        """The same runs with inertial parameters free: their standard deviations (n, 10)."""
        new = copy(self)
        new.bodies, new._family = bodies, [new]
        new.__dict__.pop("nuisance", None)
        return new

    @cached_property
    def nuisance(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Names, priors and columns (m, p) of the nominal values."""
        per_run: list[list[NuisanceColumn]] = [
            list(nuisance_columns(run, self.robot, self.tolerance, self.bodies))
            for run in self.runs
        ]
        # A joint at rest in one run, or links that could not be followed there, have no column.
        order = {c.name: c for own in per_run for c in own}
        by_name = [{c.name: c for c in own} for own in per_run]
        columns = []
        for name in order:
            channels = [
                own[name].added.channels(run, self.robot) if name in own else (None, None)
                for own, run in zip(by_name, self.runs, strict=True)
            ]
            columns.append(self.rows.flatten([c[0] for c in channels], [c[1] for c in channels]))
        matrix = np.column_stack(columns) if columns else np.zeros((self.rows.size, 0))
        return list(order), np.array([c.sd for c in order.values()]), matrix

    @cached_property
    def target(self) -> np.ndarray:
        """What the model leaves of the measured channels (m,)."""
        torque, deflection = [], []
        for run, (back, back_wound) in zip(self.runs, self._back, strict=True):
            signals = run.signals
            # Amplitudes stay whole: what their own share moves the links by comes back.
            torque.append(bridged(run.torque) - signals.drive_torque + back)
            deflection.append(bridged(run.deflection) - signals.windup - run.beside + back_wound)
        return self.rows.flatten(torque, deflection)

    @cached_property
    def unknown(self) -> np.ndarray:
        """Rows (m, r) of the swings that runs may have begun with, each of its likely size."""
        nothing: list[np.ndarray | None] = [None] * len(self.runs)
        columns = []
        for k, run in enumerate(self.runs):
            if run.swing is None:
                continue
            signals = run.signals
            torque, deflection = run.swing.unknown_start(
                signals.motor_position - signals.link_position,
                _BEYOND_CUTOFF * run.low_pass.cutoff,
            )
            for i in range(torque.shape[2]):
                channels = (list(nothing), list(nothing))
                channels[0][k], channels[1][k] = torque[..., i], deflection[..., i]
                columns.append(self.rows.flatten(*channels))
        return np.column_stack(columns) if columns else np.zeros((self.rows.size, 0))

    def of_effect(self, located: LocatedEffect) -> np.ndarray:
        """Columns (m, k) of an effect's amplitudes over their sizes."""
        key = located.key
        for kept in (self._kept, self._latest):
            if key in kept:
                return kept[key]
        per_run = [list(located.columns(run, self.robot)) for run in self.runs]
        sizes = located.sizes(self.runs[0].signals.constants)
        columns = np.column_stack(
            [
                size * self.rows.flatten([c[0] for c in each], [c[1] for c in each])
                for size, each in zip(sizes, zip(*per_run, strict=True), strict=True)
            ]
        )
        full = (len(self._kept) + 1) * columns.nbytes > _KEPT_BYTES
        if not full and located.at_start(self.runs[0].signals.constants):
            self._kept[key] = columns
            return columns
        self._latest[key] = columns
        if len(self._latest) > _KEPT_LATEST:
            self._latest.pop(next(iter(self._latest)))
        return columns

    def _distance(self, found: Extension) -> float:
        """Rms over noise of what links would do otherwise than here."""
        names, _, matrix = self.nuisance
        change = found.less(self.found)
        values = np.array([change.calibration.get(name, 0.0) for name in names])
        rows = matrix @ values
        for each in change.effects:
            sizes = each.located.sizes(self.runs[0].signals.constants)
            rows = rows + self.of_effect(each.located) @ (np.array(each.amplitudes) / sizes)
        return float(np.sqrt(np.mean(rows**2)))

    def _that_moves(self, found: Extension) -> Extension:
        """The part of an extension that moves the links, or bends them where they do not swing."""
        swings = self.runs[0].swing is not None
        calibration = {
            name: value
            for name, value in found.calibration.items()
            if swings and name.split()[0] in MOVES_LINKS
        }
        return Extension(
            calibration=calibration,
            effects=tuple(
                e for e in found.effects if any(moves_links(run, e) for run in self.runs)
            ),
        )


def bridged(samples: np.ndarray) -> np.ndarray:
    """Single missing samples bridged for the filter; whole missing channels are zero."""
    out = np.where(np.isfinite(samples), samples, 0.0)
    for j in range(samples.shape[1]):
        missing = ~np.isfinite(samples[:, j])
        if missing.any() and not missing.all():
            places = np.arange(len(samples))
            out[missing, j] = np.interp(places[missing], places[~missing], samples[~missing, j])
    return out
