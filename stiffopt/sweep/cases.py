"""Cases of a sweep: base file, changed entries, and key."""

from __future__ import annotations

import copy
import functools
import hashlib
import itertools
import json
import math
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt import __version__
from stiffopt.errors import InputError, InputFileError, shortened
from stiffopt.files import SCHEMA, apply_changes, check_file, load_toml, read_document
from stiffopt.recording.readers.read import SET_FILE as RECORDINGS
from stiffopt.recording.readers.read import files_of, find_set_file
from stiffopt.robot.mjcf import MJCF_ENDINGS, mjcf_files
from stiffopt.robot.urdf_xml import mesh_files
from stiffopt.sweep.schema import MAX_CASES, RangeSection, SweepFile
from stiffopt.units import number_and_unit

KINDS = ("trajectory", "preload", "recordings")

Change = tuple[str, Any]


@dataclass(frozen=True)
class Case:
    """One case of a sweep."""

    number: int  # from 1, in the order of the sweep file
    kind: str  # trajectory, preload or recordings
    base: Path  # absolute path: workers may have another working folder
    changes: tuple[Change, ...]  # (place, value)
    start: int  # number of the initial guess: 0 is the usual one, others start from a random detour
    baselines: bool
    key: str  # hash of all inputs of the result
    common: tuple[str, ...] = ()  # changes of all cases, in the form of `--set`
    files: str = ""  # hash of the input files

    @property
    def settings(self) -> tuple[str, ...]:
        """Changes in the form of `load_problem`."""
        return (*self.common, *self.changed)

    @property
    def changed(self) -> tuple[str, ...]:
        """Changes of this case, in that form."""
        return _format_settings(self.changes)


@dataclass(frozen=True)
class Sweep:
    """Sweep file with its cases."""

    path: Path
    title: str
    kind: str  # kind of the base files
    places: tuple[str, ...]  # varied entries, in order
    front: str  # entry of the trade-off front with the objective; "" for none
    starts: int
    cases: tuple[Case, ...]

    @property
    def base_names(self) -> dict[Path, str]:
        """Shortest unique ends of the base files' paths.

        Recording sets are named by their folder.
        """
        bases = list(dict.fromkeys(case.base for case in self.cases))
        ends = [base.parent if base.name == RECORDINGS else base.with_suffix("") for base in bases]
        for count in range(1, max(len(base.parts) for base in bases)):
            names = ["/".join(each.parts[-count:]) for each in ends]
            if len(set(names)) == len(bases):
                return dict(zip(bases, names, strict=True))
        return {base: str(base) for base in bases}


def load_sweep(path: str | os.PathLike[str], changes: Sequence[str] = ()) -> Sweep:
    """Read a sweep file and list its cases."""
    path = Path(path)
    return build_sweep(read_document(path, SweepFile, "sweep", changes), path)


def fleet_sweep(sets: Sequence[Path], changes: Sequence[str] = ()) -> Sweep:
    """Build a sweep of recording sets, each with the changes of `--set`.

    Raises `InputFileError`: a file is no recording set, is unreadable, or is named twice.
    """
    bases = [find_set_file(each).resolve() for each in sets]
    for base in bases:
        kind = load_toml(base).get("kind", "recordings")
        if kind != "recordings":
            raise InputFileError(
                base, "", f"is no recording set, but of kind {shortened(kind)}. Give the folder of "
                f"a set, or its {RECORDINGS}."
            )  # fmt: skip
        if bases.count(base) > 1:
            raise InputFileError(base, "", "is named twice. Name it once.")
    document = SweepFile.model_validate(
        {
            "schema": SCHEMA,
            "kind": "sweep",
            "title": f"Diagnosis of {len(bases)} recording sets",
            "base": [str(base) for base in bases],
        }
    )
    return build_sweep(document, Path.cwd() / "fleet", changes)


