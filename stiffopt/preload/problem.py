"""Preload problem: joints, load cases, objective, requirements, tightening, catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.declaration import (
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    Bounds,
    Doc,
    JointStiffness,
    Length,
    Named,
    Ratio,
    Torque,
    check_fields,
)
from stiffopt.drivetrain.chain import Stage
from stiffopt.drivetrain.tables import with_own
from stiffopt.errors import ProblemError, nearest
from stiffopt.fastening.limits import (
    fastener_count,
    preload_limits,
    preload_loss,
    scatter,
    workshop_torque,
)
from stiffopt.fastening.tightening import SCATTER_BY_METHOD, Tightening
from stiffopt.fastening.utilisation import PreloadLimit
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.robot.robot import Robot
from stiffopt.symbolic import Quantity

OBJECTIVES = {
    "total_preload": "N",
    "bolt_utilisation": "",
    "joint_stiffness": "N m/rad",
    "tool_deflection": "m",
}


@dataclass(frozen=True, kw_only=True)
class Requirements:
    """Requirements on every design of the study."""

    joint_stiffness: Annotated[
        Mapping[int, JointStiffness],
        POSITIVE,
        Doc("Least tangent stiffness in every load case, by joint number."),
    ] = field(default_factory=dict)
    tool_deflection: Annotated[
        Length | None,
        POSITIVE,
        Doc("Largest deflection of the tool over the load cases that have a pose."),
    ] = None
    slip_safety: Annotated[
        Ratio | None,
        Bounds(least=1.0),
        Doc(
            "Slip torque over torque of every friction connection and load case, at the least "
            "preload in service; default 1.2, and 1.8 where the torque changes its sign in a "
            "motion of the study (VDI 2230 R12)."
        ),
    ] = None
    bolt_utilisation: Annotated[
        Ratio,
        FRACTION,
        Doc(
            "Share of the permissible tightening stress, 90 % of the yield strength, at the "
            "largest preload."
        ),
    ] = 1.0
    least_preload: Annotated[
        Ratio,
        Bounds(above=0.0, below=1.0),
        Doc(
            "Least preload over permissible preload: a bolt with little preload works loose under "
            "any torque."
        ),
    ] = 0.3

    def __post_init__(self) -> None:
        check_fields(self, "require")


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """Cost of one step of each kind, in any unit; default no cost."""

    bolt: Annotated[Ratio, NOT_NEGATIVE, Doc("Of one bolt: hole, thread, tightening.")] = 0.0
    size: Annotated[Ratio, NOT_NEGATIVE, Doc("Of each bolt, for one place up in `sizes`.")] = 0.0
    grade: Annotated[Ratio, NOT_NEGATIVE, Doc("Of each bolt, for one place up in `grades`.")] = 0.0
    washer: Annotated[Ratio, NOT_NEGATIVE, Doc("Of the washers of one bolt.")] = 0.0
    nut: Annotated[Ratio, NOT_NEGATIVE, Doc("Of one nut.")] = 0.0
    circle: Annotated[
        Ratio, NOT_NEGATIVE, Doc("Of a flange with another pitch circle than at present.")
    ] = 0.0
    method: Annotated[Ratio, NOT_NEGATIVE, Doc("Of the study, for one place on in `methods`.")] = (
        0.0
    )
    coating: Annotated[
        Ratio, NOT_NEGATIVE, Doc("Of the study, for one place on in `coatings`.")
    ] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "choose.cost")


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Catalogue of designs for every free bolted flange; default the present values."""

    sizes: Annotated[
        tuple[Annotated[str, Named("bolt")], ...], Doc("Sizes of bolts, such as M5.")
    ] = ()
    grades: Annotated[
        tuple[Annotated[str, Named("bolt grade")], ...],
        Doc("Property classes, such as 12.9 or A2-70."),
    ] = ()
    counts: Annotated[tuple[int, ...], Bounds(least=1), Doc("Numbers of bolts in the ring.")] = ()
    circles: Annotated[
        tuple[Length, ...],
        POSITIVE,
        Doc("Pitch circles of the bolts, in the present ring."),
    ] = ()
    methods: Annotated[
        tuple[str, ...],
        Doc("Tightening methods, as in [tightening], for the whole study; cheapest first."),
    ] = ()
    coatings: Annotated[
        tuple[Annotated[str, Named("coating")], ...],
        Doc(
            "Coatings of the bolts, for the whole study, each with lowest and highest friction; "
            "cheapest first."
        ),
    ] = ()
    washers: Annotated[bool, Doc("Try hardened washers under the heads as well.")] = False
    nuts: Annotated[
        bool,
        Doc("Try through-bolts with nuts as well; the part under the nut is `thread_material`."),
    ] = False
    redrill: Annotated[
        bool,
        Doc("Vary sizes, counts and circles of purchased parts as well."),
    ] = False
    torques: Annotated[
        tuple[Torque, ...],
        POSITIVE,
        Doc("Tightening torques of the workshop; default the preferred numbers R20 of ISO 3."),
    ] = ()
    cost: Annotated[
        StepCost | None,
        Doc("If given, the best of the cheapest designs is chosen."),
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, "choose")
        for method in self.methods:
            if method not in SCATTER_BY_METHOD:
                raise ProblemError(
                    f"choose.methods: no tightening method {method!r}. "
                    f"{nearest(method, SCATTER_BY_METHOD)}"
                )


