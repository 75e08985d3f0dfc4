"""Command line of the benchmark."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from .key import key_under_test
from .store import Store

WORK = Path(__file__).with_name("work")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.blind",
        description="Effects concealed from `stiffopt diagnose`: make, diagnose, score.",
    )
    parser.add_argument("step", choices=("run", "generate", "diagnose", "score"))
    parser.add_argument("--cases", type=int, default=200, help="of the mixed suite")
    parser.add_argument("--none", type=int, default=150, help="with nothing missing")
    parser.add_argument("--sweep", type=int, default=0, help="of the detection curves")
    parser.add_argument("--arms", type=int, default=0, help="of the mix, on further arms")
    parser.add_argument("--arms-none", type=int, default=0, help="nothing missing, further arms")
    parser.add_argument("--jobs", type=int, default=2, help="side by side")
    parser.add_argument("--timeout", type=float, default=900.0, help="of one diagnosis [s]")
    parser.add_argument("--work", type=Path, default=WORK, help="folder of all files")
    parser.add_argument("--key", help="a key for development, dev-...")
    parser.add_argument("--commit", default="HEAD", help="under test, if not the last one")
    parser.add_argument(
        "--demand", action="store_true", help="fail where the least that is asked is not reached"
    )
    return parser


def _judge(store: Store) -> int:
    from .demands import unmet
    from .tally import score_all

    found = unmet(score_all(store.folder))
    for sentence in found:
        print(sentence, file=sys.stderr)
    return 1 if found else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one step or all; the exit status."""
    given = _parser().parse_args(arguments)
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    from . import run

    try:
        key = key_under_test(given.key, given.commit)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    store = Store(given.work.resolve() / key.text)
    suites = {"main": given.cases, "none": given.none, "sweep": given.sweep}
    suites |= {"arms": given.arms, "armsnone": given.arms_none}
    cases = run.names(suites)
    print(f"key {key.text}{' (development)' if key.development else ''}, {len(cases)} cases")
    try:
        if given.step in ("run", "generate"):
            run.write_manifest(key, store, suites)
            run.generate(key, store, cases, given.jobs)
        if given.step in ("run", "diagnose"):
            run.diagnose(store, cases, given.jobs, given.timeout)
        if given.step in ("run", "score"):
            from . import results

            print(results.main(store.folder))
        if given.demand:
            return _judge(store)
    except FileNotFoundError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; the same command goes on where it was", file=sys.stderr)
        return 130
    return 0
