"""What a key of a file means: from the declarations, by the key's name or its place."""

from __future__ import annotations

import re
from collections.abc import Iterator
from difflib import get_close_matches

from stiffopt.errors import InputError
from stiffopt.report.file_reference import FileKey, file_keys, file_models

_MAX_PLACES = 12
# Share of letters in common from which on another word is taken for what was meant: "durration" and
# "duration" have 0.94, "shaped_deviation" and "head_friction" 0.62.
_MIN_SPELLING_SIMILARITY = 0.8


def explain_key(key: str) -> Iterator[str]:
    """Lines about every key of that name or place, such as "prepressure" or "motion.duration".

    A word that stands as a value, such as the name of an objective, is found as well.

    Raises
    ------
    InputError
        No file has such a key or value; one that is spelled nearly so is named.
    """
    wanted = key.strip().strip("[]").replace("[[", "").replace("]]", "").replace(" ", "")
    every = [(kind, each) for kind in file_models() for each in file_keys(kind)]
    found = [(kind, each) for kind, each in every if _matches_place(each.place, wanted)]
    if not found:
        found = [(kind, each) for kind, each in every if wanted in _allowed_words(each)]
    if not found:
        names = {each.place.rpartition(".")[2] for _, each in every}
        names |= {choice for _, each in every for choice in _allowed_words(each)}
        close = get_close_matches(
            wanted.rpartition(".")[2], sorted(names), 1, _MIN_SPELLING_SIMILARITY
        )
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise InputError(f"no file has a key or a value {key!r}.{hint}")
    told: dict[tuple[str, str, str, str, str], list[str]] = {}
    for kind, each in found:
        about = (each.value, each.unit, each.plausible, each.default, each.sentence)
        told.setdefault(about, []).append(f"{each.place} ({kind})")
    for number, (about, places) in enumerate(told.items()):
        if number:
            yield ""
        more = f" and {len(places) - _MAX_PLACES} more" if len(places) > _MAX_PLACES else ""
        yield ", ".join(places[:_MAX_PLACES]) + more
        yield from _describe_key(*about)


def _allowed_words(key: FileKey) -> list[str]:
    """Words of which one stands at a key."""
    return re.findall(r'"([^"]+)"', key.value)


def _matches_place(place: str, wanted: str) -> bool:
    bare = place.replace(".NAME", "")
    return bare == wanted or bare.endswith(f".{wanted}") or place.endswith(f".{wanted}")


def _describe_key(
    value: str, unit: str, plausible: str, default: str, sentence: str
) -> Iterator[str]:
    if sentence:
        yield f"  {sentence}"
    yield (
        f"  {value.replace('`', '')}"
        + (f" [{unit}]" if unit else "")
        + (f", plausible {plausible}" if plausible else "")
        + ("; required" if default == "required" else f"; default {default}" if default else "")
    )


__all__ = ["FileKey", "explained"]
