"""Read extended.toml: the nominal model of a recording set with the findings of a diagnosis.

Its entries are described in `stiffopt.discovery.extended.schema`. Numbers are SI at the output
side. `stiffopt diagnose --model extended.toml` starts from this model in place of the nominal one.
A planner finds friction, stiffness, payload and preload in the parameters, by the names of the
catalogue.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.catalogue.drift import of_other_runs
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.extended.laws import read_law, read_table
from stiffopt.discovery.extended.schema import (
    ClosedLoopSection,
    EffectSection,
    ExtendedFile,
    LeftOpenSection,
    MadeForSection,
)
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.signals import RobotConstants
from stiffopt.drivetrain.chain import Chain
from stiffopt.errors import InputFileError, nearest
from stiffopt.files import read_document
from stiffopt.folders import check_result
from stiffopt.recording.nominal_files import build_chains, check_nominal
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.schema import NominalSection
from stiffopt.robot.robot import Robot

# Tolerances of lengths [m] and masses (relative) of the same arm: descriptions differ by rounding
# and by the assignment of parts to links.
_LENGTH_TOLERANCE, _MASS_TOLERANCE = 5e-3, 0.3


def robot_signature(robot: Robot, order: Sequence[int] | np.ndarray) -> MadeForSection:
    """Return name, lengths and masses of a robot's joints in this order (indices from 0)."""
    bodies = [robot.tree.bodies[int(j)] for j in order]
    return MadeForSection(
        name=robot.name,
        lengths=tuple(float(np.linalg.norm(body.translation)) for body in bodies),
        masses=tuple(float(body.mass) for body in bodies),
    )


def require_same_robot(
    section: MadeForSection | None,
    source: str,
    joints: Sequence[str],
    robot: Robot,
    place: Sequence[int] | np.ndarray,
) -> None:
    """Raise `InputFileError` if an extended model is of another robot.

    `section`: None if the file has none; joints are then compared by name. `source`: path of the
    file, for messages. `joints`: joints of the model. `place`: index of each joint of the model
    among those of the robot.
    """
    same_names = set(joints) <= set(robot.joint_names)
    if section is None:
        if not same_names:
            raise InputFileError(
                source,
                "joints",
                f"this model is of {', '.join(joints)}, the robot {robot.name} has"
                f" {', '.join(robot.joint_names)}. Give the model of the same robot.",
            )
        return
    if len(joints) < robot.n:
        # Fixed joints merge bodies: only the names can be compared.
        return
    own = robot_signature(robot, place)
    wrong = _describe_difference(section, own)
    if wrong:
        raise InputFileError(
            source,
            "robot",
            f"this model was made for the robot {section.name} ({', '.join(joints)}), not for"
            f" {robot.name}: {wrong}. Diagnose recordings of {robot.name}, or solve with the robot"
            " of the model.",
        )


def _describe_difference(stated: MadeForSection, own: MadeForSection) -> str:
    if len(stated.lengths) != len(own.lengths) or len(stated.masses) != len(own.masses):
        return f"it has {len(own.masses)} joints, the model {len(stated.masses)}"
    # The first length depends on the base, the last mass includes the payload.
    for j in range(1, len(own.lengths)):
        if abs(stated.lengths[j] - own.lengths[j]) > _LENGTH_TOLERANCE:
            return (
                f"joint {j + 1} lies {own.lengths[j]:.4g} m from the joint before, in the model"
                f" {stated.lengths[j]:.4g} m"
            )
    for j in range(len(own.masses) - 1):
        if abs(stated.masses[j] - own.masses[j]) > _MASS_TOLERANCE * max(
            stated.masses[j], own.masses[j]
        ):
            return (
                f"the body behind joint {j + 1} has {own.masses[j]:.4g} kg, in the model"
                f" {stated.masses[j]:.4g} kg"
            )
    return ""


