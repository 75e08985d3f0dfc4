"""Small arms with their problem files: quick to solve, and simple enough to check by hand."""

from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

LINK = """<link name="{name}"><inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/>
<inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-2" iyz="0" izz="1e-2"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} 0 0"/><axis xyz="{axis}"/>
<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{speed}"/></joint>"""


def urdf(joints, links):
    """URDF of a serial arm: joints as keyword mappings, links as (name, x of the com, mass)."""
    parts = ['<robot name="arm"><link name="base"/>']
    parts += [LINK.format(name=name, x=x, mass=mass) for name, x, mass in links]
    parts += [JOINT.format(**joint) for joint in joints]
    return "\n".join([*parts, '<link name="tip"/>', TIP.format(parent=links[-1][0]), "</robot>"])


TIP = """<joint name="end" type="fixed"><parent link="{parent}"/><child link="tip"/>
<origin xyz="0.4 0 0"/></joint>"""


def _turn(name, parent, child, x, axis="0 1 0", kind="revolute", low=-3, high=3):
    return {
        "name": name, "parent": parent, "child": child, "x": x, "axis": axis, "kind": kind,
        "low": low, "high": high, "effort": 60, "speed": 6,
    }  # fmt: skip


# Both joints about y: gravity loads them. Links of 0.4 m, masses at their middles.
PLANAR = urdf(
    [_turn("shoulder", "base", "upper", 0.0), _turn("elbow", "upper", "fore", 0.4)],
    [("upper", 0.2, 2.0), ("fore", 0.2, 1.0)],
)
# One link about the vertical: no gravity.
SWIVEL = urdf([_turn("swivel", "base", "upper", 0.0, axis="0 0 1")], [("upper", 0.2, 2.0)])
# One link about y.
PENDULUM = urdf([_turn("shoulder", "base", "upper", 0.0)], [("upper", 0.2, 2.0)])
# A vertical axis, then two that gravity loads.
SPATIAL = urdf(
    [
        _turn("waist", "base", "post", 0.0, axis="0 0 1"),
        _turn("shoulder", "post", "upper", 0.0),
        _turn("elbow", "upper", "fore", 0.4),
    ],
    [("post", 0.0, 2.0), ("upper", 0.2, 2.0), ("fore", 0.2, 1.0)],
)
# A slide along x, then a turn about y.
SLIDE = urdf(
    [
        _turn("rail", "base", "cart", 0.0, axis="1 0 0", kind="prismatic", low=-1, high=1),
        _turn("arm", "cart", "upper", 0.1),
    ],
    [("cart", 0.0, 3.0), ("upper", 0.2, 1.0)],
)

CONSTANT = '[[joint.element]]\nname = "spring"\ntype = "constant"\nstiffness = {stiffness}\n'
REDUCER = """[[joint.element]]
name = "reducer"
type = "reducer"
K1 = {k1}
K2 = {k2}
K3 = {k3}
T1 = {t1}
T2 = {t2}
"""


def reducer(k1=8e3, k2=1.2e4, k3=1.6e4, t1=7.0, t2=25.0):
    return REDUCER.format(k1=k1, k2=k2, k3=k3, t1=t1, t2=t2)


def joint(name, element, **numbers):
    given = {"torque_max": 60.0, "velocity_max": 6.0, "acceleration_max": 60.0, **numbers}
    lines = [f"{key} = {value}" for key, value in given.items()]
    return "\n".join(["[[joint]]", f'name = "{name}"', *lines, element])


JOINTS = {
    "planar": [joint("shoulder", reducer()), joint("elbow", reducer(k1=4e3, k2=6e3, k3=8e3))],
    "swivel": [joint("swivel", CONSTANT.format(stiffness=1e4))],
    "pendulum": [joint("shoulder", reducer())],
    "spatial": [
        joint("waist", reducer()),
        joint("shoulder", reducer()),
        joint("elbow", reducer(k1=4e3, k2=6e3, k3=8e3)),
    ],
    "slide": [
        joint("rail", CONSTANT.format(stiffness=1e6), torque_max=200.0),
        joint("arm", reducer()),
    ],
}
URDFS = {
    "planar": PLANAR,
    "swivel": SWIVEL,
    "pendulum": PENDULUM,
    "spatial": SPATIAL,
    "slide": SLIDE,
}

# Gravity keeps its sign at both joints.
MOTION = {
    "planar": ([-0.6, 0.4], [0.5, 0.2]),
    "swivel": ([0.0], [1.0]),
    "pendulum": ([-0.6], [0.6]),
    "spatial": ([0.0, -0.6, 0.4], [0.8, 0.5, 0.2]),
    "slide": ([0.0, -0.6], [0.4, 0.6]),
}

TOOL = 'tool = { link = "tip" }'


def write_robot(folder, name="planar", joints=None, urdf_text=None, extra=TOOL):
    """Write NAME.urdf and NAME.toml into a folder; the path of the robot file."""
    (folder / f"{name}.urdf").write_text(urdf_text or URDFS[name])
    head = f'schema = 1\nkind = "robot"\nname = "{name}"\nurdf = "{name}.urdf"\n{extra}\n'
    path = folder / f"{name}.toml"
    path.write_text(head + "\n".join(JOINTS[name] if joints is None else joints))
    return path


def problem_text(
    robot="planar",
    *,
    start=None,
    end=None,
    motion="",
    duration="0.5",
    minimise='objective = "torque_squared"',
    limits="",
    method="intervals = 20",
    extra="",
    head='schema = 1\nkind = "trajectory"',
):
    """Text of a problem file for one of the arms; the pieces are TOML."""
    first, last = MOTION.get(robot, MOTION["planar"])
    start = start or f"{{ joints = {first} }}"
    end = end or f"{{ joints = {last} }}"
    goal = "\n".join(f"[[minimise]]\n{term}" for term in minimise.split("---"))
    # An arm's own file lies beside the problem's.
    reference = f"{robot}.toml" if robot in URDFS else robot
    return f"""{head}
title = "{robot}"
robot = "{reference}"
{extra}
[motion]
start = {start}
end = {end}
duration = {duration}
{motion}
{goal}
[limits]
{limits}
[method]
{method}
"""


def write_problem(folder, robot="planar", text=None, name="problem.toml", **pieces):
    """Write a problem with its robot into a folder; the path of the problem file."""
    if robot in URDFS:
        write_robot(folder, robot)
    path = Path(folder) / name
    path.write_text(problem_text(robot, **pieces) if text is None else text)
    return path


def load(folder, robot="planar", **pieces):
    """The problem itself."""
    from stiffopt.problem.files import load_problem

    return load_problem(write_problem(folder, robot, **pieces)).problem


def on_one_element(problem, element, ratio=1.0):
    """The problem with a drivetrain of one element in its only joint."""
    from stiffopt.drivetrain.chain import Chain, Stage

    chain = Chain((Stage(element, ratio=ratio),))
    return replace(problem, robot=replace(problem.robot, chains=(chain,)))


def small_flange(preload):
    """A bolted flange of 23 mm; it slips at 12.0 mm times the preload of a bolt."""
    from stiffopt.connection import BoltedFlange
    from stiffopt.drivetrain import catalogue

    return BoltedFlange(
        name="flange",
        torque_max=60.0,
        bolt_count=9,
        circle_diameter=17e-3,
        inner_radius=5.5e-3,
        outer_radius=11.5e-3,
        preload=preload,
        surface=catalogue.surface("rough_steel"),
    )
