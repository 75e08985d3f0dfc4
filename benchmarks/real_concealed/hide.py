"""What is hidden, one entry a kind: put into the recorded torque or link angle, or into the model.

A body that is heavier, or whose centre lies elsewhere, adds to the recorded torques what inverse
dynamics of the changed URDF says: to the tool it is the same as if the nominal model lacked it.
Every kind is made of a unit that is scaled, so that its size can be given in multiples of what the
re-identified model leaves on runs left out. None of its formulas is the tool's.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.blind.score import Named
from benchmarks.blind.sets import Columns, write_set

from .motion import MOVING, Motion, PublicSet, motion_of, smooth

# What is added to the torque or link angle (K, n) of a run for a unit, joint from 0.
Added = Callable[[PublicSet, Motion, int], np.ndarray]
_PLAY = 1e-5  # [rad], a unit of backlash
_POLES = 4  # pole pairs that are told where ripple is hidden


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of concealment.

    Parameters
    ----------
    name : str
    where : str
        "torque", "link", "stiffness", "sign": what is changed.
    truth : callable
        From set and joint (from 0) to the names that are right.
    parameter : str
        That is compared, "" for none.
    added : callable, optional
        To the torque, or to the link angle.
    sets : tuple of str
        Names of the sets that it can be hidden in; none: all.
    every : bool
        Whether the torques of all joints change, so that no joint is drawn.
    most : float
        Units that are sensible at most; where the size drawn asks for more the next joint is taken,
        at last a smaller size.
    links : str
        "last" or "all" where it is in a link.
    """

    name: str
    where: str
    truth: Callable[[PublicSet, int], tuple[Named, ...]]
    parameter: str = ""
    added: Added | None = None
    sets: tuple[str, ...] = ()
    every: bool = False
    most: float = float("inf")
    links: str = ""


def _side(speed: np.ndarray) -> np.ndarray:
    return np.asarray(np.sign(speed) * np.minimum(np.abs(speed) / MOVING, 1.0))


def _single(values: np.ndarray, like: Motion, joint: int) -> np.ndarray:
    out = np.zeros_like(like.position)
    out[:, joint] = values
    return out


def _coulomb(_: PublicSet, m: Motion, j: int) -> np.ndarray:
    return _single(_side(m.velocity[:, j]), m, j)


def _viscous(_: PublicSet, m: Motion, j: int) -> np.ndarray:
    return _single(m.velocity[:, j], m, j)


def _rotor(_: PublicSet, m: Motion, j: int) -> np.ndarray:
    return _single(m.acceleration[:, j], m, j)


def _load(s: PublicSet, m: Motion, j: int) -> np.ndarray:
    """Of the load that the joint carries, which holds no friction."""
    carried = s.rigid_torques(s.folder / s.told["robot"], replace(m, position=_known(m.position)))
    return _single(np.abs(carried[:, j]) * _side(m.velocity[:, j]), m, j)


def _gain(_: PublicSet, m: Motion, j: int) -> np.ndarray:
    return _single(m.torque[:, j], m, j)


def _offset(_: PublicSet, m: Motion, j: int) -> np.ndarray:
    return _single(np.ones(len(m.time)), m, j)


def _delay(_: PublicSet, m: Motion, j: int) -> np.ndarray:
    """For a delay of 1 ms."""
    return _later(m, 1.0)


def _later(m: Motion, milliseconds: float) -> np.ndarray:
    """What a delay does to the torque; noise that comes later is noise as before."""
    known = smooth(m.time, m.torque)
    late = m.time - 1e-3 * milliseconds
    return np.column_stack([np.interp(late, m.time, c) for c in known.T]) - known


def _play(s: PublicSet, m: Motion, j: int) -> np.ndarray:
    """Of the link angle: half the width on the side of the load that the gear carries."""
    return _single(-0.5 * _PLAY * np.sign(s.carried(m)[:, j]), m, j)


def _softer(s: PublicSet, m: Motion, j: int) -> np.ndarray:
    """Of the link angle: the nominal wind-up as much again."""
    return _single(-s.carried(m)[:, j] / s.told["nominal"]["reducer"]["K2"][j], m, j)


def _ripple(s: PublicSet, m: Motion, j: int) -> np.ndarray:
    ratio = s.told["nominal"]["gear_ratio"][j]
    return _single(np.sin(_POLES * ratio * m.position[:, j] + 0.7), m, j)


