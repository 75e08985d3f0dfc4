"""Masses, inertias and limits of URDFs as they are found: none, placeholders, other units."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_urdfs import chain, changed, limits, written

import stiffopt.robot
from stiffopt.cli import run
from stiffopt.errors import InputError, ProblemError, RobotError
from stiffopt.problem.files import load_problem
from stiffopt.problem.resolve import resolve
from stiffopt.robot.estimated_masses import estimate_bodies, fit_to_torque_limits
from stiffopt.robot.files import load_robot
from stiffopt.robot.frames import link_frame
from stiffopt.robot.urdf import load_urdf
from stiffopt.starter.placeholders import credible_torques, inertia_fault


def test_an_arm_without_masses(tmp_path, capsys):
    """As most URDFs of ROS-Industrial are: said, and guessed by `init robot` from the shapes."""
    bar = (
        '<collision><origin xyz="0 0 0.15"/><geometry><box size="0.1 0.2 0.3"/></geometry>'
        "</collision>"
    )
    silent = '<limit lower="-2" upper="2" effort="0" velocity="2"/>'
    urdf = written(tmp_path, chain(6, mass=bar, inside=silent).replace(bar, "", 1))
    assert run(["init", "robot", str(urdf)]) == 0
    said = capsys.readouterr().out
    assert "gives no usable mass to link2, link3" in said
    assert "gives no usable mass to link1;" in said
    assert "since the URDF has no shapes" in said
    assert "no effort for 1, 2, 3, 4, 5, 6" in said
    path = tmp_path / "arm_robot.toml"
    links = {link["name"]: link for link in tomllib.loads(path.read_text())["link"]}
    # 0.1 m x 0.2 m x 0.3 m at 1000 kg/m^3; link1 has no shape and is a rod.
    assert links["link2"]["mass"] == pytest.approx(6.0)
    assert links["link2"]["com"] == pytest.approx([0.0, 0.0, 0.15])
    own = 6.0 / 12.0 * np.array([0.2**2 + 0.3**2, 0.1**2 + 0.3**2, 0.1**2 + 0.2**2])
    assert links["link2"]["inertia"] == pytest.approx(own, rel=1e-2)
    assert 0.1 < links["link1"]["mass"] < 30.0
    arm = load_robot(path)
    assert any("link link2" in str(row) for row in arm.estimated())
    assert run(["init", "problem", str(path), "--out", str(tmp_path / "first.toml")]) == 0
    motion = resolve(load_problem(tmp_path / "first.toml").problem)
    bodies = arm.rigid_bodies()
    for pose in motion.points:
        assert np.all(np.abs(bodies.gravity_torque(pose)) < arm.torque_max)


@pytest.mark.parametrize(("com", "guessed"), [("0 0 0", [1, 2, 3, 4]), ("0.1 0 0", [])])
def test_equal_point_masses_are_placeholders(com, guessed, tmp_path):
    """One mass at every joint's origin is no link; equal modules have theirs elsewhere."""
    mass = (
        f'<inertial><origin xyz="{com}"/><mass value="2"/><inertia ixx="0.01" ixy="0" ixz="0"'
        ' iyy="0.01" iyz="0" izz="0.01"/></inertial>'
    )
    assert load_urdf(written(tmp_path, chain(4, mass=mass))).joints_without_masses == guessed


@pytest.mark.parametrize(
    ("payload", "left"),
    [("", "are zero"), ("[payload]\nmass = 5.0\n", "are those of the payload alone")],
)
def test_without_any_mass_there_is_nothing_to_plan(payload, left, tmp_path):
    urdf = written(tmp_path, chain(3, mass=""))
    text = (
        'schema = 1\nkind = "trajectory"\nrobot = "arm.urdf"\n[motion]\nduration = "2 s"\n'
        "start = { joints = [0.0, 0.0, 0.0] }\nend = { joints = [0.1, 0.1, 0.1] }\n"
        '[[minimise]]\nobjective = "torque_squared"\n'
    )
    (tmp_path / "problem.toml").write_text(text + payload)
    with pytest.raises(ProblemError, match=rf"no link of arm has a mass.*{left}.*\[\[link\]\]"):
        resolve(load_problem(tmp_path / "problem.toml").problem)
    assert urdf.exists()


