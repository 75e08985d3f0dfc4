"""Lines of progress: not too many, and how long a round of many steps may go on."""

from __future__ import annotations

import time
from collections.abc import Callable


def paced(say: Callable[[str], object], seconds: float = 4.0) -> Callable[[str], object]:
    """Pass on a sentence when the last one is some seconds old: many small steps, few lines."""
    last = time.monotonic()

    def tell(sentence: str) -> None:
        nonlocal last
        if time.monotonic() - last >= seconds:
            last = time.monotonic()
            say(sentence)

    return tell


class Pace:
    """How far a round is, by the time that its steps have taken.

    Parameters
    ----------
    steps : int
        Of the round.
    """

    def __init__(self, steps: int) -> None:
        self._steps, self._begin = steps, time.monotonic()

    def words(self, done: int) -> str:
        """Such as "4 of 12, about 20 s of this round left".

        Parameters
        ----------
        done : int
            Steps that are behind.
        """
        step = f"{done + 1} of {self._steps}"
        if not done:
            return step
        left = (time.monotonic() - self._begin) / done * (self._steps - done)
        return f"{step}, about {left:.0f} s of this round left"
