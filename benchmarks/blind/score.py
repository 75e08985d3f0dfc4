"""What an answer is worth: the seal, the names, the parameters and the recomputed residuals."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.families import family

# Groups of explanations larger than this name nothing.
LARGEST_GROUP = 4
# Slower than this the torque of a joint is undetermined [rad/s].
MOVING = 0.03
# Verdicts whose findings are claims.
NAMING_VERDICTS = ("named", "law_found")
# Names of laws that the tool found by itself.
LAW_PREFIX = "law_"


@dataclass(frozen=True)
class Named:
    """An effect and its place: joint from 1, or link, or neither; a run where it has one."""

    effect: str
    joint: int | None = None
    link: str | None = None
    run: str | None = None

    @classmethod
    def read(cls, entry: dict[str, Any]) -> Named:
        """From a line of a truth or of an answer."""
        return cls(entry["effect"], entry.get("joint"), entry.get("link"), entry.get("run"))

    @property
    def label(self) -> str:
        place = self.link or (f"J{self.joint}" if self.joint else "")
        return " ".join(part for part in (self.effect, place, self.run) if part)


@dataclass(frozen=True, kw_only=True)
class ParameterScore:
    """A reported value beside the true one [unit of the parameter]."""

    name: str
    value: float
    sd: float
    truth: float

    @property
    def error(self) -> float:
        """Relative."""
        return abs(self.value / self.truth - 1.0)

    @property
    def covered(self) -> bool:
        """The 95 % interval holds the truth."""
        return abs(self.value - self.truth) <= 1.96 * self.sd


@dataclass(frozen=True, kw_only=True)
class FitScore:
    """Residual over noise of the held-out runs of a role, recomputed from predictions."""

    before: float
    after: float
    oracle: float

    @property
    def share(self) -> float:
        """Improvement of the squared residual over that of the oracle; nan where it has none."""
        room = self.before**2 - self.oracle**2
        return (self.before**2 - self.after**2) / room if room > 0.0 else float("nan")


@dataclass(frozen=True, kw_only=True)
class CaseScore:
    """All that is counted of one case.

    Answers that do not apply to a kind of case are None: `exact` where nothing is missing,
    `false_alarm` where something is. `added`: by role, the share of what separates the nominal
    robot from the true one that the answer adds to the nominal model.
    """

    id: str
    suite: str
    kind: str
    robot: str
    severity: float
    link_encoders: bool
    z: float
    sealed: bool
    void: bool
    status: str
    truth: tuple[Named, ...]
    verdict: str | None
    said: tuple[Named, ...] = ()
    rivals: tuple[Named, ...] = ()
    detected: bool | None = None
    exact: bool | None = None
    top3: bool | None = None
    in_group: bool | None = None
    joint: bool | None = None
    family: bool | None = None
    false_alarm: bool | None = None
    recognised: bool | None = None
    both: bool | None = None
    false_components: int = 0
    probability: float = float("nan")
    parameters: tuple[ParameterScore, ...] = ()
    fit: dict[str, FitScore] = field(default_factory=dict)
    torque_fit: dict[str, FitScore] = field(default_factory=dict)
    added: dict[str, float] = field(default_factory=dict)
    seconds: float = float("nan")
    cpu: float = float("nan")


def score_case(folder: Path, name: str, *, residuals: bool = True) -> CaseScore:
    """Open the seal of one answered case and count.

    Parameters
    ----------
    folder : Path
        Of a key, with cases, truth, oracle and answers.
    name : str
        Of the case.
    residuals : bool
        Recompute them, which takes the most of the time.
    """
    text = (folder / "truth" / f"{name}.json").read_bytes()
    truth = json.loads(text)
    commitment = (folder / "cases" / name / "commitment.txt").read_text().split()[0]
    oracle = _json(folder / "oracle" / f"{name}.json") or {}
    timing = _json(folder / "answers" / name / "time.json") or {}
    known = {
        "id": name,
        "suite": truth["suite"],
        "kind": truth["kind"],
        "robot": truth["robot"],
        "severity": float(truth["severity"]),
        "link_encoders": bool(truth["link_encoders"]),
        "z": float(oracle.get("z") or 0.0),
        "sealed": hashlib.sha256(text).hexdigest() == commitment,
        "void": bool(oracle.get("void", False)),
        "status": timing.get("status", "unanswered"),
        "truth": tuple(Named.read(e) for e in truth["effects"]),
        "seconds": float(timing.get("seconds") or np.nan),
        "cpu": float(timing.get("cpu") or np.nan),
    }
    answer = _json(folder / "answers" / name / "diagnosis.json")
    if answer is None or known["status"] not in ("ok", "unanswered"):
        return CaseScore(**known, verdict=None, **judged(truth, None))
    case, answered = folder / "cases" / name, folder / "answers" / name
    if not residuals:
        return CaseScore(**known, verdict=answer.get("verdict"), **judged(truth, answer))
    return CaseScore(
        **known,
        verdict=answer.get("verdict"),
        **judged(truth, answer),
        fit=fits(case, answered, folder / "oracle" / name, ("tau", "ql")),
        torque_fit=fits(case, answered, folder / "oracle" / name, ("tau",)),
        added=added(case, answered, folder / "oracle" / name),
    )


def _json(path: Path) -> dict[str, Any] | None:
    """Content of a file; None where there is none that can be read."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def is_recognised(answer: dict[str, Any] | None, true: Sequence[Named]) -> bool:
    """Outside the catalogue is what the answer says, or a law at the joint of a true effect."""
    if answer is None:
        return False
    joints = {each.joint for each in true}
    return answer["verdict"] == "outside_catalogue" or (
        answer["verdict"] == "law_found"
        and any(
            f["effect"].startswith(LAW_PREFIX) and f.get("joint") in joints
            for f in answer["findings"]
        )
    )


