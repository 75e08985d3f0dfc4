"""report.html of a diagnosis: what is missing, where, how sure, and the proof of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from stiffopt.discovery.identifiable import effect_checks
from stiffopt.files import atomic_write
from stiffopt.recording.check import missing_signals
from stiffopt.recording.facts import joint_facts
from stiffopt.recording.run import counted
from stiffopt.report.common.citations import diagnosis_references
from stiffopt.report.common.quantities import significant
from stiffopt.report.common.rendering import PageFigure, page_figure, write_page
from stiffopt.report.common.svg import extent_of, to_png, to_svg
from stiffopt.report.diagnosis.figures import balances_figure, held_out_figure
from stiffopt.report.diagnosis.motion import overlay_figure, trace, worst_windows
from stiffopt.report.diagnosis.regimes import (
    map_figure,
    regime_figure,
    regressor_figure,
    spectrum_figure,
)
from stiffopt.report.diagnosis.residuals import channel_rows, worst_channel
from stiffopt.report.diagnosis.tables import (
    calibration_table,
    candidates_table,
    channels_table,
    faults_table,
    findings_table,
    limits_table,
    runs_table,
    sharpest,
    undetectable_table,
    windows_table,
)
from stiffopt.report.diagnosis.words import (
    VERDICTS,
    channels_in_words,
    headline,
    lead,
    new_and_unstated,
    percent_sure,
    phrase,
    place,
    proof_sentence,
    unexplained_sentence,
    worst_ratio,
)

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis, Finding

PAGE_FILE = "report.html"
# Findings that are shown with figures of their own.
_SHOWN = 3


class Files(dict[str, str | bytes]):
    """Contents of figures by file name; as PNG, too, where that is asked."""

    def __init__(self, png: bool) -> None:
        super().__init__()
        self.png = png


def write_diagnosis_report(
    diagnosis: Diagnosis, directory: str | Path, *, png: bool = False
) -> Path:
    """Write report.html and its figures as SVG into `directory`; return the page.

    Parameters
    ----------
    diagnosis : Diagnosis
        Of any verdict.
    directory : path
    png : bool
        Write the figures as PNG as well.

    Returns
    -------
    Path
    """
    files = Files(png)
    recordings = diagnosis.recordings
    trained = diagnosis.training.recorded
    runs = [*trained, *(proof.run for proof in diagnosis.held_out)]
    checks = effect_checks(
        recordings, joint_facts(recordings, trained), len(trained), diagnosis.catalogue
    )
    windows = worst_windows(diagnosis)
    context = {
        "title": f"{recordings.title}: what the nominal model lacks",
        "headline": headline(diagnosis),
        "lead": lead(diagnosis),
        "verdict": VERDICTS[diagnosis.verdict],
        "good": diagnosis.verdict == "nothing_missing",
        "proof": proof_sentence(diagnosis),
        "base": diagnosis.model or "",
        "tiles": _tiles(diagnosis),
        "findings": findings_table(diagnosis),
        "balances": _saved(
            balances_figure(diagnosis),
            "diagnosis_balances",
            "Where it shows" if diagnosis.verdict != "nothing_missing" else "All balances",
            "Training runs: root mean square of the filtered residual over noise, of the torque "
            "and of the wind-up seen by the link encoder. 1 is the noise.",
            files,
        ),
        "sections": list(_sections(diagnosis, files)),
        "outside": unexplained_sentence(diagnosis),
        "outside_figures": _outside_figures(diagnosis, files),
        "quiet": _quiet(diagnosis, files),
        "held_out": _saved(
            held_out_figure(diagnosis),
            "diagnosis_held_out",
            "",
            "Runs that no fit has seen, as measured and not filtered. Torque counts while the "
            "joint moves.",
            files,
        ),
        "overlays": list(_overlays(diagnosis, files)),
        "channels": channels_table(diagnosis),
        "runs": runs_table(diagnosis),
        "windows": windows_table(windows),
        "sharpest": sharpest(diagnosis),
        "limits": limits_table(diagnosis),
        "calibration": calibration_table(diagnosis),
        "missing": missing_signals(recordings, runs),
        "untold": undetectable_table(checks),
        "faults": faults_table(diagnosis),
        "left_out": sum(fault.left_out for _, fault in diagnosis.faults),
        "assumptions": diagnosis.assumptions,
        "next": diagnosis.next_experiment,
        "source": ". ".join(
            part
            for part in (
                recordings.citation.rstrip("."),
                f"Licence: {recordings.licence}" if recordings.licence else "",
            )
            if part
        ),
        "references": diagnosis_references(f.effect for f in diagnosis.findings),
        "settings": diagnosis.settings,
    }
    return _written(context, files, Path(directory))


def _tiles(diagnosis: Diagnosis) -> list[dict[str, str]]:
    tiles = []
    new, unstated = new_and_unstated(diagnosis)
    for finding in (new or unstated)[:2]:
        sure = percent_sure(finding.probability) if finding.rivals else "no rival near"
        name = finding.effect.title
        note = f"{name}, {place(diagnosis, finding.located)}"
        tiles.append({"name": "how sure", "value": sure, "note": note})
    for role, words in (("test", "test runs"), ("extrapolate", "extrapolation")):
        if diagnosis.proofs(role):
            before, after = (significant(v, 2) for v in diagnosis.nrmse(role))
            tiles.append(
                {
                    "name": f"residual over noise, {words}",
                    "value": f"{before} → {after}",
                    "note": "before → after; 1 is the noise",
                }
            )
    tiles.append(
        {
            "name": "worst channel, training",
            "value": f"{significant(worst_ratio(diagnosis.search.after), 2)} × noise",
            "note": channels_in_words([worst_channel(diagnosis, diagnosis.search.after)])[4:]
            + ", filtered",
        }
    )
    recordings = diagnosis.recordings
    link = recordings.signals.link_position
    encoders = sum(bool(name) for name in link or ())
    tiles.append(
        {
            "name": "recordings",
            "value": f"{len(diagnosis.training.recorded)} + {len(diagnosis.held_out)} runs",
            "note": f"to fit + held out; {counted(recordings.n, 'joint')}, "
            + (counted(encoders, "link encoder") if encoders else "no link encoders"),
        }
    )
    return tiles


def _sections(diagnosis: Diagnosis, files: Files) -> Iterator[dict[str, Any]]:
    """One section a finding, those that say something new first."""
    new, unstated = new_and_unstated(diagnosis)
    for number, finding in enumerate([*new, *unstated][:_SHOWN], 1):
        effect = finding.effect
        where = place(diagnosis, finding.located)
        yield {
            "title": f"{where[0].upper()}{where[1:]}: {phrase(finding, finding in unstated)}",
            "effect": effect.title,
            "equation": effect.equation,
            "signature": effect.signature,
            "evidence": f"{finding.log_evidence:.0f}",
            "candidates": candidates_table(diagnosis, finding),
            "figures": list(_finding_figures(diagnosis, finding, number, files)),
        }


def _finding_figures(
    diagnosis: Diagnosis, finding: Finding, number: int, files: Files
) -> Iterator[PageFigure]:
    rows = channel_rows(diagnosis, finding.channel)
    if len(rows.after) < 50:
        return
    channel = channels_in_words([finding.channel])
    name = finding.effect.title
    yield _saved(
        regressor_figure(diagnosis, rows, finding),
        f"diagnosis_regressor_{number}",
        "Measured against the model of the finding",
        f"Residual of {channel} in the training runs with everything else explained. Left: against "
        f"what {name} adds by its fitted formula; points on the red line are explained. Right: its "
        "distribution.",
        files,
    )
    yield _saved(
        regime_figure(diagnosis, rows, finding),
        f"diagnosis_regimes_{number}",
        "Where in the motion it shows",
        f"Means of the same residual of {channel} with ±2 standard deviations of the mean, by "
        "direction of motion. The lines are the fitted model of the finding; what they do not "
        "follow, it does not explain.",
        files,
    )
    yield _saved(
        map_figure(diagnosis, rows, finding),
        f"diagnosis_maps_{number}",
        "",
        f"Mean residual of {channel} over noise without and with the finding; white cells are "
        "explained or were not visited.",
        files,
    )


def _outside_figures(diagnosis: Diagnosis, files: Files) -> list[PageFigure]:
    unexplained = diagnosis.unexplained
    if unexplained is None:
        return []
    rows = channel_rows(diagnosis, unexplained.channels[0])
    channel = channels_in_words(unexplained.channels[:1])
    figures = []
    if unexplained.period is not None:
        time = diagnosis.search.comparison.rows.sampled(lambda run: run.time)[rows.chosen]
        figures.append(
            _saved(
                spectrum_figure(rows, time, unexplained.period),
                "diagnosis_spectrum",
                "It repeats in time",
                f"Share of what is left of {channel} that a wave of each frequency explains, its "
                "phase free in every run. The dashed line is the period that all runs share.",
                files,
            )
        )
    title = "It does not follow the motion" if unexplained.period else "What it follows"
    if unexplained.brief:
        title = "Below the filter's cutoff it leaves nothing"
    figures.append(
        _saved(
            regime_figure(diagnosis, rows, None),
            "diagnosis_outside",
            title,
            f"Mean of what is left of {channel}, with ±2 standard deviations of the mean, by "
            "direction of motion.",
            files,
        )
    )
    return figures


def _quiet(diagnosis: Diagnosis, files: Files) -> PageFigure | None:
    """Of a set in which nothing is missing: its worst channel, which should show no pattern."""
    if diagnosis.verdict != "nothing_missing" or not np.isfinite(diagnosis.search.after).any():
        return None
    name = worst_channel(diagnosis, diagnosis.search.after)
    return _saved(
        regime_figure(diagnosis, channel_rows(diagnosis, name), None),
        "diagnosis_quiet",
        "The worst channel",
        f"Mean of what is left of {channels_in_words([name])}, the channel with the largest "
        "residual over noise, with ±2 standard deviations of the mean.",
        files,
    )


def _overlays(diagnosis: Diagnosis, files: Files) -> Iterator[PageFigure]:
    """One test run and one extrapolation run in the channel that the answer is about."""
    new, unstated = new_and_unstated(diagnosis)
    if diagnosis.unexplained is not None and not new:
        name = diagnosis.unexplained.channels[0]
    elif new or unstated:
        name = (new or unstated)[0].channel
    else:
        name = worst_channel(diagnosis, diagnosis.search.before)
    for role, words in (("test", "Test run"), ("extrapolate", "Extrapolation run")):
        for proof in diagnosis.proofs(role):
            shown = trace(diagnosis, proof, name)
            if shown is None:
                continue
            kind = "" if shown.error.kind == "torque" else " Wind-up: motor less link angle."
            yield _saved(
                overlay_figure(shown),
                f"diagnosis_{role}",
                f"{words} {proof.run.name}, {channels_in_words([name])}",
                "Measured and predicted from the motor's motion alone, before and after; below, "
                f"what is left.{kind} Residuals of torque are shown while the joint moves.",
                files,
            )
            break


def _saved(figure: Figure, name: str, title: str, caption: str, files: Files) -> PageFigure:
    extent = extent_of(figure)
    svg = to_svg(figure, name, title or caption, extent)
    files[f"{name}.svg"] = svg
    if files.png:
        files[f"{name}.png"] = to_png(figure, extent)
    return page_figure(svg, caption, title)


def _written(context: dict[str, Any], files: Files, folder: Path) -> Path:
    """Write figures, then the page; an interruption takes back what is new."""
    page = folder / PAGE_FILE
    new = [path for name in (*files, PAGE_FILE) if not (path := folder / name).exists()]
    try:
        for name, content in files.items():
            atomic_write(folder / name, content)
        return write_page("diagnosis.html.j2", page, context)
    except BaseException:
        for path in new:
            path.unlink(missing_ok=True)
        raise
