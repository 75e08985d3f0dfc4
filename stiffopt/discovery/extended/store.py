"""Write extended.toml, the format of `stiffopt.discovery.extended.model`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.discovery.comparison.located_effect import EstimatedEffect
from stiffopt.discovery.extended.model import robot_signature
from stiffopt.discovery.extended.schema import ClosedLoopSection, LeftOpenSection
from stiffopt.discovery.laws.law import Factor, Law, law_of
from stiffopt.discovery.laws.table import ResidualTable, table_of
from stiffopt.discovery.signals import JOINT_SCALES, RobotConstants
from stiffopt.files import SCHEMA, pick
from stiffopt.recording.schema import NominalSection

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis


def extended_text(diagnosis: Diagnosis) -> str:
    """Return the content of extended.toml."""
    recordings, constants = diagnosis.recordings, diagnosis.training.constants
    joints = constants.joints
    spread = {
        id(finding.estimated): {p.name: p.sd for p in finding.parameters}
        for finding in diagnosis.findings
    }
    likely = {id(finding.estimated): finding.probability for finding in diagnosis.findings}
    parts = [
        _format_table(
            "",
            {
                "schema": SCHEMA,
                "kind": "extended",
                "name": recordings.name,
                "joints": list(recordings.joints),
                "links": list(constants.links),
            },
        ),
        _format_table("robot", robot_signature(recordings.robot, recordings.order).model_dump()),
        *nominal_tables(recordings.stated),
        _format_table(
            "scales",
            {name: [float(getattr(joint, name)) for joint in joints] for name in JOINT_SCALES},
        ),
        _format_table(
            "calibration", {str(k): v for k, v in diagnosis.extension.calibration.items() if v}
        ),
        *_format_left_open(diagnosis.left_open),
        *_format_closed_loop(diagnosis.closed_loop),
    ]
    tables = [table for each in diagnosis.lawless for table in each.tables]
    tables += [table for e in diagnosis.extension.effects if (table := table_of(e.effect))]
    parts += [_format_table("[residual]", _describe_table(table)) for table in tables]
    for each in diagnosis.extension.effects:
        if table_of(each.effect) is not None:
            continue
        parts.append(
            _format_effect(each, constants, spread.get(id(each), {}), likely.get(id(each)))
        )
    return "\n".join(parts)


def nominal_tables(stated: NominalSection) -> Iterable[str]:
    """Yield the TOML tables of the stated nominal robot, as in recordings.toml."""
    entries = stated.model_dump(exclude_none=True)
    reducer, balances = entries.pop("reducer", None), entries.pop("counterbalance")
    yield _format_table("nominal", entries)
    if reducer is not None:
        yield _format_table("nominal.reducer", reducer)
    for balance in balances if isinstance(balances, tuple) else (balances,):
        yield _format_table("[nominal.counterbalance]", balance)


def _format_left_open(section: LeftOpenSection) -> Iterable[str]:
    entries = section.model_dump(exclude_none=True)
    tables = {name: entries.pop(name) for name in ("suspects", "leanings")}
    yield _format_table("left_open", entries)
    for name, table in tables.items():
        if table:
            yield _format_table(f"left_open.{name}", table)


def _format_closed_loop(section: ClosedLoopSection | None) -> Iterable[str]:
    if section is None:
        return
    entries = section.model_dump()
    tables = {name: entries.pop(name) for name in ("values", "deviations")}
    yield _format_table("closed_loop", entries)
    for name, table in tables.items():
        yield _format_table(f"closed_loop.{name}", table)


def _format_effect(
    each: EstimatedEffect,
    constants: RobotConstants,
    spread: Mapping[str, float],
    probability: float | None,
) -> str:
    located, effect = each.located, each.located.effect
    head: dict[str, Any] = {"name": effect.name}
    if located.joint is not None:
        head["joint"] = located.joint + 1
    if located.link is not None:
        head["link"] = constants.links[located.link]
    if located.run is not None:
        head["run"] = located.run
    if probability is not None:
        head["probability"] = probability
    if each.step:
        head["step"] = each.step
    law = law_of(effect)
    if law is not None:
        head["law"] = _describe_law(law)
    names = [a.name for a in effect.amplitudes] + [s.name for s in effect.shapes]
    term = dict(zip(names, (*each.amplitudes, *located.shapes), strict=True))
    reported = effect.parameters(each.amplitudes, located.shapes, located.constants(constants))
    parameters = {}
    for name, value in reported.items():
        sd = (
            f", sd = {_format_value(spread[name])}" if np.isfinite(spread.get(name, np.nan)) else ""
        )
        unit = json.dumps(located.unit_of(name, constants))
        parameters[name] = f"{{ value = {_format_value(value)}{sd}, unit = {unit} }}"
    lines = [f"{_format_key(name)} = {text}" for name, text in parameters.items()]
    return (
        _format_table("[effect]", head)
        + _format_table("effect.term", term)
        + "\n".join(["[effect.parameters]", *lines])
        + "\n"
    )


def _describe_law(law: Law) -> dict[str, Any]:
    """Return the entries of a law, as `LawSection` reads them."""
    return {"place": law.place, "factors": [_describe_factor(f) for f in law.factors]}


def _describe_factor(factor: Factor) -> dict[str, Any]:
    entry: dict[str, Any] = {"signal": factor.source.kind, "form": factor.form}
    if factor.source.joint is not None:
        entry["joint"] = factor.source.joint + 1
    return entry | ({"bounds": factor.bounds} if factor.bounds else {})


def _describe_table(table: ResidualTable) -> dict[str, Any]:
    """Return the entries of a table, as `ResidualSection` reads them."""
    return {
        "joint": table.joint + 1,
        "place": table.place,
        "times": [_describe_factor(factor) for factor in table.carrier],
        "signal": _describe_factor(Factor(table.source, "linear")),
        **pick(table, "at", "values"),
    }


def _format_table(name: str, entries: Mapping[str, Any]) -> str:
    head = [f"[{name}]"] if name else []
    return (
        "\n".join(head + [f"{_format_key(k)} = {_format_value(v)}" for k, v in entries.items()])
        + "\n"
    )


def _format_key(name: str) -> str:
    return name if name.replace("_", "").isalnum() and name.isascii() else json.dumps(name)


def _format_value(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_format_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_format_value(each) for each in value) + "]"
    if isinstance(value, int):
        return str(value)
    return repr(float(value))
