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
class _DeferredInterrupt:
    """What Ctrl-C did before an answer is prepared, and whether it came meanwhile."""

    until: Any = None
    stopped: bool = False


_deferred = _DeferredInterrupt()


@contextmanager
def handle_interrupts(handler: Callable[..., object] | signal.Handlers) -> Iterator[None]:
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
def defer_until_result() -> Iterator[None]:
    """While an answer is prepared: the first Ctrl-C waits for something to keep (`delivered`).

    A second one ends it at once. Within another one it is the same as that.
    """
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN or _deferred.until is not None:
        yield
        return

    def wait(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        _deferred.stopped = True
        print(
            "stiffopt: stops once there is a motion to keep; Ctrl-C again ends it now.",
            file=sys.stderr,
        )

    with handle_interrupts(wait):
        _deferred.until, _deferred.stopped = before, False
        try:
            yield
        finally:
            _deferred.until, _deferred.stopped = None, False


def end_deferral(*, ended: bool = False) -> None:
    """There is something to keep: from here on Ctrl-C interrupts, one that waited does now.

    Where the answer has `ended`, it was too late.
    """
    if _deferred.until is not None:
        signal.signal(signal.SIGINT, _deferred.until)
        _deferred.until = None
    stopped, _deferred.stopped = _deferred.stopped, False
    if stopped and not ended:
        raise KeyboardInterrupt


@contextmanager
def defer_while_writing() -> Iterator[None]:
    """While an answer that took long is written: the first Ctrl-C waits, a second one ends it."""
    before = signal.getsignal(signal.SIGINT)

    def wait(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        print(
            "stiffopt: the answer is being written; Ctrl-C again throws it away.", file=sys.stderr
        )

    with handle_interrupts(wait):
        yield


@contextmanager
def ignore_interrupts() -> Iterator[None]:
    """Ctrl-C waits until something short is done, and is then too late."""
    with handle_interrupts(signal.SIG_IGN):
        yield


def complete_step(step: Callable[[], Answer]) -> tuple[Answer, bool]:
    """What a short step answers that none can do without, and whether Ctrl-C came meanwhile.

    It is done anew then, and a further Ctrl-C throws nothing away.
    """
    try:
        return step(), False
    except KeyboardInterrupt:
        with ignore_interrupts():
            return step(), True
