"""IPOPT on a transcribed problem: built once, solved many times."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import casadi as ca
import numpy as np

from stiffopt import native
from stiffopt.errors import InputError
from stiffopt.frontal import ipopt_options
from stiffopt.interrupts import handle_interrupts
from stiffopt.solver.monitor import FEASIBLE_VIOLATION, Iterate, Monitor, Progress
from stiffopt.symbolic import array_of
from stiffopt.transcription.nlp import Nlp, NlpEntry, RowViolation

_STATUS_BY_RETURN_STATUS = {
    "Solve_Succeeded": "optimal",
    "Feasible_Point_Found": "optimal",
    "Solved_To_Acceptable_Level": "acceptable",
    "Infeasible_Problem_Detected": "infeasible",
    "Restoration_Failed": "infeasible",
    "Maximum_Iterations_Exceeded": "iteration_limit",
    "Maximum_CpuTime_Exceeded": "time_limit",
    "Maximum_WallTime_Exceeded": "time_limit",
    "Invalid_Number_Detected": "invalid_number",
}

# Least distances of a warm start from bounds.
_WARM_PUSH_OPTIONS = (
    "warm_start_bound_push", "warm_start_bound_frac", "warm_start_slack_bound_push",
    "warm_start_slack_bound_frac", "warm_start_mult_bound_push",
)  # fmt: skip
WARM_BARRIER = 1e-6  # initial barrier parameter of a warm start
# Least barrier parameter over the tolerance: that at which IPOPT's monotone strategy ends. Left
# free, the adaptive one falls to 1e-11 far from the optimum, and rounding selects the next steps.
_MIN_BARRIER_SHARE = 1.0 / 11.0
# Largest step of a stationary iterate, over the tolerance.
_STATIONARY_STEP_FACTOR = 10.0


@dataclass(frozen=True, kw_only=True)
class IpoptOptions:
    """Options of IPOPT; all others stay at IPOPT's defaults."""

    tol: float = 1e-8  # relative tolerance of "optimal"
    acceptable_tol: float = 1e-6  # tolerance of "acceptable"
    max_iterations: int = 500
    # Iterations after which a solve without a nearly feasible point (1 % of each row's scale) ends
    # with "iteration_limit"; 0 for never.
    patience: int = 0
    # Further options of IPOPT by their own names.
    extra: Mapping[str, Any] = field(default_factory=dict)

    def for_ipopt(self) -> dict[str, Any]:
        """Return the options by IPOPT's names."""
        return {
            **_tolerance_options(self.tol),
            "acceptable_tol": self.acceptable_tol,
            "max_iter": self.max_iterations,
            **ipopt_options(native.library()),
            "print_level": 0,
            "sb": "yes",
            # The multipliers of fixed variables would cost a second gradient in each iteration.
            "fixed_variable_treatment": "make_parameter_nodual",
            **self.extra,
        }


class Multipliers(Protocol):
    """Multipliers of a programme at the end of a solve."""

    @property
    def multipliers_x(self) -> np.ndarray:
        """Multipliers of the bounds."""

    @property
    def multipliers_g(self) -> np.ndarray:
        """Multipliers of the rows."""


@dataclass(frozen=True, kw_only=True)
class RawSolution:
    """End of one NLP solve.

    After "optimal" and "acceptable" the values are those IPOPT ends with; after any other end they
    are those of the best iterate (least violation, then lowest objective).
    """

    # optimal, acceptable, infeasible, iteration_limit, time_limit, interrupted, invalid_number or
    # stalled (no progress from a point that is neither optimal nor infeasible).
    status: str
    reason: str  # IPOPT's return status, or the row without a finite value
    # Scaled NLP variables and rows.
    x: np.ndarray
    g: np.ndarray
    objective: float  # in the problem's unit
    violation: float  # worst row, relative to its scale
    worst_rows: list[RowViolation]
    # After "infeasible": the limits and boundary values that cannot hold together.
    conflicts: list[NlpEntry]
    iteration: int  # iteration that the values are of
    iterations: int  # number of iterations
    # Of the last iterate; pass the solution as `warm` to start another solve from them.
    multipliers_x: np.ndarray
    multipliers_g: np.ndarray
    history: list[Progress]
    # Seconds.
    build_s: float
    solve_s: float
    rough: bool = False  # solved to a wider tolerance than the problem's

    @property
    def converged(self) -> bool:
        """True where the solver met its tolerance, the full or the acceptable one."""
        return self.status in ("optimal", "acceptable")


