"""Files of a solved cycle: cycle.json, cycle.csv, and a folder of files for each leg."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.cycle.cycle_simulation import leg_motions
from stiffopt.errors import InputFileError
from stiffopt.files import load_json, write_csv
from stiffopt.folders import check_result
from stiffopt.problem.cycle import Cycle
from stiffopt.recipe.stored_result import read_guess
from stiffopt.result.assessment import Assessment
from stiffopt.result.compensation import write_command
from stiffopt.result.cycle import CYCLE_FILE, CycleSolution, leg_folder, write_cycle
from stiffopt.result.store import export_times, write_result, write_rival, write_trajectory

CYCLE_TABLE = "cycle.csv"


def write_cycle_result(
    solution: CycleSolution,
    stage: Path,
    problem: Path,
    home: Path,
    changes: Sequence[str],
) -> None:
    """Write the files of a cycle into `stage`, whose final folder is `home`."""
    for number, leg in enumerate(solution.legs, start=1):
        folder = stage / leg_folder(number)
        folder.mkdir()
        stated, found = leg.problem, leg.solution
        if found.trajectory is not None:
            times = export_times(found.trajectory.duration)
            write_trajectory(assess(stated, found.trajectory, times=times), folder)
        write_command(found.compensation, folder)
        write_rival(found.compensation, folder)
        write_result(
            found,
            folder,
            problem,
            stated=stated,
            home=home / leg_folder(number),
            changes=changes,
            leg=number,
        )
    if solution.status.usable:
        _write_table(solution, stage)
    write_cycle(solution, stage, Path(os.path.relpath(problem, home)).as_posix(), changes)


def read_cycle_guess(folder: Path, cycle: Cycle) -> list[Assessment]:
    """Read the motions of all legs of an earlier cycle as initial guesses.

    Raises `InputFileError`: the folder has no cycle of as many legs of the same arm.
    """
    check_result(folder, CYCLE_FILE)
    legs = len(load_json(folder / CYCLE_FILE)["legs"])
    if legs != len(cycle.legs):
        raise InputFileError(
            folder / CYCLE_FILE,
            "legs",
            f"the earlier cycle has {legs} legs, this one {len(cycle.legs)}. Use one with the same "
            "stops.",
        )
    return [
        read_guess(folder / leg_folder(number), leg.problem)
        for number, leg in enumerate(cycle.legs, start=1)
    ]


def _write_table(solution: CycleSolution, folder: Path) -> None:
    """Write cycle.csv: time, leg, payload, motion of the motors, links."""
    commands, plans = leg_motions([leg.solution for leg in solution.legs])
    motors, links = solution.joined(commands), solution.joined(plans)
    times = export_times(solution.duration)
    begun = np.searchsorted([leg.start for leg in solution.legs], times + 1e-9, side="right")
    arrivals = np.array([leg.arrival for leg in solution.legs])
    masses = [solution.legs[0].mass_before, *(leg.mass_after for leg in solution.legs)]
    carried = np.array(masses)[np.searchsorted(arrivals, times, side="left")]
    columns = [times[:, None], begun[:, None], carried[:, None]]
    columns += [motors(times, order) for order in range(3)]
    columns.append(links(times))
    joints = range(1, columns[-1].shape[1] + 1)
    names = ["t", "leg", "payload"]
    names += [f"{quantity}{j}" for quantity in ("q", "qd", "qdd", "link") for j in joints]
    write_csv(folder / CYCLE_TABLE, names, np.hstack(columns).tolist())
