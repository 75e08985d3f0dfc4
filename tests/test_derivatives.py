"""Every objective, limit and drivetrain: derivatives against central differences."""

import casadi as ca
import numpy as np
import pytest
from small_arms import load

from stiffopt import load_robot
from stiffopt.drivetrain.compact import CompactChain
from stiffopt.exact.chain import exact_windup
from stiffopt.problem.formulation import formulate
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve

STEP = 1e-4
FORCE = "[tool]\nprocess_force = [5.0, 2.0, -20.0]"
MAP = "q1,v1,q2,v2,q3,v3\n-3,2,-3,5,-3,5\n0,3,0,5,0,4\n3,4,3,6,3,5\n"

# Pieces of a problem file that bring an objective or a limit into the stage function.
REGISTRY = {
    "dynamic_deflection": {"minimise": 'objective = "dynamic_deflection"'},
    "dynamic_deflection rms": {"minimise": 'objective = "dynamic_deflection"\nmeasure = "rms"'},
    "tool_deviation": {"minimise": 'objective = "tool_deviation"'},
    "total_deflection": {
        "minimise": 'objective = "total_deflection"\naccept_bound = true',
        "extra": FORCE,
    },
    "process_deflection": {"minimise": 'objective = "process_deflection"', "extra": FORCE},
    "joint_stiffness": {"minimise": 'objective = "joint_stiffness"\njoints = [2, 3]'},
    "mean_compliance": {"minimise": 'objective = "mean_compliance"'},
    "torque_squared": {"minimise": 'objective = "torque_squared"', "extra": FORCE},
    "acceleration_squared": {"minimise": 'objective = "acceleration_squared"'},
    "reducer_load": {"minimise": 'objective = "reducer_load"'},
    "drive_work": {"minimise": 'objective = "drive_work"'},
    "torque limit": {"limits": "torque = [20.0, 30.0, 40.0]"},
    "speed map": {"limits": 'velocity_by_position = "map.csv"'},
    "tool speed limit": {"limits": "tool_speed = 1.5"},
    "dynamic deflection limit": {"limits": "dynamic_deflection = 1e-3"},
    "total deflection limit": {"limits": "total_deflection = 9e-3"},
    "stiffness floor as torque": {"limits": "joint_stiffness = { 2 = 1e4 }"},
    "stiffness floor as compliance": {"limits": "joint_stiffness = { 1 = 7e3 }"},
    "fixed path": {
        "start": "path",
        "minimise": 'objective = "dynamic_deflection"',
        "limits": "tool_speed = 1.5",
    },
}


def stage_of(case, folder):
    """The stage function of a case as one vector of a vector, and where to start."""
    pieces = dict(REGISTRY[case])
    (folder / "map.csv").write_text(MAP)
    if pieces.pop("start", None):
        from dataclasses import replace

        path = np.array([[0, -0.6, 0.4], [0.3, -0.3, 0.5], [0.6, 0.1, 0.3], [0.8, 0.5, 0.2]])
        problem = replace(load(folder, "spatial", **pieces), path=path)
    else:
        problem = load(folder, "spatial", **pieces)
    ocp = formulate(problem, resolve(problem), Scales())
    sizes = [len(ocp.states), len(ocp.controls), len(ocp.statics)]
    v, p = ca.SX.sym("v", sum(sizes)), ca.SX.sym("p")
    out = ca.vertcat(*ocp.stage(*ca.vertsplit(v, list(np.cumsum([0, *sizes]))), p))
    return v, p, out, sizes


def states(sizes, fixed_path):
    """Random states within the limits, away from the kinks of the speed map."""
    rng = np.random.default_rng(5)
    n = sizes[1]
    for _ in range(4):
        if fixed_path:
            x = np.array([rng.uniform(0.05, 0.95), rng.uniform(0.5, 1.5)])
        else:
            x = np.concatenate([rng.uniform(0.2, 1.0, n), rng.uniform(-1.5, 1.5, n)])
            # Motions of links: acceleration, jerk and snap too.
            x = np.concatenate([x, rng.uniform(-6, 6, sizes[0] - 2 * n)])
        yield np.concatenate([x, rng.uniform(-6, 6, n), rng.uniform(0.5, 1.5, sizes[2])])


