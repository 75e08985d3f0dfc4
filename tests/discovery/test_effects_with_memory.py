"""Effects with a memory in one call, against the recurrence sample after sample."""

import casadi as ca
import numpy as np
import pytest

from stiffopt.discovery.catalogue import elastic, history

LOAD = 2e-5 * np.cumsum(np.random.default_rng(0).normal(size=800))
# It stands for a while, and turns round.
LOAD[200:260] = LOAD[200]


@pytest.mark.parametrize("kept", [0.0, 0.2, 0.97, 1.0])
def test_lag_equals_recurrence(kept):
    slow = history.remember(history._lag, [LOAD], [LOAD[0]], [kept])
    np.testing.assert_allclose(history.lagged(LOAD, kept), slow, rtol=0.0, atol=1e-15)
    symbol = ca.MX.sym("kept")
    of_symbol = ca.Function("lag", [symbol], [history.lagged(LOAD, symbol)])
    np.testing.assert_allclose(np.array(of_symbol(kept)).ravel(), slow, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("reach", [2e-5, 3e-4, 5e-3])
def test_presliding_of_exponent_one_equals_recurrence(reach):
    slow = history.remember(elastic.dahl, [LOAD], [0.0, LOAD[0]], [reach, 1.0])
    np.testing.assert_allclose(elastic._evenly(LOAD, reach), slow, rtol=0.0, atol=3e-9)
