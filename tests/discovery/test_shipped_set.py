"""The simulated set beside the problems: commands and Python of the README run on it."""

import json
import subprocess
import sys

import pytest
from shipped_set import SHIPPED

from stiffopt.cli import run

# What was added to joint 2 when the set was simulated [N m].
ADDED = 0.6237


def test_shipped_set_is_small_and_labelled_simulated():
    assert sum(path.stat().st_size for path in SHIPPED.iterdir()) < 300_000
    assert (
        (SHIPPED / "recordings.toml").read_text().startswith("# Simulated, no robot was measured")
    )


def test_shipped_set_is_usable(capsys):
    assert run(["recording", "check", str(SHIPPED)]) == 0
    assert "2 joints, 4 runs" in capsys.readouterr().out


@pytest.fixture(scope="module")
def without_report(tmp_path_factory):
    """Results of a process of its own, and the packages that it loaded."""
    out = tmp_path_factory.mktemp("shipped") / "out"
    out.mkdir()
    (out / "report.html").write_text("of an earlier diagnosis")
    arguments = ["diagnose", str(SHIPPED), "--out", str(out), "--no-report", "--quiet"]
    code = (
        "import sys\nfrom stiffopt.cli import run\n"
        f"assert run({arguments!r}) == 0\nassert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120, capture_output=True)
    return out


def test_a_diagnosis_without_report_draws_nothing(without_report):
    names = {path.name for path in without_report.iterdir()}
    assert {"diagnosis.json", "extended.toml", "pred_after_test_1.npz"} <= names
    assert not {name for name in names if name.endswith((".html", ".svg", ".png"))}


def test_the_friction_is_found(without_report):
    document = json.loads((without_report / "diagnosis.json").read_text())
    assert document["verdict"] == "named"
    (finding,) = document["findings"]
    assert (finding["effect"], finding["joint"]) == ("coulomb", 2)
    found = finding["parameters"]["dFc"]
    assert abs(found["value"] - ADDED) < 3.0 * found["sd"] < 0.2 * ADDED
    test = document["fit"]["test"]
    assert test["nrmse_after"] < 0.5 * test["nrmse_before"]


def test_shares_match_decrease_of_residual(without_report):
    document = json.loads((without_report / "diagnosis.json").read_text())
    # The link encoders are within their noise: of what there is next to nothing shared out.
    assert {each["measured"] for each in document["mismatch"]} == {"torque"}
    shares = {each["part"]: each["share"] for each in document["mismatch"]}
    before, after = (_torque_squares(document, when) for when in ("before", "after"))
    # Joints count by the samples in which they move, which the file does not say.
    assert shares["open"] == pytest.approx(after / before, abs=5e-3)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["finding"] > 0.9


def _torque_squares(document, when):
    """Mean squares above noise of the held-out torques, joint by joint, added up."""
    torques = [e for e in document["fit"]["channels"] if e["channel"].startswith("torque_")]
    return sum((each[f"rms_{when}"] / each["noise"]) ** 2 - 1.0 for each in torques)


def test_extended_model_has_no_further_findings(without_report, tmp_path):
    model, out = without_report / "extended.toml", tmp_path / "again"
    arguments = ["diagnose", str(SHIPPED), "--model", str(model), "--out", str(out)]
    assert run([*arguments, "--no-report", "--quiet"]) == 0
    assert json.loads((out / "diagnosis.json").read_text())["verdict"] == "nothing_missing"
