import json
from dataclasses import replace

import pytest
from page_reader import Page
from synthetic_solution import no_motion, problem, robot, solution
from test_figures import stiffness_rows

from stiffopt.errors import InputError, InputFileError
from stiffopt.problem.objective import Objective
from stiffopt.report.common.citations import cited, references
from stiffopt.report.common.text import si
from stiffopt.report.compare import compare_results
from stiffopt.report.file_reference import explain_key
from stiffopt.report.pages.stiffness import write_stiffness_report
from stiffopt.report.solve.page import write_solve_report
from stiffopt.report.solve.wording import amount, comparison, objective_text, violation_text
from stiffopt.result.assessment import Violation
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.solution import ObjectiveValue
from stiffopt.result.status import SolveStatus


def page_of(stated, found, folder):
    path = write_solve_report(stated, found, folder)
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert page.outside == []
    # The scene of a motion has scripts of its own, none from elsewhere; without it there are none.
    assert page.tags.count("script") == (0 if found.assessment is None else 3)
    assert "@import" not in text
    assert len(text) < 2_000_000
    return page


def test_report_has_objective_gain_limits_and_sources(tmp_path):
    page = page_of(problem(), solution(), tmp_path)
    for text in (
        "Peak dynamic tool deflection 0.141 mm",
        "4 times less than toppra's motion of the same duration.",
        "Solved and certified",
        "margin 2 %",
        "not counted",
        "torque, joint 2: exceeded by 40 %",
        "The sag at the end is 0.4 mm.",
        "width, length",
        "a guess",
        "0123abcd",
        "An introduction to trajectory optimization",
        "reachability analysis",
        "stiffness of joint 1 at least",
        "jerk by 3.20%",
        "numpy",
    ):
        assert text in page.text, text
    assert page.tags.count("svg") == 7


def test_titles_are_escaped(tmp_path):
    hostile = "<script>alert('x')</script>"
    page = page_of(
        problem(1, title=hostile), solution(1, notes=(hostile,), message=hostile), tmp_path
    )
    assert page.text.count("alert('x')") >= 3


@pytest.mark.slow
def test_report_of_seven_joints(tmp_path):
    page = page_of(problem(7), solution(7), tmp_path)
    assert "made_up, 7 joints" in page.text


def test_report_without_a_motion_is_a_page(tmp_path):
    page = page_of(problem(), no_motion(), tmp_path)
    assert "No motion found" in page.text
    assert "Rows that conflict: torque of joint 2." in page.text
    assert "svg" not in page.tags


def test_an_infeasible_motion_claims_no_gain(tmp_path):
    found = solution(1, status=SolveStatus.INFEASIBLE, ratio_to_better_baseline=None)
    page = page_of(problem(1), found, tmp_path)
    assert "Infeasible: peak dynamic tool deflection" in page.text
    assert "not compared" in page.text
    assert "optimised (exceeds limits)" in page.text


def test_a_slowed_baseline_is_compared_where_no_other_keeps_the_limits():
    given = solution(1)
    slowed = replace(given.baselines["toppra"], name="slowed S-curve")
    only = {"quintic": given.baselines["quintic"]}
    found = replace(
        given,
        baselines=only,
        ratio_to_better_baseline=None,
        strict_baseline=slowed,
        ratio_to_strict_baseline=0.25,
    )
    assert "4 times less than the slowed S-curve motion" in comparison(problem(1), found)
    late = replace(found, strict_baseline=replace(slowed, feasible=False))
    assert comparison(problem(1), late) == "No baseline meets all limits, so none is counted."


def test_report_without_baselines(tmp_path):
    found = solution(1, baselines={}, ratio_to_better_baseline=None)
    assert "It was not compared with baselines" in page_of(problem(1), found, tmp_path).text


def test_report_marks_a_failed_certificate(tmp_path):
    motion = solution(1).assessment
    worst = (Violation(0.03, "velocity", 1, 0.2), *motion.violations)
    found = solution(1, assessment=type(motion)(**{**vars(motion), "violations": worst}))
    page = page_of(problem(1), found, tmp_path)
    assert "limit exceeded by" in page.text
    assert "exceeded by 3 %" in page.text


def test_report_says_whether_results_match_inputs(tmp_path):
    stated = problem()
    own = replace(no_motion(), inputs_hash=inputs_hash(stated))
    assert "Results match inputs" in page_of(stated, own, tmp_path).text
    assert "Results do NOT match inputs" in page_of(stated, no_motion(), tmp_path).text


def test_report_in_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputFileError, match=r"report\.html"):
        write_solve_report(problem(), no_motion(), tmp_path / "file")


def test_weighted_sum_has_its_terms(tmp_path):
    objectives = (
        Objective(name="dynamic_deflection", weight=2.0),
        Objective(name="torque_squared", weight=0.5),
    )
    value = ObjectiveValue(
        name="weighted_sum",
        measure="",
        value=0.7,
        unit="",
        terms={"dynamic_deflection peak": 1e-4, "torque_squared": 1.4},
    )
    page = page_of(problem(1, objectives=objectives), solution(1, objective=value), tmp_path)
    assert "Weighted sum 0.7" in page.text
    assert "peak dynamic tool deflection" in page.text


