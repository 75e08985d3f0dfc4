"""Robot files: what they give, and what they say when something is wrong."""

import numpy as np
import pinocchio as pin
import pytest

from stiffopt.errors import InputError, InputFileError, RobotError
from stiffopt.robot.files import load_robot, shipped_robots

URDF = """<robot name="pair">
<link name="base"/>
<link name="upper"><inertial><mass value="2"/><origin xyz="0.2 0 0"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<link name="slide"><inertial><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<link name="tip"/>
<joint name="turn" type="{kind}"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="50" velocity="3"/>
<dynamics damping="0.4" friction="0.7"/></joint>
<joint name="push" type="prismatic"><parent link="upper"/><child link="slide"/>
<origin xyz="0.4 0 0"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.3" effort="200" velocity="0.5"/></joint>
<joint name="end" type="fixed"><parent link="slide"/><child link="tip"/>
<origin xyz="0 0 0.1"/></joint>
</robot>"""

HEAD = 'schema = 1\nkind = "robot"\nname = "pair"\nurdf = "pair.urdf"\n'

KEY = """
[[joint]]
name = "turn"
[[joint.element]]
name = "key"
type = "key"
ratio = 1.0
shaft_diameter = "30 mm"
width = "8 mm"
height = "7 mm"
length = "40 mm"
surface = "fine_steel"
"""

REDUCER = """
[[joint]]
name = "turn"
[[joint.element]]
name = "reducer"
type = "reducer"
K1 = "3 N*m/arcmin"
K2 = 2.0e4
K3 = 3.0e4
T1 = 7.0
T2 = 25.0
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "pair.urdf").write_text(URDF.format(kind="revolute"))
    return tmp_path


def write(folder, text, head=HEAD):
    path = folder / "pair.toml"
    path.write_text(head + text)
    return path


def fails(folder, text, head=HEAD):
    with pytest.raises(InputError) as error:
        load_robot(write(folder, text, head))
    return str(error.value)


def test_shipped_robots_load():
    assert shipped_robots() == ["er3a_c60", "er3a_c60_contact", "ur10"]
    for name in shipped_robots():
        robot = load_robot(name)
        assert robot.name == name
        assert robot.n == 6
        for limit in (robot.velocity_max, robot.acceleration_max, robot.jerk_max):
            assert limit.shape == (6,)
            assert np.isfinite(limit).all()
        assert all(chain is not None for chain in robot.chains)
        assert len(robot.estimated()) > 10
        kinds = {s.provenance for s in robot.sources}
        assert kinds <= {"catalogue", "paper", "estimated"}
        assert all(s.source for s in robot.sources)
        for inertia in list(robot.model.inertias)[1:]:
            moments = np.linalg.eigvalsh(inertia.inertia)
            assert moments[0] > 0
            assert moments[2] <= (moments[0] + moments[1]) * (1 + 1e-9)
        # No flange of a shipped robot slips at its largest torque.
        for chain, limit in zip(robot.chains, robot.torque_max, strict=True):
            assert min(chain.slip_torques().values()) > 1.2 * limit


def test_omitted_limits_are_those_of_the_urdf(folder):
    robot = load_robot(write(folder, '[[joint]]\nname = "push"\nvelocity_max = "200 mm/s"\n'))
    assert robot.joint_names == ("turn", "push")
    np.testing.assert_allclose(robot.torque_max, [50, 200])
    np.testing.assert_allclose(robot.velocity_max, [3, 0.2])
    np.testing.assert_allclose(robot.position_lower, [-1, 0])
    np.testing.assert_allclose(robot.viscous, [0.4, 0])
    np.testing.assert_allclose(robot.coulomb, [0.7, 0])
    assert np.isinf(robot.acceleration_max).all()
    assert robot.chains == (None, None)
    assert robot.prismatic.tolist() == [False, True]
    assert robot.tool.joint == 2


def test_urdf_with_and_without_drivetrain(folder):
    robot = load_robot(folder / "pair.urdf")
    assert robot.chains == (None, None)
    drivetrain = write(folder, REDUCER, 'schema = 1\nkind = "robot"\nname = "geared"\n')
    robot = load_robot(folder / "pair.urdf", drivetrain)
    assert robot.name == "geared"
    element = robot.chains[0].elements["reducer"]
    assert pytest.approx(3 * 60 * 180 / np.pi) == element.K1


def test_continuous_joints_have_no_position_limits(folder):
    (folder / "pair.urdf").write_text(URDF.format(kind="continuous"))
    robot = load_robot(folder / "pair.urdf")
    assert robot.model.nq == robot.model.nv == 2
    assert robot.position_upper[0] == np.inf
    assert robot.position_lower[0] == -np.inf
    assert robot.torque_max[0] == 50


def test_every_kind_of_element_is_built(folder):
    text = """
