"""Study files of one joint with one bolted ring: read, solved and written in a second."""

from pathlib import Path

from small_arms import joint, reducer, write_robot

__all__ = ["FLANGE", "study_text", "write_flanged", "write_study"]

FLANGE = """[[joint.element]]
name = "{name}"
type = "bolted_flange"
ratio = 1.0
inner_radius = "12 mm"
outer_radius = "18 mm"
bolt = {{ size = "M5", grade = "12.9", count = 9, circle_diameter = "30 mm" }}
preload = "7.5 kN"
bearing = "beside"
surface = "fine_steel"
friction = 0.15
"""


def write_flanged(folder, robot="pendulum", flange=FLANGE, head=""):
    """Write the pendulum, or the planar arm with a bare second joint, with a ring in joint 1."""
    joints = [joint("shoulder", reducer() + flange.format(name="ring"))]
    if robot == "planar":
        joints.append(joint("elbow", reducer(k1=4e3, k2=6e3, k3=8e3)))
    return write_robot(folder, robot, joints, extra=f'{head}\ntool = {{ link = "tip" }}')


def study_text(
    load="torque = [60.0]",
    *,
    robot="pendulum.toml",
    top="",
    minimise='objective = "total_preload"',
    require="",
    more="",
    name="peak",
):
    """Text of a study of joint 1; the pieces are TOML."""
    return f"""schema = 1
kind = "preload"
title = "ring"
robot = "{robot}"
joints = [1]
{top}
[[load_case]]
name = "{name}"
{load}
[[minimise]]
{minimise}
[require]
{require}
{more}
"""


def write_study(folder, text=None, name="study.toml", arm="pendulum", **pieces):
    """Write a study with its robot into a folder; the path of the study file."""
    write_flanged(folder, arm)
    path = Path(folder) / name
    path.write_text(study_text(robot=f"{arm}.toml", **pieces) if text is None else text)
    return path
