"""report.html of a diagnosis: missing effects with confidence, and their validation."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from stiffopt.discovery.answer import action, format_probability, place, statements
from stiffopt.discovery.diagnosis import Diagnosis, Finding
from stiffopt.discovery.identifiable import effect_checks
from stiffopt.recording.check import missing_signals
from stiffopt.recording.joint_facts import joint_facts
from stiffopt.recording.run import counted
from stiffopt.report.common.citations import diagnosis_references
from stiffopt.report.common.page import Filters, PageFigures, write_page
from stiffopt.report.common.text import capital
from stiffopt.report.diagnosis import changes, overview, words
from stiffopt.report.diagnosis.figures import (
    Trace,
    channel_ratio,
    held_out_figure,
    noise_ceiling_figure,
    overlay_figure,
    position_figure,
    proof_figure,
    residual_figure,
    state_figure,
    trace,
    worst_windows,
)
from stiffopt.report.diagnosis.law_section import law_figure, laws_on_page
from stiffopt.report.diagnosis.mismatch import mismatches
from stiffopt.report.diagnosis.positions import position_section, value_section
from stiffopt.report.diagnosis.regimes import (
    channel_residuals,
    map_figure,
    regime_figure,
    regressor_figure,
    spectrum_figure,
)
from stiffopt.report.diagnosis.sections import answer_sections

PAGE_FILE = "report.html"
# Findings with their own figures, and samples of a channel that these need.
_MAX_SHOWN_FINDINGS, _MIN_FIGURE_SAMPLES = 3, 50


def write_diagnosis_report(
    diagnosis: Diagnosis, directory: str | Path, *, png: bool = False
) -> Path:
    """Write report.html and its figures as SVG into `directory`; return the page.

    Parameters
    ----------
    diagnosis : Diagnosis
        Diagnosis of any verdict.
    png : bool
        Write the figures as PNG as well.
    """
    recordings, search = diagnosis.recordings, diagnosis.search
    trained = diagnosis.training.recorded
    order = [each.finding for each in statements(diagnosis)]
    shown = order[:_MAX_SHOWN_FINDINGS]
    overlays = _overlay_traces(diagnosis)
    figures = PageFigures("diagnosis", png=png)
    figures.draw("balances", residual_figure(diagnosis), "Residual over noise of all channels")
    for number, finding in enumerate(shown, start=1):
        _draw_finding(figures, diagnosis, finding, number)
    _draw_unexplained(figures, diagnosis)
    pair = diagnosis.compares_states
    if pair:
        figures.draw("states", state_figure(diagnosis), "Held-out residual in both states")
    if diagnosis.noise_ceiling is not None and diagnosis.noise_ceiling.depends:
        drawn = noise_ceiling_figure(diagnosis)
        figures.draw("dependence", drawn, "Black-box fit of the remaining residual")
    figures.draw("held_out", held_out_figure(diagnosis), "Residual over noise of held-out runs")
    caption = ""
    if leading := overlays.get("test") or overlays.get("extrapolate"):
        run, curve = leading
        figures.draw("proof", proof_figure(curve), "Residual of a held-out run, before and after")
        caption = (
            f"{capital(words.channel_words(curve.error.name))} in {run}, a run that no fit has "
            "seen: what the prediction leaves. The closer to zero, the better the model."
        )
    for role, (_, curve) in overlays.items():
        figures.draw(role, overlay_figure(curve), "Measured and predicted, before and after")
    if diagnosis.positions:
        drawn = position_figure(diagnosis.positions[0], recordings.joints, recordings.prismatic)
        figures.draw("positions", drawn, "Command, measured and simulated positions")
    context = {
        "diagnosis": diagnosis,
        "title": f"{recordings.title}: "
        + ("changes between two states" if pair else "diagnosis of the nominal model"),
        "headline": changes.change_headline(diagnosis) if pair else words.headline(diagnosis),
        "action": action(diagnosis),
        "paragraph": changes.change_lead(diagnosis) if pair else words.paragraph(diagnosis),
        "verdict": changes.change_verdict(diagnosis) if pair else words.verdict_words(diagnosis),
        "steady": not diagnosis.changes and diagnosis.verdict != "outside_catalogue"
        if pair
        else diagnosis.verdict == "nothing_missing",
        "pair": pair,
        "channel_outcomes": words.CHANNEL_OUTCOMES,
        "change_columns": changes.CHANGE_COLUMNS,
        "change_rows": changes.change_rows(diagnosis),
        "unchanged_rows": changes.unchanged_rows(diagnosis),
        "unexplained": words.unexplained_sentence(diagnosis),
        "mismatches": mismatches(diagnosis),
        "sections": answer_sections(diagnosis),
        "proof_caption": caption,
        "positions": position_section(diagnosis.positions, recordings.prismatic),
        "simulation": value_section(diagnosis.closed_loop, recordings.prismatic),
        "statements": {each.finding: each for each in statements(diagnosis)},
        "shown": shown,
        "laws": laws_on_page(diagnosis),
        "overlays": overlays,
        "worst": words.worst_channel(diagnosis, search.after)
        if _has_residuals(search.after)
        else None,
        "worst_ratio": words.worst_ratio(search.after),
        "encoders": sum(bool(name) for name in recordings.signals.link_position or ()),
        "channel_ratio": lambda role, name: channel_ratio(diagnosis.proofs(role), name),
        "windows": worst_windows(diagnosis),
        "limits": overview.limits_by_effect(diagnosis),
        "sharpest": overview.sharpest_limits(diagnosis),
        "moved": overview.moved_values(diagnosis),
        "bodies": overview.moved_bodies(diagnosis),
        "missing": missing_signals(
            recordings, [*trained, *(proof.run for proof in diagnosis.held_out)]
        ),
        "undetectable": overview.undetectable_effects(
            effect_checks(
                recordings, joint_facts(recordings, trained), len(trained), diagnosis.catalogue
            )
        ),
        "references": diagnosis_references(f.effect for f in diagnosis.findings),
    }
    filters: Filters = {
        "place": partial(place, diagnosis),
        "candidates": overview.candidates,
        "channel": words.channel_words,
        "channels": words.channels_in_words,
        "sure": format_probability,
        "counted": counted,
    }
    path = Path(directory) / PAGE_FILE
    return write_page("diagnosis/page.html.j2", path, context, figures, filters)


def _has_residuals(ratios: np.ndarray) -> bool:
    return bool(np.isfinite(ratios).any())


def _draw_finding(
    figures: PageFigures, diagnosis: Diagnosis, finding: Finding, number: int
) -> None:
    rows = channel_residuals(diagnosis, finding.channel)
    if len(rows.after) >= _MIN_FIGURE_SAMPLES:
        for name, figure, description in (
            ("regressor", regressor_figure, "Measured against the model of the finding"),
            ("regimes", regime_figure, "Residual over speed, load, position and other signals"),
            ("maps", map_figure, "Mean residual without and with the finding"),
        ):
            figures.draw(f"{name}_{number}", figure(diagnosis, rows, finding), description)
        drawn = law_figure(diagnosis, rows, finding)
        if drawn is not None:
            figures.draw(f"law_{number}", drawn, "Residual over the signals of the law")


def _draw_unexplained(figures: PageFigures, diagnosis: Diagnosis) -> None:
    """Draw the unexplained residual or, where nothing is missing, the worst channel."""
    unexplained, after = diagnosis.unexplained, diagnosis.search.after
    if unexplained is not None:
        rows = channel_residuals(diagnosis, unexplained.channels[0])
        if unexplained.period is not None:
            time = diagnosis.search.comparison.rows.sample_signal(lambda run: run.time)[rows.chosen]
            spectrum = spectrum_figure(rows, time, unexplained.period)
            figures.draw("spectrum", spectrum, "Share of the residual by frequency")
        figures.draw(
            "outside", regime_figure(diagnosis, rows, None), "Unexplained residual by regime"
        )
    if diagnosis.verdict == "nothing_missing" and _has_residuals(after):
        rows = channel_residuals(diagnosis, words.worst_channel(diagnosis, after))
        figures.draw("quiet", regime_figure(diagnosis, rows, None), "The worst channel by regime")


def _overlay_traces(diagnosis: Diagnosis) -> dict[str, tuple[str, Trace]]:
    """Return by role the first run that has the leading channel."""
    new, _ = words.new_and_unstated(diagnosis)
    if diagnosis.unexplained is not None and not new:
        name = diagnosis.unexplained.channels[0]
    elif found := statements(diagnosis):
        name = found[0].finding.channel
    else:
        name = words.worst_channel(diagnosis, diagnosis.search.before)
    traces: dict[str, tuple[str, Trace]] = {}
    for role in ("test", "extrapolate"):
        for proof in diagnosis.proofs(role):
            curve = trace(diagnosis, proof, name)
            if curve is not None:
                traces[role] = proof.run.name, curve
                break
    return traces
