"""Descriptions and units of every key of every file, and the generated page."""

import pytest
from small_arms import ROOT

from stiffopt.report.file_reference import (
    file_models,
    file_schema,
    forms,
    reference_page,
    sentence,
    units,
)

KINDS = tuple(file_models())
# Numbers whose unit is another key's, or that belong to no dimension.
PURE = {
    ("ParameterSection", "value"),
    ("ParameterSection", "sd"),
    ("ExpectedSection", "objective"),
    ("ExpectedValueSection", "value"),
    # In the unit of the entry that they vary.
    ("RangeSection", "lower"),
    ("RangeSection", "upper"),
    ("FrontSection", "lower"),
    ("FrontSection", "upper"),
    # A matrix of N/m, N and N m/rad.
    ("BeamSection", "stiffness"),
    ("OwnBelt", "teeth_in_mesh_max"),
    ("OwnSurface", "fractal_dimension"),
}


def keys(kind):
    """Definitions of a kind of file, and section, key and schema of every key."""
    schema = file_schema(kind)
    definitions = schema.get("$defs", {})
    found = [
        (section["title"], key, field)
        for section in (schema, *definitions.values())
        for key, field in section["properties"].items()
    ]
    assert len(found) > 10
    return definitions, found


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_has_a_description(kind):
    definitions, found = keys(kind)
    silent = [(s, k) for s, k, f in found if k != "type" and not sentence(f, definitions)]
    assert silent == []
    for section in definitions.values():
        assert section.get("description"), section["title"]


@pytest.mark.parametrize("kind", KINDS)
def test_every_number_has_a_unit(kind):
    _, found = keys(kind)
    bare = [
        (section, key)
        for section, key, field in found
        if (section, key) not in PURE
        and not units(field)
        and any(form.get("type") == "number" for form in forms(field))
    ]
    assert bare == []


def test_file_reference_page_is_current():
    page = (ROOT / ".github" / "files.md").read_text(encoding="utf-8")
    command = "python -m stiffopt.report.file_reference > .github/files.md"
    assert page == reference_page(), f"run: {command}"
