"""Folders for results: nothing half written, nothing left behind."""

import pytest

from stiffopt.errors import InputFileError
from stiffopt.folders import output_folder, staged


def tree(path):
    return {p.relative_to(path).as_posix(): p.read_text() for p in path.rglob("*") if p.is_file()}


def interrupted(*files):
    for file in files:
        file.write_text("new")
    raise KeyboardInterrupt


def test_a_folder_that_stays_empty_is_removed_with_those_above_it(tmp_path):
    with pytest.raises(KeyboardInterrupt), output_folder(tmp_path / "a" / "b"):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_way(tmp_path):
    (tmp_path / "a").write_text("")
    with pytest.raises(InputFileError, match="cannot be written"), output_folder(tmp_path / "a"):
        pass


def test_files_appear_together(tmp_path):
    with staged(tmp_path, last="z.json") as stage:
        (stage / "z.json").write_text("new")
        (stage / "figures").mkdir()
        (stage / "figures" / "one.svg").write_text("svg")
        assert tree(tmp_path).keys().isdisjoint({"z.json", "figures/one.svg"})
    assert tree(tmp_path) == {"z.json": "new", "figures/one.svg": "svg"}


def test_an_interruption_leaves_what_was_there(tmp_path):
    (tmp_path / "z.json").write_text("old")
    with pytest.raises(KeyboardInterrupt), staged(tmp_path, last="z.json") as stage:
        interrupted(stage / "z.json")
    assert tree(tmp_path) == {"z.json": "old"}
    assert len(list(tmp_path.iterdir())) == 1


def test_the_last_file_is_missing_while_the_others_change(tmp_path, monkeypatch):
    from pathlib import Path

    (tmp_path / "z.json").write_text("old")
    moved, plain = [], Path.replace

    def watched(self, target):
        moved.append((self.name, (tmp_path / "z.json").exists()))
        return plain(self, target)

    monkeypatch.setattr(Path, "replace", watched)
    with staged(tmp_path, last="z.json") as stage:
        (stage / "z.json").write_text("new")
        (stage / "zz.npz").write_text("other")
    assert moved == [("zz.npz", False), ("z.json", False)]