def build_sweep(document: SweepFile, path: Path, changes: Sequence[str] = ()) -> Sweep:
    """Build the cases of a sweep file at `path`; `changes` apply to every base file.

    Raises `InputFileError`: as `load_sweep`.
    """
    names = [document.base] if isinstance(document.base, str) else document.base
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise InputFileError(path, "base", f"names {twice!r} more than once. List each file once.")
    bases = [_read_base(path, name) for name in names]
    kinds = {kind for _, kind in bases}
    if len(kinds) != 1:
        raise InputFileError(path, "base", f"files of one kind, got {', '.join(sorted(kinds))}.")
    if document.starts > 1 and kinds != {"trajectory"}:
        raise InputFileError(path, "starts", "only trajectory problems have several starts.")
    axes = list(_read_axes(document, path))
    count = len(bases) * document.starts * int(np.prod([float(len(axis)) for axis in axes]))
    if count > MAX_CASES:
        raise InputFileError(path, "", f"has {count} cases; allowed: {MAX_CASES}.")
    cases: list[Case] = []
    digest = functools.cache(_hash_inputs)
    for base, kind in bases:
        content = load_toml(base)
        for parts in itertools.product(*axes):
            own = tuple(change for part in parts for change in part)
            changed = apply_changes(
                copy.deepcopy(content), [*changes, *_format_settings(own)], base
            )
            given = [change.partition("=")[2].strip(" \"'") for change in changes]
            chosen = _named_files(base.parent, [value for _, value in own] + given)
            inputs = "".join(digest(each) for each in (base, *chosen))
            for start in range(document.starts):
                facts = [__version__, kind, changed, inputs, start, document.baselines]
                # Diagnoses are never shared: equal files of two robots remain two cases.
                facts += [str(base)] if kind == "recordings" else []
                text = json.dumps(facts, sort_keys=True, default=str)
                key = hashlib.sha256(text.encode()).hexdigest()[:20]
                number = len(cases) + 1
                cases.append(
                    Case(
                        number=number,
                        kind=kind,
                        base=base,
                        changes=own,
                        start=start,
                        baselines=document.baselines,
                        key=key,
                        common=tuple(changes),
                        files=hashlib.sha256(inputs.encode()).hexdigest(),
                    )
                )
    return Sweep(
        path=path,
        title=document.title or path.stem,
        kind=kinds.pop(),
        places=tuple(place for axis in axes for place, _ in axis[0]),
        front="" if document.front is None else document.front.over,
        starts=document.starts,
        cases=tuple(cases),
    )


def _read_base(path: Path, name: str) -> tuple[Path, str]:
    """Find a base file: absolute path and kind."""
    base = (path.parent / name).resolve()
    if base.is_dir():
        base = base / RECORDINGS
    check_file(base)
    kind = load_toml(base).get("kind", "recordings")
    if kind not in KINDS:
        raise InputFileError(
            path, "base", f"{name} is of kind {kind!r}; allowed: a trajectory problem, a preload "
            "study or a recording set."
        )  # fmt: skip
    return base, kind


def _read_axes(document: SweepFile, path: Path) -> Iterator[list[tuple[Change, ...]]]:
    """Yield the changes at the points of each axis."""
    if document.front is not None:
        front = document.front
        bounds = RangeSection(lower=front.lower, upper=front.upper)
        shares = np.linspace(0.0, 1.0, front.points)
        yield [((front.over, v),) for v in _range_values(bounds, shares, path, "front")]
    for place, values in document.grid.items():
        yield [((place, value),) for value in values]
    if document.lists:
        rows = zip(*document.lists.values(), strict=True)
        yield [tuple(zip(document.lists, row, strict=True)) for row in rows]
    cube = document.latin_hypercube
    if cube is not None:
        if not cube.ranges:
            raise InputFileError(
                path, "latin_hypercube", "has no range. Add KEY = { lower, upper }."
            )
        shares = latin_hypercube(cube.count, len(cube.ranges), cube.seed)
        columns = [
            _range_values(each, own, path, f"latin_hypercube.{place}")
            for (place, each), own in zip(cube.ranges.items(), shares.T, strict=True)
        ]
        yield [tuple(zip(cube.ranges, row, strict=True)) for row in zip(*columns, strict=True)]


