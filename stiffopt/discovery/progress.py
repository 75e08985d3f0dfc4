"""Progress lines: repeated in long steps, limited in number, with the time that remains."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# Called with a sentence at every step.
Say = Callable[[str], object]

# Silence after which the last progress line is repeated [s].
_MAX_SILENCE = 4.0


@contextmanager
def repeat_progress(say: Say | None, quiet: float = _MAX_SILENCE) -> Iterator[Say]:
    """Pass sentences on; repeat the last one with its elapsed time after a silence.

    `say`: called with a sentence; repeated ones come from another thread. `quiet`: silence before a
    repetition [s].
    """
    if say is None:
        yield lambda _: None
        return
    last, begin, spoken = "", time.monotonic(), time.monotonic()
    done, one_at_a_time = threading.Event(), threading.Lock()

    def pass_on(sentence: str) -> None:
        nonlocal last, begin, spoken
        with one_at_a_time:
            last, begin = sentence, time.monotonic()
            spoken = begin
            say(sentence)

    def go_on() -> None:
        nonlocal spoken
        while not done.wait(quiet / 8.0):
            with one_at_a_time:
                now = time.monotonic()
                if now - spoken < quiet or not last or done.is_set():
                    continue
                spoken = now
                try:
                    say(f"running for {now - begin:.0f} s: {last}")
                except (Exception, KeyboardInterrupt):  # the display has been closed
                    return

    beside = threading.Thread(target=go_on, daemon=True)
    beside.start()
    try:
        yield pass_on
    finally:
        done.set()
        beside.join()


def throttle_progress(say: Say, seconds: float = 4.0) -> Say:
    """Return a function that passes on a sentence if the last one is some seconds old."""
    last = time.monotonic()

    def tell(sentence: str) -> None:
        nonlocal last
        if time.monotonic() - last >= seconds:
            last = time.monotonic()
            say(sentence)

    return tell


class RoundProgress:
    """Estimate the remaining time of a round from the time of its finished steps.

    `steps`: number of steps of the round.
    """

    def __init__(self, steps: int) -> None:
        self._steps, self._begin = steps, time.monotonic()

    def words(self, done: int) -> str:
        """Return text such as "4 of 12, about 20 s of this round left".

        `done`: number of finished steps.
        """
        step = f"{done + 1} of {self._steps}"
        if not done:
            return step
        left = (time.monotonic() - self._begin) / done * (self._steps - done)
        return f"{step}, about {left:.0f} s of this round left"
