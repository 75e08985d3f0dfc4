"""Numbers leave CasADi whole, and a Ctrl-C that comes meanwhile is one."""

import signal

import casadi as ca
import numpy as np
import pytest

from stiffopt.symbolic import array_of


@pytest.mark.parametrize("matrix", [ca.DM(np.arange(12.0).reshape(3, 4)), ca.DM.eye(3), ca.DM(2.0)])
def test_numbers_of_a_matrix_are_those_of_casadi(matrix):
    np.testing.assert_array_equal(array_of(matrix), matrix.full())


def test_ctrl_c_while_numbers_are_taken_is_not_lost():
    matrix, came = ca.DM(np.arange(24.0).reshape(4, 6)), 0

    def stop(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, stop)
    try:
        for _ in range(100):
            try:
                signal.setitimer(signal.ITIMER_REAL, 5e-4)
                while True:
                    assert array_of(matrix) is not None
            except KeyboardInterrupt:
                came += 1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert came == 100