def latin_hypercube(count: int, ranges: int, seed: int) -> np.ndarray:
    """Latin hypercube (count, ranges) in 0 to 1, with one point in each part of every range.

    The points are those of `scipy.stats.qmc.LatinHypercube`, whose import takes longer than many
    cases.
    """
    (random,) = np.random.default_rng(seed).spawn(1)
    within = random.uniform(size=(count, ranges))
    parts = np.tile(np.arange(1, count + 1), (ranges, 1))
    for row in parts:
        random.shuffle(row)
    return np.asarray((parts.T - within) / count)


def _range_values(bounds: RangeSection, shares: np.ndarray, path: Path, where: str) -> list[Any]:
    """Interpolate a range, as numbers or texts with its unit."""
    (low, unit), (high, other) = (number_and_unit(each) for each in (bounds.lower, bounds.upper))
    if unit is None or unit != other:
        raise InputFileError(
            path, where, f"needs two numbers, or two with the same unit; got {bounds.lower!r} and "
            f"{bounds.upper!r}."
        )  # fmt: skip
    if not math.isfinite(high - low):
        raise InputFileError(
            path, where, f"needs finite ends; got {bounds.lower!r} and {bounds.upper!r}."
        )
    if not low < high:
        raise InputFileError(path, where, f"lower = {low:g} must be below upper = {high:g}.")
    # Twelve digits avoid binary fractions such as 0.30000000000000004 in tables.
    values = [float(f"{low + share * (high - low):.12g}") for share in shares]
    return [f"{value!r} {unit}" for value in values] if unit else values


def _format_settings(changes: Sequence[Change]) -> tuple[str, ...]:
    return tuple(f"{place}={_format_toml(value)}" for place, value in changes)


def _format_toml(value: Any) -> str:
    """Format a value as TOML in one line."""
    if isinstance(value, dict):
        return (
            "{ "
            + ", ".join(f'"{key}" = {_format_toml(each)}' for key, each in value.items())
            + " }"
        )
    if isinstance(value, list | tuple):
        return f"[{', '.join(_format_toml(each) for each in value)}]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    # Strings and numbers of TOML and JSON agree; no entry is a date.
    return json.dumps(value, ensure_ascii=False, default=str)


def _hash_inputs(path: Path, seen: frozenset[Path] = frozenset()) -> str:
    """Hash a file with all files that it names, the meshes of a URDF and the parts of an MJCF.

    Unreadable files are hashed by their error: the case that needs them reports it, and others are
    solved.
    """
    try:
        with path.open("rb") as stream:
            found = hashlib.file_digest(stream, "sha256")
    except OSError as error:
        return f"{path}: {error.strerror}"
    if path.suffix == ".urdf":
        for mesh in mesh_files(path):
            found.update(_hash_inputs(mesh).encode())
    elif path.suffix in MJCF_ENDINGS and path not in seen:
        with suppress(InputError):
            for part in mjcf_files(path)[1:]:
                found.update(_hash_inputs(part, seen | {path}).encode())
    if path.suffix == ".toml" and path not in seen:
        with suppress(InputError):
            for beside in _named_files(path.parent, load_toml(path)):
                found.update(_hash_inputs(beside, seen | {path}).encode())
    return found.hexdigest()


def _named_files(folder: Path, value: Any) -> list[Path]:
    """Find files in a folder that texts of a value name, runs and folders of runs included.

    The folder itself and its parents, named by "." and "/", are excluded.
    """
    found: dict[Path, None] = {}
    for name in sorted(_collect_texts(value)):
        # The system refuses longer names.
        # Longest file name of common file systems [bytes].
        if "\0" in name or len(name.encode()) > 255:
            continue
        place = folder / name
        if folder.is_relative_to(place.resolve()):
            continue
        # "#" marks an episode in names of runs only.
        with suppress(InputFileError):
            found |= dict.fromkeys(file.resolve() for file in files_of(place))
    return list(found)


def _collect_texts(value: Any) -> set[str]:
    if isinstance(value, dict):
        return {text for each in value.values() for text in _collect_texts(each)}
    if isinstance(value, list):
        return {text for each in value for text in _collect_texts(each)}
    return {value} if isinstance(value, str) else set()
