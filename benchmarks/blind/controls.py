"""Controls: recordings in which there is nothing to name, or the same under another name.

python -m benchmarks.blind.controls KEY_FOLDER [--cases N] [--jobs J]
"""

from __future__ import annotations

import argparse
import copy
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.extras import key_folder, save
from benchmarks.blind.nominal import along
from benchmarks.blind.score import NAMING_VERDICTS, CaseScore, Named, is_recognised, same
from benchmarks.blind.sets import Columns, description, write_set
from benchmarks.blind.tally import counted, score_all
from benchmarks.blind.variants import Job, answers
from stiffopt.recording.recording_set import load_recordings

# Of the motion that the nominal model is evaluated along [Hz].
_CUTOFF = 20.0
Made = tuple[Job, CaseScore]


def scrambled(case: Path, target: Path) -> Path:
    """The nominal model's torque and wind-up plus their residuals with random phases.

    Spectra stay, whatever residuals depended on is lost; all channels of a run by one draw.
    """
    recordings = load_recordings(case)
    motions = {e.name: along(recordings, recordings.open(e), _CUTOFF) for e in recordings.runs}
    rng = np.random.default_rng(0)

    def change(name: str, columns: Columns) -> Columns:
        motion = motions[name]
        phases = np.exp(2j * np.pi * rng.uniform(size=len(motion.time) // 2 + 1))
        for j in range(recordings.n):
            models = {f"tau{j + 1}": motion.torque[:, j]}
            models[f"ql{j + 1}"] = columns[f"q{j + 1}"] - motion.windup[:, j]
            for column, model in models.items():
                if column in columns:
                    columns[column] = model + with_phases(columns[column] - model, phases)
        return columns

    return write_set(case, target, description(case), change)


def with_phases(samples: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Samples whose spectrum is turned by phases; the mean stays.

    Parameters
    ----------
    samples : array (K,)
    phases : array (K // 2 + 1,) of complex
        Of size one.
    """
    spectrum = np.fft.rfft(samples)
    spectrum[1:] *= phases[1:]
    if len(samples) % 2 == 0:
        # The highest frequency of an even number of samples has no phase but its sign.
        spectrum[-1] = np.abs(spectrum[-1])
    return np.fft.irfft(spectrum, len(samples))


def swapped(case: Path, other: Path, target: Path) -> Path:
    """Every second training run from another robot of the same nominal model."""
    told = description(case)
    theirs = {r["file"]: r for r in description(other)["runs"]}
    taken = [r["file"] for r in told["runs"] if r["role"] == "train"][1::2]
    told["runs"] = [theirs[r["file"]] if r["file"] in taken else r for r in told["runs"]]
    write_set(case, target, told)
    for name in taken:
        (target / name).write_bytes((other / name).read_bytes())
    return target


def relabelled(case: Path, target: Path, order: Sequence[int]) -> Path:
    """The same set with its joints listed in another order (from 0)."""
    told = description(case)
    count = len(told["joints"])

    def turned(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: turned(each) for key, each in value.items()}
        if isinstance(value, list) and len(value) == count and not isinstance(value[0], dict):
            return [value[k] for k in order]
        return value

    kept = {"gravity", "runs"}
    new = {key: value if key in kept else turned(value) for key, value in told.items()}
    new["runs"] = [turned(run) for run in told["runs"]]
    return write_set(case, target, new)


def restated(case: Path, target: Path, factor: float) -> Path:
    """The set with its stated noise wrong by a factor."""
    told = copy.deepcopy(description(case))
    for key, value in told["noise"].items():
        if not key.endswith("resolution"):
            told["noise"][key] = (factor * np.asarray(value)).tolist()
    return write_set(case, target, told)


def make(folder: Path, scores: Sequence[CaseScore], most: int) -> dict[str, list[Made]]:
    """Sets and jobs of every control."""
    own = counted(scores)
    single = [s for s in own if s.kind == "single" and s.severity >= 1.0][:most]
    nothing = [s for s in own if s.kind == "none"]
    none = nothing[:most]
    base = folder / "controls"

    def jobs(name: str, cases: Sequence[CaseScore], build: Callable[..., Path]) -> list[Made]:
        made = []
        for s in cases:
            target = base / name / "cases" / s.id
            if not (target / "recordings.toml").exists():
                build(folder / "cases" / s.id, target)
            made.append((Job("whole", target, base / name / "answers" / s.id), s))
        return made

    found = {"scrambled": jobs("scrambled", single, scrambled)}
    found["swapped"] = []
    for a, b in list(_neighbours(nothing))[:most]:
        other = folder / "cases" / b.id
        found["swapped"] += jobs("swapped", [a], lambda c, t, other=other: swapped(c, other, t))
    found["relabelled"] = jobs(
        "relabelled", single, lambda c, t: relabelled(c, t, _reversed(description(c)))
    )
    for factor, name in ((0.5, "noise_half"), (2.0, "noise_double")):
        found[f"{name} none"] = jobs(name, none, lambda c, t, f=factor: restated(c, t, f))
        found[f"{name} single"] = jobs(name, single, lambda c, t, f=factor: restated(c, t, f))
    found["effect_out"] = [
        (
            Job("without_effect", folder / "cases" / s.id, base / "effect_out" / s.id,
                s.truth[0].effect),
            s,
        )
        for s in single
    ]  # fmt: skip
    return found


def _neighbours(none: Sequence[CaseScore]) -> Iterator[tuple[CaseScore, CaseScore]]:
    """Each case with the next of the same robot and sensors."""
    for i, a in enumerate(none):
        for b in [*none[i + 1 :], *none[:i]]:
            if (a.robot, a.link_encoders) == (b.robot, b.link_encoders):
                yield a, b
                break


def _reversed(told: dict[str, Any]) -> list[int]:
    return list(range(len(told["joints"])))[::-1]


TEXTS = {
    "scrambled": ("residual with scrambled phases", "nothing named"),
    "swapped": ("half the training runs of another robot, nothing missing", "nothing named but"
                " encoder zeros, which do differ"),
    "relabelled": ("joints listed backwards", "the truth, at the turned joint"),
    "noise_half none": ("stated noise halved, nothing missing", "nothing named"),
    "noise_half single": ("stated noise halved, one effect", "the truth first"),
    "noise_double none": ("stated noise doubled, nothing missing", "nothing named"),
    "noise_double single": ("stated noise doubled, one effect", "the truth first"),
    "effect_out": ("catalogue without the true effect", "outside, or a neighbour of its family"),
}  # fmt: skip


def right(control: str, score: CaseScore, answer: dict[str, Any] | None, joints: int) -> bool:
    """Whether an answer to a control is the one that is right."""
    if answer is None:
        return False
    naming = answer["verdict"] in NAMING_VERDICTS
    said = [Named.read(f) for f in answer["findings"]] if naming else []
    if control == "effect_out":
        from benchmarks.blind.families import family

        return is_recognised(answer, score.truth) or (
            bool(said) and family(said[0].effect) == family(score.truth[0].effect)
        )
    if control == "swapped":
        return all(
            s.effect.startswith("encoder_zero") or s.effect == "encoder_offset" for s in said
        )
    if control == "scrambled" or control.endswith("none"):
        return not said
    true = score.truth[0]
    if control == "relabelled" and true.joint is not None:
        true = Named(true.effect, joints + 1 - true.joint, true.link, true.run)
    return bool(said) and same(true, said[0])


def control(
    folder: Path, scores: Sequence[CaseScore], most: int, workers: int, say: Callable[[str], object]
) -> Path:
    """Run every control and leave the section for the page."""
    rows = []
    for name, made in make(folder, scores, most).items():
        found = answers([job for job, _ in made], workers, say)
        words = Counter(_word(answer) for answer in found)
        hits = sum(
            right(name, score, answer, len(description(job.case)["joints"]))
            for (job, score), answer in zip(made, found, strict=True)
        )
        told = ", ".join(f"{word} {count}x" for word, count in words.most_common())
        rows.append([*TEXTS[name], f"{hits} of {len(made)}", told])
    text = "What the tool says where there is nothing to name, or the same under another name."
    head = ["control", "right", "came out", "said first"]
    return save(folder, "controls", {"title": "Controls", "text": text, "head": head, "rows": rows})


def _word(answer: dict[str, Any] | None) -> str:
    if answer is None:
        return "no answer"
    if answer["verdict"] != "named":
        return str(answer["verdict"]).replace("_", " ")
    return Named.read(answer["findings"][0]).label


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.controls")
    parser.add_argument("folder", type=key_folder, help="folder of a key")
    parser.add_argument("--cases", type=int, default=8, help="of each control")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    say = lambda text: print(text, file=sys.stderr)  # noqa: E731
    print(
        control(
            given.folder, score_all(given.folder, residuals=False), given.cases, given.jobs, say
        )
    )


if __name__ == "__main__":
    main()
