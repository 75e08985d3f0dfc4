import csv
import json
import os
from dataclasses import replace

import numpy as np
import pytest
from synthetic_solution import assessment, no_motion, solution, trajectory_columns

from stiffopt import files
from stiffopt.errors import InputFileError
from stiffopt.result.assessment import LowestStiffness
from stiffopt.result.store import (
    export_times,
    result_document,
    write_result,
    write_trajectory,
)

PEAKS = {"peak": float, "rms": float}
LOWEST = {"value": float, "joint": int, "time": float}
DEFLECTION = dict.fromkeys(("dynamic", "static", "process", "total"), PEAKS)
BASELINE = {
    "feasible": bool,
    "duration": float,
    "deflection": DEFLECTION,
    "min_stiffness": LOWEST,
}
SHAPE = {
    "schema": int,
    "status": str,
    "message": str,
    "objective": {"name": str, "measure": str, "value": float, "unit": str},
    "duration": float,
    "certificate": {
        "points": int,
        "worst_violation": {"value": float, "limit": str, "joint": int, "time": float},
        "min_stiffness": LOWEST,
        "deflection": DEFLECTION,
    },
    "baselines": {"toppra": BASELINE, "quintic": BASELINE},
    "ratio_to_better_baseline": float,
    "solver": {
        "iterations": int,
        "build_s": float,
        "solve_s": float,
        "homotopy": list,
        "transcription": str,
        "intervals": int,
    },
    "inputs_hash": str,
    "versions": dict,
}


def check_shape(document, shape, place=""):
    for key, kind in shape.items():
        assert key in document, f"{place}.{key} is missing"
        if isinstance(kind, dict):
            check_shape(document[key], kind, f"{place}.{key}")
        else:
            assert isinstance(document[key], kind), f"{place}.{key}"


def test_result_has_every_key_of_the_schema(tmp_path):
    path = write_result(solution(), tmp_path / "new" / "folder")
    document = json.loads(path.read_text(encoding="utf-8"))
    check_shape(document, SHAPE)
    assert document["schema"] == 1
    assert document["status"] == "optimal"
    assert document["certificate"]["points"] == 6001
    assert document["certificate"]["worst_violation"]["limit"] == "torque"
    assert document["solver"]["homotopy"][0] == {
        "intervals": 30,
        "smoothing": 4.0,
        "status": "optimal",
    }
    assert document["baselines"]["quintic"]["feasible"] is False


def test_numbers_keep_their_full_precision(tmp_path):
    value = 0.1 + 0.2
    document = json.loads(
        write_result(solution(ratio_to_better_baseline=value), tmp_path).read_text()
    )
    assert document["ratio_to_better_baseline"] == value


def test_values_that_are_not_finite_become_null(tmp_path):
    motion = replace(
        assessment(),
        lowest_stiffness=(LowestStiffness(np.inf, 1, 0.0), LowestStiffness(np.nan, 2, 0.0)),
        integrals={"one": np.nan, "two": np.float64(np.inf)},
    )
    path = write_result(solution(assessment=motion), tmp_path)

    def refuse(constant):
        raise AssertionError(constant)

    document = json.loads(path.read_text(), parse_constant=refuse)
    assert document["certificate"]["integrals"] == {"one": None, "two": None}
    assert [low["value"] for low in document["certificate"]["lowest_stiffness"]] == [None, None]


def test_a_result_without_a_motion_is_written(tmp_path):
    document = json.loads(write_result(no_motion(), tmp_path).read_text())
    assert document["status"] == "infeasible"
    assert "torque of joint 2" in document["message"]
    assert document["certificate"] is None
    assert document["duration"] is None
    assert document["baselines"]["toppra"]["reason"] == "Too slow."
    assert set(SHAPE) <= set(document)


def test_document_of_a_solution_is_plain_data():
    text = json.dumps(result_document(solution()), allow_nan=False)
    assert json.loads(text) == result_document(solution())


@pytest.mark.parametrize(
    ("duration", "count"), [(0.6, 301), (0.0115, 7), (1.6, 801), (0.3, 151), (0.002, 2)]
)
def test_export_times_are_every_two_milliseconds_and_end_exactly(duration, count):
    times = export_times(duration)
    assert len(times) == count
    assert times[0] == 0.0
    assert times[-1] == duration
    assert np.allclose(np.diff(times)[:-1], 2e-3, rtol=0, atol=1e-15)
    assert 0 < times[-1] - times[-2] <= 2e-3 + 1e-12


def test_trajectory_has_the_columns_in_order_and_exact_values(tmp_path):
    motion = assessment(times=export_times(0.5))
    path = write_trajectory(motion, tmp_path)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    header = (
        "t,q1,q2,qd1,qd2,qdd1,qdd2,tau1,tau2,tau_spring1,tau_spring2,k1,k2,windup1,windup2,"
        "tool_x,tool_y,tool_z,deflection_x,deflection_y,deflection_z,deflection_dynamic_x,"
        "deflection_dynamic_y,deflection_dynamic_z"
    )
    assert ",".join(rows[0]) == header
    assert list(rows[0]) == trajectory_columns(2)
    assert [float(row["t"]) for row in rows] == motion.time.tolist()
    assert rows[-1]["t"] == "0.5"
    for name, values in {
        "qdd2": motion.acceleration[:, 1],
        "tau_spring1": motion.spring_torque[:, 0],
        "deflection_z": motion.deflection["total"][:, 2],
        "deflection_dynamic_x": motion.deflection["dynamic"][:, 0],
    }.items():
        assert [float(row[name]) for row in rows] == values.tolist()


@pytest.mark.parametrize("write", [write_result, write_trajectory])
def test_failed_write_leaves_no_file(tmp_path, monkeypatch, write):
    def fail(*_):
        raise OSError(28, "No space left on device")

    content = solution() if write is write_result else assessment()
    write(content, tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(before) == 1
    monkeypatch.setattr(files.os, "replace", fail)
    with pytest.raises((OSError, InputFileError)):
        write(content, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_folder_that_cannot_be_written_is_an_input_error(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    with pytest.raises(InputFileError, match=r"result\.json"):
        write_result(solution(), blocked)
    assert os.listdir(tmp_path) == ["file"]
