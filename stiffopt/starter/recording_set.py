"""Recording set from user tables: columns, units and roles guessed, with reasons."""

from __future__ import annotations

import itertools
import math
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputError, InputFileError, NoNumbersError
from stiffopt.recording.clock import MIN_POSES
from stiffopt.recording.readers.columns import Table
from stiffopt.recording.readers.read import RUN_ENDINGS, is_messages, read_tables
from stiffopt.recording.run import counted
from stiffopt.robot.joint_tree import JointTree
from stiffopt.robot.robot import Robot
from stiffopt.robot.urdf_xml import read_urdf_tree
from stiffopt.starter import guessing, table_layouts
from stiffopt.starter.recorded_robot import RecordedRobot, store_robot
from stiffopt.starter.writing import toml_list, toml_string, write_new
from stiffopt.units import to_si

# Training share of a single recording; the rest is held out. Fewest rows for training.
_TRAINING_SHARE = 0.7
# File names by which people mark a recording as held out.
_HELD_OUT_NAME = re.compile(r"(^|[^a-z])(test|val|valid|validation|eval|holdout)([^a-z]|$)", re.I)
_MIN_TRAINING_ROWS = 400
# Fewest rows of a part between clock resets.
_MIN_PART_ROWS = 100


@dataclass(frozen=True, kw_only=True)
class StartedSet:
    """Written recording set with the guesses in it."""

    path: Path  # recordings.toml
    guess: guessing.GuessedColumns
    notes: tuple[str, ...]


def start_recording_set(
    data: Sequence[Path],
    urdf: Path,
    folder: Path,
    rate: float | None = None,
    tip: str | None = None,
) -> StartedSet:
    """Write a recording set: recordings.toml, a copy of the robot, runs as NPZ.

    `data` are files, or folders of them; values are stored as recorded, units in `[signals.scale]`.
    `rate` [Hz] is needed if no column is a time. `tip` is the last link of the recorded arm;
    default the whole URDF. Raises `InputError` without a table, and for columns that are not
    recognised.
    """
    if (folder / "recordings.toml").exists():
        raise InputFileError(folder / "recordings.toml", "", "exists and is kept.")
    if urdf.suffix.lower() in RUN_ENDINGS:
        raise InputFileError(urdf, "", "is a recording, not a URDF. Give the arm's as --urdf.")
    with tempfile.TemporaryDirectory() as beside:
        arm = store_robot(urdf, Path(beside), tip)
        try:
            return _write_set(data, arm, Path(beside), folder, rate)
        except guessing.UnrecognisedError as error:
            which = (
                ""
                if tip or urdf.suffix.lower() == ".toml"
                else JointTree(read_urdf_tree(urdf)).describe_branches()
            )
            if not which:
                raise
            raise InputError(f"{urdf.name} {which} Without it, {error}") from error


