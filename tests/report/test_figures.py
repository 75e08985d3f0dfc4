import functools
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from synthetic_solution import assessment, problem, robot, solution

from stiffopt.report.common.robot import joint_units
from stiffopt.report.common.svg import decimate_curve, line_style, to_png, to_svg
from stiffopt.report.pages.stiffness import (
    StiffnessCurve,
    loss_figure,
    shares_figure,
    stiffness_curves,
    stiffness_headline,
    tangent_figure,
    where_contacts_matter,
)
from stiffopt.report.solve.figures import (
    compared_motions,
    deflection_figure,
    motion_figure,
    stiffness_figure,
    torque_figure,
)
from stiffopt.report.solve.space_figures import exaggeration, path_figure, windup_figure
from stiffopt.robot.stiffness_study import StiffnessRow


@functools.cache
def figures(joints):
    stated, motions = problem(joints), compared_motions(solution(joints))
    motion = motions[0].assessment
    drawn = {
        "deflection": deflection_figure(motions),
        "motion": motion_figure(stated, motion, motions[1]),
        "torque": torque_figure(stated, motion),
        "stiffness": stiffness_figure(stated, motion),
        "path": path_figure(stated, motions, "dynamic"),
        "windup": windup_figure(stated, motion, "dynamic"),
    }
    return {name: to_svg(figure, name, f"The {name}") for name, figure in drawn.items()}


def stiffness_rows(joints=(1, 2)):
    return [
        StiffnessRow(
            joint=joint,
            torque_ratio=ratio,
            torque=30.0 * ratio,
            tangent_stiffness=9e3 * ratio**0.1,
            secant_stiffness=9e3 * ratio**0.1,
            windup=1e-3 * ratio,
            reducer_only_tangent_stiffness=1e4,
            ratio_to_reducer_only=0.9 * ratio**0.1,
            flanks=flanks,
            first_loading_stiffness=9e3 * ratio**0.1,
            cyclic_stiffness=9.5e3 * ratio**0.05,
        )
        for joint in joints
        for flanks in ("parallel", "series")
        for ratio in (0.001, 0.01, 0.1, 1.0)
    ]


def ids_and_uses(svg):
    ids = re.findall(r' id="([^"]+)"', svg)
    uses = re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', svg)
    return ids, {a or b for a, b in uses}


@pytest.mark.parametrize("joints", [1, 2, 5])
def test_every_figure_is_valid_svg_for_any_number_of_joints(joints):
    all_ids = []
    for name, svg in figures(joints).items():
        assert ET.fromstring(svg).tag.endswith("svg"), name
        ids, uses = ids_and_uses(svg)
        assert uses <= set(ids), name
        assert len(svg) < 400_000, name
        all_ids += ids
    assert len(all_ids) == len(set(all_ids))


def test_axis_units_match_the_joint_type():
    drawn = figures(2)
    for text in ("position [deg or mm]", "velocity [deg/s or mm/s]", "jerk [rad/s³ or m/s³]"):
        assert text in drawn["motion"]
    assert "J2 [N]" in drawn["torque"]
    assert "tangent stiffness [N m/rad or N/m]" in drawn["stiffness"]
    assert "deflection [mm]" in drawn["deflection"]
    assert "wind-up [mrad or mm]" in drawn["windup"]


def test_a_small_deflection_is_in_micrometres():
    motions = compared_motions(solution(assessment=assessment(size=2e-6), baselines={}))
    assert "deflection [µm]" in to_svg(deflection_figure(motions), "deflection", "")


def test_infeasible_baseline_is_labelled():
    assert "quintic (exceeds limits)" in figures(2)["deflection"]


def test_stiffness_figure_with_a_rigid_joint():
    motion = assessment()
    motion.stiffness[:, 1] = np.inf
    svg = to_svg(stiffness_figure(problem(), motion), "stiffness", "")
    assert "J1: lowest" in svg
    assert "J2" not in svg


