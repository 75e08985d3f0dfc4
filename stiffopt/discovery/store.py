"""Files of a diagnosis: diagnosis.json, extended.toml, predictions of held-out runs."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.discovery.answer import (
    MIN_LISTED_PROBABILITY,
    Statement,
    action,
    changed_values,
    statements,
)
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.diagnosis import Diagnosis, Rival
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.experiment.design import EXPERIMENT_FILE
from stiffopt.discovery.extended.store import extended_text
from stiffopt.discovery.judging.explained_shares import MismatchShare
from stiffopt.discovery.judging.unexplained import Unexplained
from stiffopt.discovery.law_search.find import FoundLaw
from stiffopt.discovery.laws.law import law_of
from stiffopt.discovery.laws.law_file import WrittenLaw, law_file_text
from stiffopt.discovery.position_fit import PositionRun, loop_values
from stiffopt.discovery.prediction import Prediction
from stiffopt.discovery.signals import RobotConstants
from stiffopt.files import SCHEMA, atomic_write, pick, to_json_types
from stiffopt.recording.signals import Signals

ANSWER_FILE = "diagnosis.json"
MODEL_FILE = "extended.toml"
LAW_FILE = "law.py"


def write_diagnosis(diagnosis: Diagnosis, directory: str | Path) -> Path:
    """Write diagnosis.json, extended.toml and the predictions; return the path of the first.

    Every file is written whole or not at all, diagnosis.json last: if it exists, all others do.
    """
    folder = Path(directory)
    signals = diagnosis.recordings.signals
    files: dict[str, str | bytes] = {}
    for proof in diagnosis.held_out:
        for when, prediction in (("before", proof.before), ("after", proof.after)):
            files[f"pred_{when}_{proof.run.name}.npz"] = _prediction_archive(prediction, signals)
    files[MODEL_FILE] = extended_text(diagnosis)
    laws = written_laws(diagnosis)
    if laws:
        files[LAW_FILE] = law_file_text(diagnosis.recordings.name, laws)
    if diagnosis.experiment is not None:
        files[EXPERIMENT_FILE] = diagnosis.experiment.csv()
    text = json.dumps(answer_document(diagnosis), indent=1, ensure_ascii=False, allow_nan=False)
    files[ANSWER_FILE] = text + "\n"
    # An earlier result must not remain beside files of another diagnosis.
    for name in (ANSWER_FILE, EXPERIMENT_FILE, LAW_FILE):
        (folder / name).unlink(missing_ok=True)
    for name, content in files.items():
        atomic_write(folder / name, content)
    return folder / ANSWER_FILE


def answer_document(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the content of diagnosis.json: numbers, strings, lists and dicts."""
    constants = diagnosis.training.constants
    document = {
        "schema": SCHEMA,
        "verdict": diagnosis.verdict,
        "verdict_by_channel": {
            each.channel: {
                "verdict": each.verdict,
                "residual_before": each.before,
                "residual_after": each.after,
            }
            for each in diagnosis.channel_verdicts
        },
        "findings": [_finding_entry(each, constants) for each in statements(diagnosis)],
        "to_do": action(diagnosis),
        "changed_values": [
            vars(each.change) | {"cause": each.cause} for each in changed_values(diagnosis)
        ],
        "fit": {
            "channels": [vars(channel) for channel in diagnosis.channels],
            **{role: _fit_entry(diagnosis, role) for role in ("test", "extrapolate")},
        },
        "mismatch": [_share_entry(each) for each in diagnosis.shares],
        "rigid_model": _rigid_entry(diagnosis),
        "black_box": _noise_ceiling_entry(diagnosis),
        "not_carried_over": [vars(each) for each in diagnosis.not_carried_over],
        "drift": [
            vars(each) | {"joint": each.joint + 1, "by_run": dict(each.by_run)}
            for each in diagnosis.drift
        ],
        "episodes": [vars(each) for each in diagnosis.episodes],
        "positions": [position_entry(run) for run in diagnosis.positions],
        "simulation": loop_values(diagnosis.closed_loop, diagnosis.recordings.prismatic),
        "detection_limits": [
            {"effect": limit.effect.name, "state": _name_state(limit.effect)}
            | pick(limit, "joint", "parameter", "value", "unit")
            for limit in diagnosis.detection_limits
        ],
        "modes": [vars(mode) for mode in diagnosis.modes],
        "outside": None
        if diagnosis.unexplained is None
        else _unexplained_entry(diagnosis.unexplained),
        "laws": [_law_entry(each) for each in diagnosis.laws],
        "lawless": [
            {name: value for name, value in vars(each).items() if name != "tables"}
            for each in diagnosis.lawless
        ],
        **pick(diagnosis, "next_experiment", "stopped"),
        "assumptions": list(diagnosis.assumptions),
        "doubts": [doubt.as_dict() for doubt in diagnosis.doubts],
        "runs": [
            {"run": proof.run.name, "role": proof.run.role}
            | pick(proof, "nrmse_before", "nrmse_after")
            for proof in diagnosis.held_out
        ],
        "faults": [
            {"run": run} | pick(fault, "signal", "joint", "kind", "detail", "left_out")
            for run, fault in diagnosis.faults
        ],
    }
    found: dict[str, Any] = to_json_types(document)
    return found


def written_laws(diagnosis: Diagnosis) -> list[WrittenLaw]:
    """Return the laws among the findings with their amplitudes and reported values."""
    found: list[WrittenLaw] = []
    for finding in diagnosis.findings:
        law = law_of(finding.effect)
        if law is not None:
            values = {p.name: (p.value, p.sd) for p in finding.parameters}
            own = law.with_shapes(finding.located.shapes)
            found.append((finding.effect.name, own, finding.estimated.amplitudes, values))
    return found


