"""The architecture page tells of the tree as it is: its rooms, its layers, its places."""

import ast
import re
import tomllib

from small_arms import ROOT

PACKAGE = ROOT / "stiffopt"
PAGE = (ROOT / ".github" / "architecture.md").read_text(encoding="utf-8")
CONFIG = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def section(title):
    """Lines of the page under a heading."""
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0].splitlines()


def table(title):
    """Cells of the rows of a section's table, without its head."""
    rows = [line for line in section(title) if line.startswith("|")]
    return [[cell.strip() for cell in row.strip("|").split(" | ")] for row in rows[2:]]


def layers():
    """Layers of the package, the uppermost first: one list of rooms each."""
    contracts = CONFIG["tool"]["importlinter"]["contracts"]
    (flow,) = [c for c in contracts if c["type"] == "layers" and c["containers"] == ["stiffopt"]]
    return [[room.strip() for room in layer.split("|")] for layer in flow["layers"]]


def rooms():
    """Rooms in the order of the layers, the rooms within each behind it, with what they hold."""
    found = []
    for room in [room for layer in layers() for room in layer]:
        folder = PACKAGE / room
        if folder.is_dir():
            within = sorted(path.parent for path in folder.rglob("__init__.py"))
            files = {path.relative_to(PACKAGE).as_posix(): path / "__init__.py" for path in within}
        else:
            files = {f"{room}.py": PACKAGE / f"{room}.py"}
        for name, file in files.items():
            words = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
            found.append([f"`{name}`", words.split("\n\n")[0].replace("\n", " ")])
    return found


def test_every_room_is_listed_with_the_first_sentence_of_its_docstring():
    expected = "\n".join(f"| {name} | {sentence} |" for name, sentence in rooms())
    assert table("Rooms") == rooms(), f"the table of rooms should read\n{expected}"


def test_layers_are_those_that_imports_are_checked_against():
    (drawn,) = "\n".join(section("What may import what")).split("```text\n")[1:]
    lines = [line.split("#")[0] for line in drawn.split("```")[0].splitlines()]
    drawn_layers = [re.split(r"\s*\|\s*|\s{2,}", line.strip()) for line in lines if line.strip()]
    assert drawn_layers == layers()


def test_every_place_exists():
    flows = " ".join(section("Three flows"))
    recipes = (ROOT / ".github" / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w./]+(?:\.py|/))`", PAGE)
    named += re.findall(r"`([\w.]+/[\w./]*)`", recipes)
    named += re.findall(r"\s((?:\w+/)+)\s", flows)
    for path in named:
        assert (PACKAGE / path).exists() or (ROOT / path).exists(), path
    for _, file, name in table("Where to find it"):
        text = (PACKAGE / file.strip("`")).read_text(encoding="utf-8")
        defined = rf"^\s*(?:(?:def|class) {name.strip('`')}\b|{name.strip('`')}\s*[:=])"
        assert re.search(defined, text, re.MULTILINE), f"{name} is not defined in {file}"


def test_top_level_holds_four_files():
    files = {path.name for path in ROOT.iterdir() if path.is_file() and path.name[0] != "."}
    assert files == {"CITATION.cff", "LICENSE", "README.md", "pyproject.toml"}


def test_benchmarks_import_no_tests():
    folder = ROOT / "benchmarks"
    for file in [*folder.glob("*.py"), *folder.glob("[a-z]*/*.py")]:
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"^\s*(?:from|import) tests\b", text, re.MULTILINE), file
