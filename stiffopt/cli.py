"""The command line: `stiffopt solve`, `preload`, `diagnose`, `recording check` and the others.

Exit codes: 0 done, 1 a verified value is off, 2 wrong input or command line, 3 no usable result,
130 interrupted. Commands import what they need, so that help and errors come at once.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter

from stiffopt.errors import InputError, InputFileError, NoSolutionFound
from stiffopt.folders import output_folder, staged

app = App(
    name="stiffopt",
    help="Stiff and true trajectories for industrial robot arms.",
    help_on_error=False,
    # `run` says what an interruption means.
    suppress_keyboard_interrupt=False,
)

recording = App(name="recording", help="Look at recordings before they are used.")
app.command(recording)

Out = Annotated[Path, Parameter(name="--out", help="Folder for the results; made if missing.")]


@app.command
def solve(
    problem: Path,
    *,
    out: Out | None = None,
    model: Path | None = None,
    effects: Path | None = None,
    quiet: bool = False,
) -> int:
    """Optimise a trajectory and certify it.

    Writes result.json, trajectory.csv and report.html. Ctrl-C ends the solve and keeps the best
    motion so far.

    Parameters
    ----------
    problem
        A trajectory problem file (TOML).
    out
        Default: out/NAME of the problem file.
    model
        extended.toml of a diagnosis of this arm: plan without and with what was found, and
        compare.
    effects
        Python file of the effects in it that are not of the catalogue.
    quiet
        No progress display.
    """
    from stiffopt.certificate.assess import assess
    from stiffopt.problem.files import load_problem
    from stiffopt.report.page import write_solve_report
    from stiffopt.report.terminal import print_solution
    from stiffopt.result.store import export_times, write_result, write_trajectory
    from stiffopt.study.optimise import solve as optimise

    loaded = load_problem(problem)
    stated = loaded.problem
    found = None
    if model is not None:
        from stiffopt.discovery.planner_solve import read_model, solve_extended

        found = read_model(model, effects)
    with output_folder(out or Path("out") / problem.stem) as folder:
        with _progress(stated, quiet) as progress, _about(problem):
            if found is None:
                solution = optimise(stated, progress=progress, throw=False)
            else:
                loop = solve_extended(stated, found, progress=progress)
                stated, solution = loop.problem, loop.solution
        if solution.trajectory is not None:
            times = export_times(solution.trajectory.duration)
            exported = assess(stated, solution.trajectory, times=times)
            write_trajectory(exported, folder)
        write_solve_report(stated, solution, folder)
        write_result(solution, folder)
    print_solution(stated, solution, folder)
    return solution.status.exit_code


@app.command
def preload(study: Path, *, out: Out | None = None, quiet: bool = False) -> int:
    """Find how tight bolts and pins must be: preloads, tightening torques, what binds.

    Writes study.json, study.csv and report.html with its figures.

    Parameters
    ----------
    study
        A preload study file (TOML).
    out
        Default: out/NAME of the study file.
    quiet
        No progress display.
    """
    from stiffopt.preload.files import load_study
    from stiffopt.preload.store import write_curves, write_study
    from stiffopt.preload.study import preload_study
    from stiffopt.report.preload_page import write_preload_report
    from stiffopt.report.terminal import print_study

    loaded = load_study(study)
    with output_folder(out or Path("out") / study.stem) as folder:
        with _named_progress(loaded.problem.title, quiet) as display, _about(study):
            result = preload_study(
                loaded.problem,
                motion=loaded.motion,
                rounds=loaded.rounds,
                front_points=loaded.front_points,
                progress=_study_progress(display),
            )
        write_preload_report(result, folder)
        write_curves(result, folder)
        write_study(result, folder)
    print_study(result, folder)
    return result.status.exit_code


@app.command
def verify(problems: Path, *, quiet: bool = False) -> int:
    """Solve problem and study files anew and compare with the values they expect.

    Parameters
    ----------
    problems
        A trajectory problem or preload study file, or a folder of them.
    quiet
        No progress display.
    """
    from stiffopt import verify as verification
    from stiffopt.report.terminal import print_checks

    checks: list[verification.Check] = []
    paths = verification.problem_files(problems)
    # A fault in the last file must not cost the time of the others.
    for path in paths:
        verification.check_problem(path)
    for path in paths:
        with _named_progress(path.stem, quiet) as display, _about(path):
            checks += verification.verify(path, _study_progress(display))
        if checks[-1].interrupted:
            break
    print_checks(checks)
    if any(check.interrupted for check in checks):
        return 130
    return 0 if all(check.passed for check in checks) else 1


@app.command
def stiffness(robot: str, *, out: Out | None = None, drivetrain: Path | None = None) -> int:
    """Joint stiffness against torque, with and without contacts: stiffness.csv, plots and a page.

    Parameters
    ----------
    robot
        A shipped robot (er3a_c60, er3a_c60_contact, ur10), a robot TOML, or a URDF.
    out
        Default: out/stiffness_NAME.
    drivetrain
        Robot TOML beside a URDF.
    """
    from stiffopt.report.stiffness_page import write_stiffness_report
    from stiffopt.robot.files import load_robot
    from stiffopt.study.stiffness import stiffness_study, write_stiffness_csv

    arm = load_robot(robot, drivetrain)
    with output_folder(out or Path("out") / f"stiffness_{arm.name}") as folder:
        rows = stiffness_study(arm)
        write_stiffness_csv(rows, folder / "stiffness.csv")
        page = write_stiffness_report(arm, rows, folder)
    print(f"Wrote {folder / 'stiffness.csv'} and {page}")
    return 0


@app.command
def diagnose(
    recordings: Path,
    *,
    out: Out | None = None,
    model: Path | None = None,
    effects: Path | None = None,
    experiment: bool = True,
    quiet: bool = False,
) -> int:
    """Find what the nominal model of recordings lacks, and prove it on runs never fitted to.

    Writes diagnosis.json, extended.toml, report.html and the predictions of test and extrapolation
    runs.

    Parameters
    ----------
    recordings
        A recording set: its folder or its recordings.toml.
    out
        Default: out/NAME of the folder of the set.
    model
        extended.toml of an earlier diagnosis, to start from in place of the nominal model.
    effects
        Python file of effects beside those of the catalogue.
    experiment
        Where two explanations are left, design the motion that would separate them best
        (next_experiment.csv); takes up to 20 s.
    quiet
        No progress display.
    """
    from stiffopt.discovery.answer_store import ANSWER_FILE, write_diagnosis
    from stiffopt.discovery.diagnose import diagnose as find
    from stiffopt.discovery.experiment import EXPERIMENT_FILE
    from stiffopt.recording.recording_set import load_recordings
    from stiffopt.report.diagnosis_page import write_diagnosis_report
    from stiffopt.report.diagnosis_terminal import Sentences, print_diagnosis

    loaded = load_recordings(recordings)
    home = loaded.path.parent.resolve()
    chosen = out or Path("out") / home.name
    if home in (chosen.resolve(), *chosen.resolve().parents):
        raise InputFileError(
            chosen, "", f"lies in the recording set {home}, which is only read. Give another --out."
        )
    with output_folder(chosen) as folder:
        with nullcontext() if quiet else Sentences(loaded.title) as progress:
            found = find(
                loaded, effects=effects or (), model=model, experiment=experiment, progress=progress
            )
        # A motion designed by an earlier diagnosis is none of this one's.
        (folder / EXPERIMENT_FILE).unlink(missing_ok=True)
        with staged(folder, last=ANSWER_FILE) as stage:
            write_diagnosis_report(found, stage)
            write_diagnosis(found, stage)
    print_diagnosis(found, folder)
    return 0


@recording.command
def check(recordings: Path, *, json: bool = False) -> int:
    """Say what a recording set holds, what it lacks and what can be identified with it.

    Ends with 2 where `stiffopt diagnose` (of a static set: `identify-stiffness`) cannot use it.

    Parameters
    ----------
    recordings
        Folder with a recordings.toml or a static.toml, or that file.
    json
        Print plain data in place of text.
    """
    from stiffopt.recording.check import check_recordings
    from stiffopt.recording.recording_set import load_recordings, require_usable
    from stiffopt.recording.static_set import is_static, load_static_set
    from stiffopt.report import recording_terminal as terminal

    if is_static(recordings):
        facts = terminal.static_facts(load_static_set(recordings))
        if json:
            _print_json(facts)
        else:
            terminal.print_static_check(facts)
        return 0
    loaded = load_recordings(recordings)
    report = check_recordings(loaded)
    if json:
        _print_json(report.as_dict())
    else:
        terminal.print_check(report)
    require_usable(loaded, {run.file for run in report.runs if run.usable})
    return 0


@app.command(name="identify-stiffness")
def identify_stiffness(recordings: Path, *, out: Out | None = None) -> int:
    """Find the joint stiffness of an arm from deflections measured under known forces.

    Writes stiffness.json, stiffness.csv, residuals.csv and report.html.

    Parameters
    ----------
    recordings
        Folder with a static.toml, or that file.
    out
        Default: out/NAME of the folder.
    """
    from stiffopt.discovery.static_stiffness import identify_stiffness as identify
    from stiffopt.discovery.static_store import write_static
    from stiffopt.recording.static_set import load_static_set
    from stiffopt.report.static_page import write_static_report
    from stiffopt.report.static_terminal import print_static

    recorded = load_static_set(recordings)
    with output_folder(out or Path("out") / recorded.path.resolve().parent.name) as folder:
        result = identify(recorded)
        write_static_report(result, folder)
        write_static(result, folder)
    print_static(result, folder)
    return 0


@app.command
def schema(
    kind: Literal[
        "trajectory", "robot", "preload", "recordings", "static", "extended"
    ] = "trajectory",
) -> int:
    """Print the JSON Schema of a file kind, for editors.

    Parameters
    ----------
    kind
        Which file.
    """
    from stiffopt.discovery.extended_schema import ExtendedFile
    from stiffopt.files import Section
    from stiffopt.preload.schema import PreloadFile
    from stiffopt.problem.schema import ProblemFile
    from stiffopt.recording.schema import RecordingsFile, StaticFile
    from stiffopt.robot.schema import RobotFile

    models: dict[str, type[Section]] = {
        "trajectory": ProblemFile,
        "robot": RobotFile,
        "preload": PreloadFile,
        "recordings": RecordingsFile,
        "static": StaticFile,
        "extended": ExtendedFile,
    }
    _print_json(models[kind].model_json_schema(by_alias=True))
    return 0


def _print_json(document: Any) -> None:
    import json

    print(json.dumps(document, indent=2, ensure_ascii=False))


@contextmanager
def _about(path: Path) -> Iterator[None]:
    """Add the problem file to what is said about the problem."""
    try:
        yield
    except InputFileError:
        raise
    except InputError as error:
        raise InputFileError(path, "", str(error)) from error


def _progress(problem: Any, quiet: bool) -> Any:
    first = problem.objectives[0]
    return _named_progress(problem.title, quiet, first.unit if len(problem.objectives) == 1 else "")


def _study_progress(display: Any) -> Any:
    """Callback of a preload study; `display` is None where nothing is to be shown."""
    from stiffopt.report.progress import StudyProgress

    return None if display is None else StudyProgress(display)


def _named_progress(title: str, quiet: bool, unit: str = "") -> Any:
    from stiffopt.report.progress import ProgressDisplay

    return nullcontext() if quiet else ProgressDisplay(title, unit)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; return its exit code. Errors of the user become one message."""
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except (InputError, CycloptsError) as error:
        print(f"stiffopt: {error}", file=sys.stderr)
        return 2
    except NoSolutionFound as error:
        print(f"stiffopt: {error}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        print("stiffopt: interrupted; nothing was written.", file=sys.stderr)
        return 130
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"stiffopt: {place}{error.strerror or error}", file=sys.stderr)
        return 2
    return code if isinstance(code, int) else 0


def main() -> None:
    """Entry point of the `stiffopt` command."""
    sys.exit(run())
