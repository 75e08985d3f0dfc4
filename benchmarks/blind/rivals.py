"""Rivals on the same cases: the share of the excess torque residual that each explains.

python -m benchmarks.blind.rivals KEY_FOLDER            score, with the settings of rivals.json
python -m benchmarks.blind.rivals KEY_FOLDER --tune     choose those settings (dev-... keys)
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.extras import key_folder, save
from benchmarks.blind.nominal import Motion, along
from benchmarks.blind.rival_models import LIBRARY, BlackBox, Friction, Rival, Sparse
from benchmarks.blind.score import CaseScore, FitScore, squares
from benchmarks.blind.tally import counted, score_all
from stiffopt.recording.recording_set import RecordingSet, load_recordings

HERE = Path(__file__).parent
SETTINGS = HERE / "rivals.json"
PYSINDY = HERE / "work" / "pysindy" / "bin" / "python"
NAMES = {
    "friction": "Coulomb + viscous + offset, least squares",
    "sparse": f"sparse regression, {len(LIBRARY)} terms a joint",
    "black_box": "black box: random Fourier features, ridge",
}
GRID: dict[str, dict[str, list[float]]] = {
    "friction": {"cutoff": [10.0, 20.0, 40.0]},
    "sparse": {
        "cutoff": [20.0],
        "threshold": [0.01, 0.03, 0.1, 0.2],
        "ridge": [1e-6, 1e-4, 1e-2],
    },
    "black_box": {"cutoff": [20.0], "length": [2.0, 5.0, 10.0], "ridge": [1e-5, 1e-3, 1e-1]},
}


def build(
    name: str, recordings: RecordingSet, settings: dict[str, float], python: Path | None = None
) -> Rival:
    """A rival by its name; `python`: an interpreter that has pysindy."""
    own = {key: value for key, value in settings.items() if key != "cutoff"}
    if name == "friction":
        return Friction()
    if name == "sparse":
        return Sparse(recordings.nominal, python=python, **own)
    return BlackBox(**own)


class Bench:
    """Motions of one case, for any rival.

    Parameters
    ----------
    folder : Path
        Of the key.
    name : str
        Of the case.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.case, self.oracle = folder / "cases" / name, folder / "oracle" / name
        self.answer = folder / "answers" / name
        self.recordings = load_recordings(self.case)
        # Terms that the last rival kept, if it chooses any.
        self.terms: int | None = None
        self._motions: dict[float, dict[str, Motion]] = {}

    def fits(
        self, rival: str, settings: dict[str, float], python: Path | None = None
    ) -> dict[str, FitScore]:
        """Residual over noise of the torque channels by role."""
        cutoff = settings["cutoff"]
        if cutoff not in self._motions:
            self._motions[cutoff] = {
                entry.name: along(self.recordings, self.recordings.open(entry), cutoff)
                for entry in self.recordings.runs
            }
        motions = self._motions[cutoff]
        model = build(rival, self.recordings, settings, python)
        model.fit([motions[entry.name] for entry in self.recordings.with_role("train")])
        self.terms = model.terms if isinstance(model, Sparse) else None
        sums: dict[str, np.ndarray] = {}
        for entry in self.recordings.with_role("test", "extrapolate"):
            run = motions[entry.name]
            with np.load(self.oracle / f"pred_{entry.name}.npz") as known:
                oracle = self._square(entry.name, {k: known[k] for k in known.files})
            # All start from one nominal prediction, the tool's: only what is added is compared.
            with np.load(self.answer / f"pred_before_{entry.name}.npz") as known:
                start = {k: known[k] for k in known.files}
            added = self._named(model.predict(run))
            before = self._square(entry.name, start)
            after = self._square(entry.name, {k: start[k] + v for k, v in added.items()})
            line = np.array([before[1], before[0], after[0], oracle[0]])
            sums[entry.role] = sums.get(entry.role, np.zeros(4)) + line
        return {
            role: FitScore(
                before=float(np.sqrt(b / k)),
                after=float(np.sqrt(a / k)),
                oracle=float(np.sqrt(o / k)),
            )
            for role, (k, b, a, o) in sums.items()
        }

    def _named(self, torque: np.ndarray) -> dict[str, np.ndarray]:
        return {f"tau{j + 1}": torque[:, j] for j in range(torque.shape[1])}

    def _square(self, run: str, predicted: dict[str, np.ndarray]) -> tuple[float, int]:
        return squares(self.case, run, predicted, ("tau",))


def chosen(scores: Sequence[CaseScore]) -> list[CaseScore]:
    """Cases that rivals are tried on: one effect or two, and nothing missing."""
    return [s for s in counted(scores) if s.kind in ("single", "pair", "none") and s.torque_fit]


