"""Count: `python -m benchmarks.reliability WHAT [NUMBER [FIRST]]`.

WHAT is faults (the folders of ../shared/faults), kills, interrupts, mutants (given to loaders) or
commands (mutants given to whole commands).
"""

from __future__ import annotations

import signal
import sys
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks.reliability.commands import stiffopt
from benchmarks.reliability.faults import cases
from benchmarks.reliability.kills import ended
from benchmarks.reliability.mutants import count


def main() -> None:
    what, number = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 100
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
            found = ended(place, number, signal.SIGKILL if what == "kills" else signal.SIGINT)
        elif what in ("mutants", "commands"):
            first = int(sys.argv[3]) if len(sys.argv) > 3 else 0
            found = count(place, number, commands=what == "commands", first=first)
        else:
            raise SystemExit(__doc__)
    print("\n".join(f"{count:6} {name}" for name, count in sorted(found.items())))


if __name__ == "__main__":
    main()
