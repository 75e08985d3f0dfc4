"""An optimum of the smooth law, shifted, is one of the exact law: values and slopes agree."""

import casadi as ca
import numpy as np
import pytest
from preload_studies import JACOBIAN, case, study

from stiffopt.exact.chain import exact_compliance
from stiffopt.preload.exact_shift import _linear_shift
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.nlp import PreloadNlp
from stiffopt.preload.optimise import objective_levels, optimise_preloads


def test_marginal_gains_are_equal_at_the_optimum():
    """Where stiffness alone holds two preloads, dC/dF over the bolts is equal for both."""
    loose = optimise_preloads(study(case(j2=20.0))).stiffness[0, 0]
    tight = optimise_preloads(study(case(j2=20.0), objective="joint_stiffness")).stiffness[0, 0]
    needed = {2: float(0.4 * loose + 0.6 * tight)}
    problem = study(case(j2=20.0), needs={"joint_stiffness": needed})
    solution = optimise_preloads(problem)
    assert {row.kind for row in solution.rows if row.active} == {"joint stiffness"}
    chain, alpha = problem.robot.chains[1], problem.tightening.alpha
    torque, worth = np.array([20.0]), []
    for index, element in enumerate(problem.elements):
        soft = []
        for factor in (0.999, 1.001):
            vector = solution.vector.copy()
            vector[index] *= factor
            least = {
                e.name: f / alpha - e.loss for e, f in zip(problem.elements, vector, strict=True)
            }
            soft.append(float(exact_compliance(chain, torque, preloads=least)[0]))
        slope = (soft[1] - soft[0]) / (0.002 * solution.vector[index])
        worth.append(slope / element.count)
    assert worth[0] < 0
    assert worth[0] == pytest.approx(worth[1], rel=2e-5)


@pytest.mark.parametrize("objective", ["joint_stiffness", "tool_deflection"])
def test_shifted_rows_have_the_value_and_the_slope_of_the_exact_law(objective):
    loads = (case("lift", JACOBIAN, reference=np.full(6, 3.0), j2=58.0, j3=9.0), case(j2=30.0))
    model = PreloadModel(study(*loads, joints=(2, 3), objective=objective))
    levels = objective_levels(model)
    nlp = PreloadNlp(model, objective, levels)
    at = model.design * 1.3
    parameters = nlp.parameters(at)
    rows = ca.Function("rows", [nlp.nlp.x, nlp.nlp.p], [nlp.nlp.g])
    labels = [str(nlp.nlp.rows.entry(i)) for i in range(nlp.nlp.g.numel())]
    wanted = [i for i, label in enumerate(labels) if label.startswith("level")]

    def smooth(preloads):
        x = np.concatenate([preloads / nlp.scale, np.zeros(nlp.nlp.x.numel() - model.size)])
        return np.asarray(rows(x, parameters)).ravel()[wanted] - 1.0

    def exact(preloads):
        if objective == "tool_deflection":
            return np.sum(model.exact_deflection(preloads)[:1] ** 2, axis=1) / levels.deflection**2
        stiffness = model.exact_stiffness(preloads)
        weights = np.array([levels.stiffness[joint] for joint in (2, 3)])
        return (weights[:, None] / stiffness).ravel()

    assert smooth(at) == pytest.approx(exact(at), rel=1e-12)
    for index in range(model.size):
        step = np.zeros(model.size)
        step[index] = 1e-3 * at[index]
        slopes = [law(at + step) - law(at - step) for law in (smooth, exact)]
        assert slopes[0] == pytest.approx(slopes[1], rel=1e-4, abs=1e-14)


def test_joints_without_deflection_keep_least_preload():
    loads = (case("hold", JACOBIAN, j2=40.0), case("peak", j6=3.0))
    problem = study(*loads, joints=(2, 6), objective="tool_deflection")
    solution = optimise_preloads(problem)
    least = optimise_preloads(study(*loads, joints=(2, 6)))
    for key, force in solution.preloads.items():
        element = next(e for e in problem.elements if e.key == key)
        wanted = element.capacity if element.joint == 2 else least.preloads[key]
        assert force == pytest.approx(wanted, rel=1e-4)
    assert solution.kkt_residual < 1e-6


@pytest.mark.parametrize(("excess", "expected"), [(0.2, 0.2), (3.0, 3.0), (-3.0, -0.5)])
def test_a_shift_makes_the_smooth_slope_flatter_by_at_most_half(excess, expected):
    """The exact law's steps of a spot that yields are no slope."""
    model = PreloadModel(study(case(j2=20.0)))
    preloads = model.design

    def laws(vector):
        smooth = np.array([2e-9 * vector.sum() + 1e-3])
        return smooth, smooth + excess * 2e-9 * (vector - preloads).sum()

    constant, slopes = _linear_shift(model, 2, preloads, laws)
    assert slopes[:, 0] == pytest.approx(np.full(model.size, expected * 2e-9), rel=1e-6)
    assert constant == pytest.approx(-preloads @ slopes)