@pytest.mark.parametrize(
    ("ratio", "name", "maximised", "text"),
    [
        (0.29, "dynamic_deflection", False, "3.4 times less than"),
        (0.83, "dynamic_deflection", False, "17 % less than"),
        (1.2, "torque_squared", False, "20 % more than"),
        (2.5, "torque_squared", False, "2.5 times as much as"),
        (0.5, "duration", False, "50 % shorter than"),
        (0.8, "joint_stiffness", True, "25 % more than"),
        (1.25, "joint_stiffness", True, "20 % less than"),
        (1.0, "duration", False, "The same as"),
    ],
)
def test_amount_formats_ratios(ratio, name, maximised, text):
    assert amount(ratio, name, maximised) == text


def test_comparison_takes_only_feasible_baselines():
    assert "toppra" in comparison(problem(), solution())
    assert "There is no motion" in comparison(problem(), no_motion())


def test_every_reference_can_be_printed():
    for key, reference in references().items():
        assert reference.fields["title"] in reference.text, key
        assert "{" not in reference.text
    with pytest.raises(InputError, match="Kelly2017"):
        cited(["Kelly2018"])


def test_stiffness_page_and_its_plots(tmp_path):
    path = write_stiffness_report(robot(3), stiffness_rows(), tmp_path)
    page = Page(path.read_text(encoding="utf-8"))
    assert page.outside == []
    assert page.tags.count("svg") == 4
    assert "Contacts reduce the stiffness by up to 55 %" in page.text
    assert "1.50" in page.text  # slip safety 45 N m / 30 N m
    names = {each.name for each in tmp_path.iterdir()}
    kinds = ("tangent", "low_torque", "loss", "shares")
    drawn = {f"stiffness_{kind}.{end}" for kind in kinds for end in ("svg", "png")}
    assert names == drawn | {"stiffness.html"}


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (6.99e-11, "m", "below 0.001 µm"),
        (-6.99e-11, "m", "below 0.001 µm"),
        (6.99e-9, "m", "0.00699 µm"),
        (1e-12, "s", "below 0.001 ms"),
        (0.0, "m", "0 µm"),
    ],
)
def test_lengths_and_times_have_a_least_written_value(value, unit, text):
    assert si(value, unit, 3) == text


def test_time_integral_is_written_in_seconds():
    value = ObjectiveValue(name="torque_squared", measure="", value=0.0111, unit="s")
    assert objective_text(value).endswith("0.0111 s")


def test_explain_finds_values_and_suggests_similar_spelling():
    assert next(explain_key("shaped_deviation")) == "minimise.objective (trajectory)"
    with pytest.raises(InputError, match="Did you mean 'shaped_deviation'"):
        next(explain_key("shaped_deviaton"))
    with pytest.raises(InputError) as error:
        next(explain_key("zzyzx"))
    assert "Did you mean" not in str(error.value)


def test_compared_quantities_have_units(tmp_path):
    for name, value in (("one", 1e-4), ("two", 2e-4)):
        (tmp_path / name).mkdir()
        answer = {
            "objective": {"value": value, "unit": "m"},
            "baselines": {"toppra": {"objective": 3 * value}},
        }
        (tmp_path / name / "result.json").write_text(json.dumps(answer))
    _, rows = compare_results(tmp_path / "one", tmp_path / "two")
    assert rows[0] == ("objective, value", "0.1 mm", "0.2 mm", "+100 %")
    assert rows[1][:3] == ("baselines, toppra, objective", "0.3 mm", "0.6 mm")


def test_numbers_of_a_list_and_what_one_result_lacks_are_one_compared_entry(tmp_path):
    torque, jerk = ({"limit": name, "joint": 1, "value": -0.1} for name in ("torque", "jerk"))
    arm, post = ({"limit": "clearance", "pair": ["hand", x], "value": 0.2} for x in ("arm", "post"))
    answers = {
        "one": {
            "draws": [1.0, 2.0, 4.0],
            "rivals": {"quintic": 1, "toppra": 2},
            "v": [torque, jerk, arm, post],
            "findings": [],
        },
        "two": {
            "draws": [1.0, 2.5, 4.0],
            "v": [{**jerk, "value": -0.2}, torque, {**arm, "value": 0.3}, post],
            "findings": [{"effect": "viscous", "joint": 2}],
        },
    }
    for name, answer in answers.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.json").write_text(json.dumps(answer))
    _, rows = compare_results(tmp_path / "one", tmp_path / "two")
    assert rows == [
        ("draws", "3 values, 1 to 4", "3 values, 1 to 4", "up to 12 % of the largest"),
        ("rivals", "2 entries", "–", ""),
        ("v, jerk of joint 1, value", "-0.1", "-0.2", "+100 %"),
        ("v, clearance of hand and arm, value", "0.2", "0.3", "+50 %"),
        ("findings 1", "–", "2 entries", ""),
    ]


def test_a_limit_within_the_tolerance_of_the_certificate_is_kept():
    texts = [
        violation_text(Violation(value, "velocity", 1, 0.0)) for value in (3e-4, 5.1e-3, -0.02)
    ]
    assert texts == ["at the limit (+0.03 %)", "exceeded by 0.51 %", "margin 2 %"]
