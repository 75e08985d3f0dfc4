"""stiffness.html of a robot: joint stiffness with and without contacts, and what yields."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from stiffopt.files import atomic_write
from stiffopt.report.common.citations import robot_references
from stiffopt.report.common.motions import JointUnits, robot_joint_units
from stiffopt.report.common.quantities import significant
from stiffopt.report.common.rendering import page_figure, write_page
from stiffopt.report.common.svg import to_png, to_svg
from stiffopt.report.solve.tables import DASH, Table, estimated_table
from stiffopt.report.stiffness.figures import (
    StiffnessCurve,
    relative_figure,
    shares_figure,
    stiffness_curves,
    tangent_figure,
)

PAGE_FILE = "stiffness.html"
_TABLE_RATIOS = (0.01, 0.05, 0.2, 1.0)


def write_stiffness_report(robot: Any, rows: Iterable[Any], directory: str | Path) -> Path:
    """Write stiffness.html and its figures as SVG and PNG into `directory`; return the page.

    Parameters
    ----------
    robot : Robot
    rows : iterable of mapping or object
        With the columns of stiffness.csv, as `stiffness_study` returns them.
    directory : path

    Returns
    -------
    Path
    """
    folder = Path(directory)
    units = robot_joint_units(robot)
    curves = stiffness_curves(rows)
    shown = [
        (
            "tangent",
            "Tangent stiffness",
            tangent_figure(curves, units, low_torque=False),
            "Tangent stiffness over the torque ratio. The steps are the reducer's ranges K1, K2 "
            "and K3; with contacts every joint is softer than its reducer alone.",
        ),
        (
            "low_torque",
            "Near zero torque",
            tangent_figure(curves, units, low_torque=True),
            "The same over a logarithmic torque axis: lightly loaded contacts are soft, so the "
            "difference grows as the torque goes to zero.",
        ),
        (
            "ratio",
            "Against the reducer alone",
            relative_figure(curves, units),
            "One means that the contacts do not matter.",
        ),
        (
            "shares",
            "What yields",
            shares_figure(robot, units),
            "Share of each kind of element in the joint's tangent compliance, reflected to the "
            "output.",
        ),
    ]
    figures = []
    for name, title, figure, caption in shown:
        svg = _save(figure, f"stiffness_{name}", title, folder)
        figures.append(page_figure(svg, caption, title))
    context = {
        "title": f"Joint stiffness of {robot.title or robot.name}",
        "headline": _headline(curves),
        "figures": figures,
        "stiffness": _stiffness_table(curves, units),
        "slip": _slip_table(robot, units),
        "estimated": estimated_table(robot),
        "references": robot_references(robot),
    }
    return write_page("stiffness.html.j2", folder / PAGE_FILE, context)


def _save(figure: Figure, name: str, title: str, folder: Path) -> str:
    svg = to_svg(figure, name, title)
    atomic_write(folder / f"{name}.svg", svg)
    atomic_write(folder / f"{name}.png", to_png(figure))
    return svg


def _headline(curves: Mapping[int, Sequence[StiffnessCurve]]) -> str:
    lowest, joint, ratio = min(
        (float(each[0].relative.min()), joint, float(each[0].ratio[each[0].relative.argmin()]))
        for joint, each in curves.items()
    )
    return (
        f"Contacts take up to {100 * (1 - lowest):.0f} % of the stiffness "
        f"(joint {joint} at {100 * ratio:g} % of its largest torque)"
    )


def _stiffness_table(
    curves: Mapping[int, Sequence[StiffnessCurve]], units: Sequence[JointUnits]
) -> Table:
    head = ["joint", "key flanks"]
    head += [f"at {100 * ratio:g} %" for ratio in _TABLE_RATIOS]
    head += [f"over reducer at {100 * ratio:g} %" for ratio in _TABLE_RATIOS]
    head.append("wind-up at largest torque")
    rows = []
    for joint, readings in curves.items():
        unit = units[joint - 1]
        for curve in readings:
            row = [unit.label, curve.flanks]
            row += [significant(curve.at(ratio, curve.tangent)) for ratio in _TABLE_RATIOS]
            row += [significant(curve.at(ratio, curve.relative), 3) for ratio in _TABLE_RATIOS]
            windup = significant(1e3 * curve.at(1.0, curve.windup), 3)
            row.append(f"{windup} {'mm' if unit.prismatic else 'mrad'}")
            rows.append(tuple(row))
    return Table(tuple(head), tuple(rows))


def _slip_table(robot: Any, units: Sequence[JointUnits]) -> Table:
    """Per joint the element that slips first, with its safety at the largest torque."""
    rows, bad = [], set()
    for j, chain in enumerate(robot.chains):
        if chain is None:
            continue
        slip = chain.slip_torques()
        name = min(slip, key=lambda each: slip[each]) if slip else ""
        largest = float(robot.torque_max[j])
        unit = units[j]
        if not name or slip[name] == float("inf"):
            rows.append((unit.label, f"{significant(largest)} {unit.torque}", DASH, DASH, DASH))
            continue
        if slip[name] <= largest:
            bad.add(len(rows))
        rows.append(
            (
                unit.label,
                f"{significant(largest)} {unit.torque}",
                name.replace("_", " "),
                f"{significant(slip[name], 3)} {unit.torque}",
                f"{slip[name] / largest:.2f}",
            )
        )
    head = ("joint", "largest torque", "slips first", "slip torque at the joint", "safety")
    return Table(head, tuple(rows), frozenset(bad))
