"""What a result was made from: a hash of all inputs, and the versions of the packages."""

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
    """Versions of what decides the numbers."""
    return dict(_versions())


@functools.cache
def _versions() -> tuple[tuple[str, str], ...]:
    packages = ("stiffopt", "casadi", "pin", "numpy", "toppra", "scipy")
    return ("python", platform.python_version()), *((name, version(name)) for name in packages)


def inputs_hash(problem: object) -> str:
    """SHA-256 over everything that the result depends on; equal inputs give equal hashes."""
    document = json.dumps(_plain(problem), sort_keys=True)
    return hashlib.sha256(document.encode()).hexdigest()


# Drivetrains by what they are, not by what they equal: 1 and 1.0 are not written alike. Robots with
# other payloads share them.
_chains: OrderedDict[int, tuple[Chain, object]] = OrderedDict()
_KEPT = 64


@functools.cache
def _compared(kind: Any) -> tuple[str, ...]:
    """Fields of a dataclass; what takes no part in comparisons, as a path, is no input."""
    return tuple(f.name for f in dataclasses.fields(kind) if f.compare)


def _plain(value: object) -> object:
    """Nested plain data of dataclasses, arrays and rigid-body models."""
    if isinstance(value, Chain):
        if id(value) not in _chains:
            _chains[id(value)] = value, _fields(value)
        while len(_chains) > _KEPT:
            _chains.popitem(last=False)
        return _chains[id(value)][1]
    if isinstance(value, float):
        return repr(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _fields(value)
    if isinstance(value, np.ndarray):
        return [repr(x) for x in value.ravel().tolist()]
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in sorted(value.items(), key=lambda kv: str(kv[0]))}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if type(value).__module__.startswith("pinocchio"):
        return _model(value)
    return str(value)


def _fields(value: object) -> dict[str, object]:
    kind: Any = type(value)
    own = {name: _plain(getattr(value, name)) for name in _compared(kind)}
    return {"class": kind.__name__, **own}


def _model(model: Any) -> object:
    """Placements and inertias; names and file paths do not matter."""
    if not hasattr(model, "jointPlacements"):
        return str(model)
    placements = [_plain(np.asarray(m.homogeneous)) for m in model.jointPlacements]
    inertias = [_plain(np.asarray(i.matrix())) for i in model.inertias]
    return {"placements": placements, "inertias": inertias}
