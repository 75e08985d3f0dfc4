"""What is doubted of a recording set, with the evidence and the line to change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stiffopt.errors import InputFileError


@dataclass(frozen=True, kw_only=True)
class Doubt:
    """A description of the files that the files themselves contradict.

    Parameters
    ----------
    kind : str
        "position unit", "torque gain", "joint order", "gravity", ...
    joints : tuple of int
        From 1; empty where it is about the set as a whole.
    evidence : str
        What shows it, in a sentence.
    line : str
        Of recordings.toml, as it would have to be; "" where no line mends it.
    """

    kind: str
    joints: tuple[int, ...]
    evidence: str
    line: str

    def __str__(self) -> str:
        ending = f" If so, write {self.line}." if self.line else ""
        return f"{self.evidence}{ending}"

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self)


class DoubtfulRecordings(InputFileError):
    """Recordings that cannot be what their description says; nothing is diagnosed from them.

    Parameters
    ----------
    path : Path
        Of recordings.toml.
    doubts : sequence of Doubt
    """

    def __init__(self, path: Path, doubts: Sequence[Doubt]) -> None:
        self.doubts = tuple(doubts)
        lines = [doubt.line for doubt in doubts]
        # One line may mend several doubts: it stands beside the last of them.
        reasons = "".join(
            f"\n  {doubt if doubt.line not in lines[k + 1 :] else doubt.evidence}"
            for k, doubt in enumerate(doubts)
        )
        super().__init__(
            path,
            "",
            "no diagnosis is made of recordings that do not fit their description. Nothing was"
            f" changed in them; check this first:{reasons}\nIf all is as the file says, diagnose"
            " with --despite-doubts.",
        )
