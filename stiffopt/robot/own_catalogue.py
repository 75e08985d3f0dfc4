"""The user's own catalogue: reducers that the package does not have, beside a robot file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from stiffopt.declaration import POSITIVE, Doc, JointStiffness, Torque
from stiffopt.drivetrain.catalogue import ReducerData
from stiffopt.errors import InputFileError
from stiffopt.files import Section, read_document
from stiffopt.robot.element_sections import Cited


class OwnReducer(Cited):
    """A reducer by the three slopes of its torsion; equal slopes are one."""

    name: Annotated[str, Doc("What robot files call it.")]
    ratio: Annotated[int, POSITIVE, Doc("Turns of the input for one turn of the output.")]
    K1: Annotated[JointStiffness, POSITIVE, Doc("Slope up to T1.")]
    K2: Annotated[JointStiffness, POSITIVE, Doc("Slope from T1 to T2.")]
    K3: Annotated[JointStiffness, POSITIVE, Doc("Slope above T2.")]
    T1: Annotated[Torque, POSITIVE, Doc("First corner.")]
    T2: Annotated[Torque, POSITIVE, Doc("Second corner, not below the first.")]
    ratings: Annotated[
        tuple[Torque, Torque, Torque] | None,
        Doc("Rated, repeated peak and momentary peak torque; `init robot` chooses by the second."),
    ] = None


class CatalogueFile(Section):
    """Reducers of one's own, named by `catalogue` of a robot file."""

    schema_: Annotated[int, Doc("Version of the format: 1.")] = Field(alias="schema")
    kind: Annotated[Literal["catalogue"], Doc("Kind of file.")]
    reducer: Annotated[tuple[OwnReducer, ...], Doc("Reducers; their names come first.")] = ()


def read_own_catalogue(path: str | os.PathLike[str]) -> tuple[ReducerData, ...]:
    """Reducers of a catalogue file.

    Raises
    ------
    InputFileError
        What is wrong, where, and what is allowed.
    """
    path = Path(path)
    document = read_document(path, CatalogueFile, "catalogue")
    found: dict[str, ReducerData] = {}
    for section in document.reducer:
        where = f"reducer[{section.name}]"
        if section.name in found:
            raise InputFileError(path, where, "is given twice. Keep one.")
        if section.T2 < section.T1:
            raise InputFileError(path, f"{where}.T2", f"must not be below T1 = {section.T1:g}.")
        if section.ratings is not None and np.any(np.diff(section.ratings) < 0.0):
            raise InputFileError(path, f"{where}.ratings", "must rise: rated, repeated, momentary.")
        fields = section.model_dump(include=set(ReducerData.__dataclass_fields__))
        found[section.name] = ReducerData(**fields)
    return tuple(found.values())
