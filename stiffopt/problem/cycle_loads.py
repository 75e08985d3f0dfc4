"""Loads of a cycle from move to move: what its events put on the flange and take off it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from stiffopt.errors import InputFileError
from stiffopt.problem.schema import PayloadSection, ProblemFile, ToolPointSection


@dataclass(frozen=True)
class CarriedLoad:
    """Bodies at the flange and the tool point."""

    body: PayloadSection | None
    part: PayloadSection | None
    tool: ToolPointSection
    # Of its last body in the file; not compared: equal loads share one robot.
    place: str = field(default="payload", compare=False)

    @property
    def mass(self) -> float:
        """Sum of the masses [kg]."""
        return sum(each.mass for each in (self.body, self.part) if each is not None)


def follow_loads(document: ProblemFile, path: Path) -> list[CarriedLoad]:
    """Load of each move of a cycle, and that after the last one.

    Raises `InputFileError`: an event is impossible: a part is put down that is not held or taken
    while another one is held, or the tool is changed then.
    """
    tool = document.tool
    loads = [
        CarriedLoad(
            document.payload,
            None,
            ToolPointSection(link=tool.link, offset=tool.offset, rpy=tool.rpy),
        )
    ]
    gripped_at = ""
    for number, move in enumerate(document.move, start=1):
        now, where = loads[-1], f"move[{number}]"
        if move.payload is not None and move.event not in ("grip", "tool_change"):
            raise InputFileError(
                path,
                f"{where}.payload",
                "belongs to a move whose event is grip (the part) or tool_change (the new tool).",
            )
        if move.tool is not None and move.event != "tool_change":
            raise InputFileError(
                path, f"{where}.tool", "belongs to a move whose event is tool_change."
            )
        if move.event == "grip":
            if now.part is not None:
                raise InputFileError(
                    path,
                    f"{where}.event",
                    f"the gripper still holds the part that it took at {gripped_at}. Release "
                    "that one before.",
                )
            if move.payload is None:
                raise InputFileError(
                    path, f"{where}.payload", "a grip needs the part: mass, com and inertia."
                )
            now = replace(now, part=move.payload, place=f"{where}.payload")
            gripped_at = where
        elif move.event == "release":
            if now.part is None:
                raise InputFileError(
                    path,
                    f"{where}.event",
                    "the gripper holds no part here: nothing was gripped before, or it was "
                    "put down already. Add a move with event = 'grip' and its payload before,"
                    " or leave this event out.",
                )
            now = replace(now, part=None, place=loads[0].place)
        elif move.event == "tool_change":
            if now.part is not None:
                raise InputFileError(
                    path,
                    f"{where}.event",
                    "the tool cannot be changed while the gripper holds the part that it took"
                    f" at {gripped_at}. Release it before.",
                )
            new = move.tool or ToolPointSection()
            now = CarriedLoad(move.payload, None, new, f"{where}.payload")
        loads.append(now)
    return loads