def judged(truth: dict[str, Any], answer: dict[str, Any] | None) -> dict[str, Any]:
    """Names and parameters of an answer against the truth; no answer is a wrong one.

    Parameters
    ----------
    truth : dict
        Content of the truth file; `kind` is "none", "single", "pair" or "outside".
    answer : dict or None
        Content of diagnosis.json.
    """
    verdict = None if answer is None else answer.get("verdict")
    kind = truth["kind"]
    if kind == "none":
        return {"false_alarm": verdict != "nothing_missing"} | _words(answer)
    detected = verdict in (*NAMING_VERDICTS, "outside_catalogue")
    found = answer["findings"] if answer is not None and verdict in NAMING_VERDICTS else []
    true = [Named.read(e) for e in truth["effects"]]
    if kind == "outside":
        return {"detected": detected, "recognised": is_recognised(answer, true)} | _words(answer)
    said = [Named.read(f) for f in found]
    pairs = [(t, f) for t in truth["effects"] for f in found if _same(t, f)]
    out: dict[str, Any] = {
        "detected": detected,
        "false_components": len(said) - sum(any(same(t, s) for t in true) for s in said),
        "parameters": tuple(p for t, f in pairs for p in _parameters(t, f)),
    }
    if kind == "pair":
        return out | {"both": all(any(same(t, s) for s in said[:3]) for t in true)} | _words(answer)
    own = true[0]
    rivals = [Named.read(r) for r in found[0]["confused_with"]] if found else []
    exact = bool(said) and same(own, said[0])
    listed = said[:1] + rivals
    small = len(listed) <= LARGEST_GROUP
    placed = own.joint is not None or own.link is not None
    return (
        out
        | {
            "exact": exact,
            "top3": any(same(own, s) for s in (listed + said[1:])[:3]),
            "in_group": exact or (small and any(same(own, s) for s in listed)),
            "joint": (bool(said) and (said[0].joint, said[0].link) == (own.joint, own.link))
            if placed
            else None,
            "family": bool(said) and family(said[0].effect) == family(own.effect),
        }
        | _words(answer)
    )


def _words(answer: dict[str, Any] | None) -> dict[str, Any]:
    """What was said, for tables: findings, rivals of the first, its probability."""
    if answer is None or answer.get("verdict") != "named" or not answer["findings"]:
        return {}
    first = answer["findings"][0]
    return {
        "said": tuple(Named.read(f) for f in answer["findings"]),
        "rivals": tuple(Named.read(r) for r in first["confused_with"]),
        "probability": float(first["probability"]),
    }


def same(truth: Named, said: Named) -> bool:
    """Effect and place agree; the joint does not count for effects of the whole robot."""
    if truth.effect != said.effect:
        return False
    if truth.run is not None and truth.run != said.run:
        return False
    if truth.link is not None:
        return truth.link == said.link
    return truth.joint is None or truth.joint == said.joint


def _same(truth: dict[str, Any], said: dict[str, Any]) -> bool:
    return same(Named.read(truth), Named.read(said))


