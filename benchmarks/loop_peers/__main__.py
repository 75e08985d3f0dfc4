"""Position errors of a held-out run by peers that fit given parameters to the same training run.

    python -m benchmarks.loop_peers [--recordings DIR] [--page FILE]

The leg of a real quadruped (`go2_leg_fl`), held in the air: commands and positions at 200 Hz. Every
fit sees `train.csv` alone; `test.csv` is simulated from its commands and its first position. All
begin with the gains that the recording's description states. Writes LOOP_PEERS.md beside this
folder. Needs the packages `mujoco[sysid]` and `cma`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.real import RECORDINGS
from benchmarks.blind.sets import write_set

try:
    from . import pace_fit, sysid_fit
    from .leg import DAMPING, JOINTS, STIFFNESS, Run, build_spec, read_run, simulate
except ModuleNotFoundError as missing:
    sys.exit(f"{missing}. Install the packages mujoco[sysid] and cma.")

PAGE = Path(__file__).parents[1] / "LOOP_PEERS.md"
GENERATIONS, POPULATION, ITERATIONS = 250, 24, 60
Fit = Callable[[Path, Run], tuple[Callable[[Run], np.ndarray], dict[str, Any]]]


def _guess(urdf: Path, run: Run) -> tuple[Callable[[Run], np.ndarray], dict[str, Any]]:
    model, none = build_spec(urdf).compile(), np.zeros(len(JOINTS))
    return lambda own: simulate([model], own, [own.mean_command(0.0)], [none])[0], {}


def _diagnose(folder: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """Return positions of the held-out run simulated by the diagnosis of this package."""
    from stiffopt.discovery.diagnose import diagnose

    told = {
        "schema": 1,
        "name": "leg",
        "robot": "leg.urdf",
        "joints": list(JOINTS),
        "signals": {
            "time": "time",
            **{kind: [f"{kind}_{joint}" for joint in JOINTS] for kind in ("command", "position")},
        },
        "actuator": {
            "kind": "position_servo",
            "kp": [STIFFNESS] * len(JOINTS),
            "kd": [DAMPING] * len(JOINTS),
        },
        "runs": [{"file": f"{role}.csv", "role": role} for role in ("train", "test")],
    }
    with tempfile.TemporaryDirectory() as own:
        found = diagnose(write_set(folder, Path(own), told), experiment=False)
    loop = found.closed_loop
    assert loop is not None
    values = {name: np.array(own) for name, own in loop.values.items() if name != "amplitudes"}
    values["gain"] = np.array(loop.stiffness) * (1.0 + values["gain"])
    values["damping of the servo"] = np.array(loop.damping) * (1.0 + values.pop("damping"))
    return found.positions[0].after, values


def _row(title: str, predicted: np.ndarray, run: Run, count: str, seconds: float) -> str:
    error = 1e3 * (predicted - run.position)
    each = np.sqrt(np.mean(error**2, axis=0))
    cells = [title, count, f"{np.sqrt(np.mean(error**2)):.2f}"]
    cells += [f"{own:.2f}" for own in each]
    return f"| {' | '.join([*cells, f'{np.abs(error).max():.1f}', f'{seconds:.0f}'])} |"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loop_peers")
    parser.add_argument("--recordings", type=Path, default=RECORDINGS)
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    folder = given.recordings / "go2_leg_fl"
    if not folder.is_dir():
        parser.error(f"No recordings in {folder}; name their folder in STIFFOPT_RECORDINGS.")
    train, test = (read_run(folder / f"{name}.csv") for name in ("train", "test"))
    urdf = folder / "leg.urdf"
    fits: dict[str, Fit] = {
        "manufacturer's guess": _guess,
        "CMA-ES as PACE": lambda *own: pace_fit.fit(*own, GENERATIONS, POPULATION),
        "mujoco.sysid": lambda *own: sysid_fit.fit(*own, ITERATIONS),
        "mujoco.sysid with masses, centres, gains": lambda *own: sysid_fit.fit(
            *own, ITERATIONS, bodies=True
        ),
    }
    rows, fitted = [], []
    for title, fit in fits.items():
        begun = time.process_time()
        predict, values = fit(urdf, train)
        seconds = time.process_time() - begun
        count = str(sum(np.size(own) for own in values.values())) if values else "0"
        rows.append(_row(title, predict(test), test, count, seconds))
        fitted += [f"| {title} | {_listed(values)} |"] if values else []
        print(rows[-1], flush=True)
    begun = time.process_time()
    predicted, values = _diagnose(folder)
    rows.append(_row("stiffopt", predicted, test, "chosen", time.process_time() - begun))
    fitted.append(f"| stiffopt | {_listed(values)} |")
    print(rows[-1], flush=True)
    given.page.write_text(_page(rows, fitted), encoding="utf-8")


def _listed(values: dict[str, Any]) -> str:
    return "; ".join(
        f"{name} {', '.join(f'{x:.3g}' for x in np.ravel(own))}" for name, own in values.items()
    )


def _page(rows: list[str], fitted: list[str]) -> str:
    usage = (__doc__ or "").split("\n\n", 2)[2].strip().splitlines()
    head = ["# Forward-simulation fits of a real leg", "", *usage, ""]
    head += ["Errors of the positions in mrad, root mean square, in all joints and in each.", ""]
    head += ["Processor time of a busy machine of two cores.", ""]
    columns = ["fit", "parameters", "all", *JOINTS, "largest", "processor [s]"]
    table = [f"| {' | '.join(columns)} |", "|" + " --- |" * len(columns)]
    values = ["", "| fit | values |", "| --- | --- |", *fitted]
    return "\n".join([*head, *table, *rows, *values]) + "\n"


if __name__ == "__main__":
    main()
