"""Design matrix of a comparison over the stated noise: columns of nominal values and effects."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice

import numpy as np

from stiffopt.discovery.comparison.channel_rows import ChannelNoise, ChannelRows
from stiffopt.discovery.comparison.extended_run import linearise_run
from stiffopt.discovery.comparison.extension_change import (
    extension_change,
    link_moving_part,
    with_drive_torque,
)
from stiffopt.discovery.comparison.filtering import fill_missing
from stiffopt.discovery.comparison.located_effect import (
    Extension,
    LocatedEffect,
    channel_changes,
    effect_channel_changes,
)
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import (
    BODY_VALUES,
    LOAD_VALUE,
    nuisance_columns,
)
from stiffopt.discovery.comparison.piece_sums import PieceColumns, PieceProducts, Pieces, PieceSums
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.names import ValueName
from stiffopt.recording.nominal import Tolerance

# Smallest number of runs of which each is a cross-validation block; fewer runs are cut into blocks.
MIN_RUNS_AS_BLOCKS = 3
# Length of the stretches that are left out [s], longer than the correlation time of residuals, and
# largest number of blocks per run.
STRETCH_DURATION, _MAX_BLOCKS = 2.0, 8
# Cache of columns: of initial shapes, which every search asks for, up to a memory limit [bytes],
# and a number of the latest others.
_START_CACHE_BYTES, _RECENT_CACHE_SIZE = 2**27, 64
# Memory of link motions that are computed together [bytes].
_BATCH_BYTES = 2**21
# Number of earlier linearisations in memory.
_MAX_EARLIER = 4
_NO_EXTENSION = Extension()
# Largest linearisation error of the links before a new linearisation, rms over the residual noise.
MAX_LINEARISATION_ERROR = 0.3


def _batch_size(run: PreparedRun) -> int:
    """Return the number of link motions along a run that are computed together."""
    return int(max(1, _BATCH_BYTES // run.signals.spring_torque.nbytes))


@dataclass(eq=False)
class _NominalColumns:
    """Names, priors and columns of the nominal values, and their products with others.

    Columns (p, m) are kept once, their rows in the order of pieces.
    """

    names: list[ValueName]
    sd: np.ndarray
    ordered: np.ndarray
    sums: PieceSums | None = None
    products: dict[tuple[object, ...], PieceProducts] = field(default_factory=dict)


class DesignMatrix:
    """Training runs linearised about an extension, and columns of small changes to them.

    `runs`: runs with the nominal model. `start`: extension of the compared model. `found`: further
    extension by which the links move; nonlinear effects are linearised about it.
    """

    def __init__(
        self,
        robot: RobotModel,
        runs: tuple[PreparedRun, ...],
        noise: ChannelNoise,
        tolerance: Tolerance,
        start: Extension = _NO_EXTENSION,
        found: Extension = _NO_EXTENSION,
    ) -> None:
        self.robot, self.noise, self.tolerance = robot, noise, tolerance
        self.start, self.found, self.nominal_runs = start, found, runs
        about = [linearise_run(run, start, found) for run in runs]
        self.runs = tuple(run for run, _, _ in about)
        self._own_share = [(torque, deflection) for _, torque, deflection in about]
        self.rows = ChannelRows(self.runs, noise, self._blocks_per_run())
        self._start_cache: dict[tuple[object, ...], PieceColumns] = {}
        self._recent_cache: dict[tuple[object, ...], PieceColumns] = {}
        self._shape_starts: dict[tuple[object, ...], tuple[tuple[float, ...], ...]] = {}
        self._cached_bytes = 0
        self._nominal_by_freedom: dict[bool, _NominalColumns] = {}
        self._earlier = [self]
        self.bodies: np.ndarray | None = None
        # Runs as the torque is read, with all effects found; keys of the effects that read it.
        self._read_runs = self.runs
        self._reading_keys: set[tuple[object, ...]] = set()

    def _blocks_per_run(self) -> int:
        if len(self.runs) >= MIN_RUNS_AS_BLOCKS:
            return 1
        seconds = min(float(run.time[-1] - run.time[0]) for run in self.runs)
        return int(np.clip(seconds / STRETCH_DURATION, 2, _MAX_BLOCKS))

    def linearised_at(
        self,
        found: Extension,
        inflation: np.ndarray | None = None,
        near: float = MAX_LINEARISATION_ERROR,
    ) -> DesignMatrix:
        """Return the design matrix about another extension: its link motion, and torque readings.

        `inflation` (2 n,): residual noise of every channel over the stated one; default as stated.
        `near`: largest linearisation error, rms over that noise.
        """
        links = self._linearise_links(found, inflation, near)
        return links._linearise_readings(found, inflation, near)

    def _linearise_readings(
        self, found: Extension, inflation: np.ndarray | None, near: float
    ) -> DesignMatrix:
        """Return the matrix with readings of the torque that an extension adds to."""
        read = []
        for run, (known, _) in zip(self.runs, self._own_share, strict=True):
            change = extension_change(run, found.acting)
            # Vibrating links were simulated with their part of the change.
            link = change.link_torque - known if run.vibration is None else 0.0
            read.append(with_drive_torque(run, change.torque + link))
        moved = [
            new.signals.drive_torque - old.signals.drive_torque
            for new, old in zip(read, self._read_runs, strict=True)
        ]
        rows = self.rows.flatten(moved, [np.zeros_like(each) for each in moved])
        if inflation is not None:
            rows = rows / inflation[self.rows.channel]
        if np.sqrt(np.mean(rows**2)) < near:
            return self
        new = copy(self)
        new._read_runs = tuple(read)
        keys = self._reading_keys
        new._start_cache, new._recent_cache = (
            {key: own for key, own in cache.items() if key not in keys}
            for cache in (self._start_cache, self._recent_cache)
        )
        new._cached_bytes = sum(each.nbytes for each in new._start_cache.values())
        new._nominal_by_freedom = {
            free: replace(own, products={k: v for k, v in own.products.items() if k not in keys})
            for free, own in self._nominal_by_freedom.items()
        }
        self._earlier[:] = [new if each is self else each for each in self._earlier]
        return new

    def _linearise_links(
        self, found: Extension, inflation: np.ndarray | None, near: float
    ) -> DesignMatrix:
        """Return the matrix about a link motion, or an earlier one near it.

        Returns itself where masses are not positive definite, whose vibration would grow without
        bound. With vibrating links the residual may stem from the linearisation: the stated noise
        counts.
        """
        found = link_moving_part(self.runs, found)
        if any(run.vibration is not None for run in self.runs):
            inflation = None
        for earlier in reversed(self._earlier):
            if earlier._linearisation_error(found, inflation) < near:
                return earlier
            earlier._release_steps()
        with np.errstate(over="ignore", invalid="ignore"):
            new = DesignMatrix(
                self.robot, self.nominal_runs, self.noise, self.tolerance, self.start, found
            )
        vibrations = [run.vibration for run in new.runs if run.vibration is not None]
        if not all(each.has_positive_inertia for each in vibrations):
            return self
        new.bodies, new._earlier = self.bodies, self._earlier
        for other in self._earlier:
            other._clear_effect_columns()
        self._earlier.append(new)
        del self._earlier[1:-_MAX_EARLIER]
        return new

    def with_bodies(self, bodies: np.ndarray | None) -> DesignMatrix:
        """Return the matrix with inertial parameters free: their standard deviations (n, 10).

        Without the linearisations that a search went through.
        """
        new = copy(self)
        new.bodies, new._earlier = bodies, [new]
        return new

    def _clear_effect_columns(self) -> None:
        """Free the memory of effect columns, which are recomputed when needed."""
        self._start_cache.clear()
        self._cached_bytes = 0
        for nominal in self._nominal_by_freedom.values():
            nominal.products.clear()

    def _release_steps(self) -> None:
        """Free the memory of transition matrices, which are recomputed when needed."""
        for run in self.runs:
            if run.vibration is not None:
                run.vibration.response.release_steps()

    def release_memory(self) -> None:
        """Free the memory of columns that are not needed after a search."""
        self._recent_cache.clear()
        self.robot.torque_cache.clear()

    def release_effects(self) -> None:
        """Free the memory of all effects of this linearisation and earlier ones."""
        self.release_memory()
        for each in self._earlier:
            each._recent_cache.clear()
            each._clear_effect_columns()
            each._release_steps()

    @property
    def priors(self) -> tuple[list[ValueName], np.ndarray]:
        """Names and priors of the nominal values."""
        nominal = self._cached_nominal
        sd = nominal.sd.copy()
        if self.bodies is not None:
            sd[: self.bodies.size] = self.bodies.ravel()
        return nominal.names, sd

    @property
    def nuisance(self) -> np.ndarray:
        """Columns (m, p) of the nominal values."""
        return self.pieces.unorder(self._cached_nominal.ordered).T

    def nominal_rows(self, values: np.ndarray) -> np.ndarray:
        """Return the rows (m,) of nominal values (p,)."""
        return self.pieces.unorder(values @ self._cached_nominal.ordered)

    @property
    def _cached_nominal(self) -> _NominalColumns:
        """Columns of the nominal values, independent of the priors of free bodies."""
        free = self.bodies is not None
        if free not in self._nominal_by_freedom:
            self._nominal_by_freedom[free] = self._build_nominal_columns()
        return self._nominal_by_freedom[free]

    def _build_nominal_columns(self) -> _NominalColumns:
        sd, columns, known = self._unchanged_columns()
        # A joint at rest, or links without a solution, have no column in a run. A few columns after
        # others: a long run has no memory for all of them before decimation.
        for number, run in enumerate(self.runs):
            new = nuisance_columns(run, self.tolerance, self.bodies, lambda name: name not in known)
            while together := list(islice(new, _batch_size(run))):
                like = run.signals.spring_torque
                added = [each.contribution(like) for each in together]
                changes = channel_changes(added, run)
                for each, change in zip(together, changes, strict=True):
                    sd[each.name] = each.sd
                    rows = columns.setdefault(each.name, np.zeros(self.rows.size))
                    self.rows.fill_run(rows, number, *change)
        ordered = np.empty((len(columns), self.rows.size))
        for out, name in zip(ordered, sd, strict=True):
            out[:] = self.pieces.order(columns.pop(name))
        return _NominalColumns(list(sd), np.array(list(sd.values())), ordered)

    def _unchanged_columns(
        self,
    ) -> tuple[dict[ValueName, float], dict[ValueName, np.ndarray], set[ValueName]]:
        """Return priors and columns of nominal values by name, and the names of unchanged ones.

        With rigid joints links move as in the first linearisation: only the load may differ, and
        gravity and joint zeros.
        """
        first = self._earlier[0]._nominal_by_freedom.get(self.bodies is not None)
        if first is None or self.robot.elastic:
            return {}, {}, set()
        changing = {LOAD_VALUE}
        if any(e.effect.changes_geometry for e in self.found.effects):
            changing.update(BODY_VALUES)
        known = {name for name in first.names if name.kind not in changing}
        columns = {
            name: self.pieces.unorder(column) if name in known else np.zeros_like(column)
            for name, column in zip(first.names, first.ordered, strict=True)
        }
        return dict(zip(first.names, first.sd.tolist(), strict=True)), columns, known

    @cached_property
    def target(self) -> np.ndarray:
        """Residual of the measured channels (m,)."""
        torque, deflection = [], []
        for run, (back, back_wound) in zip(self.runs, self._own_share, strict=True):
            signals = run.signals
            # Add the contribution of the linearisation point: fitted amplitudes are then total
            # ones.
            torque.append(fill_missing(run.torque) - signals.drive_torque + back)
            deflection.append(
                fill_missing(run.deflection) - signals.windup - run.added_deflection + back_wound
            )
        return self.rows.flatten(torque, deflection)

    @cached_property
    def initial_state_columns(self) -> np.ndarray:
        """Columns (m, r) of likely initial vibrations, each of its expected size."""
        nothing: list[np.ndarray | None] = [None] * len(self.runs)
        columns = []
        for k, run in enumerate(self.runs):
            if run.vibration is None:
                continue
            torque, deflection = run.vibration.free_vibration(run.initial_states())
            for i in range(torque.shape[2]):
                channels = (list(nothing), list(nothing))
                channels[0][k], channels[1][k] = torque[..., i], deflection[..., i]
                columns.append(self.rows.flatten(*channels))
        return np.column_stack(columns) if columns else np.zeros((self.rows.size, 0))

    def effect_columns(self, located: LocatedEffect) -> np.ndarray:
        """Return columns (m, k) of an effect's amplitudes over their sizes."""
        return self.pieces.join(self._effect_pieces(located))

    def effect_rows(self, located: LocatedEffect, values: np.ndarray) -> np.ndarray:
        """Return the rows (m,) of an effect with amplitudes (k,) over their sizes."""
        return self.pieces.join(self._effect_pieces(located).times(values))[:, 0]

    @cached_property
    def pieces(self) -> Pieces:
        """Pieces of the rows, one per channel and block."""
        return Pieces(self.rows)

    @property
    def sums(self) -> PieceSums:
        """Sums of products of the columns of nominal values."""
        nominal = self._cached_nominal
        if nominal.sums is None:
            nominal.sums = PieceSums(self.pieces, nominal.ordered, self.target)
        return nominal.sums

    def products(self, located: LocatedEffect) -> PieceProducts:
        """Return the columns of an effect with their products."""
        columns = self._effect_pieces(located)
        known = self._cached_nominal.products
        if located.key not in known:
            if located.key not in self._start_cache:
                return self.sums.products(columns)
            known[located.key] = self.sums.products(columns)
        return known[located.key]

    def _effect_pieces(self, located: LocatedEffect) -> PieceColumns:
        key = located.key
        for kept in (self._start_cache, self._recent_cache):
            if key in kept:
                return kept[key]
        if not located.is_of_one_joint:
            return self._cache_columns(located, self._robot_effect_pieces(located))
        return self._cache_columns(located, self._joint_effect_pieces([located])[0])

    def prepare_effects(self, effects: Sequence[LocatedEffect]) -> int:
        """Compute columns of the first effects in advance; return their number.

        Together is faster where links vibrate.
        """
        if any(run.vibration is None for run in self.runs):
            return len(effects)
        first = effects[: _RECENT_CACHE_SIZE // 2]
        asked = [
            each
            for each in first
            if each.is_of_one_joint
            and each.key not in self._start_cache
            and each.key not in self._recent_cache
        ]
        many = min(_batch_size(run) for run in self.runs)
        while asked:
            loads = np.cumsum([len(each.effect.amplitudes) for each in asked])
            count = max(1, int(np.searchsorted(loads, many, "right")))
            part, asked = asked[:count], asked[count:]
            for each, columns in zip(part, self._joint_effect_pieces(part), strict=True):
                self._cache_columns(each, columns)
        return len(first)

    def _cache_columns(self, located: LocatedEffect, columns: PieceColumns) -> PieceColumns:
        """Store columns in the cache of initial shapes or of recent ones."""
        key = located.key
        if located.effect.reads_torque:
            self._reading_keys.add(key)
        self._cached_bytes += columns.nbytes
        place = located.key[:-1]
        if place not in self._shape_starts:
            self._shape_starts[place] = located.starts(self.runs[0].signals.constants)
        grids = zip(located.shapes, self._shape_starts[place], strict=True)
        if self._cached_bytes < _START_CACHE_BYTES and all(value in grid for value, grid in grids):
            self._start_cache[key] = columns
            return columns
        self._cached_bytes -= columns.nbytes
        self._recent_cache[key] = columns
        if len(self._recent_cache) > _RECENT_CACHE_SIZE:
            self._recent_cache.pop(next(iter(self._recent_cache)))
        return columns

    def _robot_effect_pieces(self, located: LocatedEffect) -> PieceColumns:
        """Return the columns of an effect of the robot or a link."""
        runs = self._read_runs if located.effect.reads_torque else self.runs
        per_run = [located.columns(run) for run in runs]
        rows = [
            self.rows.flatten([c[0] for c in each], [c[1] for c in each])
            for each in zip(*per_run, strict=True)
        ]
        return self.pieces.split(np.column_stack(rows) * self._amplitude_sizes(located))

    def _joint_effect_pieces(self, effects: Sequence[LocatedEffect]) -> list[PieceColumns]:
        """Return the columns of effects of joints, computed together."""
        sizes = [self._amplitude_sizes(each) for each in effects]
        parts: list[list[tuple[int, np.ndarray]]] = [[] for _ in effects]
        # Run by run: vibrating links respond in all channels, which takes memory.
        for number, run in enumerate(self.runs):
            for own, size, of_run in zip(
                parts, sizes, effect_channel_changes(effects, run), strict=True
            ):
                stretches = self.rows.channel_columns(number, of_run, len(size))
                own.extend((begin, part * size) for begin, part in stretches)
        both = zip(parts, sizes, strict=True)
        return [self.pieces.from_stretches(own, len(size)) for own, size in both]

    def _amplitude_sizes(self, located: LocatedEffect) -> np.ndarray:
        """Return the typical size of every amplitude (k,)."""
        return located.sizes(self.runs[0].signals.constants)

    def _linearisation_error(self, found: Extension, inflation: np.ndarray | None) -> float:
        """Return the rms over residual noise of link motion not included here."""
        names, _ = self.priors
        change = found.minus(self.found)
        rows = self.nominal_rows(np.array([change.calibration.get(name, 0.0) for name in names]))
        for each in change.effects:
            amplitudes = np.array(each.amplitudes) / self._amplitude_sizes(each.located)
            rows += self.effect_rows(each.located, amplitudes)
        if inflation is not None:
            rows = rows / inflation[self.rows.channel]
        return float(np.sqrt(np.mean(rows**2)))
