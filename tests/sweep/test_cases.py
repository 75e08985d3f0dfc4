"""Sweep files: cases, keys and refusals."""

import numpy as np
import pytest
from small_arms import CONSTANT, ROOT, joint, write_problem, write_robot

from stiffopt.errors import InputFileError
from stiffopt.sweep.cases import latin_hypercube, load_sweep
from stiffopt.sweep.run import predecessors, spread_order
from stiffopt.sweep.solve_case import solve_case

BASE = ROOT / "problems" / "two_link.toml"


def sweep_file(folder, text, base=BASE):
    path = folder / "sweep.toml"
    path.write_text(f'schema = 1\nkind = "sweep"\nbase = "{base}"\n{text}\n', encoding="utf-8")
    return path


def changes(sweep):
    return [dict(case.changes) for case in sweep.cases]


def test_grids_are_combined_and_lists_vary_together(tmp_path):
    text = """
[grid]
"motion.duration" = ["1 s", "2 s"]
payload.mass = [0.0, 0.5]
[lists]
"method.intervals" = [20, 30]
"method.tolerance" = [1e-6, 1e-7]
"""
    sweep = load_sweep(sweep_file(tmp_path, text))
    assert sweep.places == (
        "motion.duration", "payload.mass", "method.intervals", "method.tolerance"
    )  # fmt: skip
    assert len(sweep.cases) == len({case.key for case in sweep.cases}) == 8
    assert changes(sweep)[:2] == [
        {"motion.duration": "1 s", "payload.mass": 0.0, "method.intervals": n,
         "method.tolerance": tolerance}
        for n, tolerance in ((20, 1e-6), (30, 1e-7))
    ]  # fmt: skip


def test_a_latin_hypercube_has_one_point_in_each_layer_of_each_range(tmp_path):
    text = """
[latin_hypercube]
count = 10
"limits.scale.velocity" = { lower = 0.5, upper = 1.0 }
"motion.duration" = { lower = "1 s", upper = "2 s" }
seed = 3
"""
    path = sweep_file(tmp_path, text)
    sweep = load_sweep(path)
    scales = sorted(each["limits.scale.velocity"] for each in changes(sweep))
    assert [int((value - 0.5) / 0.05) for value in scales] == list(range(10))
    times = sorted(each["motion.duration"] for each in changes(sweep))
    assert [int((float(value.split()[0]) - 1.0) / 0.1) for value in times] == list(range(10))
    assert changes(load_sweep(path)) == changes(sweep)
    assert changes(load_sweep(path, ["latin_hypercube.seed=4"])) != changes(sweep)


@pytest.mark.parametrize(("count", "ranges", "seed"), [(1, 1, 0), (7, 3, 1), (200, 2, 42)])
def test_a_latin_hypercube_is_that_of_scipy(count, ranges, seed):
    from scipy.stats import qmc

    known = qmc.LatinHypercube(ranges, rng=seed).random(count)
    np.testing.assert_array_equal(latin_hypercube(count, ranges, seed), known)


def test_case_key_depends_on_all_inputs(tmp_path):
    robot = tmp_path / "robot.toml"
    base = tmp_path / "base.toml"
    for source, copy in ((BASE, base), (ROOT / "problems" / "two_link_robot.toml", robot)):
        copy.write_text(source.read_text().replace("two_link_robot.toml", "robot.toml"))
    (tmp_path / "two_link.urdf").write_text((ROOT / "problems" / "two_link.urdf").read_text())
    path = sweep_file(tmp_path, '[grid]\n"payload.mass" = [0.1]', base.name)
    (before,) = load_sweep(path).cases
    assert load_sweep(path).cases[0].key == before.key
    assert solve_case(before)[0]["status"] == "optimal"
    robot.write_text(robot.read_text() + "\n# another\n")
    assert load_sweep(path).cases[0].key != before.key


