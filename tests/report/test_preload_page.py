import re
from dataclasses import replace

import numpy as np
import pytest
from page_reader import Page
from preload_report_studies import cannot, flange, open_flange, run, several, stiff, with_motion

from stiffopt.preload.bolt_sheet import bolt_sheets
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.problem import PreloadProblem
from stiffopt.report.common.text import change, listed
from stiffopt.report.preload.figures import flange_drawings, joint_diagrams
from stiffopt.report.preload.overview import most_used, utilisation_matrix
from stiffopt.report.preload.page import write_preload_report
from stiffopt.report.preload.words import (
    active_limits_sentence,
    fastener_words,
    headline,
    prose,
    readable,
    stiffness_sentence,
    weakest_sentence,
)

FIGURES = (
    *("preload_curves", "preload_diagram", "preload_flanges"),
    *("preload_front", "preload_loosening", "preload_shares"),
)


def page_of(study, folder):
    path = write_preload_report(study, folder)
    assert path == folder / "report.html"
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert page.outside == []
    assert "script" not in page.tags
    assert not re.search(r"\bnan\b|\binf\b|None", page.text)
    assert not re.search(r"\b[a-z]+_(flange|pins|key)\b", page.text)
    return page


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("flange")


@pytest.fixture(scope="module")
def flange_page(folder):
    return page_of(flange(), folder)


def test_page_of_one_flange_has_torque_limits_sources_and_estimates(flange_page, folder):
    study, page = flange(), flange_page
    torque = study.solution.tightening["flexspline_flange"]
    for text in (
        "Flange of J2",
        f"Tighten the 9 bolts of the flexspline flange to {torque.nominal:.3g} N m",
        "Active limit: slip safety at peak torque.",
        "slip, not stiffness, determines the preload",
        "9 × M5 12.9",
        f"{torque.lower:.3g} N m",
        "torque wrench",
        "7.8 kN *",
        "20 to 40 *",
        "2 d *",
        "head pressure *",
        "VDI 2230, M5 12.9",
        "knee",
        "Most compliant element: reducer",
        "parallel keys, calculation and design",
        "preferred numbers",
    ):
        assert text in page.text, text
    for name in FIGURES:
        assert (folder / f"{name}.svg").read_text(encoding="utf-8").startswith("<svg")
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert page.tags.count("svg") == len(FIGURES)


def test_calculation_sheet_has_every_step_of_vdi_2230(flange_page):
    study = flange()
    cells = flange_page.table("step", "check")
    rows = {r.kind: r for r in study.solution.rows if r.equation and r.element}
    assert {row[1].removesuffix(" (warning)") for row in cells} == set(rows)
    assert [row[0] for row in cells if row[1] == "working stress"] == ["R8/5"]
    order = [int(row[0][1:].split("/")[0].split(",")[0]) for row in cells if row[0][0] == "R"]
    assert order == sorted(order)
    (facts,) = flange_page.table("R1 α_A", "R3 δ_S")
    assert facts[0] == "1.6"
    assert facts[-1] == "< 0.001 %"
    assert facts[-2] == f"{study.solution.tightening['flexspline_flange'].nominal:.3g} N m"
    for text in ("sheet for signature", "calculated by", "break-before: page", "Load of each bolt"):
        assert text in flange_page.text


def test_a_joint_that_slips_outside_the_study_is_named(tmp_path):
    torque = np.array([0.0, 4.0, 0.3, 0.0, 0.0, 0.0]) * flange().problem.robot.torque_max
    held = LoadCase(name="held", torque=0.1 * torque, jacobian=np.eye(3, 6))
    pushed = LoadCase(name="pushed", torque=torque, jacobian=np.eye(3, 6))
    study = run(joints=(3,), load_cases=(held, pushed), front_points=0)
    assert study.solution.status.usable
    assert study.solution.largest_deflection == np.inf
    page = page_of(study, tmp_path)
    assert "joint 2 slips under pushed with the preloads of the robot file" in page.text
    assert [row[-2] == "slips" for row in page.table("load case", "present preload")] == [
        False,
        True,
    ]


def test_joint_diagram_lines_meet_at_the_assembly_preload():
    study = flange()
    model = PreloadModel(study.problem, study.solution.cases)
    (sheet,) = bolt_sheets(model, study.solution.vector)
    (axes,) = (a for a in joint_diagrams([sheet]).axes if a.get_visible())
    bolt, clamped, service, *_ = axes.get_lines()
    assert bolt.get_ydata()[-1] == clamped.get_ydata()[0] == pytest.approx(sheet.largest / 1e3)
    assert bolt.get_xdata()[-1] == clamped.get_xdata()[0]
    slope = np.diff(clamped.get_xdata())[0] / -np.diff(clamped.get_ydata())[0]
    assert slope == pytest.approx(1e9 * sheet.plate_compliance)
    assert service.get_ydata()[0] == pytest.approx(sheet.in_service / 1e3)
    assert sheet.in_service == pytest.approx(sheet.least - sheet.loss)


