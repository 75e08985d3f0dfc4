"""Transcription of an optimal-control problem on a mesh into an NLP."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import Block, Blocks, BlockScales, Nlp, Places
from stiffopt.transcription.node_derivatives import NumberedStage, SplineCoordinates
from stiffopt.transcription.ocp import (
    OptimalControlProblem,
    Rows,
    Waypoint,
    shortest_phase_share,
)
from stiffopt.transcription.point_function import StageFunction, compose_derivatives
from stiffopt.transcription.scheme import Intervals, Scheme, StagePoints, Symbols
from stiffopt.transcription.schemes import scheme_of
from stiffopt.transcription.structure import same_bounds, scaled_like, structure_of
from stiffopt.transcription.transcription import Transcription


def transcribe(
    ocp: OptimalControlProblem,
    method: str,
    mesh: Mesh,
    scales: BlockScales | None = None,
) -> Transcription:
    """Turn an optimal-control problem into an NLP.

    The stage is evaluated through one `casadi.Function.map` over all points and the graph is not
    expanded, so the time to build hardly grows with the mesh. `method`: name of `SCHEMES`. `mesh`:
    interval fractions of each phase; see `uniform_mesh`. `scales`: of another programme, in place
    of the problem's own where its blocks are the same.
    """
    scheme = scheme_of(method, len(ocp.chains[0]) - 1)
    stage = _stage_of(ocp, scheme)
    if scales is not None:
        # Spline coefficients have the units of their states.
        own = (ocp.states, ocp.controls) if stage.along is None else (ocp.chains,)
        blocks = scales.variables[: len(own) + 1]
        if [*map(len, blocks)] == [*map(len, (*own, ocp.statics))]:
            ocp = replace(ocp, static_scale=blocks[-1])
            if stage.along is None:
                ocp = replace(ocp, state_scale=blocks[0], control_scale=blocks[1])
    own_mesh = [part / part.sum() for part in mesh]
    return _NlpBuilder(ocp, scheme, own_mesh, stage, scales=scales).build()


def adapt(first: Transcription, ocp: OptimalControlProblem) -> Transcription | None:
    """Return the programme with bounds and numbers of another problem; None if more differs.

    Mesh and scales stay.
    """
    stage = _stage_of(ocp, first.scheme)
    if structure_of(ocp, stage, first.scheme, first.mesh) != first.structure:
        return None
    own = scaled_like(ocp, first.ocp)
    if same_bounds(own, first.ocp):
        # Only numbers of the stage differ: most cases of a sweep.
        fixed = first.nlp.numbers[: len(first.nlp.numbers) - len(stage.numbers)]
        nlp = replace(first.nlp, numbers=np.append(fixed, stage.numbers))
        return replace(first, ocp=own, nlp=nlp)
    return _NlpBuilder(own, first.scheme, first.mesh, stage, first).build()


def _stage_of(ocp: OptimalControlProblem, scheme: Scheme) -> NumberedStage:
    stage, splines = ocp.numbered_stage, scheme.splines(ocp, [np.ones(1)])
    if splines is None:
        return stage
    free = ocp.phases > 1 or not ocp.fixed_duration
    along = SplineCoordinates(splines.places, splines.degree, len(ocp.statics), free)
    return replace(stage, formula=f"{stage.formula} {along}", along=along)


class _NlpBuilder:
    """Collects variables and rows of one NLP.

    With `like` given, only bounds and numbers are made; its graph stays.
    """

    def __init__(
        self,
        ocp: OptimalControlProblem,
        scheme: Scheme,
        mesh: Mesh,
        stage: NumberedStage,
        like: Transcription | None = None,
        scales: BlockScales | None = None,
    ) -> None:
        self.own_stage = stage
        self.like = like
        if like is not None:
            scales = BlockScales.of(like.nlp)
        self.row_scales = () if scales is None else scales.rows
        self.ocp, self.scheme, self.mesh = ocp, scheme, mesh
        self.intervals = Intervals.of(mesh)
        self.variables, self.rows = Blocks(), Blocks()
        self.expressions: list[ca.MX] = []
        self.splines = scheme.splines(ocp, mesh)
        # Node values are variables only where spline coefficients are not.
        self.nodes = self.variables if self.splines is None else Blocks()
        self.coefficients: Block | None = None
        self._declare_variables()
        free = self.durations
        self.lift = (
            None
            if free is None
            else self.intervals.copy_durations(free.offset, self.variables.size)
        )
        # Variables, then the copies of durations.
        self.z = ca.MX.sym("z", self.variables.size if self.lift is None else self.lift.size1())
        self.x = self.z[: self.variables.size]
        fixed = [ocp.duration[0]] if self.durations is None else []
        self.numbers = np.append(fixed, self.own_stage.numbers)
        count = len(ocp.parameters)
        self.p = ca.MX.sym("p", count + len(self.numbers))
        self.parameters = self.p[:count]

    def build(self) -> Transcription:
        ocp = self.ocp
        count = len(self.intervals)
        copies = self.z[self.variables.size :]
        if self.durations is None:
            durations = ca.repmat(self.p[len(ocp.parameters)], count, 1)
        else:
            durations = copies[:count]
        symbols = self._make_symbols(durations)
        statics = self._block_symbol(self.statics)
        for name, index, expression, places in self.scheme.defects(symbols):
            labels = [ocp.states[i] for i in index]
            rows = Rows.make(name, labels, 0.0, 0.0, ocp.state_scale[index])
            self._add_rows(rows, expression, places, structural=True)
        points = self.scheme.stage_points(symbols)
        integrals = self._add_stage(symbols, points, statics)
        for rows, expression, places in self.scheme.extra_rows(symbols):
            self._add_rows(rows, expression, places)
        if self.splines is not None:
            self._add_spline_rows(symbols)
        self._add_control_rate_rows(symbols)
        self._add_waypoint_rows(symbols)
        if ocp.phases > 1:
            rows = Rows.make("duration", [""], *ocp.duration, unit="s")
            self._add_rows(rows, copies[count], None)
        # A fixed total is a number: as a variable it would couple each phase with all others.
        fixed = self.durations is None or ocp.fixed_duration
        total = ca.MX(ocp.duration[0]) if ocp.phases > 1 and fixed else durations[0]
        if not fixed:
            total = copies[count]
        if ocp.integral_function is not None:
            values = ocp.integral_function(integrals, total, statics, self.parameters)
            self._add_bounded_rows(ocp.integral_rows, values)
        ends = [
            self._state_at_node(symbols, column) for column in (0, self.states.lower.shape[1] - 1)
        ]
        objective = ocp.objective(integrals, total, statics, *ends, self.parameters)
        return self._make_transcription(integrals, objective)

    def _make_symbols(self, durations: ca.MX) -> Symbols:
        spline_values = None
        if self.splines is None:
            states, controls = self._block_symbol(self.states), self._block_symbol(self.controls)
        else:
            assert self.coefficients is not None
            spline_values = functools.partial(
                self.splines.at,
                coefficients=ca.vec(self._block_symbol(self.coefficients)),
                durations=durations,
            )
            nodes = spline_values(self.scheme.state_places(self.intervals))
            states, controls = ca.vertsplit(nodes, [0, len(self.ocp.states), nodes.shape[0]])
        return Symbols(
            ocp=self.ocp,
            intervals=self.intervals,
            states=states,
            controls=controls,
            durations=durations,
            parameters=self.parameters,
            spline_values=spline_values,
        )

    def _state_at_node(self, s: Symbols, column: int) -> ca.MX:
        if s.spline_values is None:
            return s.states[:, column]
        place = self.scheme.state_places(self.intervals)[[column]]
        return s.spline_values(place)[: len(self.ocp.states)]

    def _make_transcription(self, integrals: ca.MX, objective: ca.MX) -> Transcription:
        lower_x, upper_x = self.variables.bounds()
        lower_g, upper_g = self.rows.bounds()
        for index in np.flatnonzero(lower_x > upper_x):
            entry = self.variables.entry(int(index))
            low, high = lower_x[index] * entry.scale, upper_x[index] * entry.scale
            raise ProblemError(
                f"{self.ocp.name}: {entry} must be at least {low:g} and at most {high:g}. Move "
                "the boundary value inside the limits, or widen the limits."
            )
        own: dict[str, Any] = {
            "variables": self.variables,
            "rows": self.rows,
            "lower_x": lower_x,
            "upper_x": upper_x,
            "lower_g": lower_g,
            "upper_g": upper_g,
            "numbers": self.numbers,
        }
        blocks: dict[str, Any] = {
            "ocp": self.ocp,
            "states": self.states,
            "controls": self.controls,
            "statics": self.statics,
            "durations": self.durations,
            "path_blocks": tuple(self.path_blocks),
        }
        if self.like is not None:
            return replace(self.like, nlp=replace(self.like.nlp, **own), **blocks)
        x = self.z if self.lift is None else ca.MX.sym("x", self.variables.size)
        f, g, derivatives = compose_derivatives(
            self.stage,
            (self.z, self.p, self.values),
            self.variables_of_stage,
            ca.densify(objective),
            ca.vertcat(ca.MX(0, 1), *self.expressions),
            (x, self.lift),
            self.slope_of_variables,
        )
        nlp = Nlp(
            x=x,
            p=self.p,
            f=f,
            g=g,
            derivatives=derivatives,
            **own,
        )
        return Transcription(
            scheme=self.scheme,
            mesh=self.mesh,
            nlp=nlp,
            splines=self.splines,
            coefficients=self.coefficients,
            outputs=self._output_function(x, integrals, objective),
            structure=structure_of(self.ocp, self.own_stage, self.scheme, self.mesh),
            **blocks,
        )

    def _output_function(self, x: ca.MX, integrals: ca.MX, objective: ca.MX) -> ca.Function:
        values = self.stage.values(self.variables_of_stage, self.p)
        outer = ca.Function("outer", [self.z, self.p, self.values], [integrals, objective])
        inner = ca.Function("inner", [self.z, self.p], outer.call([self.z, self.p, values]))
        at_x = x if self.lift is None else ca.mtimes(self.lift, x)
        return ca.Function("outputs", [x, self.p], inner.call([at_x, self.p], True, False))

    def _declare_variables(self) -> None:
        ocp = self.ocp
        self.states = self.nodes.add_nodes(
            Rows.make("state", ocp.states, ocp.state_lower, ocp.state_upper, ocp.state_scale),
            self.scheme.state_places(self.intervals),
            (ocp.initial_lower, ocp.initial_upper),
            (ocp.final_lower, ocp.final_upper),
        )
        starts = self.scheme.continuous_control  # else there is no control at the start
        self.controls = self.nodes.add_nodes(
            Rows.make(
                "control",
                ocp.controls,
                ocp.control_lower,
                ocp.control_upper,
                ocp.control_scale,
            ),
            self.scheme.control_places(self.intervals),
            (ocp.initial_control_lower, ocp.initial_control_upper) if starts else (None, None),
            (ocp.final_control_lower, ocp.final_control_upper),
        )
        if self.splines is not None:
            self.coefficients = self._declare_coefficients()
        self.statics = self.variables.add(
            Rows.make(
                "static variable",
                ocp.statics,
                ocp.static_lower,
                ocp.static_upper,
                ocp.static_scale,
            ),
            None,
        )
        self.durations = None
        if ocp.phases > 1 or not ocp.fixed_duration:
            lower, upper = ocp.duration
            labels = [""]
            if ocp.phases > 1:
                lower = shortest_phase_share(ocp.phases) * (upper if np.isfinite(upper) else lower)
                labels = [f"phase {i + 1}" for i in range(ocp.phases)]
            rows = Rows.make("duration", labels, lower, upper, unit="s")
            self.durations = self.variables.add(rows, None)

    def _declare_coefficients(self) -> Block:
        """Add the coefficients of the splines; bounds fix those that a pose at rest determines."""
        assert self.splines is not None
        n = len(self.ocp.chains)
        rows = Rows.make("spline", [f"chain {j + 1}" for j in range(n)], -np.inf, np.inf)
        count = self.splines.size // n
        free = np.full((n, count), np.inf)
        lower, upper = -free, free.copy()
        for column, along in ((0, slice(None)), (-1, slice(None, None, -1))):
            rests = self._fixed_derivatives(column)
            pose = self.states.lower[[chain[0] for chain in self.ocp.chains], column]
            for bound in (lower, upper):
                bound[:, along][:, :rests] = pose[:, None]
        places = Places(
            np.repeat(np.arange(self.ocp.phases), self.splines.counts),
            np.concatenate([np.linspace(0.0, 1.0, k) for k in self.splines.counts]),
        )
        return self.variables.add(rows, places, lower, upper)

    def _fixed_derivatives(self, column: int) -> int:
        """Count the derivatives, position included, that an end at rest in a given pose fixes."""
        low, high = self.states.lower[:, column], self.states.upper[:, column]
        *orders, _ = (list(order) for order in zip(*self.ocp.chains, strict=True))
        for order, own in enumerate(orders):
            still = np.array_equal(low[own], high[own])
            if not still or (order and np.any(low[own])):
                return order
        return len(orders)

    def _add_spline_rows(self, s: Symbols) -> None:
        """Add bounds of states at the nodes, and continuity of the splines between phases."""
        assert s.spline_values is not None
        ocp, nodes = self.ocp, self.scheme.state_places(self.intervals)
        *orders, _ = (list(order) for order in zip(*ocp.chains, strict=True))
        last = len(nodes) - 1
        for order, own in enumerate(orders):
            for columns in ([0], list(range(1, last)), [last]):
                first = columns[0] if columns else 0
                fixed = len(columns) == 1 and order < self._fixed_derivatives(-1 if first else 0)
                low, high = self.states.lower[own, first], self.states.upper[own, first]
                kept = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
                if not columns or fixed or not kept.size:
                    continue
                index = [own[i] for i in kept]
                labels = [ocp.states[i] for i in index]
                name = "position" if order == 0 else "state"
                value = s.spline_values(nodes[columns], orders=(order,))
                scales = ocp.state_scale[index]
                rows = Rows.make(name, labels, low[kept], high[kept], scales)
                self._add_rows(rows, value[kept.tolist(), :], nodes[columns])
        for phase in range(ocp.phases - 1):
            ends = Places(np.array([phase]), np.ones(1)), Places(np.array([phase + 1]), np.zeros(1))
            leave, enter = (s.spline_values(place) for place in ends)
            scales = np.concatenate([ocp.state_scale, ocp.control_scale])
            rows = Rows.make("continuity", [*ocp.states, *ocp.controls], 0.0, 0.0, scales)
            self._add_rows(rows, enter - leave, ends[0], structural=True)

    def _spline_variables(self, points: StagePoints, durations: ca.MX) -> tuple[ca.MX, ca.DM]:
        """Return bases of the splines at all points, and the matrix to their variables."""
        along, splines, coefficients = self.own_stage.along, self.splines, self.coefficients
        assert along is not None
        assert splines is not None
        assert coefficients is not None
        count, n = len(points.places), len(along.chains)
        rows, basis = splines.nonzero_basis(points.places)
        own = [(rows[:, :, None] * n + np.arange(n)).reshape(count, -1) + coefficients.offset]
        own.append(np.tile(self.statics.offset + np.arange(self.statics.size), (count, 1)))
        values: ca.MX = ca.MX(ca.DM(basis.reshape(count, -1).T))
        if self.durations is None:
            powers = np.repeat(np.arange(along.orders), along.degree + 1)
            values = values * ca.repmat(durations[0] ** ca.DM(-powers), 1, count)
        else:
            own.append(self.durations.offset + points.places.phase[:, None])
        columns = np.hstack(own).ravel()
        scales = np.concatenate([block.scales for block in self.variables.items])
        pattern = ca.Sparsity.triplet(
            len(columns), self.variables.size, list(range(len(columns))), columns.tolist()
        )
        # Entries of a sparsity pattern are ordered by columns.
        return values, ca.DM(pattern, scales[np.sort(columns)])

    def _block_symbol(self, block: Block) -> ca.MX:
        part = self.x[block.offset : block.offset + block.size]
        if not np.all(block.rows.scale == 1.0):
            part = part * ca.DM(block.scales)
        return ca.reshape(part, *block.lower.shape)

    def _add_rows(
        self, rows: Rows, expression: ca.MX, places: Places | None, structural: bool = False
    ) -> Block:
        place = len(self.rows.items)
        if place < len(self.row_scales) and len(self.row_scales[place]) == len(rows):
            rows = replace(rows, scale=self.row_scales[place])
        block = self.rows.add(rows, places, structural=structural)
        column = ca.vec(ca.densify(expression))
        if not np.all(rows.scale == 1.0):
            column = column / ca.DM(block.scales)
        self.expressions.append(column)
        return block

    def _add_bounded_rows(
        self,
        blocks: Sequence[Rows],
        values: ca.MX,
        places: Places | None = None,
    ) -> list[tuple[Block, np.ndarray]]:
        """Add the bounded rows of a function's output, block by block.

        Return the blocks, each with the indices of its entries in the output.
        """
        begin, made = 0, []
        for rows in blocks:
            kept = np.flatnonzero(rows.bounded)
            entries = begin + kept
            part = values[entries.tolist(), :]
            begin += len(rows)
            if not kept.size:
                continue
            made.append((self._add_rows(rows.select(kept), part, places), entries))
        return made

    def _add_stage(self, s: Symbols, points: StagePoints, statics: ca.MX) -> ca.MX:
        count = len(points.places)
        values = self.own_stage.function.size1_out(1)
        if self.splines is None:
            basis = self.slope_of_variables = None
            self.variables_of_stage = ca.vertcat(
                points.states, points.controls, ca.repmat(statics, 1, count)
            )
        else:
            basis, chosen = self._spline_variables(points, s.durations)
            self.slope_of_variables = ca.MX(chosen)
            self.variables_of_stage = ca.reshape(ca.mtimes(chosen, self.x), -1, count)
        if self.like is None:
            self.stage = StageFunction(self.own_stage, count, len(self.ocp.parameters), basis)
        # Placeholder of the stage's values: derivatives are composed from the stage's own.
        self.values = ca.MX.sym("values", values, count)
        first = self.ocp.stage.size1_out(0)
        self.path_blocks = self._add_bounded_rows(
            self.ocp.path_rows, self.values[first:, :], points.places
        )
        return self.values[:first, :] @ (ca.DM(ca.sparsify(ca.DM(points.weights))) @ s.steps.T)

    def _add_control_rate_rows(self, s: Symbols) -> None:
        ocp = self.ocp
        low, high = ocp.control_rate_lower, ocp.control_rate_upper
        rows = Rows.make(
            "control rate",
            ocp.controls,
            -np.inf if low is None else low,
            np.inf if high is None else high,
        )
        use = np.flatnonzero(rows.bounded)
        if not use.size:
            return
        rows = rows.select(use)
        bounds = np.abs([rows.lower, rows.upper])
        largest = np.where(np.isfinite(bounds), bounds, 0.0).max(axis=0)
        rows = replace(rows, scale=np.where(largest > 0.0, largest, 1.0))
        for local in self.scheme.rate_nodes:
            rates = self.scheme.control_rates(s, float(local))[use.tolist(), :]
            self._add_rows(rows, rates, self.intervals.places(np.array([local])))
        if self.scheme.continuous_control:
            return
        # A jump between intervals would be an unbounded rate that no rate row sees.
        jumps = self.scheme.control_jumps(s)[use.tolist(), :]
        labels = [ocp.controls[i] for i in use]
        rows = Rows.make("control continuity", labels, 0.0, 0.0, ocp.control_scale[use])
        inner = self.intervals.places(np.array([0.0]))
        self._add_rows(rows, jumps, inner[1:], structural=True)

    def _add_waypoint_rows(self, s: Symbols) -> None:
        borders = np.flatnonzero(np.diff(self.intervals.phase)) + 1
        stride = len(self.scheme.state_nodes) - 1
        columns = [0, *(borders * stride), len(self.intervals) * stride]
        points: list[Waypoint | None] = [self.ocp.start, *self.ocp.vias, self.ocp.end]
        places = self.scheme.state_places(self.intervals)
        for column, point in zip(columns, points, strict=True):
            if point is not None:
                given = (self._state_at_node(s, int(column)), s.parameters)
                values = point.function(*given[: point.function.n_in()])
                self._add_bounded_rows(point.rows, values, places[[int(column)]])
