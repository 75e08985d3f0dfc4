"""Ctrl-C during a diagnosis: what was found so far is told, and that it was stopped."""

import json

import pytest
from diagnosed_folders import written
from simulated_sets import COULOMB

from stiffopt.cli import run
from stiffopt.discovery.judging import held_out
from stiffopt.discovery.search import search as searching


def interrupted(monkeypatch, module, name, calls):
    """Ctrl-C in a function, from that call on."""
    plain, count = getattr(module, name), 0

    def function(*arguments, **keywords):
        nonlocal count
        count += 1
        if count == calls:
            raise KeyboardInterrupt
        return plain(*arguments, **keywords)

    monkeypatch.setattr(module, name, function)


def answered(tmp_path, *options):
    arguments = ["diagnose", str(written(COULOMB)), "--out", str(tmp_path / "out"), "--quiet"]
    code = run([*arguments, "--no-report", *options])
    path = tmp_path / "out" / "diagnosis.json"
    return code, json.loads(path.read_text()) if path.is_file() else None


@pytest.mark.slow
def test_in_the_search_after_a_finding(tmp_path, monkeypatch, capsys):
    interrupted(monkeypatch, searching, "scan", 2)
    code, document = answered(tmp_path)
    assert code == 130
    assert document["stopped"]
    assert document["assumptions"][0].startswith("Stopped by the user: what was found until then")
    assert [finding["effect"] for finding in document["findings"]] == ["coulomb"]
    assert "Assumed: Stopped by the user" in capsys.readouterr().out


def test_before_any_finding_nothing_is_claimed(tmp_path, monkeypatch, capsys):
    interrupted(monkeypatch, searching, "scan", 1)
    assert answered(tmp_path) == (130, None)
    assert "interrupted; nothing was written" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_while_held_out_runs_are_predicted(tmp_path, monkeypatch):
    interrupted(monkeypatch, held_out, "Predictor", 1)
    code, document = answered(tmp_path)
    assert code == 130
    first = document["assumptions"][0]
    assert "not all held-out runs were predicted" in first
    assert "test_1" in first
    assert document["findings"]
