"""`stiffopt solve`, `preload`, `verify` and `stiffness`: motions, fasteners, joints of a model."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from stiffopt.cli.base import Changes, Open, Out, app, default_folder, show_report
from stiffopt.errors import InputError, InputFileError
from stiffopt.folders import output_folder
from stiffopt.interrupts import beginning, delivered, finishing

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
    open_report: Open = False,
    quiet: bool = False,
) -> int:
    """Optimise a trajectory and certify it.

    Writes result.json, trajectory.csv, report.html and, of an elastic arm, command.csv: what the
    motors must do so that the links move as planned. Ctrl-C ends the solve and keeps the best
    motion so far; pressed before there is one it waits for the first, pressed twice it does not.

    Parameters
    ----------
    problem
        A trajectory problem file (TOML).
    out
        Default: out/NAME of the problem file, with what --set changes.
    model
        extended.toml of a diagnosis of this arm: plan without and with what was found, and
        compare.
    effects
        Python file of the effects in it that are not of the catalogue.
    guess
        Folder of an earlier solve of the same arm, whose motion is begun from.
    quiet
        No progress display.
    """
    with beginning():
        from stiffopt.certificate.assess import assess
        from stiffopt.problem.files import load_problem
        from stiffopt.result.compensation_store import write_command
        from stiffopt.result.status import SolveStatus
        from stiffopt.result.store import (
            RESULT_FILE,
            TRAJECTORY_FILE,
            export_times,
            write_result,
            write_trajectory,
        )
        from stiffopt.solver.simulation import with_simulation
        from stiffopt.solver.solve import solve as optimise
        from stiffopt.solver.stored import read_guess

        loaded = load_problem(problem, changes)
        stated = loaded.problem
        found = None
        if model is not None:
            from stiffopt.discovery.extended.planning import read_model, solve_extended

            found = read_model(model, effects)
        if guess is not None and found is not None:
            raise InputError("--guess is of a solve without --model: leave one of them out.")
        begin = None if guess is None else read_guess(guess, stated)
        folder = out or default_folder(problem.stem, changes)
        with output_folder(folder, "solve", maybe=(TRAJECTORY_FILE,)) as stage:
            with _progress(stated, quiet) as progress, _about(problem):
                if found is None:
                    solution = optimise(
                        stated, progress=progress, guess=begin, throw=False, simulate=True
                    )
                else:
                    loop = solve_extended(stated, found, progress=progress)
                    stated = loop.problem
                    solution = with_simulation(stated, loop.solution, progress)
            delivered(ended=True)
            stopped = solution.status is SolveStatus.INTERRUPTED
            if stopped and not solution.solver.iterations and (folder / RESULT_FILE).exists():
                raise KeyboardInterrupt(
                    f"the optimiser had no motion yet, and the earlier answer in {folder} stays."
                )
            with finishing():
                # Figures need a while to load: not before the solve.
                from stiffopt.report.solve.page import write_solve_report
                from stiffopt.report.solve.terminal import print_solution

                if solution.trajectory is not None:
                    times = export_times(solution.trajectory.duration)
                    exported = assess(stated, solution.trajectory, times=times)
                    write_trajectory(exported, stage)
                write_command(solution.compensation, stage)
                write_solve_report(stated, solution, stage)
                write_result(solution, stage, problem, home=folder, stated=stated)
    print_solution(stated, solution, folder)
    show_report(folder, open_report)
    return solution.status.exit_code


@app.command
def preload(
    study: Path,
    *,
    out: Out | None = None,
    changes: Changes = (),
    open_report: Open = False,
    quiet: bool = False,
) -> int:
    """Find how tight bolts and pins must be: preloads, tightening torques, what binds.

    Writes study.json, study.csv and report.html with its figures.

    Parameters
    ----------
    study
        A preload study file (TOML).
    out
        Default: out/NAME of the study file, with what --set changes.
    quiet
        No progress display.
    """
    from stiffopt.preload.files import load_study
    from stiffopt.preload.store import write_curves, write_study
    from stiffopt.preload.study import preload_study
    from stiffopt.report.preload.page import write_preload_report
    from stiffopt.report.preload.terminal import print_study

    loaded = load_study(study, changes)
    folder = out or default_folder(study.stem, changes)
    with output_folder(folder, "preload") as stage:
        with _named_progress(loaded.problem.title, quiet) as display, _about(study):
            result = preload_study(
                loaded.problem,
                motion=loaded.motion,
                rounds=loaded.rounds,
                front_points=loaded.front_points,
                progress=_study_progress(display),
            )
        with finishing():
            write_preload_report(result, stage)
            write_curves(result, stage)
            write_study(result, stage)
    print_study(result, folder)
    show_report(folder, open_report)
    return result.status.exit_code


@app.command
def verify(problems: Path, *more: Path, changes: Changes = (), quiet: bool = False) -> int:
    """Solve problem and study files anew and compare with the values they expect.

    With --set the expected values stay those of the file: to see what a change does to them.

    Parameters
    ----------
    problems
        A trajectory problem or preload study file, or a folder of them.
    more
        Further ones.
    quiet
        No progress display.
    """
    from stiffopt import verify as verification
    from stiffopt.report.solve.terminal import (
        print_check_begins,
        print_check_ends,
        print_checks,
    )

    checks: list[verification.Check] = []
    named = [path for each in (problems, *more) for path in verification.problem_files(each)]
    paths = list(dict.fromkeys(named))
    # A fault in the last file must not cost the time of the others.
    for path in paths:
        verification.check_problem(path, changes)
    for number, path in enumerate(paths, start=1):
        if not quiet:
            print_check_begins(path, number, len(paths))
        with _named_progress(path.stem, quiet) as display, _about(path):
            found = verification.verify(path, _study_progress(display), changes)
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
    """Joint stiffness against torque, with and without contacts: stiffness.csv, plots and a page.

    Parameters
    ----------
    robot
        A shipped robot (er3a_c60, er3a_c60_contact, ur10), a robot TOML, or a URDF.
    out
        Default: out/stiffness_NAME, with what --set changes.
    drivetrain
        Robot TOML beside a URDF.
    """
    from stiffopt.report.stiffness.page import write_stiffness_report
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
def _about(path: Path) -> Iterator[None]:
    """Add the problem file to what is said about the problem."""
    try:
        yield
    except InputFileError:
        raise
    except InputError as error:
        raise InputFileError(path, "", str(error)) from error


def _progress(problem: TrajectoryProblem, quiet: bool) -> Display:
    first = problem.objectives[0]
    return _named_progress(problem.title, quiet, first.unit if len(problem.objectives) == 1 else "")


def _study_progress(display: ProgressDisplay | None) -> StudyProgress | None:
    """Callback of a preload study; `display` is None where nothing is to be shown."""
    from stiffopt.report.common.progress import StudyProgress

    return None if display is None else StudyProgress(display)


def _named_progress(title: str, quiet: bool, unit: str = "") -> Display:
    from stiffopt.report.common.progress import ProgressDisplay

    return nullcontext() if quiet else ProgressDisplay(title, unit)
