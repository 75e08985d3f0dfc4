"""Count: `python -m benchmarks.reliability faults | kills | interrupts | mutants [NUMBER]`."""

from __future__ import annotations

import signal
import sys
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks.reliability.commands import stiffopt
from benchmarks.reliability.faults import cases
from benchmarks.reliability.kills import ended


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
        else:
            raise SystemExit(__doc__)
    print("\n".join(f"{count:6} {name}" for name, count in sorted(found.items())))


if __name__ == "__main__":
    main()
