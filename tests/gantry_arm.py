"""Two slides at right angles that carry a ball past a round post: optima known in closed form."""

from small_arms import problem_text

# Half the way along x, the top of what the ball's centre must go around, and its radius [m].
HALF, TOP, ROUND = 0.4, 0.2, 0.15
BALL, CLEARANCE = 0.02, 0.01

_LINK = (
    '<link name="{name}"><inertial><mass value="1"/>'
    '<inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>{shape}</link>'
)
_BALL = (
    '<collision><origin xyz="0 {y} 0"/><geometry><sphere radius="{radius}"/></geometry></collision>'
)
_SLIDE = (
    '<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{child}"/>'
    '<axis xyz="{axis}"/><limit lower="{low}" upper="1" effort="10" velocity="20"/></joint>'
)
_JOINT = """
[[joint]]
name = "{name}"
torque_max = {force}
velocity_max = 20.0
acceleration_max = {acceleration}
"""


def gantry(lowest=-1.0):
    """Slides x and y; the post is a ball of the base, the slide y may go down to `lowest`."""
    post = _BALL.format(y=TOP - ROUND, radius=ROUND - BALL - CLEARANCE)
    ball = _BALL.format(y=0.0, radius=BALL)
    return "".join(
        [
            f'<robot name="gantry"><link name="base">{post}</link>',
            _LINK.format(name="cart", shape=""),
            _LINK.format(name="hand", shape=ball),
            _SLIDE.format(name="x", parent="base", child="cart", axis="1 0 0", low=-1.0),
            _SLIDE.format(name="y", parent="cart", child="hand", axis="0 1 0", low=lowest),
            "</robot>",
        ]
    )


def write_gantry(folder, *, lowest=-1.0, acceleration=100.0, cell="", **pieces):
    """Robot and problem files in a folder; the path of the problem. Both slides count alike."""
    (folder / "gantry.urdf").write_text(gantry(lowest))
    joints = "".join(
        _JOINT.format(name=name, force=force, acceleration=acceleration)
        for name, force in (("x", 20.0), ("y", 10.0))
    )
    (folder / "gantry.toml").write_text(
        'schema = 1\nkind = "robot"\nname = "gantry"\nurdf = "gantry.urdf"\n'
        f'tool = {{ link = "hand", offset = [0.0, 0.0, 0.1] }}\n{joints}'
    )
    given = {
        "robot": "gantry.toml",
        "start": f"{{ joints = [{-HALF}, 0.0] }}",
        "end": f"{{ joints = [{HALF}, 0.0] }}",
        "duration": "1.0",
        "motion": 'boundary_acceleration = "free"',
        "limits": 'jerk = "none"',
        "method": "intervals = 40",
        **pieces,
    }
    path = folder / "problem.toml"
    path.write_text(problem_text(**given) + f"[cell]\nclearance = {CLEARANCE}\n{cell}")
    return path
