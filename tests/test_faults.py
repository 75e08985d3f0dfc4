"""Inputs that once ended in a traceback, a crash or a hang, where `../shared/faults` is there."""

import pytest

from benchmarks.reliability.commands import stiffopt
from benchmarks.reliability.faults import FAULTS, SECOND, cases, second_cases
from benchmarks.reliability.mutants import alone, called

CASES = tuple(cases()) if FAULTS.is_dir() else ()
SECOND_CASES = tuple(second_cases()) if SECOND.is_dir() else ()
# Meshes without a form are named in an answer, torques of nothing are a constant channel, and half
# a character is printed.
ANSWERED = {
    "mesh_scale_zero",
    "runs_npz_diag_traceback_73c36b",
    "runs_parquet_arr_traceback_73c36b",
    "urdf_crash_0283ba",
    "urdf_traceback_9ec24b",
}
# What can be used after all: odd, but nothing that a file must not say.
USED = {"phys_hang_hang_3d49f7", "trap_rate_20Hz_all"}


@pytest.fixture(scope="module", autouse=True)
def loaded():
    """What commands import, once for all children."""
    import stiffopt.discovery.diagnose
    import stiffopt.discovery.extended.planning
    import stiffopt.preload.study
    import stiffopt.recording.readers.mcap
    import stiffopt.recording.readers.parquet
    import stiffopt.recording.readers.rosbag2
    import stiffopt.recording.static_set
    import stiffopt.report.recording_check
    import stiffopt.robot.stiffness_study
    import stiffopt.solver.solve
    import stiffopt.units

    stiffopt.units.to_si("1 mm", "length")


def ended(case, tmp_path):
    before = {path: path.read_bytes() for path in case.folder.iterdir() if path.is_file()}
    work = case.laid_out(tmp_path)
    own = {path for path in tmp_path.rglob("*") if path.is_file()}
    verdict, what = alone(lambda: called(case.arguments), work)
    assert verdict == ("accepted" if case.folder.name in USED else "told"), what
    if verdict == "told":
        assert {path for path in tmp_path.rglob("*") if path.is_file()} == own
    assert before == {path: path.read_bytes() for path in before}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.folder.name)
def test_one_sentence_or_an_answer(case, tmp_path):
    ended(case, tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(not SECOND_CASES, reason="there is no ../shared/faults/second")
@pytest.mark.parametrize("case", SECOND_CASES, ids=lambda case: case.folder.name)
def test_one_sentence_or_an_answer_of_what_was_found_later(case, tmp_path):
    outcome = stiffopt(case.arguments, case.laid_out(tmp_path))
    expected = "done" if case.folder.name in ANSWERED else "told"
    assert outcome.verdict == expected, outcome.error
    assert "Warning:" not in outcome.error
    if expected == "told":
        assert outcome.code == 2
        assert not (tmp_path / "out").exists()
