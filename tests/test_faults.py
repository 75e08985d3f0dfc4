"""Inputs that once ended in a traceback, a crash or a hang, where `../shared/faults` is there."""

import pytest

from benchmarks.reliability.faults import FAULTS, cases
from benchmarks.reliability.mutants import alone, called

CASES = tuple(cases()) if FAULTS.is_dir() else ()
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
