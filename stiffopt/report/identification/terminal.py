"""What `stiffopt identify-stiffness` prints."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from stiffopt.identification.result import StaticStiffness
from stiffopt.report.identification.page import error_sentence, headline, stiffness_table

# In a file or a log numbers must not be cut.
_LOG_WIDTH = 160


def print_static(result: StaticStiffness, folder: Path) -> None:
    """Stiffness of the joints, errors, the verdict on torque dependence, where the files are."""
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{headline(result)}. {error_sentence(result)}", markup=False)
    content = stiffness_table(result)
    shown = [k for k in range(len(content.head)) if k != 1]
    short = {7: "softer by"}
    table = Table(box=None, pad_edge=False)
    for k in shown:
        table.add_column(short.get(k, content.head[k]), justify="left" if k in (0, 2) else "right")
    for row in content.rows:
        table.add_row(*(row[k] for k in shown))
    wide = Console(highlight=False)
    if not wide.is_terminal:
        wide = Console(highlight=False, width=_LOG_WIDTH)
    wide.print(table)
    for joint in result.joints:
        if joint.reason:
            console.print(f"J{joint.joint}: {joint.reason}", markup=False)
    if result.outliers:
        poses = ", ".join(map(str, result.outliers))
        console.print(f"Poses that do not fit the others: {poses}", markup=False)
    console.print(f"Torque-dependent stiffness: {result.torque_dependence.sentence}", markup=False)
    console.print(f"Report: {folder / 'report.html'}", markup=False)
