"""A law that no catalogue has, from recordings to files and to the next diagnosis."""

import html
import re

import numpy as np
import pytest
from diagnosed_folders import answered, command, written
from simulated_sets import short_case
from typed_laws import typed_torque

from stiffopt.discovery.extended.model import load_extended
from stiffopt.discovery.laws.law import law_of
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.user_effects import load_effects, sample_signals

pytestmark = pytest.mark.slow

# Dry friction of joint 1 by the load of another joint; nobody's catalogue has it.
SHARED_BEARING = short_case(("shared_bearing", 1, 1.5), seed=11)
ANOTHER_ROBOT = short_case(("shared_bearing", 1, 1.0), seed=12)


def test_verdict_equation_and_proof():
    found = answered(SHARED_BEARING)
    assert found.code == 0
    document = found.document
    assert document["verdict"] == "law_found"
    (law,) = document["laws"]
    assert law["joint"] == 1
    assert {re.sub(r"sg\((\w+)\)", r"\1", s) for s in law["signals"]} == {"w_1", "T_2"}
    assert law["explained"] > 0.85 * law["attainable"]
    fit = document["fit"]["test"]
    assert fit["nrmse_after"] ** 2 - 1.0 < 0.15 * (fit["nrmse_before"] ** 2 - 1.0)


def test_page_has_the_equation_with_its_numbers_in_full():
    found = answered(SHARED_BEARING)
    page = (found.out / "report.html").read_text(encoding="utf-8")
    (law,) = found.document["laws"]
    model = load_extended(found.out / "extended.toml")
    (estimated,) = [e for e in model.extension.effects if law_of(e.effect) is not None]
    assert law["equation"].replace("+=", "").split()[0] in page
    assert f"A = {estimated.amplitudes[0]!r}" in page
    assert "Residual over the signals of the law" in page
    assert "The law adds to the torque that the drive of joint 1 has to give" in page


def test_page_names_the_nominal_values_that_the_law_is_told_together_with():
    """Friction by a load is, over the loads that were met, partly the dry friction of the joint."""
    found = answered(SHARED_BEARING)
    page = html.unescape((found.out / "report.html").read_text(encoding="utf-8"))
    (told,) = re.findall(r"would lower the law's variance: (.*?)\.</p>", page)
    values = load_extended(found.out / "extended.toml").extension.calibration
    assert f"dry friction of joint 1, {100 * values[ValueName('coulomb', 0)]:+.4g} % here" in told


def test_the_equation_typed_from_the_page_gives_the_torque_of_the_model():
    found = answered(SHARED_BEARING)
    page = html.unescape((found.out / "report.html").read_text(encoding="utf-8"))
    equation, numbers, meanings = re.search(
        r'<div class="equation">([^<]*\+=[^<]*)</div>\s*<div class="equation">(.*?)</div>\s*'
        r"<p>Here (.*?)\. SI units",
        page,
        re.DOTALL,
    ).groups()
    model = load_extended(found.out / "extended.toml")
    (estimated,) = [e for e in model.extension.effects if law_of(e.effect) is not None]
    law = law_of(estimated.effect)
    signals = sample_signals(count=300)
    lines = [line.strip() for line in numbers.split("<br>") if line.strip()]
    typed = typed_torque(equation, lines, meanings.split("; "), signals)
    columns = law.columns(signals, estimated.shapes)
    own = sum(a * c for a, c in zip(estimated.amplitudes, columns, strict=True))
    np.testing.assert_allclose(typed, own, rtol=1e-9, atol=1e-9 * np.abs(own).max())


def test_next_diagnosis_starts_from_the_law():
    found = answered(SHARED_BEARING)
    again = command(found.source, "--model", str(found.out / "extended.toml"), "--no-report")
    assert again.code == 0
    assert again.document["verdict"] == "nothing_missing"
    before = again.document["fit"]["test"]["nrmse_before"]
    assert before == pytest.approx(found.document["fit"]["test"]["nrmse_after"], rel=1e-6)


def test_another_robot_is_asked_for_the_law():
    found = answered(SHARED_BEARING)
    path = found.out / "law.py"
    (effect,) = load_effects(path)
    asked = command(written(ANOTHER_ROBOT), "--effects", str(path), "--no-report")
    assert asked.code == 0
    (finding,) = asked.document["findings"]
    assert (finding["effect"], finding["joint"]) == (effect.name, 1)
    assert np.isfinite(finding["parameters"]["A"]["sd"])
