"""What every format of an exported motion must answer, and the registry that holds them."""

from __future__ import annotations

import hashlib
import re
from abc import ABC, abstractmethod
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import InputError
from stiffopt.export.motion import SampledMotion, StoredMotion, check_rate
from stiffopt.problem.registry import Registry

if TYPE_CHECKING:
    from stiffopt.export.motion import StoredMotion


class ExportFormat(ABC):
    """A way to hand a motion to others.

    Attributes
    ----------
    name : str
        Of `--to`.
    title : str
        What reads it.
    rate : float
        Where none is given [Hz].
    rate_max : float
        The most that it takes [Hz].
    whole_steps : bool
        Whether it has a fixed cycle: every step is then 1/rate.
    from_rest : bool
        Whether its programs move to the start and stop at the end, so that the motion must begin
        and end at rest.
    """

    name: str
    title: str
    rate: float
    rate_max: float
    whole_steps = False
    from_rest = False

    def export(self, stored: StoredMotion, rate: float | None = None) -> dict[str, str]:
        """Texts of the files by their name.

        Parameters
        ----------
        stored : StoredMotion
        rate : float, optional [Hz]

        Raises
        ------
        InputError
            The rate, the joints or their positions are beyond what the format takes, or the samples
            exceed a limit.
        """
        chosen = self.rate if rate is None else rate
        check_rate(chosen, self.rate_max, self.title)
        self.check(stored, chosen)
        if self.from_rest:
            stored.require_rest(self.title)
        motion = stored.sampled(chosen, whole_steps=self.whole_steps)
        stored.judge(motion)
        texts = {
            name: with_seal(text, seal_entries(stored, self.name, chosen, name), name)
            for name, text in self.files(motion, chosen).items()
        }
        return texts | self.programs(texts)

    def check(self, stored: StoredMotion, rate: float) -> None:  # noqa: B027
        """Raise `InputError` for what the format cannot hold; default: it holds all."""

    @abstractmethod
    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Texts of the files by their name, of a motion sampled at `rate` [Hz]."""

    def programs(self, texts: dict[str, str]) -> dict[str, str]:
        """Texts of programs that send the files, by name; default: none."""
        return {}


FORMATS: Registry[ExportFormat] = Registry("stiffopt.export.formats")


# Lines of KRL sources are of ASCII and below 256 characters: one entry a line.
_ENTRY_PATTERN = re.compile(r"^[#;] stiffopt (\w+): (.*)\n", re.MULTILINE)
# What a comment begins with, by suffix, and the lines that come before it.
_COMMENT_STYLES = {".src": (";", 2)}


def seal_entries(stored: StoredMotion, to: str, rate: float, file: str) -> dict[str, str]:
    """Return what the header of a file says: whose motion it is, and how it was sampled."""
    return {
        "file": file,
        "format": to,
        "of": stored.which,
        "rate": repr(float(rate)),
        **stored.seal,
    }


def with_seal(text: str, entries: dict[str, str], file: str) -> str:
    """Return the text of a file with its header, the hash of all other lines included."""
    mark, before = _COMMENT_STYLES.get(PurePath(file).suffix, ("#", 0))
    # A title may look like an entry: what is hashed is what `read_seal` leaves.
    content = hashlib.sha256(_ENTRY_PATTERN.sub("", text).encode()).hexdigest()
    lines = text.splitlines(keepends=True)
    header = [f"{mark} stiffopt {key}: {value}\n" for key, value in entries.items()]
    header.append(f"{mark} stiffopt content: {content}\n")
    return "".join([*lines[:before], *header, *lines[before:]])


def read_seal(text: str) -> tuple[dict[str, str], str]:
    """Return the entries of a file's header, and its text without them."""
    return dict(reversed(_ENTRY_PATTERN.findall(text))), _ENTRY_PATTERN.sub("", text)


def is_whole(entries: dict[str, str], body: str) -> bool:
    """Return whether the text is that which the header was made for."""
    return entries.get("content") == hashlib.sha256(body.encode()).hexdigest()


def require_six_axes(stored: StoredMotion, owner: str) -> None:
    """Raise `InputError` unless the arm has six joints, all of which turn."""
    slides = int(np.sum(stored.prismatic))
    if len(stored.joint_names) != 6 or slides:
        those = f", {slides} of them sliding" if slides else ""
        raise InputError(
            f"{owner} moves arms of 6 turning joints; this motion has "
            f"{len(stored.joint_names)} joints{those}. Export it with --to ros2 or csv."
        )


def require_cycle(rate: float, fastest: float, owner: str) -> None:
    """Raise `InputError` unless the step 1/rate is a whole number of the controller's cycles."""
    cycles = fastest / rate
    if abs(cycles - round(cycles)) > 1e-6 * cycles:
        allowed = ", ".join(f"{fastest / k:g}" for k in (1, 2, 4, 5))
        raise InputError(
            f"--rate {rate:g} Hz: {owner} has a cycle of {1e3 / fastest:g} ms, so the rate must be "
            f"{fastest:g} Hz over a whole number, such as {allowed}."
        )
