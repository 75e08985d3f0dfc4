"""`stiffopt diagnose`, `rollout`, `recording check` and `identify-stiffness`."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from stiffopt.cli import base
from stiffopt.errors import InputError, InputFileError
from stiffopt.folders import output_folder
from stiffopt.interrupts import defer_while_writing

recording = App(name="recording", help="Check recordings before a diagnosis.")
base.app.command(recording)


@base.app.command
def diagnose(
    recordings: Path | None = None,
    *more: Path,
    before: Path | None = None,
    after: Path | None = None,
    out: base.Out | None = None,
    model: Path | None = None,
    effects: Path | None = None,
    experiment: bool = True,
    report: bool = True,
    png: bool = False,
    despite_doubts: Annotated[bool, Parameter(negative=())] = False,
    workers: int | None = None,
    scheduler: str | None = None,
    changes: base.Changes = (),
    open_report: base.Open = False,
    quiet: base.Quiet = False,
) -> int:
    """Identify effects that the nominal model lacks, and validate them on held-out runs.

    Writes diagnosis.json, extended.toml, report.html and the predictions of test and extrapolation
    runs. Ctrl-C ends the search and keeps the findings so far. For several sets, such as a fleet:
    cases/KEY.json for each, then a table and report.html, as `stiffopt sweep`, with the values that
    all arms share and each arm's own where they follow commands; the same command resumes an
    interrupted one.

    Parameters
    ----------
    recordings
        Recording set: its folder or its recordings.toml.
    more
        Further sets.
    before, after
        Two sets of one robot in two states, in place of a recording set: names what changed
        between them, such as by maintenance, a new gripper or a crash. extended.toml is the model
        of the state after.
    out
        Folder for the results; default: out/NAME of the set's folder, with the changes of --set;
        for several sets out/fleet.
    model
        extended.toml of an earlier diagnosis, used in place of the nominal model.
    effects
        Python file of effects beside those of the catalogue.
    experiment
        Where two explanations remain, design the motion that separates them best
        (next_experiment.csv); takes up to 20 s.
    report
        Write report.html and its figures.
    png
        Write the figures also as PNG.
    despite_doubts
        Continue where units, signs or orders contradict the recordings; the doubts are reported.
    workers
        Processes for several sets; default one per core.
    scheduler
        Address of a Dask scheduler for several sets; its workers need access to the same files.
    """
    _require_one_question(recordings, before, after, model)
    if recordings is not None and more:
        of_one = {
            "--model": model,
            "--effects": effects,
            "--png": png,
            "--despite-doubts": despite_doubts,
            "--no-experiment": not experiment,
            "--no-report": not report,
        }
        for option, given in of_one.items():
            if given:
                raise InputError(
                    f"{option} needs a single recording set; {1 + len(more)} were given."
                )
        from stiffopt.cli.sweeps import run_cases, start_workers
        from stiffopt.sweep.cases import fleet_sweep

        fleet = fleet_sweep([recordings, *more], changes)
        folder = out or Path("out") / "fleet"
        pool = start_workers(workers, scheduler)
        return run_cases(fleet, folder, pool, open_report=open_report, quiet=quiet)
    for option, other in (("--workers", workers), ("--scheduler", scheduler)):
        if other is not None:
            raise InputError(f"{option} needs several recording sets; one was given.")
    from stiffopt.discovery.diagnose import diagnose as find
    from stiffopt.discovery.experiment.design import EXPERIMENT_FILE
    from stiffopt.discovery.store import LAW_FILE, write_diagnosis
    from stiffopt.recording.recording_set import RecordingSet, load_recordings
    from stiffopt.recording.state_pair import load_state_pair
    from stiffopt.report.common.terminal import StepDisplay
    from stiffopt.report.diagnosis.sections import print_diagnosis

    if before is not None and after is not None:
        states = [load_recordings(each, changes) for each in (before, after)]
        loaded: RecordingSet = load_state_pair(*states)
        homes = [each.path.parent.resolve() for each in states]
    else:
        assert recordings is not None
        loaded = load_recordings(recordings, changes)
        homes = [loaded.path.parent.resolve()]
    chosen = out or base.default_folder("_to_".join(home.name for home in homes), changes)
    for home in homes:
        if home in (chosen.resolve(), *chosen.resolve().parents):
            raise InputFileError(
                chosen,
                "",
                f"lies in the recording set {home}, which is read-only. Give another --out.",
            )
    with output_folder(
        chosen, "diagnose", maybe=("report.html", EXPERIMENT_FILE, LAW_FILE)
    ) as stage:
        with nullcontext() if quiet else StepDisplay(loaded.title) as progress:
            found = find(
                loaded,
                effects=effects or (),
                model=model,
                experiment=experiment,
                progress=progress,
                despite_doubts=despite_doubts,
            )
        with defer_while_writing():
            if report:
                from stiffopt.report.diagnosis.page import write_diagnosis_report

                write_diagnosis_report(found, stage, png=png)
            write_diagnosis(found, stage)
    print_diagnosis(found, chosen)
    base.show_report(chosen, open_report)
    return 130 if found.stopped else 0


def _require_one_question(
    recordings: Path | None, before: Path | None, after: Path | None, model: Path | None
) -> None:
    """Raise `InputError` unless either recording sets or two states are given."""
    if before is None and after is None:
        if recordings is None:
            raise InputError(
                "diagnose needs a recording set, or two states of one robot: --before SET"
                " --after SET."
            )
        return
    if before is None or after is None:
        given, missing = ("--before", "--after") if after is None else ("--after", "--before")
        raise InputError(f"{given} needs {missing} as well: the set of the other state.")
    if recordings is not None:
        raise InputError(
            f"--before and --after are the recording sets; {recordings} is one too many. Leave it"
            " out."
        )
    if model is not None:
        raise InputError(
            "--model starts from an earlier state, as --before does: give one of the two."
        )


@recording.command
def check(
    recordings: Path,
    *,
    effects: Path | None = None,
    json: bool = False,
    changes: base.Changes = (),
) -> int:
    """Check a recording set: content, missing signals, identifiable effects.

    The exit code is 2 where `stiffopt diagnose` (of a static set: `identify-stiffness`) cannot use
    it, and where units, signs or orders contradict the recordings. `recordings`: folder with a
    recordings.toml or a static.toml, or that file. `effects`: Python file of effects beside those
    of the catalogue. `json`: print JSON instead of text.
    """
    from stiffopt.discovery.catalogue import CATALOGUE
    from stiffopt.discovery.identifiable import effect_checks
    from stiffopt.discovery.sanity.actuator_estimate import resolve_actuator
    from stiffopt.discovery.sanity.command_doubts import take_errors_as_commands
    from stiffopt.discovery.sanity.doubt import DoubtfulRecordings
    from stiffopt.discovery.sanity.gate import judge_plausibility
    from stiffopt.discovery.training import open_training_runs
    from stiffopt.discovery.user_effects import load_effects
    from stiffopt.recording.check import check_recordings
    from stiffopt.recording.recording_set import load_recordings, require_usable
    from stiffopt.recording.static_set import is_static, load_static_set
    from stiffopt.report import recording_check as terminal
    from stiffopt.report.common.terminal import print_lines

    if is_static(recordings):
        facts = terminal.static_facts(load_static_set(recordings, changes))
        if json:
            base.print_json(facts)
        else:
            terminal.print_static_check(facts)
        return 0
    loaded = load_recordings(recordings, changes)
    loaded, taken = take_errors_as_commands(loaded)
    resolved = resolve_actuator(loaded, open_training_runs(loaded))
    loaded, training, derived = resolved.recordings, resolved.runs, (*taken, *resolved.notes)
    report = check_recordings(loaded)
    every = (*CATALOGUE, *(load_effects(effects) if effects else ()))
    found = effect_checks(loaded, report.facts, report.training_runs, every)
    doubted, remarked = judge_plausibility(loaded, training, despite_doubts=True)
    if json:
        base.print_json(
            report.as_dict()
            | {
                "effects": [each.as_dict() for each in found],
                "doubts": [doubt.as_dict() for doubt in doubted],
                "remarks": [doubt.as_dict() for doubt in remarked],
                "derived": list(derived),
            }
        )
    else:
        terminal.print_check(report, found)
        print_lines(derived)
        print_lines(f"Warning: {each}" for each in remarked)
    if doubted:
        raise DoubtfulRecordings(loaded.path, doubted)
    require_usable(loaded, {run.file for run in report.runs if run.usable})
    return 0


@base.app.command(name="identify-stiffness")
def identify_stiffness(
    recordings: Path,
    *,
    beside: tuple[Path, ...] = (),
    robot: str = "",
    out: base.Out | None = None,
    changes: base.Changes = (),
    open_report: base.Open = False,
) -> int:
    """Identify the joint stiffness of an arm from deflections measured under known forces.

    Writes stiffness.json, stiffness.csv, residuals.csv and report.html; with --beside or --robot
    comparison.json and comparison.csv, and with --robot uncertainty.toml, the bounds of the
    modelled stiffness that cover what was identified.

    Parameters
    ----------
    recordings
        Folder with a static.toml, or that file.
    beside
        Further static sets of this arm or others of its type; repeat the option for each.
    robot
        Robot with drivetrains, by name or file, whose modelled stiffness is compared.
    out
        Folder for the results; default: out/NAME of the folder, with the changes of --set.
    """
    from stiffopt.identification.comparison import (
        JointComparison,
        compare_stiffness,
        write_comparison,
    )
    from stiffopt.identification.result import write_static
    from stiffopt.identification.stiffness import identify_stiffness as identify
    from stiffopt.recording.static_set import load_static_set
    from stiffopt.report.pages.identification import (
        print_comparison,
        print_static,
        write_static_report,
    )
    from stiffopt.robot.files import load_robot

    recorded = load_static_set(recordings, changes)
    others = [load_static_set(path, changes) for path in beside]
    modelled = load_robot(robot) if robot else None
    folder = out or base.default_folder(recorded.path.resolve().parent.name, changes)
    with output_folder(folder, "identify-stiffness") as stage:
        result = identify(recorded)
        write_static_report(result, stage)
        write_static(result, stage)
        names = [each.title for each in (recorded, *others)]
        joints: tuple[JointComparison, ...] = ()
        if others or modelled is not None:
            results = [result, *(identify(each, torque=False) for each in others)]
            joints = compare_stiffness(results, modelled)
            write_comparison(names, joints, stage)
    print_static(result, folder)
    if joints:
        print_comparison(names, joints)
    base.show_report(folder, open_report)
    return 0


@base.app.command
def rollout(
    recordings: Path,
    *,
    model: Path,
    out: base.Out | None = None,
    changes: base.Changes = (),
) -> int:
    """Simulate what the arm would have done on the recorded commands, before and after a diagnosis.

    Writes rollout.json, and for each run its positions as CSV and a picture of command, measured
    and simulated positions. A simulation sees the commands and the first position of a run alone.
    `recordings`: recording set with commands: its folder or its recordings.toml. `model`:
    extended.toml of a diagnosis of this arm from commands. `out`: folder for the results; default:
    out/NAME-rollout of the set's folder.
    """
    from stiffopt.discovery.extended.model import load_extended
    from stiffopt.discovery.rollout import roll_out, write_rollout
    from stiffopt.recording.recording_set import load_recordings
    from stiffopt.report.common.svg import to_png
    from stiffopt.report.common.terminal import print_lines, print_table
    from stiffopt.report.diagnosis.figures import position_figure
    from stiffopt.report.diagnosis.positions import position_section

    loaded = load_recordings(recordings, changes)
    home = loaded.path.parent.resolve()
    folder = out or base.default_folder(f"{home.name}-rollout", changes)
    if home in (folder.resolve(), *folder.resolve().parents):
        raise InputFileError(
            folder, "", f"lies in the recording set {home}, which is read-only. Give another --out."
        )
    with output_folder(folder, "rollout") as stage:
        runs = roll_out(loaded, load_extended(model))
        for run in runs:
            figure = position_figure(run, loaded.joints, loaded.prismatic)
            (stage / f"{run.name}.png").write_bytes(to_png(figure))
        write_rollout(runs, loaded.joints, stage)
    section = position_section(runs, loaded.prismatic)
    print_table(section.head, section.rows, title=section.title)
    print_lines([f"{len(runs)} run(s) of {loaded.path} simulated.", f"Files: {folder}"])
    return 0
