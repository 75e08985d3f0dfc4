"""A planner's robot with what was found in recordings of it.

Friction, rotor inertia, payload, masses of links and the stiffness of drivetrains are things that a
planner computes with; what else was found (ripple, offsets, delays) it does not know, and that is
said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stiffopt.discovery.comparison.extension import EstimatedEffect
from stiffopt.discovery.comparison.signals import JointConstants
from stiffopt.discovery.extended.model import ExtendedModel
from stiffopt.discovery.extended.planner_elastic import ELASTIC, yielding
from stiffopt.drivetrain.chain import Chain
from stiffopt.errors import InputFileError
from stiffopt.robot.robot import Robot

_RELATIVE = ("coulomb", "viscous", "rotor_inertia")


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannerModel:
    """A robot with an extended model in it.

    Parameters
    ----------
    robot : Robot
    changes : tuple of str
        What was changed, a sentence each.
    left_out : tuple of str
        What was found and a planner does not know, with the place.
    """

    robot: Robot
    changes: tuple[str, ...]
    left_out: tuple[str, ...]


def planner_model(robot: Robot, model: ExtendedModel) -> PlannerModel:
    """Put what was found into the robot of a planner.

    Parameters
    ----------
    robot : Robot
        With its payload.
    model : ExtendedModel
        Of recordings of the same arm.

    Returns
    -------
    PlannerModel

    Raises
    ------
    InputFileError
        The model's joints are not the robot's.

    Notes
    -----
    Values of a finding are added to the robot's own; calibrated values of friction and rotor
    inertia scale them. Calibrated masses, centres and stiffnesses lie within the tolerances of the
    nominal model and are not carried over.
    """
    planner = _Planner(robot, model)
    planner.calibrate()
    for estimated in model.extension.effects:
        planner.add(estimated)
    return PlannerModel(
        robot=planner.robot, changes=tuple(planner.changes), left_out=tuple(planner.left_out)
    )


class _Planner:
    """The robot while findings are put into it."""

    def __init__(self, robot: Robot, model: ExtendedModel) -> None:
        self.robot, self.model = robot, model
        self.place = _places(robot, model)
        self.changes: list[str] = []
        self.left_out: list[str] = []

    def calibrate(self) -> None:
        """Scale what was calibrated and is a value of the robot."""
        for name in _RELATIVE:
            values = np.array(getattr(self.robot, name), dtype=float)
            moved = False
            for j, place in enumerate(self.place):
                relative = self.model.extension.calibration.get(f"{name} {j + 1}", 0.0)
                values[place] *= max(1.0 + relative, 0.0)
                moved |= relative != 0.0
            if moved:
                self._set(name, values)

    def add(self, estimated: EstimatedEffect) -> None:
        """Put one finding into the robot, or name it among those left out."""
        located = estimated.located
        name, joint = located.effect.name, located.joint
        if name in _ADDED and joint is not None:
            field, unit = _ADDED[name]
            self._add_to(field, unit, joint, estimated.amplitudes[0])
        elif name in ELASTIC and joint is not None:
            self._yield(joint, estimated)
        elif name == "payload":
            self._weigh(len(self.place) - 1, estimated, "payload")
        elif name == "inertial_error" and located.link is not None:
            self._weigh(located.link, estimated, "masses")
        else:
            self.left_out.append(located.label)

    def _add_to(self, field: str, unit: str, joint: int, change: float) -> None:
        values = np.array(getattr(self.robot, field), dtype=float)
        place = self.place[joint]
        before = float(values[place])
        # A drive neither pushes itself nor has a rotor of negative inertia.
        values[place] = max(before + change, 0.0)
        self._set(field, values)
        said = field.replace("_", " ")
        self.changes.append(
            f"Joint {place + 1}: {said} {before:.4g} to {values[place]:.4g} {unit}."
        )

    def _set(self, field: str, values: np.ndarray) -> None:
        changed: dict[str, Any] = {field: values}
        self.robot = replace(self.robot, **changed)

    def _yield(self, joint: int, estimated: EstimatedEffect) -> None:
        place = self.place[joint]
        chain = self.robot.chains[place]
        changed = yielding(chain, estimated, joint_constants(self.model, joint))
        if changed is None:
            self.left_out.append(estimated.located.label)
            return
        chains: list[Chain | None] = list(self.robot.chains)
        chains[place] = changed.chain
        self.robot = replace(self.robot, chains=tuple(chains))
        self.changes.append(f"Joint {place + 1}: {changed.sentence}")

    def _weigh(self, link: int, estimated: EstimatedEffect, what: str) -> None:
        joint = self.place[link] + 1
        before = self.robot.tree.bodies[joint - 1]
        values = before.inertial_parameters + np.asarray(estimated.amplitudes)
        if values[0] <= 0.0:
            self.left_out.append(f"{estimated.located.label} (it would leave no mass)")
            return
        self.robot = self.robot.with_inertial_parameters(joint, values)
        body = self.robot.tree.bodies[joint - 1]
        centre = ", ".join(f"{1e3 * x:.0f}" for x in body.centre)
        self.changes.append(
            f"{what.capitalize()} of link {link + 1}: {before.mass:.4g} to {body.mass:.4g} kg,"
            f" centre at ({centre}) mm."
        )


_ADDED = {
    "coulomb": ("coulomb", "N m"),
    "viscous": ("viscous", "N m s/rad"),
    "rotor_inertia": ("rotor_inertia", "kg m^2"),
}


def _places(robot: Robot, model: ExtendedModel) -> tuple[int, ...]:
    """Index of every joint of the model among those of the robot: by name, else in order."""
    names: Sequence[str] = robot.joint_names
    if set(model.joints) <= set(names):
        return tuple(names.index(name) for name in model.joints)
    if len(model.joints) != len(names):
        raise InputFileError(
            model.source,
            "joints",
            f"this model is of {', '.join(model.joints)}, the robot of the problem has"
            f" {', '.join(names)}. Give the model of the same robot.",
        )
    return tuple(range(len(names)))


def joint_constants(model: ExtendedModel, joint: int) -> JointConstants:
    """Constants of a joint that the terms of an extended model were fitted with.

    Parameters
    ----------
    model : ExtendedModel
    joint : int
        From 0.
    """
    nominal = model.nominal

    def own(values: np.ndarray | None, default: float) -> float:
        return default if values is None or not np.isfinite(values[joint]) else float(values[joint])

    slopes = torques = None
    if nominal.reducer is not None:
        r = nominal.reducer
        k1, k2, k3, t1, t2 = (float(v[joint]) for v in (r.K1, r.K2, r.K3, r.T1, r.T2))
        if np.isfinite([k1, k2, k3]).all():
            slopes, torques = (k1, k2, k3), (t1, t2)
    return JointConstants(
        joint=joint + 1,
        ratio=own(nominal.gear_ratio, 1.0),
        coulomb=own(nominal.coulomb, 0.0),
        viscous=own(nominal.viscous, 0.0),
        torque_rated=model.scales["torque_rated"][joint],
        torque_max=model.scales["torque_max"][joint],
        rotor_inertia=own(nominal.rotor_inertia, 0.0),
        contact_stiffness=own(nominal.contact_stiffness, np.inf),
        pole_pairs=nominal.pole_pairs,
        fastest=model.scales["fastest"][joint],
        slopes=slopes,
        torques=torques,
    )
