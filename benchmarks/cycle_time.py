"""Time of a working cycle against the same moves optimised one by one, and against S-curves.

    python -m benchmarks.cycle_time [--lead] [FILE ...]

All have the same poses, postures, payloads, dwells and limits, the deflection among them. Moves one
by one and S-curves stop at every pose. The last two columns leave out the limit of the deflection:
of the optimised cycle and of the S-curves.

With `--lead` motors lead the links by the wind-up in both, within the limits of the motors, and the
error is that of the commands, simulated on the same uncertain arms: its largest value in flight and
after arrival over all moves. The S-curves (ruckig) are as fast as their commands keep the limits.
The legs of least tool error are given 15 % less time than those for the whole cycle, and then 10 %
less than moves that are optimised one by one. S-curves of equal error are slowed, each move by
itself, until neither error is above that of the legs in 15 % less.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from stiffopt.baseline.rivals import fair_rivals
from stiffopt.command.command_search import CommandOnArms
from stiffopt.command.compensation import rival_commands
from stiffopt.command.simulated_solution import with_simulation
from stiffopt.command.simulation import PlannedMotion, elastic_arm
from stiffopt.cycle.solve_cycle import solve_cycle
from stiffopt.problem.cycle import Cycle
from stiffopt.problem.cycle_files import load_cycle
from stiffopt.problem.limit import Limits
from stiffopt.problem.objective import Objective
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.compensation import Spreads
from stiffopt.solver.solve import solve_with_state

PROBLEMS = Path(__file__).resolve().parents[1] / "problems"
FILES = ("er3a_cycle.toml", "ur10_cycle.toml")


def stopping_changes(path: Path) -> list[str]:
    """Changes of the file by which the arm stops at the end of every move."""
    moves = sum(len(leg.moves) for leg in load_cycle(path).cycle.legs)
    return [f"move[{k}].stop=true" for k in range(1, moves + 1)]


def one_by_one(path: Path) -> Cycle:
    """The cycle with a stop at the end of every move."""
    return load_cycle(path, stopping_changes(path)).cycle


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


Errors = tuple[float, float]


def _largest(found: Iterable[Spreads]) -> Errors:
    """Largest errors on the worst arm, in flight and after arrival [m]."""
    led = list(found)
    return max(each.flight.worst for each in led), max(each.after.worst for each in led)


# Factor from one duration to the next at which S-curves are tried, and the longest over the first.
_SLOWING_STEP, _MAX_SLOWING = 1.05, 4.0
# Durations are left out at which the error in flight, by its fall with the square of the duration,
# would exceed the allowed one by more than this factor, which stands for what rings in it.
_FLIGHT_MARGIN = 1.2


def led_s_curves(cycle: Cycle) -> list[tuple[TrajectoryProblem, CommandOnArms]]:
    """Fastest S-curves whose motors lead within limits, with a stop at every pose."""
    found = []
    for leg in cycle.legs:
        problem = leg.problem
        rivals = fair_rivals(problem, resolve(problem), problem.duration[0])
        rival, motion = next(each for each in rivals if each[0].name == "S-curve")
        planned = PlannedMotion.of_rival(rival.smoothed, motion, True)
        found.append((problem, _command(problem, planned)))
    return found


def _command(problem: TrajectoryProblem, planned: PlannedMotion) -> CommandOnArms:
    (own,) = rival_commands(problem, elastic_arm(problem, planned.position[0]), [planned])
    return own


def slowed_within(problem: TrajectoryProblem, own: CommandOnArms, allowed: Errors) -> CommandOnArms:
    """An S-curve as fast as its limits and the allowed errors permit, the slowest tried if none."""
    longest = _MAX_SLOWING * own.motion.duration
    while True:
        errors = _largest([own.compensated])
        within = all(a <= b for a, b in zip(errors, allowed, strict=True))
        if within or own.motion.duration >= longest:
            return own
        least = np.sqrt(errors[0] / allowed[0] / _FLIGHT_MARGIN)
        slower = max(_SLOWING_STEP, float(least)) * own.motion.duration
        own = _command(problem, own.motion.slowed_to(problem, min(slower, longest)))


def s_curve_row(curves: list[CommandOnArms], rest: float, allowed: Errors) -> tuple[float, Errors]:
    """Time of all moves [s] and errors; infinite where a limit or an allowed error is exceeded."""
    errors = _largest(each.compensated for each in curves)
    kept = all(a <= b for a, b in zip(errors, allowed, strict=True))
    if not kept or any(each.excess for each in curves):
        return np.inf, errors
    return sum(float(each.motion.time[-1]) for each in curves) + rest, errors


def led_cycle(cycle: Cycle) -> tuple[float, Errors, str]:
    """Time [s] and errors of the fastest cycle whose motors lead, and its status."""
    found, led = solve_cycle(cycle, simulate=False), []
    if len(found.legs) < len(cycle.legs):
        return np.inf, (np.inf, np.inf), f"{found.status} of leg {len(found.legs)}"
    for leg in found.legs:
        made = with_simulation(leg.problem, leg.solution, compare=False).compensation
        if made is None or made.refusal:
            return found.duration, (np.inf, np.inf), f"{found.status}, without a command"
        led.append(made.optimised.compensated)
    return found.duration, _largest(led), str(found.status)


def led_errors_at(cycle: Cycle, durations: list[float]) -> Errors:
    """Errors of the legs of least tool error at given durations [s]."""
    found = []
    for leg, duration in zip(cycle.legs, durations, strict=True):
        fixed = {"objectives": (Objective(name="tool_error"),), "duration": (duration, duration)}
        problem = replace(leg.problem, **fixed)
        # The best motion so far has a command where it keeps the limits, whatever its status.
        solution, _ = solve_with_state(problem, simulate=True, beside_rivals=False)
        led = solution.compensation
        if led is None or led.refusal:
            return np.inf, np.inf
        found.append(led.optimised.compensated)
        told = f"  leg in {duration:.3f} s: {_largest(found[-1:])}, {solution.status}"
        print(told, file=sys.stderr, flush=True)
    return _largest(found)


def led_errors_in(cycle: Cycle, time: float, moves: list[float]) -> Errors:
    """Errors of the legs of least tool error in a time [s], split as durations of the moves."""
    share, left = (time - cycle.rest) / sum(moves), iter(moves)
    durations = [share * sum(next(left) for _ in leg.moves) for leg in cycle.legs]
    return led_errors_at(cycle, durations)


def print_led(paths: list[Path]) -> None:
    """Print the table of cycles whose motors lead, each time with the errors beside it."""
    heads = ("S-curves", "15 % less", "S-curves of equal error", "one by one", "10 % less")
    print(f"| cycle | {' | '.join(heads)} | fastest |")
    print("|---|---|---|---|---|---|---|")
    for path in paths:
        whole, stopping = (
            without_deflection(load_cycle(path, ["uncertainty.draws=50", *stops]).cycle)
            for stops in ((), stopping_changes(path))
        )
        row = [path.stem]

        def add(name: str, time: float, errors: Errors, row: list[str] = row) -> None:
            row.append(f"{time:.3f} s, {1e3 * errors[0]:.3f} / {1e3 * errors[1]:.4f} mm")
            print(f"{row[0]}, {name}: {row[-1]}", file=sys.stderr, flush=True)

        curves = led_s_curves(stopping)
        moves = [float(own.motion.time[-1]) for _, own in curves]
        fastest = s_curve_row([own for _, own in curves], whole.rest, (np.inf, np.inf))
        add("S-curves", *fastest)

        slow = led_errors_in(whole, 0.85 * fastest[0], moves)
        add("15 % less", 0.85 * fastest[0], slow)
        slowed = [slowed_within(problem, own, slow) for problem, own in curves]
        add("S-curves of equal error", *s_curve_row(slowed, whole.rest, slow))
        for name, each in (("one by one", stopping), ("fastest", whole)):
            lasted, errors, status = led_cycle(each)
            add(f"{name} ({status})", lasted, errors)
            if each is stopping:
                add("10 % less", 0.9 * lasted, led_errors_in(whole, 0.9 * lasted, moves))
        print(f"| {' | '.join(row)} |", flush=True)


def main() -> None:
    """Print the tables of the files named on the command line."""
    named = [name for name in sys.argv[1:] if name != "--lead"]
    paths = [Path(name) for name in named] or [PROBLEMS / name for name in FILES]
    if "--lead" in sys.argv:
        return print_led(paths)
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
