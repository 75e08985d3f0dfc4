"""Sealed arms that follow commands, without torque: is what is missing named, and how well proved.

    python -m benchmarks.blind.commanded --cases 45 --none 30 [--key dev-1] [--jobs 2]

Cases are drawn, sealed and answered as those of `python -m benchmarks.blind`: three kinds of arm,
fifteen effects, and arms that lack nothing (`benchmarks/simulator/commanded_*.py`, on MuJoCo).
Every third case leaves the gains unstated. Needs the package `mujoco`.
"""

from __future__ import annotations

import argparse
import json
import os
import threading
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.simulator.commanded_arms import ARMS
from benchmarks.simulator.commanded_case import CommandedSpec, write_commanded_case
from benchmarks.simulator.commanded_effects import COMMANDED_EFFECTS

from .key import Key, key_under_test
from .mix import dealt
from .store import Store, whole_folder, write_json, write_text
from .tool import answer
from .wilson import Z95, Rate

WORK = Path(__file__).with_name("work")
PAGE = Path(__file__).with_name("COMMANDED.md")
SIZES = (1.0, 1.5, 2.5)
GAINS_STATED = (True, True, False)
TIMEOUT = 900.0  # [s]
# Certainties of findings that claim an effect.
CLAIMED = ("found", "likely")
# What counts as told: gains within this share, delays within this time [s].
GAIN_ERROR, DELAY_ERROR = 0.02, 1e-3
FITTED = ("armature", "coulomb", "viscous")


def spec_of(key: Key, suite: str, index: int, arms: Sequence[str] = tuple(ARMS)) -> CommandedSpec:
    """Return the case of one of the suites "commanded" and "idle" (nothing missing)."""
    name = "_".join([suite, *(arms if len(arms) < len(ARMS) else ()), f"{index:04d}"])
    missing = suite == "commanded"
    effect = dealt(key, tuple(COMMANDED_EFFECTS), index, suite, "effect") if missing else ""
    return CommandedSpec(
        name=name,
        arm=dealt(key, arms, index, suite, "arm"),
        effect=effect,
        size=dealt(key, SIZES, index, suite, "size") if missing else 0.0,
        # More of a value that nothing states is that value.
        gains_stated=effect == "viscous" or dealt(key, GAINS_STATED, index, suite, "gains"),
        seed=int(key.draw(name).integers(2**62)),
    )


def make(spec: CommandedSpec, store: Store) -> None:
    """Make and seal a case; one that is there already stays."""
    if store.made(spec.name) or store.unmade(spec.name).exists():
        return
    try:
        with whole_folder(store.case(spec.name)) as folder:
            truth = write_commanded_case(spec, lambda: folder)
            # On disk before the case is: what the tool can be given is held to a truth.
            write_text(store.truth(spec.name), truth["text"])
    except FloatingPointError as error:
        write_json(store.unmade(spec.name), {"id": spec.name, "reason": str(error)})


@dataclass(frozen=True, kw_only=True)
class Scored:
    """One answered case.

    Parameters
    ----------
    name, arm, effect, status, first : str
        `first`: effect and joint of the first claimed finding, "" without one.
    gains_stated, right, joint_right : bool
        Effect (and joint) of the first finding as in the truth; of controls: nothing is claimed.
    false : int
        Claimed findings that are not of the truth.
    gain_errors : list of float
        Relative, of all joints whose gain is told.
    silent : int
        Joints whose gain is not told.
    delay_error : float
        nan without one [s].
    covered : dict of str to list of bool
        By parameter: 95 % intervals that hold the truth.
    before, after : float
        Held-out position error of the simulation, root mean square [rad].
    seconds : float
        Of processor.
    """

    name: str
    arm: str
    effect: str
    status: str
    first: str
    gains_stated: bool
    right: bool
    joint_right: bool
    false: int
    gain_errors: list[float]
    silent: int
    delay_error: float
    covered: dict[str, list[bool]]
    before: float
    after: float
    seconds: float


