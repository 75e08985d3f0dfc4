"""Effects from a user's file: found, checked, refused with the reason."""

from dataclasses import replace

import numpy as np
import pytest

from stiffopt.discovery.effect import Term
from stiffopt.discovery.identifiable import required_signals
from stiffopt.discovery.user_effects import load_effects, sample_signals
from stiffopt.errors import InputFileError

HEAD = """
from __future__ import annotations

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
"""

GOOD = (
    HEAD
    + '''
def seal_drag_term(signals, amplitudes, shapes):
    """Drag that fades with speed."""
    w = signals.motor_velocity
    return Term(drive_torque=amplitudes[0] * np.tanh(w / shapes[0]))


def seal_drag() -> Effect:
    """Drag of a shaft seal."""
    return Effect(
        name="seal_drag", family="friction", scope="joint", equation="tau += D*tanh(w/v0)",
        signature="torque against the motion that sets in slowly", term=seal_drag_term,
        amplitudes=(Amplitude(name="D", unit="N m", scale=2.0, lower=0.0, upper=5.0),),
        shapes=(Shape(name="v0", unit="rad/s", starts=(0.05, 0.2), lower=0.01, upper=1.0),),
    )


WIND = Effect(
    name="wind", family="contact", scope="robot", equation="s += p*J_x",
    signature="a steady push along x",
    term=lambda signals, a, s: Term(link_torque=a[0] * signals.tool_jacobian[:, 0, :]),
    amplitudes=(Amplitude(name="p", unit="N", scale=5.0, lower=-10.0, upper=10.0),),
)
'''
)


def written(tmp_path, text):
    path = tmp_path / "mine.py"
    path.write_text(text, encoding="utf-8")
    return path


def test_effect_defaults_follow_from_name_and_term(tmp_path):
    drag, wind = load_effects(written(tmp_path, GOOD))
    assert (drag.title, drag.phrase_of([1.0])) == ("seal drag", "seal drag")
    assert required_signals(drag) == required_signals(wind) == ("torque", "moves")
    late = replace(drag, scope="run", term=lambda signals, a, v: Term(deflection=a[0] + v[0]))
    assert required_signals(late) == ("link", "moves", "runs")


def test_unknown_needs_are_refused(tmp_path):
    text = GOOD.replace('scope="joint"', 'scope="joint", needs=("torqe",)')
    with pytest.raises(InputFileError, match=r"seal_drag.*needs 'torqe'; known are torque, link"):
        load_effects(written(tmp_path, text))


def test_functions_and_objects_become_effects(tmp_path):
    found = load_effects(written(tmp_path, GOOD))
    assert [e.name for e in found] == ["seal_drag", "wind"]
    signals = sample_signals().of_joint(4)
    value = found[0].term(signals, [2.0], [0.2]).drive_torque
    np.testing.assert_allclose(value, 2.0 * np.tanh(signals.motor_velocity / 0.2))


def test_imported_effects_are_ignored(tmp_path):
    text = GOOD + "\nfrom stiffopt.discovery.catalogue.friction import COULOMB\nALL = [WIND]\n"
    assert [e.name for e in load_effects(written(tmp_path, text))] == ["seal_drag", "wind"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\n", "no effect is defined here"),
        ("def f(:\n", "SyntaxError"),
        ("import numpy\nnumpy.nothing\n", "line 2.*AttributeError"),
        (HEAD + "def mine() -> Effect:\n    return 3\n", "mine: it returns a int, no Effect"),
        (HEAD + "def mine() -> Effect:\n    return 1 / 0\n", "ZeroDivisionError"),
        (HEAD + "def mine(x) -> Effect:\n    return x\n", "takes no arguments"),
        (GOOD.replace('name="wind"', 'name="seal_drag"'), "'seal_drag' is taken by seal_drag"),
        (GOOD.replace('name="wind"', 'name="payload"'), "'payload' is taken by the catalogue"),
        (GOOD.replace("amplitudes[0] *", "amplitudes[0] ** 2 *"), "not linear in its amplitudes"),
        (GOOD.replace("amplitudes[0] *", "1.0 + amplitudes[0] *"), "does not vanish"),
        (GOOD.replace("np.tanh(w", "np.log(w"), "not finite"),
        (GOOD.replace("starts=(0.05, 0.2)", "starts=(0.05, 2.0)"), "all between 0.01 and 1"),
        (GOOD.replace("starts=(0.05, 0.2)", "starts=tuple(0.02 + 0.01 * i for i in range(31))"),
         "31 combinations of initial values; at most 30"),
        (GOOD.replace("scale=2.0", "scale=0.0"), "must be above zero"),
        (GOOD.replace("lower=-10.0", "lower=10.0"), "lower bound above"),
        (GOOD.replace("np.tanh(w", "float(w"), "its term fails with TypeError"),
        (GOOD.replace("return Term(drive_torque=", "return ("), "returns no Term"),
        (GOOD.replace('scope="robot"', 'scope="arm"'), "scope 'arm' is none of joint"),
        (GOOD.replace('name="v0"', 'name="D"'), "share a name"),
    ],
)  # fmt: skip
def test_invalid_file_gives_reason(tmp_path, text, message):
    with pytest.raises(InputFileError, match=message):
        load_effects(written(tmp_path, text))


def test_an_absent_file_is_named(tmp_path):
    with pytest.raises(InputFileError, match=r"nowhere\.py: no such file"):
        load_effects(tmp_path / "nowhere.py")
