"""Peers of the search for laws on the same residuals: sparse and symbolic regression, and a bound.

    python -m benchmarks.blind.law_peers --key dev-1 --python ENVIRONMENT/bin/python

Every sealed law that was made becomes one problem: the residual of its torque channel beside
nominal values within tolerance, and the signals of all joints there. Each method predicts runs that
it was not fitted to. The environment has pysindy and gplearn, see `law_peers_environment.sh`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from stiffopt.discovery.law_search.open_channel import OpenChannel
from stiffopt.discovery.law_search.search import search_channel
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

from .key import key_under_test
from .laws import WORK
from .store import Store, write_text

WORKER = Path(__file__).with_name("law_peers_worker.py")
METHODS = ("pysindy", "gplearn", "gaussian process")


def open_channel(store: Store, name: str) -> OpenChannel | None:
    """The torque channel of a case's law, with nothing named; None of a law in the link."""
    law = json.loads(store.truth(name).read_text())["effects"][0]
    if law["effect"] == "softening_by_heat":
        return None
    training = prepare_training(load_recordings(store.case(name)), Settings())
    comparison = training.comparison()
    return OpenChannel(comparison.linearised_at(comparison.fit()), (), law["joint"] - 1)


def write_problem(channel: OpenChannel, path: Path) -> None:
    """Write the residual, its signals and its runs for the worker."""
    rows = channel.comparison.rows
    kept = [s for s in channel.sources if s.kind not in ("tool_x", "tool_y")]
    signals = [
        rows.sample_signal(
            lambda run, own=source: np.broadcast_to(own.value(run.signals), run.time.shape)
        )[channel.rows]
        for source in kept
    ]
    symbols = [source.symbol for source in kept]
    np.savez(path, x=np.column_stack(signals), y=channel.target, run=channel.block, names=symbols)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.law_peers")
    parser.add_argument("--key", required=True)
    parser.add_argument("--python", type=Path, required=True, help="of the peers' environment")
    parser.add_argument("--work", type=Path, default=WORK)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    given = parser.parse_args()
    store = Store(given.work.resolve() / key_under_test(given.key).text)
    names = [path.parent.name for path in sorted(store.folder.glob("cases/law_*/commitment.txt"))]
    lines = [
        "| case | law | " + " | ".join(("stiffopt", *given.methods)) + " |",
        "| --- " * (3 + len(given.methods)) + "|",
    ]
    every = []
    for name in names[: given.cases]:
        channel = open_channel(store, name)
        if channel is None:
            continue
        with tempfile.TemporaryDirectory() as folder:
            problem = Path(folder) / "problem.npz"
            write_problem(channel, problem)
            done = subprocess.run(
                [given.python, WORKER, problem, *given.methods],
                capture_output=True,
                text=True,
                check=True,
            )
        left = json.loads(done.stdout)
        own = search_channel(channel)
        shares = [own.explained, *(channel.share(left[method]) for method in given.methods)]
        every.append(shares)
        kind = json.loads(store.truth(name).read_text())["effects"][0]["effect"]
        cells = " | ".join(f"{share:.2f}" for share in shares)
        lines.append(f"| {name} | {kind.replace('_', ' ')} | {cells} |")
        print(lines[-1], flush=True)
    lines.append("| median | | " + " | ".join(f"{v:.2f}" for v in np.median(every, axis=0)) + " |")
    write_text(store.folder / "LAW_PEERS.md", "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
