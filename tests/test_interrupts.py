"""Who takes Ctrl-C while an answer is prepared."""

import signal

import pytest

from stiffopt.interrupts import beginning, delivered


@pytest.fixture(autouse=True)
def as_in_a_terminal():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_the_first_one_waits_for_something_to_keep(capsys):
    with beginning():
        signal.raise_signal(signal.SIGINT)
        assert "once there is a motion to keep" in capsys.readouterr().err
        with pytest.raises(KeyboardInterrupt):
            delivered()
        delivered()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_one_ends_it_at_once():
    with beginning():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_once_there_is_something_it_interrupts():
    with beginning():
        delivered()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    delivered()


def test_what_was_too_late_for_one_answer_is_not_of_the_next():
    with beginning():
        signal.raise_signal(signal.SIGINT)
    delivered()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_shell_that_ignores_it_is_heeded():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with beginning():
        signal.raise_signal(signal.SIGINT)
        delivered()


def test_within_another_one_it_is_the_same(capsys):
    with beginning():
        signal.raise_signal(signal.SIGINT)
        with beginning(), pytest.raises(KeyboardInterrupt):
            delivered()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert capsys.readouterr().err.count("to keep") == 1


def test_an_answer_that_has_ended_is_not_interrupted():
    with beginning():
        signal.raise_signal(signal.SIGINT)
        delivered(ended=True)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
