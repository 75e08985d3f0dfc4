import itertools
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Annotation
from preload_report_studies import cannot, case, flange, run, several, stiff

from stiffopt.preload.model import PreloadModel
from stiffopt.report.common.robot import joint_units
from stiffopt.report.preload.curves_figure import curves_figure, preload_view
from stiffopt.report.preload.figures import front_figure, loosening_figure, shares_figure
from stiffopt.report.preload.overview import shares_by_joint


def view_of(study):
    element = study.problem.elements[0]
    curve = max(study.curves, key=lambda each: (each.key == element.key, abs(each.torque)))
    return element, preload_view(study.problem, study.solution, element, curve)


def curves_of(study):
    units = joint_units(study.problem.robot)
    return curves_figure(study.problem, study.solution, study.curves, units)


def test_view_has_the_stiffness_of_the_least_and_of_the_largest_preload():
    study = flange()
    element, view = view_of(study)
    model = PreloadModel(study.problem, study.solution.cases)
    least = study.solution.stiffness[0, 0]
    assert np.interp(view.least, view.preload, view.stiffness) == pytest.approx(least, rel=1e-4)
    largest = model.exact_stiffness(np.array([element.largest(view.largest)]))[0, 0]
    assert np.interp(view.largest, view.preload, view.stiffness) == pytest.approx(largest, rel=1e-4)
    assert np.all(np.diff(view.preload) >= 0)


def test_slip_line_is_where_the_least_preload_just_holds():
    element, view = view_of(flange())
    holds = element.stage.element.slip_torque(view.bounds["slip safety"]) * element.stage.reduction
    assert holds == pytest.approx(1.2 * flange().problem.robot.torque_max[1])
    assert view.least == pytest.approx(view.bounds["slip safety"], rel=1e-6)
    assert view.largest < view.bounds["bolt utilisation"]


def test_infeasible_study_shows_the_conflict():
    _, view = view_of(cannot())
    assert view.least < view.bounds["slip safety"]
    assert view.largest == pytest.approx(view.bounds["bolt utilisation"])


@pytest.mark.parametrize("study", [flange, stiff, cannot, several])
def test_limit_labels_do_not_overlap(study):
    figure = curves_of(study())
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert len(shown) == len(study().problem.elements)
    for axes in shown:
        labels = [each for each in axes.texts if isinstance(each, Annotation)]
        assert labels
        frame = axes.get_window_extent(renderer)
        boxes = [label.get_window_extent(renderer) for label in labels]
        assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 + 1 for box in boxes)
        assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))


def test_dots_lie_on_the_curve_at_both_ends_of_the_scatter():
    study = flange()
    axes = curves_of(study).axes[0]
    lines = {line.get_label(): line for line in axes.lines}
    dots, curve = lines["least and largest"], lines["stiffness of the joint"]
    _, view = view_of(study)
    assert dots.get_xdata() == pytest.approx([view.least / 1e3, view.largest / 1e3])
    on_curve = np.interp(dots.get_xdata(), curve.get_xdata(), curve.get_ydata())
    assert dots.get_ydata() == pytest.approx(on_curve)


def test_every_load_case_drawn_is_within_the_panel():
    loads = (case("peak", 0, 0.9, 0, 0, 0, 0), case("light", 0, 0.03, 0, 0, 0, 0))
    study = run(joints=(2,), free=("flexspline_flange",), load_cases=loads, front_points=0)
    axes = curves_of(study).axes[0]
    low, high = axes.get_ylim()
    curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
    assert len(curves) == len(study.curves) == 2
    assert all(low < line.get_ydata().max() < high for line in curves)


def test_front_marks_its_knee():
    study = flange()
    figure = front_figure(study.front, joint_units(study.problem.robot), (2,))
    knee = study.front.points[study.front.knee]
    marker = figure.axes[0].lines[1]
    assert marker.get_xdata()[0] == pytest.approx(knee.total_preload / 1e3)
    assert marker.get_ydata()[0] == pytest.approx(knee.stiffness[0])


def test_bars_of_the_windup_sum_to_all_of_it():
    study = several()
    shares = shares_by_joint(study.sensitivity, study.problem, study.solution)
    figure = shares_figure(shares, [e.name for e in study.problem.elements])
    for axes, own in zip(figure.axes, shares.values(), strict=True):
        widths = [bar.get_width() for bar in axes.patches]
        assert sum(widths) == pytest.approx(100.0)
        assert widths == sorted(widths, reverse=True)
        bold = {t.get_text() for t in axes.get_yticklabels() if t.get_fontweight() == "bold"}
        assert all(("pins" in name) or ("flange" in name) for name in bold)
        assert len(widths) == len(own)


def test_loosening_bars_end_where_rim_and_ring_slip():
    axes = loosening_figure({"ring": 0.7, "bush": 1.4}, {"ring": 0.5, "bush": 1.1}).axes[0]
    widths = [bar.get_width() for bar in axes.patches if bar.get_width() > 0]
    assert widths == pytest.approx([50.0, 20.0, 30.0, 100.0])


def test_binding_limit_is_drawn_within_the_frame():
    for study in (flange(), stiff(), cannot(), several()):
        figure = curves_of(study)
        for axes, element in zip(figure.axes, study.problem.elements, strict=False):
            curve = max(
                (each for each in study.curves if each.key == element.key),
                key=lambda each: abs(each.torque),
            )
            view = preload_view(study.problem, study.solution, element, curve)
            bold = {line.get_xdata()[0] for line in axes.lines if line.get_linewidth() == 1.8}
            assert bold == {view.bounds[name] / 1e3 for name in view.binding}
            left, right = axes.get_xlim()
            drawn = [line.get_xdata()[0] for line in axes.lines if len(line.get_xdata()) == 2]
            assert all(left <= force < right for force in drawn)
            assert min(view.bounds.values()) / 1e3 in drawn


def test_required_stiffness_is_a_limit_of_the_figure():
    study = stiff()
    _, view = view_of(study)
    assert "joint stiffness" in view.binding
    assert view.bounds["joint stiffness"] == pytest.approx(view.least, rel=1e-3)


def test_present_preload_is_drawn_only_where_it_is_stated():
    study = flange()
    element, view = view_of(study)
    assert view.present == (
        pytest.approx(float(element.least(element.stage.element.preload))),
        element.stage.element.preload,
    )
    ring = replace(element.stage.element, preload_is="assumed")
    begun = replace(element, stage=replace(element.stage, element=ring))
    curve = study.curves[0]
    assert preload_view(study.problem, study.solution, begun, curve).present is None
