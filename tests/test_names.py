"""Names tell things apart: a public class exists once, and no module or function is a riddle."""

import ast
import re
from collections import defaultdict

from small_arms import ROOT

PACKAGE = ROOT / "stiffopt"
FILES = sorted(PACKAGE.rglob("*.py"))
# Participles and metaphors that did not say what a thing is; the field has terms for all of them.
RIDDLES = {
    "placed",
    "credit",
    "silent",
    "menus",
    "ledger",
    "conclude",
    "judged",
    "told",
    "sized",
    "settled",
    "spoken",
}


def words(name):
    """Lower-case words of a name in snake_case or CamelCase."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z0-9]+|[A-Z]+(?![a-z])", name)}


def test_a_public_class_is_defined_once():
    places = defaultdict(list)
    for file in FILES:
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(file.relative_to(PACKAGE).as_posix())
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_no_name_is_a_riddle():
    riddles = []
    for file in FILES:
        where = file.relative_to(PACKAGE).as_posix()
        names = [part.removesuffix(".py") for part in where.split("/")]
        tree = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        kinds = ast.ClassDef | ast.FunctionDef
        names += [node.name for node in tree if isinstance(node, kinds)]
        riddles += [f"{where}: {name}" for name in names if words(name) & RIDDLES]
    assert riddles == []
