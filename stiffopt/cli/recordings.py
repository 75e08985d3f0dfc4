"""`stiffopt diagnose`, `recording check` and `identify-stiffness`: what measurements say."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from stiffopt.cli.base import Changes, Open, Out, app, default_folder, print_json, show_report
from stiffopt.errors import InputError, InputFileError
from stiffopt.folders import output_folder
from stiffopt.interrupts import finishing

recording = App(name="recording", help="Look at recordings before they are used.")
app.command(recording)


@app.command
def diagnose(
    recordings: Path,
    *more: Path,
    out: Out | None = None,
    model: Path | None = None,
    effects: Path | None = None,
    experiment: bool = True,
    report: bool = True,
    png: bool = False,
    despite_doubts: Annotated[bool, Parameter(negative=())] = False,
    workers: int | None = None,
    scheduler: str | None = None,
    changes: Changes = (),
    open_report: Open = False,
    quiet: bool = False,
) -> int:
    """Find what the nominal model of recordings lacks, and prove it on runs never fitted to.

    Writes diagnosis.json, extended.toml, report.html and the predictions of test and extrapolation
    runs. Ctrl-C ends the search and keeps what was found so far. Of several sets, such as a fleet:
    cases/KEY.json for each as it is done, then a table and report.html, as `stiffopt sweep` does;
    the same command goes on where a killed or interrupted one stopped.

    Parameters
    ----------
    recordings
        A recording set: its folder or its recordings.toml.
    more
        Further sets.
    out
        Default: out/NAME of the folder of the set, with what --set changes; of several, out/fleet.
    model
        extended.toml of an earlier diagnosis, to start from in place of the nominal model.
    effects
        Python file of effects beside those of the catalogue.
    experiment
        Where two explanations are left, design the motion that would separate them best
        (next_experiment.csv); takes up to 20 s.
    report
        Write report.html and its figures.
    png
        Write the figures of the report as PNG beside SVG.
    despite_doubts
        Go on where units, signs or orders contradict the recordings; the answer tells the doubts.
    workers
        Of several sets: processes; default one a core.
    scheduler
        Of several sets: address of a Dask scheduler whose workers see the same files.
    quiet
        No progress display.
    """
    if more:
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
                raise InputError(f"{option} is of one recording set, not of {1 + len(more)}.")
        from stiffopt.cli.sweeps import employed, swept
        from stiffopt.sweep.cases import fleet_of

        fleet = fleet_of([recordings, *more], changes)
        folder = out or Path("out") / "fleet"
        pool = employed(workers, scheduler)
        return swept(fleet, folder, pool, open_report=open_report, quiet=quiet)
    for option, other in (("--workers", workers), ("--scheduler", scheduler)):
        if other is not None:
            raise InputError(f"{option} is of several recording sets; this is one.")
    from stiffopt.discovery.diagnose import diagnose as find
    from stiffopt.discovery.experiment.design import EXPERIMENT_FILE
    from stiffopt.discovery.store import write_diagnosis
    from stiffopt.recording.recording_set import load_recordings
    from stiffopt.report.common.status_line import StepDisplay
    from stiffopt.report.diagnosis.terminal import print_diagnosis

    loaded = load_recordings(recordings, changes)
    home = loaded.path.parent.resolve()
    chosen = out or default_folder(home.name, changes)
    if home in (chosen.resolve(), *chosen.resolve().parents):
        raise InputFileError(
            chosen, "", f"lies in the recording set {home}, which is only read. Give another --out."
        )
    with output_folder(chosen, "diagnose", maybe=("report.html", EXPERIMENT_FILE)) as stage:
        with nullcontext() if quiet else StepDisplay(loaded.title) as progress:
            found = find(
                loaded,
                effects=effects or (),
                model=model,
                experiment=experiment,
                progress=progress,
                despite_doubts=despite_doubts,
            )
        with finishing():
            if report:
                from stiffopt.report.diagnosis.page import write_diagnosis_report

                write_diagnosis_report(found, stage, png=png)
            write_diagnosis(found, stage)
    print_diagnosis(found, chosen)
    show_report(chosen, open_report)
    return 130 if found.stopped else 0


@recording.command
def check(
    recordings: Path,
    *,
    effects: Path | None = None,
    json: bool = False,
    changes: Changes = (),
) -> int:
    """Say what a recording set holds, what it lacks and what can be identified with it.

    Ends with 2 where `stiffopt diagnose` (of a static set: `identify-stiffness`) cannot use it, and
    where units, signs or orders contradict the recordings.

    Parameters
    ----------
    recordings
        Folder with a recordings.toml or a static.toml, or that file.
    effects
        Python file of effects beside those of the catalogue.
    json
        Print plain data in place of text.
    """
    from stiffopt.discovery.catalogue import CATALOGUE
    from stiffopt.discovery.identifiable import effect_checks
    from stiffopt.discovery.sanity.doubt import DoubtfulRecordings
    from stiffopt.discovery.sanity.gate import SanityGate
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
            print_json(facts)
        else:
            terminal.print_static_check(facts)
        return 0
    loaded = load_recordings(recordings, changes)
    report = check_recordings(loaded)
    every = (*CATALOGUE, *(load_effects(effects) if effects else ()))
    found = effect_checks(loaded, report.facts, report.training_runs, every)
    gate = SanityGate(loaded, open_training_runs(loaded))
    doubted = gate.doubts
    remarked = () if doubted else gate.remarks
    if json:
        print_json(
            report.as_dict()
            | {
                "effects": [each.as_dict() for each in found],
                "doubts": [doubt.as_dict() for doubt in doubted],
                "remarks": [doubt.as_dict() for doubt in remarked],
            }
        )
    else:
        terminal.print_check(report, found)
        print_lines(f"Look at this: {each}" for each in remarked)
    if doubted:
        raise DoubtfulRecordings(loaded.path, doubted)
    require_usable(loaded, {run.file for run in report.runs if run.usable})
    return 0


@app.command(name="identify-stiffness")
def identify_stiffness(
    recordings: Path,
    *,
    out: Out | None = None,
    changes: Changes = (),
    open_report: Open = False,
) -> int:
    """Find the joint stiffness of an arm from deflections measured under known forces.

    Writes stiffness.json, stiffness.csv, residuals.csv and report.html.

    Parameters
    ----------
    recordings
        Folder with a static.toml, or that file.
    out
        Default: out/NAME of the folder, with what --set changes.
    """
    from stiffopt.identification.stiffness import identify_stiffness as identify
    from stiffopt.identification.store import write_static
    from stiffopt.recording.static_set import load_static_set
    from stiffopt.report.identification.page import write_static_report
    from stiffopt.report.identification.terminal import print_static

    recorded = load_static_set(recordings, changes)
    folder = out or default_folder(recorded.path.resolve().parent.name, changes)
    with output_folder(folder, "identify-stiffness") as stage:
        result = identify(recorded)
        write_static_report(result, stage)
        write_static(result, stage)
    print_static(result, folder)
    show_report(folder, open_report)
    return 0
