"""Text of extended.toml, the format of `stiffopt.discovery.extended.model`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.discovery.comparison.located_effect import EstimatedEffect
from stiffopt.discovery.extended.made_for import made_for
from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.discovery.signals import RobotConstants
from stiffopt.recording.schema import NominalSection

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis


def extended_text(diagnosis: Diagnosis) -> str:
    """Content of extended.toml."""
    recordings, constants = diagnosis.recordings, diagnosis.training.constants
    joints = constants.joints
    spread = {
        id(finding.estimated): {p.name: p.sd for p in finding.parameters}
        for finding in diagnosis.findings
    }
    likely = {id(finding.estimated): finding.probability for finding in diagnosis.findings}
    parts = [
        _table(
            "",
            {
                "schema": 1,
                "kind": "extended",
                "name": recordings.name,
                "joints": list(recordings.joints),
                "links": list(constants.links),
            },
        ),
        _table("robot", made_for(recordings.robot, recordings.order).model_dump()),
        *nominal_tables(recordings.stated),
        _table(
            "scales",
            {
                name: [float(getattr(joint, name)) for joint in joints]
                for name in ("torque_rated", "torque_max", "fastest")
            },
        ),
        _table("calibration", {k: v for k, v in diagnosis.extension.calibration.items() if v}),
        *_left_open(diagnosis.left_open),
    ]
    for each in diagnosis.extension.effects:
        parts.append(_effect(each, constants, spread.get(id(each), {}), likely.get(id(each))))
    return "\n".join(parts)


def nominal_tables(stated: NominalSection) -> Iterable[str]:
    """Tables of what a set states of the nominal robot, as the set itself has them."""
    entries = stated.model_dump(exclude_none=True)
    reducer, balances = entries.pop("reducer", None), entries.pop("counterbalance")
    yield _table("nominal", entries)
    if reducer is not None:
        yield _table("nominal.reducer", reducer)
    for balance in balances if isinstance(balances, tuple) else (balances,):
        yield _table("[nominal.counterbalance]", balance)


def _left_open(section: LeftOpenSection) -> Iterable[str]:
    entries = section.model_dump(exclude_none=True)
    tables = {name: entries.pop(name) for name in ("suspects", "leanings")}
    yield _table("left_open", entries)
    for name, table in tables.items():
        if table:
            yield _table(f"left_open.{name}", table)


def _effect(
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
    names = [a.name for a in effect.amplitudes] + [s.name for s in effect.shapes]
    term = dict(zip(names, (*each.amplitudes, *located.shapes), strict=True))
    reported = effect.parameters(each.amplitudes, located.shapes, located.constants(constants))
    parameters = {}
    for name, value in reported.items():
        sd = f", sd = {_value(spread[name])}" if np.isfinite(spread.get(name, np.nan)) else ""
        unit = json.dumps(located.unit_of(name, constants))
        parameters[name] = f"{{ value = {_value(value)}{sd}, unit = {unit} }}"
    lines = [f"{_key(name)} = {text}" for name, text in parameters.items()]
    return (
        _table("[effect]", head)
        + _table("effect.term", term)
        + "\n".join(["[effect.parameters]", *lines])
        + "\n"
    )


def _table(name: str, entries: Mapping[str, Any]) -> str:
    head = [f"[{name}]"] if name else []
    return "\n".join(head + [f"{_key(k)} = {_value(v)}" for k, v in entries.items()]) + "\n"


def _key(name: str) -> str:
    return name if name.replace("_", "").isalnum() and name.isascii() else json.dumps(name)


def _value(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(each) for each in value) + "]"
    if isinstance(value, int):
        return str(value)
    return repr(float(value))