def _name_state(effect: Effect) -> str | None:
    """Return "after" for a change between two states; None for what acts in all runs."""
    return "after" if effect.only_in else None


def _finding_entry(statement: Statement, constants: RobotConstants) -> dict[str, Any]:
    finding = statement.finding
    return {
        "effect": finding.effect.name,
        "state": _name_state(finding.effect),
        **pick(finding, "joint", "probability", "certainty"),
        "statement": statement.sentence,
        "to_do": statement.action,
        "equation": finding.effect.equation,
        "parameters": {
            p.name: pick(p, "value", "sd", "unit", "determined") for p in finding.parameters
        },
        **pick(finding, "where", "link"),
        "run": finding.located.run,
        **pick(finding, "variance_explained", "channel", "held_out_ratio"),
        "size": None if finding.size is None else pick(finding.size, "value", "sd", "unit"),
        "confused_with": [
            _rival_entry(rival, constants)
            for rival in finding.rivals
            if rival.probability >= MIN_LISTED_PROBABILITY
        ],
    }


def _law_entry(found: FoundLaw) -> dict[str, Any]:
    return {
        "effect": found.located.effect.name,
        "joint": found.law.joint + 1,
        "channel": found.channel,
        "equation": found.law.equation,
        "signals": [factor.source.symbol for factor in found.law.factors],
        "forms": [factor.form for factor in found.law.factors],
        **pick(found, "explained", "attainable"),
        "laws_tried": found.tried,
        "log_evidence": found.evidence,
    }


def _rival_entry(rival: Rival, constants: RobotConstants) -> dict[str, Any]:
    located: LocatedEffect = rival.located
    return {
        "effect": located.effect.name,
        "joint": None if located.joint is None else located.joint + 1,
        "link": None if located.link is None else constants.links[located.link],
        "run": located.run,
        "probability": rival.probability,
    }


def _fit_entry(diagnosis: Diagnosis, role: str) -> dict[str, float] | None:
    if not diagnosis.proofs(role):
        return None
    before, after = diagnosis.nrmse(role)
    return {"nrmse_before": before, "nrmse_after": after}


def _share_entry(share: MismatchShare) -> dict[str, Any]:
    """Return the entry of a part of the mismatch; "open" is the unexplained one."""
    part = share.part
    return {
        "part": "open" if part is None else part.kind,
        "effects": [] if part is None else sorted({e.effect.name for e in part.effects}),
        "joints": []
        if part is None
        else sorted({e.joint + 1 for e in part.effects if e.joint is not None}),
        **pick(share, "measured", "share"),
    }


def _rigid_entry(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Return the entry of the re-identified rigid model; None if mass tolerances are stated."""
    rigid = diagnosis.search.rigid
    if rigid is None:
        return None
    return {
        "reidentified": rigid.freed,
        "width": max(rigid.widths, default=0.0),
        "widths": list(rigid.widths),
        "gain": rigid.gain,
        "single": None if rigid.single is None else rigid.single.located.label,
        "counterbalances": [
            {
                "joint": each.joint + 1,
                "torque": each.torque,
                "likelier": each.balanced,
                "gain": each.gain if math.isfinite(each.gain) else None,
            }
            for each in rigid.counterweights
        ],
    }


def position_entry(run: PositionRun) -> dict[str, Any]:
    """Return the errors of a simulated run [rad], [m]; of the tool [m]."""
    entry: dict[str, Any] = {"run": run.name, "role": run.role}
    for when in ("before", "after"):
        error = getattr(run, when) - run.measured
        tool = getattr(run, f"tool_{when}")
        entry |= {
            f"rms_{when}": list(np.sqrt(np.nanmean(error**2, axis=0))),
            f"largest_{when}": list(np.nanmax(np.abs(error), axis=0)),
            f"tool_rms_{when}": float(np.sqrt(np.nanmean(tool**2))),
            f"tool_largest_{when}": float(np.nanmax(tool)),
        }
    return entry


def _noise_ceiling_entry(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Return the entry of the noise ceiling and of the signals that the residual depends on."""
    rod = diagnosis.noise_ceiling
    if rod is None:
        return None
    return {
        "explained": rod.explained,
        "channels": [
            {"channel": name, "rms_after": after, "rms_box": box}
            for name, (after, box) in rod.channels.items()
        ],
        "depends_on": [
            {"channel": each.channel, "signal": each.signal, "at": each.at, "mean": each.mean}
            for each in rod.depends
        ],
    }


def _unexplained_entry(unexplained: Unexplained) -> dict[str, Any]:
    return {
        "channels": list(unexplained.channels),
        "regressors": list(unexplained.regressors),
        "gain_heldout": unexplained.gain,
        **pick(unexplained, "period", "ratio", "left", "brief"),
        "tool_force": None if unexplained.tool_force is None else vars(unexplained.tool_force),
        "held_out": None if unexplained.held_out is None else vars(unexplained.held_out),
        "alone": None
        if unexplained.alone is None
        else {"run": unexplained.alone[0], "times_any_other": unexplained.alone[1]},
    }


def _prediction_archive(prediction: Prediction, signals: Signals) -> bytes:
    """Return an .npz archive of predictions, with names and units of the set."""
    columns: dict[str, np.ndarray] = {}
    for kind, values in (
        ("torque", prediction.torque),
        ("link_position", prediction.link_position),
    ):
        names = signals.torque if kind == "torque" else signals.link_position or ()
        columns |= {name: values[:, j] for j, name in enumerate(names) if name}
    if signals.time:
        columns[signals.time] = prediction.stamps
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **signals.as_recorded(columns))
    return stream.getvalue()
