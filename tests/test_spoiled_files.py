"""Spoiled files of every kind through their loaders: accepted or one sentence, and nothing else.

Ten thousand of them are counted by `python -m benchmarks.reliability commands 10000`.
"""

import pytest

from benchmarks.reliability.mutants import judged
from benchmarks.reliability.subjects import subjects

EACH = 12


@pytest.fixture(scope="module")
def every(tmp_path_factory):
    return subjects(tmp_path_factory.mktemp("spoiled"), with_answers=False)


KINDS = (
    "problem", "er3a_process_force", "er3a_preload_pins", "sweep", "robot", "urdf", "contacts",
    "recordings", "static", "poses", "extended", "table", "csv", "npz", "parquet", "bag of SQLite",
    "bag of SQLite, metadata", "bag of MCAP", "mcap", "mcap of JSON", "lerobot", "lerobot, rows",
    "lerobot, names", "kuka", "kuka, values",
    "own urdf", "own table", "own catalogue",
    "cell", "uncertainty", "hypercube", "left open", "currents",
)  # fmt: skip


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS)
def test_spoiled_files_end_in_one_sentence(every, kind):
    (subject,) = (each for each in every if each.kind == kind)
    path = subject.folder / subject.file
    sound = path.read_bytes()
    assert judged(lambda: subject.read(path)) == ("accepted", "")
    told = 0
    try:
        for seed in range(EACH):
            path.write_bytes(subject.spoiled(sound, seed))
            verdict, what = judged(lambda: subject.read(path))
            assert verdict in ("accepted", "told"), f"{kind}, seed {seed}: {what}"
            told += verdict == "told"
    finally:
        path.write_bytes(sound)
    assert told