def tune(folder: Path, scores: Sequence[CaseScore], say: Callable[[str], object]) -> Path:
    """Settings with the best median improvement on the test runs of development cases."""
    manifest = json.loads((folder / "manifest.json").read_text())
    if not manifest.get("development", True):
        raise SystemExit("Settings are tuned on development cases only: give a dev-... key.")
    cases = [Bench(folder, s.id) for s in chosen(scores) if s.kind != "none"]
    best: dict[str, Any] = {}
    for rival, grid in GRID.items():
        tried = []
        for values in itertools.product(*grid.values()):
            settings = dict(zip(grid, values, strict=True))
            shares = [case.fits(rival, settings)["test"].share for case in cases]
            tried.append((float(np.nanmedian(shares)), settings))
            say(f"{rival} {settings}: {tried[-1][0]:.3f}")
        median, settings = max(tried, key=lambda pair: pair[0])
        best[rival] = settings
        say(f"{rival}: {settings} with {median:.3f} on {len(cases)} cases")
    SETTINGS.write_text(json.dumps(best, indent=1) + "\n", encoding="utf-8")
    return SETTINGS


def some(scores: Sequence[CaseScore], count: int | None) -> list[CaseScore]:
    """The first so many cases with something missing, and a quarter as many without."""
    cases = chosen(scores)
    if count is None:
        return cases
    none = [s for s in cases if s.kind == "none"]
    return [s for s in cases if s.kind != "none"][:count] + none[: (count + 3) // 4]


def compare(
    folder: Path,
    scores: Sequence[CaseScore],
    say: Callable[[str], object],
    count: int | None = None,
) -> Path:
    """Score the rivals beside the tool, and leave the section for the page."""
    if not SETTINGS.exists():
        raise SystemExit("The rivals have no settings yet: --tune them on a dev-... key first.")
    settings: dict[str, dict[str, float]] = json.loads(SETTINGS.read_text())
    python = PYSINDY if PYSINDY.exists() else None
    lines: dict[str, list[tuple[CaseScore, dict[str, FitScore]]]] = {name: [] for name in settings}
    kept = []
    cases = some(scores, count)
    for score in cases:
        case = Bench(folder, score.id)
        say(score.id)
        for rival, own in settings.items():
            lines[rival].append((score, case.fits(rival, own, python)))
            if score.kind == "none" and case.terms is not None:
                kept.append(case.terms)
    tool = [(s, s.torque_fit) for s in cases]
    rows = [_row("stiffopt diagnose", "defaults", tool)]
    for rival, fits in lines.items():
        told = ", ".join(f"{key} {value:g}" for key, value in settings[rival].items())
        rows.append(_row(NAMES[rival], told, fits))
    solver = "the same algorithm in NumPy" if python is None else "pysindy's STLSQ"
    text = (
        "Torque channels alone; the same training runs, and the same nominal prediction to add"
        " to. Share: what is taken off the squared residual over what the oracle takes off, 1 is"
        " the oracle. Where nothing is missing, `after / before` is the residual's ratio: what"
        " tolerances leave is all there is to fit, and only the tool can say so. Settings were"
        f" chosen on development cases by the median share on test runs, from {_grid()}. Sparse"
        f" regression by {solver}; its terms: {', '.join(f'`{t}`' for t in LIBRARY)}."
    )
    if kept:
        text += f" Where nothing is missing it keeps {np.median(kept):.0f} terms (median)."
    head = [
        "", "settings", "cases", "share, test, median", "90 % or more on test",
        "share, extrapolation, median", "nothing missing: after / before",
        "names what is missing",
    ]  # fmt: skip
    return save(folder, "rivals", {"title": "Rivals", "text": text, "head": head, "rows": rows})


def _row(
    name: str, settings: str, lines: Sequence[tuple[CaseScore, dict[str, FitScore]]]
) -> list[str]:
    effects = [fit for score, fit in lines if score.kind != "none"]
    test = np.array([f["test"].share for f in effects if "test" in f])
    beyond = np.array([f["extrapolate"].share for f in effects if "extrapolate" in f])
    none = [f["test"].after / f["test"].before for s, f in lines if s.kind == "none"]
    test, beyond = test[np.isfinite(test)], beyond[np.isfinite(beyond)]
    return [
        name,
        settings,
        str(len(effects)),
        f"{np.median(test):.2f}" if test.size else "",
        f"{int(np.sum(test >= 0.9))} of {test.size}",
        f"{np.median(beyond):.2f}" if beyond.size else "",
        f"{np.median(none):.2f} ({len(none)} cases)" if none else "",
        "yes" if name.startswith("stiffopt") else "no",
    ]


def _grid() -> str:
    return "; ".join(
        f"{rival}: " + ", ".join(f"{k} {v}" for k, v in grid.items())
        for rival, grid in GRID.items()
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.rivals")
    parser.add_argument("folder", type=key_folder, help="folder of a key")
    parser.add_argument("--tune", action="store_true", help="choose the settings here")
    parser.add_argument("--cases", type=int, help="the first so many of those with an effect")
    given = parser.parse_args()
    scores = score_all(given.folder)

    def say(text: str) -> None:
        print(text, file=sys.stderr)

    made = (
        tune(given.folder, scores, say)
        if given.tune
        else compare(given.folder, scores, say, given.cases)
    )
    print(made)


if __name__ == "__main__":
    main()
