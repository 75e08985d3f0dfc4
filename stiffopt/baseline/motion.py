"""What a baseline hands back: a motion, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass

from stiffopt.result.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class BaselineMotion:
    """A motion to compare with.

    Parameters
    ----------
    name : str
        "toppra" or "quintic".
    motion : Trajectory or None
        None where the baseline does not exist; `reason` then says why.
    reason : str
        A sentence, empty where there is a motion.
    fastest : float or None
        Shortest duration on the path under the limits, where it is known. [s]
    """

    name: str
    motion: Trajectory | None
    reason: str = ""
    fastest: float | None = None