def score(store: Store, name: str) -> Scored:
    """Score an answered case; one without an answer counts as missed."""
    truth = json.loads(store.truth(name).read_text(encoding="utf-8"))
    took = json.loads((store.answer(name) / "time.json").read_text(encoding="utf-8"))
    answered = took["status"] == "ok"
    path = store.answer(name)
    found: dict[str, Any] = {"findings": [], "positions": []}
    loop: dict[str, Any] = {}
    if answered:
        found = json.loads((path / "diagnosis.json").read_text(encoding="utf-8"))
        loop = tomllib.loads((path / "extended.toml").read_text("utf-8")).get("closed_loop", {})
    entry = COMMANDED_EFFECTS.get(truth["effect"])
    # Damping of a servo whose gains nobody states is a value that was missing, no claim.
    own = () if truth["gains_stated"] else ("viscous",)
    claimed = [f for f in found["findings"] if f["certainty"] in CLAIMED and f["effect"] not in own]

    def is_true(finding: dict[str, Any]) -> tuple[bool, bool]:
        named = entry is not None and finding["effect"] in entry.names
        return named, named and (not entry.at_joint or finding["joint"] == truth["joint"])

    first = claimed[0] if claimed else None
    right = is_true(first) if first else (False, False)
    if entry is None:
        right = (answered and not claimed,) * 2
    errors = _errors(truth, loop) if loop else {}
    covered = {key: [bool(abs(z) <= Z95) for _, z in own] for key, own in errors.items()}
    for finding in claimed:
        if is_true(finding)[1]:
            covered["finding"] = _finding_coverage(finding, truth["params"])
    return Scored(
        name=name,
        arm=truth["arm"],
        effect=truth["effect"],
        status=took["status"],
        first=f"{first['effect']} {first['joint'] or ''}".strip() if first else "",
        gains_stated=truth["gains_stated"],
        right=right[0],
        joint_right=right[1],
        false=sum(not is_true(f)[1] for f in claimed),
        gain_errors=[error for error, _ in errors.get("gain", [])],
        silent=len(truth["kp"]) - len(errors.get("gain", [])),
        delay_error=errors["delay"][0][0] if errors else float("nan"),
        covered=covered,
        **_position_errors(found["positions"]),
        seconds=took["cpu"],
    )


def _errors(truth: dict[str, Any], loop: dict[str, Any]) -> dict[str, list[tuple[float, float]]]:
    """Return errors of the fitted loop, and over their standard deviations, by parameter."""
    values, deviations = loop["values"], loop["deviations"]
    gain, own = np.array(loop["stiffness"]), np.array(values["gain"])
    told = np.isfinite(gain) & (gain > 0.0)
    fitted, kp = gain * (1.0 + own), np.array(truth["kp"])
    spread = np.maximum(gain * np.array(deviations["gain"]), 1e-12)
    errors = {
        "gain": [
            (float(fitted[j] / kp[j] - 1.0), float((fitted[j] - kp[j]) / spread[j]))
            for j in np.flatnonzero(told)
        ]
    }
    delay = float(np.median(truth["delay"]))
    late = values["delay"][0] - delay
    errors["delay"] = [(late, late / max(deviations["delay"][0], 1e-12))]
    damping = np.array(loop["damping"]) * (1.0 + np.array(values["damping"]))
    true = {name: np.array(truth[name]) for name in FITTED}
    # Damping of the servo and of the joint are one where the gains are not stated.
    extra = {"viscous": damping - np.array(truth["kd"])}
    for name in FITTED:
        away = np.array(values[name]) + extra.get(name, 0.0) - true[name]
        size = np.hypot(
            deviations[name],
            np.array(loop["damping"]) * deviations["damping"] if name == "viscous" else 0.0,
        )
        errors[name] = [
            (float(away[j]), float(away[j] / max(size[j], 1e-12))) for j in np.flatnonzero(told)
        ]
    return errors


def _finding_coverage(finding: dict[str, Any], params: dict[str, float]) -> list[bool]:
    """Return which intervals of a right finding's parameters hold the truth."""
    told = finding["parameters"]
    return [
        bool(abs(told[key]["value"] - value) <= Z95 * told[key]["sd"])
        for key, value in params.items()
        if key in told
    ]


def _position_errors(positions: list[dict[str, Any]]) -> dict[str, float]:
    def total(key: str) -> float:
        return float(np.sqrt(np.mean([np.square(each[key]) for each in positions])))

    if not positions:
        return {"before": float("nan"), "after": float("nan")}
    return {"before": total("rms_before"), "after": total("rms_after")}


