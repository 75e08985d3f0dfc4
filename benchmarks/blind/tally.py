"""Counts over all cases: rates, targets, calibration, detection against severity."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.blind.score import CaseScore, FitScore, same, score_case
from benchmarks.blind.wilson import Rate, calibration_error

# What is asked for counts from this severity on.
COUNTED = 1.0


@dataclass(frozen=True, kw_only=True)
class Target:
    """One number asked of the tool, and what came out."""

    what: str
    wanted: str
    measured: str
    reached: bool | None


def score_all(folder: Path, *, residuals: bool = True) -> tuple[CaseScore, ...]:
    """Score every answered case of a key, by name; as `score_case`."""
    answered = sorted(p.parent.name for p in (folder / "answers").glob("*/time.json"))
    return tuple(score_case(folder, name, residuals=residuals) for name in answered)


def counted(scores: Sequence[CaseScore]) -> list[CaseScore]:
    """Cases that count: sealed, and seen by the oracle."""
    return [s for s in scores if s.sealed and not s.void]


def of_kind(scores: Sequence[CaseScore], kind: str, lowest: float = 0.0) -> list[CaseScore]:
    """Counted cases of a kind from a severity on."""
    return [s for s in counted(scores) if s.kind == kind and s.severity >= lowest]


def asked_of(scores: Sequence[CaseScore]) -> list[CaseScore]:
    """Cases with one effect that the numbers asked for are of."""
    return [s for s in of_kind(scores, "single", COUNTED) if s.suite != "sweep"]


def shares(scores: Sequence[CaseScore], role: str, *, torque: bool = False) -> np.ndarray:
    """Improvement over the oracle's of cases with one effect or two; no answer improves nothing."""
    found = []
    for s in scores:
        fit: FitScore | None = (s.torque_fit if torque else s.fit).get(role)
        found.append(0.0 if fit is None else fit.share)
    values = np.array(found, dtype=float)
    return values[np.isfinite(values)]


def targets(scores: Sequence[CaseScore]) -> list[Target]:
    """The numbers asked for, from all counted cases."""
    single = asked_of(scores)
    none = of_kind(scores, "none")
    outside = of_kind(scores, "outside", COUNTED)
    improved = shares([*single, *of_kind(scores, "pair", COUNTED)], "test")
    exact, alarms = Rate.of(s.exact for s in single), Rate.of(s.false_alarm for s in none)
    known = Rate.of(s.recognised for s in outside)
    cover = Rate.of(p.covered for s in single if s.exact for p in s.parameters)
    seconds = np.array([s.cpu if np.isfinite(s.cpu) else s.seconds for s in counted(scores)])
    slow = Rate.of(bool(t < 120.0) for t in seconds if np.isfinite(t))
    median = float(np.median(improved)) if improved.size else float("nan")
    allowed = 3.0 / 150.0
    return [
        _target(
            "cases with one effect, severity 1 and above",
            "120 or more",
            str(len(single)),
            len(single) >= 120,
            len(single),
        ),
        _target(
            "effect and joint named first",
            "85 % or more",
            str(exact),
            exact.share >= 0.85,
            exact.total,
        ),
        _target("cases with nothing missing", "150", str(len(none)), len(none) >= 150, len(none)),
        _target(
            "false alarms", "3 in 150 or fewer", str(alarms), alarms.share <= allowed, alarms.total
        ),
        _target(
            "outside the catalogue recognised, severity 1 and above",
            "70 % or more",
            str(known),
            known.share >= 0.70,
            known.total,
        ),
        _target(
            "improvement on test runs over the oracle's, median",
            "0.90 or more",
            f"{median:.3f} ({improved.size} cases)",
            median >= 0.90,
            improved.size,
        ),
        _target(
            "95 % intervals that hold the truth",
            "85 to 99 %",
            str(cover),
            0.85 <= cover.share <= 0.99,
            cover.total,
        ),
        _target(
            "cases answered within 120 s on one core",
            "all",
            f"{slow}, median {np.nanmedian(seconds):.0f} s, longest {np.nanmax(seconds):.0f} s"
            if slow.total
            else "none counted",
            slow.hits == slow.total,
            slow.total,
        ),
    ]


