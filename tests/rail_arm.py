"""A UR10 on a linear axis: seven joints."""

from small_arms import ROOT

RAIL = """<link name="cart"><inertial><mass value="50"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="world"/><child link="cart"/><axis xyz="0 1 0"/>
<limit lower="-0.5" upper="0.5" effort="2000" velocity="1"/></joint>"""
RAIL_JOINT = """[[joint]]
name = "rail"
torque_max = 2000.0
velocity_max = 1.0
acceleration_max = 5.0
"""


def write_ur10_on_rail(folder):
    """Write robot.urdf and robot.toml into a folder; the rail, 1 m along y, is the first joint."""
    data = ROOT / "stiffopt" / "robot" / "data" / "ur10"
    urdf, robot = ((data / name).read_text() for name in ("robot.urdf", "robot.toml"))
    urdf = urdf.replace('<parent link="world"/>', '<parent link="cart"/>', 1)
    urdf = urdf.replace('<link name="world"/>', f'<link name="world"/>{RAIL}', 1)
    (folder / "robot.urdf").write_text(urdf)
    (folder / "robot.toml").write_text(robot.replace("[[joint]]", f"{RAIL_JOINT}\n[[joint]]", 1))
