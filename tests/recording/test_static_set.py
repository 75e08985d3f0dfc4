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
        (("", ""), ("fz", "f_z"), r"poses\.csv: needs .* the columns"),
        (("", ""), ("200.0", "0.0"), r"poses\.csv, row 2: a pose without a force"),
        (("", ""), ("200.0", "much"), r"row 2, fz: needs a finite number"),
        (('"poses.csv"', '"../poses.csv"'), ("", ""), "lies outside of the set"),
    ],
)
def test_wrong_static_sets_are_refused(
    tmp_path: Path, toml: tuple[str, str], poses: tuple[str, str], says: str
) -> None:
    with pytest.raises(InputFileError, match=says):
        load_static_set(folder_of(tmp_path, toml, poses))
