"""Files of people, spoiled: keys, values, rows, arrays and bytes, one seed one file."""

from __future__ import annotations

import copy
import datetime
import io
import json
import math
import random
import tomllib
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np

# What stands where a number, a text or a list is wanted.
_VALUES: tuple[Any, ...] = (
    -1, 0, 1, 2**31, 2**63, 10**400, -1e-300, 1e-300, 1e15, 1e300, math.inf, -math.inf, math.nan,
    True, False, "", " ", "x", "45 deg", "1 mm", "5 m/", "9**9**9 m", "1e400 N", "nan", "\x00", "é",
    "../../etc/passwd", "/dev/zero", "/", "a" * 5000, "none", [], {}, [[]], [0.0], ["x"], {"": 1},
    {"type": "x"}, [{}], [0.0] * 3000, datetime.date(2026, 1, 1), datetime.time(1, 2), -0.0,
)  # fmt: skip


def toml_text(value: Any) -> str:
    """Document as TOML, tables inline."""
    return "".join(f"{_key(key)} = {_inline(each)}\n" for key, each in value.items())


def _key(key: str) -> str:
    return json.dumps(key, ensure_ascii=True)


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=True)
    if isinstance(value, float):
        return repr(value)
    return value.isoformat() if hasattr(value, "isoformat") else str(value)


