"""Files written anew by grammar, or sound ones in extreme forms: mutators of another make.

`mutators` changes entries and bytes of sound files; here structure, encodings and numbers are made
extreme: deep nesting, long tokens, repeated keys, other encodings and line ends, special files,
denormal and huge numbers, digits of other scripts, sections in another order.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import shutil
import socket
import warnings
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.reliability import mutators
from benchmarks.reliability.commands import ROOT
from benchmarks.reliability.subject import Subject
from benchmarks.reliability.subjects import subjects

Mutate = Callable[[bytes, random.Random], bytes]

# Numbers as texts of every format have them, plausible and not.
NUMBERS = (
    "0", "-0.0", "1e-310", "5e-324", "2.2e-308", "1e308", "-1.7e308", "1e-30", "1e30", "1_000",
    "+5", ".5", "5.", "0x1F", "0b1", "1e+400", "-1e-400", "NaN", "-nan", "Infinity", "-inf", "1,5",
    "1.5.2", "1e5e5", "１２３", "٣٫١٤", "१२", "½", "Ⅷ", "1e-9", "1e9", "12345678901234567890123456",
    "0." + "0" * 5000 + "1", "9" * 5000 + ".0", "1" * 200_000, "1." + "3" * 200_000, "true", "null",
    "'1'", "1 ", "\t1", "1\u00a0000", "−1", "1e", "--1", "1d3", "1f", "$1", "=1+1", "1%", "1°",
)  # fmt: skip
_TOML_NUMBERS = (
    "0", "-1", "1e-310", "5e-324", "1e308", "-1.7e308", "1e-30", "1e30", "1_000", "+5", "0x1F",
    "nan", "-inf", "inf", "1e-9", "1e9", "9223372036854775807", "-0.0", "1e-3", "1e3", "0.999", "2",
    "100", "true", '"1 m"', '"1 deg"', '"1e-9 s"', "1979-05-27", "[1, 2]", "{}",
)  # fmt: skip
TOKENS = (
    "a" * 100_000, " " * 100_000, "\\" * 5000, '"' * 5000, "((((" * 5000, "[" * 50_000,
    "{" * 50_000, "." * 50_000, "a." * 30_000 + "a", "-" * 50_000, "1 " * 50_000, "%s%n" * 100,
    "../" * 2000 + "etc", "/dev/stdin", "/proc/self/mem", "fifo", "loop", ".", "..", "~", "\x1b[2J",
    "\ud7ff", "\U0010ffff", "\u202e", "\ufeff", "\x85", "\u2028", "\x00", "\x7f", "a\rb", "a\nb",
    "1 m" + " " * 50_000 + "x", "5 " + "m" * 5000, "5 m*" * 5000, "9**9**9 m", "1 m^" + "9" * 50,
    "5 \u00b5m", "5 \u212b", "5 °", "nan m", "inf s", "1e999 kg", "-0 rad", "5 m s", "5 furlong",
)  # fmt: skip


def in_another_form(content: bytes, choice: random.Random) -> bytes:
    """The same bytes in another encoding, with other line ends, or with marks among them."""
    text = content.decode(errors="replace")
    forms: tuple[Callable[[], bytes], ...] = (
        lambda: text.encode("utf-16"),
        lambda: text.encode("utf-16-le"),
        lambda: text.encode("utf-32"),
        lambda: b"\xef\xbb\xbf" + content,
        lambda: b"\xef\xbb\xbf" * 2 + content,
        lambda: text.replace("\n", "\r\n").encode(),
        lambda: text.replace("\n", "\r").encode(),
        lambda: text.replace("\n", "\x85").encode(),
        lambda: text.replace("\n", "\u2028").encode(),
        lambda: text.replace(" ", "\u00a0").encode(),
        lambda: text.replace(" ", "\t").encode(),
        lambda: text.replace('"', "\u201c").encode(),
        lambda: text.replace("\n", "").encode(),
        lambda: text.replace("e", "\u0435").encode(),
        lambda: text.encode("latin-1", "replace") + b"\xe9",
        lambda: content + b"\x1a",
        lambda: content + bytes(4096),
        lambda: content * choice.choice((2, 3, 200)),
        lambda: content[::-1],
        lambda: b"",
        lambda: b"\n" * 100_000,
        lambda: b" " * 1_000_000,
        lambda: content + b"#" * 1_000_000,
        lambda: text.upper().encode(),
        lambda: b"\x1f\x8b\x08\x00" + content,
        lambda: b"PK\x03\x04" + content,
    )
    return choice.choice(forms)()


def toml_by_grammar(content: bytes, choice: random.Random) -> bytes:
    """A TOML text whose values, keys and sections are put in extreme forms line by line."""
    lines = content.decode().splitlines()
    for _ in range(choice.choice((1, 1, 2, 4))):
        keyed = [k for k, line in enumerate(lines) if re.match(r"\s*[\w\".-]+\s*=", line)]
        if not keyed:
            break
        k = choice.choice(keyed)
        if choice.random() < 0.2:
            lines = _restructured(lines, k, choice)
        elif choice.random() < 0.4:
            lines[k] = _with_number(lines[k], choice)
        else:
            lines[k] = _extreme_entry(lines[k], choice)
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _extreme_entry(line: str, choice: random.Random) -> str:
    """A key with a long, deep, repeated or mixed value, or with a strange name."""
    key, _, value = line.partition("=")
    value = value[:1000]  # of one that is long already, not fifty thousand
    flat, deep = choice.choice((5, 39, 41, 500, 50_000)), choice.choice((5, 39, 41, 2000))
    strange = choice.choice(("a", "\\u0000", "é", "x" * 9000))
    return choice.choice(
        (
            f"{key}= {_quoted(choice.choice(TOKENS))}",
            f"{key}= {_quoted(choice.choice(TOKENS))}",
            f"{key}= " + "[" * flat + value + "]" * flat,
            f"{key}= " + "{ a = " * deep + value + " }" * deep,
            f'"{key.strip()}"."{strange}" ={value}',
            f"{key}= [" + f"{value}," * choice.choice((2, 300, 50_000)) + "]",
            f"{key}= {{ joints ={value}, position ={value}, x = [[[]]] }}",
        )
    )


def _restructured(lines: list[str], k: int, choice: random.Random) -> list[str]:
    """Lines with a key twice, many further keys, or sections renamed or in another order."""
    heads = [number for number, line in enumerate(lines) if line.startswith("[")]
    how = choice.randrange(4)
    if how == 0:
        return [*lines[:k], lines[k], *lines[k:]]
    if how == 1 or not heads:
        return lines + [f"k{i} = {i}" for i in range(choice.choice((1, 20_000)))]
    if how == 2:
        return _swapped(lines, heads, choice)
    head = choice.choice(heads)
    form = choice.choice(("[[{0}]]", "[{0}.{0}]", "[{0}]\n[{0}]", "[ {0} ]"))
    return [*lines[:head], form.format(lines[head].strip("[]")), *lines[head + 1 :]]


def _quoted(token: str) -> str:
    return json.dumps(token, ensure_ascii=False)


def _with_number(line: str, choice: random.Random) -> str:
    """One number of a line, or its value, in another form."""
    places = list(re.finditer(r"(?<![\w.])-?\d+(\.\d+)?(e-?\d+)?", line))
    number = choice.choice(NUMBERS if choice.random() < 0.2 else _TOML_NUMBERS)
    if not places:
        return f"{line.partition('=')[0]}= {number}"
    at = choice.choice(places)
    return line[: at.start()] + number + line[at.end() :]


def _swapped(lines: list[str], heads: list[int], choice: random.Random) -> list[str]:
    """Sections in another order."""
    edges = [0, *heads, len(lines)]
    parts = [lines[a:b] for a, b in pairwise(edges)]
    choice.shuffle(parts)
    return [line for part in parts for line in part]


def urdf_by_grammar(content: bytes, choice: random.Random) -> bytes:
    """A URDF of a chain, a star or a comb of its own, or the sound one with extreme attributes."""
    how = choice.randrange(8)
    if how < 3:
        return _chain(choice).encode()
    text = content.decode()
    if how == 3:
        depth = choice.choice((30, 60, 1000, 100_000))
        part = "<a>" * depth + "</a>" * depth
        return re.sub(r"</link>", part + "</link>", text, count=1).encode()
    if how == 4:
        noise = choice.choice(
            ('<gazebo x="1"/>' * 150_000, "<!-- -->" * 50_000, "<?x y?>" * 1000, "&#65;" * 100_000,
             "<![CDATA[" + "<" * 9999 + "]]>", "&lt;" * 100_000, '<link name="l"/>' * 2000)
        )  # fmt: skip
        return text.replace("</robot>", noise + "</robot>").encode()
    if how == 5:
        head = choice.choice(
            ('<!DOCTYPE r SYSTEM "file:///etc/passwd">', '<!DOCTYPE r [<!ENTITY a SYSTEM "x">]>',
             '<!DOCTYPE r [<!ATTLIST link mass CDATA "1">]>', '<?xml version="1.1"?>',
             '<?xml version="1.0" encoding="utf-16"?>', '<?xml version="1.0" encoding="cp037"?>',
             "<!DOCTYPE r [<!ENTITY % p '%p;'> %p;]>")
        )  # fmt: skip
        return (head + re.sub(r"<\?xml[^>]*>", "", text)).encode()
    places = list(re.finditer(r'="([^"]*)"', text))
    for at in sorted(choice.sample(places, min(3, len(places))), key=lambda m: -m.start()):
        words = at[1].split()
        if words and choice.random() < 0.6:
            words[choice.randrange(len(words))] = choice.choice(NUMBERS)
            own = " ".join(words)
        else:
            own = choice.choice(TOKENS)
        own = own.replace("&", "").replace("<", "").replace('"', "")
        text = text[: at.start(1)] + own + text[at.end(1) :]
    return text.encode("utf-8", "surrogatepass")


def _chain(choice: random.Random) -> str:
    """Links joined one behind the other, from one, or to a spine, with numbers of any size."""
    count = choice.choice((1, 2, 3, 8, 30, 60, 400, 999))
    kinds = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
    kind = choice.choice((*kinds[:3], "any"))
    wild = choice.random() < 0.5
    number = lambda usual: choice.choice(NUMBERS[:14]) if wild and choice.random() < 0.02 else usual  # noqa: E731
    parts = ['<robot name="r"><link name="l0"/>']
    for k in range(1, count + 1):
        parent = choice.choice((k - 1, k - 1, k - 1, 0, choice.randrange(k)))
        own = choice.choice(kinds) if kind == "any" else kind
        parts.append(
            f'<link name="l{k}"><inertial><origin xyz="{number("0")} 0 {number("0.1")}"/>'
            f'<mass value="{number("1")}"/><inertia ixx="{number("0.1")}" ixy="{number("0")}"'
            f' ixz="0" iyy="0.1" iyz="0" izz="{number("0.1")}"/></inertial></link>'
            f'<joint name="j{k}" type="{own}"><origin xyz="{number("0.3")} 0 0"'
            f' rpy="0 0 {number("0")}"/><parent link="l{parent}"/><child link="l{k}"/>'
            f'<axis xyz="{number("0")} 0 {number("1")}"/><limit lower="{number("-3")}"'
            f' upper="{number("3")}" velocity="{number("5")}" effort="{number("40")}"/></joint>'
        )
    return "".join(parts) + "</robot>"


def table_by_grammar(content: bytes, choice: random.Random) -> bytes:
    """A table with another clock, extreme cells, quotes, ragged rows or very many columns."""
    lines = content.decode().splitlines()
    head, rows = lines[0], [line.split(",") for line in lines[1:]]
    how = choice.randrange(6)
    if how < 2:
        _change_clock(rows, choice)
    elif how < 4:
        _change_cells(rows, choice)
    elif how == 4:
        names = head.split(",")
        other = (head * 2000, f"{head},{head}", head.upper(), f'"{head}"', "", f"#{head}",
                 ",".join(names[::-1]), head.replace(",", ";"), "\x00" + head)  # fmt: skip
        head = choice.choice((*other, head + "".join(f",x{i}" for i in range(2000))))
    else:
        k = choice.randrange(len(rows))
        twice = [row for row in rows for _ in range(2)]
        by_last = sorted(rows, key=lambda row: row[-1])
        few = [rows[:number] for number in (0, 1, 2, 19, 20, 21)]
        rows = choice.choice((rows[::-1], by_last, rows * 50, twice, rows[:k] + rows, *few))
    return "\n".join([head, *map(",".join, rows)]).encode("utf-8", "surrogatepass")


def _change_clock(rows: list[list[str]], choice: random.Random) -> None:
    """A clock that jumps, is in another unit, of another epoch, or stands still."""
    k = choice.randrange(len(rows))
    jumps = (1e-3, 1.0, 60.0, 3600.0, 86400.0, 3e7, 1e18, -1.0, 1e-17)
    jump = choice.choice((0.0, *jumps))
    scale, shift = choice.choice(((1, 0), (1e3, 0), (1e9, 1.7e18), (1e-12, 0), (1, 1.7e9), (0, 0)))
    for number, row in enumerate(rows):
        row[0] = repr((float(row[0]) + (jump if number >= k else 0.0)) * scale + shift)


def _change_cells(rows: list[list[str]], choice: random.Random) -> None:
    """Cells, whole columns or ends of rows in extreme forms."""
    how, column = choice.randrange(6), choice.randrange(len(rows[0]))
    if how == 0:
        factor, number = choice.choice((0.0, 1e-300, 1e-20, 1e20, 1e150)), choice.choice(NUMBERS)
        all_one = choice.random() < 0.5
        for row in rows:
            row[column] = number if all_one else repr(float(row[column]) * factor)
    elif how == 1:
        for _ in range(choice.choice((1, 30, 3000))):
            choice.choice(rows)[column] = choice.choice(NUMBERS)
    elif how == 2:
        choice.choice(rows)[column] = choice.choice(TOKENS)
    elif how == 3:
        for row in rows[:: choice.choice((1, 2, 17))]:
            del row[choice.randrange(len(row)) :]
    elif how == 4:
        for row in rows:
            row[:] = [f'"{cell}"' for cell in row]
        choice.choice(rows)[-1] = '"'
    else:
        for row in rows:
            row += ["1"] * 2000


def archive_by_grammar(content: bytes, choice: random.Random) -> bytes:
    """An NPZ whose arrays are put in extreme forms, or whose archive lies about them."""
    with np.load(io.BytesIO(content)) as stored:
        arrays = {name: stored[name] for name in stored.files}
    name = choice.choice(("t", *arrays))
    own, k = arrays[name].astype(float), choice.randrange(len(arrays[name]))
    shifted = own.copy()
    shifted[k:] += choice.choice((1e-3, 60.0, 3e7, 1e18, -5.0))
    forms = (
        shifted, own * 1e-300, own * 1e-12, own * 1e9, own + 1.7e18, own.astype("<f2"), own[:20],
        np.full_like(own, 5e-324), np.linspace(0, 1e-320, len(own)), np.repeat(own, 3),
        own.astype(">f8"), own.astype("longdouble"), np.cumsum(np.full(len(own), 1e300)),
        np.where(np.arange(len(own)) % 2, own, np.inf), np.sort(own)[::-1], own.astype("U"),
        np.array([]), np.array(0.0), own[:, None], np.tile(own, (50, 1)), own.astype("m8[s]"),
        np.ma.masked_array(own), own.astype(">i1"), np.exp(np.linspace(0, 700, len(own))),
    )  # fmt: skip
    arrays[name] = choice.choice(forms)
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    if choice.random() < 0.15:  # members twice, one that unpacks to a gigabyte of zeros, paths
        with zipfile.ZipFile(out, "a", zipfile.ZIP_DEFLATED) as archive:
            member = choice.choice((f"{name}.npy", "../x.npy", "z.npy", f"{name}"))
            warnings.simplefilter("ignore")  # of a name that is there already
            archive.writestr(member, choice.choice((b"", bytes(10**8), b"\x93NUMPY\x09\x09")))
    return out.getvalue()


def json_by_grammar(content: bytes, choice: random.Random) -> bytes:
    """A JSON document on one line, nested, with repeated keys, or with extreme values."""
    how = choice.randrange(9)
    text = content.decode()
    if how == 0:
        return json.dumps([json.loads(text)] * 60).encode()
    if how == 1:
        depth = choice.choice((50, 900, 100_000))
        return ("[" * depth + text + "]" * depth).encode()
    if how == 2:
        depth = choice.choice((50, 900, 100_000))
        return ('{"a":' * depth + text + "}" * depth).encode()
    if how == 3:
        return (text.rstrip().rstrip("}") + ',"x":1' * choice.choice((1, 50_000)) + "}").encode()
    places = list(re.finditer(r"(?<=[:\[,]) *(-?\d[\d.e+-]*|\"[^\"]*\"|null|true|false)", text))
    for at in sorted(choice.sample(places, min(4, len(places))), key=lambda m: -m.start()):
        others = (
            '"\\ud800"',
            '"\\udcff"',
            "{}",
            "[]",
            "[[]]",
            "NaN",
            "-Infinity",
            "1E400",
            "[null]",
        )
        own = choice.choice((*NUMBERS, *map(json.dumps, TOKENS), *others))
        text = text[: at.start()] + own + text[at.end() :]
    return text.encode("utf-8", "surrogatepass")


def mesh_by_grammar(_: bytes, choice: random.Random) -> bytes:
    """An STL, binary or text, or an OBJ under that name, with triangles of any size."""
    count = choice.choice((0, 1, 2, 4, 12, 500))
    rng = np.random.default_rng(choice.randrange(2**32))
    scale = np.array(
        [choice.choice((0.0, 1e-30, 1e-6, 1.0, 1.0, 1.0, 1e3, 1e30)) for _ in range(3)]
    )
    corners = rng.normal(size=(count, 3, 3)) * scale
    if count and choice.random() < 0.3:
        wild = choice.choice((np.nan, np.inf, -np.inf, 1e38, 1e-45))
        corners[rng.random(corners.shape) < choice.choice((0.02, 0.5, 1.0))] = wild
    if count and choice.random() < 0.2:
        corners[:] = corners[:1]
    told = choice.choice((count, count, count, count + 1, 2**31, 2**32 - 1, 0))
    if choice.random() < 0.6:
        facets = [np.concatenate([[0, 0, 1], each.ravel()]).astype("<f4") for each in corners]
        data = b"".join(facet.tobytes() + b"\0\0" for facet in facets)
        data = bytes(80) + told.to_bytes(4, "little") + data
    else:
        rows = ["solid a"]
        for each in corners:
            rows += ["facet normal 0 0 1", "outer loop"]
            rows += ["vertex " + " ".join(repr(float(x)) for x in corner) for corner in each]
            rows += ["endloop", "endfacet"]
        data = "\n".join([*rows, "endsolid a"]).encode()
    return data[: choice.choice((len(data), len(data), len(data) - 7, len(data) // 2))]


def special_file(path: Path, choice: random.Random) -> None:
    """Something that is no regular file, or leads elsewhere, at a path where nothing is."""
    makers: tuple[Callable[[], object], ...] = (
        lambda: os.mkfifo(path),
        lambda: path.symlink_to(path),
        lambda: path.symlink_to("nowhere"),
        lambda: path.symlink_to("/dev/zero"),
        lambda: path.symlink_to("/dev/full"),
        lambda: path.symlink_to("/proc/self/mem"),
        lambda: path.symlink_to("/dev/stdin"),
        path.mkdir,
        lambda: path.symlink_to(path.parent),
        lambda: os.mknod(path) or path.chmod(0),
        lambda: os.truncate(path, 2**40) if os.mknod(path) is None else None,
        lambda: _bind_socket(path),
    )
    choice.choice(makers)()


def _bind_socket(path: Path) -> None:
    here = os.getcwd()
    os.chdir(path.parent)  # names of sockets are short
    try:
        socket.socket(socket.AF_UNIX).bind(path.name)
    finally:
        os.chdir(here)


# The mutator of the other make for each of `mutators`.
_BY_GRAMMAR: dict[str, Mutate] = {
    mutators.spoiled_toml.__name__: toml_by_grammar,
    mutators.spoiled_urdf.__name__: urdf_by_grammar,
    mutators.spoiled_csv.__name__: table_by_grammar,
    mutators.spoiled_npz.__name__: archive_by_grammar,
    mutators.spoiled_document.__name__: json_by_grammar,
}
_ANOTHER_FORM, SPECIAL = 0.15, 0.04  # shares of all mutants


def by_grammar(place: Path) -> list[Subject]:
    """Subjects of all kinds that have a grammar, and meshes, with mutators of this module."""
    found = [s for s in subjects(place) if getattr(s.spoil, "__name__", "") in _BY_GRAMMAR]
    text = [*(replace(s, spoil=_mixed(_BY_GRAMMAR[s.spoil.__name__])) for s in found)]
    return [*text, *_meshed(place)]


def _mixed(mutate: Mutate) -> Mutate:
    def mixed(content: bytes, choice: random.Random) -> bytes:
        other = choice.random() < _ANOTHER_FORM
        return (in_another_form if other else mutate)(content, choice)

    return mixed


_MESH_TAG = '<{0}><geometry><mesh filename="m.stl"/></geometry></{0}></link>'
_CELL = """
[cell]
self_collision = true
floor = "-1 m"
"""


def _read_mesh(path: Path) -> object:
    from stiffopt.robot.link_shapes import convex_hull, load_mesh_file

    return convex_hull(load_mesh_file(path, np.ones(3)), path)


def _meshed(place: Path) -> Iterator[Subject]:
    """Meshes of links and of a cell."""
    for kind, section in (
        ("collision", _CELL),
        ("visual", _CELL),
        ("cell", _CELL + '[[cell.mesh]]\nname = "m"\nfile = "m.stl"\nposition = [9, 9, 9]\n'),
    ):
        folder = place / f"mesh_{kind}"
        shutil.copytree(ROOT / "problems", folder, ignore=shutil.ignore_patterns("recordings"))
        problem = (
            (folder / "two_link.toml").read_text().replace("intervals = 20\n", "intervals = 8\n")
        )
        (folder / "meshed.toml").write_text(problem + section)
        if kind != "cell":
            urdf = (folder / "two_link.urdf").read_text()
            tagged = re.sub("</link>", _MESH_TAG.format(kind), urdf, count=1)
            (folder / "two_link.urdf").write_text(tagged)
        (folder / "m.stl").write_bytes(mesh_by_grammar(b"", random.Random("sound")))
        command = ("solve", "meshed.toml", "--out", "out", "--quiet")
        yield Subject(
            f"mesh, {kind}", folder, "m.stl", mesh_by_grammar, _read_mesh, command, whole=False
        )