@pytest.mark.parametrize("limit", ["", '<limit lower="0" upper="0" effort="0" velocity="0"/>'])
def test_limits_that_the_urdf_does_not_state(limit, tmp_path, capsys):
    """Zeros as exporters of CAD programs leave them."""
    urdf = written(tmp_path, chain(3, inside=limit))
    with pytest.raises(RobotError, match="'1' has no limits"):
        load_robot(urdf)
    assert run(["init", "robot", str(urdf)]) == 0
    assert "GUESSED: limits of position of 1, 2, 3" in capsys.readouterr().out
    arm = load_robot(tmp_path / "arm_robot.toml")
    assert arm.position_upper == pytest.approx(np.radians(170.0))
    # What holds the weight and full acceleration, of joint 2 with three links behind it.
    assert arm.torque_max[1] > 3 * 3.0 * 9.81 * 0.3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[link]]\nname = "lnk1"\nmass = 1.0\n', "no link 'lnk1'. Did you mean 'link1'?"),
        ('[[link]]\nname = "link1"\nmass = 1.0\n' * 2, "link[link1]: is given twice"),
        ('[[link]]\nname = "link1"\nmass = -1.0\n', "mass"),
        (
            '[[link]]\nname = "link1"\nmass = 1.0\ninertia = [1.0, 0.1, 0.1]\n',
            "belongs to no body",
        ),
    ],
)
def test_impossible_masses_are_refused(text, said, tmp_path):
    written(tmp_path, chain(3))
    head = 'schema = 1\nkind = "robot"\nname = "arm"\nurdf = "arm.urdf"\n'
    (tmp_path / "robot.toml").write_text(head + text)
    with pytest.raises(InputError, match=re.escape(said)):
        load_robot(tmp_path / "robot.toml")


def test_limits_in_degrees_are_questioned(tmp_path, capsys):
    urdf = written(tmp_path, chain(3).replace('lower="-2" upper="2"', 'lower="-130" upper="130"'))
    assert run(["init", "robot", str(urdf)]) == 0
    assert "QUESTION: limits of 1, 2, 3" in capsys.readouterr().out


def test_a_limit_without_effort_is_silent_about_it(tmp_path, capfd):
    urdf = written(tmp_path, chain(3).replace(' effort="80"', ""))
    with pytest.raises(InputError, match="URDF has no effort"):
        load_robot(urdf)
    assert run(["init", "robot", str(urdf)]) == 0
    found = capfd.readouterr()
    assert "no effort for 1, 2, 3" in found.out
    # Nothing of the library below.
    assert found.err == ""


@pytest.mark.parametrize(
    ("effort", "velocity", "said"),
    [
        (
            "1e6",
            "2",
            r"the effort of 6 joints is a placeholder: 1, 2, 3, 4, 5, 6: the URDF says 1e\+06 N m",
        ),
        ("80", "100", r"the velocity of 6 joints is a placeholder: 1: the URDF says 100 rad/s"),
        ("1e6", "100", r"the effort of 6 joints is a placeholder"),
    ],
)
def test_placeholders_are_questioned_by_name_and_guessed(effort, velocity, said, tmp_path, capsys):
    urdf = written(tmp_path, chain(6, inside=limits(effort, velocity)))
    assert run(["init", "robot", str(urdf)]) == 0
    assert re.search(f"QUESTION: {said}", capsys.readouterr().out)
    text = (tmp_path / "arm_robot.toml").read_text()
    assert "GUESSED: the URDF says" in text
    arm = load_robot(tmp_path / "arm_robot.toml")
    assert np.all(arm.torque_max < 1000.0)
    assert np.all(arm.velocity_max <= 2.0)
    assert all('provenance = "estimated"' in part for part in text.split("[[joint]]")[1:])


@pytest.mark.parametrize(
    ("effort", "velocity", "said"),
    [
        # The first joint alone would move the tool too fast; the wrist has the same number.
        (
            "150",
            "24",
            r"the velocity of 6 joints .* 5, 6: the URDF says 24 rad/s, a placeholder as for 1",
        ),
        # Only the first joints cannot hold the weight.
        (
            "30",
            "2",
            r"the effort of 6 joints .* a placeholder as for 2; 2: .* weight alone takes",
        ),
    ],
)
def test_one_number_for_all_joints_is_a_placeholder_of_all(
    effort, velocity, said, tmp_path, capsys
):
    urdf = written(tmp_path, chain(6, inside=limits(effort, velocity)))
    assert run(["init", "robot", str(urdf)]) == 0
    assert re.search(f"QUESTION: {said}", capsys.readouterr().out)
    arm = load_robot(tmp_path / "arm_robot.toml")
    stated = arm.velocity_max if velocity == "24" else arm.torque_max
    assert not np.any(np.isin(stated, [24.0, 30.0]))


def test_force_that_does_not_bear_the_weight_is_told_in_its_unit(tmp_path, capsys):
    text = chain(6, inside=limits("30", "2"))
    urdf = written(tmp_path, text.replace('type="revolute"', 'type="prismatic"', 1))
    assert run(["init", "robot", str(urdf)]) == 0
    assert re.search(r"1: [^;]* weight alone takes \d+ N[;.]", capsys.readouterr().out)