class IpoptSolver:
    """Solver of one NLP with exact derivatives."""

    def __init__(self, nlp: Nlp, options: IpoptOptions | None = None) -> None:
        self.nlp = nlp
        self.options = options or IpoptOptions()
        begin = time.perf_counter()
        self._monitor = Monitor(nlp)
        self._symbols = nlp.casadi
        self._solver = self._create_solver({}, **nlp.derivatives)
        self._other: tuple[dict[str, Any], ca.Function] = ({}, self._solver)
        self.build_s = time.perf_counter() - begin

    @property
    def derivatives(self) -> tuple[ca.Function, ca.Function, ca.Function]:
        """Gradient of the objective, Jacobian of the rows, Hessian of the Lagrangian."""
        names = ("nlp_grad_f", "nlp_jac_g", "nlp_hess_l")
        gradient, jacobian, hessian = map(self._solver.get_function, names)
        return gradient, jacobian, hessian

    def solve(
        self,
        x0: np.ndarray,
        parameters: np.ndarray | None = None,
        *,
        warm: Multipliers | None = None,
        barrier: Literal["monotone", "adaptive"] = "monotone",
        mu_init: float = WARM_BARRIER,
        push: float = 1e-8,
        tolerance: float | None = None,
        report: Callable[[Progress], object] | None = None,
        max_seconds: float = np.inf,
        max_iterations: int | None = None,
    ) -> RawSolution:
        """Solve from a guess; Ctrl-C ends it at the next iteration with the best iterate kept.

        `x0`: scaled variables, see `Transcription.pack`. `parameters` (np,): zeros when absent.
        `warm`: initial multipliers, such as of the same NLP with other parameters. From there
        `mu_init` is the initial barrier, `barrier` its strategy (adaptive takes half the iterations
        to the optimum of a similar problem, monotone is safer where the problem changes more, as by
        a step of the smoothing) and `push` the least distance from bounds (1e-3 halves the
        iterations where they have been backed off beyond the start). `report` is called in each
        iteration. `tolerance` overrides that of the options, `max_iterations` only lowers it.
        """
        nlp = self.nlp
        p = nlp.parameters(parameters)
        inputs: dict[str, np.ndarray] = {
            "x0": np.asarray(x0, dtype=float),
            "p": p,
            "lbx": nlp.lower_x,
            "ubx": nlp.upper_x,
            "lbg": nlp.lower_g,
            "ubg": nlp.upper_g,
        }
        further: dict[str, Any] = {} if tolerance is None else _tolerance_options(tolerance)
        if warm is not None:
            further |= {"mu_strategy": barrier, "warm_start_init_point": "yes", "mu_init": mu_init}
            further |= dict.fromkeys(_WARM_PUSH_OPTIONS, push)
            inputs |= {"lam_x0": warm.multipliers_x, "lam_g0": warm.multipliers_g}
        solver = self._solver_with(further)
        monitor = self._monitor
        monitor.begin(report, max_seconds)

        def stationary(barrier: float = np.inf) -> bool:
            """True where full Newton steps change nothing, under at most this barrier parameter.

            The residual gradient is rounding along stiff directions then.
            """
            made = solver.stats()["iterations"]
            lengths = np.where(np.equal(made["regularization_size"], 0.0), made["alpha_pr"], 0.0)
            return made["mu"][-1] <= barrier and monitor.is_stationary(lengths.tolist())

        monitor.still_step = _STATIONARY_STEP_FACTOR * self.options.tol
        monitor.has_ended = functools.partial(stationary, self.options.tol)
        monitor.patience = self.options.patience
        monitor.max_iterations = max_iterations
        with handle_interrupts(lambda *_: monitor.interrupt.set()):
            outputs = solver(**inputs)
        solve_s = time.perf_counter() - monitor.started
        if monitor.error is not None:
            raise monitor.error
        word = str(solver.stats()["return_status"])
        status = monitor.stopped_by or _translate_status(word)
        if monitor.interrupt.is_set():  # after the last iteration too
            status = "interrupted"
        if status in ("acceptable", "stalled", "iteration_limit") and stationary():
            status = "optimal"
        last = self._last_iterate(outputs)
        best = last if status in ("optimal", "acceptable") else (monitor.best or last)
        reason = word
        if status == "infeasible" and best.violation <= FEASIBLE_VIOLATION:
            # A feasible iterate contradicts "infeasible": the solver diverged from it.
            status = "stalled"
        if status == "invalid_number":
            reason = self._locate_invalid_number([inputs["x0"], last.x], p) or word
        lam_x, lam_g = self._final_multipliers(outputs, p)
        return RawSolution(
            status=status,
            reason=reason,
            x=best.x,
            g=best.g,
            objective=best.objective,
            violation=best.violation,
            worst_rows=nlp.worst_rows(best.g, tolerance=self.options.tol),
            conflicts=nlp.conflicts(lam_x, lam_g) if status == "infeasible" else [],
            iteration=best.iteration,
            iterations=max(len(monitor.history) - 1, 0),
            multipliers_x=lam_x,
            multipliers_g=lam_g,
            history=monitor.history,
            build_s=self.build_s,
            solve_s=solve_s,
            rough=tolerance is not None,
        )

    def set_bounds(self, nlp: Nlp) -> None:
        """Replace the bounds, by those of the same NLP, for the solves that follow."""
        self.nlp = nlp
        self._monitor.nlp = nlp

    def _create_solver(self, further: dict[str, Any], **functions: ca.Function) -> ca.Function:
        options: dict[str, Any] = {
            "ipopt": {**self.options.for_ipopt(), **further},
            "iteration_callback": self._monitor,
            "print_time": False,
            "show_eval_warnings": False,
            "error_on_fail": False,
            # CasADi would derive gradients for unused sensitivities to parameters.
            "calc_lam_p": False,
            "no_nlp_grad": True,
            **functions,
        }
        return ca.nlpsol("solver", "ipopt", self._symbols, options)

    def _solver_with(self, further: dict[str, Any]) -> ca.Function:
        # IPOPT reads its options at setup; the derivatives are shared with the first solver. Only
        # the last one is kept: of a hundred phases each holds 100 MB.
        if not further:
            return self._solver
        if further != self._other[0]:
            names = ("grad_f", "jac_g", "hess_lag")
            shared = dict(zip(names, self.derivatives, strict=True))
            self._other = (further, self._create_solver(further, **shared))
        return self._other[1]

    def _final_multipliers(
        self, outputs: dict[str, ca.DM], p: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return multipliers of bounds and rows; of fixed variables from the Lagrangian."""
        lam_x, lam_g = (array_of(outputs[name]).ravel() for name in ("lam_x", "lam_g"))
        fixed = self.nlp.lower_x == self.nlp.upper_x
        if fixed.any():
            gradient = self._solver.get_function("nlp_grad_f")(outputs["x"], p)[1]
            jacobian = self._solver.get_function("nlp_jac_g")(outputs["x"], p)[1]
            slope = array_of(gradient + ca.mtimes(jacobian.T, outputs["lam_g"])).ravel()
            lam_x[fixed] = -slope[fixed]
        return lam_x, lam_g

    def _last_iterate(self, outputs: dict[str, ca.DM]) -> Iterate:
        g = array_of(outputs["g"]).ravel()
        excess = self.nlp.violations(g)
        return Iterate(
            iteration=max(len(self._monitor.history) - 1, 0),
            x=array_of(outputs["x"]).ravel(),
            g=g,
            objective=float(outputs["f"]),
            violation=float(excess.max()) if excess.size else 0.0,
        )

    def _locate_invalid_number(self, points: list[np.ndarray], p: np.ndarray) -> str:
        """Return a clause on the first row without a finite value or slope at one of the points."""
        value = ca.Function("value", [self.nlp.x, self.nlp.p], [self.nlp.f, self.nlp.g])
        slope = self._solver.get_function("nlp_jac_g")
        for x in points:
            f, g = (array_of(m).ravel() for m in value(x, p))
            bad = np.flatnonzero(~np.isfinite(g))
            if bad.size:
                return f"no finite value of row: {self.nlp.rows.entry(int(bad[0]))}"
            if not np.isfinite(f[0]):
                return "no finite value of the objective"
            jacobian = slope(x, p)[-1]
            rows = np.asarray(jacobian.sparsity().row())
            bad = rows[~np.isfinite(np.asarray(jacobian.nonzeros()))]
            if bad.size:
                return f"no finite slope of row: {self.nlp.rows.entry(int(bad.min()))}"
        return ""


def _tolerance_options(tolerance: float) -> dict[str, float]:
    return {"tol": tolerance, "mu_min": _MIN_BARRIER_SHARE * tolerance}


def _translate_status(word: str) -> str:
    if word == "Not_Enough_Degrees_Of_Freedom":
        raise InputError(
            "The problem has more equations than free variables. Free a boundary value or remove "
            "an equation."
        )
    return _STATUS_BY_RETURN_STATUS.get(word, "stalled")


def kkt_residual(nlp: Nlp, raw: RawSolution, parameters: np.ndarray | None = None) -> float:
    """Return the largest residual of the Karush-Kuhn-Tucker conditions of a solve.

    `raw`: ended at its last iterate ("optimal" or "acceptable"). `parameters` (np,). The largest
    of: gradient of the Lagrangian, excess of a bound or row, product of a multiplier and the
    distance to its bound; in the NLP's own scaling [-]. Computed from fresh derivatives,
    independently of the solver. For a convex problem a residual of zero proves the global optimum.
    """
    p = nlp.parameters(parameters)
    lagrangian = type(nlp.x).sym("lam", nlp.g.numel())
    gradient = ca.gradient(nlp.f, nlp.x) + ca.mtimes(ca.jacobian(nlp.g, nlp.x).T, lagrangian)
    function = ca.Function("kkt", [nlp.x, nlp.p, lagrangian], [gradient, nlp.g])
    slope, g = (array_of(m).ravel() for m in function(raw.x, p, raw.multipliers_g))
    worst = float(np.abs(slope + raw.multipliers_x).max(initial=0.0))
    for value, lower, upper, multiplier in (
        (raw.x, nlp.lower_x, nlp.upper_x, raw.multipliers_x),
        (g, nlp.lower_g, nlp.upper_g, raw.multipliers_g),
    ):
        excess = np.maximum(np.maximum(lower - value, value - upper), 0.0)
        # A positive multiplier holds at the upper bound, a negative one at the lower.
        with np.errstate(invalid="ignore"):
            slack = np.where(multiplier > 0.0, upper - value, value - lower)
            # At a bound that does not exist a multiplier is wrong by its own size.
            slack = np.where(np.isfinite(slack), slack, 1.0)
            product = np.abs(multiplier * slack)
        worst = max(worst, float(excess.max(initial=0.0)), float(product.max(initial=0.0)))
    return worst
