"""Tables of a diagnosis: findings, rivals, channels, limits, and what the recordings lack."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.report.common.quantities import significant
from stiffopt.report.diagnosis.figures import channel_ratio
from stiffopt.report.diagnosis.motion import Window
from stiffopt.report.diagnosis.words import (
    channels_in_words,
    fall,
    is_unstated,
    own_unit,
    percent_sure,
    place,
    prismatic,
    scaled_unit,
    with_deviation,
)
from stiffopt.report.solve.tables import DASH, Table

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis, Finding
    from stiffopt.discovery.identifiable import EffectCheck
    from stiffopt.discovery.judging.detection import DetectionLimit

# Standard deviations from which a nominal value that moved is marked.
_FAR = 3.0
# Speed below which a joint as good as stands [rad/s].
_STILL = 0.02


def findings_table(diagnosis: Diagnosis) -> Table | None:
    """Findings with parameters, their standard deviations, and how sure they are."""
    rows = [
        (
            place(diagnosis, f.located),
            f.effect.title + (" (no nominal value)" if is_unstated(diagnosis, f) else ""),
            _parameters(diagnosis, f),
            f"{f.significance:.0f} sd",
            channels_in_words([f.channel])[4:],
            " → ".join(significant(v, 2) for v in fall(diagnosis, f.channel)),
            f"{100 * f.variance_explained:.0f} %",
            percent_sure(f.probability) if f.rivals else "no rival",
        )
        for f in diagnosis.findings
    ]
    head = (
        "where",
        "effect",
        "parameters, ± one standard deviation",
        "from nothing",
        "shows in",
        "residual over noise",
        "share, left out",
        "probability",
    )
    return Table(head, tuple(rows)) if rows else None


def _parameters(diagnosis: Diagnosis, finding: Finding) -> str:
    slides = prismatic(diagnosis, finding.located)
    return ", ".join(
        f"{p.name} = {with_deviation(p.value, p.sd, own_unit(p.unit, slides))}"
        for p in finding.parameters
    )


def candidates_table(diagnosis: Diagnosis, finding: Finding) -> Table:
    """A finding and its rivals by probability."""
    every = [(finding.located, finding.probability)]
    every += [(rival.located, rival.probability) for rival in finding.rivals]
    every.sort(key=lambda pair: -pair[1])
    rows = tuple(
        (
            str(rank),
            located.effect.title,
            place(diagnosis, located),
            percent_sure(share),
            located.effect.signature,
        )
        for rank, (located, share) in enumerate(every, 1)
    )
    return Table(("", "effect", "where", "probability", "how it shows"), rows)


def channels_table(diagnosis: Diagnosis) -> Table:
    """Root mean square residual of every channel on test and extrapolation runs."""
    roles = [role for role in ("test", "extrapolate") if diagnosis.proofs(role)]
    head = ["channel", "noise"]
    for role in roles:
        words = "test" if role == "test" else "extrapolation"
        head += [f"{words}, before", "after", "after over noise"]
    rows, bad = [], set()
    for number, fit in enumerate(diagnosis.channels):
        factor, unit = scaled_unit(fit.rms_before, fit.unit)
        line = [
            channels_in_words([fit.channel])[4:],
            f"{significant(factor * fit.noise, 2)} {unit}",
        ]
        for role in roles:
            before, after = channel_ratio(diagnosis, role, fit.channel)
            line += [significant(factor * fit.noise * v, 3) for v in (before, after)]
            line.append(significant(after, 3))
            if after > 2.0:
                bad.add(number)
        rows.append(tuple(line))
    return Table(tuple(head), tuple(rows), frozenset(bad))


def runs_table(diagnosis: Diagnosis) -> Table:
    """Residual over noise of every held-out run."""
    words = {"test": "test", "extrapolate": "extrapolation"}
    rows = tuple(
        (
            proof.run.name,
            words[proof.run.role],
            f"{proof.run.duration:.3g} s",
            significant(proof.nrmse_before, 3),
            significant(proof.nrmse_after, 3),
        )
        for proof in diagnosis.held_out
    )
    return Table(("run", "role", "length", "residual over noise, before", "after"), rows)


def limits_table(diagnosis: Diagnosis) -> Table | None:
    """Least value that would have been seen, effects by joints."""
    n = diagnosis.recordings.n
    joints = diagnosis.training.constants.joints
    by_effect: dict[tuple[str, str], dict[int | None, str]] = {}
    for limit in diagnosis.detection_limits:
        slides = limit.joint is not None and joints[limit.joint - 1].prismatic
        cells = by_effect.setdefault((limit.effect.title, limit.parameter), {})
        cells[limit.joint] = _limit(limit, own_unit(limit.unit, slides))
    rows = []
    for (effect, parameter), cells in by_effect.items():
        if None in cells:
            line = [cells[None], *[DASH] * (n - 1)] if n > 1 else [cells[None]]
            rows.append((f"{effect}, whole robot", parameter, *line))
        else:
            rows.append((effect, parameter, *(cells.get(j + 1, DASH) for j in range(n))))
    head = ("effect", "parameter", *(f"J{j + 1}" for j in range(n)))
    return Table(head, tuple(rows)) if rows else None


def _limit(limit: DetectionLimit, unit: str) -> str:
    factor, name = scaled_unit(limit.value, unit)
    text = f"{significant(factor * limit.value, 2)} {name}".strip()
    return text if limit.relative is None else f"{text} ({significant(100 * limit.relative, 2)} %)"


def sharpest(diagnosis: Diagnosis) -> list[str]:
    """Sentences about the smallest relative changes that would have been seen."""
    known = [limit for limit in diagnosis.detection_limits if limit.relative is not None]
    best: dict[str, DetectionLimit] = {}
    for limit in sorted(known, key=lambda each: each.relative or 0.0):
        best.setdefault(limit.effect.nominal_words, limit)
    return [
        f"A change of {name} above "
        f"{significant(100 * (limit.relative or 0.0), 2)} % on joint {limit.joint} would have been "
        "seen."
        for name, limit in best.items()
    ]


def calibration_table(diagnosis: Diagnosis) -> Table | None:
    """Nominal values that were moved most, over their tolerances."""
    names, sd, _ = diagnosis.search.comparison.nuisance
    moved = diagnosis.search.fit.posterior.mean[: len(names)]
    order = np.argsort(-np.abs(moved / sd))[:12]
    rows, bad = [], set()
    for number, k in enumerate(order):
        far = moved[k] / sd[k]
        kind = names[k].split()[0]
        unit = {"com": "m", "encoder_zero": "rad"}.get(kind)
        if unit is None:
            factor, unit = 100.0, "%"
        else:
            factor, unit = scaled_unit(sd[k], unit)
        sign = "+" if moved[k] > 0.0 else ""
        shown = f"{sign}{significant(factor * moved[k], 2)} {unit}"
        width = f"{significant(factor * sd[k], 2)} {unit}"
        rows.append((names[k].replace("_", " "), shown, width, f"{far:+.1f}"))
        if abs(far) > _FAR:
            bad.add(number)
    head = ("nominal value", "moved by", "tolerance, one sd", "in standard deviations")
    return Table(head, tuple(rows), frozenset(bad)) if rows else None


def windows_table(windows: Sequence[Window]) -> Table | None:
    """Where and when the extended model is worst."""
    rows = []
    for window in windows:
        factor, unit = scaled_unit(window.rms, window.unit)
        speeds = f"{significant(window.slowest, 2)} to {significant(window.fastest, 2)}"
        if window.slowest < -_STILL and window.fastest > _STILL:
            speeds += ", reverses"
        elif window.slowest < _STILL and window.fastest > -_STILL:
            speeds += ", comes to rest or leaves it"
        rows.append(
            (
                window.run,
                channels_in_words([window.error.name])[4:],
                f"{window.begin:.2f} to {window.end:.2f} s",
                f"{significant(factor * window.rms, 3)} {unit}",
                f"{significant(window.ratio, 2)} times",
                speeds,
            )
        )
    head = ("run", "channel", "when", "residual, rms", "over noise", "joint speed [rad/s or m/s]")
    return Table(head, tuple(rows)) if rows else None


def undetectable_table(checks: Sequence[EffectCheck]) -> Table | None:
    """Effects that could not have been found, on which joints, and why."""
    groups: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    for check in checks:
        if not check.possible:
            groups.setdefault((check.effect.title, check.lacks), []).append(check.joint or 0)
    merged: dict[tuple[tuple[str, ...], tuple[int, ...]], list[str]] = {}
    for (effect, lacks), joints in groups.items():
        merged.setdefault((lacks, tuple(joints)), []).append(effect)
    rows = tuple(
        (
            "robot" if joints == (0,) else ", ".join(f"J{j}" for j in joints),
            "; ".join(lacks),
            ", ".join(effects),
        )
        for (lacks, joints), effects in merged.items()
    )
    return Table(("where", "because", "cannot be told"), rows) if rows else None


def faults_table(diagnosis: Diagnosis) -> Table | None:
    """Faults of the recordings; channels that were left out are marked."""
    rows = tuple((run, fault.channel, fault.detail) for run, fault in diagnosis.faults)
    bad = frozenset(k for k, (_, fault) in enumerate(diagnosis.faults) if fault.left_out)
    return Table(("run", "channel", "what is wrong"), rows, bad) if rows else None