def _places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place of a document, but the whole."""
    inner = value.items() if isinstance(value, dict) else enumerate(value)
    found = []
    for key, each in inner:
        found.append((*at, key))
        if isinstance(each, dict | list):
            found += _places(each, (*at, key))
    return found


def spoiled_toml(content: bytes, choice: random.Random) -> bytes:
    """A TOML document with one to three entries changed, or with spoiled text."""
    if choice.random() < 0.2:
        return spoiled_text(content, choice)
    document = tomllib.loads(content.decode())
    if not _spoil(document, choice):
        return _nested(document)
    return toml_text(document).encode()


def spoiled_document(content: bytes, choice: random.Random) -> bytes:
    """A JSON document with one to three entries changed, or with spoiled text."""
    if choice.random() < 0.3:
        return spoiled_text(content, choice)
    document = json.loads(content)
    try:
        _spoil(document, choice)
        return json.dumps(document, default=str).encode()
    except RecursionError:  # deeper than this writer goes
        return b"[" * 5000 + b"]" * 5000


def _spoil(document: dict[str, Any], choice: random.Random) -> bool:
    """Change one to three entries; False where the document is nested too deep to write."""
    for _ in range(choice.choice((1, 1, 1, 2, 3))):
        *above, last = choice.choice(_places(document))
        holder = document
        for key in above:
            holder = holder[key]
        how = choice.random()
        if how < 0.15:
            del holder[last]
        elif how < 0.25 and isinstance(holder, dict):
            holder[choice.choice(("", str(last) + "s", "x", "type", "name"))] = holder.pop(last)
        elif how < 0.35 and isinstance(holder, list):
            holder.insert(last, copy.deepcopy(holder[last]))
        elif how < 0.45 and isinstance(holder[last], int | float):
            holder[last] = holder[last] * choice.choice((-1, 1e-6, 1e3, 1e9, 1e30))
        elif how < 0.47:
            for _ in range(choice.choice((30, 3000))):
                holder[last] = [holder[last]]
            return False
        else:
            holder[last] = copy.deepcopy(choice.choice(_VALUES))
        if not document:
            break
    return True


def _nested(document: dict[str, Any]) -> bytes:
    try:
        return toml_text(document).encode()
    except RecursionError:  # deeper than this writer goes
        return b"a = " + b"[" * 3000 + b"]" * 3000


def spoiled_text(content: bytes, choice: random.Random) -> bytes:
    """Lines of a text doubled, lost, joined or swapped, or a few bytes changed."""
    lines = content.splitlines(keepends=True)
    if len(lines) < 2 or choice.random() < 0.3:
        return spoiled_bytes(content, choice)
    k = choice.randrange(len(lines))
    change: Callable[[], Any] = choice.choice(
        (
            lambda: lines.insert(k, lines[k]),
            lambda: lines.pop(k),
            lambda: lines.insert(k, lines.pop(choice.randrange(len(lines)))),
            lambda: lines.__setitem__(k, lines[k].rstrip(b"\r\n")),
            lambda: lines.__setitem__(k, lines[k].replace(b'"', b"", 1)),
            lambda: lines.__setitem__(k, lines[k] * 500),
            lambda: lines.__setitem__(slice(k, None), []),
            lambda: lines.insert(0, b"\xef\xbb\xbf"),
        )
    )
    change()
    return b"".join(lines)


def spoiled_bytes(content: bytes, choice: random.Random) -> bytes:
    """Bytes flipped, cut, put in twice, or set to 0 or 255."""
    data = bytearray(content)
    for _ in range(choice.choice((1, 1, 2, 8))):
        if not data:
            break
        # Headers and trailers hold the sizes.
        size = len(data)
        k = choice.choice((choice.randrange(size), choice.randrange(min(size, 200)),
                           size - 1 - choice.randrange(min(size, 200))))  # fmt: skip
        span = choice.choice((1, 1, 4, 8, 100))
        how = choice.randrange(6)
        if how == 0:
            data[k] ^= 1 << choice.randrange(8)
        elif how == 1:
            del data[k:]
        elif how == 2:
            data[k:k] = data[k : k + span]
        elif how == 3:
            data[k : k + span] = b"\xff" * span
        elif how == 4:
            data[k : k + span] = bytes(span)
        else:
            data[k : k + span] = choice.randbytes(span)
    return bytes(data)


_NUMBERS = (
    "-1", "0", "1e400", "nan", "inf", "", "1,5", "9" * 400, "x", '"', "\x00", "1e-320", "#", "é",
)  # fmt: skip


def spoiled_csv(content: bytes, choice: random.Random) -> bytes:
    """A table with other cells, another delimiter, or spoiled text."""
    if choice.random() < 0.4:
        return spoiled_text(content, choice)
    rows = [line.split(b",") for line in content.splitlines()]
    if choice.random() < 0.2:
        mark = choice.choice((b";", b"\t", b" ", b"|"))
        return b"\n".join(mark.join(row) for row in rows)
    for _ in range(choice.choice((1, 3, 50))):
        row = rows[choice.randrange(min(len(rows), choice.choice((1, 3, 10**6))))]
        k = choice.randrange(len(row))
        if choice.random() < 0.2:
            row[k:] = [b""]
        else:
            row[k] = choice.choice(_NUMBERS).encode()
    return b"\n".join(b",".join(row) for row in rows)


def spoiled_npz(content: bytes, choice: random.Random) -> bytes:
    """An archive of other arrays, with other headers, or with spoiled bytes."""
    if choice.random() < 0.4:
        return spoiled_bytes(content, choice)
    with np.load(io.BytesIO(content)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = choice.choice(list(arrays))
    own = arrays[name]
    others: list[Any] = [
        own[:0], own[:1], own[:-1], own[::-1], own.astype(complex), own.astype(str), own > 0,
        own.astype(np.float16), own.astype(np.int8), own.reshape(-1, 1), own.reshape(1, -1),
        np.array(1.0), np.full(len(own), np.nan), np.full(len(own), np.inf), 1e300 * own,
        1e-300 * own, np.zeros(len(own)), np.repeat(own, 50), np.zeros((2, 3, 4)),
        own.astype("datetime64[ns]"),
        np.zeros(3, dtype=[("a", float)]), np.where(np.arange(len(own)) % 7, own, np.nan),
    ]  # fmt: skip
    how = choice.random()
    if how < 0.6:
        arrays[name] = choice.choice(others)
    elif how < 0.7:
        del arrays[name]
    made = io.BytesIO()
    np.savez_compressed(made, **arrays)
    if how < 0.7:
        return made.getvalue()
    # A header that promises another shape than there is.
    out = io.BytesIO()
    shape = choice.choice(("(10000000000,)", "(-5,)", "(3,)", "(1e9,)", "((),)", "(" * 90, "()"))
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, array in arrays.items():
            text = f"{{'descr': '{choice.choice(('<f8', '|O', '<f8', '<U9', 'x'))}', " \
                   f"'fortran_order': False, 'shape': {shape}, }}"  # fmt: skip
            text = text.ljust(117) + "\n"
            head = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()
            whole = io.BytesIO()
            np.save(whole, array)
            archive.writestr(f"{each}.npy", head if each == name else whole.getvalue())
    return out.getvalue()


_ATTRIBUTES = (
    "", "x", "nan", "inf", "1e308", "-1", "0 0", "0 0 0", "0 0 0 0", "1e400 0 0", "base", "link_1",
    "joint_1", "floating", "planar", "mimic", "spherical", "fixed", "continuous", "9" * 400,
    "\u00e9",
)  # fmt: skip


def spoiled_urdf(content: bytes, choice: random.Random) -> bytes:
    """A URDF with other attributes, elements twice, lost or moved, or with spoiled text."""
    import xml.etree.ElementTree as ET

    if choice.random() < 0.25:
        return spoiled_text(content, choice)
    root = ET.fromstring(content)
    for _ in range(choice.choice((1, 1, 2, 4))):
        every = list(root.iter())
        parents = [each for each in every if len(each)]
        one = choice.choice(every)
        how = choice.random()
        if how < 0.6 and one.attrib:
            one.set(choice.choice(list(one.attrib)), choice.choice(_ATTRIBUTES))
        elif how < 0.7 and parents:
            holder = choice.choice(parents)
            holder.append(copy.deepcopy(choice.choice(list(holder))))
        elif how < 0.8 and parents:
            holder = choice.choice(parents)
            holder.remove(choice.choice(list(holder)))
        elif how < 0.85:
            one.tag = choice.choice(("robot", "joint", "link", "mimic", "x"))
        elif how < 0.9 and parents:
            choice.choice(parents).append(copy.deepcopy(choice.choice(every)))
        elif one.attrib:
            del one.attrib[choice.choice(list(one.attrib))]
    head = choice.choice(("", "<!-- -->", '<?xml version="1.0" encoding="utf-99"?>', "")).encode()
    bomb = b'<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    return (bomb if choice.random() < 0.02 else head) + ET.tostring(root)


def messages_of(arrays: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Joint states of a recorded run as a bridge to JSON writes them."""
    columns = [arrays[name].tolist() for name in ("t", "q1", "q2", "qd1", "qd2", "tau1", "tau2")]
    return [
        {
            "header": {"stamp": {"sec": int(t), "nanosec": round(t % 1 * 1e9)}},
            "name": ["joint1", "joint2"],
            "position": [q1, q2],
            "velocity": [qd1, qd2],
            "effort": [tau1, tau2],
        }
        for t, q1, q2, qd1, qd2, tau1, tau2 in zip(*columns, strict=True)
    ]


