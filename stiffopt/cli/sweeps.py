"""`stiffopt sweep`: a problem, study or diagnosis for many values of its entries."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from stiffopt.cli.base import Changes, Open, Out, app, show_report
from stiffopt.errors import InputError
from stiffopt.folders import output_folder
from stiffopt.interrupts import finishing

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
    quiet: bool = False,
) -> int:
    """Solve a file for grids, lists and Latin hypercubes of its entries, and tabulate the answers.

    Writes cases/KEY.json for each case as it is done, then table.csv, table.parquet (with pyarrow),
    sweep.json and report.html. The same command goes on where a killed or interrupted one stopped.

    Parameters
    ----------
    file
        A sweep file (TOML).
    out
        Default: out/NAME of the sweep file.
    workers
        Processes; default one a core, 1 solves in this one.
    scheduler
        Address of a Dask scheduler, tcp://HOST:PORT, whose workers see the same files.
    quiet
        No progress display.
    """
    from stiffopt.files import check_file

    check_file(file)
    pool = start_workers(workers, scheduler)
    from stiffopt.sweep.cases import load_sweep

    loaded = load_sweep(file, changes)
    folder = out or Path("out") / file.stem
    return run_cases(loaded, folder, pool, open_report=open_report, quiet=quiet)


def start_workers(workers: int | None, scheduler: str | None) -> Workers:
    """Workers as the command line asks for them, which load while the cases are being read."""
    from stiffopt.sweep import workers as known

    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}: at least 1 is needed.")
    return known.workers(workers, scheduler)


def run_cases(sweep: Sweep, folder: Path, pool: Workers, *, open_report: bool, quiet: bool) -> int:
    """Solve the cases of a sweep and write what it found; exit code."""
    from stiffopt.report.sweep.terminal import SweepDisplay, print_sweep
    from stiffopt.sweep.run import run_sweep
    from stiffopt.sweep.store import PARQUET_FILE, write_sweep
    from stiffopt.sweep.summary import SweepSummary

    with output_folder(folder, "sweep", maybe=(PARQUET_FILE,)) as stage:
        with (
            nullcontext() if quiet else SweepDisplay(sweep.title) as progress,
            _load_report_meanwhile(pool),
        ):
            results, interrupted = run_sweep(sweep, folder, pool, progress)
        from stiffopt.report.sweep.page import write_sweep_report

        summary = SweepSummary(sweep, results, interrupted)
        if set(summary.statuses()) == {"invalid"}:
            first = next(each for each in results if each is not None)
            raise InputError(
                f"{sweep.path}: none of the cases can be stated. The first: {first['message']}"
            )
        with finishing():
            write_sweep(summary, stage)
            write_sweep_report(summary, stage)
    print_sweep(summary, folder)
    show_report(folder, open_report)
    return 130 if interrupted else 0


@contextmanager
def _load_report_meanwhile(pool: Workers) -> Iterator[None]:
    """Load what the answer is written with while others work, who begin with a single case."""
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
    import_module("stiffopt.report.sweep.page")
    # What fails is told where it is needed.
    with suppress(ImportError):
        import_module("pyarrow.parquet")
        # Its first array loads pandas, where that is installed.
        import_module("pyarrow").array([])
