"""Handling of Ctrl-C while a solve runs, or while results are prepared or written."""

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
    """Handler of Ctrl-C to restore after preparation, and whether Ctrl-C was pressed meanwhile."""

    until: Any = None
    stopped: bool = False


_deferred = _DeferredInterrupt()


@contextmanager
def handle_interrupts(handler: Callable[..., object] | signal.Handlers) -> Iterator[None]:
    """Send Ctrl-C to a handler; without effect outside the main thread."""
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
    """Defer the first Ctrl-C until a first result exists (`end_deferral`).

    A second one interrupts immediately. Nested use has no further effect.
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
    """End the deferral: Ctrl-C interrupts from now on, a deferred one immediately.

    A deferred one is dropped where the solve has `ended`.
    """
    if _deferred.until is not None:
        signal.signal(signal.SIGINT, _deferred.until)
        _deferred.until = None
    stopped, _deferred.stopped = _deferred.stopped, False
    if stopped and not ended:
        raise KeyboardInterrupt


@contextmanager
def defer_while_writing() -> Iterator[None]:
    """Defer the first Ctrl-C while results are written; a second one interrupts."""
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
    """Ignore Ctrl-C during a short operation."""
    with handle_interrupts(signal.SIG_IGN):
        yield


def complete_step(step: Callable[[], Answer]) -> tuple[Answer, bool]:
    """Result of a short indispensable step, and whether Ctrl-C was pressed during it.

    An interrupted step is repeated with Ctrl-C ignored.
    """
    try:
        return step(), False
    except KeyboardInterrupt:
        with ignore_interrupts():
            return step(), True


def until_interrupted(work: Callable[[], Answer], kept: Callable[[], Answer]) -> Answer:
    """Return the result of the work; after Ctrl-C the best that is kept."""
    try:
        return work()
    except KeyboardInterrupt:
        return kept()