[assembly]
reflect = false
contact_law = "power_law"
[surface.honed]
first = "steel"
second = { modulus = "110 GPa", poisson = 0.3, hardness = "1.5 GPa" }
fractal_dimension = 2.4
fractal_roughness = 2e-9
[[joint]]
name = "turn"
[[joint.element]]
name = "gears"
type = "gear_pair"
ratio = 30
module = "1 mm"
teeth = 20
teeth_driven = 40
face_width = "8 mm"
surface = "honed"
[[joint.element]]
name = "belt"
type = "timing_belt"
ratio = 60
profile = "HTD3M"
teeth = 20
teeth_driven = 40
width = "10 mm"
span_length = "90 mm"
preload = "80 N"
[[joint.element]]
name = "pins"
type = "clamping_pins"
ratio = 30
count = 2
shaft_diameter = "8 mm"
tip_diameter = "2 mm"
preload = "1.5 kN"
surface = "honed"
[[joint.element]]
name = "shaft"
type = "shaft"
ratio = 50
diameter = "8 mm"
length = "60 mm"
[[joint.element]]
name = "reducer"
type = "reducer"
catalogue = "harmonic_20_50"
K3 = 2.0e4
[[joint.element]]
name = "flange"
type = "bolted_flange"
pattern = "flexspline_20"
preload = "4 kN"
surface = "fine_steel"
parallel = "output"
[[joint.element]]
name = "key"
type = "key"
shaft_diameter = "16 mm"
width = "5 mm"
height = "5 mm"
length = "20 mm"
surface = "honed"
parallel = "output"
[[joint]]
name = "push"
[[joint.element]]
name = "screw"
type = "constant"
stiffness = "20 N/um"
"""
    robot = load_robot(write(folder, text))
    chain = robot.chains[0]
    kinds = [e.kind for e in chain.elements.values()]
    assert kinds == [
        "gear_pair", "timing_belt", "clamping_pins", "shaft", "reducer", "bolted_flange", "key",
    ]  # fmt: skip
    assert not chain.reflect
    assert chain.elements["gears"].pitch_radius == pytest.approx(10e-3)
    assert chain.elements["gears"].torque_max == pytest.approx(50 / 30)
    assert chain.elements["belt"].teeth_driven == 40
    assert chain.elements["reducer"].K3 == 2.0e4
    assert chain.elements["reducer"].K1 == 1.3e4
    assert chain.elements["flange"].preload == 4000.0
    assert chain.elements["flange"].bolt_count == 9
    assert chain.elements["key"].shaft_flank_height == 2.5e-3
    assert [s.group for s in chain.stages][-2:] == ["output", "output"]
    assert np.isfinite(chain.windup(20.0))
    assert robot.chains[1].windup(100.0) == pytest.approx(5e-6)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (KEY.replace("shaft_diameter", "shaft_diamter"), ["joint[turn].element[key]",
            "unknown key 'shaft_diamter'. Did you mean 'shaft_diameter'"]),
        (KEY.replace('"key"\nratio', '"kee"\nratio'), ["unknown type 'kee'. Did you mean 'key'"]),
        (KEY.replace('"30 mm"', '"30 deg"'), ["element[key].shaft_diameter", "not one of length",
            "'0.3 mm'"]),
        (KEY.replace('"30 mm"', "nan"), ["element[key].shaft_diameter", "finite"]),
        (KEY.replace('"30 mm"', "-0.03"), ["element[key]", "shaft_diameter = -0.03"]),
        (KEY.replace("fine_steel", "fine_stel"), ["no surface 'fine_stel'", "'fine_steel'"]),
        (KEY.replace("ratio = 1.0", "ratio = 0"), ["element[key].ratio",
            "ratio = 0 cannot be used; allowed is a finite number above 0"]),
        (KEY.replace('"turn"', '"trun"'), ["no moving joint 'trun'", "Did you mean 'turn'"]),
        (KEY + KEY, ["joint[turn]", "given twice"]),
        (REDUCER.replace("T2 = 25.0", "T2 = 5.0"), ["joint[turn].element[reducer]",
            "T1 = 7 must be smaller than T2 = 5"]),
        (REDUCER.replace("K2 = 2.0e4", "K2 = -2.0e4"), ["element[reducer].K2",
            "K2 = -20000 cannot be used; allowed is a finite number above 0"]),
        (REDUCER.replace("K2 = 2.0e4\n", ""), ["K2 missing", "`catalogue`"]),
        (REDUCER.replace('"3 N*m/arcmin"', '"3 N*m"'), ["element[reducer].K1",
            "not one of stiffness"]),
        ('[[joint]]\nname = "turn"\nrotor_inertia = -1\n', ["joint[turn].rotor_inertia",
            "rotor_inertia = -1 cannot be used; allowed is a finite number, 0 or above"]),
        ('[[joint]]\nname = "turn"\nvelocity_max = 0\n', ["joint[turn].velocity_max", "above 0"]),
        ('[[joint]]\nname = "turn"\nvelocity_max = "1 m/s"\n', ["velocity_max",
            "revolute and needs angular velocity, got speed"]),
        ('[[joint]]\nname = "turn"\nposition_lower = "3 rad"\n', ["position_lower = 3 must be"]),
        ('tool = { link = "tipp" }\n', ["tool", "no link 'tipp'", "Did you mean 'tip'"]),
        ('tool = { link = "base" }\n', ["tool", "does not move"]),
        ('[[joint]]\nname = "turn"\n[[joint.element]]\nname = "c"\ntype = "constant"\n'
         "stiffness = -1.0\n", ["joint[turn].element[c].stiffness", "stiffness = -1"]),
        ('[surface.odd]\nfirst = "steel"\nsecond = "steel"\nfractal_dimension = 3.2\n'
         "fractal_roughness = 1e-9\n", ["surface.odd", "fractal_dimension = 3.2",
                                        "validity range 2 to 3"]),
        ('[surface.odd]\nfirst = "stel"\nsecond = "steel"\nfractal_dimension = 2.4\n'
         "fractal_roughness = 1e-9\n", ["surface.odd", "no material 'stel'"]),
        ("a = ", ["line 5", "not valid TOML"]),
    ],
)  # fmt: skip
def test_faulty_robot_files_are_refused(folder, text, parts):
    message = fails(folder, text)
    assert "pair.toml" in message
    for part in parts:
        assert part in message


def test_missing_robot_files_are_refused(folder):
    with pytest.raises(InputFileError, match=r"no such file\. That folder holds: .*pair\.urdf"):
        load_robot(write(folder, "", HEAD.replace("pair.urdf", "piar.urdf")))
    with pytest.raises(InputError, match="Did you mean 'er3a_c60'"):
        load_robot("er3a_c06")
    with pytest.raises(InputFileError, match="no such file"):
        load_robot(folder / "nothing.toml")
    assert 'needs kind = "robot"' in fails(folder, "", HEAD.replace('"robot"', '"sweep"'))
    assert "urdf" in fails(folder, "", 'schema = 1\nkind = "robot"\nname = "pair"\n')
    (folder / "pair.urdf").write_text("<robot")
    with pytest.raises(InputFileError, match="is not a URDF"):
        load_robot(folder / "pair.urdf")
    (folder / "pair.urdf").write_text("<svg/>")
    with pytest.raises(InputFileError, match="the root is <svg>"):
        load_robot(folder / "pair.urdf")


@pytest.mark.parametrize("kind", ["floating", "planar", "spherical"])
def test_unsupported_joint_kinds_are_refused(folder, kind):
    (folder / "pair.urdf").write_text(URDF.format(kind=kind))
    with pytest.raises(RobotError) as error:
        load_robot(folder / "pair.urdf")
    assert f"joint 'turn' is of the kind '{kind}'; allowed are revolute" in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "<dynamics",
            '<mimic joint="push"/><dynamics',
            "joint 'turn' follows 'push' (mimic), which moves",
        ),
        ('mass value="2"', 'mass value="nan"', "link 'upper', mass: got 'nan'"),
        ('mass value="2"', 'mass value="-2"', "the mass -2 is below 0"),
        ('izz="0.01"', 'izz="-0.01"', "izz = -0.01 is below 0"),
        ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', "has the axis 0 0 0"),
        ('axis xyz="0 1 0"', 'axis xyz="0 1"', "joint 'turn', axis: got '0 1'"),
        ('lower="-1" upper="2"', 'lower="2" upper="-1"', "needs limits with lower below upper"),
        ('effort="50"', 'effort="0"', "has no effort for it"),
    ],
)
def test_faulty_urdfs_are_refused(folder, old, new, text):
    (folder / "pair.urdf").write_text(URDF.format(kind="revolute").replace(old, new, 1))
    with pytest.raises(InputError) as error:
        load_robot(folder / "pair.urdf")
    assert text in str(error.value)


def test_gravity_of_the_er3a_is_as_published():
    # Stretched and horizontal, 3 kg at 100 mm beyond the flange: 44.7, 19.7, 5.3 N m.
    robot = load_robot("er3a_c60").with_payload(3.0, [0, 0, 0.1])
    q = np.array([0, -np.pi / 2, np.pi / 2, 0, 0, 0])
    torque = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), q)
    np.testing.assert_allclose(torque[[1, 2, 4]], [44.7, 19.7, 5.3], rtol=0, atol=0.05)


def test_geometry_of_the_er3a():
    robot = load_robot("er3a_c60")
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, np.zeros(6))
    tool = data.oMi[robot.tool.joint].act(np.asarray(robot.tool.offset))
    np.testing.assert_allclose(tool, [0.05 + 0.299 + 0.0785, 0, 0.3215 + 0.27 + 0.07], atol=1e-12)
    # Modified Denavit-Hartenberg chain, independently.
    table = [(0, 0, 0.3215, 0), (90, 0.05, 0, 90), (0, 0.27, 0, 0), (90, 0.07, 0.299, 0),
             (-90, 0, 0, 0), (90, 0, 0, 0)]  # fmt: skip
    q = np.array([0.3, -0.4, 0.5, 0.6, -0.7, 0.8])
    pose = np.eye(4)
    for (alpha, a, d, offset), angle in zip(table, q, strict=True):
        ca, sa = np.cos(np.radians(alpha)), np.sin(np.radians(alpha))
        c, s = np.cos(angle + np.radians(offset)), np.sin(angle + np.radians(offset))
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, d], [0, 0, 0, 1]])
        tilt = np.array([[1, 0, 0, a], [0, ca, -sa, 0], [0, sa, ca, 0], [0, 0, 0, 1]])
        pose = pose @ tilt @ turn
    pin.forwardKinematics(model, data, q)
    np.testing.assert_allclose(data.oMi[6].homogeneous, pose, atol=1e-12)
