"""Sentences on compensated motions, compared with toppra's motion."""

from __future__ import annotations

import numpy as np
import pytest

from stiffopt.report.solve.compensation import compensation_text
from stiffopt.result.compensation import CompensatedMotion, Compensation, Spread, Spreads


def motion(name, flight, after):
    spreads = Spreads(
        **{
            phase: Spread(
                nominal=peak, worst=peak, worst_case="", worst_arm={}, draws=np.array([peak])
            )
            for phase, peak in (("flight", flight), ("after", after))
        }
    )
    return CompensatedMotion(
        name=name,
        planned=spreads,
        compensated=spreads,
        simulated=None,
        worst=None,
        spacing=None,
        share=1.0,
        excess=(),
    )


@pytest.mark.parametrize(
    ("toppra", "own", "said"),
    [
        ((8.0, 6.0), (1.0, 2.0), "8 / 3 times below"),
        ((1.0, 1.0), (2.0, 3.0), "2 / 3 times above"),
        ((1.0, 6.0), (2.0, 2.0), "in flight 2 times above and after arrival 3 times below"),
        ((1.0, 0.0), (2.0, 0.0), "in flight 2 times above and after arrival equal to"),
        ((1.0, 0.0), (2.0, 1.0), "in flight 2 times above and after arrival above the 0 of"),
        ((1.0, 2.0), (0.0, 1.0), "in flight at 0, below and after arrival 2 times below"),
        ((0.0, 0.0), (0.0, 0.0), "equal to"),
        ((1.0, 1.0), (1.0001, 0.9999), "about equal to"),
        ((np.nan, 2.0), (1.0, 1.0),
         "in flight not comparable with and after arrival 2 times below"),
    ],
)  # fmt: skip
def test_compensation_text_compares_with_toppra(toppra, own, said):
    compensation = Compensation(
        motions=(motion("optimised", *own), motion("toppra", *toppra)),
        command=None,
        uncertainty=("stiffness",),
        draws=1,
        refusal="",
    )
    text = compensation_text(compensation)
    assert f"{said} toppra as planned; in the worst case {said} toppra" in text
    assert f"{said} toppra compensated" in text
