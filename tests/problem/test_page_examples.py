"""Examples of the pages on cycles and tool paths are whole problem files."""

import re
from pathlib import Path

import pytest

from stiffopt.problem.cycle_files import load_cycle
from stiffopt.problem.files import load_problem

HOWTO = Path(__file__).resolve().parents[2] / ".github" / "docs" / "howto"


def example(page, folder):
    """File of the first example of a page."""
    text = (HOWTO / page).read_text(encoding="utf-8")
    path = folder / "problem.toml"
    path.write_text(re.findall(r"```toml\n(.*?)```", text, re.DOTALL)[0], encoding="utf-8")
    return path


def test_example_of_a_cycle_has_two_legs_and_a_part(tmp_path):
    legs = load_cycle(example("plan_a_cycle.md", tmp_path)).cycle.legs
    assert [leg.moves for leg in legs] == [(1, 2), (3,)]
    masses = [leg.problem.robot.payload[0] for leg in legs]
    assert masses == pytest.approx([1.2, 6.2])


def test_example_of_a_path_is_timed_and_led(tmp_path):
    problem = load_problem(example("follow_a_tool_path.md", tmp_path)).problem
    assert problem.is_timed_on_path
    assert problem.leads_on_path
