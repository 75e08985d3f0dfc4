"""What a key of a file means: from the declarations, by the key's name or its place."""

from __future__ import annotations

from collections.abc import Iterator

from stiffopt.errors import InputError, nearest
from stiffopt.report.file_reference import FileKey, file_keys, file_models

_SHOWN = 12


def explained(key: str) -> Iterator[str]:
    """Lines about every key of that name or place, such as "prepressure" or "motion.duration".

    Raises
    ------
    InputError
        No file has such a key; the nearest one is named.
    """
    wanted = key.strip().strip("[]").replace("[[", "").replace("]]", "").replace(" ", "")
    every = [(kind, each) for kind in file_models() for each in file_keys(kind)]
    found = [(kind, each) for kind, each in every if _fits(each.place, wanted)]
    if not found:
        names = {each.place.rpartition(".")[2] for _, each in every}
        close = nearest(wanted.rpartition(".")[2], names).partition(" Allowed")[0]
        hint = close if close.startswith("Did") else ""
        raise InputError(f"no key {key!r} in any file. {hint}".strip())
    told: dict[tuple[str, str, str, str, str], list[str]] = {}
    for kind, each in found:
        about = (each.value, each.unit, each.plausible, each.default, each.sentence)
        told.setdefault(about, []).append(f"{each.place} ({kind})")
    for number, (about, places) in enumerate(told.items()):
        if number:
            yield ""
        more = f" and {len(places) - _SHOWN} more" if len(places) > _SHOWN else ""
        yield ", ".join(places[:_SHOWN]) + more
        yield from _about(*about)


def _fits(place: str, wanted: str) -> bool:
    bare = place.replace(".NAME", "")
    return bare == wanted or bare.endswith(f".{wanted}") or place.endswith(f".{wanted}")


def _about(value: str, unit: str, plausible: str, default: str, sentence: str) -> Iterator[str]:
    if sentence:
        yield f"  {sentence}"
    yield (
        f"  {value.replace('`', '')}"
        + (f" [{unit}]" if unit else "")
        + (f", plausible {plausible}" if plausible else "")
        + ("; required" if default == "required" else f"; default {default}" if default else "")
    )


__all__ = ["FileKey", "explained"]