def _parameters(truth: dict[str, Any], said: dict[str, Any]) -> list[ParameterScore]:
    """Parameters that mean the same in both; a truth of zero has no relative error."""
    return [
        ParameterScore(name=name, value=reported["value"], sd=reported["sd"], truth=float(true))
        for name, true in truth["params"].items()
        if float(true) != 0.0
        and (reported := said["parameters"].get(name)) is not None
        and reported["value"] is not None
        and reported["sd"] is not None
    ]


def fits(case: Path, answer: Path, oracle: Path, kinds: tuple[str, ...]) -> dict[str, FitScore]:
    """Residual over noise by role, from the recordings and the prediction files alone."""
    sums: dict[str, np.ndarray] = {}
    for run, role in held_out(case):
        files = [
            answer / f"pred_before_{run}.npz",
            answer / f"pred_after_{run}.npz",
            oracle / f"pred_{run}.npz",
        ]
        if not all(f.exists() for f in files):
            continue
        lines = [squares(case, run, dict(np.load(f)), kinds) for f in files]
        total = [lines[0][1], *(square for square, _ in lines)]
        sums[role] = sums.get(role, np.zeros(4)) + np.array(total)
    return {
        role: FitScore(
            before=float(np.sqrt(b / count)),
            after=float(np.sqrt(a / count)),
            oracle=float(np.sqrt(o / count)),
        )
        for role, (count, b, a, o) in sums.items()
    }


def added(case: Path, answer: Path, oracle: Path) -> dict[str, float]:
    """Share of the exact change of the channels that an answer predicts, by role.

    What the answer adds to its own nominal prediction, against what the true robot adds to the
    nominal one along the exact motion: no filter, no noise and no edge of a run is in either
    difference.
    """
    sums: dict[str, np.ndarray] = {}
    for run, role in held_out(case):
        names = [
            answer / f"pred_before_{run}.npz",
            answer / f"pred_after_{run}.npz",
            oracle / f"nominal_{run}.npz",
            oracle / f"pred_{run}.npz",
        ]
        if not all(name.exists() for name in names):
            continue
        before, after, nominal, true = (dict(np.load(name)) for name in names)
        change = {k: v - nominal[k] for k, v in true.items() if k in nominal}
        left = {k: v - (after[k] - before[k]) for k, v in change.items() if k in after}
        with np.load(case / f"{run}.npz") as columns:
            measured = {k: columns[k] for k in columns.files}
        total = [_size(case, measured, each) for each in (left, change)]
        sums[role] = sums.get(role, np.zeros(2)) + np.array(total)
    return {role: float(1.0 - a / b) for role, (a, b) in sums.items() if b > 0.0}


def _size(case: Path, measured: dict[str, np.ndarray], change: dict[str, np.ndarray]) -> float:
    """Sum of squares over noise of a change of the channels."""
    predicted = {k: measured[k] - v for k, v in change.items() if k[:3] == "tau" or k[:2] == "ql"}
    return squares_of(case, measured, predicted, ("tau", "ql"))[0]


def held_out(case: Path) -> list[tuple[str, str]]:
    """Runs that were not for training, with their roles."""
    runs = tomllib.loads((case / "recordings.toml").read_text())["runs"]
    return [(Path(r["file"]).stem, r["role"]) for r in runs if r["role"] != "train"]


def squares(
    case: Path, run: str, predicted: dict[str, np.ndarray], kinds: tuple[str, ...]
) -> tuple[float, int]:
    """Sum of squared residuals over noise and the number of samples of one run.

    Torque counts where its joint moves, link positions everywhere; one that is not finite makes
    the sum infinite.
    """
    with np.load(case / f"{run}.npz") as columns:
        measured = {name: columns[name] for name in columns.files}
    return squares_of(case, measured, predicted, kinds)


def squares_of(
    case: Path,
    measured: dict[str, np.ndarray],
    predicted: dict[str, np.ndarray],
    kinds: tuple[str, ...],
) -> tuple[float, int]:
    """As `squares`, of columns that are already read."""
    noise = tomllib.loads((case / "recordings.toml").read_text())["noise"]
    total, count = 0.0, 0
    for j in range(1, 1 + sum(name.startswith("tau") for name in measured)):
        for kind in kinds:
            if f"{kind}{j}" not in measured:
                continue
            stated = noise["torque" if kind == "tau" else "link_position"]
            sd = stated[j - 1] if isinstance(stated, list) else stated
            left = (measured[f"{kind}{j}"] - predicted[f"{kind}{j}"]) / sd
            if kind == "tau":
                left = left[np.abs(measured[f"qd{j}"]) >= MOVING]
            square = float(left @ left)
            total += square if np.isfinite(square) else np.inf
            count += left.size
    return total, count
