"""The shipped problem files: each loads, says where its expected value comes from, and verifies."""

import pytest
from small_arms import ROOT

from stiffopt.files import load_toml
from stiffopt.problem.bounds import check_bounds
from stiffopt.problem.cycle_files import is_cycle, load_cycle
from stiffopt.problem.files import load_problem
from stiffopt.problem.resolve import resolve


def shipped(kind):
    paths = sorted((ROOT / "problems").glob("*.toml"))
    return [path for path in paths if load_toml(path).get("kind") == kind]


ALL = shipped("trajectory")
CYCLES = [path for path in ALL if is_cycle(path)]
FILES = [path for path in ALL if path not in CYCLES]
IDS = [path.stem for path in FILES]
STUDIES = shipped("preload")


def test_there_are_problems():
    assert len(FILES) >= 8
    assert "er3a_pick_and_place" in IDS
    assert len(STUDIES) >= 3


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_problem_loads_and_can_be_stated_honestly(path):
    problem = load_problem(path).problem
    motion = resolve(problem)
    assert motion.points.shape[1] == problem.joints
    check_bounds(problem, motion)


@pytest.mark.parametrize("path", CYCLES, ids=[path.stem for path in CYCLES])
def test_cycle_has_eight_moves_and_two_events(path):
    cycle = load_cycle(path).cycle
    assert sum(len(leg.moves) for leg in cycle.legs) == 8
    events = [leg.stop.event.kind for leg in cycle.legs if leg.stop.event is not None]
    assert events == ["grip", "release"]
    for leg in cycle.legs:
        check_bounds(leg.problem, resolve(leg.problem))
    # Poses above and at a place are taken in the same branch.
    branches = {posture.name: posture.branch for posture in cycle.postures}
    for place in ("pick", "place"):
        assert branches[place] == branches[f"above {place}"]


@pytest.mark.parametrize("path", ALL, ids=[path.stem for path in ALL])
def test_expected_value_has_a_source(path):
    expected = (load_cycle if is_cycle(path) else load_problem)(path).expected
    assert expected is not None
    # A wider tolerance is the measured spread of a flat optimum.
    assert expected.rtol <= 1e-4 or "spread of" in expected.source
    assert expected.rtol <= 2e-3
    assert len(expected.source) > 4


@pytest.mark.slow
@pytest.mark.parametrize("path", STUDIES, ids=[path.stem for path in STUDIES])
def test_study_verifies(path):
    from stiffopt.verify import verify_study

    for check in verify_study(path):
        assert check.passed, f"{check.name}: {check.value} for {check.expected} {check.unit}"


@pytest.mark.slow
@pytest.mark.parametrize("path", ALL, ids=[path.stem for path in ALL])
def test_problem_verifies(path):
    from stiffopt.verify import verify_file

    check = verify_file(path)
    assert check.passed, f"{check.value} for {check.expected} {check.unit}: {check.message}"
