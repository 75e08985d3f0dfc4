"""Columns of a comparison over the stated noise: what each value adds, about what was found."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.extended_run import around
from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.extension_change import moves_links
from stiffopt.discovery.comparison.located_effect import LocatedEffect, channels
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import MOVES_LINKS, OF_LOAD, nuisance_columns
from stiffopt.discovery.comparison.pieces import PieceColumns, PieceProducts, Pieces, PieceSums
from stiffopt.discovery.comparison.prepare import PreparedRun
from stiffopt.discovery.comparison.rows import ChannelNoise, ChannelRows
from stiffopt.recording.nominal import Tolerance

# Blocks a run is cut into where there are too few runs to leave one out.
FEW_RUNS = 3
_BLOCK_SECONDS = 2.0
_MOST_BLOCKS = 8
# Columns that are kept for the next time they are asked for: those of shapes that every search
# starts from as far as memory goes [bytes], and the latest of others.
_KEPT_BYTES, _KEPT_LATEST = 2**27, 64
# Motions of all links that are worked out beside each other [bytes].
_TOGETHER_BYTES = 2**22
# Earlier extensions that columns are kept about.
_FAMILY = 4
# Root mean square, over the noise that is left, of what links may do otherwise before they are
# followed anew.
NEAR = 0.3


@dataclass(eq=False)
class _Nominal:
    """Names, priors and columns (m, p) of the nominal values, and what products they have."""

    names: list[str]
    sd: np.ndarray
    matrix: np.ndarray
    sums: PieceSums | None = None
    products: dict[tuple[object, ...], PieceProducts] = field(default_factory=dict)


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
        self._kept: dict[tuple[object, ...], PieceColumns] = {}
        self._latest: dict[tuple[object, ...], PieceColumns] = {}
        self._starts: dict[tuple[object, ...], tuple[tuple[float, ...], ...]] = {}
        self._bytes = 0
        self._made: dict[bool, _Nominal] = {}
        self._family = [self]
        self.bodies: np.ndarray | None = None

    def _blocks(self) -> int:
        if len(self.runs) >= FEW_RUNS:
            return 1
        seconds = min(float(run.time[-1] - run.time[0]) for run in self.runs)
        return int(np.clip(seconds / _BLOCK_SECONDS, 2, _MOST_BLOCKS))

    def about(
        self, found: Extension, inflation: np.ndarray | None = None, near: float = NEAR
    ) -> Columns:
        """Columns about another extension; earlier ones where they are near enough.

        These again about masses that cannot be, whose swing would grow without end.

        Parameters
        ----------
        found : Extension
        inflation : array (2 n,), optional
            Noise that is left in every channel over the stated one; default as stated. Where links
            swing, what is left may be of links that were not followed yet: the stated one counts.
        near : float
            Rms over that noise of what links may do otherwise.
        """
        found = self._that_moves(found)
        if any(run.swing is not None for run in self.runs):
            inflation = None
        for earlier in reversed(self._family):
            if earlier._distance(found, inflation) < near:
                return earlier
        with np.errstate(over="ignore", invalid="ignore"):
            new = Columns(
                self.robot, self.nominal_runs, self.noise, self.tolerance, self.start, found
            )
        if not new._swings:
            return self
        new.bodies, new._family = self.bodies, self._family
        for other in self._family:
            other._forget()
        self._family.append(new)
        del self._family[1:-_FAMILY]
        return new

    @property
    def _swings(self) -> bool:
        """Whether what swings in the runs has masses that can be."""
        return all(run.swing is None or run.swing.possible for run in self.runs)

    def with_bodies(self, bodies: np.ndarray | None) -> Columns:
        """The same runs with inertial parameters free: their standard deviations (n, 10)."""
        new = copy(self)
        new.bodies, new._family = bodies, [new]
        return new

    def _forget(self) -> None:
        """Leave out columns of effects, which are made again where they are asked for."""
        self._kept.clear()
        self._bytes = 0
        for nominal in self._made.values():
            nominal.products.clear()

    def release(self) -> None:
        """Make room once a search is over: what was tried last is not asked for any more."""
        self._latest.clear()
        self.robot.kept_torques.clear()

    @property
    def nuisance(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Names, priors and columns (m, p) of the nominal values."""
        nominal = self._nominal
        sd = nominal.sd.copy()
        if self.bodies is not None:
            sd[: self.bodies.size] = self.bodies.ravel()
        return nominal.names, sd, nominal.matrix

    @property
    def _nominal(self) -> _Nominal:
        """Columns of the nominal values, the same whatever the width of free bodies is."""
        free = self.bodies is not None
        if free not in self._made:
            self._made[free] = self._nominal_columns()
        return self._made[free]

    def _nominal_columns(self) -> _Nominal:
        sd, columns, known = self._known_columns()
        # A joint at rest in one run, or links that could not be followed there, have no column.
        # One after another: a long run has no room for all of them before they are thinned.
        for number, run in enumerate(self.runs):
            new = nuisance_columns(
                run, self.robot, self.tolerance, self.bodies, lambda name: name not in known
            )
            for each in new:
                sd[each.name] = each.sd
                rows = columns.setdefault(each.name, np.zeros(self.rows.size))
                self.rows.put(rows, number, *each.added.channels(run, self.robot))
        matrix = np.column_stack([*columns.values(), np.zeros((self.rows.size, 0))])
        return _Nominal(list(sd), np.array(list(sd.values())), matrix)

    def _known_columns(self) -> tuple[dict[str, float], dict[str, np.ndarray], set[str]]:
        """Priors and columns of nominal values by name, and those that are as they were at first.

        Where no joint winds up, links move as they did, and only the load may be another.
        """
        first = self._family[0]._made.get(self.bodies is not None)
        if first is None or self.robot.elastic:
            return {}, {}, set()
        known = {name for name in first.names if not name.startswith(OF_LOAD)}
        columns = {
            name: column if name in known else np.zeros_like(column)
            for name, column in zip(first.names, first.matrix.T, strict=True)
        }
        return dict(zip(first.names, first.sd.tolist(), strict=True)), columns, known

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
            torque, deflection = run.swing.left_alone(run.starts())
            for i in range(torque.shape[2]):
                channels = (list(nothing), list(nothing))
                channels[0][k], channels[1][k] = torque[..., i], deflection[..., i]
                columns.append(self.rows.flatten(*channels))
        return np.column_stack(columns) if columns else np.zeros((self.rows.size, 0))

    def of_effect(self, located: LocatedEffect) -> np.ndarray:
        """Columns (m, k) of an effect's amplitudes over their sizes."""
        return self.pieces.joined(self._pieces_of(located))

    @cached_property
    def pieces(self) -> Pieces:
        """Pieces of the rows."""
        return Pieces(self.rows)

    @property
    def sums(self) -> PieceSums:
        """Sums that the columns of the nominal values make."""
        nominal = self._nominal
        if nominal.sums is None:
            nominal.sums = PieceSums(self.pieces, nominal.matrix, self.target)
        return nominal.sums

    def products(self, located: LocatedEffect) -> PieceProducts:
        """Columns of an effect with their products."""
        columns = self._pieces_of(located)
        known = self._nominal.products
        if located.key not in known:
            if located.key not in self._kept:
                return self.sums.products(columns)
            known[located.key] = self.sums.products(columns)
        return known[located.key]

    def _pieces_of(self, located: LocatedEffect) -> PieceColumns:
        key = located.key
        for kept in (self._kept, self._latest):
            if key in kept:
                return kept[key]
        if located.joint is None:
            return self._keep(located, self._of_robot(located))
        return self._keep(located, self._of_joints([located])[0])

    def make(self, effects: Sequence[LocatedEffect]) -> None:
        """Make columns that will be asked for next; together that is less where links swing."""
        if any(run.swing is None for run in self.runs):
            return
        asked = [
            each
            for each in effects
            if each.joint is not None and each.key not in self._kept.keys() | self._latest.keys()
        ]
        longest = max(run.signals.spring_torque.nbytes for run in self.runs)
        many = min(_KEPT_LATEST // 2, max(1, _TOGETHER_BYTES // longest))
        for begin in range(0, min(len(asked), _KEPT_LATEST // 2), many):
            part = asked[begin : begin + many]
            for each, columns in zip(part, self._of_joints(part), strict=True):
                self._keep(each, columns)

    def _keep(self, located: LocatedEffect, columns: PieceColumns) -> PieceColumns:
        """Keep columns for the next time they are asked for."""
        key = located.key
        self._bytes += columns.nbytes
        place = located.key[:-1]
        if place not in self._starts:
            self._starts[place] = located.starts(self.runs[0].signals.constants)
        grids = zip(located.shapes, self._starts[place], strict=True)
        if self._bytes < _KEPT_BYTES and all(value in grid for value, grid in grids):
            self._kept[key] = columns
            return columns
        self._bytes -= columns.nbytes
        self._latest[key] = columns
        if len(self._latest) > _KEPT_LATEST:
            self._latest.pop(next(iter(self._latest)))
        return columns

    def _of_robot(self, located: LocatedEffect) -> PieceColumns:
        """Columns of an effect that is of no single joint."""
        per_run = [list(located.columns(run, self.robot)) for run in self.runs]
        rows = [
            self.rows.flatten([c[0] for c in each], [c[1] for c in each])
            for each in zip(*per_run, strict=True)
        ]
        return self.pieces.split(np.column_stack(rows) * self._sizes(located))

    def _of_joints(self, effects: Sequence[LocatedEffect]) -> list[PieceColumns]:
        """Columns of effects of joints, made together."""
        sizes = [self._sizes(each) for each in effects]
        parts: list[list[tuple[int, np.ndarray]]] = [[] for _ in effects]
        # One run after another: where links swing, all channels of it are moved.
        for number, run in enumerate(self.runs):
            for own, size, of_run in zip(
                parts, sizes, channels(effects, run, self.robot), strict=True
            ):
                stretches = self.rows.of_channels(number, of_run, len(size))
                own.extend((begin, part * size) for begin, part in stretches)
        both = zip(parts, sizes, strict=True)
        return [self.pieces.from_stretches(own, len(size)) for own, size in both]

    def _sizes(self, located: LocatedEffect) -> np.ndarray:
        """Typical size of every amplitude (k,)."""
        return located.sizes(self.runs[0].signals.constants)

    def _distance(self, found: Extension, inflation: np.ndarray | None) -> float:
        """Rms over the noise that is left of what links would do otherwise than here."""
        names, _, matrix = self.nuisance
        change = found.less(self.found)
        values = np.array([change.calibration.get(name, 0.0) for name in names])
        rows = matrix @ values
        for each in change.effects:
            amplitudes = np.array(each.amplitudes) / self._sizes(each.located)
            rows = rows + self.of_effect(each.located) @ amplitudes
        if inflation is not None:
            rows = rows / inflation[self.rows.channel]
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