def test_flange_drawing_has_the_load_of_every_bolt():
    wrench = np.zeros((6, 6))
    wrench[1] = [0, 0, 0, 30.0, 0, 20.0]
    load = LoadCase(name="tilt", torque=wrench[:, 5], wrench=wrench)
    robot = open_flange()
    model = PreloadModel(
        PreloadProblem(robot=robot, joints=(2,), load_cases=(load,), free=("flexspline_flange",))
    )
    (sheet,) = bolt_sheets(model, np.array([9e3]))
    assert sheet.axial.sum() == pytest.approx(0.0, abs=1e-9)
    (axes,) = flange_drawings([sheet]).axes
    texts = [text.get_text() for text in axes.texts]
    for force in sheet.axial:
        assert f"{force:.3g}" in [t.replace("−", "-") for t in texts]


def test_header_shows_slip_safety_under_the_whole_load_where_lower(tmp_path):
    wrench = np.zeros((6, 6))
    wrench[1] = 0.0, 0.0, 200.0, 30.0, 20.0, 40.0
    load = LoadCase(name="swing", torque=wrench[:, 5].copy(), wrench=wrench)
    study = run(
        front_points=0,
        robot=open_flange(),
        joints=(2,),
        free=("flexspline_flange",),
        load_cases=(load,),
    )
    rows = {row.kind: row.value for row in study.solution.rows}
    whole = rows["slip under the whole load"]
    assert whole < rows["slip safety"] - 0.1
    assert f"least slip safety {whole:.2f}" in " ".join(page_of(study, tmp_path).text.split())


def test_catalogue_search_counts_every_combination(flange_page):
    choice = flange().choice
    total = choice.proof.combinations
    assert f"The catalogue has {total} combinations" in flange_page.text
    assert "the catalogue has no better design" in flange_page.text
    *parts, (_, whole) = flange_page.table("excluded by")
    assert sum(int(count) for _, count in parts) == int(whole) == total
    design = choice.designs["flexspline_flange"]
    taken = f"{design.count} × {design.size} {design.grade} {design.torque:g} N m"
    assert taken in flange_page.text


def test_unfinished_catalogue_search_claims_no_optimality(tmp_path):
    choice = flange().choice
    proof = replace(choice.proof, unvisited=7)
    page = page_of(replace(flange(), choice=replace(choice, proof=proof)), tmp_path)
    assert "7 were not visited" in page.text
    assert "the catalogue has no better design" not in page.text
    assert "standard torques cost" not in page.text


def test_page_of_an_infeasible_study_has_reasons_and_no_recommendation(tmp_path):
    study = cannot()
    page = page_of(study, tmp_path)
    for text in (
        "No preload meets all requirements",
        "slip safety, flexspline flange, overload",
        "bolt utilisation of flexspline flange",
        "Remedy: a larger bolt",
        "Do not use them for tightening.",
        "exceeded",
    ):
        assert text in page.text, text
    for stop in study.solution.stoppers:
        assert f"Required {stop.required:.4g}, best reachable {stop.best:.4g}." in page.text
    assert "Set the wrench" not in page.text
    assert "recommended" not in page.text.replace("all others as recommended", "")
    assert "knee" not in page.text
    chosen = headline(replace(study, choice=flange().choice))
    assert chosen.startswith("The present bolts cannot meet all requirements; the catalogue has ")
    assert flange().choice.designs["flexspline_flange"].label in chosen


def test_page_of_several_joints_has_a_utilisation_matrix(tmp_path):
    study = several()
    page = page_of(study, tmp_path)
    assert f"Tighten {len(study.problem.elements)} connections as listed" in page.text
    assert f"All {len(study.solution.rows)} requirements" in page.text
    assert "joint 2 flexspline flange" in page.text
    matrix = utilisation_matrix(study.solution.rows)
    assert len(matrix.rows) == len(study.problem.elements) + 1
    worst = max(r.utilisation for r in study.solution.rows if r.kind == "key pressure")
    keys = list(matrix.rows.values())[-1]
    assert keys[matrix.kinds.index("key pressure")].utilisation == worst
    shown = page.table("", *matrix.kinds)
    assert [name for name, *_ in shown] == list(matrix.rows)
    assert float(shown[-1][1 + matrix.kinds.index("key pressure")]) == pytest.approx(
        100 * worst, rel=5e-3
    )


