"""How well a point satisfies the first-order conditions of an NLP."""

from __future__ import annotations

import casadi as ca
import numpy as np

from stiffopt.solver.ipopt import RawSolution
from stiffopt.transcription.nlp import Nlp


def kkt_residual(nlp: Nlp, raw: RawSolution, parameters: np.ndarray | None = None) -> float:
    """Largest residual of the Karush-Kuhn-Tucker conditions of a solve.

    Parameters
    ----------
    nlp : Nlp
    raw : RawSolution
        Ended at its last iterate ("optimal" or "acceptable").
    parameters : array (np,), optional

    Returns
    -------
    float
        The largest of: gradient of the Lagrangian, excess of a bound or row, product of a
        multiplier and the distance to its bound; in the NLP's own scaling [-].

    Notes
    -----
    Computed from fresh derivatives, not taken from the solver's word. For a convex problem a
    residual of zero proves the global optimum.
    """
    p = np.zeros(nlp.p.numel()) if parameters is None else np.asarray(parameters, dtype=float)
    lagrangian = type(nlp.x).sym("lam", nlp.g.numel())
    gradient = ca.gradient(nlp.f, nlp.x) + ca.mtimes(ca.jacobian(nlp.g, nlp.x).T, lagrangian)
    function = ca.Function("kkt", [nlp.x, nlp.p, lagrangian], [gradient, nlp.g])
    slope, g = (m.full().ravel() for m in function(raw.x, p, raw.multipliers_g))
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
