"""`stiffopt solve`, `preload`, `verify`, `stiffness`, `replay` and `report`."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from stiffopt.cli.base import Changes, Open, Out, Quiet, app, default_folder, show_report
from stiffopt.errors import InputError, InputFileError
from stiffopt.folders import output_folder
from stiffopt.interrupts import defer_until_result, defer_while_writing, end_deferral

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.report.common.progress import ProgressDisplay, StudyProgress

    Display = AbstractContextManager[ProgressDisplay | None]


@app.command
def solve(
    problem: Path,
    *,
    out: Out | None = None,
    model: Path | None = None,
    effects: Path | None = None,
    guess: Path | None = None,
    changes: Changes = (),
    report: bool = True,
    open_report: Open = False,
    quiet: Quiet = False,
) -> int:
    """Optimise and certify a trajectory.

    Writes result.json, trajectory.csv, report.html, state.bin and formulas.npz to solve similar
    problems from and, for an elastic arm, command.csv: the motor motion with which the links
    follow the plan. For a cycle of several [[move]] it writes cycle.json, cycle.csv, report.html
    and a folder with these files for each leg. Ctrl-C ends the solve and keeps the best motion so
    far; before the first motion it waits for it, pressed twice it stops immediately.

    Parameters
    ----------
    problem
        Trajectory problem file (TOML).
    out
        Folder for the results; default: out/NAME of the problem file, with the changes of --set.
    model
        extended.toml of a diagnosis of this arm: plan with the nominal and the extended model, and
        compare.
    effects
        Python file of its user-defined effects.
    guess
        Folder of an earlier solve of the same arm: its solved state, or where the problem differs
        in more than numbers its motion, is the initial guess. For a cycle that of an earlier cycle
        of as many legs: their motions and the split of the time.
    report
        Simulate rivals and draw report.html; `stiffopt report` does both later.
    """
    from stiffopt.problem.cycle_files import is_cycle

    if is_cycle(problem):
        if model is not None:
            raise InputError("--model is of single motions: omit it for a cycle.")
        return _solve_cycle(problem, out, changes, open_report, quiet, guess)
    with defer_until_result():
        from stiffopt.certificate.assess import assess
        from stiffopt.command.simulated_solution import with_simulation
        from stiffopt.path.load import load_problem
        from stiffopt.recipe.stored_result import (
            PREPARED_FILE,
            STATE_FILE,
            read_guess,
            read_state,
            write_state,
        )
        from stiffopt.result.archive import ARCHIVE_FILE, write_archive
        from stiffopt.result.compensation import write_command
        from stiffopt.result.status import SolveStatus
        from stiffopt.result.store import (
            RESULT_FILE,
            TRAJECTORY_FILE,
            export_times,
            write_result,
            write_rival,
            write_trajectory,
        )
        from stiffopt.solver.family import ProblemFamily

        stated = load_problem(problem, changes).problem
        found = None
        if model is not None:
            from stiffopt.discovery.extended.planning import read_model, solve_extended

            found = read_model(model, effects)
        if guess is not None and found is not None:
            raise InputError("--guess and --model exclude each other. Omit one of them.")
        begin = None if guess is None else functools.partial(read_guess, guess, stated)
        state = None if guess is None else read_state(guess)
        end = None
        folder = out or default_folder(problem.stem, changes)
        optional = (TRAJECTORY_FILE, STATE_FILE, PREPARED_FILE, ARCHIVE_FILE)
        with output_folder(folder, "solve", maybe=optional) as stage:
            with _problem_progress(stated, quiet) as progress, _name_file_in_errors(problem):
                if found is None:
                    solution, end = ProblemFamily().solve(
                        stated,
                        state,
                        progress=progress,
                        guess=begin,
                        simulate=True,
                        beside_rivals=report,
                    )
                else:
                    loop = solve_extended(stated, found, progress=progress)
                    stated = loop.problem
                    solution = with_simulation(stated, loop.solution, progress)
            end_deferral(ended=True)
            stopped = solution.status is SolveStatus.INTERRUPTED
            if stopped and not solution.solver.iterations and (folder / RESULT_FILE).exists():
                raise KeyboardInterrupt(
                    f"there was no motion yet; the earlier result in {folder} is unchanged."
                )
            with defer_while_writing():
                from stiffopt.report.solve.terminal import print_solution

                if solution.trajectory is not None:
                    times = export_times(solution.trajectory.duration)
                    exported = assess(stated, solution.trajectory, times=times)
                    write_trajectory(exported, stage)
                write_command(solution.compensation, stage)
                write_rival(solution.compensation, stage)
                write_state(end, stage)
                if report:
                    # matplotlib loads slowly: not before the solve.
                    from stiffopt.report.solve.page import write_solve_report

                    write_solve_report(stated, solution, stage)
                else:
                    write_archive(solution, stage)
                write_result(
                    solution,
                    stage,
                    problem,
                    home=folder,
                    stated=stated,
                    changes=changes,
                    model=model,
                    effects=effects,
                    guess=guess,
                )
    print_solution(stated, solution, folder)
    show_report(folder, open_report)
    return solution.status.exit_code


def _solve_cycle(
    problem: Path,
    out: Path | None,
    changes: Changes,
    open_report: bool,
    quiet: bool,
    guess: Path | None,
) -> int:
    """Optimise a cycle: cycle.json, cycle.csv, report.html, and a folder for each leg."""
    from stiffopt.cycle.cycle_store import read_cycle_guess, write_cycle_result
    from stiffopt.cycle.solve_cycle import solve_cycle
    from stiffopt.problem.cycle_files import load_cycle
    from stiffopt.report.pages.cycle import print_cycle, write_cycle_report

    cycle = load_cycle(problem, changes).cycle
    guesses = [] if guess is None else read_cycle_guess(guess, cycle)
    folder = out or default_folder(problem.stem, changes)
    with output_folder(folder, "solve") as stage:
        with (
            _progress_display(cycle.title, quiet) as progress,
            _name_file_in_errors(problem),
            defer_until_result(),
        ):
            solution = solve_cycle(cycle, progress=progress, guesses=guesses)
        end_deferral(ended=True)
        with defer_while_writing():
            write_cycle_report(cycle, solution, stage)
            write_cycle_result(solution, stage, problem, folder, changes)
    print_cycle(solution, folder)
    show_report(folder, open_report)
    return solution.status.exit_code


@app.command
def preload(
    study: Path,
    *,
    out: Out | None = None,
    changes: Changes = (),
    open_report: Open = False,
    quiet: Quiet = False,
) -> int:
    """Optimise the preloads of bolts and pins: preloads, tightening torques, active limits.

    Writes study.json, study.csv and report.html with its figures. `study`: preload study file
    (TOML). `out`: folder for the results; default: out/NAME of the study file, with the changes of
    --set.
    """
    from stiffopt.preload.files import load_study
    from stiffopt.preload.store import write_curves, write_study
    from stiffopt.preload.study import preload_study
    from stiffopt.report.preload.page import print_study, write_preload_report

    loaded = load_study(study, changes)
    folder = out or default_folder(study.stem, changes)
    with output_folder(folder, "preload") as stage:
        with _progress_display(loaded.problem.title, quiet) as display, _name_file_in_errors(study):
            result = preload_study(
                loaded.problem,
                motion=loaded.motion,
                rounds=loaded.rounds,
                front_points=loaded.front_points,
                progress=_study_callback(display),
            )
        with defer_while_writing():
            write_preload_report(result, stage)
            write_curves(result, stage)
            write_study(result, stage)
    print_study(result, folder)
    show_report(folder, open_report)
    return result.status.exit_code


@app.command
def verify(problems: Path, *more: Path, changes: Changes = (), quiet: Quiet = False) -> int:
    """Solve problem and study files again and compare with their expected values.

    With --set the expected values remain those of the file, to see the effect of a change.
    `problems`: trajectory problem or preload study file, or a folder of them. `more`: further files
    or folders.
    """
    from stiffopt import verify as verification
    from stiffopt.report.solve.terminal import print_check_begins, print_check_ends, print_checks

    checks: list[verification.Check] = []
    named = [path for each in (problems, *more) for path in verification.problem_files(each)]
    paths = list(dict.fromkeys(named))
    # Check all files before the first solve.
    for path in paths:
        verification.check_problem(path, changes)
    for number, path in enumerate(paths, start=1):
        if not quiet:
            print_check_begins(path, number, len(paths))
        with _progress_display(path.stem, quiet) as display, _name_file_in_errors(path):
            found = verification.verify(path, _study_callback(display), changes)
        checks += found
        if not quiet:
            print_check_ends(found)
        if checks[-1].interrupted:
            break
    print_checks(checks)
    if any(check.interrupted for check in checks):
        return 130
    return 0 if all(check.passed for check in checks) else 1


@app.command
def stiffness(
    robot: str,
    *,
    out: Out | None = None,
    drivetrain: Path | None = None,
    changes: Changes = (),
    open_report: Open = False,
) -> int:
    """Compute joint stiffness over torque, with and without contacts.

    Writes stiffness.csv and stiffness.html with its figures. `robot`: shipped robot (er3a_c60,
    er3a_c60_contact, ur10), robot file (TOML), URDF or MJCF. `out`: folder for the results;
    default: out/stiffness_NAME, with the changes of --set. `drivetrain`: robot file (TOML) with the
    drivetrain of a URDF or MJCF.
    """
    from stiffopt.report.pages.stiffness import write_stiffness_report
    from stiffopt.robot.files import load_robot
    from stiffopt.robot.stiffness_study import stiffness_study, write_stiffness_csv

    arm = load_robot(robot, drivetrain, changes=changes)
    folder = out or default_folder(f"stiffness_{arm.name}", changes)
    with output_folder(folder, "stiffness") as stage:
        rows = stiffness_study(arm)
        write_stiffness_csv(rows, stage / "stiffness.csv")
        page = write_stiffness_report(arm, rows, stage)
    print(f"Wrote {folder / 'stiffness.csv'} and {folder / page.name}")
    show_report(folder, open_report, page.name)
    return 0


@contextmanager
def _name_file_in_errors(path: Path) -> Iterator[None]:
    """Add the path of the file to errors of its problem."""
    try:
        yield
    except InputFileError:
        raise
    except InputError as error:
        raise InputFileError(path, "", str(error)) from error


def _problem_progress(problem: TrajectoryProblem, quiet: bool) -> Display:
    first = problem.objectives[0]
    return _progress_display(
        problem.title, quiet, first.unit if len(problem.objectives) == 1 else ""
    )


def _study_callback(display: ProgressDisplay | None) -> StudyProgress | None:
    """Return the callback of a preload study; None without a display."""
    from stiffopt.report.common.progress import StudyProgress

    return None if display is None else StudyProgress(display)


def _progress_display(title: str, quiet: bool, unit: str = "") -> Display:
    from stiffopt.report.common.progress import ProgressDisplay

    return nullcontext() if quiet else ProgressDisplay(title, unit)


@app.command
def replay(folder: Path, *, quiet: Quiet = False) -> int:
    """Solve a stored result again by its recipe, and say whether the answer is the same.

    Every stage has to end in the same objective to 1e-9, else the first one that differs is named,
    with versions that do. Exit code 1 where the answer differs. `folder`: folder of `stiffopt
    solve`.
    """
    from stiffopt.recipe.replay import replay as solve_again

    with _progress_display(str(folder), quiet) as progress:
        found = solve_again(folder, progress=progress)
    changed = found.differences
    print("the same answer, stage by stage" if not changed else "; ".join(changed))
    return 1 if changed else 0


@app.command
def report(folder: Path, *, open_report: Open = False) -> int:
    """Draw report.html of a solve that was made with --no-report.

    Nothing is solved: the stored motion is compared with simulated rivals. `folder`: folder of
    `stiffopt solve --no-report`.
    """
    from stiffopt.recipe.stored_result import read_stored_solution
    from stiffopt.report.solve.page import REPORT_FILE, write_solve_report
    from stiffopt.result.store import write_rival
    from stiffopt.solver.solve import complete_comparison

    stated, stored = read_stored_solution(folder)
    with output_folder(folder, "report", of="solve") as stage:
        solution = complete_comparison(stated, stored)
        with defer_while_writing():
            write_solve_report(stated, solution, stage)
            if solution.compensation is not stored.compensation:
                write_rival(solution.compensation, stage)
    print(f"Report: {folder / REPORT_FILE}")
    show_report(folder, open_report)
    return 0
