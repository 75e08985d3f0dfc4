"""Poses that tell nothing of a stiffness: the report says so, and no library complains."""

import warnings

from benchmarks.reliability.documents import sets
from stiffopt.cli import run


def test_noise_only_identifies_no_joint(tmp_path, capsys):
    subject = next(each for each in sets(tmp_path) if each.kind == "static")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        arguments = ["identify-stiffness", str(subject.folder), "--out", str(tmp_path / "out")]
        assert run(arguments) == 0
    assert "Stiffness of 0 of 2 joints identified" in capsys.readouterr().out
