"""Who takes Ctrl-C while an answer is prepared."""

import signal

import pytest

from stiffopt.interrupts import defer_until_result, end_deferral


@pytest.fixture(autouse=True)
def as_in_a_terminal():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_the_first_one_waits_for_something_to_keep(capsys):
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        assert "once there is a motion to keep" in capsys.readouterr().err
        with pytest.raises(KeyboardInterrupt):
            end_deferral()
        end_deferral()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_one_ends_it_at_once():
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_once_there_is_something_it_interrupts():
    with defer_until_result():
        end_deferral()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    end_deferral()


def test_what_was_too_late_for_one_answer_is_not_of_the_next():
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
    end_deferral()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_shell_that_ignores_it_is_heeded():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        end_deferral()


def test_within_another_one_it_is_the_same(capsys):
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        with defer_until_result(), pytest.raises(KeyboardInterrupt):
            end_deferral()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert capsys.readouterr().err.count("to keep") == 1


def test_an_answer_that_has_ended_is_not_interrupted():
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        end_deferral(ended=True)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
