"""The front against dense grids, its properties, its knee, and fronts that have no room."""

from dataclasses import replace

import numpy as np
import pytest
from preload_studies import Ring, case, study, with_elements

from stiffopt.errors import NoSolutionFound
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.nlp import PreloadNlp
from stiffopt.preload.optimise import objective_levels
from stiffopt.preload.pareto import pareto_front

LOAD = case(j2=60.0, j3=20.0)


def one_flange():
    return study(LOAD, joints=(2,), free=("flexspline_flange",))


def rings(problem):
    """The joint of the study by rings of their own law: bounds of the preloads and stiffness."""
    model = PreloadModel(problem)
    own = [(Ring(e.stage.element), e) for e in model.elements]
    torque = LOAD.torque[1]
    rest = float(model.rest_compliance(2, np.array([torque]))[0])

    def least(element, preloads):
        return preloads / 1.6 - element.loss

    def stiffness(*preloads):
        total = rest
        for (ring, element), forces in zip(own, preloads, strict=True):
            total = total + ring.compliance(torque, least(element, forces))
        return 1.0 / total

    lower = [
        max(1.6 * (1.2 * torque / ring.slip(1.0) + e.loss), 0.3 * e.capacity) for ring, e in own
    ]
    return stiffness, lower, [e.capacity for e in model.elements], [e.count for e in model.elements]


def test_one_flange_agrees_with_a_dense_grid():
    problem = one_flange()
    front = pareto_front(problem, (LOAD,), points=9)
    stiffness, (lower,), (upper,), (count,) = rings(problem)
    grid = np.linspace(lower, upper, 20001)
    curve = stiffness(grid)
    for point in front.points:
        # One preload: the least for a stiffness is where the curve passes it.
        least = np.interp(point.stiffness[0], curve, grid) * count
        assert point.total_preload == pytest.approx(least, rel=1e-6)
        assert point.preloads == {"flexspline_flange": pytest.approx(point.total_preload / count)}
    assert front.points[0].total_preload == pytest.approx(count * lower, rel=1e-7)
    assert front.points[-1].total_preload == pytest.approx(count * upper, rel=1e-7)
    assert "slip safety, flexspline_flange, peak" in front.points[0].active
    assert "bolt utilisation, flexspline_flange" in front.points[-1].active


def test_two_flanges_no_design_of_a_grid_is_better():
    problem = study(LOAD, joints=(2,))
    front = pareto_front(problem, (LOAD,), points=7)
    stiffness, lower, upper, counts = rings(problem)
    axes = [np.linspace(a, b, 401) for a, b in zip(lower, upper, strict=True)]
    first, second = np.meshgrid(*axes)
    reached, total = stiffness(first, second), counts[0] * first + counts[1] * second
    step = sum(n * (b - a) / 400 for a, b, n in zip(lower, upper, counts, strict=True))
    for point in front.points:
        enough = total[reached >= point.stiffness[0] * (1.0 - 1e-9)]
        assert enough.min() >= point.total_preload * (1.0 - 1e-6)
        # And the grid comes as near as its step lets it.
        assert enough.min() <= point.total_preload + step


@pytest.fixture(scope="module")
def both():
    return pareto_front(study(LOAD, joints=(2, 3)), (LOAD,), points=6)


def test_every_point_is_proved_and_none_beats_another(both):
    assert all(point.kkt_residual < 1e-8 for point in both.points)
    total = [point.total_preload for point in both.points]
    level = [point.level for point in both.points]
    assert np.all(np.diff(total) > 0.0)
    assert np.all(np.diff(level) > 0.0)
    # Each newton of preload gains less than the one before.
    assert np.all(np.diff(np.diff(level) / np.diff(total)) < 0.0)


def test_level_one_is_every_preload_at_its_limit(both):
    last = both.points[-1]
    assert last.level == pytest.approx(1.0, abs=1e-9)
    weights = [both.weights[j] for j in (2, 3)]
    assert last.stiffness == pytest.approx(weights, rel=1e-9)


