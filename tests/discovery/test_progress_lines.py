"""A step that takes long says that it goes on."""

from __future__ import annotations

import time

import pytest

from stiffopt.discovery.progress import repeat_progress


def test_long_step_repeats_line() -> None:
    said: list[str] = []
    with repeat_progress(said.append, quiet=0.05) as say:
        time.sleep(0.2)  # nothing was said yet
        assert said == []
        say("fit all")
        time.sleep(0.4)
    assert said[0] == "fit all"
    assert said[1].startswith("running for")
    assert said[1].endswith("s: fit all")
    assert len(said) >= 3
    after = len(said)
    time.sleep(0.2)
    assert len(said) == after


def test_short_steps_do_not_repeat() -> None:
    said: list[str] = []
    with repeat_progress(said.append, quiet=5.0) as say:
        say("first")
        say("second")
    assert said == ["first", "second"]


def test_failing_display_is_ignored() -> None:
    """Ctrl-C and errors of a display are for the step that speaks, not for the thread beside."""

    def fail(sentence: str) -> None:
        if "running" in sentence:
            raise KeyboardInterrupt

    with repeat_progress(fail, quiet=0.05) as say:
        say("fit all")
        time.sleep(0.3)

    with pytest.raises(KeyboardInterrupt), repeat_progress(fail, quiet=5.0) as say:
        say("running")


def test_progress_without_callback() -> None:
    with repeat_progress(None) as say:
        say("first")
