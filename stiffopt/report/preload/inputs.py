"""Inputs of a preload study as tables, estimated numbers marked."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stiffopt.connection import BoltedFlange, ClampingPins
from stiffopt.report.common.motions import robot_joint_units
from stiffopt.report.common.quantities import engineering, percent, significant
from stiffopt.report.preload.names import MARK, fasteners, method_name, objective_name, spoken
from stiffopt.report.solve.tables import Table, estimated_table

if TYPE_CHECKING:
    from stiffopt.preload.problem import FreeElement, PreloadProblem
    from stiffopt.preload.solution import PreloadSolution


def study_table(problem: PreloadProblem) -> Table:
    """List the study as stated, as name and value."""
    needs, units = problem.requirements, robot_joint_units(problem.robot)
    rows = [
        ("robot", problem.robot.title or problem.robot.name),
        ("joints", ", ".join(map(str, problem.joints))),
        ("aim", objective_name(problem)),
        ("slip safety at least", f"{needs.slip_safety:g}, with the least preload"),
        (
            "bolt utilisation at most",
            f"{percent(needs.bolt_utilisation)} of 90 % of yield, with the largest preload",
        ),
        (
            "least preload" + MARK,
            f"{percent(needs.least_preload)} of what the connection bears, so that no bolt works "
            "loose",
        ),
    ]
    for joint, stiffness in needs.joint_stiffness.items():
        unit = units[joint - 1].stiffness
        rows.append((f"stiffness of joint {joint} at least", engineering(stiffness, unit)))
    if needs.tool_deflection is not None:
        rows.append(("tool deflection at most", engineering(needs.tool_deflection, "m")))
    for joint, weight in problem.joint_weights.items():
        rows.append((f"weight of joint {joint}", engineering(weight, units[joint - 1].stiffness)))
    alone = "one of its own for each bolt or pin"
    rows.append(("preloads", alone if problem.individual else "equal within each connection"))
    return Table(("", ""), tuple(rows))


def tightening_table(problem: PreloadProblem) -> Table:
    """How bolts are tightened, with sources."""
    own = problem.tightening
    given = "by method, VDI 2230" if own.scatter is None else "given"
    rows = (
        ("method", method_name(problem), "given"),
        ("scatter, largest over least preload", f"{own.alpha:g}", given),
        ("thread friction", f"{own.thread_friction:g}", "given or default; VDI 2230 class B"),
        ("head friction", f"{own.head_friction:g}", "given or default; VDI 2230 class B"),
        (
            "embedding of each fastener",
            engineering(own.embedding, "m"),
            "given or default; order of VDI 2230",
        ),
    )
    return Table(("tightening", "value", "where from"), rows)


def cases_table(problem: PreloadProblem, solution: PreloadSolution) -> Table:
    """Torque of every joint of the study in every load case, and where it comes from."""
    units = robot_joint_units(problem.robot)
    head = ["load case"]
    head += [f"joint {joint} [{units[joint - 1].torque}]" for joint in problem.joints]
    head.append("where from")
    rows = tuple(
        (
            case.name,
            *(significant(float(case.torque[joint - 1])) for joint in problem.joints),
            case.source,
        )
        for case in solution.cases
    )
    return Table(tuple(head), rows)


def bolts_table(problem: PreloadProblem) -> Table | None:
    """Bolted flanges: fasteners, lengths, friction and embedding; None where there are none."""
    marks, rows = EstimateMarks(problem), []
    for element in problem.elements:
        flange = element.stage.element
        if not isinstance(flange, BoltedFlange) or flange.bolt is None:
            continue
        bolt = flange.bolt
        ring = f"{_mm(2 * flange.inner_radius)} to {_mm(2 * flange.outer_radius)}"
        rows.append(
            (
                spoken(element.key),
                fasteners(element) + marks.of(element, "bolt"),
                _mm(flange.circle_diameter) + marks.of(element, "bolt"),
                ring + marks.of(element, "inner_radius", "outer_radius"),
                f"2 d{MARK}" if bolt.clamp_length is None else _mm(bolt.clamp_length),
                f"by material{MARK}" if bolt.engagement is None else _mm(bolt.engagement),
                f"{bolt.head_material}, {bolt.thread_material}",
                _friction(flange) + marks.of(element, _friction_key(flange)),
                f"{significant(element.embedding_loss / 1e3, 2)} kN",
            )
        )
    head = (
        "bolted flange",
        "bolts",
        "bolt circle [mm]",
        "ring diameters [mm]",
        "clamp length [mm]",
        "thread length [mm]",
        "under head, in thread",
        "face friction",
        "lost by embedding",
    )
    return Table(head, tuple(rows)) if rows else None


def pins_table(problem: PreloadProblem) -> Table | None:
    """Clamping pins: screws, tips, shaft, friction and embedding; None where there are none."""
    marks, rows = EstimateMarks(problem), []
    for element in problem.elements:
        pins = element.stage.element
        if not isinstance(pins, ClampingPins):
            continue
        shaft = "steel 45" + MARK if pins.screw is None else spoken(pins.screw.shaft_material)
        length = None if pins.screw is None else pins.screw.length
        rows.append(
            (
                spoken(element.key),
                fasteners(element) + marks.of(element, "count"),
                f"by diameter{MARK}" if length is None else _mm(length),
                _mm(pins.tip_diameter) + marks.of(element, "tip_diameter"),
                _mm(pins.shaft_diameter) + marks.of(element, "shaft_diameter"),
                shaft,
                _friction(pins) + marks.of(element, _friction_key(pins)),
                f"{significant(element.embedding_loss / 1e3, 2)} kN",
            )
        )
    head = (
        "pins",
        "screws",
        "length [mm]",
        "tip [mm]",
        "shaft [mm]",
        "shaft material",
        "tip friction",
        "lost by embedding",
    )
    return Table(head, tuple(rows)) if rows else None


def _friction(connection: BoltedFlange | ClampingPins) -> str:
    return f"{connection.friction_coefficient:g}"


def _friction_key(connection: BoltedFlange | ClampingPins) -> str:
    """Key of the robot file that the friction comes from."""
    return "surface" if connection.friction is None else "friction"


def _mm(length: float) -> str:
    return significant(1e3 * length)


def robot_estimates(problem: PreloadProblem) -> Table | None:
    """Estimated inputs of the study's joints and of the robot as a whole; None without any."""
    names = problem.robot.joint_names
    table = estimated_table(problem.robot, {names[joint - 1] for joint in problem.joints})
    if table is None:
        return None
    rows = tuple((*(spoken(cell) for cell in row[:-1]), row[-1]) for row in table.rows)
    return Table(table.head, rows)


class EstimateMarks:
    """Marks numbers of elements that the robot file calls estimated.

    Parameters
    ----------
    problem : PreloadProblem
    """

    def __init__(self, problem: PreloadProblem) -> None:
        self._names = problem.robot.joint_names
        self._keys: dict[tuple[str, str], set[str]] = {}
        for each in problem.robot.estimated():
            own = self._keys.setdefault((each.joint, each.element), set())
            own.update(key.strip() for key in each.key.split(","))

    def of(self, element: FreeElement, *keys: str) -> str:
        """Mark, where one of these keys of an element is estimated; else nothing."""
        own = self._keys.get((self._names[element.joint - 1], element.name), set())
        return MARK if own.intersection(keys) else ""
