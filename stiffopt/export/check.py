"""Check of exported motions: integrity, origin and limits."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.errors import InputFileError, format_relative
from stiffopt.export.folder_motions import read_stored
from stiffopt.export.format import FORMATS, UNSEALED_SUFFIXES, is_whole, read_seal
from stiffopt.files import read_text

# Relative and absolute tolerance of numbers against a fresh export: rounding of other processors.
_NUMBER_TOLERANCE = 1e-9
_NUMBER_PATTERN = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
# Hashes of the header, in the order of comparison: the first difference names the cause.
_SEAL_SUBJECTS = ("payload", "robot", "limits", "motion")


@dataclass(frozen=True, kw_only=True)
class CheckedMotion:
    """Exported motion that is unchanged and keeps its limits."""

    # Name of `--to`, "motor" or "link", title of the result, name of the robot.
    format: str
    which: str
    title: str
    robot: str
    payload: float | None  # [kg]
    rate: float  # [Hz]
    duration: float  # [s]
    samples: int
    tightest: str  # description of the limit with the least margin


def check_file(file: Path, result: Path, problem: Path | None = None) -> CheckedMotion:
    """Check an exported file against its result, whose motion is assessed again.

    `result`: folder of the solve. `problem`: problem file in place of that of the result. Raises
    `InputError`: the file has no header, was changed, or belongs to another result; or the motion
    of the result is not the certified one.
    """
    entries, body = read_seal(read_text(file))
    kind, which = entries.get("format", ""), entries.get("of", "")
    rate = _read_rate(entries)
    if file.suffix in UNSEALED_SUFFIXES:
        raise InputFileError(
            file, "", "cannot be checked: this format has no room for the header of `stiffopt "
            "export`. Export the motion again, and compare both files."
        )  # fmt: skip
    if kind not in FORMATS or which not in ("motor", "link") or rate is None:
        raise InputFileError(
            file, "", "has no header of `stiffopt export`, as exported motions have. Export the "
            "motion again; `stiffopt solve` checks a problem file."
        )  # fmt: skip
    if not is_whole(entries, body):
        raise InputFileError(
            file, "", "was changed after its export: the hash of its header is that of another "
            "content. Export the motion again."
        )  # fmt: skip
    if not any(
        (result / name).is_file() for name in ("result.json", "cycle.json", "improvement.json")
    ):
        raise InputFileError(
            file, "", f"{result} has no result.json to compare with. Give the folder of its solve "
            "as --result."
        )  # fmt: skip
    stored = read_stored(result, "link" if which == "link" else "motor", problem)
    for subject in _SEAL_SUBJECTS:
        if entries.get(subject) != stored.seal[subject]:
            verb = "are" if subject == "limits" else "is"
            raise InputFileError(
                file, "", f"its {subject} {verb} not that of {result}: it belongs to another "
                "solve. Give that solve as --result, or export again."
            )  # fmt: skip
    texts = FORMATS[kind].export(stored, rate)
    fresh = texts.get(entries.get("file", ""))
    if fresh is None or not _equal_numbers(body, read_seal(fresh)[1]):
        raise InputFileError(
            file, "", f"is not the motion of {result}, although its header matches. Export the "
            "motion again."
        )  # fmt: skip
    motion = FORMATS[kind].sample(stored, rate)
    tightest = stored.judge(motion)
    payload = stored.problem.robot.payload
    return CheckedMotion(
        format=kind,
        which=which,
        title=stored.title,
        robot=stored.problem.robot.name,
        payload=None if payload is None else float(payload[0]),
        rate=rate,
        duration=float(motion.time[-1]),
        samples=len(motion.time),
        tightest=f"{tightest.limit.replace('_', ' ')} of joint {tightest.joint} at "
        f"{tightest.time:.3f} s, {_format_margin(tightest.value)}",
    )


def _format_margin(value: float) -> str:
    """Format a violation within the certificate's tolerance."""
    if value > 0.0:
        tolerance = f"the certificate's tolerance of {CERTIFICATE_TOLERANCE:.1%}"
        return f"over by {format_relative(value)}, within {tolerance}"
    return f"{format_relative(-value)} left"


def _read_rate(entries: dict[str, str]) -> float | None:
    """Read the rate [Hz] of a header; None without a number."""
    try:
        return float(entries["rate"])
    except (KeyError, ValueError):
        return None


def _equal_numbers(one: str, other: str) -> bool:
    """Return True if two texts differ only by rounding of their numbers."""
    if one == other:
        return True
    if _NUMBER_PATTERN.sub("#", one) != _NUMBER_PATTERN.sub("#", other):
        return False
    own, wanted = (np.array(_NUMBER_PATTERN.findall(text), dtype=float) for text in (one, other))
    return bool(np.allclose(own, wanted, rtol=_NUMBER_TOLERANCE, atol=_NUMBER_TOLERANCE))
