"""`stiffopt sweep`: parameter studies of a problem, preload study or diagnosis."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from stiffopt.cli.base import Changes, Open, Out, Quiet, app, show_report
from stiffopt.errors import InputError
from stiffopt.folders import output_folder
from stiffopt.interrupts import defer_while_writing

if TYPE_CHECKING:
    from stiffopt.sweep.cases import Sweep
    from stiffopt.sweep.workers import Workers


@app.command
def sweep(
    file: Path,
    *,
    out: Out | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    changes: Changes = (),
    open_report: Open = False,
    quiet: Quiet = False,
) -> int:
    """Solve a file for grids, lists and Latin hypercubes of its entries and tabulate the results.

    Writes cases/KEY.json for each case, then table.csv, table.parquet (with pyarrow), sweep.json
    and report.html. The same command resumes an interrupted sweep. `file`: sweep file (TOML).
    `out`: folder for the results; default: out/NAME of the sweep file. `workers`: number of
    processes; default one per core, 1 solves in the main process. `scheduler`: address of a Dask
    scheduler, tcp://HOST:PORT; its workers need access to the same files.
    """
    from stiffopt.files import check_file

    check_file(file)
    pool = start_workers(workers, scheduler)
    from stiffopt.sweep.cases import load_sweep

    loaded = load_sweep(file, changes)
    folder = out or Path("out") / file.stem
    return run_cases(loaded, folder, pool, open_report=open_report, quiet=quiet)


def start_workers(workers: int | None, scheduler: str | None) -> Workers:
    """Start the requested workers, which import their modules while the cases are read."""
    from stiffopt.sweep import workers as known

    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}: at least 1 is needed.")
    return known.make_workers(workers, scheduler)


def run_cases(sweep: Sweep, folder: Path, pool: Workers, *, open_report: bool, quiet: bool) -> int:
    """Solve the cases of a sweep, write its results and return the exit code."""
    from stiffopt.report.pages.sweep_terminal import SweepDisplay, print_sweep
    from stiffopt.sweep.run import run_sweep
    from stiffopt.sweep.summary import PARQUET_FILE, SweepSummary, write_sweep

    with output_folder(folder, "sweep", maybe=(PARQUET_FILE,)) as stage:
        with (
            nullcontext() if quiet else SweepDisplay(sweep.title) as progress,
            _load_report_meanwhile(pool),
        ):
            results, interrupted = run_sweep(sweep, folder, pool, progress)
        from stiffopt.report.pages.sweep import write_sweep_report

        summary = SweepSummary(sweep, results, interrupted)
        if set(summary.statuses()) == {"invalid"}:
            first = next(each for each in results if each is not None)
            raise InputError(
                f"{sweep.path}: all cases are invalid. Message of the first: {first['message']}"
            )
        with defer_while_writing():
            write_sweep(summary, stage)
            write_sweep_report(summary, stage)
    print_sweep(summary, folder)
    show_report(folder, open_report)
    return 130 if interrupted else 0


@contextmanager
def _load_report_meanwhile(pool: Workers) -> Iterator[None]:
    """Import the modules of the report in a thread while other processes solve."""
    if pool.slots == 1:
        yield
        return
    loader = threading.Thread(target=_load_report_modules)
    loader.start()
    try:
        yield
    finally:
        loader.join()


def _load_report_modules() -> None:
    import_module("stiffopt.report.pages.sweep")
    # A failing import is reported where the module is needed.
    with suppress(ImportError):
        import_module("pyarrow.parquet")
        # The first array imports pandas, if installed.
        import_module("pyarrow").array([])