@pytest.mark.parametrize("gain", [0.0004, 0.03])
def test_joint_optimisation_reports_its_gain(gain, tmp_path):
    page = page_of(with_motion(flange(), gain), tmp_path)
    compared = page.table("", "peak dynamic deflection of the tool")
    assert compared[-1][1] == f"{100 * gain:.2g} %"
    assert ("not worth it here" in page.text) == (gain < 0.01)


def test_page_without_front_and_choice(tmp_path):
    page = page_of(replace(flange(), front=None, choice=None), tmp_path)
    assert "Pareto front" not in page.text
    assert "Catalogue design" not in page.text
    assert page.tags.count("svg") == 5


def test_page_of_a_joint_study_escapes_titles_and_notes(tmp_path):
    hostile = "<script>alert('x')</script>"
    study = with_motion(flange(), 0.01)
    problem = replace(study.problem, title=hostile)
    solution = replace(study.solution, notes=(hostile,))
    page = page_of(replace(study, problem=problem, solution=solution), tmp_path)
    assert page.text.count("alert('x')") >= 2
    assert "peak dynamic deflection of the tool" in page.text


def test_stiffness_sentence_names_slip_only_where_it_is_active():
    study = stiff()
    assert {row.kind for row in study.solution.rows if row.active} == {"joint stiffness"}
    text = stiffness_sentence(study.problem, study.solution)
    assert "determines the preload" not in text
    assert "joint stiffness" in active_limits_sentence(study.problem, study.solution)


def test_stiffness_sentence_gives_the_change_of_the_least_stiffness():
    study = stiff()
    before, after = study.solution.stiffness_before.min(), study.solution.stiffness.min()
    text = stiffness_sentence(study.problem, study.solution)
    assert change(after / before) in text
    slipping = replace(study.solution, stiffness_before=np.zeros((1, 1)))
    text = stiffness_sentence(study.problem, slipping)
    assert "joint 2 slips" in text
    assert "changes by" not in text


def test_large_stiffness_gain_is_not_attributed_to_slip():
    study = flange()
    before = study.solution.stiffness / 1.3
    text = stiffness_sentence(study.problem, replace(study.solution, stiffness_before=before))
    assert "+30 %" in text
    assert "determines the preload" not in text


def test_tightening_table_has_least_and_largest_preload(flange_page):
    study = flange()
    element = study.problem.elements[0]
    largest = study.solution.preloads[element.key]
    (row,) = flange_page.table("connection", "fasteners", "tightening torque", "least torque")
    least = largest / study.problem.tightening.alpha - element.loss
    assert float(row[5].split()[0]) == pytest.approx(largest / 1e3, rel=5e-3)
    assert float(row[6].split()[0]) == pytest.approx(least / 1e3, rel=5e-3)


def test_requirements_shown_are_the_worst_of_each_owner(flange_page):
    rows = most_used(flange().solution.rows)
    slip = [row for row in rows if row.kind == "slip safety"]
    assert [row.case for row in slip] == ["peak torque"]
    used = [row.utilisation for row in rows]
    assert used == sorted(used, reverse=True)
    cells = flange_page.table("connection", "requirement")
    assert [row[1].removesuffix("active") for row in cells[: len(rows)]] == [r.kind for r in rows]
    (bound,) = (row for row in cells[: len(rows)] if row[1] == "slip safetyactive")
    assert bound[4] == "≥ 1.2"
    assert not most_used(cannot().solution.rows)[0].satisfied


def test_loosening_table_counts_each_connection_once(flange_page):
    (row,) = flange_page.table("connection", "rim slips below")
    assert row[3].startswith("1.20")
    assert row[-1].endswith("slips")


def test_most_compliant_element_is_named_with_its_share():
    share = {each.element: each for each in flange().sensitivity.shares if each.case == "hold"}
    text = weakest_sentence({2: list(share.values())}, ["flexspline_flange"])
    assert f"{100 * share['flexspline_flange'].share:.2g} %" in text
    assert text.startswith("Most compliant element: reducer, ")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("joint_2.motor_key", "joint 2 motor key"),
        ("at most 4.5 N. The end", "at most 4.5 N. The end"),
        ("a smaller require.least_preload, or", "a smaller require.least_preload, or"),
    ],
)
def test_element_keys_become_words_and_file_keys_stay(text, said):
    assert readable(text) == said


def test_word_formats():
    assert prose("rises by 1.1%: flat") == "rises by 1.1 %: flat"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed([]) == ""
    assert change(1.0) == "0 %"
    assert change(0.98) == "−2 %"
    assert fastener_words(several().problem.elements).endswith("bolts and pins")
    assert fastener_words(flange().problem.elements) == "9 bolts"
