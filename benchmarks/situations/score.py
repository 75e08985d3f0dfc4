"""Score of an answer: what was concealed and is named, its values, and what is claimed beyond."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from .causes import USUAL

NAMED = 0.5  # probability from which a finding is a claim
DEVIATIONS = 3.0  # within which a value is right


def scored(name: str, folder: Path) -> dict[str, Any]:
    """Row of the table for one situation."""
    case = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    found = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
    row = {"name": name, "case": case, "seconds": found["seconds"]}
    said = "".join(step["said"] for step in found["commands"])
    answer = found.get("diagnosis")
    if answer is None:
        first = [line for line in said.splitlines() if line.strip()]
        missed = [_from_text(truth, said) for truth in case["truths"]]
        return row | {"refused": " ".join(first[-6:])[:300], "told": missed, "false": []}
    claims = [each for each in answer["findings"] if each["probability"] >= NAMED]
    claims = [
        each
        for each in claims
        if not _is_usual(each, case) or any(_names(each, truth) for truth in case["truths"])
    ]
    told, right = [], []
    for truth in case["truths"]:
        own = [k for k, each in enumerate(claims) if _names(each, truth)]
        right += own
        told.append(_told(truth, own, claims, answer, said))
    false = [each for k, each in enumerate(claims) if k not in right]
    return row | {
        "verdict": answer["verdict"],
        "told": told,
        "false": [_short(each) for each in false],
        "residual": (answer["fit"]["test"] or {}).get("nrmse_after"),
    }


def _is_usual(finding: dict[str, Any], case: dict[str, Any]) -> bool:
    """True for friction and rotors, which the user's model lacks in every joint, and guesses."""
    guessed = finding["effect"] == "inertial_error" and case["masses"] != "stated"
    return guessed or finding["effect"] in USUAL


def _names(finding: dict[str, Any], truth: dict[str, Any]) -> bool:
    joint = truth["joint"]
    return finding["effect"] in truth["effects"] and joint in (None, finding["joint"])


def _told(
    truth: dict[str, Any], own: list[int], claims: list[Any], answer: dict[str, Any], said: str
) -> str:
    if truth["effects"] == ["episode"]:
        run = truth["kind"].split()[-1]
        return "named" if any(each["run"].endswith(run) for each in answer["episodes"]) else "no"
    if not own:
        rivals = [
            rival
            for each in answer["findings"]
            for rival in (each, *each["confused_with"])
            if rival.get("effect") in truth["effects"] and truth["joint"] in (None, rival["joint"])
        ]
        return "rival" if rivals else _from_text(truth, said)
    finding = claims[own[0]]
    wrong = []
    for parameter, value in truth["values"].items():
        given = finding["parameters"].get(parameter)
        if given and abs(given["value"] - value) > DEVIATIONS * (given["sd"] or 0.0):
            wrong.append(f"{parameter} {given['value']:.3g} +- {given['sd']:.2g} for {value:.3g}")
    return "; ".join(["named" if own[0] < 2 else "named late", *wrong])


def _from_text(truth: dict[str, Any], said: str) -> str:
    """What the commands say of a channel outside of findings."""
    if truth["effects"] != ["fault"]:
        return "no"
    return "said" if f"tau{truth['joint']}" in said or f"joint {truth['joint']}" in said else "no"


def _short(finding: dict[str, Any]) -> str:
    place = finding["joint"] or finding["link"] or finding["run"] or ""
    return f"{finding['effect']}@{place} {finding['probability']:.2f}"


def table(rows: list[dict[str, Any]]) -> str:
    """One line a situation; below, for more than one, the sums."""
    lines = []
    for row in rows:
        case = row["case"]
        truths = " + ".join(
            truth["kind"] + (f" J{truth['joint']}" if truth["joint"] else "")
            for truth in case["truths"]
        )
        residual = row.get("residual")
        lines.append(
            f"| {row['name'][:3]} | {truths or 'nothing'} | {case['weight']:.0f} kg, {case['axes']}"
            f" axes, masses {case['masses']}{'' if case['timed'] else ', untimed'} | "
            + " / ".join(row["told"])
            + f" | {', '.join(row['false'])} | "
            + ("refused: " + row["refused"] if residual is None else f"{residual:.2f}")
            + f" | {row['seconds']:.0f} s |"
        )
    if len(rows) > 1:
        told = [each for row in rows for each in row["told"]]
        controls = [row for row in rows if not row["case"]["truths"]]
        left = [row["residual"] for row in rows if row.get("residual") is not None]
        lines += [
            "",
            f"named {sum(each.startswith('named') for each in told)} of {len(told)}, values wrong"
            f" {sum(';' in each for each in told)}, false {sum(len(row['false']) for row in rows)}"
            f" in {len(rows)} situations, in controls {sum(len(row['false']) for row in controls)}"
            f" of {len(controls)}; residual median {np.median(left):.2f}, above 1.3:"
            f" {sum(each > 1.3 for each in left)} of {len(left)}",
        ]
    return "\n".join(lines)
