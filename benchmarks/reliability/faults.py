"""Inputs that once ended in a traceback, a crash or a hang: `../shared/faults`, one a folder.

Those of its table, and those of its folder `second`, whose commands stand in each WHAT.txt.
"""

from __future__ import annotations

import ast
import os
import re
import shlex
import shutil
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.reliability.commands import ROOT

FAULTS = Path(os.environ.get("STIFFOPT_FAULTS", ROOT.parent / "shared" / "faults"))
_TWO_LINK = ROOT / "problems" / "recordings" / "two_link_friction"
# What lies beside the files of a folder, by the words of the table.
_BESIDE = {
    "problems/recordings/two_link_friction": [_TWO_LINK],
    "problems": [ROOT / "problems"],
    "stiffopt/robot/data/er3a_c60_contact": [ROOT / "stiffopt/robot/data/er3a_c60_contact"],
    "shared/recordings/fanuc_r2000_static": [
        ROOT.parent / "shared" / "recordings" / "fanuc_r2000_static"
    ],
    "an extended.toml of problems/recordings/two_link_friction": [_TWO_LINK, ROOT / "problems"],
    "the output folder of a diagnosis": [_TWO_LINK, ROOT / "problems"],
}


@dataclass(frozen=True)
class FaultCase:
    """A reproducer: the folder and the command that is run with a copy of it."""

    folder: Path
    arguments: tuple[str, ...]
    beside: tuple[Path, ...]

    def laid_out(self, place: Path) -> Path:
        """The files where the command runs, a folder below `place`."""
        work = place / self.folder.name
        for source in (*self.beside, self.folder):
            shutil.copytree(
                source, work, dirs_exist_ok=True, copy_function=shutil.copyfile,
                ignore=shutil.ignore_patterns("recordings") if source.name == "problems" else None,
            )  # fmt: skip
            for path in (work, *work.rglob("*")):
                path.chmod(0o755 if path.is_dir() else 0o644)
        # A set in a folder "set" of the working folder, where the command asks for one.
        if self.arguments[:2] == ("diagnose", "set"):
            shutil.copytree(_TWO_LINK, work / "set")
        return work


def cases() -> Iterator[FaultCase]:
    """Every case whose folder is there, by the table of the README."""
    for line in (FAULTS / "README.md").read_text().splitlines():
        row = re.match(r"\| (\w[\w.-]+) \| `(.+)` \| (.*?) \| .* \|$", line)
        if row is None or not (FAULTS / row[1]).is_dir():
            continue
        words = ast.literal_eval(row[2]) if row[2].startswith("[") else shlex.split(row[2])
        if words == ["diagnose", "."]:
            words += ["--out", "../out"]  # not into the set itself, which is refused at once
        beside = tuple(path for path in _BESIDE.get(row[3], []) if path.is_dir())
        yield FaultCase(FAULTS / row[1], tuple(words), beside)


SECOND = FAULTS / "second"
_MESHED = SECOND / "mesh_scale_zero"
_RUNS = """
[[runs]]
file = "{run}"
role = "train"

[[runs]]
file = "test_1.npz"
role = "test"
"""


def second_cases() -> Iterator[FaultCase]:
    """Every case of the folder `second`."""
    for folder in sorted(each for each in SECOND.iterdir() if each.is_dir()):
        what = folder / "WHAT.txt"
        words = ["solve", "self.toml", "--out", "out"]
        if what.is_file():
            (line,) = re.findall(r"^argv=(.*)$", what.read_text(), re.MULTILINE)
            words = ast.literal_eval(line)
        yield SecondCase(folder, tuple(words), ())


class SecondCase(FaultCase):
    """A reproducer whose surroundings follow from its command and its files."""

    def laid_out(self, place: Path) -> Path:
        """The files where the command runs, a folder below `place`."""
        work = place / self.folder.name
        if self.folder.name.startswith("results"):
            for name in ("a", "b"):
                _copy(self.folder, work / name)
            other = work / "b" / "result.json"
            other.write_text(re.sub(r'"\\\\ud\w+"', "0.0", other.read_text()))
            if "fifo" in (self.folder / "WHAT.txt").read_text():
                (work / "a" / "result.json").unlink()
                os.mkfifo(work / "a" / "result.json")
            return work
        sound = ROOT / "problems"
        if "." in self.arguments or "set" in self.arguments:
            sound = _TWO_LINK
            work = work / "set" if "set" in self.arguments else work
        for source in (sound, *([_MESHED] if self.folder.name.startswith("urdf") else ()),
                       self.folder):  # fmt: skip
            _copy(source, work)
        for run in work.glob("run.*"):
            text = (work / "recordings.toml").read_text()
            head = text[: text.index("[[runs]]")]
            (work / "recordings.toml").write_text(head + _RUNS.format(run=run.name))
        if (work / "BOX.stl").is_file():
            box = (work / "BOX.stl").read_bytes()
            # Of a binary STL, the first corner of the first triangle.
            (work / "NAN.stl").write_bytes(box[:96] + struct.pack("<f", float("nan")) + box[100:])
        return place / self.folder.name


def _copy(source: Path, work: Path) -> None:
    """Files of a folder, writable."""
    ignored = shutil.ignore_patterns("recordings") if source.name == "problems" else None
    shutil.copytree(source, work, dirs_exist_ok=True, copy_function=shutil.copyfile, ignore=ignored)
    for path in (work, *work.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