def _target(what: str, wanted: str, measured: str, reached: bool, count: int) -> Target:
    return Target(
        what=what, wanted=wanted, measured=measured, reached=bool(reached) if count else None
    )


@dataclass(frozen=True, kw_only=True)
class Line:
    """Rates of a group of cases with one effect."""

    group: str
    cases: int
    detected: Rate
    exact: Rate
    top3: Rate
    in_group: Rate
    joint: Rate
    family: Rate
    false_components: float
    share: float


def line(group: str, scores: Sequence[CaseScore]) -> Line:
    """Rates of some cases with one effect."""
    improved = shares(scores, "test")
    return Line(
        group=group,
        cases=len(scores),
        detected=Rate.of(s.detected for s in scores),
        exact=Rate.of(s.exact for s in scores),
        top3=Rate.of(s.top3 for s in scores),
        in_group=Rate.of(s.in_group for s in scores),
        joint=Rate.of(s.joint for s in scores),
        family=Rate.of(s.family for s in scores),
        false_components=float(np.mean([s.false_components for s in scores])) if scores else 0.0,
        share=float(np.median(improved)) if improved.size else float("nan"),
    )


def grouped(scores: Sequence[CaseScore], key: Callable[[CaseScore], str]) -> list[Line]:
    """A line for every value of a key, in the order of the values."""
    names = sorted({key(s) for s in scores})
    return [line(name, [s for s in scores if key(s) == name]) for name in names]


def curve(
    scores: Sequence[CaseScore], value: Callable[[CaseScore], float], edges: Sequence[float]
) -> list[tuple[float, Rate, Rate]]:
    """Geometric middle of every bin of a value, with rates of detection and of exact names."""
    out = []
    for low, high in itertools.pairwise(edges):
        own = [s for s in scores if low <= value(s) < high]
        if own:
            middle = float(np.exp(np.mean(np.log([max(value(s), 1e-9) for s in own]))))
            out.append((middle, Rate.of(s.detected for s in own), Rate.of(s.exact for s in own)))
    return out


def probabilities(
    scores: Sequence[CaseScore],
) -> tuple[float, list[tuple[float, float, int]]]:
    """Calibration error of the first findings' probabilities, and its bins."""
    own = [s for s in counted(scores) if s.kind == "single" and np.isfinite(s.probability)]
    return calibration_error([s.probability for s in own], [bool(s.exact) for s in own])


def wrong(score: CaseScore) -> bool:
    """Not what was asked for in a case of its kind."""
    right = {
        "none": score.false_alarm is False,
        "single": score.exact,
        "pair": score.both,
        "outside": score.recognised,
    }
    return not right[score.kind]


def reason(score: CaseScore) -> str:
    """Why a case was not answered right, as far as the answer tells."""
    if score.verdict is None:
        return f"no answer ({score.status})"
    if score.kind == "none":
        return "false alarm" + (f", probability {score.probability:.2f}" if score.said else "")
    if score.verdict == "nothing_missing":
        return f"not seen; the oracle sees it at {score.z:.0f} sigma"
    if score.verdict == "outside_catalogue":
        return "taken for something outside the catalogue"
    if score.kind == "outside":
        return "an effect of the catalogue imitates it"
    true, said = score.truth, score.said
    if not said:
        return "a law stands for it"
    if score.kind == "pair":
        missed = [t.label for t in true if not any(same(t, s) for s in said[:3])]
        return "not among the first three: " + ", ".join(missed)
    if any(same(true[0], s) for s in said[1:]):
        return "named, but not first"
    if any(same(true[0], r) for r in score.rivals):
        return "among what the answer calls indistinguishable"
    if said[0].effect == true[0].effect:
        return "right effect at a wrong place"
    place = "right" if (said[0].joint, said[0].link) == (true[0].joint, true[0].link) else "wrong"
    kind = "same" if score.family else "another"
    return f"{kind} family at the {place} place, the truth not among the rivals"
