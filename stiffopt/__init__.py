"""Stiff and true trajectories for industrial robot arms.

    from stiffopt import load_robot, Objective, Target, TrajectoryProblem, solve

Public names are listed in `__init__.pyi` and loaded on first use, so that the import is fast.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, _, _public_names = lazy_loader.attach_stub(__name__, __file__)
__all__ = ["__version__", *_public_names]


def __dir__() -> list[str]:
    return list(__all__)
