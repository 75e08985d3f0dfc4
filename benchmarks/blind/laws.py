"""Sealed laws that no catalogue has: are they found, in the right form, and never where none is.

    python -m benchmarks.blind.laws --cases 60 --none 20 --single 20 [--key dev-1]
        [--arms further|heavy]

Cases are drawn, sealed, answered and kept as those of `python -m benchmarks.blind`. A third of the
laws have an effect of the catalogue beside them.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.simulator import EFFECTS

from .cases import make_planned
from .function_error import function_errors
from .key import Key, key_under_test
from .mix import CATALOGUE, FURTHER_ARMS, LAWS, Plan, dealt
from .store import Store, write_text
from .tool import answer
from .wilson import wilson

WORK = Path(__file__).with_name("work")
PAGE = Path(__file__).with_name("LAWS.md")
# Robots of the cases and their shares, by the choice of the command line.
ARMS = {
    "usual": (("small3", 0.75), ("arm6", 0.25)),
    "further": FURTHER_ARMS,
    "heavy": (("big6", 0.5), ("pallet4", 0.5)),
}
SEVERITIES = (1.0, 1.5, 3.0, 6.0)
WITH_CATALOGUE = 1.0 / 3.0
TIMEOUT = 900.0  # [s]
# A function is found within this error over the range met, root mean square over its own.
CLOSE = 0.1


def plan_of(key: Key, suite: str, index: int, arms: str) -> Plan:
    """The plan of a case of one of the suites "law", "lawless" (nothing missing) and "known".

    `arms`: key of `ARMS`.
    """
    name = f"{suite}_{index:04d}"
    draw = key.draw(name)
    effects: list[tuple[str, ...]] = []
    if suite == "law":
        effects = [(dealt(key, LAWS, index, "law"),)]
    if suite == "known" or (suite == "law" and draw.uniform() < WITH_CATALOGUE):
        effects.append(tuple(key.shuffled(CATALOGUE, name, "beside")))
    return Plan(
        name=name,
        suite=suite,
        kind={"law": "outside", "lawless": "none", "known": "single"}[suite],
        robot=drawn_robot(draw, arms),
        seed=int(draw.integers(2**62)),
        link_encoders=True,
        effects=tuple(effects),
        severity=dealt(key, SEVERITIES, index, suite, "severity") if effects else 0.0,
    )


def drawn_robot(draw: np.random.Generator, arms: str) -> str:
    """A robot of a choice of `ARMS`."""
    robots, shares = zip(*ARMS[arms], strict=True)
    return str(draw.choice(robots, p=shares))


@dataclass(frozen=True, kw_only=True)
class Scored:
    """One answered case.

    Parameters
    ----------
    kind : str
        Law of the simulator; "" without one.
    verdict : str
    claimed : int
        Laws among the findings that are found, likely or one of a family.
    joint, signals : bool
        Of a claimed law, as in the truth.
    error : dict of str to float
        By role: root mean square of what the findings add less what is missing, over the latter,
        in the law's channel.
    whole : dict of str to float
        The same of findings together with the nominal values as they are reported.
    removed : dict of str to float
        By role: share of the excess of the squared residual over the oracle's that is gone.
    seconds : float
    """

    name: str
    kind: str
    verdict: str
    claimed: int
    joint: bool
    signals: bool
    error: dict[str, float]
    whole: dict[str, float]
    removed: dict[str, float]
    seconds: float


def score(store: Store, name: str, of: str = "", answered: str = "") -> Scored | None:
    """Score an answered case; None without an answer.

    Parameters
    ----------
    store : Store
    name : str
    of : str
        Effect that counts as the law; default: that of the family of laws.
    answered : str
        Name of the answer; default: that of the case.
    """
    given = store.answer(answered or name)
    path = given / "diagnosis.json"
    if not path.exists():
        return None
    found = json.loads(path.read_text())
    truth = json.loads(store.truth(name).read_text())
    oracle = json.loads(store.oracle(name).read_text())
    true = next(
        (
            e
            for e in truth["effects"]
            if e["effect"] == of or (not of and EFFECTS[e["effect"]].family == "law")
        ),
        None,
    )
    laws = {law["effect"]: law for law in found["laws"]}
    claimed = [f for f in found["findings"] if f["effect"] in laws and f["certainty"] != "possible"]
    own = [f for f in claimed if true is not None and f["joint"] == true["joint"]]
    seen = {_plain(s) for f in own for s in laws[f["effect"]]["signals"]}
    wanted = set() if true is None else {_plain(s) for s in true["law"].get("signals", ())}
    error, whole = ({}, {}) if true is None else function_errors(store, name, true, given)
    removed = {}
    for role in ("test", "extrapolate") if true is not None else ():
        before, after = (found["fit"][role][key] ** 2 for key in ("nrmse_before", "nrmse_after"))
        removed[role] = (before - after) / max(before - oracle[role] ** 2, 1e-9)
    return Scored(
        name=name,
        kind="" if true is None else true["effect"],
        verdict=found["verdict"],
        claimed=len(claimed),
        joint=bool(own),
        signals=bool(wanted) and wanted <= seen,
        error=error,
        whole=whole,
        removed=removed,
        seconds=json.loads((given / "time.json").read_text())["cpu"],
    )


def _plain(symbol: str) -> str:
    """The signal of a symbol: direction and nominal friction of a joint are a matter of its speed,
    its nominal wind-up of its load."""
    return re.sub(r"sg\((\w+)\)", r"\1", symbol).replace("F_", "w_").replace("D_", "T_")


def page(rows: list[Scored], key: Key) -> str:
    """The results as a page."""
    laws = [row for row in rows if row.kind]
    lines = [
        "# Laws that no catalogue has",
        "",
        f"Key `{key.text}`{' (development)' if key.development else ''}, commit `{key.commit}`;"
        f" {len(laws)} laws of {len({r.kind for r in laws})} kinds, made by"
        " `benchmarks/simulator/effects_laws.py`, which shares no code with the tool.",
        "",
        "| asked | of | share | 95 % interval |",
        "| --- | --- | --- | --- |",
    ]

    def line(title: str, hits: list[bool]) -> None:
        if hits:
            low, high = wilson(sum(hits), len(hits))
            lines.append(
                f"| {title} | {sum(hits)} of {len(hits)} | {np.mean(hits):.0%}"
                f" | {low:.0%} to {high:.0%} |"
            )

    line("verdict law_found", [r.verdict == "law_found" for r in laws])
    line("joint", [r.joint for r in laws])
    line("signals", [r.signals for r in laws])
    line("function within 10 %, test runs", [r.error["test"] <= CLOSE for r in laws])
    line("whole model within 10 %, test runs", [r.whole["test"] <= CLOSE for r in laws])
    for title, suite in (("nothing missing", "lawless"), ("one effect of the catalogue", "known")):
        own = [r for r in rows if r.name.startswith(f"{suite}_")]
        line(f"law claimed, {title}", [r.claimed > 0 for r in own])
    if laws:
        for role in ("test", "extrapolate"):
            middle = float(np.median([r.removed[role] for r in laws]))
            lines.append(f"| excess removed, {role} runs, median | | {middle:.0%} | |")
    lines += [
        "",
        "| case | law | verdict | joint | signals | error | of the whole model | removed"
        " | CPU [s] |",
    ]
    lines += ["| --- | --- | --- | --- | --- | --- | --- | --- | --- |"]
    lines += [
        f"| {r.name} | {r.kind.replace('_', ' ')} | {r.verdict} | {'yes' if r.joint else 'no'}"
        f" | {'yes' if r.signals else 'no'} | {r.error['test']:.2f} | {r.whole['test']:.2f}"
        f" | {r.removed['test']:.2f} | {r.seconds:.0f} |"
        for r in laws
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.laws")
    parser.add_argument("--cases", type=int, default=60, help="with a law")
    parser.add_argument("--none", type=int, default=20, help="with nothing missing")
    parser.add_argument("--single", type=int, default=20, help="with one effect of the catalogue")
    parser.add_argument("--key", help="a key for development, dev-...")
    parser.add_argument("--arms", choices=ARMS, default="usual", help="robots of the cases")
    parser.add_argument("--commit", default="HEAD")
    parser.add_argument("--work", type=Path, default=WORK)
    given = parser.parse_args()
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    key = key_under_test(given.key, given.commit)
    store = Store(given.work.resolve() / key.text)
    counts = {"law": given.cases, "lawless": given.none, "known": given.single}
    rows = []
    for suite, count in counts.items():
        for index in range(count):
            drawn = plan_of(key, suite, index, given.arms)
            make_planned(key, drawn, store)
            if not store.unmade(drawn.name).exists():
                answer(drawn.name, store, TIMEOUT, threading.Event())
                row = score(store, drawn.name)
                if row is not None:
                    rows.append(row)
                    print(row, flush=True)
    write_text(PAGE if not key.development else store.folder / PAGE.name, page(rows, key))


if __name__ == "__main__":
    main()
