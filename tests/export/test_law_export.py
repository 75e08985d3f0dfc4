"""Laws beyond the catalogue in an exported MJCF: values that joints have there, and the rest."""

import xml.etree.ElementTree as ET

import pytest
from diagnosed_two_link import TWO_LINK

from stiffopt.cli import run
from stiffopt.closed_loop.parameters import BODY_PARAMETERS, JOINT_PARAMETERS

MODEL = """schema = 1
kind = "extended"
name = "cell"
joints = ["joint1", "joint2"]
links = ["link1", "link2"]
[scales]
torque_rated = [40.0, 40.0]
torque_max = [120.0, 120.0]
fastest = [2.0, 2.0]
"""
LAW = """[[effect]]
name = "{name}"
joint = 2
law = {{ place = "drive_torque", factors = [{factors}] }}
term = {{ A = {value} }}
"""


@pytest.fixture
def exported(tmp_path, capsys):
    def export(*laws, more=""):
        source = tmp_path / "diagnosis"
        source.mkdir(exist_ok=True)
        parts = [LAW.format(name=n, factors=f, value=v) for n, f, v in laws]
        (source / "extended.toml").write_text(MODEL + more + "".join(parts))
        arguments = ["--recordings", str(TWO_LINK), "--out", str(tmp_path), "--to", "mjcf"]
        assert run(["export", str(source), *arguments]) == 0
        root = ET.parse(tmp_path / "found.xml").getroot()
        joint = next(each for each in root.iter("joint") if each.get("name") == "joint2")
        values = {key: float(joint.get(key)) for key in ("damping", "frictionloss", "armature")}
        return values, capsys.readouterr().out

    return export


def test_laws_that_a_joint_has_a_value_for_are_carried(exported):
    plain, _ = exported()
    kinds = {"speed": 0.5, "direction": 0.3, "acceleration": 0.02}
    laws = [(k, f'{{ signal = "{k}", joint = 2, form = "linear" }}', v) for k, v in kinds.items()]
    found, told = exported(*laws)
    assert found["damping"] - plain["damping"] == pytest.approx(0.5)
    assert found["frictionloss"] - plain["frictionloss"] == pytest.approx(0.3)
    assert found["armature"] - plain["armature"] == pytest.approx(0.02)
    assert "finding without a value" not in told


def test_a_law_beside_a_fitted_simulation_is_named(exported):
    """The simulation's parameters replace the robot's values, and not what no robot file holds."""
    none = {name: [0.0, 0.0] for name in (*JOINT_PARAMETERS, *BODY_PARAMETERS)}
    loop = {
        **{"stiffness": [20.0, 10.0], "damping": [1.5, 0.5], "delay": 0.004},
        **{"drive_max": [90.0, 90.0], "torque_max": [90.0, 90.0]},
        **{"tolerance": [0.1, 0.1], "middle": [0.0, 0.0]},
    }
    text = "[closed_loop]\n" + "\n".join(f"{key} = {value}" for key, value in loop.items())
    for part in ("values", "deviations"):
        text += f"\n[closed_loop.{part}]\n"
        text += "\n".join(f"{name} = {value}" for name, value in none.items())
    other = '{ signal = "position", joint = 1, form = "linear" }'
    _, told = exported(("hose", other, 1.0), more=text + "\n")
    assert "finding without a value in this model: hose of joint 2" in told


def test_other_laws_are_named(exported):
    product = ", ".join(
        f'{{ signal = "{kind}", joint = {joint}, form = "linear" }}'
        for kind, joint in (("speed", 2), ("position", 1))
    )
    timed = '{ signal = "session_time", form = "linear" }'
    _, told = exported(("drag", product, 1.0), ("warm", timed, 1.0))
    assert "finding without a value in this model: drag of joint 2" in told
    assert "warm of joint 2 (a law of the time since power-on" in told
