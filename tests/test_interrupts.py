"""Who takes Ctrl-C while an answer is prepared."""

import signal

import pytest

from stiffopt.interrupts import defer_until_result, end_deferral


@pytest.fixture(autouse=True)
def as_in_a_terminal():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_first_interrupt_is_deferred_until_a_result(capsys):
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        assert "once there is a motion to keep" in capsys.readouterr().err
        with pytest.raises(KeyboardInterrupt):
            end_deferral()
        end_deferral()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_second_interrupt_is_immediate():
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_interrupt_after_a_result_is_immediate():
    with defer_until_result():
        end_deferral()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    end_deferral()


def test_late_interrupt_does_not_affect_the_next_solve():
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
    end_deferral()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ignored_sigint_stays_ignored():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        end_deferral()


def test_nested_deferral_has_no_effect(capsys):
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        with defer_until_result(), pytest.raises(KeyboardInterrupt):
            end_deferral()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert capsys.readouterr().err.count("to keep") == 1


def test_ended_solve_is_not_interrupted():
    with defer_until_result():
        signal.raise_signal(signal.SIGINT)
        end_deferral(ended=True)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
