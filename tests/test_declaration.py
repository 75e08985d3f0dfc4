"""A declared field is checked alike in Python and in files."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
import pytest

from stiffopt.declaration import (
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    Bounds,
    Doc,
    JointStiffness,
    Length,
    Ratio,
    Unit,
    check_fields,
)
from stiffopt.errors import InputError, InputFileError, OutOfValidityError
from stiffopt.validation import Section, validate


@dataclasses.dataclass(frozen=True, kw_only=True)
class Beam:
    """Beam between two walls."""

    length: Annotated[Length, POSITIVE, Doc("Distance of the walls.")]
    ends: Annotated[Literal["held", "free"], Doc("How the ends are held.")] = "held"
    share: Annotated[Ratio | None, FRACTION, Doc("Share of the load.")] = None
    supports: Annotated[
        Mapping[int, Annotated[JointStiffness, POSITIVE]], Doc("Stiffness by number of support.")
    ] = dataclasses.field(default_factory=dict)
    cuts: Annotated[tuple[Annotated[Length, NOT_NEGATIVE], ...], Doc("Places of cuts.")] = ()

    def __post_init__(self):
        check_fields(self, "beam")
        if any(cut > self.length for cut in self.cuts):
            raise InputError("cuts must lie on the beam. Correct them.")


class BeamFile(Section):
    """A file with a beam."""

    beam: Beam


def read(**keys):
    return validate(BeamFile, {"beam": keys}, "beam.toml").beam


def test_section_of_a_file_is_the_dataclass():
    beam = read(length="300 mm", supports={2: "20 N/um"}, cuts=[0.1, "20 cm"])
    assert beam == Beam(length=0.3, supports={2: 2e7}, cuts=(0.1, 0.2))
    assert dataclasses.replace(beam, length=0.4).length == 0.4


@pytest.mark.parametrize(
    ("changes", "where", "sentence"),
    [
        ({"length": -1.0}, "beam.length", "length = -1 cannot be used; allowed is a finite number"),
        ({"share": 0.0}, "beam.share", "share = 0 cannot be used; allowed is a finite number abo"),
        ({"share": 1.5}, "beam.share", "above 0 and at most 1. Correct share (SI units)."),
        ({"supports": {3: -1.0}}, "beam.supports.3", "supports = -1 cannot be used"),
        ({"cuts": (0.1, -0.1)}, "beam.cuts[2]", "finite number, 0 or above"),
        ({"cuts": (2.0,)}, "beam", "cuts must lie on the beam. Correct them."),
    ],
)
def test_bounds_have_the_same_message_in_python_and_files(changes, where, sentence):
    values = {"length": 1.0} | changes
    with pytest.raises(InputError) as told:
        Beam(**values)
    assert sentence in str(told.value)
    with pytest.raises(InputFileError) as told:
        read(**values)
    assert told.value.where == where
    assert sentence in told.value.reason


def test_unknown_words_and_keys_suggest_the_nearest():
    with pytest.raises(InputError, match=r"beam: ends = 'hold' is not known. Did you mean 'held'"):
        Beam(length=1.0, ends="hold")
    with pytest.raises(InputFileError, match=r"beam\.ends: got 'hold'\. Did you mean 'held'"):
        read(length=1.0, ends="hold")
    with pytest.raises(InputFileError, match=r"unknown key 'lenght'. Did you mean 'length'"):
        read(lenght=1.0)
    with pytest.raises(InputFileError, match=r"beam\.length: this key is required"):
        read(ends="free")
    with pytest.raises(InputFileError, match=r"length.*not one of length"):
        read(length="3 deg")


def test_schema_has_unit_bounds_words_and_description():
    schema = BeamFile.model_json_schema()["$defs"]["Beam"]
    assert schema["description"] == "Beam between two walls."
    length, cuts = schema["properties"]["length"], schema["properties"]["cuts"]
    assert (length["unit"], length["description"]) == ("m", "Distance of the walls.")
    number = {"type": "number", "plausible": [0.0, 100.0], "exclusiveMinimum": 0.0}
    assert length["anyOf"][0] == number
    assert cuts["items"]["anyOf"][0]["minimum"] == 0.0
    assert schema["properties"]["ends"]["enum"] == ["held", "free"]
    support = schema["properties"]["supports"]["additionalProperties"]
    assert (support["unit"], support["unit_prismatic"]) == ("N*m/rad", "N/m")
    assert schema["required"] == ["length"]


def test_bounds():
    with pytest.raises(OutOfValidityError, match="angle = 2 is outside the validity range 0 to 1"):
        Bounds(above=0.0, below=1.0).check("angle", 2.0)
    with pytest.raises(InputError, match="allowed is a finite number, 1 or above and at most 5"):
        Bounds(least=1.0, most=5.0).check("points", 6)
    for wrong in (math.nan, math.inf, -1.0, [1.0, 0.0], np.array([1.0, math.nan])):
        with pytest.raises(InputError, match=r"x = .* cannot be used"):
            POSITIVE.check("x", wrong)
    POSITIVE.check("x", np.array([1.0, 2.0]))
    POSITIVE.check("x", None)
    rigid = Bounds(above=0.0, finite=False)
    rigid.check("x", math.inf)
    with pytest.raises(InputError, match="x = nan"):
        rigid.check("x", math.nan)


def test_bare_quantities_refuse_texts():
    class Run(Section):
        temperature: Annotated[float, Unit("temperature", bare=True), Doc("Of the housing.")]

    assert validate(Run, {"temperature": 22}, "run").temperature == 22.0
    with pytest.raises(InputFileError, match="valid number"):
        validate(Run, {"temperature": "22 degC"}, "run")
    assert Run.model_json_schema()["properties"]["temperature"]["unit"] == "degC"
