"""A joint whose bolts work loose: first slip, full slip and stiffness lost."""

import numpy as np
import pytest
from preload_studies import Ring, case, study

from stiffopt.exact.chain import exact_compliance
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.sensitivity import first_slip_torque, loosen_element, loosening

LOADS = (case("lift", j2=40.0, j3=-12.0), case("back", j2=-15.0, j3=5.0))


def tight(**fields):
    model = PreloadModel(study(*LOADS, **{"joints": (2, 3), **fields}))
    return model, 0.9 * model.spread([e.capacity for e in model.elements])


def test_stiffness_left_is_that_of_the_chain_with_the_loose_connection():
    model, preloads = tight()
    result = loosening(model, preloads)
    assert [r.fraction for r in result.rows[:4]] == [1.0, 0.8, 0.5, 0.3]
    assert len(result.rows) == 4 * 5
    for row in result.rows:
        names = {e.key: i for i, e in enumerate(model.elements)}
        chain, torque = model.drivetrain(preloads, row.joint), {2: 40.0, 3: -12.0}[row.joint]
        element = model.elements[names[row.key]]
        least = chain.elements[element.name].preload
        loose = chain.with_preloads({element.name: row.fraction * least})
        at = np.array([torque])
        left = 1.0 / float(exact_compliance(loose, at)[0])
        before = 1.0 / float(exact_compliance(chain, at)[0])
        assert row.case == "lift"
        assert row.stiffness == pytest.approx(left, rel=1e-9)
        assert row.lost == pytest.approx(1.0 - left / before, abs=1e-9)
        assert row.slip_safety == pytest.approx(loose.slip_torques()[element.name] / abs(torque))
        assert row.slips == (row.slip_safety <= 1.0)
        assert row.slips == (row.stiffness == 0.0)


def test_stiffness_falls_as_a_connection_loosens_until_it_slips():
    model, preloads = tight()
    fractions = tuple(np.linspace(1.0, 0.05, 20))
    result = loosening(model, preloads, fractions)
    assert sum(slip > 0.05 for slip in result.slip_fraction.values()) >= 4
    for element in model.elements:
        own = [r for r in result.rows if r.key == element.key]
        lost = np.array([r.lost for r in own])
        assert lost[0] == 0.0
        assert (np.diff(lost) >= 0.0).all()
        assert (lost[-1] == 1.0) == own[-1].slips
        slip = result.slip_fraction[element.key]
        assert [r.slips for r in own] == [f <= slip for f in fractions]
        assert [r.first_slip for r in own] == [
            f < result.first_slip_fraction[element.key] for f in fractions
        ]


def test_slip_begins_at_the_fraction_that_the_closed_form_gives():
    model, preloads = tight(joints=(2,))
    result = loosening(model, preloads)
    for index, element in enumerate(model.elements):
        ring = Ring(element.stage.element)
        least = element.least(preloads[index])
        # Shear grows with the radius: mu p = T r/J at the rim; and as a whole 2/3 of that lever.
        rim = ring.friction * ring.pressure(least) * ring.moment / ring.outer
        assert first_slip_torque(model, preloads, index) == pytest.approx(rim, rel=1e-12)
        assert result.first_slip_fraction[element.key] == pytest.approx(40.0 / rim)
        assert result.slip_fraction[element.key] == pytest.approx(40.0 / ring.slip(least))
        at = {}
        for side in (1 - 1e-6, 1 + 1e-6):
            fraction = side * result.slip_fraction[element.key]
            at[side] = model.exact_stiffness(loosen_element(model, preloads, index, fraction))[0, 0]
        assert at[1 - 1e-6] == 0.0 < at[1 + 1e-6]


def test_pins_bear_at_one_radius_and_slip_all_at_once():
    model, preloads = tight(joints=(3,), free=("pulley_pins",))
    result = loosening(model, preloads)
    assert result.first_slip_fraction == result.slip_fraction
    assert 0.0 < result.slip_fraction["pulley_pins"] < 1.0


def test_without_torque_nothing_slips():
    model = PreloadModel(study(case("rest")))
    result = loosening(model, model.design)
    assert all(not r.slips and not r.first_slip and r.slip_safety == np.inf for r in result.rows)
    assert set(result.slip_fraction.values()) == {0.0}
    assert all(0.0 <= r.lost < 0.1 for r in result.rows)


def test_a_connection_that_slips_when_tight_says_so():
    model = PreloadModel(study(case("over", j2=300.0)))
    result = loosening(model, model.design)
    assert min(result.slip_fraction.values()) > 1.0
    assert all(r.slips and r.stiffness == 0.0 and r.lost == 0.0 for r in result.rows)


def test_individual_bolts_loosen_together():
    one, _ = tight(joints=(2,), free=("flexspline_flange",))
    each, _ = tight(joints=(2,), free=("flexspline_flange",), individual=True)
    rows = [loosening(m, m.spread([9000.0])).rows for m in (one, each)]
    for a, b in zip(*rows, strict=True):
        assert (b.stiffness, b.lost) == pytest.approx((a.stiffness, a.lost), rel=1e-6, abs=1e-9)
        assert (b.slip_safety, b.first_slip) == (pytest.approx(a.slip_safety), a.first_slip)