def test_case_key_depends_on_meshes_of_links_and_cell(tmp_path):
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"><visual><geometry><mesh filename="meshes/base.stl"/>'
        '</geometry></visual></link><link><visual><geometry><mesh filename="gone.stl"/>'
        "</geometry></visual></link></robot>"
    )
    (tmp_path / "meshes").mkdir()
    link, jig = tmp_path / "meshes" / "base.stl", tmp_path / "jig.stl"
    base = tmp_path / "base.toml"
    base.write_text(
        'kind = "trajectory"\nrobot = "arm.urdf"\n[[cell.mesh]]\nname = "jig"\nfile = "jig.stl"\n'
    )
    path = sweep_file(tmp_path, "", base.name)
    keys = []
    for own, around in ((b"1", b"1"), (b"2", b"1"), (b"2", b"2")):
        link.write_bytes(own)
        jig.write_bytes(around)
        keys.append(load_sweep(path).cases[0].key)
    assert len(set(keys)) == 3


@pytest.mark.parametrize(
    ("run", "file"),
    [
        ("run.parquet#3", "run.parquet"),
        ("run.parquet#3", "meta/info.json"),
        ("bag", "bag/metadata.yaml"),
        ("bag", "bag/0.db3"),
        ("bag/0.db3", "bag/1.db3"),
        ("a_Ipo.dat", "a_Ipo.r64"),
        ("a_Ipo.dat", "a_Drive#1.r64"),
    ],
)
def test_case_key_depends_on_all_run_files(tmp_path, run, file):
    for name in (
        "run.parquet", "meta/info.json", "bag/metadata.yaml", "bag/0.db3", "bag/1.db3",
        "a_Ipo.dat", "a_Ipo.r64", "a_Drive#1.dat", "a_Drive#1.r64",
    ):  # fmt: skip
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("{}")
    base = tmp_path / "recordings.toml"
    base.write_text(f'schema = 1\nname = "#3"\ntitle = "No #file/."\n[[runs]]\nfile = "{run}"\n')
    path = sweep_file(tmp_path, "", base.name)
    (before,) = load_sweep(path).cases
    (tmp_path / "unnamed.csv").write_text("1")
    assert load_sweep(path).cases[0].key == before.key
    (tmp_path / file).write_text('{"other": 1}')
    assert load_sweep(path).cases[0].key != before.key


def test_long_texts_are_not_taken_for_file_names(tmp_path):
    base = tmp_path / "base.toml"
    base.write_text(f'kind = "trajectory"\ntitle = "{200 * "ü"}"\n', encoding="utf-8")
    assert len(load_sweep(sweep_file(tmp_path, "", base.name)).cases) == 1


def test_case_key_depends_on_files_named_by_changes(tmp_path):
    for name in ("one", "other"):
        (tmp_path / f"{name}.toml").write_text('kind = "robot"\n')
    base = tmp_path / "base.toml"
    base.write_text('kind = "trajectory"\nrobot = "one.toml"\n')
    path = sweep_file(tmp_path, '[grid]\nrobot = ["one.toml", "other.toml"]', base.name)
    before = [case.key for case in load_sweep(path).cases]
    (tmp_path / "other.toml").write_text('kind = "robot"\nname = "changed"\n')
    after = [case.key for case in load_sweep(path).cases]
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False]


def test_sets_are_named_by_their_folders(tmp_path):
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "recordings.toml").write_text("schema = 1\n")
    path = tmp_path / "sweep.toml"
    path.write_text('schema = 1\nkind = "sweep"\nbase = ["one", "other"]\n')
    names = list(load_sweep(path).base_names.values())
    assert names == ["one", "other"]


def test_stiffness_of_a_prismatic_joint_has_its_unit(tmp_path):
    base = write_problem(tmp_path, "slide", method="intervals = 8")
    soft = joint("rail", CONSTANT.format(stiffness=1e3), torque_max=200.0)
    write_robot(tmp_path, "slide", [soft, joint("arm", CONSTANT.format(stiffness=1e4))])
    (case,) = load_sweep(sweep_file(tmp_path, "", base)).cases
    found, _ = solve_case(case)
    assert found["values"]["least_stiffness"] == {"value": pytest.approx(1e3), "unit": "N/m"}