def _stop(s: PublicSet, m: Motion, j: int) -> np.ndarray:
    """A stiff spring over the last fifth of the stroke that the runs have."""
    angles = np.concatenate([s.motion(file).position[:, j] for file in s.runs("train")])
    low, high = np.nanquantile(angles, [0.0, 1.0])
    return _single(np.maximum(m.position[:, j] - (high - 0.2 * (high - low)), 0.0), m, j)


def _mass(s: PublicSet, m: Motion, j: int) -> np.ndarray:
    """A kilogram at the centre of a link, its inertia about it in proportion."""
    return _bodies(s, m, j, mass=1.0, centre=0.0)


def _centre(s: PublicSet, m: Motion, j: int) -> np.ndarray:
    """The centre of a link a centimetre off, along a diagonal of its frame."""
    return _bodies(s, m, j, mass=0.0, centre=0.01)


def _bodies(s: PublicSet, m: Motion, j: int, *, mass: float, centre: float) -> np.ndarray:
    whole = replace(m, position=_known(m.position), torque=m.torque)
    with tempfile.TemporaryDirectory() as folder:
        changed = heavier(s, j, mass, centre, Path(folder) / "changed.urdf")
        after = s.rigid_torques(changed, whole)
    return after - s.rigid_torques(s.folder / s.told["robot"], whole)


def _known(samples: np.ndarray) -> np.ndarray:
    every = np.arange(len(samples))
    columns = [np.interp(every, every[np.isfinite(c)], c[np.isfinite(c)]) for c in samples.T]
    return np.column_stack(columns)


def _joint(name: str) -> Callable[[PublicSet, int], tuple[Named, ...]]:
    return lambda s, j: (Named(name, j + 1),)


def _link(s: PublicSet, j: int) -> tuple[Named, ...]:
    moved = (Named("inertial_error", None, link_of(s, j)),)
    return (*moved, Named("payload")) if j == len(s.joints) - 1 else moved


def _stops(s: PublicSet, j: int) -> tuple[Named, ...]:
    return tuple(Named(name, j + 1) for name in ("end_stop", "cable_spring", "gravity_spring"))


# Sets with torques alone: bodies and stops would move the link encoders of the other.
LIGHT = ("dfki_a0815", "tx40_first", "unisa_ur10", "ur10e")
ARMS = ("dfki_a0815", "kuka_kr300", "tx40_first", "unisa_ur10", "ur10e")
KINDS = (
    Kind(name="coulomb", where="torque", truth=_joint("coulomb"), parameter="dFc", added=_coulomb),
    Kind(name="viscous", where="torque", truth=_joint("viscous"), parameter="dFv", added=_viscous),
    Kind(
        name="rotor inertia", where="torque", truth=_joint("rotor_inertia"), parameter="dJ",
        added=_rotor,
    ),
    Kind(
        name="load friction", where="torque", truth=_joint("load_friction"), added=_load, most=0.6,
    ),
    Kind(
        name="motor gain", where="torque", truth=_joint("torque_gain"), parameter="eps",
        added=_gain, most=0.5,
    ),
    Kind(
        name="offset", where="torque", truth=_joint("torque_offset"), parameter="off",
        added=_offset,
    ),
    Kind(
        name="delay", where="torque", truth=lambda s, j: (Named("time_delay"),), parameter="d",
        added=_delay, sets=ARMS, every=True, most=30.0,
    ),
    Kind(
        name="ripple", where="torque", truth=_joint("torque_ripple"), added=_ripple,
        sets=("tx40_first",),
    ),
    Kind(name="stop", where="torque", truth=_stops, added=_stop, sets=LIGHT),
    Kind(
        name="payload", where="torque", truth=_link, parameter="dm", added=_mass, sets=LIGHT,
        links="last",
    ),
    Kind(
        name="mass of a link", where="torque", truth=_link, parameter="dm", added=_mass,
        sets=LIGHT, links="all",
    ),
    Kind(
        name="centre of mass moved", where="torque", truth=_link, added=_centre, sets=LIGHT,
        links="all", most=20.0,
    ),
    Kind(
        name="backlash", where="link", truth=_joint("backlash"), parameter="width",
        added=_play, sets=("kuka_kr300",),
    ),
    Kind(
        name="stiffness", where="stiffness", truth=_joint("stiffness_linear"), parameter="factor",
        added=_softer, sets=("kuka_kr300",),
    ),
    Kind(name="sign of an axis", where="sign", truth=_joint("sign"), sets=ARMS),
)  # fmt: skip


