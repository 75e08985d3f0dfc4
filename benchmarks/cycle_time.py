"""Time of a working cycle against the same moves optimised one by one, and against S-curves.

    python -m benchmarks.cycle_time [FILE ...]

All have the same poses, postures, payloads, dwells and limits, the deflection among them. Moves one
by one and S-curves stop at every pose. The last two columns leave out the limit of the deflection,
as motors that lead by the wind-up take it away: of the optimised cycle and of the S-curves.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from stiffopt.baseline.rivals import fair_rivals
from stiffopt.cycle.solve_cycle import solve_cycle
from stiffopt.problem.cycle import Cycle
from stiffopt.problem.cycle_files import load_cycle
from stiffopt.problem.limit import Limits
from stiffopt.problem.resolve import resolve

PROBLEMS = Path(__file__).resolve().parents[1] / "problems"
FILES = ("er3a_cycle.toml", "ur10_cycle.toml")


def one_by_one(path: Path) -> Cycle:
    """The cycle with a stop at the end of every move."""
    moves = sum(len(leg.moves) for leg in load_cycle(path).cycle.legs)
    return load_cycle(path, [f"move[{k}].stop=true" for k in range(1, moves + 1)]).cycle


def without_deflection(cycle: Cycle) -> Cycle:
    """The cycle without its limit of the deflection."""
    legs = []
    for leg in cycle.legs:
        free = Limits({**leg.problem.active_limits.values, "dynamic_deflection": np.inf})
        legs.append(replace(leg, problem=replace(leg.problem, limits=free)))
    return replace(cycle, legs=tuple(legs))


def s_curve_time(cycle: Cycle) -> float:
    """Time of S-curves over all legs, each as fast as its limits allow [s]."""
    total = cycle.rest
    for leg in cycle.legs:
        problem = leg.problem
        found = [
            motion.duration
            for rival, motion in fair_rivals(problem, resolve(problem), problem.duration[0])
            if rival.name == "S-curve"
        ]
        total += found[0] if found else np.inf
    return total


def main() -> None:
    paths = [Path(name) for name in sys.argv[1:]] or [PROBLEMS / name for name in FILES]
    head = ("cycle", "optimised [s]", "one by one [s]", "S-curves [s]", "optimised", "S-curves")
    print(f"| {' | '.join(head)} |")
    print("|---|---|---|---|---|---|")
    for path in paths:
        whole, stopping = load_cycle(path).cycle, one_by_one(path)
        found = [
            solve_cycle(each, simulate=False)
            for each in (whole, stopping, without_deflection(whole))
        ]
        told = [f"{each.duration:.3f} ({each.status})" for each in found]
        curves = [f"{s_curve_time(each):.3f}" for each in (stopping, without_deflection(stopping))]
        row = [path.stem, *told[:2], curves[0], told[2], curves[1]]
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
