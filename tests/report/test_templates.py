"""Attributes named in page templates exist in the package: renamed fields do not break a page."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "stiffopt"
TEMPLATES = sorted(PACKAGE.rglob("*.j2"))
# Attributes of Jinja's own loop variable.
LOOP_ATTRIBUTES = {"index0", "index", "first", "last", "length"}


def _names_of_package() -> set[str]:
    """Return identifiers and string constants of all modules."""
    names: set[str] = set()
    for module in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(module.read_text())):
            match node:
                case ast.FunctionDef(name=name) | ast.Name(id=name) | ast.Attribute(attr=name):
                    names.add(name)
                case ast.AnnAssign(target=ast.Name(id=name)):
                    names.add(name)
                case ast.Constant(value=str(name)):
                    names.add(name)
                case _:
                    pass
    return names


@pytest.fixture(scope="module")
def names() -> set[str]:
    return _names_of_package() | LOOP_ATTRIBUTES


@pytest.mark.parametrize("template", TEMPLATES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_attributes_in_a_template_exist_in_the_package(template: Path, names: set[str]) -> None:
    code = " ".join(re.findall(r"\{[{%](.*?)[}%]\}", template.read_text(), re.DOTALL))
    used = set(re.findall(r"\w\.([a-z_]\w+)", re.sub(r'"[^"]*"', "", code)))
    assert used <= names