@dataclass(frozen=True)
class FreeElement:
    """Connection with a free preload."""

    joint: int  # 1-based
    stage: Stage  # the connection with its present preload and place in the drivetrain
    limits: tuple[PreloadLimit, ...]  # on the largest assembly preload
    count: int  # bolts or pins
    loss: float  # preload loss of one bolt or pin by embedding and temperature [N]
    scatter: float  # alpha_A, largest over least preload at assembly
    key: str  # name in results

    @property
    def name(self) -> str:
        """Name of the element within its joint."""
        return self.stage.element.name

    @property
    def capacity(self) -> float:
        """Largest preload that every limit allows [N]."""
        return min(self.ends(1.0).values())

    def ends(self, bolt_utilisation: float) -> dict[str, float]:
        """Return the preload at each limit that depends on it [N].

        `bolt_utilisation` is the share of the permissible tightening stress that may be used.
        """
        allowed = {"bolt utilisation": bolt_utilisation}
        return {
            limit.name: (allowed.get(limit.name, 1.0) - limit.fixed) * limit.capacity
            for limit in self.limits
            if np.isfinite(limit.capacity)
        }

    def least(self, preload: Quantity) -> Quantity:
        """Return the least preload in service [N] for a largest assembly preload."""
        return preload / self.scatter - self.loss

    def largest(self, least: Quantity) -> Quantity:
        """Return the largest assembly preload [N] for a least one; inverse of `least`."""
        return self.scatter * (least + self.loss)

    @property
    def preload_known(self) -> bool:
        """True if the present preload is stated, not an initial guess."""
        flange = self.stage.element
        return not (isinstance(flange, BoltedFlange) and flange.preload_is == "assumed")

    def as_present(self, tightening: Tightening) -> FreeElement:
        """Return the present element, with its preload interpreted as in the robot file.

        A net preload is the least in service: scatter and losses are not subtracted again. Its
        largest follows from the maker's wrench setting at the study's friction, if given.
        """
        flange = self.stage.element
        if not isinstance(flange, BoltedFlange) or flange.preload_is != "net":
            return self
        assert flange.preload is not None
        largest = flange.preload
        if flange.tightening_torque is not None:
            lever = workshop_torque(flange, 1.0, tightening).nominal
            largest = max(largest, flange.tightening_torque / lever)
        present = replace(flange, preload=largest, preload_is="assembly")
        stage = replace(self.stage, element=present)
        return replace(self, stage=stage, scatter=largest / flange.preload, loss=0.0)