def test_infinite_limit_is_a_valid_value(tmp_path):
    text = '[grid]\n"limits.torque" = [inf, 10.0]\ntitle = [1979-05-27]'
    sweep = load_sweep(sweep_file(tmp_path, text))
    assert [case.settings[0] for case in sweep.cases] == ["limits.torque=inf", "limits.torque=10.0"]
    assert len({case.key for case in sweep.cases}) == 2
    with np.errstate(all="raise"):
        predecessors(list(sweep.cases))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('[grid]\n"payload.mass" = []', "payload.mass has no value"),
        ('[lists]\n"a" = [1]\n"b" = [1, 2]', "differ in length"),
        ('[grid]\n"a" = [1]\n[lists]\n"a" = [1]', "two axes"),
        ("[latin_hypercube]\ncount = 3", "has no range"),
        ("[latin_hypercube]\ncount = 3\na = [1, 2]", "Its keys: lower, upper"),
        ('[latin_hypercube]\ncount = 3\na = { lower = "1 s", upper = "2 mm" }', "same unit"),
        ("[latin_hypercube]\ncount = 3\na = { lower = 2, upper = 1 }", "must be below"),
        ('[latin_hypercube]\ncount = 3\na = { lower = "x", upper = "y" }', "two numbers"),
        ("[latin_hypercube]\ncount = 3\na = { lower = 1, upper = inf }", "finite number"),
        ('[front]\nover = "a"\nlower = "1 s"\nupper = "1e999 s"', "finite ends"),
        ("starts = 0", "starts"),
        ("[grid]\na = [1, 2]\n[latin_hypercube]\ncount = 100000\nb = { lower = 0, upper = 1 }",
         "200000 cases"),
    ],
)  # fmt: skip
def test_invalid_sweeps_are_refused(tmp_path, text, named):
    with pytest.raises(InputFileError, match=named):
        load_sweep(sweep_file(tmp_path, text))


def test_a_base_of_another_kind_is_refused(tmp_path):
    with pytest.raises(InputFileError, match="is of kind 'robot'"):
        load_sweep(sweep_file(tmp_path, "", ROOT / "problems" / "two_link_robot.toml"))


def test_case_starts_from_the_nearest_of_earlier_rounds(tmp_path):
    values = ", ".join(f"{0.5 + 0.1 * k:.1f}" for k in range(16))
    sweep = load_sweep(sweep_file(tmp_path, f'[grid]\n"payload.mass" = [{values}]'))
    cases, before = list(sweep.cases), predecessors(list(sweep.cases))
    masses = {case.key: dict(case.changes)["payload.mass"] for case in cases}
    first, *others = spread_order(cases)
    assert before[first.key] is None
    steps = [abs(masses[case.key] - masses[before[case.key]]) for case in others]
    # Half of them start from a neighbour.
    assert sorted(steps)[:8] == pytest.approx(8 * [0.1])
    # Rounds of 1, 1, 2, 4 and 8 cases: none waits for more than four others.
    depth = 0
    for case in cases:
        chain, key = 0, case.key
        while before[key] is not None:
            chain, key = chain + 1, before[key]
        depth = max(depth, chain)
    assert depth <= 4


def test_diagnoses_and_further_guesses_start_cold(tmp_path):
    sweep = load_sweep(sweep_file(tmp_path, 'starts = 3\n[grid]\n"payload.mass" = [0.1, 0.2]'))
    before = predecessors(list(sweep.cases))
    begun = [case.start for case in sweep.cases if before[case.key] is not None]
    assert begun == [0]


def test_a_base_listed_twice_is_refused(tmp_path):
    path = sweep_file(tmp_path, "")
    line = next(line for line in path.read_text().splitlines() if line.startswith("base"))
    name = line.partition("=")[2].strip().strip("[]")
    path.write_text(path.read_text().replace(line, f"base = [{name}, {name}]"))
    with pytest.raises(InputFileError, match="more than once"):
        load_sweep(path)