def link_of(s: PublicSet, joint: int) -> str:
    """Name of the link that a joint moves."""
    tree = ElementTree.parse(s.folder / s.told["robot"])
    child = tree.find(f".//joint[@name='{s.joints[joint]}']/child")
    assert child is not None
    return child.attrib["link"]


def heavier(s: PublicSet, joint: int, mass: float, centre: float, target: Path) -> Path:
    """The set's URDF with a link heavier [kg], or its centre moved along a diagonal [m]."""
    tree = ElementTree.parse(s.folder / s.told["robot"])
    inertial = tree.find(f".//link[@name='{link_of(s, joint)}']/inertial")
    assert inertial is not None
    entry, origin, tensor = (inertial.find(tag) for tag in ("mass", "origin", "inertia"))
    assert entry is not None
    assert tensor is not None
    if origin is None:
        origin = ElementTree.SubElement(inertial, "origin")
    now = float(entry.attrib["value"])
    place = [float(v) + centre / 3.0**0.5 for v in origin.attrib.get("xyz", "0 0 0").split()]
    origin.set("xyz", " ".join(map(repr, place)))
    entry.set("value", repr(now + mass))
    for key, value in tensor.attrib.items():
        tensor.set(key, repr(float(value) * (now + mass) / max(now, 1e-9)))
    tree.write(target)
    return target


def hidden(s: PublicSet, kind: Kind, joint: int, amount: float, target: Path) -> Path:
    """The set with so much of a kind in it."""
    told = s.told
    signals = told["signals"]
    if kind.where == "torque":
        assert kind.added is not None
        added = kind.added

        def change(_: str, columns: Columns) -> Columns:
            run = motion_of(columns, signals)
            if kind.name == "delay":
                return columns | {
                    name: np.interp(run.time - 1e-3 * amount, run.time, columns[name])
                    for name in signals["torque"]
                }
            more = amount * np.nan_to_num(added(s, run, joint))
            names = enumerate(signals["torque"])
            return columns | {name: columns[name] + more[:, k] for k, name in names}

        if kind.name == "ripple":
            told = told | {"nominal": told["nominal"] | {"pole_pairs": _POLES}}
        return write_set(s.folder, target, told, change)
    if kind.where == "link":
        name = signals["link_position"][joint]

        def play(_: str, columns: Columns) -> Columns:
            added = _play(s, motion_of(columns, signals), joint)
            return columns | {name: columns[name] + amount * added[:, joint]}

        return write_set(s.folder, target, told, play)
    if kind.where == "stiffness":
        reducer = {
            key: [v * amount if k == joint else v for k, v in enumerate(values)]
            if key.startswith("K")
            else values
            for key, values in told["nominal"]["reducer"].items()
        }
        told = told | {"nominal": told["nominal"] | {"reducer": reducer}}
        return write_set(s.folder, target, told)
    assert kind.where == "sign"

    def turned(_: str, columns: Columns) -> Columns:
        names = [signals["position"][joint]]
        if "velocity" in signals:
            names.append(signals["velocity"][joint])
        return columns | {name: -columns[name] for name in names}

    return write_set(s.folder, target, told, turned)


def softer(model: Path, joint: int, factor: float, target: Path) -> Path:
    """An extended.toml with the nominal stiffness of a joint times a factor."""

    def scaled(line: str) -> str:
        key, _, values = line.partition(" = ")
        if key not in ("K1", "K2", "K3"):
            return line
        numbers = [float(v) for v in values.strip("[]").split(",")]
        numbers[joint] *= factor
        return f"{key} = {numbers!r}"

    lines = model.read_text(encoding="utf-8").splitlines()
    target.write_text("\n".join(map(scaled, lines)) + "\n", encoding="utf-8")
    return target


def size(s: PublicSet, kind: Kind, joint: int, amount: float) -> np.ndarray:
    """What so much of a kind adds to every torque, or link angle, root mean square (n,)."""
    if kind.name == "delay":
        return s.size(lambda run: _later(run, amount))
    added = kind.added
    assert added is not None
    per_unit = s.size(lambda run: added(s, run, joint), centred=kind.where != "torque")
    return abs(amount) * per_unit
