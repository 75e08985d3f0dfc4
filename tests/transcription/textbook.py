"""Textbook optimal-control problems of mechanisms with exact or agreed optima, as test data.

Controls are accelerations; forces are rows, by the equations of motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

import stiffopt.symbolic  # noqa: F401 - CasADi conventions
from stiffopt.transcription import Guess, OptimalControlProblem, Rows

INF = np.inf
# Forces of a mechanism by positions, velocities and accelerations.
Forces = Callable[[list[ca.SX], list[ca.SX], list[ca.SX]], list[object]]


@dataclass(frozen=True)
class Case:
    """A problem, a guess, and its reference."""

    ocp: OptimalControlProblem
    guess: Guess
    reference: float


def problem(
    name: str,
    axes: str,
    *,
    start: list[float],
    end: list[float],
    duration: tuple[float, float],
    forces: Forces | None = None,
    force_bounds: list[tuple[float, float]] = (),
    squares: bool = False,
    position_bounds: list[tuple[float, float]] | None = None,
    control_bounds: tuple[float, float] = (-INF, INF),
    **further: object,
) -> OptimalControlProblem:
    """Problem of axes from rest to rest unless `start` and `end` hold velocities too.

    Minimises the duration, or with `squares` the integral of the squared first force.
    """
    labels = tuple(axes.split())
    n = len(labels)
    x, u = ca.SX.sym("x", 2 * n), ca.SX.sym("u", n)
    p, z = ca.SX.sym("p", 0), ca.SX.sym("z", 0)
    parts = [ca.vertsplit(each) for each in (x[:n], x[n:], u)]
    values = [u[0]] if forces is None else forces(*parts)
    rows = () if forces is None else values
    integral, total = ca.SX.sym("I", int(squares)), ca.SX.sym("T")
    ends = [integral, total, z, ca.SX.sym("x0", 2 * n), ca.SX.sym("xf", 2 * n), p]
    low, high = (
        np.array([each[k] for each in position_bounds or [(-INF, INF)] * n] + [sign * INF] * n)
        for k, sign in ((0, -1.0), (1, 1.0))
    )
    first, last = (np.array([*each, *[0.0] * (2 * n - len(each))], float) for each in (start, end))
    bounds = np.array(force_bounds, dtype=float).reshape(-1, 2)
    integrands = [values[0] ** 2] if squares else []
    return OptimalControlProblem(
        name=name,
        states=(*labels, *(f"d{label}" for label in labels)),
        controls=tuple(f"dd{label}" for label in labels),
        chains=tuple((k, n + k, k) for k in range(n)),
        stage=ca.Function(
            "stage",
            [x, u, z, p],
            [ca.vertcat(ca.SX(0, 1), *integrands), ca.vertcat(ca.SX(0, 1), *rows)],
        ),
        path_rows=()
        if forces is None
        else (Rows.make("force", [str(k) for k in range(len(bounds))], *bounds.T),),
        objective=ca.Function("objective", ends, [integral[0] if squares else total]),
        duration=duration,
        state_lower=low,
        state_upper=high,
        control_lower=np.full(n, control_bounds[0]),
        control_upper=np.full(n, control_bounds[1]),
        initial_lower=first,
        initial_upper=first,
        final_lower=last,
        final_upper=last,
        **({"state_scale": np.ones(2 * n), "control_scale": np.ones(n)} | further),
    )


def guess(states: Callable[[np.ndarray], list[object]], controls: list[float], duration: float):
    """Guess from formulas of s = t/T."""
    return Guess(
        states=lambda s: np.stack([v + 0.0 * s for v in states(s)], axis=1),
        controls=lambda s: np.tile(controls, (len(s), 1)),
        duration=duration,
    )


def line(ocp: OptimalControlProblem, duration: float):
    """Straight line between the ends."""
    a, b = ocp.initial_lower, ocp.final_lower
    return guess(
        lambda s: list(a[:, None] + (b - a)[:, None] * s), [0.0] * len(ocp.controls), duration
    )


FREE = (1e-3, 1e5)


def block_move(**further: object) -> Case:
    ocp = problem(
        "block move", "x", start=[0], end=[1], duration=(1, 1), squares=True, **further
    )  # fmt: skip
    return Case(ocp, line(ocp, 1.0), 12.0)


def minimum_time(**further: object) -> Case:
    ocp = problem(
        "double integrator", "x", start=[0], end=[1], duration=FREE, control_bounds=(-1, 1),
        **further,
    )  # fmt: skip
    return Case(ocp, line(ocp, 3.0), 2.0)


def bryson_denham() -> Case:
    """Twice the usual objective: the integral of the squared acceleration."""
    ocp = problem(
        "Bryson-Denham", "x", start=[0, 1], end=[0, -1], duration=(1, 1), squares=True,
        position_bounds=[(-INF, 1 / 9)],
    )  # fmt: skip
    return Case(ocp, line(ocp, 1.0), 8.0)


def robot_arm() -> Case:
    """Three axes of which two turn a rod of variable length, in least time."""

    def forces(q: list[ca.SX], v: list[ca.SX], a: list[ca.SX]) -> list[object]:
        inertia = ((5 - q[0]) ** 3 + q[0] ** 3) / 3
        return [5 * a[0], inertia * np.sin(q[2]) ** 2 * a[1], inertia * a[2]]

    ocp = problem(
        "robot arm", "rho theta phi", start=[4.5, 0, np.pi / 4],
        end=[4.5, 2 * np.pi / 3, np.pi / 4], duration=FREE, forces=forces,
        force_bounds=[(-1, 1)] * 3, position_bounds=[(0, 5), (-np.pi, np.pi), (0, np.pi)],
    )  # fmt: skip
    return Case(ocp, line(ocp, 9.0), 9.1409)


def cart_pole() -> Case:
    """Swing-up with least squared force on the cart; nothing drives the pole."""
    m1, m2, length, g = 1.0, 0.3, 0.5, 9.81

    def forces(q: list[ca.SX], v: list[ca.SX], a: list[ca.SX]) -> list[object]:
        sine, cosine = np.sin(q[1]), np.cos(q[1])
        cart = (m1 + m2) * a[0] + m2 * length * (cosine * a[1] - sine * v[1] ** 2)
        return [cart, cosine * a[0] + length * a[1] + g * sine]

    ocp = problem(
        "cart-pole", "q1 q2", start=[0, 0], end=[1, np.pi], duration=(2, 2), squares=True,
        forces=forces, force_bounds=[(-20, 20), (0, 0)], position_bounds=[(-2, 2), (-INF, INF)],
    )  # fmt: skip
    return Case(ocp, line(ocp, 2.0), 58.807667)


def two_link_arm() -> Case:
    """Two links of equal length in least time; axes are their absolute angles."""

    def forces(q: list[ca.SX], v: list[ca.SX], a: list[ca.SX]) -> list[object]:
        sine, cosine = np.sin(q[1] - q[0]), np.cos(q[1] - q[0])
        d = 31 / 36 + 9 / 4 * sine**2
        first = d * a[0] - sine * (9 / 4 * cosine * v[0] ** 2 + 2 * v[1] ** 2)
        second = -d * a[1] - sine * (9 / 4 * cosine * v[1] ** 2 + 7 / 2 * v[0] ** 2)
        whole = 9 / 4 * cosine**2 - 28 / 9
        between = (3 / 2 * cosine * second - 7 / 3 * first) / whole
        elbow = (4 / 3 * second - 3 / 2 * cosine * first) / whole
        return [between + elbow, elbow]

    ocp = problem(
        "two-link arm", "q1 q2", start=[0, 0.5], end=[0.522, 1.022], duration=FREE,
        forces=forces, force_bounds=[(-1, 1)] * 2,
    )  # fmt: skip
    return Case(ocp, line(ocp, 3.0), 2.98228)


CASES: dict[str, Case] = {
    "block_move": block_move(),
    "minimum_time": minimum_time(),
    "bryson_denham": bryson_denham(),
    "robot_arm": robot_arm(),
    "cart_pole": cart_pole(),
    "two_link_arm": two_link_arm(),
}