def _write_set(
    data: Sequence[Path], arm: RecordedRobot, beside: Path, folder: Path, rate: float | None
) -> StartedSet:
    """Write the set of an arm whose files are in the folder `beside`."""
    robot = arm.robot
    files = _find_files(data)
    tables, layout, told = _read_runs(files, robot, named=frozenset(data))
    files = list(tables)
    if rate is None and guessing.are_poses(tables[files[0]], robot):
        # One pose a row: the rows are numbered.
        rate = 1.0
    if rate is not None:
        if not 0.0 < rate < 1e6:
            raise InputError(f"--rate {rate:g} must be above 0 and below 1e6 rows a second.")
        tables = {path: guessing.with_time(table, rate) for path, table in tables.items()}
    first = guessing.guess_columns(tables[files[0]], robot, rate)
    if layout:
        first = replace(first, reasons=(layout, *first.reasons))
    wanted = [first.time, *(c for columns in first.columns.values() for c in columns if c)]
    notes = [*arm.notes, *told]
    for path, table in tables.items():
        lacking = [name for name in wanted if name not in table]
        if lacking:
            raise InputFileError(
                path, "", f"lacks {', '.join(lacking)}, which {files[0].name} has."
            )
    runs: list[tuple[str, str, dict[str, np.ndarray]]] = []
    # Names that were guessed are corrected in [signals]: the other columns must be there then.
    every = [c for c in tables[files[0]] if all(c in table for table in tables.values())]
    kept = every if layout else [*wanted, *first.asked]
    parts, begun = _split_runs(tables, first.time, kept)
    notes += begun
    if len(parts) == 1:
        _, stem, table = parts[0]
        rows = len(table[first.time])
        cut = int(_TRAINING_SHARE * rows)
        needed = math.ceil(
            MIN_POSES / (1.0 - _TRAINING_SHARE)
            if first.at_rest
            else _MIN_TRAINING_ROWS / _TRAINING_SHARE
        )
        if rows < needed:
            raise InputFileError(
                files[0],
                "",
                f"has {rows} rows; a single recording is cut in two and needs {needed}. Record"
                " more, or a second one.",
            )
        runs.append((f"{stem}_train", "train", {k: v[:cut] for k, v in table.items()}))
        runs.append((f"{stem}_test", "test", {k: v[cut:] for k, v in table.items()}))
        notes.append(
            "One recording: its first 70 % are for training, the rest is held out. Record"
            f" {'more poses' if first.at_rest else 'a second motion'} for a stronger validation."
        )
    else:
        labels = _label_files(files)
        names = [labels[path] if len(files) > 1 else name for path, name, _ in parts]
        held_out = [each for each in names if _HELD_OUT_NAME.search(Path(each).stem)]
        if not 0 < len(set(held_out)) < len(set(names)):
            held_out = [names[-1]]
        for file, (_, name, part) in zip(names, parts, strict=True):
            runs.append((name, "test" if file in held_out else "train", part))
        verb = "is" if len(set(held_out)) == 1 else "are"
        notes.append(
            f"{', '.join(dict.fromkeys(held_out))} {verb} held out (test), the others are for"
            " training."
        )
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copytree(beside, folder, dirs_exist_ok=True)
    for name, _, table in runs:
        columns: dict[str, Any] = dict(table)
        np.savez_compressed(folder / f"{name}.npz", **columns)
    begins, told = _session_times(first, runs)
    notes += told
    listed_runs = [(name, role, begins.get(name)) for name, role, _ in runs]
    text = _set_text(folder.resolve().name, arm, first, listed_runs)
    return StartedSet(
        path=write_new(folder / "recordings.toml", text), guess=first, notes=tuple(notes)
    )


def _session_times(
    found: guessing.GuessedColumns, runs: Sequence[tuple[str, str, Mapping[str, np.ndarray]]]
) -> tuple[dict[str, float], list[str]]:
    """Return the begin of each run since that of the first [s], and a note; none if runs overlap.

    Logs that begin at zero overlap. Runs of one clock follow one another.
    """
    unit = found.units.get("time")
    second = to_si(f"1 {unit}", "time") if isinstance(unit, str) and unit else 1.0
    spans = {name: second * table[found.time] for name, _, table in runs}
    ordered = sorted((np.nanmin(own), np.nanmax(own)) for own in spans.values())
    if found.at_rest or any(late[0] <= early[1] for early, late in itertools.pairwise(ordered)):
        return {}, []
    begins = {name: round(float(np.nanmin(own) - ordered[0][0]), 3) for name, own in spans.items()}
    return begins, ["All runs are of one clock: session_time of each counts from the first."]


