"""Leave one out: each effect is taken from the catalogue, and its law has to be found again.

    python -m benchmarks.blind.leave_one_out [--effects stribeck load_friction] [--key dev-1]

Cases are drawn and sealed as those of `python -m benchmarks.blind.laws`, one an effect, at severity
1; the tool runs in this process, since it has no option to forget an effect. A case whose law is
missed is answered with the whole catalogue too: recordings in which that misses the function as
well do not hold it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import stiffopt.discovery.diagnose as tool
from benchmarks.simulator import EFFECTS
from stiffopt.discovery.catalogue import CATALOGUE as ENTRIES
from stiffopt.discovery.store import write_diagnosis

from .cases import make_planned
from .key import Key, key_under_test
from .laws import ARMS, CLOSE, WORK, Scored, drawn_robot, score
from .mix import CATALOGUE, Plan
from .store import Store, whole_folder, write_json, write_text

# What no law of a joint's signals can be: values that differ from run to run without a signal, the
# sensors' clocks, the whole robot.
NO_LAW = frozenset(
    {"encoder_zero_change", "run_clock", "clock_drift", "time_delay", "saturation"}
    | {"friction_drift", "gain_drift"}
)


def left_out() -> list[str]:
    """Effects of single joints that a law could be."""
    known = {entry.name for entry in ENTRIES}
    return [
        name
        for name in CATALOGUE
        if name in known and EFFECTS[name].where == "joint" and name not in NO_LAW
    ]


@contextmanager
def without(name: str) -> Iterator[None]:
    """A catalogue without an effect; the whole one without a name."""
    tool.CATALOGUE = tuple(entry for entry in ENTRIES if entry.name != name)
    try:
        yield
    finally:
        tool.CATALOGUE = ENTRIES


def plan_without(key: Key, effect: str, arms: str) -> Plan:
    """The plan of the case of one effect. `arms`: key of `ARMS`."""
    name = f"loo_{effect}"
    draw = key.draw(name)
    return Plan(
        name=name,
        suite="loo",
        kind="single",
        robot=drawn_robot(draw, arms),
        seed=int(draw.integers(2**62)),
        link_encoders=True,
        effects=((effect,),),
        severity=1.0,
    )


@dataclass(frozen=True)
class Outcome:
    """A law sought in place of an effect; `whole`: by the whole catalogue, where it was missed."""

    law: Scored
    whole: Scored | None


def answer_without(store: Store, case: str, effect: str, name: str) -> None:
    """Diagnose a case without an effect, or with all for no name, and keep the answer."""
    if store.answered(name):
        return
    begin = time.process_time()
    with without(effect):
        found = tool.diagnose(store.case(case), experiment=False)
    with whole_folder(store.answer(name)) as folder:
        write_diagnosis(found, folder)
        write_json(folder / "time.json", {"id": name, "cpu": time.process_time() - begin})


def outcome(store: Store, case: str, effect: str) -> Outcome | None:
    """Answer and score a case; None where it cannot be scored."""
    answer_without(store, case, effect, case)
    law = score(store, case, of=effect)
    if law is None:
        return None
    if _within(law):
        return Outcome(law, None)
    answer_without(store, case, "", f"{case}_whole")
    return Outcome(law, score(store, case, of=effect, answered=f"{case}_whole"))


def page(rows: list[Outcome], key: Key) -> str:
    """The results as a page."""
    close = [_within(row.law) for row in rows]
    held = [_within(row.whole or row.law) for row in rows]
    alike = sum(row.law.whole["test"] <= CLOSE for row in rows)
    lines = [
        "# Effects taken from the catalogue, found again as laws",
        "",
        f"Key `{key.text}`{' (development)' if key.development else ''}, commit `{key.commit}`."
        f" Function within 10 % over the range met in {sum(close)} of {len(close)}, that of the"
        f" findings with the reported nominal values in {alike}; by the law or else the whole"
        f" catalogue in {sum(held)}. Excess removed on test runs in the median"
        f" {np.median([row.law.removed['test'] for row in rows]):.0%}.",
        "",
        "| effect | verdict | law at the joint | error | of the whole model"
        " | error of the whole catalogue | excess removed |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for law, whole in ((row.law, row.whole) for row in rows):
        known = "" if whole is None else f"{whole.error['test']:.2f}"
        lines.append(
            f"| {law.kind} | {law.verdict} | {'yes' if law.joint else 'no'}"
            f" | {law.error['test']:.2f} | {law.whole['test']:.2f} | {known}"
            f" | {law.removed['test']:.2f} |"
        )
    return "\n".join(lines) + "\n"


def _within(row: Scored) -> bool:
    return row.error["test"] <= CLOSE


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.leave_one_out")
    parser.add_argument("--effects", nargs="*", default=left_out())
    parser.add_argument("--key", help="a key for development, dev-...")
    parser.add_argument("--arms", choices=ARMS, default="usual", help="robots of the cases")
    parser.add_argument("--work", type=Path, default=WORK)
    given = parser.parse_args()
    key = key_under_test(given.key)
    store = Store(given.work.resolve() / key.text)
    rows = []
    for effect in given.effects:
        drawn = plan_without(key, effect, given.arms)
        make_planned(key, drawn, store)
        if store.unmade(drawn.name).exists():
            continue
        row = outcome(store, drawn.name, effect)
        if row is not None:
            rows.append(row)
            print(row, flush=True)
    write_text(store.folder / "LEAVE_ONE_OUT.md", page(rows, key))


if __name__ == "__main__":
    main()
