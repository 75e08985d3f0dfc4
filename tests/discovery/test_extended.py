"""extended.toml as the model that a further diagnosis starts from."""

import numpy as np
import pytest
from diagnosed_folders import answered, command
from simulated_sets import COULOMB

from stiffopt.discovery.extended.model import load_extended

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def again():
    """A second diagnosis that starts from what the first found."""
    return command(
        answered(COULOMB).source, "--model", str(answered(COULOMB).out / "extended.toml")
    )


def test_finding_in_model_is_not_found_again(again):
    assert again.code == 0
    named = [(f["effect"], f["joint"]) for f in again.document["findings"]]
    assert named == []
    assert again.document["verdict"] == "nothing_missing"


def test_second_diagnosis_starts_from_first(again):
    first, second = answered(COULOMB), again
    for role in ("test", "extrapolate"):
        before = second.document["fit"][role]["nrmse_before"]
        assert before == pytest.approx(first.document["fit"][role]["nrmse_after"], rel=1e-6)
    for name, columns in second.predictions().items():
        if name.startswith("pred_before_"):
            ended = first.predictions()[name.replace("before", "after")]
            for column, values in columns.items():
                np.testing.assert_allclose(values, ended[column], rtol=1e-6, atol=1e-9)


def test_model_contains_finding_with_deviation():
    model = load_extended(answered(COULOMB).out / "extended.toml")
    found = answered(COULOMB).document["findings"][0]["parameters"]["dFc"]
    (effect,) = model.extension.effects
    assert (effect.located.effect.name, effect.located.joint) == ("coulomb", 1)
    assert model.parameters[0]["dFc"] == pytest.approx(found["value"])
    text = (answered(COULOMB).out / "extended.toml").read_text()
    assert "sd = " in text
    assert 'unit = "N m"' in text


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('name = "coulomb"', 'name = "coulom"', r"effect\[1\].name: no effect 'coulom'.*coulomb"),
        ("joint = 2", "joint = 5", r"effect\[1\].joint: is 5, there are 2"),
        ("dFc = { value = ", "dFc = { value = 9", "but effect.term gives"),
        ("[effect.term]\ndFc", "[effect.term]\ndF", "coulomb needs exactly dFc"),
        ('"joint1", "joint2"', '"joint2", "joint1"', "this model is of joint2, joint1"),
        ('kind = "extended"', 'kind = "robot"', "robot"),
    ],
)
def test_invalid_model_raises_error(tmp_path, capsys, before, after, message):
    import re

    text = (answered(COULOMB).out / "extended.toml").read_text()
    assert before in text
    model = tmp_path / "extended.toml"
    model.write_text(text.replace(before, after))
    result = command(answered(COULOMB).source, "--model", str(model))
    assert result.code == 2
    error = capsys.readouterr().err
    assert re.search(message, error), error
    assert str(model) in error
    assert not result.out.exists()


def test_missing_shape_has_usual_value(tmp_path):
    text = (answered(COULOMB).out / "extended.toml").read_text()
    file = tmp_path / "extended.toml"
    file.write_text(
        text
        + """
[[effect]]
name = "load_friction"
joint = 1
[effect.term]
mu = 0.05
[effect.parameters]
mu = { value = 0.05, sd = 0.01 }
"""
    )
    (*_, added) = load_extended(file).extension.effects
    assert added.amplitudes == (0.05,)
    assert added.located.shapes == (0.02,)