def _read_runs(
    files: Sequence[Path], robot: Robot, named: Container[Path]
) -> tuple[dict[Path, Table], str, list[str]]:
    """Return tables by file without garbled rows, why unnamed columns are so named, and notes.

    Files that are not `named` but found in a folder need not be recordings.
    """
    tables: dict[Path, Table] = {}
    layout, notes, without = "", [], []
    for path in files:
        if is_messages(path):
            tables[path] = table_layouts.read_message_table(path, robot.joint_names)
            continue
        try:
            parts = read_tables(path)
        except NoNumbersError:
            if path in named:
                raise
            without.append(path.name)
            continue
        for part, table in parts.items():
            own = path.with_name(f"{path.stem}_{part}{path.suffix}") if part else path
            tables[own] = table
    if not tables:
        raise InputFileError(files[0], "", "holds no row of numbers, nor do the files beside it.")
    if without:
        listed = ", ".join(dict.fromkeys(without))
        notes.append(f"Files without rows of numbers are left out: {listed}.")
    tables = _join_by_folder(tables, robot)
    for path, table in tables.items():
        try:
            tables[path], layout = table_layouts.name_blocks(table, robot)
        except InputError as error:
            raise InputFileError(path, "", str(error)) from error
        tables[path], garbled = table_layouts.drop_garbled_rows(tables[path])
        if garbled:
            listed = ", ".join(map(str, garbled[:5])) + (", ..." if len(garbled) > 5 else "")
            notes.append(
                f"{path.name}: {counted(len(garbled), 'garbled row')} left out ({listed}), of"
                " values or times that cannot be."
            )
    return tables, layout, notes


def _join_by_folder(tables: Mapping[Path, Table], robot: Robot) -> dict[Path, Table]:
    """Join the files of one signal each in every folder; of all folders, where each has one."""
    folders = [path.parent for path in tables]
    if len(set(folders)) == len(folders):
        return table_layouts.join_signal_files(tables, robot)
    joined: dict[Path, Table] = {}
    for folder in dict.fromkeys(folders):
        own = {path: table for path, table in tables.items() if path.parent == folder}
        joined |= table_layouts.join_signal_files(own, robot)
    return joined


def _label_files(files: Iterable[Path]) -> dict[Path, str]:
    """Return the name of each file, with its folder where files of others have that name.

    Raises `InputFileError`: two files remain with one name.
    """
    labels = {path: path.name for path in files}
    for _ in range(2):
        names = Counter(_run_name(label) for label in labels.values())
        twice = [path for path, label in labels.items() if names[_run_name(label)] > 1]
        if not twice:
            return labels
        labels |= {path: f"{path.parent.name}_{path.name}" for path in twice}
    raise InputFileError(twice[0], "", "has the name of another run. Rename one.")


def _split_runs(
    tables: Mapping[Path, Mapping[str, np.ndarray]], time: str, names: Sequence[str]
) -> tuple[list[tuple[Path, str, dict[str, np.ndarray]]], list[str]]:
    """Return file, name and columns of each run, split at clock resets, and notes."""
    parts: list[tuple[Path, str, dict[str, np.ndarray]]] = []
    notes: list[str] = []
    stems = {path: _run_name(label) for path, label in _label_files(tables).items()}
    taken = set(stems.values())
    for path, table in tables.items():
        own = list(
            _split_at_clock_resets({name: table[name] for name in names if name in table}, time)
        )
        called = [stems[path]] if len(own) == 1 else _part_names(stems[path], len(own), taken)
        taken.update(called)
        parts += [(path, name, part) for name, part in zip(called, own, strict=True)]
        if len(own) > 1:
            notes.append(
                f"The clock of {path.name} restarts {len(own) - 1} time(s): it is stored as"
                f" {len(own)} runs, {', '.join(called)}."
            )
    return parts, notes


def _part_names(stem: str, count: int, taken: Container[str]) -> list[str]:
    """Return names STEM_1, ... of the parts of a file, or STEM_part_1, ... if taken."""
    while True:
        names = [f"{stem}_{k}" for k in range(1, count + 1)]
        if not any(name in taken for name in names):
            return names
        stem += "_part"


