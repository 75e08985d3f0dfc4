"""A cycle of a small arm: three axes, joint targets, one part."""

from small_arms import write_robot

HEAD = """schema = 1
kind = "trajectory"
robot = "spatial.toml"
[payload]
mass = 0.2
inertia = [1e-4, 1e-4, 1e-4]
[motion]
start = "home"
duration = {duration}
[[pose]]
name = "home"
joints = [0.0, -0.6, 0.4]
[[pose]]
name = "above"
joints = [0.4, -0.2, 0.3]
tolerance = 0.02
[[pose]]
name = "pick"
joints = [0.5, 0.0, 0.3]
[[pose]]
name = "place"
joints = [-0.4, 0.1, 0.2]
"""
GRIP = """[[move]]
to = "pick"
event = "grip"
payload = { mass = 1.0, inertia = [1e-3, 1e-3, 1e-3] }
"""
MOVES = f"""[[move]]
to = "above"
stop = false
{GRIP}dwell = 0.05
[[move]]
to = "place"
event = "release"
dwell = 0.05
[[move]]
to = "home"
"""


def cycle_text(moves=MOVES, duration='"3 s"', objective="dynamic_deflection", extra=""):
    """Text of a problem file."""
    head = HEAD.replace("{duration}", duration)
    return (
        f'{head}{moves}[[minimise]]\nobjective = "{objective}"\n[method]\nintervals = 16\n{extra}'
    )


def write_cycle_file(folder, **changes):
    """`cycle.toml` with its robot in a folder."""
    write_robot(folder, "spatial")
    path = folder / "cycle.toml"
    path.write_text(cycle_text(**changes))
    return path
