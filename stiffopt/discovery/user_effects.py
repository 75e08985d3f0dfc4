"""Effects from a user's own Python file, beside those of the catalogue."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import inspect
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.soundness import faults
from stiffopt.errors import InputFileError

_HOW = (
    "A file of effects holds `stiffopt.discovery.effect.Effect` objects at module level, or"
    " functions without arguments that say `-> Effect`."
)


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Effects that a Python file defines, each checked as those of the catalogue are.

    Parameters
    ----------
    path : str or Path
        The file; it is run.

    Returns
    -------
    tuple of Effect
        In the order of the file.

    Raises
    ------
    InputFileError
        The file cannot be run, defines no effect, takes a name twice or one of the catalogue, or
        an effect is not sound: not linear in its amplitudes, not fit for symbols, out of bounds.

    Notes
    -----
    A term takes (signals, amplitudes, shapes) and returns a `Term`; write it with NumPy's
    functions and arithmetic, so that it takes CasADi symbols as well as arrays of samples.
    """
    path = Path(path)
    module = _run(path)
    found = list(_effects(module, path))
    if not found:
        raise InputFileError(path, "", f"no effect is defined here. {_HOW}")
    taken = {entry.name: "the catalogue" for entry in CATALOGUE}
    for where, effect in found:
        if effect.name in taken:
            raise InputFileError(
                path,
                where,
                f"the name {effect.name!r} is taken by {taken[effect.name]}; choose another.",
            )
        taken[effect.name] = where
        _require_sound(path, where, effect)
    return tuple(effect for _, effect in found)


def _run(path: Path) -> ModuleType:
    if not path.is_file():
        raise InputFileError(path, "", "no such file; give the path of a Python file of effects.")
    name = f"stiffopt_user_effects_{path.stem}"
    loader = importlib.machinery.SourceFileLoader(name, str(path))
    spec = importlib.util.spec_from_loader(name, loader)
    if spec is None:
        raise InputFileError(path, "", "this is no Python file.")
    module = importlib.util.module_from_spec(spec)
    # Dataclasses of the file look their module up while it runs.
    sys.modules[name] = module
    try:
        loader.exec_module(module)
    except Exception as error:
        raise InputFileError(
            path, _line(error, path), f"the file cannot be run: {type(error).__name__}: {error}"
        ) from error
    finally:
        sys.modules.pop(name, None)
    return module


def _line(error: Exception, path: Path) -> str:
    """Last line of the file that an error passed, "" where it passed none."""
    trace, line = error.__traceback__, ""
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = f"line {trace.tb_lineno}"
        trace = trace.tb_next
    return line


def _effects(module: ModuleType, path: Path) -> Iterator[tuple[str, Effect]]:
    seen: list[Effect] = []
    for name, value in vars(module).items():
        if name.startswith("_"):
            continue
        for effect in _given(module, path, name, value):
            if any(effect is other for other in seen) or any(effect is e for e in CATALOGUE):
                continue
            seen.append(effect)
            yield name, effect


def _given(module: ModuleType, path: Path, name: str, value: Any) -> Sequence[Effect]:
    """Effects that one module-level name stands for."""
    if isinstance(value, Effect):
        return [value]
    if isinstance(value, list | tuple) and any(isinstance(v, Effect) for v in value):
        return [v for v in value if isinstance(v, Effect)]
    if not inspect.isfunction(value) or value.__module__ != module.__name__:
        return []
    signature = inspect.signature(value)
    if signature.return_annotation not in (Effect, "Effect", "effect.Effect"):
        return []
    if signature.parameters:
        raise InputFileError(
            path, name, f"a function that says `-> Effect` takes no arguments. {_HOW}"
        )
    try:
        made = value()
    except Exception as error:
        raise InputFileError(
            path, name, f"the function fails with {type(error).__name__}: {error}"
        ) from error
    if not isinstance(made, Effect):
        raise InputFileError(path, name, f"it returns a {type(made).__name__}, no Effect. {_HOW}")
    return [made]


def _require_sound(path: Path, where: str, effect: Effect) -> None:
    for fault in faults(effect):
        raise InputFileError(path, where, f"effect {effect.name!r} cannot be used: {fault}")