# Relative tolerance of equal values.
VALUE_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class ExtendedModel:
    """A nominal model with findings."""

    source: str  # path of the file, for messages
    name: str  # name of the recording set
    joints: tuple[str, ...]  # (n,)
    robot: MadeForSection | None  # robot that it was made for; None if not stated
    nominal: NominalSection  # stated values of the nominal robot
    chains: tuple[Chain | None, ...] | None  # (n,) nominal drivetrains; None for those of the robot
    scales: dict[str, tuple[float, ...]]  # (n,) `JOINT_SCALES`
    extension: Extension
    parameters: tuple[dict[str, float], ...]  # reported values of every effect
    deviations: tuple[dict[str, float], ...] = ()  # their standard deviations, if stated
    left_open: LeftOpenSection | None = None  # residual in its own recordings; None if not stated
    closed_loop: ClosedLoopSection | None = None  # simulation from commands; None without commands

    def applied_to(self, recordings: RecordingSet) -> RecordingSet:
        """Return the set with this model's nominal values.

        Raises `InputFileError`: the joints differ.
        """
        if recordings.joints != self.joints:
            raise InputFileError(
                self.source,
                "joints",
                f"this model is of {', '.join(self.joints)}, the recordings of"
                f" {', '.join(recordings.joints)}. Give the model of the same robot.",
            )
        require_same_robot(self.robot, self.source, self.joints, recordings.robot, recordings.order)
        nominal = self.nominal
        found = (each.effect for each in self.extension.effects)
        if nominal.pole_pairs is None and not any("pole_pairs" in e.only_without for e in found):
            # Pole pairs of the set are compatible unless the model contains an effect of unknown
            # ones, which would be found a second time as ripple of the poles.
            nominal = nominal.model_copy(update={"pole_pairs": recordings.stated.pole_pairs})
        return recordings.with_nominal(nominal, self.source)

    def scales_of(self, joint: int) -> dict[str, Any]:
        """Return the constants of a joint (from 0) that scale terms."""
        return {name: values[joint] for name, values in self.scales.items()}

    def scaled(self, constants: RobotConstants) -> RobotConstants:
        """Return constants with the scales that the effects were fitted with."""
        joints = tuple(replace(own, **self.scales_of(j)) for j, own in enumerate(constants.joints))
        return replace(constants, joints=joints)


def load_extended(path: str | os.PathLike[str], effects: Sequence[Effect] = ()) -> ExtendedModel:
    """Read an extended.toml.

    `effects`: additional to the catalogue.

    Raises `InputFileError`: the file is invalid.
    """
    check_result(Path(path).parent, Path(path).name, edited=True)
    document = read_document(path, ExtendedFile, "extended")
    n = len(document.joints)
    check_nominal(document.nominal, document.joints, Path(path))
    scales = {
        name: _check_length((0.0,) * n if values is None else values, n, path, f"scales.{name}")
        for name, values in document.scales.model_dump().items()
    }
    known = {entry.name: entry for entry in (*CATALOGUE, *effects)}
    read = [
        _read_effect(section, known, document, path, f"effect[{number}]")
        for number, section in enumerate(document.effect, start=1)
    ]
    read += [
        read_table(section, n, path, f"residual[{number}]")
        for number, section in enumerate(document.residual, start=1)
    ]
    try:
        calibration = {ValueName.read(k): v for k, v in document.calibration.items()}
    except ValueError as error:
        raise InputFileError(path, "calibration", str(error)) from None
    return ExtendedModel(
        source=str(path),
        name=document.name,
        joints=document.joints,
        robot=document.robot,
        nominal=document.nominal,
        chains=build_chains(document.nominal, np.array(scales["torque_max"]), Path(path)),
        scales=scales,
        extension=Extension(calibration=calibration, effects=tuple(read)),
        parameters=tuple(
            {name: entry.value for name, entry in section.parameters.items()}
            for section in document.effect
        )
        + ({},) * len(document.residual),
        deviations=tuple(
            {name: entry.sd for name, entry in section.parameters.items() if entry.sd is not None}
            for section in document.effect
        ),
        left_open=_check_left_open(document.left_open, n, path),
        closed_loop=document.closed_loop,
    )


