"""USD: table of joint values in the terms of Isaac Lab and of USD physics, for Isaac Sim."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields

import numpy as np

from stiffopt.export.model_format import MODEL_FORMATS, DiagnosedRobot, ModelFormat
from stiffopt.files import csv_text
from stiffopt.robot.mjcf import is_mjcf, read_mjcf
from stiffopt.units import joint_unit

_PER_DEGREE = math.radians(1.0)


@dataclass(frozen=True, kw_only=True)
class IsaacValue:
    """A value of a joint."""

    joint: str
    isaac_lab: str  # key of `ImplicitActuatorCfg`
    # Before and with the findings, in `unit`.
    nominal: float
    found: float
    unit: str
    usd_attribute: str  # attribute of the joint's prim
    usd_value: float  # found value in `usd_unit`: rotations of USD are in degrees
    usd_unit: str


class Usd(ModelFormat):
    """Armature, friction, drive gains and limits of every joint, one row a value.

    Dry friction is an effort, as PhysX has it since Isaac Sim 5; `physxJoint:jointFriction` of
    earlier ones is a dimensionless share of the joint's load and cannot be computed. Gains are
    those of servos in the robot's MJCF.
    """

    name = "usd"
    file = "isaac_joints.csv"

    def text(self, found: DiagnosedRobot) -> str:
        """Return the content of isaac_joints.csv."""
        columns = [each.name for each in fields(IsaacValue)]
        return csv_text(columns, (astuple(value) for value in _isaac_values(found)))


def _isaac_values(found: DiagnosedRobot) -> Iterator[IsaacValue]:
    """Yield the values of all joints."""
    path = found.nominal.urdf
    drives = read_mjcf(path).actuators if path is not None and is_mjcf(path) else ()
    nominal, robot = found.nominal, found.robot
    for j, name in enumerate(robot.joint_names):
        axis = "linear" if robot.prismatic[j] else "angular"
        axial, drive = f"physxJointAxis:{axis}:", f"drive:{axis}:physics:"
        rows: list[tuple[str, float, float, str, str]] = [
            (key, float(getattr(nominal, own)[j]), float(getattr(robot, own)[j]), unit, attribute)
            for key, own, unit, attribute in (
                ("armature", "rotor_inertia", "kg m^2", f"{axial}armature"),
                ("friction", "coulomb", "N m", f"{axial}staticFrictionEffort"),
                ("dynamic_friction", "coulomb", "N m", f"{axial}dynamicFrictionEffort"),
                ("viscous_friction", "viscous", "N m s/rad", f"{axial}viscousFrictionCoefficient"),
                ("effort_limit_sim", "torque_max", "N m", f"{drive}maxForce"),
            )
        ]
        servos = [each for each in drives if each.joint == name and each.position_gain]
        for key, gains, estimated, unit in (
            ("stiffness", [s.position_gain for s in servos], found.stiffness[j], "N m/rad"),
            ("damping", [s.velocity_gain for s in servos], found.damping[j], "N m s/rad"),
        ):
            if servos or not np.isnan(estimated):
                old = sum(gains) if servos else math.nan
                new = found.gain[j] * old if np.isnan(estimated) else estimated
                rows.append((key, old, float(new), unit, f"{drive}{key}"))
        for key, before, after, unit, attribute in rows:
            unit = joint_unit(unit, bool(robot.prismatic[j]))
            angular = unit.endswith("/rad")
            yield IsaacValue(
                joint=name,
                isaac_lab=key,
                nominal=before,
                found=after,
                unit=unit,
                usd_attribute=attribute,
                usd_value=_PER_DEGREE * after if angular else after,
                usd_unit=unit.replace("/rad", "/deg"),
            )


MODEL_FORMATS.add(Usd())
