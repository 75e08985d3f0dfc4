"""Who takes Ctrl-C: while something short is done that a long answer needs, or a solve runs."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

Answer = TypeVar("Answer")


@dataclass
class _Preparing:
    """What Ctrl-C did before an answer is prepared, and whether it came meanwhile."""

    until: Any = None
    stopped: bool = False


_preparing = _Preparing()


@contextmanager
def handled(handler: Callable[..., object] | signal.Handlers) -> Iterator[None]:
    """Ctrl-C goes to a handler; only the main thread can take signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def beginning() -> Iterator[None]:
    """While an answer is prepared: the first Ctrl-C waits for something to keep (`delivered`).

    A second one ends it at once. Within another one it is the same as that.
    """
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN or _preparing.until is not None:
        yield
        return

    def wait(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        _preparing.stopped = True
        print(
            "stiffopt: stops once there is a motion to keep; Ctrl-C again ends it now.",
            file=sys.stderr,
        )

    with handled(wait):
        _preparing.until, _preparing.stopped = before, False
        try:
            yield
        finally:
            _preparing.until, _preparing.stopped = None, False


def delivered(*, ended: bool = False) -> None:
    """There is something to keep: from here on Ctrl-C interrupts, one that waited does now.

    Where the answer has `ended`, it was too late.
    """
    if _preparing.until is not None:
        signal.signal(signal.SIGINT, _preparing.until)
        _preparing.until = None
    stopped, _preparing.stopped = _preparing.stopped, False
    if stopped and not ended:
        raise KeyboardInterrupt


@contextmanager
def finishing() -> Iterator[None]:
    """While an answer that took long is written: the first Ctrl-C waits, a second one ends it."""
    before = signal.getsignal(signal.SIGINT)

    def wait(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        print(
            "stiffopt: the answer is being written; Ctrl-C again throws it away.", file=sys.stderr
        )

    with handled(wait):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C waits until something short is done, and is then too late."""
    with handled(signal.SIG_IGN):
        yield


def finished(step: Callable[[], Answer]) -> tuple[Answer, bool]:
    """What a short step answers that none can do without, and whether Ctrl-C came meanwhile.

    It is done anew then, and a further Ctrl-C throws nothing away.
    """
    try:
        return step(), False
    except KeyboardInterrupt:
        with uninterrupted():
            return step(), True