@dataclass(frozen=True, kw_only=True)
class PreloadProblem:
    """Preload study of one or more joints of a robot.

    Parameters
    ----------
    joints : tuple of int
        1-based.
    histories : tuple of LoadHistory
        Motions; their worst instants join the load cases.
    objective : str
        total_preload : sum of the preloads of all bolts and pins [N]. bolt_utilisation : largest
        utilisation of any bolt or pin. joint_stiffness : MAXIMISES the smallest k_j / weight_j over
        joints and load cases. tool_deflection : largest over the load cases with a pose.
    joint_weights : mapping of joint number to float
        For joint_stiffness [N m/rad]; default the stiffness at the largest preloads, so that
        joints of different size compare.
    free : tuple of str
        Names of the elements with free preload; empty: all bolts and pins of the joints.
    individual : bool
        One preload per bolt or pin instead of one per connection.
    """

    robot: Robot
    joints: tuple[int, ...]
    load_cases: tuple[LoadCase, ...] = ()
    histories: tuple[LoadHistory, ...] = ()
    tightening: Tightening = field(default_factory=Tightening)
    objective: str = "total_preload"
    joint_weights: Mapping[int, float] = field(default_factory=dict)
    requirements: Requirements = field(default_factory=Requirements)
    free: tuple[str, ...] = ()
    individual: bool = False
    choose: Choice | None = None
    title: str = ""

    def __post_init__(self) -> None:
        if self.objective not in OBJECTIVES:
            raise ProblemError(
                f"Unknown objective {self.objective!r}. {nearest(self.objective, OBJECTIVES)}"
            )
        self._check_joints()
        self._check_load_cases()
        with with_own(self.robot.own):
            elements = self.elements
        if not elements:
            raise ProblemError(
                f"{self.robot.name}: joints {', '.join(map(str, self.joints))} have no bolted "
                "flange and no pins, so there is no preload to choose."
            )

    def _check_joints(self) -> None:
        n = self.robot.n
        asked = [*self.joints, *self.requirements.joint_stiffness, *self.joint_weights]
        for joint in asked:
            if not 1 <= joint <= n:
                raise ProblemError(f"{self.robot.name} has joints 1 to {n}, got joint {joint}.")
        if len(set(self.joints)) != len(self.joints) or not self.joints:
            raise ProblemError("joints must be a list of different joint numbers, at least one.")
        for joint in self.joints:
            if self.robot.chains[joint - 1] is None:
                raise ProblemError(
                    f"Joint {joint} of {self.robot.name} has no drivetrain. Describe its elements "
                    "in the robot file, or leave the joint out."
                )
        outside = set(self.requirements.joint_stiffness) - set(self.joints)
        if outside:
            raise ProblemError(
                f"require.joint_stiffness names joint {min(outside)}, which is not among the "
                f"study's joints {list(self.joints)}. Add it to joints or drop the requirement."
            )
        if any(not weight > 0.0 for weight in self.joint_weights.values()):
            raise ProblemError("joint_weights must all be above 0.")

    def _check_load_cases(self) -> None:
        n = self.robot.n
        loads: list[LoadCase | LoadHistory] = [*self.load_cases, *self.histories]
        if not loads:
            raise ProblemError("A preload study needs at least one [[load_case]].")
        for load in loads:
            if load.torque.shape[-1:] != (n,):
                raise ProblemError(
                    f"Load case {load.name!r}: torque needs one number a joint, {n}, got "
                    f"{load.torque.shape[-1] if load.torque.ndim else 1}."
                )
        names = [load.name for load in loads]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ProblemError(f"Load case names must differ, used twice: {', '.join(twice)}.")
        posed = any(load.jacobian is not None for load in loads)
        wanted = self.requirements.tool_deflection is not None
        if (wanted or self.objective == "tool_deflection") and not posed:
            raise ProblemError(
                "The tool deflection needs a load case with a pose: give it `joints` and a tool "
                "`force`, or a `trajectory`."
            )

    @cached_property
    def elements(self) -> tuple[FreeElement, ...]:
        """Connections with free preload, joint by joint from motor to link."""
        candidates = [
            (joint, stage) for joint in self.joints for stage in self._fastened_stages(joint)
        ]
        known = {stage.element.name for _, stage in candidates}
        for name in self.free:
            if name not in known:
                raise ProblemError(
                    f"free: no bolted flange and no pins named {name!r} in the study's joints. "
                    f"{nearest(name, known)}"
                )
        return tuple(
            self._free_element(joint, stage)
            for joint, stage in candidates
            if not self.free or stage.element.name in self.free
        )

    def _fastened_stages(self, joint: int) -> list[Stage]:
        chain = self.robot.chains[joint - 1]
        assert chain is not None
        return [s for s in chain.stages if s.element.kind in ("bolted_flange", "clamping_pins")]

    def _free_element(self, joint: int, stage: Stage) -> FreeElement:
        name = stage.element.name
        return FreeElement(
            joint=joint,
            stage=stage,
            limits=preload_limits(stage.element, self.tightening),
            count=fastener_count(stage.element),
            loss=preload_loss(stage.element, self.tightening),
            scatter=scatter(stage.element, self.tightening),
            key=name if len(self.joints) == 1 else f"joint_{joint}.{name}",
        )
