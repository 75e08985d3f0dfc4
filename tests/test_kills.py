"""Solves that are killed or interrupted; `python -m benchmarks.reliability` does a hundred."""

import signal

import pytest

from benchmarks.reliability.kills import ended


@pytest.mark.slow
@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGINT], ids=["kill", "interrupt"])
def test_a_folder_never_holds_two_answers(tmp_path, sign):
    found = ended(tmp_path, 2, sign, kinds=("solve",))
    assert found["whole"] + found["begun"] == 2, found
    assert found["left behind"] == 0
    assert found["at the end whole, exit 0"] == 1
