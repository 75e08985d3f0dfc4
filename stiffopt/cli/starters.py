"""`stiffopt init`: starter files from a URDF, an MJCF or recorded data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from stiffopt.cli import base
from stiffopt.report.common.terminal import print_lines

init = App(name="init", help="Write starter files: robot, problem, recording set, flange study.")
base.app.command(init)

File = Annotated[
    Path | None,
    Parameter(
        name=base.OUT_NAMES,
        converter=base.out_path,
        help="File to write; an existing file is not overwritten.",
    ),
]
# A negative value is refused by its range, not parsed as an option.
Amount = Annotated[str, Parameter(allow_leading_hyphen=True)]


@init.command
def robot(
    urdf: Path,
    *,
    tip: str | None = None,
    catalogue: Path | None = None,
    out: File = None,
    changes: base.NoChanges = (),
) -> int:
    """Write a robot file for a URDF or MJCF: limits and candidate reducers, estimates marked.

    `urdf`: URDF or MJCF of the arm; joints that do not lead to the tip, such as fingers, are fixed.
    `tip`: last link of the arm; default: the link from which fingers branch off. `catalogue`: user
    catalogue file, whose reducers are candidates too.
    """
    from stiffopt.starter.robot_file import robot_text
    from stiffopt.starter.writing import write_new

    base.refuse_changes(changes, base.STARTER_FILE_REASON)
    path = out or urdf.with_name(f"{urdf.stem}_robot.toml")
    started = robot_text(urdf, path.parent, tip, catalogue=catalogue)
    written = write_new(path, started.text)
    print_lines(
        (
            f"Wrote {written}. Correct the values that are marked as estimated.",
            *started.notes,
            f"Next: stiffopt init problem {written}",
        )
    )
    return 0


@init.command
def problem(source: str, *, out: File = None, changes: base.NoChanges = ()) -> int:
    """Write a first trajectory problem for a robot.

    `source`: shipped robot, robot file (TOML), URDF or MJCF.
    """
    from stiffopt.robot.files import load_robot, shipped_robots
    from stiffopt.starter.problem_file import problem_text
    from stiffopt.starter.writing import write_new

    base.refuse_changes(changes, base.STARTER_FILE_REASON)
    arm = load_robot(source)
    file = source if source in shipped_robots() else Path(source)
    path = out or (file.parent if isinstance(file, Path) else Path()) / f"{arm.name}_first.toml"
    written = write_new(path, problem_text(arm, file, path.parent))
    print_lines((f"Wrote {written}.", f"Next: stiffopt solve {written}"))
    return 0


@init.command
def recording(
    data: list[Path],
    *,
    urdf: Annotated[Path, Parameter(name=("--urdf", "--robot"))],
    out: Annotated[
        Path | None,
        Parameter(
            name=base.OUT_NAMES,
            converter=base.out_path,
            help="Folder of the set; default NAME_set beside the data.",
        ),
    ] = None,
    rate: float | None = None,
    tip: str | None = None,
    changes: base.NoChanges = (),
) -> int:
    """Write a recording set for recorded tables or bags; inferred entries are listed.

    Reads text tables, JSON, NPZ, Parquet, LeRobot datasets, MATLAB, Excel, HDF5, MCAP, rosbag2 and
    the text of `ros2 topic echo`. `data`: files or folders; the last of several is held out for
    validation, a single one is split. `urdf`: URDF, MJCF or robot file of the arm, or the name of a
    shipped robot; limits and masses that it lacks are estimated. `rate`: sampling rate [Hz], where
    the data have no time column. `tip`: last link of the recorded arm, where the URDF has further
    links.
    """
    from stiffopt.starter.recording_set import start_recording_set

    base.refuse_changes(changes, base.STARTER_FILE_REASON)
    folder = out or data[0].with_name(f"{data[0].stem}_set")
    started = start_recording_set(data, urdf, folder, rate, tip)
    print_lines(
        (
            f"Wrote {started.path}, "
            + ("poses at rest" if started.guess.at_rest else f"{started.guess.rate:.4g} Hz")
            + ". Inferred:",
            *(f"  {reason}" for reason in started.guess.reasons),
            *started.notes,
            f"Next: stiffopt recording check {folder}",
            f"then: stiffopt diagnose {folder}",
        )
    )
    return 0


@init.command
def flange(
    *,
    out: Annotated[
        Path, Parameter(name=base.OUT_NAMES, converter=base.out_path, help="Folder for the files.")
    ] = Path("flange"),
    torque: Amount = "100 N*m",
    size: str = "M5",
    grade: str = "12.9",
    count: int = 8,
    circle: Amount = "50 mm",
    nut: bool = False,
    axial_force: Amount = "0 N",
    shear_force: Amount = "0 N",
    tilting_moment: Amount = "0 N*m",
    catalogue: Path | None = None,
    changes: base.NoChanges = (),
) -> int:
    """Write a preload study of one bolted flange; no URDF is needed.

    Parameters
    ----------
    torque
        Torque that the flange transmits.
    size
        Size of the bolts, see `stiffopt catalogue bolts`, or one of --catalogue.
    grade
        Strength grade: 8.8, 10.9 or 12.9; stainless A2-50 to A4-80.
    count
        Number of bolts.
    circle
        Diameter of the bolt circle.
    nut
        Through-bolts with nuts instead of tapped holes.
    axial_force
        Force along the axis of the bolt circle.
    shear_force
        Force across the axis.
    tilting_moment
        Moment about axes across that of the bolt circle, as of overhung masses.
    catalogue
        User catalogue file with bolts for --size.
    """
    from stiffopt.starter.flange_files import write_flange
    from stiffopt.units import to_si

    base.refuse_changes(changes, base.STARTER_FILE_REASON)
    files = write_flange(
        out,
        torque=to_si(base.number_or_text(torque), "torque", "--torque"),
        size=size,
        grade=grade,
        count=count,
        circle=to_si(base.number_or_text(circle), "length", "--circle"),
        nut=nut,
        axial_force=to_si(base.number_or_text(axial_force), "force", "--axial-force"),
        shear_force=to_si(base.number_or_text(shear_force), "force", "--shear-force"),
        tilting_moment=to_si(base.number_or_text(tilting_moment), "torque", "--tilting-moment"),
        own=catalogue,
    )
    print_lines((f"Wrote {', '.join(map(str, files))}.", f"Next: stiffopt preload {files[-1]}"))
    return 0
