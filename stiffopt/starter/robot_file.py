"""Robot file of a URDF or MJCF: its limits, candidate reducers, and marked estimates."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from stiffopt.drivetrain.catalogue import reducer, reducer_names
from stiffopt.drivetrain.tables import with_own
from stiffopt.errors import InputFileError, RobotError, nearest
from stiffopt.robot import estimated_masses
from stiffopt.robot.body_tree import Body, body_tree
from stiffopt.robot.files import default_tool_link
from stiffopt.robot.frames import LinkFrame, link_frame, link_names, moving_link_names
from stiffopt.robot.own_catalogue import read_own_catalogue
from stiffopt.robot.rigid_body import RigidBodies
from stiffopt.robot.urdf import UNLIMITED, LoadedUrdf, load_urdf
from stiffopt.robot.urdf_xml import unsupported_format
from stiffopt.starter import placeholders
from stiffopt.starter.writing import relative_path, toml_key, toml_list, toml_number, toml_string

# Time to full speed that sets an unstated acceleration limit [s].
_ACCELERATION_TIME = 0.25
# Guesses for unstated limits: speed [rad/s], range of a prismatic joint [m].
_DEFAULT_SPEED, _DEFAULT_SLIDE_RANGE = 2.0, 0.3
# Position limits beyond this may be in degrees [rad].
_MAX_PLAUSIBLE_ANGLE = 12.0 * np.pi
# Usual names of tool links.
_TOOL_NAME_PATTERN = re.compile("tcp|tool|flange|effector", re.IGNORECASE)
_UNREAD_FORMATS = {".sdf": "an SDF", ".xacro": "xacro"}
# Friction and rotor inertia in robot files, and in the model's.
_DYNAMICS_KEYS = {"coulomb": "friction", "viscous": "damping", "rotor_inertia": "armature"}
_SLIDE_COMMENT = (
    '# Prismatic joint: describe its elements, such as type = "constant" with its stiffness.',
)
_NO_REDUCER_COMMENT = "# No packaged reducer carries"


@dataclass(frozen=True, kw_only=True)
class StartedRobot:
    """Text of a robot file, with notes for the user."""

    text: str
    notes: tuple[str, ...]  # guesses and omissions, a sentence each


def robot_text(
    urdf: Path,
    folder: Path,
    tip: str | None = None,
    catalogue: Path | None = None,
    *,
    keep: Collection[str] = (),
    bare: bool = False,
) -> StartedRobot:
    """Return the text of a robot file for a URDF.

    `folder`: of the file. `tip`: last link of the arm, which carries the tool; default where
    fingers branch off. `catalogue`: of the user, whose reducers are candidates too. `keep`: joints
    that are not fixed although no tip is named. `bare`: without reducers and the friction of a
    URDF, which recordings determine.

    Raises `InputFileError`, `RobotError`: unreadable URDF, unknown tip, or several arms and no tip.
    """
    _check_format(urdf)
    load = partial(load_urdf, urdf, tip=tip, keep=keep, limited=None, hold_unplanned=True)
    arm = load()
    names = link_names(arm.model)
    if tip is not None and tip not in names:
        raise RobotError(f"{urdf}: there is no link {tip!r}. {nearest(tip, names)}")
    tool = link_frame(arm.model, tip or default_tool_link(arm.model))
    bodies = estimated_masses.estimate_bodies(arm, urdf, tool)
    if bodies:
        arm = load(bodies=bodies)
        bodies = estimated_masses.fit_to_torque_limits(
            bodies, _weight_torques(arm), placeholders.credible_torques(arm)
        )
        arm = load(bodies=bodies)
    doubted = placeholders.speed_placeholders(arm, tool)
    arm = placeholders.drop_placeholders(arm, doubted)
    speed = np.array([stated["velocity"] or _DEFAULT_SPEED for stated in arm.joints.values()])
    demands = _weight_torques(arm, speed / _ACCELERATION_TIME)
    weight = 0.0 * demands if bodies else _weight_torques(arm)
    doubted += (further := placeholders.torque_placeholders(arm, demands, weight))
    arm = placeholders.drop_placeholders(arm, further)
    lines = [
        f"# Robot file of {urdf.name}, written by `stiffopt init robot`. Position, velocity and"
        " torque",
        f"# limits are those of the {arm.format}. Values marked estimated are initial guesses:",
        "# replace them by your own before relying on results.",
        "schema = 1",
        'kind = "robot"',
        f"name = {toml_string(urdf.stem)}",
        f"urdf = {toml_string(relative_path(urdf, folder))}",
    ]
    if arm.held:
        held = ", ".join(f"{toml_key(h.name)} = {toml_number(h.value)}" for h in arm.held)
        reasons = "; ".join(dict.fromkeys(h.why for h in arm.held))
        lines.append(f"lock = {{ {held} }}  # held: {reasons}")
    lines.append(f"tool = {{ link = {toml_string(tool.link)}, offset = [0.0, 0.0, 0.0] }}  # [m]")
    if catalogue is not None:
        lines.append(f"catalogue = {toml_string(relative_path(catalogue, folder))}")
    for link, body in bodies.items():
        lines += ["", *_link_lines(link, body)]
    with with_own({} if catalogue is None else read_own_catalogue(catalogue)):
        for j, each in enumerate(body_tree(arm.model).bodies):
            own = {p.quantity: p for p in doubted if p.joint == each.name}
            lines += ["", *_joint_lines(arm, j, each, float(demands[j]), own, bare=bare)]
            if not bare:
                lines += (
                    _SLIDE_COMMENT
                    if each.prismatic
                    else _reducer_lines(_torque_limit(arm, each, float(demands[j])))
                )
    notes = [*_describe_guesses(arm, bodies, tool.link, doubted, lines)]
    if tip is None:
        notes[1:1] = _list_farther_links(arm, tool)
    return StartedRobot(text="\n".join(lines) + "\n", notes=tuple(notes))


def _check_format(urdf: Path) -> None:
    """Raise `InputFileError` for file names of other formats than URDF."""
    kind = (
        "xacro" if urdf.name.endswith(".urdf.xacro") else _UNREAD_FORMATS.get(urdf.suffix.lower())
    )
    if kind is not None:
        raise InputFileError(urdf, "", unsupported_format(kind))
    if urdf.suffix.lower() == ".toml":
        raise InputFileError(
            urdf, "", f"is a robot file already: continue with `stiffopt init problem {urdf}`."
        )


def _describe_guesses(
    arm: LoadedUrdf,
    bodies: Mapping[str, estimated_masses.EstimatedBody],
    tool: str,
    doubted: Sequence[placeholders.Placeholder],
    lines: Sequence[str],
) -> Iterator[str]:
    """Yield guesses, omissions and questions, a sentence each."""
    yield f"The arm: {', '.join(arm.joints)}; its tool is fixed to {tool}."
    for value, why in dict.fromkeys((h.value, h.why) for h in arm.held):
        names = [h.name for h in arm.held if (h.value, h.why) == (value, why)]
        yield f"Held at {value:g} ({why}): {', '.join(names)}."
    coupled = [h.name for h in arm.held if h.why.endswith("which moves")]
    if coupled:
        yield (
            f"{', '.join(coupled)} cannot follow its leading joint: if that joint moves the tool,"
            " the arm differs from the real one."
        )
    yield from _guessed_masses(bodies)
    names = list(arm.joints)
    turning = ~body_tree(arm.model).prismatic
    reach = np.maximum(-arm.model.lowerPositionLimit, arm.model.upperPositionLimit)
    wide = [
        names[j]
        for j in np.flatnonzero(turning & (reach > _MAX_PLAUSIBLE_ANGLE) & (reach < UNLIMITED))
    ]
    if wide:
        yield (
            f"QUESTION: limits of {', '.join(wide)} are more than {_MAX_PLAUSIBLE_ANGLE / np.pi:g}"
            " half turns. URDFs are in rad: were degrees meant? Then give position_lower and"
            ' position_upper as texts, such as "-130 deg".'
        )
    if arm.unlimited:
        yield f"GUESSED: limits of position of {', '.join(arm.unlimited)}."
    for quantity in ("effort", "velocity"):
        taken: dict[str, list[str]] = {}
        for each in doubted:
            if each.quantity == quantity:
                taken.setdefault(str(each), []).append(each.joint)
        doubtful = {name for names in taken.values() for name in names}
        silent = [name for name, stated in arm.joints.items() if not stated[quantity]]
        silent = [name for name in silent if name not in doubtful]
        if silent:
            yield f"GUESSED: the {arm.format} has no {quantity} for {', '.join(silent)}."
        if taken:
            said = "; ".join(f"{', '.join(names)}: {text}" for text, names in taken.items())
            yield (
                f"QUESTION: the {quantity} of {len(doubtful)} joints is a placeholder: {said}."
                " Guessed values are in the file, marked estimated: replace them by the data"
                " sheet's."
            )
    bare = [line for line in lines if line.startswith(_NO_REDUCER_COMMENT)]
    if bare:
        yield (
            f"RIGID: for {len(bare)} of the joints no packaged reducer carries the torque; give"
            " yours in the file, or these joints are rigid."
        )
    yield from placeholders.open_questions(arm, _weight_torques(arm), bodies)


def _list_farther_links(arm: LoadedUrdf, tool: LinkFrame) -> Iterator[str]:
    """Yield a note on other links fixed to that of the tool, which may be meant."""
    frames = [link_frame(arm.model, name) for name in moving_link_names(arm.model)]
    found = {
        frame.link: float(np.linalg.norm(frame.offset - tool.offset))
        for frame in frames
        if frame.joint == tool.joint
    }
    ahead = sorted((way, name) for name, way in found.items() if way > 1e-3)
    if ahead:
        named = [name for _, name in ahead if _TOOL_NAME_PATTERN.search(name)]
        best = named[-1] if named else ahead[0][1]
        listed_ = ", ".join(f"{name} ({1e3 * way:.0f} mm away)" for way, name in ahead[:6])
        yield (
            f"Fixed to {tool.link} are also {listed_}: for the tool there, name one,"
            f" such as --tip {shlex.quote(best)}."
        )


def _guessed_masses(bodies: Mapping[str, estimated_masses.EstimatedBody]) -> Iterator[str]:
    """Yield the guessed masses, their source and their uncertainty."""
    shaped = {name: body for name, body in bodies.items() if body.shaped}
    rods = {name: body for name, body in bodies.items() if not body.shaped}
    for own, off in ((shaped, "a factor of two"), (rods, "a factor of two, single links of three")):
        if own:
            total = sum(body.mass for body in own.values())
            yield (
                f"GUESSED: the URDF gives no usable mass to {', '.join(own)};"
                f" {total:.3g} kg together, by"
                f" {_describe_mass_source(next(iter(own.values())))}. They can be off by {off}, and"
                " every torque depends on them: put in your own."
            )


def _describe_mass_source(body: estimated_masses.EstimatedBody) -> str:
    """Return the source of a guessed mass."""
    said = f"the volume of their shapes at {estimated_masses.DENSITY:g} kg/m^3"
    if not body.shaped:
        said = (
            "housings and rods from joint to joint, since the URDF has no shapes, at"
            f" {estimated_masses.ROD_DENSITY:g} kg/m^3"
        )
    # Least relative change of masses by torque limits that is reported [-].
    if abs(body.scale - 1.0) < 0.05:
        return said
    return f"{said}, times {body.scale:.2g} to match the torque limits"


def _link_lines(name: str, body: estimated_masses.EstimatedBody) -> Iterator[str]:
    yield "[[link]]"
    yield f"name = {toml_string(name)}"
    yield f"mass = {toml_number(body.mass, 3)}  # [kg], estimated: the URDF has no usable one"
    yield f"com = {toml_list(toml_number(round(float(x), 4)) for x in body.com)}  # [m]"
    moments = toml_list(toml_number(float(x), 3) for x in np.diag(body.inertia))
    yield f"inertia = {moments}  # [kg m^2]"
    yield 'provenance = "estimated"'
    yield f'source = "init robot: {_describe_mass_source(body)}"'


def _weight_torques(arm: LoadedUrdf, acceleration: np.ndarray | float = 0.0) -> np.ndarray:
    """Return the largest torque of gravity and acceleration (n,) over random poses (n,)."""
    bodies = RigidBodies(arm.model)
    torques = [
        np.abs(bodies.gravity_torque(q)) + np.diag(bodies.inertia_matrix(q)) * acceleration
        for q in _random_poses(arm)
    ]
    return np.asarray(np.max(torques, axis=0))


def _random_poses(arm: LoadedUrdf) -> np.ndarray:
    """Return random poses (K, n) within the limits."""
    low, high = (np.array(x) for x in (arm.model.lowerPositionLimit, arm.model.upperPositionLimit))
    endless = (low <= -UNLIMITED) | (high >= UNLIMITED)
    slides = body_tree(arm.model).prismatic
    reach = np.where(slides, 0.5 * _DEFAULT_SLIDE_RANGE, np.pi)
    low, high = np.where(endless, -reach, low), np.where(endless, reach, high)
    return np.random.default_rng(1).uniform(low, high, (200, len(low)))


def _joint_lines(
    arm: LoadedUrdf,
    j: int,
    body: Body,
    demand: float,
    doubted: Mapping[str, placeholders.Placeholder],
    *,
    bare: bool,
) -> Iterator[str]:
    stated = arm.joints[body.name]
    low, high = float(arm.model.lowerPositionLimit[j]), float(arm.model.upperPositionLimit[j])
    unit = ("m", "m/s", "N") if body.prismatic else ("rad", "rad/s", "N m")
    speed = stated["velocity"] or _DEFAULT_SPEED
    torque = _torque_limit(arm, body, demand)
    acceleration = speed / _ACCELERATION_TIME
    yield "[[joint]]"
    if body.name in arm.unlimited:
        # Angles as texts, since users edit degrees.
        ends = ("0.0", f"{_DEFAULT_SLIDE_RANGE}") if body.prismatic else ('"-170 deg"', '"170 deg"')
        yield f"name = {toml_string(body.name)}"
        yield f"position_lower = {ends[0]}  # GUESSED: the {arm.format} has no limits of position"
        yield f"position_upper = {ends[1]}  # GUESSED"
    else:
        reach = _format_range(low, high, body.prismatic)
        yield f"name = {toml_string(body.name)}  # {reach}, of the {arm.format}"
    for name, value, key_, per in (
        ("torque_max", torque, "effort", unit[2]),
        ("velocity_max", speed, "velocity", unit[1]),
    ):
        where = arm.format
        if not stated[key_]:
            where = f"GUESSED: {doubted.get(key_, f'the {arm.format} has no {key_}')}"
            if key_ == "effort":
                where += "; this is weight and full acceleration with margin"
        yield f"{name} = {toml_number(value)}  # [{per}], {where}"
    yield f"acceleration_max = {toml_number(acceleration, 3)}  # estimated: full speed in 0.25 s"
    yield f"jerk_max = {toml_number(acceleration / 0.05, 3)}  # estimated: that in 50 ms"
    for name, key_ in _DYNAMICS_KEYS.items():
        # Friction in a URDF is a setting of simulators; that of an MJCF is set for each joint.
        if bare and arm.format == "URDF" and name != "rotor_inertia":
            yield f"{name} = 0.0  # not known"
        elif stated[key_]:
            yield f"{name} = {toml_number(stated[key_])}  # {arm.format}"
    yield 'provenance = "estimated"'
    guesses = [name for name, key_ in (("torque", "effort"), ("speed", "velocity"))
               if not stated[key_]]  # fmt: skip
    limits = ("position_lower", "position_upper") if body.name in arm.unlimited else ()
    estimated = [*limits, *(["torque_max"] if "torque" in guesses else [])]
    if estimated:  # no limits of a simulated drive or of recordings
        yield f"estimated = {toml_list(map(toml_string, estimated))}"
    yield f'source = "{arm.format}; {", ".join([*guesses, "acceleration"])} and jerk are guesses"'


def _torque_limit(arm: LoadedUrdf, body: Body, demand: float) -> float:
    """Return the torque limit of a joint; if not stated, its demand and a half, at least 5 N m."""
    return arm.joints[body.name]["effort"] or float(f"{max(1.5 * demand, 5.0):.2g}")


def _reducer_lines(torque: float) -> Iterator[str]:
    """Yield the smallest packaged reducer for the torque, and the next ones."""
    fitting = reducers_for(torque)
    yield ""
    if not fitting:
        yield (
            f"{_NO_REDUCER_COMMENT} {toml_number(torque)} N m repeatedly. Give yours:"
            " the joint is rigid until then."
        )
        yield "# [[joint.element]]"
        yield '# name = "reducer"'
        yield '# type = "reducer"'
        yield "# K1 = ...  # [N m/rad] up to T1; K2 up to T2, K3 above; T1, T2 [N m]"
        return
    others = [name for name, _ in fitting[1:4]]
    yield "[[joint.element]]"
    yield 'name = "reducer"'
    yield 'type = "reducer"'
    more = f"; next {', '.join(others)}" if others else ""
    chosen, peak = fitting[0]
    yield f"catalogue = {toml_string(chosen)}  # estimated: repeated peak {peak:g} N m{more}"
    yield 'provenance = "estimated"'
    yield 'source = "init robot: the smallest packaged reducer of ratio 80 or more for the torque"'


def reducers_for(torque: float) -> list[tuple[str, float]]:
    """Return packaged reducers of ratio 80 or more for a repeated peak torque [N m]."""
    entries = [reducer(name) for name in reducer_names()]
    found = [
        (entry.name, entry.ratings[1], entry.ratio)
        for entry in entries
        if entry.ratings is not None and entry.ratio >= 80 and entry.ratings[1] >= torque
    ]

    def order(entry: tuple[str, float, float]) -> tuple[bool, float, float]:
        # Cycloidal reducers are for large joints.
        name, peak, ratio = entry
        # Largest torque of usual strain-wave reducers [N m].
        return name.startswith("rv_") == (torque <= 350.0), peak, -ratio

    return [(name, peak) for name, peak, _ in sorted(found, key=order)]


def _format_range(low: float, high: float, slides: bool) -> str:
    if max(abs(low), abs(high)) >= UNLIMITED:
        return "no limits of position"
    if slides:
        return f"{low:.4g} to {high:.4g} m"
    return f"{np.degrees(low):.4g} to {np.degrees(high):.4g} deg"
