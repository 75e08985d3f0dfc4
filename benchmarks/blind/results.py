"""The results page of a sealed run: every number beside its target, bad ones included."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.extras import extra_sections, table
from benchmarks.blind.figures import draw_all
from benchmarks.blind.score import CaseScore
from benchmarks.blind.tally import (
    Line,
    asked_of,
    counted,
    grouped,
    line,
    of_kind,
    probabilities,
    reason,
    score_all,
    shares,
    targets,
    wrong,
)
from benchmarks.blind.wilson import Rate

HERE = Path(__file__).parent
# A page replaces the published one only from so many sealed cases on.
PUBLISHED = 120
_CAPTIONS = {
    "confusion": "What was said first, against the truth (cases with two effects left out).",
    "detection": "Detection and right names against severity and against what the oracle sees.",
    "calibration": "Stated probability of the first finding against the share that was right.",
    "improvement": "Residual over noise on held-out runs, before and after; 1 is sensor noise.",
    "fits": "Held-out residuals before and after: from the worst case to the best.",
}


def main(folder: Path) -> Path:
    """Score a key and write its page; the published one too where enough cases are sealed.

    Parameters
    ----------
    folder : Path
        Of the key.

    Returns
    -------
    Path
        Of the page.
    """
    scores = score_all(folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["unmade"] = len(list((folder / "unmade").glob("*.json")))
    sealed = sum(s.suite == "main" for s in scores)
    development = bool(manifest.get("development", True))
    target = HERE if not development and sealed >= PUBLISHED else folder
    figures = draw_all(scores, folder, target / "figures")
    (target / "cases.csv").write_text(case_table(scores), encoding="utf-8")
    page = target / "RESULTS.md"
    page.write_text(results_page(scores, manifest, figures, extra_sections(folder)))
    return page


def results_page(
    scores: Sequence[CaseScore],
    manifest: dict[str, Any],
    figures: Sequence[str],
    extra: Sequence[str],
) -> str:
    """Text of the page, Markdown.

    Parameters
    ----------
    scores : sequence of CaseScore
    manifest : dict
        Key and sizes of the run.
    figures : sequence of str
        Names of those drawn.
    extra : sequence of str
        Sections on rivals, controls, ablation and real recordings.
    """
    parts = [
        _head(scores, manifest),
        _targets(scores),
        _rates(scores),
        *(f"![{_CAPTIONS[name]}](figures/{name}.svg)\n\n{_CAPTIONS[name]}\n" for name in figures),
        *extra,
        _failures(scores),
        _missed(scores),
        "What was tried about numbers that are not reached is in `README.md`.\n",
        "Every case with its severity, what the oracle sees and what was said: `cases.csv`.\n",
    ]
    return "\n".join(parts)


def _head(scores: Sequence[CaseScore], manifest: dict[str, Any]) -> str:
    broken = [s.id for s in scores if not s.sealed]
    void = [s.id for s in scores if s.void]
    failed = [s for s in scores if s.verdict is None]
    unmade = manifest.get("unmade", 0)
    lines = [
        "# Effects concealed from the tool: results\n",
        f"Key `{manifest['key']}`, commit `{manifest['commit']}`, {len(scores)} cases answered.",
    ]
    if manifest.get("development", True):
        lines.append("**Development results: the key was chosen, the cases were not sealed.**")
    lines += [
        f"Seals broken: {', '.join(broken) or 'none'}. Void, since the oracle itself stays above"
        f" 1.2 times the noise: {', '.join(void) or 'none'}. Without an answer, counted as wrong:"
        f" {len(failed)}. Planned, but with nothing that the oracle could see or the simulator"
        f" could make: {unmade}.",
        "\nIntervals are Wilson's, 95 %. Residuals are recomputed from the prediction files; the"
        " protocol is in `README.md`.\n",
    ]
    return "\n".join(lines)


def _targets(scores: Sequence[CaseScore]) -> str:
    words = {True: "reached", False: "**not reached**", None: "no cases"}
    rows = [[t.what, t.wanted, t.measured, words[t.reached]] for t in targets(scores)]
    return "## Against what was asked\n\n" + table(["", "asked", "measured", ""], rows)


def _cells(each: Line) -> list[object]:
    def short(rate: Rate) -> str:
        return f"{rate.hits}/{rate.total}" if rate.total else ""

    share = "" if np.isnan(each.share) else f"{each.share:.2f}"
    rates = (each.detected, each.exact, each.top3, each.in_group, each.joint, each.family)
    return [each.group, *(short(r) for r in rates), f"{each.false_components:.2f}", share]


def _rates(scores: Sequence[CaseScore]) -> str:
    own = of_kind(scores, "single")
    head = [
        "cases with one effect", "detected", "exact", "top 3", "in group", "joint", "family",
        "false components a case", "share on test, median",
    ]  # fmt: skip
    parts = ["## Rates\n"]
    if own:
        lines = [line("all", own)]
        lines += grouped(own, lambda s: f"severity {_step(s.severity)}")
        lines += grouped(own, lambda s: f"robot {s.robot}")
        lines += grouped(own, lambda s: f"{'with' if s.link_encoders else 'no'} link encoders")
        lines += grouped(own, lambda s: s.truth[0].effect)
        parts.append(table(head, [_cells(each) for each in lines]))
        parts.append(_summary(scores, own))
    pairs, outside = of_kind(scores, "pair"), of_kind(scores, "outside")
    none = of_kind(scores, "none")
    rows = [
        ["two effects: both with place", str(Rate.of(s.both for s in pairs))],
        ["two effects: false components a case", _mean([s.false_components for s in pairs])],
        ["outside: recognised", str(Rate.of(s.recognised for s in outside))],
        ["outside: noticed at all", str(Rate.of(s.detected for s in outside))],
        ["one effect: taken for outside",
         str(Rate.of(s.verdict == "outside_catalogue" for s in own))],
        ["nothing missing: false alarms", str(Rate.of(s.false_alarm for s in none))],
    ]  # fmt: skip
    parts.append(table(["", ""], rows))
    return "\n".join(parts)


def _summary(scores: Sequence[CaseScore], own: Sequence[CaseScore]) -> str:
    right = [p for s in own if s.exact for p in s.parameters]
    error = [p.error for p in right]
    calibration, _ = probabilities(scores)
    seconds = [s.seconds for s in counted(scores) if np.isfinite(s.seconds)]
    rows = [
        ["effect and joint first", str(Rate.of(s.exact for s in own))],
        ["in a group of at most four", str(Rate.of(s.in_group for s in own))],
        ["joint", str(Rate.of(s.joint for s in own))],
        ["relative error of parameters, median", _median(error)],
        ["95 % intervals that hold the truth", str(Rate.of(p.covered for p in right))],
        ["share of the oracle's improvement, test, median", _median(shares(own, "test"))],
        ["the same, extrapolation", _median(shares(own, "extrapolate"))],
        [
            "share of the change from nominal to true robot that is predicted, test, median",
            _median([s.added["test"] for s in own if "test" in s.added]),
        ],
        ["calibration error of probabilities", f"{calibration:.3f}"],
        ["wall time a case [s], median", _median(seconds)],
    ]
    return table(["one effect, all severities", ""], rows)


def _median(values: Sequence[float] | np.ndarray) -> str:
    return f"{np.median(values):.3g} ({len(values)} values)" if len(values) else "none counted"


def _mean(values: Sequence[float]) -> str:
    return f"{np.mean(values):.2f}" if values else "none counted"


def _step(severity: float) -> str:
    edges = (0.0, 0.3, 0.6, 1.0, 2.0)
    low = max(edge for edge in edges if edge <= severity)
    later = [edge for edge in edges if edge > low]
    return f"{low:g} to {later[0]:g}" if later else f"{low:g} and above"


def _failures(scores: Sequence[CaseScore]) -> str:
    own = [s for s in counted(scores) if wrong(s)]
    rows = [
        [
            s.id,
            ", ".join(n.label for n in s.truth) or "nothing missing",
            s.robot + ("" if s.link_encoders else ", no link encoders"),
            f"{s.severity:g}",
            f"{s.z:.0f}" if s.z else "",
            ", ".join(n.label for n in s.said) or s.verdict or s.status,
            ", ".join(n.label for n in s.rivals),
            reason(s),
        ]
        for s in own
    ]
    head = ["case", "truth", "robot", "severity", "oracle z", "said", "its rivals", "why"]
    body = table(head, rows) if rows else "None.\n"
    return f"## Failures one by one: {len(own)} of {len(counted(scores))} cases\n\n{body}"


def _missed(scores: Sequence[CaseScore]) -> str:
    """Intervals that do not hold the truth, of those that count."""
    every = [(s, p) for s in asked_of(scores) if s.exact for p in s.parameters]
    rows = [
        [
            s.id,
            s.truth[0].label,
            s.robot,
            p.name,
            f"{p.value:.3g} +- {p.sd:.2g}",
            f"{p.truth:.3g}",
            f"{abs(p.value - p.truth) / p.sd:.1f}" if p.sd else "",
            f"{100.0 * p.error:.0f} %",
        ]
        for s, p in every
        if not p.covered
    ]
    head = ["case", "truth", "robot", "parameter", "said", "true", "off, in sd", "off"]
    body = table(head, rows) if rows else "None.\n"
    return f"## Intervals that miss the truth: {len(rows)} of {len(every)}\n\n{body}"


def case_table(scores: Sequence[CaseScore]) -> str:
    """Every case on a line, comma separated."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        ["case", "kind", "robot", "severity", "link_encoders", "oracle_z", "truth", "verdict",
         "said", "rivals", "right", "test_before", "test_after", "test_oracle", "seconds"]
    )  # fmt: skip
    for s in scores:
        fit = s.fit.get("test")
        numbers = [""] * 3 if fit is None else [f"{v:.4g}" for v in vars(fit).values()]
        writer.writerow(
            [s.id, s.kind, s.robot, f"{s.severity:g}", s.link_encoders, f"{s.z:.3g}",
             "; ".join(n.label for n in s.truth), s.verdict or s.status,
             "; ".join(n.label for n in s.said), "; ".join(n.label for n in s.rivals),
             not wrong(s), *numbers, f"{s.seconds:.1f}"]
        )  # fmt: skip
    return stream.getvalue()