def test_the_knee_is_farthest_from_the_chord(both):
    x = np.array([p.total_preload for p in both.points])
    y = np.array([p.level for p in both.points])
    x, y = (x - x[0]) / (x[-1] - x[0]), (y - y[0]) / (y[-1] - y[0])
    # Distance to the line through (0, 0) and (1, 1) by the cross product.
    distance = np.abs(np.cross([1.0, 1.0, 0.0], np.c_[x, y, 0.0 * x])[:, 2]) / np.sqrt(2.0)
    assert both.knee == int(np.argmax(distance))
    assert 0 < both.knee < len(both.points) - 1
    assert f"{both.points[both.knee].total_preload / 1e3:.1f} kN" in both.knee_reason


def test_a_nearly_flat_front_is_said_to_be_flat(both):
    gain = both.points[-1].level / both.points[0].level - 1.0
    assert gain < 0.05
    assert f"rises by {100 * gain:.3g} %" in both.note
    more = both.points[-1].total_preload / both.points[0].total_preload - 1.0
    assert f", {100 * more:.0f} % more in all," in both.note
    assert "flat" in both.note


def test_where_the_flanges_yield_most_the_front_is_not_called_flat():
    robot = with_elements(2, reducer={f"K{i}": 1e8 for i in (1, 2, 3)})
    front = pareto_front(study(LOAD, joints=(2,), robot=robot), (LOAD,), points=3)
    gain = front.points[-1].level / front.points[0].level - 1.0
    assert gain > 0.05
    assert f"rises by {100 * gain:.3g} %" in front.note
    assert "flat" not in front.note


def test_own_weights_leave_the_better_joint_at_its_least():
    # Joint 3 is asked for far less than it has, so only joint 2 is tightened along the front.
    problem = study(LOAD, joints=(2, 3), joint_weights={2: 5e4, 3: 1e4})
    front = pareto_front(problem, (LOAD,), points=4)
    first, last = front.points[0], front.points[-1]
    for key, preload in last.preloads.items():
        if key.startswith("joint_3"):
            assert preload == pytest.approx(first.preloads[key], rel=1e-6)
        else:
            assert preload > 1.05 * first.preloads[key]


def test_without_room_the_front_is_a_single_point():
    problem = one_flange()
    model = PreloadModel(problem)
    slip = float(model.slip_torque(np.array([model.elements[0].capacity]), 0))
    full = replace(LOAD, torque=np.array([0.0, slip / 1.2 * (1.0 - 1e-9), 0.0, 0.0, 0.0, 0.0]))
    front = pareto_front(replace(problem, load_cases=(full,)), (full,), points=5)
    assert len(front.points) == 1
    assert front.knee == 0
    assert "single point" in front.note


def test_the_required_stiffness_does_not_cut_the_front():
    needs = {"joint_stiffness": {2: 5.6e4}}
    problem = study(LOAD, joints=(2,), free=("flexspline_flange",), needs=needs)
    front = pareto_front(problem, (LOAD,), points=3)
    free = pareto_front(one_flange(), (LOAD,), points=3)
    assert front.points[0].total_preload == pytest.approx(free.points[0].total_preload, rel=1e-9)


def test_slip_at_every_preload_ends_with_the_reason():
    heavy = case(j2=600.0)
    with pytest.raises(NoSolutionFound, match=r"Slip safety, flexspline_flange, peak.*To change"):
        pareto_front(study(heavy, joints=(2,), free=("flexspline_flange",)), (heavy,))


def test_levels_agree_with_those_of_the_optimiser(both):
    model = PreloadModel(study(LOAD, joints=(2, 3)))
    assert both.weights == objective_levels(model).stiffness
    lower, _ = PreloadNlp(model, "total_preload", objective_levels(model)).bounds()
    least = [both.points[0].preloads[e.key] for e in model.elements]
    assert np.all(np.array(least) >= lower * (1.0 - 1e-9))
