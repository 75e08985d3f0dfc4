"""Sensitivity of joint stiffness to preloads, and joints with loosened connections."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.exact.chain import compliance_shares, windup_shares
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.model import PreloadModel


@dataclass(frozen=True, kw_only=True)
class PreloadWorth:
    """Sensitivity of a joint's stiffness to the preload of an element's bolts or pins."""

    key: str
    joint: int  # 1-based
    case: str
    stiffness: float  # exact tangent stiffness K of the joint [N m/rad]
    # dK/dF [N m/rad per N], F the largest assembly preload of one bolt or pin; 0 where a connection
    # slips.
    slope: float
    elasticity: float  # d ln K/d ln F [-]


@dataclass(frozen=True, kw_only=True)
class WindupShare:
    """Share of an element in wind-up and compliance of its joint."""

    joint: int  # 1-based
    case: str
    element: str
    kind: str  # kind of connection, such as "reducer"
    share: float  # of the wind-up from zero to the torque of the case [-]
    compliance_share: float  # of the tangent compliance at that torque [-]


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivities to the preloads and shares of the elements at one design."""

    worth: tuple[PreloadWorth, ...]  # every free element in every load case
    # Every element of the study's joints in every load case, from motor to link; shares of a joint
    # and case sum to 1.
    shares: tuple[WindupShare, ...]
    # By joint number: largest share of the wind-up under the largest torque of the joint.
    weakest: dict[int, str]


def sensitivity(model: PreloadModel, preloads: np.ndarray) -> Sensitivity:
    """Compute sensitivities to the largest preloads [N] and shares of the elements in wind-up.

    Stiffness and shares follow the exact law. The slope is -K^2 dC/dF with the derivative of the
    smooth law, valid up to 0.95 of the slip torque.
    """
    shares = tuple(_windup_shares(model, preloads))
    weakest = {}
    for joint in model.problem.joints:
        case = largest_torque(model, joint).name
        own = [s for s in shares if s.joint == joint and s.case == case]
        weakest[joint] = max(own, key=lambda s: s.share).element
    return Sensitivity(tuple(_preload_worths(model, preloads)), shares, weakest)


def largest_torque(model: PreloadModel, joint: int) -> LoadCase:
    """Return the load case with the largest torque at a joint (1-based), nearest to slip."""
    return max(model.cases, key=lambda case: abs(float(case.torque[joint - 1])))


def _preload_worths(model: PreloadModel, preloads: np.ndarray) -> Iterator[PreloadWorth]:
    slopes = compliance_slopes(model, preloads)
    stiffness = model.exact_stiffness(preloads)
    for index, element in enumerate(model.elements):
        part, row = model.slices[index], model.problem.joints.index(element.joint)
        mean = float(np.mean(preloads[part]))
        for column, case in enumerate(model.cases):
            own = float(stiffness[row, column])
            # All bolts or pins of the element together.
            slope = -(own**2) * float(slopes[row, column, part].sum())
            yield PreloadWorth(
                key=element.key,
                joint=element.joint,
                case=case.name,
                stiffness=own,
                slope=slope,
                elasticity=slope * mean / own if own > 0.0 else 0.0,
            )


def compliance_slopes(model: PreloadModel, preloads: np.ndarray) -> np.ndarray:
    """Derivatives of tangent compliances by preloads (joints, cases, size) [rad/(N m) per N]."""
    symbol = ca.SX.sym("preload", model.size)
    joints = model.problem.joints
    values = [model.compliances(symbol, joint) for joint in joints]
    slope = ca.jacobian(ca.vertcat(*values), symbol)
    function = ca.Function("slopes", [symbol], [ca.densify(slope)])
    return np.asarray(function(preloads)).reshape(len(joints), len(model.cases), model.size)


def _windup_shares(model: PreloadModel, preloads: np.ndarray) -> Iterator[WindupShare]:
    for joint in model.problem.joints:
        chain = model.drivetrain(preloads, joint)
        owners, kinds = model.owners(joint), {}
        for stage in chain.stages:
            kinds[owners[stage.element.name]] = stage.element.kind
        for case in model.cases:
            torque = float(case.torque[joint - 1])
            angles: dict[str, float] = dict.fromkeys(kinds, 0.0)
            slopes = dict(angles)
            by_angle, by_slope = windup_shares(chain, torque), compliance_shares(chain, torque)
            for name, owner in owners.items():
                angles[owner] += by_angle[name]
                slopes[owner] += by_slope[name]
            for name, kind in kinds.items():
                yield WindupShare(
                    joint=joint,
                    case=case.name,
                    element=name,
                    kind=kind,
                    share=angles[name],
                    compliance_share=slopes[name],
                )