def test_doubtful_limits_are_kept_and_questioned(tmp_path, capsys):
    """One torque for all joints, and one that does not bear the weight of three links of 3 kg."""
    urdf = written(tmp_path, chain(6, inside=limits("150", "2")))
    assert run(["init", "robot", str(urdf)]) == 0
    assert "torque 150 N m" in capsys.readouterr().out
    parts = chain(3).split('effort="80"')
    weak = parts[0] + 'effort="80"' + parts[1] + 'effort="4"' + parts[2] + 'effort="60"' + parts[3]
    urdf = written(tmp_path, weak)
    (tmp_path / "arm_robot.toml").unlink()
    assert run(["init", "robot", str(urdf)]) == 0
    assert "the torque of 2 (4 N m, the weight takes" in capsys.readouterr().out
    assert load_robot(tmp_path / "arm_robot.toml").torque_max[1] == 4.0


def test_plausible_limits_are_not_questioned(tmp_path, capsys):
    ur10 = Path(stiffopt.robot.__file__).parent / "data" / "ur10" / "robot.urdf"
    assert run(["init", "robot", str(ur10), "--out", str(tmp_path / "r.toml")]) == 0
    out = capsys.readouterr().out
    assert "QUESTION" not in out
    assert "GUESSED" not in out


def test_mass_without_information_is_not_guessed(tmp_path, capfd):
    """A test bench of one joint at the origin, without mass, shape or length."""
    bench = """<link name="out"/><joint name="j1" type="revolute"><parent link="base"/>
<child link="out"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="50" velocity="3"/></joint>"""
    assert run(["init", "robot", str(written(tmp_path, bench))]) == 2
    said = " ".join(capfd.readouterr().err.split())
    assert "mass of link 'out'" in said
    assert "[[link]] with its mass" in said
    assert "Error" not in said
    assert not (tmp_path / "arm_robot.toml").exists()


def test_guessed_masses_are_scaled_to_torque_limits(tmp_path):
    """The same arm without masses, with weak, usual and strong drives."""
    arm = load_urdf(written(tmp_path, chain(3, mass="")), limited=None)
    rods = estimate_bodies(arm, tmp_path / "arm.urdf", link_frame(arm.model, "link3"))
    assert not any(body.shaped for body in rods.values())
    shapes = {name: replace(body, shaped=True) for name, body in rods.items()}
    weight = np.array([0.0, 60.0, 20.0])

    def scale(bodies, torque):
        found = fit_to_torque_limits(bodies, weight, np.array([5.0, torque, np.nan]))
        for name, body in found.items():
            assert body.inertia == pytest.approx(body.mass / rods[name].mass * rods[name].inertia)
        return sum(body.mass for body in found.values()) / sum(b.mass for b in rods.values())

    # Half way to twice the weight, a factor of two at most.
    assert scale(rods, 240.0) == pytest.approx(np.sqrt(2.0))
    assert scale(rods, 2400.0) == pytest.approx(2.0)
    # The drives hold it in the end.
    assert scale(rods, 15.0) == pytest.approx(15.0 / 60.0 / 1.2)
    # Shapes only where the drives could not hold them: as the safety envelopes of the Panda.
    assert scale(shapes, 240.0) == 1.0
    assert scale(shapes, 30.0) == pytest.approx(0.25)
    # One torque for all joints tells nothing.
    assert np.all(np.isnan(credible_torques(load_urdf(written(tmp_path, chain(6)), limited=None))))


def test_inertias_in_square_millimetres_are_questioned(tmp_path):
    with pytest.raises(InputError, match=r"30000 kg m\^2 lie 100 m from .*g mm\^2"):
        load_robot(changed(tmp_path, [('ixx="0.03"', 'ixx="30000"')]))


@pytest.mark.parametrize(
    ("moments", "why"),
    [
        ((0.0, 0.06, 0.06), ""),
        ((0.03, 0.05, 0.01), "larger than the other two together"),
        ((-0.005, 0.06, 0.06), "below 0"),
    ],
)
def test_impossible_inertias_are_detected(moments, why):
    """A thin rod is one, however it is turned."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        found = np.linalg.eigvalsh(turned @ np.diag(moments) @ turned.T)
        assert inertia_fault(found) == why


def test_impossible_inertia_is_questioned(tmp_path, capsys):
    assert run(["init", "robot", str(written(tmp_path, chain(3)))]) == 0
    assert "principal moment is" not in capsys.readouterr().out
    (tmp_path / "arm_robot.toml").unlink()
    assert run(["init", "robot", str(changed(tmp_path, [('ixx="0.03"', 'ixx="3.0"')]))]) == 0
    assert "the inertia of the links moved by 1 is impossible" in capsys.readouterr().out
