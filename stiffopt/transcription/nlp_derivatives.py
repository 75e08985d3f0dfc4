"""Derivatives of an NLP, put together from those of its stage.

With the stage's variables w(x) and values v = V(w), the programme is f(x, v), g(x, v), where all
but V is cheap. By the chain rule, S = V' w' and the Lagrangian L(x, v) = sigma f + lambda^T g,

    g' = g_x + g_v S,    L'' = L_xx + L_xv S + (L_xv S)^T + S^T L_vv S + sum (V'^T L_v)_k w_k''
                               + w'^T (sum (L_v)_i V_i'') w'.

CasADi's own way through the same graph, colour by colour, takes several times as long.
"""

from __future__ import annotations

import casadi as ca

from stiffopt.transcription.stage_function import StageFunction


def composed(
    stage: StageFunction,
    symbols: tuple[ca.MX, ca.MX, ca.MX],
    variables: ca.MX,
    objective: ca.MX,
    rows: ca.MX,
    slope: ca.MX | None = None,
) -> tuple[ca.MX, ca.MX, dict[str, ca.Function]]:
    """Objective and rows as expressions of x alone, and their derivatives for `casadi.nlpsol`.

    Parameters
    ----------
    stage : StageFunction
    symbols : MX
        x, parameters p, and v (m, count), which stands for the stage's values.
    variables : MX (n, count)
        w(x).
    objective, rows : MX
        f(x, v), g(x, v).
    slope : MX, optional
        w'(x), where more is known of it than CasADi finds out.
    """
    x, p, v = symbols
    true = stage.values(variables, p)
    f, g = ca.Function("outer", [x, p, v], [objective, rows]).call([x, p, true], True, False)

    sigma, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", rows.numel())
    pull = ca.MX.sym("pull", variables.numel())
    lagrangian = sigma * objective + ca.dot(multipliers, rows)
    flat = ca.vec(v)
    weights = ca.gradient(lagrangian, flat)
    seen = lagrangian + ca.dot(pull, ca.vec(variables))
    # All that is left to CasADi are these small graphs.
    parts = ca.Function(
        "parts",
        [x, p, v, sigma, multipliers, pull],
        [
            ca.gradient(objective, x),
            ca.jacobian(objective, flat),
            ca.jacobian(rows, x),
            ca.jacobian(rows, flat),
            ca.hessian(seen, x)[0],
            ca.jacobian(ca.gradient(lagrangian, x), flat),
            ca.hessian(lagrangian, flat)[0],
            weights,
        ],
    )
    inner = ca.jacobian(ca.vec(variables), x) if slope is None else slope
    jacobian = stage.jacobian(variables, p)
    along = ca.mtimes(jacobian, inner)

    def at(pulled: ca.MX) -> list[ca.MX]:
        return parts.call([x, p, true, sigma, multipliers, pulled], True, False)

    f_x, f_v, g_x, g_v, *_, weights = at(ca.MX.zeros(pull.shape))
    pulled = ca.mtimes(jacobian.T, weights)
    *_, l_xx, l_xv, l_vv, _ = at(pulled)
    cross = ca.mtimes(l_xv, along)
    bent = stage.hessian(variables, p, ca.reshape(weights, *v.shape))
    hessian = l_xx + cross + cross.T
    hessian += ca.mtimes([along.T, l_vv, along]) + ca.mtimes([inner.T, bent, inner])
    # Two products with a vector, not one of two matrices.
    gradient = f_x + ca.mtimes(ca.mtimes(f_v, jacobian), inner).T
    return (
        f,
        g,
        {
            # CasADi reads a sparse gradient as if it were dense.
            "grad_f": ca.Function("nlp_grad_f", [x, p], [f, ca.densify(gradient)]),
            "jac_g": ca.Function("nlp_jac_g", [x, p], [g, g_x + ca.mtimes(g_v, along)]),
            "hess_lag": ca.Function("nlp_hess_l", [x, p, sigma, multipliers], [ca.triu(hessian)]),
        },
    )