@pytest.mark.parametrize("smoothing", [1.0, 0.25])
@pytest.mark.parametrize("case", REGISTRY)
def test_stage_derivatives(case, smoothing, tmp_path):
    v, p, out, sizes = stage_of(case, tmp_path)
    jacobian = ca.Function("jacobian", [v, p], [ca.jacobian(out, v)])
    value = ca.Function("value", [v, p], [out])
    # Random multipliers, so that one Hessian covers all rows.
    weights = np.random.default_rng(2).uniform(0.5, 1.5, out.shape[0])
    gradient = ca.gradient(ca.dot(ca.DM(weights), out), v)
    slope = ca.Function("slope", [v, p], [gradient])
    hessian = ca.Function("hessian", [v, p], [ca.jacobian(gradient, v)])
    rng = np.random.default_rng(9)
    for at in states(sizes, case == "fixed path"):
        direction = rng.normal(size=at.size)
        direction /= np.linalg.norm(direction)
        for function, derivative, rtol in ((value, jacobian, 1e-6), (slope, hessian, 1e-4)):
            matrix = derivative(at, smoothing).full()
            assert np.all(np.isfinite(matrix))
            given = matrix @ direction
            found = difference(lambda s, f=function: f(s, smoothing).full().ravel(), at, direction)
            # Differences of values that are rounded in the last digits.
            rounding = (
                20 * np.finfo(float).eps * np.abs(function(at, smoothing).full()).max() / STEP
            )
            allowed = rtol * np.abs(matrix).max(axis=1) + rounding
            assert np.all(np.abs(given - found) <= allowed)
        matrix = hessian(at, smoothing).full()
        assert matrix == pytest.approx(matrix.T, rel=1e-9, abs=1e-9 * np.abs(matrix).max())


def difference(function, at, direction, step=STEP):
    """Fourth-order central difference along a direction."""
    near = function(at + step * direction) - function(at - step * direction)
    far = function(at + 2 * step * direction) - function(at - 2 * step * direction)
    return (8 * near - far) / (12 * step)


@pytest.fixture(scope="module")
def er3a():
    return load_robot("er3a_c60")


@pytest.mark.parametrize("joint", [1, 3, 5])
def test_compact_chain(er3a, joint):
    """The optimiser's wind-up against the exact law, its symmetry and its two derivatives."""
    chain, limit = er3a.chains[joint - 1], float(er3a.torque_max[joint - 1])
    compact = CompactChain(chain, limit)
    t = ca.SX.sym("t")
    windup = ca.Function("windup", [t], [compact.windup(t, smoothing=0.25)])
    tangent = ca.Function("tangent", [t], [compact.tangent_compliance(t, smoothing=0.25)])
    slope = ca.Function("slope", [t], [ca.jacobian(compact.windup(t, smoothing=0.25), t)])
    bend = ca.Function("bend", [t], [ca.jacobian(compact.tangent_compliance(t, smoothing=0.25), t)])
    torque = np.linspace(0.02, 1.0, 60) * limit

    def at(function, x):
        return np.asarray(function(x.reshape(1, -1))).ravel()

    assert float(windup(0.0)) == 0.0
    assert at(windup, -torque) == pytest.approx(-at(windup, torque), rel=1e-12)
    assert np.all(np.diff(at(windup, np.linspace(-limit, limit, 400))) > 0)
    assert at(slope, torque) == pytest.approx(at(tangent, torque), rel=1e-3)
    step = 1e-5 * limit
    rise = (at(windup, torque + step) - at(windup, torque - step)) / (2 * step)
    assert at(slope, torque) == pytest.approx(rise, rel=1e-6)
    turn = (at(tangent, torque + step) - at(tangent, torque - step)) / (2 * step)
    scale = np.max(np.abs(at(tangent, torque))) / limit
    assert at(bend, torque) == pytest.approx(turn, rel=1e-3, abs=1e-3 * scale)


@pytest.mark.parametrize("joint", [2, 4])
def test_compact_chain_is_the_smooth_chain(er3a, joint):
    """The compact form is a fit of the smooth law; the smoothing leaves its mark only at jumps."""
    chain, limit = er3a.chains[joint - 1], float(er3a.torque_max[joint - 1])
    compact = CompactChain(chain, limit)
    assert compact.error < 1e-4
    torque = np.linspace(0.01, 1.0, 50) * limit
    t = ca.SX.sym("t")
    fitted = ca.Function("fitted", [t], [compact.windup(t, smoothing=1e-3)])
    found = np.asarray(fitted(torque.reshape(1, -1))).ravel()
    assert found == pytest.approx(exact_windup(chain, torque), rel=2e-4)


@pytest.mark.parametrize("name", ["er3a_c60", "er3a_c60_contact", "ur10"])
def test_compact_chain_stays_near_the_exact_law(name):
    """From tiny torques to a tenth beyond the largest: the fits of contacts miss up to 0.5 %."""
    robot = load_robot(name)
    for chain, limit in zip(robot.chains, robot.torque_max, strict=True):
        torque = np.geomspace(1e-4, 1.1, 120) * limit
        found = CompactChain(chain, float(limit)).windup(torque, smoothing=1e-3)
        error = np.abs(found / exact_windup(chain, torque) - 1.0)
        assert np.max(error) < 5.5e-3
        assert np.max(error[torque > 0.05 * limit]) < 2.5e-3
