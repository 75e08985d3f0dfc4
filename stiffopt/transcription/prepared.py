"""Prepared functions in a file: what the formulas of a solve are, a next solve does not find again.

They depend on the formulas alone: payload, duration, poses and limits are numbers beside them.

A function in a file is code: CasADi would load libraries that it names. Files are therefore signed
with a key of the user, and those without this signature, such as of another user, are not read.
"""

from __future__ import annotations

import hashlib
import hmac
import io
import json
import os
import secrets
from contextlib import suppress
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
# Bytes of a SHA-256 signature, and of the key.
_SIGNATURE_SIZE = 32


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
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **{_INDEX_NAME: np.array(json.dumps(index))}, **arrays)
    if (key := _user_key()) is not None:
        # Readers of zip files ignore what follows the archive.
        path.write_bytes(content.getvalue() + _sign(key, content.getvalue()))


def read_prepared(path: Path) -> None:
    """Take what `write_prepared` has written; nothing of another user, version or damaged file."""
    try:
        content, key = path.read_bytes(), _user_key()
        content, signature = content[:-_SIGNATURE_SIZE], content[-_SIGNATURE_SIZE:]
        if key is None or not hmac.compare_digest(signature, _sign(key, content)):
            return
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
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


def _sign(key: bytes, content: bytes) -> bytes:
    return hmac.digest(key, content, "sha256")


def _user_key() -> bytes | None:
    """Return the user's key, made at first use; None where the user's cache cannot be used."""
    with suppress(OSError, RuntimeError):
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stiffopt"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        path = folder / "key"
        if not path.exists():
            own = folder / f"key-{secrets.token_hex(8)}"
            own.touch(mode=0o600)
            own.write_bytes(secrets.token_bytes(_SIGNATURE_SIZE))
            # Whole at once, and the first of several processes wins.
            with suppress(FileExistsError):
                os.link(own, path)
            own.unlink()
        found = path.read_bytes()
        return found if len(found) == _SIGNATURE_SIZE else None
    return None


def _hash_source() -> str:
    """Return a hash of the code that prepares functions."""
    found = hashlib.sha256(ca.CasadiMeta.version().encode())
    for module in (batched, node_derivatives, point_function):
        found.update(Path(str(module.__file__)).read_bytes())
    return found.hexdigest()
