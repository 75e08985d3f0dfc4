"""Static sets: poses, forces and displacements as written, or one clear message."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_sets import URDF

from benchmarks.reliability.documents import static_toml
from stiffopt.errors import InputFileError
from stiffopt.recording.static_set import load_static_set

TOML = static_toml("two", ("swing", "slide")) + "\n[nominal]\nstiffness = [1e5, 2e6]\n"
POSES = """pose,q1,q2,fx,fy,fz,dx,dy,dz
1,0.1,0.2,100.0,0.0,-3.0,1e-4,0.0,2e-5
2,0.4,0.3,0.0,0.0,200.0,0.0,0.0,3e-5
"""


def folder_of(
    path: Path, toml: tuple[str, str] = ("", ""), poses: tuple[str, str] = ("", "")
) -> Path:
    (path / "static.toml").write_text(TOML.replace(*toml) if toml[0] else TOML)
    (path / "poses.csv").write_text(POSES.replace(*poses) if poses[0] else POSES)
    (path / "robot.urdf").write_text(URDF)
    return path


def test_entries_of_the_files_are_in_the_set(tmp_path: Path) -> None:
    static = load_static_set(folder_of(tmp_path))
    assert static.joints == ("swing", "slide")
    assert static.n == 2
    np.testing.assert_array_equal(static.position, [[0.1, 0.2], [0.4, 0.3]])
    np.testing.assert_array_equal(static.force, [[100.0, 0.0, -3.0], [0.0, 0.0, 200.0]])
    np.testing.assert_array_equal(static.displacement[0], [1e-4, 0.0, 2e-5])
    np.testing.assert_array_equal(static.stiffness, [1e5, 2e6])
    assert static.difference
    assert static.robot.model.existFrame(static.tool_frame)
    plain = load_static_set(
        folder_of(tmp_path, ("\n[nominal]\nstiffness = [1e5, 2e6]\n", "")) / "static.toml"
    )
    assert plain.stiffness is None


LAB = """Pose;A1 [°];A2 [mm];Fx;Fy;Fz;dx;dy;dz
;;;[kN];[kN];[kN];[µm];[µm];[µm]
1;5,7295780;200;0,1;0;-0,003;100;0;20
2;22,918312;300;0;0;0,2;0;0;30
"""


def write_workbook(path: Path, lines: list[str]) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(lines[0].split(";"))
    for line in lines[1:]:
        book.active.append([float(cell.replace(",", ".")) for cell in line.split(";")])
    book.save(path)


@pytest.mark.parametrize("ending", ["csv", "xlsx"])
def test_units_of_column_names_are_kept(tmp_path: Path, ending: str) -> None:
    folder = folder_of(tmp_path, ('"poses.csv"', f'"Prüfstand 1.{ending}"'))
    names = {"q1": "A1 [°]", "q2": "A2 [mm]"}
    names |= {f"f{axis}": f"F{axis} [kN]" for axis in "xyz"}
    names |= {f"d{axis}": f"d{axis} [µm]" for axis in "xyz"}
    text = (folder / "static.toml").read_text()
    for short, name in names.items():
        text = text.replace(f'"{short}"', f'"{name}"')
    (folder / "static.toml").write_text(text)
    path = folder / f"Prüfstand 1.{ending}"
    if ending == "xlsx":
        rows = LAB.replace("Fx;Fy;Fz;dx;dy;dz", "Fx [kN];Fy [kN];Fz [kN];dx [µm];dy [µm];dz [µm]")
        write_workbook(path, [line for line in rows.splitlines() if line[:1] != ";"])
    else:
        rows = LAB.replace("A1 [°];A2 [mm]", "A1;A2").replace(";;;", ";[°];[mm];")
        path.write_bytes(rows.replace("\n", "\r\n").encode("utf-8-sig"))
    static = load_static_set(folder)
    np.testing.assert_allclose(static.position, [[0.1, 0.2], [0.4, 0.3]], rtol=1e-6)
    np.testing.assert_allclose(static.force, [[100.0, 0.0, -3.0], [0.0, 0.0, 200.0]])
    np.testing.assert_allclose(static.displacement, [[1e-4, 0.0, 2e-5], [0.0, 0.0, 3e-5]])


def test_scale_replaces_the_unit_of_the_name(tmp_path: Path) -> None:
    static = load_static_set(
        folder_of(tmp_path),
        [
            "scale.position=['deg', 'mm']",
            "scale.force=kN",
            "scale.displacement=[1e-3, 1e-3, -1e-3]",
        ],
    )
    np.testing.assert_allclose(static.position[0], [np.radians(0.1), 2e-4])
    np.testing.assert_allclose(static.force[0], [1e5, 0.0, -3e3])
    np.testing.assert_allclose(static.displacement[0], [1e-7, 0.0, -2e-8])


@pytest.mark.parametrize(
    ("toml", "poses", "says"),
    [
        (('"static"', '"dynamic"'), ("", ""), 'needs kind = "static"'),
        (("[1e5, 2e6]", "[1e5]"), ("", ""), r"nominal\.stiffness: needs one number a joint"),
        (
            ("[1e5, 2e6]", "[1e5, -1.0]"),
            ("", ""),
            r"nominal\.stiffness\[2\].*finite number above 0",
        ),
        (('["q1", "q2"]', '["q1"]'), ("", ""), r"position: needs one column a joint \(2\), got 1"),
        (('"fz"]', '"fx"]'), ("", ""), "one column is named for two quantities"),
        (('"slide"]', '"elbow"]'), ("", ""), "no moving joint 'elbow'"),
        (("difference = true", ""), ("", ""), "difference: this key is required"),
        (("", ""), ("fz", "f_z"), r"poses\.csv: has no column 'fz', which the set names"),
        (("", ""), ("200.0", "0.0"), r"poses\.csv, row 2: a pose without a force"),
        (("", ""), ("200.0", "much"), r"row 2, fz: needs a finite number"),
        (("", ""), ("2,0.4,", "2,23.0,"), r"row 2: swing is at 23 rad, outside its range"),
        (('"fx"', '"fx [mm]"'), ("fx", "fx [mm]"), r"force: .*'mm' is not one of force"),
        (('"q1"', '"q1 [mm]"'), ("q1", "q1 [mm]"), r"position: .*'mm' is not one of angle"),
        (('"poses.csv"', '"../poses.csv"'), ("", ""), "lies outside of the set"),
    ],
)
def test_wrong_static_sets_are_refused(
    tmp_path: Path, toml: tuple[str, str], poses: tuple[str, str], says: str
) -> None:
    with pytest.raises(InputFileError, match=says):
        load_static_set(folder_of(tmp_path, toml, poses))
