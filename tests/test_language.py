"""The package is written in plain technical English that an engineer can search."""

import ast
import re

from small_arms import ROOT

FILES = sorted((ROOT / "stiffopt").rglob("*.py"))
# Openings of docstrings that name no quantity and no action.
OPENING = re.compile(r"(What|Whether|Of|Who|Where|How|That|As|Which)\b")
# Of "what" in 1000 lines: it stands where a quantity should be named.
MAX_WHAT = 2.0
# Idioms, and the terms to use instead.
IDIOMS = {
    r"\bmeasuring rods?\b": "noise ceiling",
    r"\bswings? on\b": "residual vibration",
    r"\bdrawn in\b": "constraint back-off",
    r"\bled around\b": "collision avoidance",
    r"\bwould have been seen\b": "detection limit",
}


def texts():
    return [(path, path.read_text(encoding="utf-8")) for path in FILES]


def test_private_constants_have_more_than_one_word():
    found = []
    for path, text in texts():
        for node in ast.parse(text).body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
            names = [name for target in targets for name in ast.walk(target)]
            found += [
                f"{path.name}: {name.id}"
                for name in names
                if isinstance(name, ast.Name) and re.fullmatch(r"_[A-Z]+\d*", name.id)
            ]
    assert found == []


def test_docstrings_name_a_quantity_or_an_action():
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    found = []
    for path, text in texts():
        for node in ast.walk(ast.parse(text)):
            summary = ast.get_docstring(node) if isinstance(node, kinds) else None
            if summary and OPENING.match(summary):
                found.append(f"{path.name}: {summary.splitlines()[0]}")
    assert found == []


def test_what_is_rare():
    words = sum(len(re.findall(r"\bwhat\b", text, re.IGNORECASE)) for _, text in texts())
    lines = sum(text.count("\n") for _, text in texts())
    assert 1000.0 * words / lines < MAX_WHAT


def test_terms_of_the_field_stand_in_place_of_idioms():
    found = [
        f"{path.name}: {match.group()} -> {term}"
        for path, text in texts()
        for idiom, term in IDIOMS.items()
        for match in re.finditer(idiom, text)
    ]
    assert found == []


def test_no_module_is_longer_than_500_lines():
    long = {path.name: text.count("\n") for path, text in texts() if text.count("\n") > 500}
    assert long == {}
