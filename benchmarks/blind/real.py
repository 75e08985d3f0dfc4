"""Effects concealed in real recordings: known physics taken out of the nominal model, or put in.

    python -m benchmarks.blind.real KEY_FOLDER [--jobs J]

Recordings are in the folder that STIFFOPT_RECORDINGS names.
"""

from __future__ import annotations

import argparse
import os
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.extras import key_folder, save
from benchmarks.blind.score import Named
from benchmarks.blind.sets import Columns, description, write_set
from benchmarks.blind.variants import Job, answers

RECORDINGS = Path(
    os.environ.get(
        "STIFFOPT_RECORDINGS", Path(__file__).parents[2].parent / "shared" / "recordings"
    )
)
# Slower than this a joint counts as standing: an added friction says nothing there [rad/s].
_MOVING = 0.03


@dataclass(frozen=True, kw_only=True)
class Concealed:
    """Something known, hidden in a real recording set.

    Parameters
    ----------
    name : str
    source : str
        Name of the set.
    what : str
        What was done, in words.
    truth : tuple of Named
        Any of these is right.
    parameter : str
        That is compared, "" for none.
    value : float
        What it is [SI].
    build : callable
        From source and target folder to the changed set.
    after_first : bool
        The tool starts from the model that it found for the unchanged set.
    """

    name: str
    source: str
    what: str
    truth: tuple[Named, ...]
    parameter: str
    value: float
    build: Callable[[Path, Path], Path]
    after_first: bool = False


def without_rotor(joint: int, left: float) -> Callable[[Path, Path], Path]:
    """The nominal rotor inertia of a joint cut to a share."""

    def build(source: Path, target: Path) -> Path:
        told = description(source)
        told["nominal"]["rotor_inertia"][joint - 1] *= left
        return write_set(source, target, told)

    return build


def lighter(link: str, mass: float) -> Callable[[Path, Path], Path]:
    """A link of the nominal robot lighter by a mass [kg], its inertia about it in proportion."""

    def build(source: Path, target: Path) -> Path:
        told = description(source)
        write_set(source, target, told)
        tree = ElementTree.parse(target / told["robot"])
        inertial = tree.find(f".//link[@name='{link}']/inertial")
        assert inertial is not None
        entry, tensor = inertial.find("mass"), inertial.find("inertia")
        assert entry is not None
        assert tensor is not None
        now = float(entry.attrib["value"])
        entry.set("value", repr(now - mass))
        for key, value in tensor.attrib.items():
            tensor.set(key, repr(float(value) * (now - mass) / now))
        tree.write(target / told["robot"])
        return target

    return build


def stiffer(joint: int, factor: float) -> Callable[[Path, Path], Path]:
    """The nominal wind-up of a joint too stiff by a factor."""

    def build(source: Path, target: Path) -> Path:
        told = description(source)
        for key in ("K1", "K2", "K3"):
            told["nominal"]["reducer"][key][joint - 1] *= factor
        return write_set(source, target, told)

    return build


def rubbing(joint: int, level: float) -> Callable[[Path, Path], Path]:
    """Coulomb friction [N m] added to the measured torque, by the sign of the measured motion."""

    def build(source: Path, target: Path) -> Path:
        told = description(source)
        signals = told["signals"]

        def change(_: str, columns: Columns) -> Columns:
            torque, position = signals["torque"][joint - 1], signals["position"][joint - 1]
            time = columns[signals["time"]]
            speed = _speed(time, columns[position])
            added = level * np.sign(speed) * np.minimum(np.abs(speed) / _MOVING, 1.0)
            return columns | {torque: columns[torque] + added}

        return write_set(source, target, told, change)

    return build


def weaker(joint: int, share: float) -> Callable[[Path, Path], Path]:
    """Measured torque of a joint read too large by a share, as after a change of its constant."""

    def build(source: Path, target: Path) -> Path:
        told = description(source)
        column = told["signals"]["torque"][joint - 1]
        return write_set(source, target, told, lambda _, c: c | {column: c[column] * (1.0 + share)})

    return build


