"""Count: `python -m benchmarks.reliability WHAT [NUMBER [FIRST]] [--record FILE] [--minutes N]`.

WHAT is faults (the folders of ../shared/faults), kills, interrupts, mutants (given to loaders),
commands (mutants given to whole commands), grammar (files by grammar, given to them as well) or
grammar-read (the same, given to loaders).
FIRST is the first seed. With --record each verdict is a line of FILE: the same command goes on
where it stopped, and its end counts all lines.
"""

from __future__ import annotations

import argparse
import math
import signal
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks.reliability.commands import stiffopt
from benchmarks.reliability.faults import cases
from benchmarks.reliability.kills import ended
from benchmarks.reliability.mutants import count, recorded

WHAT = ("faults", "kills", "interrupts", "mutants", "commands", "grammar", "grammar-read")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=WHAT)
    parser.add_argument("number", type=int, nargs="?", default=100)
    parser.add_argument("first", type=int, nargs="?", default=0)
    parser.add_argument("--record", type=Path)
    parser.add_argument("--minutes", type=float, default=math.inf)
    asked = parser.parse_args()
    what, limits = asked.what, {"record": asked.record, "seconds": 60.0 * asked.minutes}
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        if what == "faults":
            found: Counter[str] = Counter()
            for case in cases():
                outcome = stiffopt(case.arguments, case.laid_out(place))
                found[outcome.verdict] += 1
                last = (outcome.error.strip().splitlines() or [""])[-1]
                print(f"{outcome.verdict:10} {outcome.seconds:5.1f} s  {case.folder.name}  {last}")
        elif what in ("kills", "interrupts"):
            sign = signal.SIGKILL if what == "kills" else signal.SIGINT
            found = ended(place, asked.number, sign, first=asked.first, **limits)
        else:
            loaders = ("mutants", "grammar-read")
            how = {"commands": what not in loaders, "grammar": what.startswith("grammar")}
            found = count(place, asked.number, **how, first=asked.first, **limits)
    if asked.record is not None:
        found = recorded(asked.record)
    print("\n".join(f"{count:6} {name}" for name, count in sorted(found.items())))


if __name__ == "__main__":
    main()