def _split_at_clock_resets(
    table: Mapping[str, np.ndarray], time: str
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the parts between clock resets; the whole table without any."""
    stamps = table[time]
    steps = np.diff(stamps)
    known = steps[np.isfinite(steps) & (steps > 0.0)]
    usual = float(np.median(known)) if known.size else 0.0
    # A step back by a few rows is no reset; reading the run reports it.
    cuts = np.flatnonzero(steps < -_MIN_PART_ROWS * usual) + 1
    ends = [0, *(int(cut) for cut in cuts), len(stamps)]
    if any(np.diff(ends) < _MIN_PART_ROWS):
        yield dict(table)
        return
    for begin, end in itertools.pairwise(ends):
        yield {name: column[begin:end] for name, column in table.items()}


def _find_files(data: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for path in data:
        if (path / "meta" / "info.json").is_file():
            # A LeRobot dataset.
            found += sorted(path.glob("data/**/*.parquet"))
        elif path.is_dir() and not is_messages(path):
            found += sorted(
                p for p in path.iterdir() if p.suffix.lower() in RUN_ENDINGS or is_messages(p)
            )
        else:
            found.append(path)
    if not found:
        raise InputError(
            f"no recordings in {', '.join(map(str, data))}: {', '.join(RUN_ENDINGS)}, rosbag2"
            " and LeRobot datasets are read."
        )
    return found


def _run_name(label: str) -> str:
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in Path(label).stem) or "run"


def _set_text(
    name: str,
    arm: RecordedRobot,
    found: guessing.GuessedColumns,
    runs: Sequence[tuple[str, str, float | None]],
) -> str:
    joints = arm.robot.joint_names

    def suggested(**values: str) -> list[str]:
        return [f"# {key} = {toml_list([value] * len(joints))}" for key, value in values.items()]

    lines = [
        "# Written by `stiffopt init recording`; guesses and their reasons:",
        *(f"#   {reason}" for reason in found.reasons),
        *([] if found.at_rest else [f"#   rate: {found.rate:.4g} Hz"]),
        "# Check it: `stiffopt recording check` of this folder.",
        "schema = 1",
        f"name = {toml_string(name)}",
        f"robot = {toml_string(arm.file)}",
        f"joints = {toml_list(map(toml_string, joints))}",
        *arm.tool_lines(),
        "",
        "[signals]",
        f"time = {toml_string(found.time)}",
    ]
    for kind in ("position", "velocity", "link_position", "torque", "command"):
        if kind in found.columns:
            lines.append(f"{kind} = {toml_list(map(toml_string, found.columns[kind]))}")
    if "torque" in found.columns:
        lines.append('torque_side = "motor"  # "link" with joint torque sensors')
    if found.at_rest:
        lines.append("at_rest = true  # each row is a pose at rest; time numbers the poses")
    scaled = {kind: unit for kind, unit in found.units.items() if unit}
    if scaled:
        lines += ["", "[signals.scale]"]
        for kind, unit in scaled.items():
            if not isinstance(unit, str):
                each = ("1.0" if not one else toml_string(one) for one in unit)
                lines.append(f"{kind} = {toml_list(each)}")
            elif request := guessing.request_factor(kind, unit):
                # Not a valid entry until the user replaces it by a factor, but for torques.
                lines.append(f"{kind} = {toml_string(unit)}  # {request} here")
            else:
                lines.append(f"{kind} = {toml_string(unit)}")
    entries = arm.entries(torque="torque" in found.columns)
    lines += [
        *entries,
        "",
        "# [nominal]                 # parameters of the nominal model, one number a joint, SI",
        *suggested(gear_ratio="100.0", rotor_inertia="0.1", coulomb="1.0", viscous="1.0"),
    ]
    if "command" in found.columns and not any("[actuator]" in line for line in entries):
        lines += [
            "",
            "# [actuator]                # law of the joints' controllers; without gains these are",
            '# kind = "position_servo"   # estimated from the arm\'s weight',
            *suggested(kp="20.0", kd="0.5"),
        ]
    for run, role, begin in runs:
        lines += [
            "",
            "[[runs]]",
            f"file = {toml_string(run + '.npz')}",
            f"role = {toml_string(role)}",
            *([] if begin is None else [f"session_time = {begin}  # [s] since the first run"]),
        ]
    return "\n".join(lines) + "\n"