def _speed(time: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Speed from positions, over 20 ms: what a person would differentiate by hand."""
    step = float(np.median(np.diff(time)))
    width = max(3, round(0.02 / step))
    smooth = np.convolve(position, np.full(width, 1.0 / width), mode="same")
    return np.asarray(np.gradient(smooth, step))


def _payload(link: str) -> tuple[Named, ...]:
    return (Named("payload"), Named("inertial_error", None, link))


def _rubbed(source: str, joint: int, level: float) -> Concealed:
    return Concealed(
        name=f"{source}_friction_{joint}_{level:g}",
        source=source,
        what=f"{level:g} N m Coulomb friction added to joint {joint}, against the model found"
        " before",
        truth=(Named("coulomb", joint),),
        parameter="dFc",
        value=level,
        build=rubbing(joint, level),
        after_first=True,
    )


EMPS = "its friction is silent in the nominal model; published: Coulomb 20.4 N"
CASES = (
    Concealed(
        name="emps_friction", source="emps", what=EMPS,
        truth=(Named("coulomb", 1),), parameter="dFc", value=20.4,
        build=lambda s, t: write_set(s, t, description(s)),
    ),
    Concealed(
        name="kuka_rotor_2", source="kuka_kr300",
        what="rotor inertia of joint 2 halved in the nominal model: within four times the 20 %"
        " that are assumed where a set states no tolerance",
        truth=(Named("rotor_inertia", 2),), parameter="dJ", value=0.5 * 843.912881633,
        build=without_rotor(2, 0.5),
    ),
    Concealed(
        name="kuka_rotor_1", source="kuka_kr300",
        what="rotor inertia of joint 1 taken out of the nominal model",
        truth=(Named("rotor_inertia", 1),), parameter="dJ", value=608.954712653,
        build=without_rotor(1, 0.0),
    ),
    Concealed(
        name="kuka_payload", source="kuka_kr300",
        what="the 150 kg payload taken out of the last link",
        truth=_payload("link_6"), parameter="dm", value=150.0, build=lighter("link_6", 150.0),
    ),
    Concealed(
        name="kuka_stiffness_2", source="kuka_kr300",
        what="joint 2 twice as stiff in the nominal model",
        truth=(Named("stiffness_linear", 2),), parameter="factor", value=0.5,
        build=stiffer(2, 2.0),
    ),
    *(_rubbed("ur10e", 3, level) for level in (6.0, 12.0, 24.0)),
    *(_rubbed("kuka_kr300", 1, level) for level in (150.0, 300.0, 600.0)),
    *(
        Concealed(
            name=f"ur10_gain_2_{100.0 * share:g}", source="unisa_ur10",
            what=f"torque of joint 2 read {100.0 * share:g} % too large, against the model found"
            " before",
            truth=(Named("torque_gain", 2),), parameter="eps", value=share, build=weaker(2, share),
            after_first=True,
        )
        for share in (0.1, 0.2, 0.4)
    ),
)  # fmt: skip


def conceal(
    folder: Path, workers: int, say: Callable[[str], object], only: Sequence[str] = ()
) -> Path:
    """Hide, diagnose, and leave the section for the page."""
    base = folder / "real"
    here = [c for c in CASES if (RECORDINGS / c.source / "recordings.toml").exists()]
    made = [c for c in here if not only or c.name in only]
    for c in made:
        if not (base / "cases" / c.name / "recordings.toml").exists():
            c.build(RECORDINGS / c.source, base / "cases" / c.name)
    sources = sorted({c.source for c in made if c.after_first})
    first = [Job("whole", RECORDINGS / s, base / "first" / s) for s in sources]
    answers(first, workers, say)
    jobs = [
        Job(
            "whole",
            base / "cases" / c.name,
            base / "answers" / c.name,
            model=base / "first" / c.source / "extended.toml" if c.after_first else None,
        )
        for c in made
    ]
    found = answers(jobs, workers, say)
    rows = [_row(c, a) for c, a in zip(made, found, strict=True)]
    for c in CASES:
        if c not in made:
            rows.append([c.what, c.source, "", _why_not(c in here), "", "", ""])
    text = (
        "Public recordings of real robots, described in each set's own README. Either something"
        " known is taken out of the nominal model, or something known is added to the measured"
        " torque, in growing sizes. Real sets lack more than what is hidden: what else is named may"
        " well be true, and at most three effects are named beside friction that a set does not"
        " give. Where the truth is not named, the least size that the answer itself says it would"
        " have seen stands beside it."
    )
    head = [
        "hidden", "set", "truth", "said", "parameter: truth, found +- sd", "named", "seen from",
    ]  # fmt: skip
    return save(
        folder,
        "real",
        {"title": "Concealed in real recordings", "text": text, "head": head, "rows": rows},
    )


def _why_not(here: bool) -> str:
    return "not run" if here else "not run: no recordings"


def _row(concealed: Concealed, answer: dict[str, Any] | None) -> list[str]:
    truth = " or ".join(t.label for t in concealed.truth)
    head = [concealed.what, concealed.source, truth]
    if answer is None:
        return [*head, "no answer", "", "no", ""]
    findings = answer["findings"] if answer["verdict"] == "named" else []
    said = [Named.read(f) for f in findings]
    places = [k for k, s in enumerate(said) if s in concealed.truth]
    words = ", ".join(s.label for s in said) or answer["verdict"].replace("_", " ")
    told = f"{concealed.parameter}: {concealed.value:.4g}"
    if not places:
        group = any(Named.read(r) in concealed.truth for f in findings for r in f["confused_with"])
        named = "among the rivals" if group else "no"
        return [*head, words, told, named, _seen_from(concealed, answer)]
    value = findings[places[0]]["parameters"].get(concealed.parameter)
    if value is not None:
        told += f", {value['value']:.4g} +- {value['sd'] or float('nan'):.2g}"
    where = "first" if places[0] == 0 else f"as number {places[0] + 1}"
    return [*head, words, told, where, ""]


def _seen_from(concealed: Concealed, answer: dict[str, Any]) -> str:
    """The answer's own detection limit of what was hidden."""
    for limit in answer["detection_limits"]:
        if limit["parameter"] == concealed.parameter and any(
            (limit["effect"], limit["joint"]) == (t.effect, t.joint) for t in concealed.truth
        ):
            return f"{limit['value']:.3g} {limit['unit']}".strip()
    return ""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.real")
    parser.add_argument("folder", type=key_folder, help="folder of a key, where the answers go")
    parser.add_argument("--jobs", type=int, default=1)
    names = [c.name for c in CASES]
    parser.add_argument(
        "--only", nargs="*", default=(), choices=names, metavar="NAME", help="of the concealments"
    )
    given = parser.parse_args()
    if not RECORDINGS.is_dir():
        print(f"No recordings in {RECORDINGS}; name their folder in STIFFOPT_RECORDINGS.")
        return

    def say(text: str) -> None:
        print(text, file=sys.stderr)

    print(conceal(given.folder, given.jobs, say, given.only))


if __name__ == "__main__":
    main()
