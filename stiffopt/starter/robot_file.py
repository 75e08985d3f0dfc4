"""Robot file of a URDF: its limits, candidates of reducers, and what is estimated marked."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputFileError, RobotError, nearest
from stiffopt.robot.body_tree import Body, body_tree
from stiffopt.robot.files import last_link
from stiffopt.robot.frames import link_frame, link_names
from stiffopt.robot.urdf import UNLIMITED, LoadedUrdf, load_urdf
from stiffopt.starter.writing import beside, key, number, quoted

# Of a joint whose limits nobody states: full speed within the first time, full acceleration within
# the second [s].
_TO_SPEED, _TO_ACCELERATION = 0.25, 0.05
# Where the URDF is silent [N m], [rad/s].
_TORQUE, _SPEED = 50.0, 2.0
_SHOWN = 3


def robot_text(urdf: Path, folder: Path, tip: str | None = None, name: str | None = None) -> str:
    """Text of a robot file for a URDF.

    Parameters
    ----------
    urdf : Path
    folder : Path
        That the file is to lie in.
    tip : str, optional
        Link at the end of the arm, which the tool is fixed to; default where fingers branch off.
    name : str, optional
        Default the name of the URDF's file.

    Raises
    ------
    InputFileError, RobotError
        No URDF that can be read, or a tip that it lacks.
    """
    if urdf.suffix.lower() in (".sdf", ".mjcf", ".xacro") or urdf.name.endswith(".urdf.xacro"):
        raise InputFileError(
            urdf,
            "",
            f"{urdf.suffix} is not read, only URDF. Convert it first: `xacro FILE > robot.urdf`,"
            " `sdf2urdf`, or the exporter of MuJoCo models.",
        )
    arm = load_urdf(urdf, tip=tip)
    names = link_names(arm.model)
    if tip is not None and tip not in names:
        raise RobotError(f"{urdf}: there is no link {tip!r}. {nearest(tip, names)}")
    tool = link_frame(arm.model, tip or last_link(arm.model))
    lines = [
        f"# Robot file of {urdf.name}, written by `stiffopt init robot`. Position, velocity and"
        " torque",
        "# limits are those of the URDF. What is marked estimated is a guess to begin with: put",
        "# your own numbers in its place before you trust a micrometre.",
        "schema = 1",
        'kind = "robot"',
        f"name = {quoted(name or urdf.stem)}",
        f"urdf = {quoted(beside(urdf, folder))}",
    ]
    if arm.held:
        held = ", ".join(f"{key(h.name)} = {number(h.value)}" for h in arm.held)
        lines.append(f"lock = {{ {held} }}  # held: {_whys(arm)}")
    lines.append(f"tool = {{ link = {quoted(tool.link)}, offset = [0.0, 0.0, 0.0] }}  # [m]")
    for j, body in enumerate(body_tree(arm.model).bodies):
        lines += ["", *_joint(arm, j, body)]
    return "\n".join(lines) + "\n"


def _whys(arm: LoadedUrdf) -> str:
    return "; ".join(dict.fromkeys(h.why for h in arm.held))


def _joint(arm: LoadedUrdf, j: int, body: Body) -> Iterator[str]:
    stated = arm.joints[body.name]
    low, high = float(arm.model.lowerPositionLimit[j]), float(arm.model.upperPositionLimit[j])
    unit = ("m", "m/s", "N") if body.prismatic else ("rad", "rad/s", "N m")
    speed, torque = stated["velocity"] or _SPEED, stated["effort"] or _TORQUE
    acceleration = speed / _TO_SPEED
    yield "[[joint]]"
    yield f"name = {quoted(body.name)}  # {_range(low, high, body.prismatic)}, of the URDF"
    for name, value, key_, per in (
        ("torque_max", torque, "effort", unit[2]),
        ("velocity_max", speed, "velocity", unit[1]),
    ):
        where = "URDF" if stated[key_] else f"GUESSED: the URDF has no {key_}"
        yield f"{name} = {number(value)}  # [{per}], {where}"
    yield f"acceleration_max = {number(acceleration, 3)}  # estimated: full speed in 0.25 s"
    yield f"jerk_max = {number(acceleration / _TO_ACCELERATION, 3)}  # estimated: that in 50 ms"
    for name, key_ in (("coulomb", "friction"), ("viscous", "damping")):
        if stated[key_]:
            yield f"{name} = {number(stated[key_])}  # URDF"
    yield 'provenance = "estimated"'
    yield 'source = "URDF; acceleration and jerk are guesses of init robot"'
    if body.prismatic:
        yield '# A slide: describe its elements, such as type = "constant" with its stiffness.'
        return
    yield from _reducer(torque)


def _reducer(torque: float) -> Iterator[str]:
    """Smallest packaged reducer that bears the torque, and the next ones."""
    fitting = reducers_for(torque)
    yield ""
    if not fitting:
        yield (
            f"# No packaged reducer bears {number(torque)} N m again and again. Give yours:"
            " the joint is rigid until then."
        )
        yield "# [[joint.element]]"
        yield '# name = "reducer"'
        yield '# type = "reducer"'
        yield "# K1 = ...  # [N m/rad] up to T1; K2 up to T2, K3 above; T1, T2 [N m]"
        return
    others = [name for name, _ in fitting[1 : 1 + _SHOWN]]
    yield "[[joint.element]]"
    yield 'name = "reducer"'
    yield 'type = "reducer"'
    more = f"; next {', '.join(others)}" if others else ""
    chosen, peak = fitting[0]
    yield f"catalogue = {quoted(chosen)}  # estimated: repeated peak {peak:g} N m{more}"
    yield 'provenance = "estimated"'
    yield 'source = "init robot: the smallest packaged reducer of ratio 80 or more for the torque"'


def reducers_for(torque: float) -> list[tuple[str, float]]:
    """Packaged reducers of ratio 80 or more with a repeated peak torque above this [N m]."""
    entries = [catalogue.reducer(name) for name in catalogue.reducer_names()]
    found = [
        (entry.name, entry.ratings[1], entry.ratio)
        for entry in entries
        if entry.ratings is not None and entry.ratio >= 80 and entry.ratings[1] >= torque
    ]
    return [(name, peak) for name, peak, _ in sorted(found, key=lambda e: (e[1], -e[2]))]


def _range(low: float, high: float, slides: bool) -> str:
    if max(abs(low), abs(high)) >= UNLIMITED:
        return "no limits of position"
    if slides:
        return f"{low:.4g} to {high:.4g} m"
    return f"{np.degrees(low):.4g} to {np.degrees(high):.4g} deg"