def page(rows: list[Scored], key: Key) -> str:
    """Return the results as a page."""
    missing, idle = [r for r in rows if r.effect], [r for r in rows if not r.effect]
    development = " (development)" if key.development else ""
    lines = ["# Arms that follow commands, without torque", ""]
    lines += [f"Key `{key.text}`{development}, commit `{key.commit}`.", ""]
    lines += ["| asked | measured |", "| --- | --- |"]

    def line(title: str, value: object) -> None:
        lines.append(f"| {title} | {value} |")

    line("effect first", Rate.of(r.right for r in missing))
    line("effect and joint first", Rate.of(r.joint_right for r in missing))
    line("false claims in controls", Rate.of(not r.right for r in idle))
    line("cases with a false claim beside an effect", Rate.of(r.false > 0 for r in missing))
    for stated in (True, False):
        own = [r for r in rows if r.gains_stated == stated]
        title = "stated" if stated else "unstated"
        gains = [abs(e) < GAIN_ERROR for r in own for e in r.gain_errors]
        gains += [False for r in own for _ in range(r.silent)]
        line(f"gains within 2 %, {title}", Rate.of(gains))
        late = [abs(r.delay_error) < DELAY_ERROR for r in own]
        line(f"delay within 1 ms, {title}", Rate.of(late))
    for name in ("finding", "gain", "delay", *FITTED):
        held = [each for r in rows for each in r.covered.get(name, [])]
        line(f"95 % intervals of {name}", Rate.of(held))
    for title, own in (("effects", missing), ("controls", idle)):
        if own:
            before, after = (
                1e3 * float(np.nanmedian([getattr(r, name) for r in own]))
                for name in ("before", "after")
            )
            line(
                f"held-out position error, median of {title}, mrad", f"{before:.3g} to {after:.3g}"
            )
    line("processor, median", f"{np.median([r.seconds for r in rows]):.0f} s")
    columns = "case | arm | effect | gains | first | right | false | gain | delay | mrad | CPU [s]"
    lines += ["", f"| {columns} |", "|" + " --- |" * columns.count("|") + " --- |"]
    for r in rows:
        gain = f"{100 * np.max(np.abs(r.gain_errors)):.1f} %" if r.gain_errors else "-"
        gain += f", {r.silent} untold" if r.silent and r.status == "ok" else ""
        cells = (r.name, r.arm, r.effect or "none", "stated" if r.gains_stated else "unstated")
        own = "yes" if r.joint_right else "effect" if r.right else "no"
        late = f"{1e3 * r.delay_error:+.2f} ms"
        moved = f"{1e3 * r.before:.3g} to {1e3 * r.after:.3g}"
        cells += (r.first or r.status, own, str(r.false), gain, late, moved, f"{r.seconds:.0f}")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def run(
    key: Key, store: Store, counts: dict[str, int], jobs: int, arms: Sequence[str] = tuple(ARMS)
) -> list[Scored]:
    """Make, answer and score all cases."""
    specs = [spec_of(key, suite, i, arms) for suite, count in counts.items() for i in range(count)]
    stop = threading.Event()

    def one(spec: CommandedSpec) -> Scored | None:
        make(spec, store)
        if store.unmade(spec.name).exists() or answer(spec.name, store, TIMEOUT, stop) is None:
            return None
        row = score(store, spec.name)
        print(row, flush=True)
        return row

    with ThreadPoolExecutor(jobs) as pool:
        try:
            found = list(pool.map(one, specs))
        except BaseException:
            stop.set()
            raise
    return [row for row in found if row is not None]


def main(argv: list[str] | None = None, say: Callable[[str], object] = print) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.commanded")
    parser.add_argument("--cases", type=int, default=45, help="with an effect")
    parser.add_argument("--none", type=int, default=30, help="with nothing missing")
    parser.add_argument("--arms", nargs="+", choices=list(ARMS), default=list(ARMS))
    parser.add_argument("--key", help="a key for development, dev-...")
    parser.add_argument("--commit", default="HEAD")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--work", type=Path, default=WORK)
    given = parser.parse_args(argv)
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    key = key_under_test(given.key, given.commit)
    store = Store(given.work.resolve() / key.text)
    counts = {"commanded": given.cases, "idle": given.none}
    rows = run(key, store, counts, given.jobs, given.arms)
    text = page(rows, key)
    write_text(PAGE if not key.development else store.folder / PAGE.name, text)
    say(text)


if __name__ == "__main__":
    main()
