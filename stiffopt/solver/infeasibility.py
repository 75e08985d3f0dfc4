"""Infeasibility analysis: the motion that violates the rows of a programme least.

Every limit and waypoint gets one slack, the largest amount by which it is exceeded anywhere; their
sum is minimised. Bounds of the variables and the equations of motion remain hard constraints.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from stiffopt.solver.ipopt import IpoptOptions, IpoptSolver
from stiffopt.symbolic import array_of
from stiffopt.transcription.nlp import Blocks, Nlp, NlpEntry
from stiffopt.transcription.ocp import Rows

# Weight of the squared distance from the start, which leaves no direction undetermined.
_PROXIMITY_WEIGHT = 1e-4
_MAX_ITERATIONS = 150
# Share of the largest excess below which a row is no part of the conflict.
_MIN_CONFLICT_SHARE = 0.01
# Groups of rows exceeded by more than this, relative to their scale, are scaled down to it: beside
# others their size would drown the steps in rounding.
_MAX_SCALED_EXCESS = 100.0
# The scaling is repeated at the solution where a weight grows by this factor, so often at most.
_MIN_SCALING_GAIN, _MAX_RESCALED_SOLVES = 3.0, 3


@dataclass(frozen=True)
class LeastExcess:
    """Point of locally least excess of the rows."""

    x: np.ndarray
    # Sum over limits of the largest by which each is exceeded, relative to its scale.
    excess: float
    converged: bool
    # Violated rows, the worst first, then the active bounds that prevent less.
    conflicts: list[NlpEntry]
    status: str  # of the solver
    iterations: int


def minimise_excess(
    nlp: Nlp, x: np.ndarray, parameters: np.ndarray, max_seconds: float = np.inf
) -> LeastExcess:
    """Find the point near `x` that exceeds the rows of a programme least.

    The programme has derivatives of its own.
    """
    begin = time.perf_counter()
    relaxed = _RelaxedProgramme(nlp, x, parameters)
    found = _solve_relaxed(nlp, relaxed, x, parameters, max_seconds)
    for _ in range(_MAX_RESCALED_SOLVES):
        closer = _RelaxedProgramme(nlp, found.x, parameters)
        if not found.converged or not closer.is_better_scaled_than(relaxed):
            break
        # Excesses that are small beside those of the start are inaccurate: solve again from here.
        left = max(max_seconds - (time.perf_counter() - begin), 0.1)
        again = _solve_relaxed(nlp, closer, found.x, parameters, left)
        again = replace(again, iterations=found.iterations + again.iterations)
        if again.status in ("interrupted", "time_limit"):
            return again
        if not again.converged:
            return replace(found, iterations=again.iterations)
        relaxed, found = closer, again
    return found


def _solve_relaxed(
    nlp: Nlp, relaxed: _RelaxedProgramme, x: np.ndarray, parameters: np.ndarray, max_seconds: float
) -> LeastExcess:
    """Solve one relaxed programme from the point at which it is scaled."""
    options = IpoptOptions(
        tol=1e-6,
        acceptable_tol=1e-2,
        max_iterations=_MAX_ITERATIONS,
        extra={"mu_strategy": "adaptive", "acceptable_iter": 5},
    )
    n = len(nlp.lower_x)
    begin = np.append(np.clip(x, nlp.lower_x, nlp.upper_x), relaxed.slacks)
    raw = IpoptSolver(relaxed.nlp, options).solve(begin, parameters, max_seconds=max_seconds)
    slack = relaxed.unscaled(np.maximum(raw.x[n:], 0.0))
    multipliers = array_of(relaxed.selection.T @ ca.DM(raw.multipliers_g)).ravel()
    g, _ = nlp.derivatives["jac_g"](raw.x[:n], nlp.parameters(parameters))
    violated_entries = relaxed.violated_entries(nlp.violations(array_of(g)), slack)
    known = {(entry.name, entry.label) for entry in violated_entries}
    held = nlp.conflicts(raw.multipliers_x[:n], multipliers)
    violated_entries += [entry for entry in held if (entry.name, entry.label) not in known]
    return LeastExcess(
        x=raw.x[:n],
        excess=float(slack.sum()),
        converged=raw.converged,
        conflicts=violated_entries,
        status=raw.status,
        iterations=raw.iterations,
    )


class _RelaxedProgramme:
    """Programme with slacks on its rows, upper and lower bounds as rows of their own."""

    def __init__(self, nlp: Nlp, near: np.ndarray, parameters: np.ndarray) -> None:
        self._first, self._parameters = nlp, parameters
        groups, self.count = _slack_groups(nlp)
        self._slack_groups = groups
        free = groups >= 0
        fixed = np.flatnonzero(~free)
        upper = np.flatnonzero(free & np.isfinite(nlp.upper_g))
        lower = np.flatnonzero(free & np.isfinite(nlp.lower_g))
        chosen = np.concatenate([fixed, upper, lower])
        rows, slacks, n = len(chosen), self.count, len(nlp.lower_x)
        excess = self._group_excess(near)
        self._weight = 1.0 / np.maximum(excess / _MAX_SCALED_EXCESS, 1.0)
        weight = (
            np.where(groups >= 0, self._weight[groups], 1.0) if slacks else np.ones(len(groups))
        )
        self._begin = excess * self._weight
        self.selection = ca.DM.triplet(
            list(range(rows)), chosen.tolist(), ca.DM(weight[chosen]), rows, len(nlp.lower_g)
        )
        sign = np.concatenate([np.zeros(len(fixed)), -np.ones(len(upper)), np.ones(len(lower))])
        moved = np.flatnonzero(sign)
        eased = ca.DM.triplet(
            moved.tolist(), groups[chosen[moved]].tolist(), ca.DM(sign[moved]), rows, slacks
        )
        z, p = ca.MX.sym("z", n + slacks), ca.MX.sym("p", nlp.p.numel())
        x, s = z[:n], z[n:]
        g, jacobian = nlp.derivatives["jac_g"](x, p)
        away = x - ca.DM(np.clip(near, nlp.lower_x, nlp.upper_x))
        cost = ca.sum1(s) + 0.5 * _PROXIMITY_WEIGHT / n * ca.dot(away, away)
        sigma, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", rows)
        bent = nlp.derivatives["hess_lag"](x, p, 0.0, self.selection.T @ multipliers)
        hessian = ca.diagcat(
            bent + sigma * _PROXIMITY_WEIGHT / n * ca.DM.eye(n), ca.MX(slacks, slacks)
        )
        slope = ca.vertcat(_PROXIMITY_WEIGHT / n * away, ca.DM.ones(slacks))
        f, values = cost, self.selection @ g + eased @ s
        free_rows = np.full(rows, np.inf)
        low, high = -free_rows, free_rows
        low[: len(fixed)], high[: len(fixed)] = nlp.lower_g[fixed], nlp.upper_g[fixed]
        high[len(fixed) : len(fixed) + len(upper)] = (weight * nlp.upper_g)[upper]
        low[len(fixed) + len(upper) :] = (weight * nlp.lower_g)[lower]
        self.nlp = Nlp(
            x=z,
            p=p,
            f=f,
            g=values,
            variables=_anonymous_blocks(n + slacks),
            rows=_anonymous_blocks(rows),
            lower_x=np.append(nlp.lower_x, np.zeros(slacks)),
            upper_x=np.append(nlp.upper_x, np.full(slacks, np.inf)),
            lower_g=low,
            upper_g=high,
            derivatives={
                "grad_f": ca.Function("nlp_grad_f", [z, p], [f, ca.densify(slope)]),
                "jac_g": ca.Function(
                    "nlp_jac_g", [z, p], [values, ca.horzcat(self.selection @ jacobian, eased)]
                ),
                "hess_lag": ca.Function(
                    "nlp_hess_l", [z, p, sigma, multipliers], [ca.triu(hessian)]
                ),
            },
            numbers=nlp.numbers,
        )

    def is_better_scaled_than(self, other: _RelaxedProgramme) -> bool:
        """Return True where rows scaled down in `other` are scaled down far less here."""
        return bool(np.any(self._weight > _MIN_SCALING_GAIN * other._weight))

    @property
    def slacks(self) -> np.ndarray:
        """Initial slacks with which all rows hold strictly at the start."""
        return self._begin + 1e-2

    def unscaled(self, slack: np.ndarray) -> np.ndarray:
        """Return slacks relative to the original scales of the rows."""
        return np.asarray(slack / self._weight)

    def _group_excess(self, x: np.ndarray) -> np.ndarray:
        """Return the largest excess of each group of rows at a point."""
        nlp = self._first
        inside = np.clip(x, nlp.lower_x, nlp.upper_x)
        g, _ = nlp.derivatives["jac_g"](inside, nlp.parameters(self._parameters))
        excess = np.nan_to_num(nlp.violations(array_of(g)), nan=1.0, posinf=1e6)
        found = np.zeros(self.count)
        free = self._slack_groups >= 0
        np.maximum.at(found, self._slack_groups[free], excess[free])
        return found

    def violated_entries(self, excess: np.ndarray, slack: np.ndarray) -> list[NlpEntry]:
        """Return the violated rows, worst group first, each at its worst place."""
        found = []
        for group in np.argsort(-slack):
            if slack[group] > max(_MIN_CONFLICT_SHARE * slack.max(), 1e-5):
                own = np.flatnonzero(self._slack_groups == group)
                found.append(self._first.rows.entry(int(own[np.argmax(excess[own])])))
        return found


def _slack_groups(nlp: Nlp) -> tuple[np.ndarray, int]:
    """Return the slack index of each row, -1 without one, and the number of slacks."""
    numbers, count = np.full(nlp.rows.size, -1), 0
    for block in nlp.rows.items:
        # The duration stays a hard constraint: with more time any limit can be met.
        if not block.structural and block.size and block.rows.name != "duration":
            own = count + np.arange(block.size) % len(block.rows)
            numbers[block.offset : block.offset + block.size] = own
            count += len(block.rows)
    return numbers, count


def _anonymous_blocks(size: int) -> Blocks:
    """Return blocks of entries that no message names."""
    blocks = Blocks()
    free = np.full((1, size), np.inf)
    blocks.add(Rows.make("relaxed", [""], -np.inf, np.inf), None, -free, free)
    return blocks
