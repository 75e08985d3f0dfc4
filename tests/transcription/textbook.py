"""Textbook optimal-control problems with exact or agreed optima, as data for the tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from scipy.optimize import brentq

import stiffopt.symbolic  # noqa: F401 - CasADi conventions
from stiffopt.transcription import Guess, OptimalControlProblem, Rows

INF = np.inf


@dataclass(frozen=True)
class Case:
    """A problem, a guess, its reference and (intervals, tolerance) pairs for Radau of degree 4."""

    ocp: OptimalControlProblem
    guess: Guess
    reference: float
    meshes: tuple[tuple[int, float, float], ...]  # intervals, expected, tolerance
    maximise: bool = False
    ipopt: dict[str, object] = field(default_factory=dict)


def problem(
    name: str,
    states: str,
    controls: str,
    rates: Callable[[list[ca.SX], list[ca.SX]], list[object]],
    *,
    start: list[float | None],
    end: list[float | None],
    duration: tuple[float, float],
    integrand: Callable[[list[ca.SX], list[ca.SX]], list[object]] | None = None,
    objective: Callable[[ca.SX, ca.SX, ca.SX], object] | None = None,
    state_bounds: list[tuple[float, float]] | None = None,
    control_bounds: list[tuple[float, float]] | None = None,
    **further: object,
) -> OptimalControlProblem:
    """Problem from formulas; by default the first integral is minimised, else the duration."""
    labels, inputs = tuple(states.split()), tuple(controls.split())
    x, u = ca.SX.sym("x", len(labels)), ca.SX.sym("u", len(inputs))
    p, z = ca.SX.sym("p", 0), ca.SX.sym("z", 0)
    xs, us = ca.vertsplit(x), ca.vertsplit(u)
    integrands = ca.vertcat(ca.SX(0, 1), *(integrand(xs, us) if integrand else []))
    integrals = ca.SX.sym("I", integrands.numel())
    total = ca.SX.sym("T")
    x0, xf = ca.SX.sym("x0", len(labels)), ca.SX.sym("xf", len(labels))
    if objective is None:
        goal = integrals[0] if integrand else total
    else:
        goal = objective(integrals, total, xf)
    bounds = np.array(state_bounds or [(-INF, INF)] * len(labels), dtype=float)
    limits = np.array(control_bounds or [(-INF, INF)] * len(inputs), dtype=float)

    def ends(values: list[float | None]) -> tuple[np.ndarray, np.ndarray]:
        low = [-INF if v is None else v for v in values]
        high = [INF if v is None else v for v in values]
        return np.array(low, dtype=float), np.array(high, dtype=float)

    return OptimalControlProblem(
        name=name,
        states=labels,
        controls=inputs,
        dynamics=ca.Function("dynamics", [x, u, p], [ca.vertcat(*rates(xs, us))]),
        stage=ca.Function("stage", [x, u, z, p], [integrands, ca.SX(0, 1)]),
        objective=ca.Function("objective", [integrals, total, z, x0, xf, p], [goal]),
        duration=duration,
        state_lower=bounds[:, 0],
        state_upper=bounds[:, 1],
        control_lower=limits[:, 0],
        control_upper=limits[:, 1],
        initial_lower=ends(start)[0],
        initial_upper=ends(start)[1],
        final_lower=ends(end)[0],
        final_upper=ends(end)[1],
        **further,
    )


def guess(states: Callable[[np.ndarray], list[object]], controls: list[float], duration: float):
    """Guess from formulas of s = t/T."""
    return Guess(
        states=lambda s: np.stack([v + 0.0 * s for v in states(s)], axis=1),
        controls=lambda s: np.tile(controls, (len(s), 1)),
        duration=duration,
    )


def line(start: list[float | None], end: list[float | None], controls: int, duration: float):
    """Straight line between the ends; a free end repeats the given one."""
    first = [e if s is None else s for s, e in zip(start, end, strict=True)]
    last = [s if e is None else e for s, e in zip(start, end, strict=True)]
    a, b = np.array(first, dtype=float), np.array(last, dtype=float)
    return guess(lambda s: list(a[:, None] + (b - a)[:, None] * s), [0.0] * controls, duration)


FREE = (1e-3, 1e5)
_DOUBLE = {"states": "x v", "controls": "u", "rates": lambda x, u: [x[1], u[0]]}


def block_move(**further: object) -> Case:
    ocp = problem(
        "block move",
        **_DOUBLE,
        start=[0, 0],
        end=[1, 0],
        duration=(1, 1),
        integrand=lambda x, u: [u[0] ** 2],
        **further,
    )
    return Case(ocp, line([0, 0], [1, 0], 1, 1.0), 12.0, ((20, 12.0, 1e-8),))


def minimum_time(**further: object) -> Case:
    ocp = problem(
        "double integrator",
        **_DOUBLE,
        start=[0, 0],
        end=[1, 0],
        duration=FREE,
        control_bounds=[(-1, 1)],
        **further,
    )
    meshes = ((20, 2.0, 1e-7), (21, 2.00016, 1e-5))
    return Case(ocp, line([0, 0], [1, 0], 1, 3.0), 2.0, meshes)


def bryson_denham() -> Case:
    ocp = problem(
        "Bryson-Denham",
        **_DOUBLE,
        start=[0, 1],
        end=[0, -1],
        duration=(1, 1),
        integrand=lambda x, u: [0.5 * u[0] ** 2],
        state_bounds=[(-INF, 1 / 9), (-INF, INF)],
    )
    return Case(ocp, line([0, 1], [0, -1], 1, 1.0), 4.0, ((20, 4.0, 1e-4), (80, 4.0, 2e-6)))


def cycloid_time(across: float, drop: float, gravity: float) -> float:
    """Exact brachistochrone time."""
    angle = brentq(
        lambda t: (t - np.sin(t)) / (1 - np.cos(t)) - across / drop,
        1e-3,
        2 * np.pi - 1e-3,
        xtol=1e-14,
    )
    return float(angle * np.sqrt(drop / (1 - np.cos(angle)) / gravity))


def brachistochrone_down() -> Case:
    ocp = problem(
        "brachistochrone (y down)",
        "x y v",
        "u",
        lambda x, u: [x[2] * np.sin(u[0]), x[2] * np.cos(u[0]), 9.81 * np.cos(u[0])],
        start=[0, 0, 0],
        end=[2, 2, None],
        duration=FREE,
        control_bounds=[(0, np.pi)],
    )
    exact = cycloid_time(2.0, 2.0, 9.81)
    return Case(
        ocp, guess(lambda s: [2 * s, 2 * s, 6 * s], [0.7], 1.0), exact, ((20, exact, 1e-8),)
    )


def brachistochrone_up() -> Case:
    g = 9.80665
    ocp = problem(
        "brachistochrone (y up)",
        "x y v",
        "u",
        lambda x, u: [x[2] * np.sin(u[0]), -x[2] * np.cos(u[0]), g * np.cos(u[0])],
        start=[0, 10, 0],
        end=[10, 5, None],
        duration=FREE,
        control_bounds=[(0.01, np.pi)],
    )
    exact = cycloid_time(10.0, 5.0, g)
    start = guess(lambda s: [10 * s, 10 - 5 * s, 9.9 * s], [1.0], 2.0)
    return Case(ocp, start, exact, ((20, exact, 5e-7),))


def chain_energy(length: float, a: float, b: float) -> float:
    """Exact energy of the hanging chain over a unit span."""
    target = np.sqrt(length**2 - (b - a) ** 2)
    c = brentq(lambda c: 2 * c * np.sinh(1 / (2 * c)) - target, 0.05, 10.0, xtol=1e-15)
    z0 = np.arctanh((b - a) / length) * c - 0.5
    z1 = z0 + 1.0
    shift = a - c * np.cosh(z0 / c)
    sines = (np.sinh(2 * z1 / c) - np.sinh(2 * z0 / c)) / 2
    return float(shift * length + c**2 / 2 * ((z1 - z0) / c + sines))


def hanging_chain() -> Case:
    arc = ca.SX.sym("I", 2)
    ocp = problem(
        "hanging chain",
        "x",
        "u",
        lambda x, u: [u[0]],
        start=[1],
        end=[3],
        duration=(1, 1),
        state_bounds=[(0, INF)],
        control_bounds=[(-20, 20)],
        integrand=lambda x, u: [x[0] * np.sqrt(1 + u[0] ** 2), np.sqrt(1 + u[0] ** 2)],
        integral_function=ca.Function(
            "length", [arc, ca.SX.sym("T"), ca.SX.sym("z", 0), ca.SX.sym("p", 0)], [arc[1]]
        ),
        integral_rows=(Rows.make("chain length", [""], 4.0, 4.0),),
    )
    exact = chain_energy(4.0, 1.0, 3.0)
    start = guess(lambda s: [4 * s**2 - 2 * s + 1], [1.0], 1.0)
    return Case(ocp, start, exact, ((80, exact, 1e-8),))


def _van_der_pol(x: list[ca.SX], u: list[ca.SX]) -> list[object]:
    return [(1 - x[1] ** 2) * x[0] - x[1] + u[0], x[0]]


def van_der_pol(horizon: float) -> Case:
    short = horizon == 5
    ocp = problem(
        "Van der Pol",
        "x1 x2",
        "u",
        _van_der_pol,
        start=[0, 1],
        end=[None, None],
        duration=(horizon, horizon),
        control_bounds=[(-0.3, 1) if short else (-1, 1)],
        integrand=lambda x, u: [x[0] ** 2 + x[1] ** 2 + u[0] ** 2],
        state_bounds=None if short else [(-0.25, INF), (-INF, INF)],
    )
    start = line([0, 1], [None, None], 1, horizon)
    if short:
        return Case(ocp, start, 2.867261, ((20, 2.867261, 5e-6), (80, 2.867261, 5e-6)))
    return Case(ocp, start, 3.61518, ((20, 3.61518, 5e-4), (80, 3.61518, 2e-5)))


def rayleigh() -> Case:
    ocp = problem(
        "Rayleigh",
        "x1 x2",
        "u",
        lambda x, u: [x[1], -x[0] + x[1] * (1.4 - 0.14 * x[1] ** 2) + 4 * u[0]],
        start=[-5, -5],
        end=[None, None],
        duration=(2.5, 2.5),
        integrand=lambda x, u: [u[0] ** 2 + x[0] ** 2],
    )
    meshes = ((20, 29.376080, 2e-4), (80, 29.376080, 1e-6))
    return Case(ocp, line([-5, -5], [None, None], 1, 2.5), 29.376080, meshes)


def hypersensitive() -> Case:
    ocp = problem(
        "hypersensitive",
        "x",
        "u",
        lambda x, u: [-(x[0] ** 3) + u[0]],
        start=[1.5],
        end=[1.0],
        duration=(50, 50),
        integrand=lambda x, u: [(x[0] ** 2 + u[0] ** 2) / 2],
    )
    return Case(ocp, line([1.5], [1.0], 1, 50.0), 1.330807, ((320, 1.330807, 2e-6),))


def goddard() -> Case:
    def rates(x: list[ca.SX], u: list[ca.SX]) -> list[object]:
        h, v, m = x
        drag = 310 * v**2 * np.exp(-500 * (h - 1))
        return [v, (u[0] - drag) / m - 1 / h**2, -u[0] / 0.5]

    ocp = problem(
        "Goddard rocket",
        "h v m",
        "u",
        rates,
        start=[1, 0, 1],
        end=[None, None, 0.6],
        duration=FREE,
        objective=lambda integrals, total, xf: -xf[0],
        state_bounds=[(1, INF), (0, INF), (0.6, 1)],
        control_bounds=[(0, 3.5)],
    )
    start = guess(lambda s: [1.0, 0.4 * s * (1 - s), 1 - 0.4 * s], [1.75], 0.2)
    return Case(ocp, start, 1.01284, ((20, 1.01284, 3e-5), (80, 1.01284, 1e-5)), maximise=True)


def robot_arm() -> Case:
    def rates(x: list[ca.SX], u: list[ca.SX]) -> list[object]:
        rho, phi = x[0], x[4]
        inertia = ((5 - rho) ** 3 + rho**3) / 3
        return [x[1], u[0] / 5, x[3], u[1] / (inertia * np.sin(phi) ** 2), x[5], u[2] / inertia]

    start = [4.5, 0, 0, 0, np.pi / 4, 0]
    end = [4.5, 0, 2 * np.pi / 3, 0, np.pi / 4, 0]
    free = (-INF, INF)
    ocp = problem(
        "robot arm",
        "rho drho theta dtheta phi dphi",
        "u1 u2 u3",
        rates,
        start=start,
        end=end,
        duration=FREE,
        control_bounds=[(-1, 1)] * 3,
        state_bounds=[(0, 5), free, (-np.pi, np.pi), free, (0, np.pi), free],
    )
    return Case(ocp, line(start, end, 3, 9.0), 9.1409, ((20, 9.1409, 3e-4), (80, 9.1409, 3e-4)))


def steering_time(thrust: float, speed: float, height: float) -> float:
    """Exact time of the linear tangent law."""

    def time(q: float) -> float:
        return speed * q / (thrust * np.arcsinh(q))

    def excess(q: float) -> float:
        shape = q * np.sqrt(1 + q * q) - np.arcsinh(q)
        return thrust * time(q) ** 2 / (4 * q * q) * shape - height

    return float(time(brentq(excess, 0.1, 10.0, xtol=1e-15)))


def particle_steering() -> Case:
    ocp = problem(
        "particle steering",
        "x y vx vy",
        "u",
        lambda x, u: [x[2], x[3], 100 * np.cos(u[0]), 100 * np.sin(u[0])],
        start=[0, 0, 0, 0],
        end=[None, 5, 45, 0],
        duration=FREE,
        control_bounds=[(-np.pi / 2, np.pi / 2)],
    )
    start = guess(lambda s: [12 * s**2, 5 * s, 45 * s, 30 * s * (1 - s)], [0.0], 0.6)
    exact = steering_time(100.0, 45.0, 5.0)
    return Case(ocp, start, exact, ((20, exact, 1e-9),))


def cart_pole() -> Case:
    def rates(x: list[ca.SX], u: list[ca.SX]) -> list[object]:
        m1, m2, length, g = 1.0, 0.3, 0.5, 9.81
        sine, cosine = np.sin(x[1]), np.cos(x[1])
        mass = m1 + m2 * (1 - cosine**2)
        swing = length * m2 * sine * x[3] ** 2
        pole = swing * cosine + u[0] * cosine + (m1 + m2) * g * sine
        return [x[2], x[3], (swing + u[0] + m2 * g * cosine * sine) / mass, -pole / (length * mass)]

    free = (-INF, INF)
    ocp = problem(
        "cart-pole",
        "q1 q2 v1 v2",
        "u",
        rates,
        start=[0, 0, 0, 0],
        end=[1, np.pi, 0, 0],
        duration=(2, 2),
        integrand=lambda x, u: [u[0] ** 2],
        control_bounds=[(-20, 20)],
        state_bounds=[(-2, 2), free, free, free],
    )
    meshes = ((20, 58.807667, 1e-3), (80, 58.807667, 1e-6))
    return Case(ocp, line([0, 0, 0, 0], [1, np.pi, 0, 0], 1, 2.0), 58.807667, meshes)


def two_link_arm() -> Case:
    def rates(x: list[ca.SX], u: list[ca.SX]) -> list[object]:
        w1, w2, a, _ = x
        sine, cosine = np.sin(a), np.cos(a)
        d = 31 / 36 + 9 / 4 * sine**2
        first = sine * (9 / 4 * cosine * w1**2 + 2 * w2**2)
        first += 4 / 3 * (u[0] - u[1]) - 3 / 2 * cosine * u[1]
        second = sine * (9 / 4 * cosine * w2**2 + 7 / 2 * w1**2)
        second += -7 / 3 * u[1] + 3 / 2 * cosine * (u[0] - u[1])
        return [first / d, -second / d, w2 - w1, w1]

    start, end = [0, 0, 0.5, 0], [0, 0, 0.5, 0.522]
    ocp = problem(
        "two-link arm",
        "w1 w2 a b",
        "u1 u2",
        rates,
        start=start,
        end=end,
        duration=FREE,
        control_bounds=[(-1, 1)] * 2,
    )
    meshes = ((20, 2.98240, 1e-5), (80, 2.98228, 1e-4))
    return Case(ocp, line(start, end, 2, 3.0), 2.98228, meshes)


CASES: dict[str, Case] = {
    "block_move": block_move(),
    "minimum_time": minimum_time(),
    "bryson_denham": bryson_denham(),
    "brachistochrone_down": brachistochrone_down(),
    "brachistochrone_up": brachistochrone_up(),
    "hanging_chain": hanging_chain(),
    "van_der_pol_5": van_der_pol(5),
    "van_der_pol_10": van_der_pol(10),
    "rayleigh": rayleigh(),
    "hypersensitive": hypersensitive(),
    "goddard": goddard(),
    "robot_arm": robot_arm(),
    "particle_steering": particle_steering(),
    "cart_pole": cart_pole(),
    "two_link_arm": two_link_arm(),
}


def second_order(case: Case) -> Case:
    """The same double-integrator problem with its states declared as second order."""
    return replace(case, ocp=replace(case.ocp, chains=((0, 1, 0),)))
