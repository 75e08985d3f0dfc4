"""What `stiffopt diagnose` says on the terminal, while it works and when it is done."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.status import Status
from rich.table import Table
from rich.text import Text

from stiffopt.report.common.quantities import significant
from stiffopt.report.diagnosis.words import unexplained_sentence

if TYPE_CHECKING:
    from stiffopt.discovery.comparison.located_effect import LocatedEffect
    from stiffopt.discovery.diagnosis import Diagnosis, Finding

_VERDICTS = {
    "named": "Something is missing in the nominal model, and what it is was found.",
    "nothing_missing": "Nothing is missing: the nominal model within its tolerances explains the"
    " recordings.",
    "outside_catalogue": "Something is missing that no entry of the catalogue explains.",
}
_LOG_WIDTH = 160


class Sentences:
    """Context manager that is called with a sentence at every step.

    Parameters
    ----------
    title : str
    console : rich.console.Console or None
        None: standard error, so that standard output stays free for results.
    clock : callable
        Seconds; replaced in tests.

    Notes
    -----
    On a terminal the step stands in one line that moves; elsewhere each is a line of its own.
    """

    def __init__(
        self,
        title: str,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._title = title
        self._console = Console(stderr=True) if console is None else console
        self._clock = clock
        self._begin = clock()
        self._status: Status | None = None

    def __enter__(self) -> Sentences:
        if self._console.is_terminal:
            self._status = self._console.status(Text(self._title))
            self._status.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._status is not None:
            self._status.__exit__(kind, error, traceback)
            self._status = None

    def __call__(self, sentence: str) -> None:
        """Show a step; what was found stays on the screen."""
        line = f"{self._clock() - self._begin:.1f} s  {sentence}"
        if self._status is None:
            self._console.print(Text(line), soft_wrap=True)
            return
        self._status.update(Text(f"{self._title}: {line}"))
        if sentence.startswith("found "):
            self._console.print(Text(line), soft_wrap=True)


def print_diagnosis(diagnosis: Diagnosis, folder: Path) -> None:
    """Verdict, findings with deviations and rivals, fit on held-out runs, where the files are."""
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{diagnosis.verdict}: {_VERDICTS[diagnosis.verdict]}", markup=False)
    if diagnosis.findings:
        table = Table()
        for column in ("effect", "where", "parameters", "explains", "probability", "confused with"):
            table.add_column(column)
        for finding in diagnosis.findings:
            table.add_row(*_row(diagnosis, finding))
        wide = Console(highlight=False)
        (wide if wide.is_terminal else Console(highlight=False, width=_LOG_WIDTH)).print(table)
    if diagnosis.unexplained is not None:
        console.print(f"Unexplained the catalogue. {unexplained_sentence(diagnosis)}", markup=False)
    for role, meaning in (("test", "test"), ("extrapolate", "extrapolation")):
        if diagnosis.proofs(role):
            before, after = diagnosis.nrmse(role)
            console.print(
                f"Residual over noise on {meaning} runs: {significant(before, 3)} before,"
                f" {significant(after, 3)} after.",
                markup=False,
            )
    if diagnosis.next_experiment:
        console.print(f"Next: {diagnosis.next_experiment}", markup=False)
    for note in diagnosis.assumptions:
        console.print(f"Assumed: {note}", markup=False)
    broken = sum(fault.left_out for _, fault in diagnosis.faults)
    if diagnosis.faults:
        count = len(diagnosis.faults)
        console.print(
            f"Faults of the recordings: {count} ({broken} channels left out), in diagnosis.json.",
            markup=False,
        )
    console.print(f"Answer: {folder / 'diagnosis.json'}", markup=False)


def _row(diagnosis: Diagnosis, finding: Finding) -> list[str]:
    parameters = "\n".join(
        f"{p.name} {significant(p.value, 3)} ± {significant(p.sd, 2)} {p.unit}".rstrip()
        for p in finding.parameters
    )
    rivals = "\n".join(
        f"{rival.located.effect.name} {_place(diagnosis, rival.located)}"
        f" ({100 * rival.probability:.0f} %)"
        for rival in finding.rivals
    )
    return [
        finding.effect.name,
        _place(diagnosis, finding.located),
        parameters,
        f"{100 * finding.variance_explained:.0f} % of {finding.channel}",
        f"{100 * finding.probability:.0f} %",
        rivals or "–",
    ]


def _place(diagnosis: Diagnosis, located: LocatedEffect) -> str:
    if located.link is not None:
        return diagnosis.training.constants.links[located.link]
    if located.joint is None:
        return "robot"
    place = f"joint {located.joint + 1}"
    return place if located.run is None else f"{place}, {located.run}"