@dataclass(frozen=True, kw_only=True)
class LoosenedConnection:
    """Joint with one connection at a fraction of its preload, under its largest torque."""

    key: str
    joint: int  # 1-based
    fraction: float  # of the least preload in service, for all bolts or pins of the element [-]
    case: str  # load case with the largest torque at the joint
    slip_safety: float  # slip torque over torque [-]; infinite without torque
    first_slip: bool  # the rim of the ring slips; pins at one radius slip simultaneously
    slips: bool  # the whole connection slips
    stiffness: float  # tangent stiffness of the joint by the exact law [N m/rad]; 0 in slip
    lost: float  # relative loss of the joint stiffness [-]


@dataclass(frozen=True)
class Loosening:
    """Joints of a study with one connection loosened at a time."""

    rows: tuple[LoosenedConnection, ...]
    # By element key: fraction of the least preload below which the rim, or the whole connection,
    # slips under the largest torque [-]; above 1 if it slips at full preload.
    first_slip_fraction: dict[str, float]
    slip_fraction: dict[str, float]


def loosening(
    model: PreloadModel,
    preloads: np.ndarray,
    fractions: Sequence[float] = (1.0, 0.8, 0.5, 0.3),
) -> Loosening:
    """Loosen one connection at a time, to fractions of its least preload in service.

    `preloads` (size,): largest assembly preloads [N].
    """
    rims = [first_slip_torque(model, preloads, i) for i in range(len(model.elements))]
    slips = [float(model.slip_torque(preloads, i)) for i in range(len(model.elements))]
    rows: list[LoosenedConnection] = []
    first: dict[str, float] = {}
    whole: dict[str, float] = {}
    for index, (element, rim, slip) in enumerate(zip(model.elements, rims, slips, strict=True)):
        torque = abs(float(largest_torque(model, element.joint).torque[element.joint - 1]))
        # Both slip torques are proportional to the remaining preload.
        first[element.key], whole[element.key] = torque / rim, torque / slip
        rows += _loosened_rows(
            model, preloads, index, fractions, first[element.key], whole[element.key]
        )
    return Loosening(tuple(rows), first, whole)


def first_slip_torque(model: PreloadModel, preloads: np.ndarray, index: int) -> float:
    """Return the joint torque at first slip of an element at the least mean preload [N m].

    A ring slips first at its rim; pins slip simultaneously.
    """
    element = model.elements[index]
    connection = element.stage.element
    if not isinstance(connection, BoltedFlange):
        return float(model.slip_torque(preloads, index))
    own = preloads[model.slices[index]]
    least = float(np.mean(element.least(own)))
    return float(connection.first_slip_torque(least)) * element.stage.reduction


def loosen_element(
    model: PreloadModel, preloads: np.ndarray, index: int, fraction: float
) -> np.ndarray:
    """Return the design vector with a fraction of the least preloads of one element [N]."""
    element, own = model.elements[index], preloads[model.slices[index]]
    return model.replaced(preloads, index, element.largest(fraction * element.least(own)))


def _loosened_rows(
    model: PreloadModel,
    preloads: np.ndarray,
    index: int,
    fractions: Sequence[float],
    first: float,
    whole: float,
) -> Iterator[LoosenedConnection]:
    element = model.elements[index]
    case = largest_torque(model, element.joint)
    torque = np.array([case.torque[element.joint - 1]])
    tight = 1.0 / float(model.exact_compliance(preloads, element.joint, torque)[0])
    for fraction in fractions:
        slips = fraction <= whole
        left = 0.0
        if not slips:
            changed = loosen_element(model, preloads, index, fraction)
            left = 1.0 / float(model.exact_compliance(changed, element.joint, torque)[0])
        yield LoosenedConnection(
            key=element.key,
            joint=element.joint,
            fraction=float(fraction),
            case=case.name,
            slip_safety=fraction / whole if whole > 0.0 else np.inf,
            first_slip=fraction < first,
            slips=slips,
            stiffness=left,
            lost=1.0 - left / tight if tight > 0.0 else 0.0,
        )
