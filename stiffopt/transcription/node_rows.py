"""Rows added at single nodes of a transcribed problem, with numbers of their own at each node.

Path rows are the same at every point and part of the stage. Node rows are few, differ from node to
node and change between solves: their numbers are parameters of the programme, so a solver that was
set up for them is used again with new ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from stiffopt.transcription.nlp import Blocks
from stiffopt.transcription.ocp import Rows
from stiffopt.transcription.transcription import Transcription


@dataclass(frozen=True, kw_only=True, eq=False)
class NodeRows:
    """One row at each of k nodes."""

    rows: Rows  # of one label
    # (states (m,), numbers (d,)) -> scalar, of SX: some of the states at the node.
    function: ca.Function
    states: Sequence[int]  # (m,) their indices; positions only where motions are splines
    columns: np.ndarray  # (k,) nodes, counted from the first
    numbers: np.ndarray  # (k, d)
    kept: np.ndarray  # (k,) rows that hold; the others have no bounds


def with_node_rows(first: Transcription, blocks: Sequence[NodeRows]) -> Transcription:
    """Return the transcription with node rows appended to its programme."""
    nlp = first.nlp
    own = nlp.p.numel()
    data = _join_numbers(blocks)
    x, p = ca.MX.sym("x", len(nlp.lower_x)), ca.MX.sym("p", own + len(data))
    before = p[:own]
    parts, begin = [], own
    for block in blocks:
        end = begin + block.numbers.size
        given = ca.reshape(p[begin:end], block.numbers.shape[1], block.numbers.shape[0])
        parts.append(_MappedRows(first, block, x, given))
        begin = end
    f, g = ca.Function("base", [nlp.x, nlp.p], [nlp.f, nlp.g]).call([x, before], True, False)
    values = ca.vertcat(g, *(part.values for part in parts))
    multipliers, sigma = ca.MX.sym("lam_g", values.numel()), ca.MX.sym("lam_f")
    base = nlp.derivatives
    _, jacobian = base["jac_g"](x, before)
    hessian = base["hess_lag"](x, before, sigma, multipliers[: g.numel()])
    start = g.numel()
    for part in parts:
        weights = multipliers[start : start + part.count]
        hessian += ca.triu(part.hessian(weights))
        start += part.count
    slope = ca.vertcat(jacobian, *(part.jacobian for part in parts))
    made = replace(
        nlp,
        x=x,
        p=p,
        f=f,
        g=values,
        rows=_append_row_names(first, blocks),
        derivatives={
            "grad_f": ca.Function("nlp_grad_f", [x, p], list(base["grad_f"](x, before))),
            "jac_g": ca.Function("nlp_jac_g", [x, p], [values, slope]),
            "hess_lag": ca.Function("nlp_hess_l", [x, p, sigma, multipliers], [hessian]),
        },
    )
    outputs = ca.Function("outputs", [x, p], list(first.outputs(x, before)))
    return renumber_node_rows(replace(first, nlp=made, outputs=outputs), first, blocks)


def renumber_node_rows(
    made: Transcription, first: Transcription, blocks: Sequence[NodeRows]
) -> Transcription:
    """Return the programme with other numbers of the node rows, and others of them active.

    `made`: result of `with_node_rows`. `first`: without the rows. `blocks`: at the same nodes.
    """
    kept = np.concatenate([block.kept for block in blocks])
    lower, upper = (
        np.concatenate(
            [
                getattr(block.rows, side) / block.rows.scale
                for block in blocks
                for _ in block.columns
            ]
        )
        for side in ("lower", "upper")
    )
    nlp = replace(
        made.nlp,
        numbers=np.append(first.nlp.numbers, _join_numbers(blocks)),
        lower_g=np.append(first.nlp.lower_g, np.where(kept, lower, -np.inf)),
        upper_g=np.append(first.nlp.upper_g, np.where(kept, upper, np.inf)),
    )
    return replace(made, nlp=nlp)


class _MappedRows:
    """One block with its derivatives by all variables."""

    def __init__(self, first: Transcription, block: NodeRows, x: ca.MX, given: ca.MX) -> None:
        self.count = len(block.columns)
        self._inner = _selection_matrix(first, block)
        self._given = given
        states, numbers = block.function.sx_in()
        row = block.function(states, numbers) / float(block.rows.scale[0])
        weight = ca.SX.sym("weight")
        slope = ca.densify(ca.jacobian(row, states))
        bent = ca.densify(ca.hessian(weight * row, states)[0])
        inputs = [states, numbers]
        self._states = ca.reshape(ca.mtimes(self._inner, x), len(block.states), self.count)
        value, first_order = ca.Function("rows", inputs, [row, slope]).map(self.count)(
            self._states, given
        )
        self.values = ca.vec(value)
        pattern = ca.diagcat(*[ca.Sparsity.dense(1, len(block.states))] * self.count)
        self.jacobian = ca.mtimes(ca.sparsity_cast(first_order, pattern), self._inner)
        self._bent = ca.Function("bent", [*inputs, weight], [bent]).map(self.count)
        self._pattern = ca.diagcat(
            *[ca.Sparsity.dense(len(block.states), len(block.states))] * self.count
        )

    def hessian(self, weights: ca.MX) -> ca.MX:
        found = self._bent(self._states, self._given, weights.T)
        return ca.mtimes([self._inner.T, ca.sparsity_cast(found, self._pattern), self._inner])


def _selection_matrix(first: Transcription, block: NodeRows) -> ca.DM:
    """Matrix from the scaled variables to the states of every node."""
    if first.splines is not None:
        places = first.scheme.state_places(first.intervals)[block.columns]
        return first.splines.positions(places, block.states, len(first.nlp.lower_x))
    states = first.states
    width = len(states.rows)
    index = states.offset + block.columns[:, None] * width + np.asarray(block.states)
    scale = np.broadcast_to(states.rows.scale[np.asarray(block.states)], index.shape)
    return ca.DM.triplet(
        list(range(index.size)),
        index.ravel().tolist(),
        ca.DM(scale.ravel()),
        index.size,
        len(first.nlp.lower_x),
    )


def _append_row_names(first: Transcription, blocks: Sequence[NodeRows]) -> Blocks:
    found = Blocks(list(first.nlp.rows.items), first.nlp.rows.size)
    places = first.scheme.state_places(first.intervals)
    for block in blocks:
        found.add(block.rows, places[block.columns])
    return found


def _join_numbers(blocks: Sequence[NodeRows]) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(block.numbers.ravel() for block in blocks)])
