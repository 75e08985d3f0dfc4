"""Provenance of a result: hash of all inputs, and package versions."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import platform
from collections import OrderedDict
from importlib.metadata import version
from typing import Any

import numpy as np

from stiffopt.drivetrain.chain import Chain


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that determine the numbers."""
    return dict(_package_versions())


@functools.cache
def _package_versions() -> tuple[tuple[str, str], ...]:
    packages = ("stiffopt", "casadi", "pin", "numpy", "toppra", "scipy")
    return ("python", platform.python_version()), *((name, version(name)) for name in packages)


def inputs_hash(problem: object) -> str:
    """SHA-256 of all inputs of a result; equal inputs give equal hashes."""
    document = json.dumps(_plain_data(problem), sort_keys=True)
    return hashlib.sha256(document.encode()).hexdigest()


# Plain data by identity of the drivetrain, as 1 and 1.0 are equal but written differently. Robots
# with other payloads share drivetrains.
_plain_chains: OrderedDict[int, tuple[Chain, object]] = OrderedDict()


@functools.cache
def _compared_fields(kind: Any) -> tuple[str, ...]:
    """Compared fields of a dataclass; others, such as paths, are no inputs."""
    return tuple(f.name for f in dataclasses.fields(kind) if f.compare)


def _plain_data(value: object) -> object:
    """Convert dataclasses, arrays and rigid-body models to nested plain data."""
    if isinstance(value, Chain):
        if id(value) not in _plain_chains:
            _plain_chains[id(value)] = value, _plain_fields(value)
        while len(_plain_chains) > 64:
            _plain_chains.popitem(last=False)
        return _plain_chains[id(value)][1]
    if isinstance(value, float):
        return repr(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain_fields(value)
    if isinstance(value, np.ndarray):
        return [repr(x) for x in value.ravel().tolist()]
    if isinstance(value, dict):
        return {str(k): _plain_data(v) for k, v in sorted(value.items(), key=lambda kv: str(kv[0]))}
    if isinstance(value, list | tuple):
        return [_plain_data(v) for v in value]
    if type(value).__module__.startswith("pinocchio"):
        return _plain_model(value)
    return str(value)


def _plain_fields(value: object) -> dict[str, object]:
    kind: Any = type(value)
    own = {name: _plain_data(getattr(value, name)) for name in _compared_fields(kind)}
    return {"class": kind.__name__, **own}


def _plain_model(model: Any) -> object:
    """Placements and inertias of a model, without names and file paths."""
    if not hasattr(model, "jointPlacements"):
        return str(model)
    placements = [_plain_data(np.asarray(m.homogeneous)) for m in model.jointPlacements]
    inertias = [_plain_data(np.asarray(i.matrix())) for i in model.inertias]
    return {"placements": placements, "inertias": inertias}
