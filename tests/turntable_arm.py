"""A UR10 beside a turntable that carries the work: six joints of the arm and one of the table."""

from small_arms import ROOT

TABLE = """<link name="table"><inertial><mass value="30"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1.5"/></inertial></link>
<joint name="turn" type="revolute"><parent link="world"/><child link="table"/>
<origin xyz="0.9 0.1 0.1" rpy="0 0.2 0"/><axis xyz="0 0 1"/>
<limit lower="-3.2" upper="3.2" effort="300" velocity="2"/></joint>"""
TABLE_JOINT = """[[joint]]
name = "turn"
torque_max = 300.0
velocity_max = 2.0
acceleration_max = 8.0
jerk_max = 100.0
"""


def write_ur10_with_turntable(folder, named=True):
    """Write robot.urdf and robot.toml; the table's link is `table`, named in the TOML or held."""
    data = ROOT / "stiffopt" / "robot" / "data" / "ur10"
    urdf, robot = ((data / name).read_text() for name in ("robot.urdf", "robot.toml"))
    urdf = urdf.replace('<link name="world"/>', f'<link name="world"/>{TABLE}', 1)
    (folder / "robot.urdf").write_text(urdf)
    robot = robot.replace("[[joint]]", f"{TABLE_JOINT}\n[[joint]]", 1) if named else robot
    (folder / "robot.toml").write_text(robot)
