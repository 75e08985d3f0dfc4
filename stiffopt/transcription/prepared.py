"""Prepared functions in a file: what the formulas of a solve are, a next solve does not find again.

They depend on the formulas alone: payload, duration, poses and limits are numbers beside them.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from zipfile import BadZipFile

import casadi as ca
import numpy as np

from stiffopt.interpreter import batched
from stiffopt.interpreter.batched import Batch
from stiffopt.transcription import node_derivatives, point_function
from stiffopt.transcription.node_derivatives import kept_formulas
from stiffopt.transcription.point_function import kept_batches

# Name of the table of contents among the arrays.
_INDEX_NAME = "index"


def write_prepared(path: Path) -> None:
    """Write all formulas that this process has prepared, and what the compiled core reads."""
    arrays: dict[str, np.ndarray] = {}
    for n, (function, uses, _) in enumerate(kept_formulas.values()):
        arrays[f"function{n}"] = np.frombuffer(function.serialize().encode(), np.uint8)
        arrays[f"uses{n}"] = np.array(uses, dtype=np.int64)
    for n, batches in enumerate(kept_batches.values()):
        for k, batch in enumerate(batches):
            arrays |= {f"{name}{n}_{k}": each for name, each in batch._asdict().items()}
    index = {
        "source": _hash_source(),
        "formulas": [(key, formula) for key, (_, _, formula) in kept_formulas.items()],
        "batches": [(formula, len(batches)) for formula, batches in kept_batches.items()],
    }
    np.savez(path, allow_pickle=False, **{_INDEX_NAME: np.array(json.dumps(index))}, **arrays)


def read_prepared(path: Path) -> None:
    """Take what `write_prepared` has written; nothing of another version or a damaged file."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            index = json.loads(str(arrays[_INDEX_NAME]))
            if index["source"] != _hash_source():
                return
            formulas = {
                key: (
                    ca.Function.deserialize(arrays[f"function{n}"].tobytes().decode()),
                    arrays[f"uses{n}"].tolist(),
                    formula,
                )
                for n, (key, formula) in enumerate(index["formulas"])
            }
            batches = {
                formula: tuple(
                    Batch(*(arrays[f"{name}{n}_{k}"] for name in Batch._fields))
                    for k in range(count)
                )
                for n, (formula, count) in enumerate(index["batches"])
            }
    except (OSError, BadZipFile, KeyError, TypeError, ValueError, RuntimeError):
        return
    kept_formulas.update(formulas)
    kept_batches.update(batches)


def _hash_source() -> str:
    """Return a hash of the code that prepares functions."""
    found = hashlib.sha256(ca.CasadiMeta.version().encode())
    for module in (batched, node_derivatives, point_function):
        found.update(Path(str(module.__file__)).read_bytes())
    return found.hexdigest()
