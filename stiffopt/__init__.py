"""Stiff and true trajectories for industrial robot arms.

    from stiffopt import load_robot, Objective, Target, TrajectoryProblem, solve

Names are loaded when they are first used, so that importing the package costs next to nothing;
which they are stands in `__init__.pyi`, for type checkers and for this file.
"""

import ast
from importlib import import_module
from pathlib import Path

__version__ = "0.1.0"


def _public() -> dict[str, str]:
    """Module of each public name."""
    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


_PUBLIC = _public()
__all__ = ["__version__", *sorted(_PUBLIC)]


def __getattr__(name: str) -> object:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'stiffopt' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
