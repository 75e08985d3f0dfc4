"""Functions of points, for any number of points."""

import casadi as ca
import numpy as np
import pytest

from stiffopt import native
from stiffopt.interpreter.batched import POINTS
from stiffopt.transcription.point_function import PointFunction


@pytest.mark.parametrize("count", [1, POINTS, 3 * POINTS + 1])
def test_compiled_values_equal_those_of_casadi(monkeypatch, count):
    x, u, z, p = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("z", 0), ca.SX.sym("p", 2)
    rows = ca.vertcat(ca.sin(3.7 * x[0]) * u / p[0], ca.fmax(x[1], p[1]) ** 2 - 0.3)
    function = ca.Function("rows", [x, u, z, p], [rows])
    points, parameters = np.random.default_rng(5).normal(size=(3, count)), np.array([1.3, 0.1])
    quick = PointFunction(function)
    monkeypatch.setattr(native, "library", lambda: None)
    plain = PointFunction(function)(points, parameters)
    each = [function(point[:2], point[2], [], parameters).full() for point in points.T]
    np.testing.assert_array_equal(plain, np.hstack(each))
    np.testing.assert_allclose(quick(points, parameters), plain, rtol=1e-15, atol=0)


def test_extended_function_gives_rates():
    q, p, none = ca.SX.sym("q"), ca.SX.sym("p"), ca.SX(0, 1)
    speed = ca.SX.sym("speed")
    found = PointFunction(
        ca.Function("rows", [q, none, none, p], [ca.sin(0.7 * q) * p]),
        lambda x, y: (ca.vertcat(x, speed), ca.vertcat(y, ca.jtimes(y, x, speed))),
    )
    points = np.array([[0.1, 1.1, -2.0], [3.0, 0.0, 0.4]])
    expected = [2.5 * np.sin(0.7 * points[0]), 2.5 * 0.7 * np.cos(0.7 * points[0]) * points[1]]
    np.testing.assert_allclose(found(points, np.array([2.5])), expected, rtol=1e-14, atol=1e-15)
