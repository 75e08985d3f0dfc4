"""The header of exported motions: hashes of motion, robot, payload and limits, as comments."""

from __future__ import annotations

import hashlib
import re
from pathlib import PurePath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stiffopt.export.motion import StoredMotion

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
