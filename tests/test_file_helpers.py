"""TOML with messages that help; files that appear whole or not at all."""

from typing import Annotated, Literal

import pytest
from pydantic import Field

from stiffopt.declaration import Length
from stiffopt.errors import InputFileError
from stiffopt.files import atomic_write, check_header, load_json, load_toml, write_csv
from stiffopt.validation import Section, validate


class Circle(Section):
    type: Literal["circle"]
    name: str = ""
    radius: Length


class Square(Section):
    type: Literal["square"]
    name: str = ""
    width: Length


class Drawing(Section):
    title: str
    shape: tuple[Annotated[Circle | Square, Field(discriminator="type")], ...] = ()
    colour: Literal["red", "green"] = "red"
    sizes: dict[str, Circle] = Field(default_factory=dict)


def fails(data):
    with pytest.raises(InputFileError) as error:
        validate(Drawing, data, "a.toml")
    return error.value


def test_valid_document_is_read():
    drawing = validate(Drawing, {"title": "t", "shape": [{"type": "circle", "radius": "3 mm"}]}, "")
    assert drawing.shape[0].radius == 3e-3


def test_unknown_keys_are_refused_at_every_level():
    error = fails({"title": "t", "colur": "red"})
    assert error.where == "colur"
    assert "unknown key 'colur'. Did you mean 'colour'?" in error.reason
    error = fails({"title": "t", "shape": [{"type": "circle", "name": "c", "radios": 1}]})
    assert "Did you mean 'radius'" in str(error)
    assert error.where.startswith("shape[c].r")
    error = fails({"title": "t", "shape": [{"type": "square", "width": 1, "hight": 2}]})
    assert error.where == "shape[1].hight"
    error = fails({"title": "t", "sizes": {"big": {"type": "circle", "radius": 1, "widht": 2}}})
    assert error.where == "sizes.big.widht"


def test_other_faults_are_refused():
    error = fails({"shape": [{"type": "circel", "radius": 1}]})
    assert "this key is required" in error.reason
    assert "title" in str(error)
    assert "Also shape[1].type: unknown type 'circel'. Did you mean 'circle'?" in str(error)
    assert "Did you mean 'green'" in str(fails({"title": "t", "colour": "gren"}))
    assert "'type' is required" in str(fails({"title": "t", "shape": [{"radius": 1}]}))
    error = fails({"title": "t", "shape": [{"type": "circle", "radius": "3 kg"}]})
    assert error.where == "shape[1].radius"
    assert "not one of length" in error.reason
    assert "valid string" in str(fails({"title": 3}))
    error = fails({"title": "t", "shape": [{"type": "circle", "radius": float("nan")}]})
    assert "finite" in str(error)


def test_missing_file_suggests_similar_names(tmp_path):
    (tmp_path / "robot.toml").write_text("")
    with pytest.raises(InputFileError, match=r"no such file\. That folder holds: robot\.toml"):
        load_toml(tmp_path / "robto.toml")
    with pytest.raises(InputFileError, match="there is no folder"):
        load_toml(tmp_path / "none" / "robot.toml")
    with pytest.raises(InputFileError, match="is a folder"):
        load_toml(tmp_path)


def test_syntax_errors_name_the_line(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("a = 1\nb = = 2\n")
    with pytest.raises(InputFileError) as error:
        load_toml(path)
    assert error.value.where == "line 2"
    path.write_bytes(b"a = '\xff'")
    with pytest.raises(InputFileError, match="UTF-8"):
        load_toml(path)


def test_invalid_json_is_refused(tmp_path):
    path = tmp_path / "a.json"
    with pytest.raises(InputFileError, match=r"a\.json: no such file"):
        load_json(path)
    path.write_text('{"a": ' + "9" * 400 + "}")
    with pytest.raises(InputFileError, match="is no JSON text: an integer of more than 64 bits"):
        load_json(path)
    path.write_text('{"a": -9223372036854775808}')
    assert load_json(path) == {"a": -(2**63)}


def test_wrong_header_is_refused():
    check_header({"schema": 1, "kind": "robot"}, "a.toml", "robot")
    with pytest.raises(InputFileError, match=r'needs kind = "robot", got \'sweep\''):
        check_header({"schema": 1, "kind": "sweep"}, "a.toml", "robot")
    with pytest.raises(InputFileError, match="the key is missing"):
        check_header({"kind": "robot"}, "a.toml", "robot")
    with pytest.raises(InputFileError, match="reads schema = 1, got 2"):
        check_header({"schema": 2, "kind": "robot"}, "a.toml", "robot")


def test_files_are_written_atomically(tmp_path):
    path = tmp_path / "out" / "table.csv"
    write_csv(path, ["a", "b"], [(1, 0.1), (2, 1 / 3)])
    assert path.read_text() == "a,b\n1,0.1\n2,0.3333333333333333\n"

    def rows():
        yield (1, 2)
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError):
        write_csv(path, ["a", "b"], rows())
    assert path.read_text().startswith("a,b\n1,0.1")
    target = tmp_path / "folder"
    target.mkdir()
    (target / "x").write_text("")
    with pytest.raises(OSError, match="folder"):
        atomic_write(target, "text")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder", "out"]
    with pytest.raises(InputFileError, match="cannot be written"):
        atomic_write(path / "below" / "a.txt", "text")


class Cube(Section):
    kind: Literal["cube"]


class Ball(Section):
    kind: Literal["ball"]


class Box(Section):
    part: Annotated[Cube | Ball, Field(discriminator="kind")]


def test_the_key_that_tells_kinds_apart_is_named():
    with pytest.raises(InputFileError, match="'kind' is required"):
        validate(Box, {"part": {}}, "a.toml")
    with pytest.raises(InputFileError, match=r"unknown kind 'bal'\. Did you mean 'ball'") as error:
        validate(Box, {"part": {"kind": "bal"}}, "a.toml")
    assert error.value.where == "part.kind"