def json_messages() -> list[dict[str, Any]]:
    """A few joint states, as `messages_of`."""
    return [
        {
            "header": {"stamp": {"sec": 100 + k // 50, "nanosec": k % 50 * 20_000_000}},
            "name": ["joint1", "joint2"],
            "position": [math.sin(0.1 * k), math.cos(0.1 * k)],
            "velocity": [math.cos(0.1 * k), -math.sin(0.1 * k)],
            "effort": [1.0, 0.1 * k],
        }
        for k in range(60)
    ]


def mcap_of_json(messages: list[Any], step: float = 0.02) -> bytes:
    """MCAP file of joint states in JSON, one every `step` seconds by the log's clock."""
    from mcap.writer import Writer

    out = io.BytesIO()
    writer = Writer(out)
    writer.start()
    schema = writer.register_schema("JointState", "jsonschema", b"{}")
    channel = writer.register_channel("/joint_states", "json", schema)
    for k, message in enumerate(messages):
        data = message if isinstance(message, bytes) else json.dumps(message, default=str).encode()
        now = round(1e9 * step * k)
        writer.add_message(channel, now, data, now)
    writer.finish()
    return out.getvalue()


def spoiled_json(sound: list[dict[str, Any]], step: float, choice: random.Random) -> bytes:
    """MCAP file of JSON messages, some or all of them with one entry changed."""
    messages: list[Any] = copy.deepcopy(sound)
    places = _places(messages[0])
    *above, last = choice.choice(places)
    value = choice.choice((*_VALUES, None))
    share = choice.choice((0.02, 0.5, 1.0))
    for k, message in enumerate(messages):
        if choice.random() > share:
            continue
        holder = message
        for key in above:
            holder = holder[key]
        holder[last] = value
        if choice.random() < 0.05:
            messages[k] = choice.choice((b"", b"[" * 5000, b"null", b"3", b"\xff", b"9" * 5000))
    return mcap_of_json(messages, step)


def spoiled_parquet(content: bytes, choice: random.Random) -> bytes:
    """A table of vectors whose rows are short, empty or none in places, or of another type."""
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    table = parquet.read_table(io.BytesIO(content)).to_pydict()
    name = choice.choice(list(table))
    column = table[name]
    other = choice.choice(
        (None, [], [1.0], ["x"], [None, None], [math.nan, 1.0], [1e300, 1.0], [True, False],
         [[1.0], [2.0]], "x", 1.0, -1, 2**62, {"a": 1.0}, [1.0] * 3000)
    )  # fmt: skip
    share = choice.choice((0.003, 0.5, 1.0))
    table[name] = [other if choice.random() < share else value for value in column]
    if choice.random() < 0.1:
        del table[name]
    out = io.BytesIO()
    try:
        parquet.write_table(arrow.table(table), out)
    except (arrow.ArrowInvalid, arrow.ArrowTypeError, arrow.ArrowNotImplementedError):
        return spoiled_bytes(content, choice)  # a mixture that no such file can hold
    return out.getvalue()


def spoiled_header(content: bytes, choice: random.Random) -> bytes:
    """A header of lines "key,value" with other values, or with spoiled text."""
    if choice.random() < 0.3:
        return spoiled_text(content, choice)
    lines = content.splitlines()
    for _ in range(choice.choice((1, 1, 3))):
        k = choice.randrange(len(lines))
        key, comma, _ = lines[k].partition(b",")
        if comma:
            other = choice.choice((*_NUMBERS, "REAL32", "EXPLIZIT", "7", "1e300"))
            lines[k] = key + comma + other.encode()
        else:
            del lines[k]
    return b"\r\n".join(lines)