def check_extended(model: ExtendedModel, constants: RobotConstants) -> None:
    """Raise `InputFileError` if reported values disagree with their terms."""
    pairs = zip(model.extension.effects, model.parameters, strict=True)
    for number, (estimated, stated) in enumerate(pairs, start=1):
        located = estimated.located
        own = located.effect.parameters(
            estimated.amplitudes, located.shapes, located.constants(constants)
        )
        for name, value in stated.items():
            if name not in own:
                raise InputFileError(
                    model.source,
                    f"effect[{number}].parameters.{name}",
                    f"{located.effect.name} has no such parameter. {nearest(name, own)}",
                )
            if not np.isclose(value, own[name], rtol=VALUE_TOLERANCE, atol=0.0):
                raise InputFileError(
                    model.source,
                    f"effect[{number}].parameters.{name}",
                    f"is {value:g}, but effect.term gives {own[name]:g}. Change effect.term, which"
                    " calculations use, and leave the parameter out.",
                )


def _check_length(values: Sequence[float], n: int, path: object, where: str) -> tuple[float, ...]:
    if len(values) != n:
        raise InputFileError(path, where, f"needs one number a joint ({n}), got {len(values)}.")
    return tuple(values)


def _check_left_open(
    section: LeftOpenSection | None, n: int, path: object
) -> LeftOpenSection | None:
    for name in ("predict", "torque", "link_position"):
        values = None if section is None else getattr(section, name)
        if values is not None:
            _check_length(values, n, path, f"left_open.{name}")
    return section


def _read_effect(
    section: EffectSection,
    known: dict[str, Effect],
    document: ExtendedFile,
    path: object,
    where: str,
) -> EstimatedEffect:
    effect = known.get(section.name)
    if effect is None and section.law is not None:
        effect = read_law(section, len(document.joints), path, where)
    if effect is None:
        raise InputFileError(
            path,
            f"{where}.name",
            f"no effect {section.name!r}. {nearest(section.name, known)} A user's own effect"
            " needs its Python file.",
        )
    place = _read_place(section, effect, document, path, where)
    if effect.of_runs is not None:
        effect = of_other_runs(effect, section.term)
    names = [a.name for a in effect.amplitudes] + [s.name for s in effect.shapes]
    usual = {s.name: s.usual for s in effect.shapes if s.usual is not None}
    term = {**usual, **section.term}
    if sorted(names) != sorted(term):
        raise InputFileError(
            path, f"{where}.term", f"{effect.name} needs exactly {', '.join(names)}."
        )
    shapes = tuple(term[s.name] for s in effect.shapes)
    for shape, value in zip(effect.shapes, shapes, strict=True):
        if not shape.lower <= value <= shape.upper:
            raise InputFileError(
                path,
                f"{where}.term.{shape.name}",
                f"is {value:g}, allowed are {shape.lower:g} to {shape.upper:g} {shape.unit}.",
            )
    return EstimatedEffect(
        located=LocatedEffect(effect=effect, shapes=shapes, **place),
        amplitudes=tuple(term[a.name] for a in effect.amplitudes),
        step=section.step,
    )


def _read_place(
    section: EffectSection, effect: Effect, document: ExtendedFile, path: object, where: str
) -> dict[str, Any]:
    needed = {
        "joint": ("joint",),
        "robot": (),
        "link": ("link",),
        "run": ("joint", "run"),
        "recording": ("run",),
    }
    for key in ("joint", "link", "run"):
        given, wanted = getattr(section, key) is not None, key in needed[effect.scope]
        if given != wanted:
            reason = f"{effect.name} needs a {key}." if wanted else f"{effect.name} has no {key}."
            raise InputFileError(path, f"{where}.{key}", reason)
    place: dict[str, Any] = {"run": section.run}
    if section.joint is not None:
        if not 1 <= section.joint <= len(document.joints):
            raise InputFileError(
                path, f"{where}.joint", f"is {section.joint}, there are {len(document.joints)}."
            )
        place["joint"] = section.joint - 1
    if section.link is not None:
        if section.link not in document.links:
            raise InputFileError(path, f"{where}.link", nearest(section.link, document.links))
        place["link"] = document.links.index(section.link)
    return place