def test_svg_is_reproducible():
    again = deflection_figure(compared_motions(solution(2)))
    assert to_svg(again, "deflection", "The deflection") == figures(2)["deflection"]


def test_decimated_curve_keeps_ends_and_peaks():
    time = np.linspace(0, 1, 20001)
    values = np.sin(3 * time)
    values[7777], values[12345] = 5.0, -5.0
    t, v = decimate_curve(time, values, 400)
    assert len(t) <= 402
    assert v.max() == 5.0
    assert v.min() == -5.0
    assert (t[0], t[-1]) == (0.0, 1.0)
    assert np.all(np.diff(t) > 0)
    assert np.array_equal(np.interp(t, time, values), v)


@pytest.mark.parametrize(
    ("extent", "largest", "factor"), [(0.3, 1.2e-4, 200), (0.3, 2.4e-4, 100), (0.1, 0.1, 1)]
)
def test_exaggeration_is_a_round_factor(extent, largest, factor):
    assert exaggeration(extent, largest) == factor
    assert exaggeration(extent, 0.0) == 1.0


def test_line_styles_differ():
    styles = [str(line_style(index)) for index in range(28)]
    assert len(set(styles)) == 28


def test_stiffness_figures_are_drawn_from_rows():
    units, curves = joint_units(robot(3)), stiffness_curves(stiffness_rows())
    assert [curve.flanks for curve in curves[1]] == ["parallel", "series"]
    assert curves[2][0].at(0.01, curves[2][0].reducer_only) == pytest.approx(1e4)
    drawn = {
        "tangent": tangent_figure(curves, units, low_torque=False),
        "low": tangent_figure(curves, units, low_torque=True),
        "loss": loss_figure(curves, units),
        "shares": shares_figure(robot(3), units),
    }
    for name, figure in drawn.items():
        assert ET.fromstring(to_svg(figure, name, "a & b <c>")).tag.endswith("svg")
    assert to_png(drawn["loss"]).startswith(b"\x89PNG")


def curve(joint, first, last):
    """A joint whose contacts take these shares of its stiffness at 0.1 and 100 % of its torque."""
    ratio = np.array([0.001, 0.03, 1.0])
    relative = 1.0 - np.array([first, min(first, last), last])
    alone = np.full(3, 1e4)
    return [
        StiffnessCurve(
            joint, "parallel", ratio, relative * alone, alone, relative, ratio, alone, alone
        )
    ]


def test_torque_of_largest_contact_loss_per_joint():
    curves = {1: curve(1, 0.0049, 0.0090), 2: curve(2, 0.026, 0.011)}
    assert curves[1][0].ratio_of_largest_loss == 1.0
    assert curves[2][0].ratio_of_largest_loss == 0.001
    said = where_contacts_matter(curves, ["J1", "J2"])
    largest, least = said.split("; ")
    assert "J1 (0.49 % to 0.9 %)" in largest
    assert "largest torque" in largest
    assert "J2 (2.6 % to 1.1 %)" in least
    assert "least torque" in least
    assert stiffness_headline(curves, ["J1", "J2"]).endswith("(J2 at 0.1 % of its largest torque)")
    rigid = {1: curve(1, 0.0, 0.0)}
    assert "J1" not in where_contacts_matter(curves | rigid, ["J1", "J2"])
    assert where_contacts_matter(rigid, ["J1"]) == "Without contacts both curves are one."
    assert stiffness_headline(rigid, ["J1"]).startswith("No joint has contacts")


@pytest.mark.parametrize(("second", "scale"), [(0.009, "linear"), (0.5, "log")])
def test_loss_axis_is_logarithmic_for_losses_decades_apart(second, scale):
    curves = {1: curve(1, 0.005, 0.009), 2: curve(2, second, second)}
    axes = loss_figure(curves, joint_units(robot(2))).axes[0]
    assert axes.get_yscale() == scale
    assert axes.get_ylim()[1] < 200.0 * second
