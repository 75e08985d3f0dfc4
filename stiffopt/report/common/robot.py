"""Properties of a robot used by all reports: units of joints, estimated inputs, element kinds."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass

from stiffopt.connection.connection import connection_kinds
from stiffopt.drivetrain.chain import Chain
from stiffopt.exact.chain import compliance_shares, windup_shares
from stiffopt.report.common.svg import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION
from stiffopt.robot.robot import Robot
from stiffopt.units import joint_unit

# Colours of the kinds of connections, in the order of their names.
_KIND_COLOURS = (GREEN, PURPLE, BLACK, SKY, VERMILLION, BLUE, GREY, ORANGE)


@dataclass(frozen=True)
class JointUnits:
    """Label of a joint on a page and the units in which its quantities are shown."""

    label: str
    position: str  # degrees or millimetres
    windup: str  # milliradians or millimetres
    rate: str  # of acceleration and jerk without the seconds; shown in SI
    torque: str  # or force
    stiffness: str


def joint_units(robot: Robot) -> list[JointUnits]:
    """Return labels J1.. and units of a robot's joints."""
    quantities = ("deg", "mrad", "rad", "N m", "N m/rad")
    return [
        JointUnits(f"J{number}", *(joint_unit(unit, bool(prismatic)) for unit in quantities))
        for number, prismatic in enumerate(robot.prismatic, start=1)
    ]


def common_unit(units: list[str]) -> str:
    """Return the unit of an axis; several joined by "or" where the joints differ."""
    return " or ".join(dict.fromkeys(units))


@dataclass(frozen=True)
class EstimatedInputs:
    """Estimated inputs of one element (or of a joint, or the robot) from one source."""

    joint: str
    element: str
    source: str
    inputs: tuple[str, ...]


def estimated_inputs(robot: Robot, joints: Container[str] | None = None) -> list[EstimatedInputs]:
    """List the inputs of a robot that are estimated: of no joint, and of these (default: all)."""
    keys: dict[tuple[str, str, str], list[str]] = {}
    for each in robot.estimated():
        if joints is None or not each.joint or each.joint in joints:
            keys.setdefault((each.joint, each.element, each.source), []).append(each.key)
    return [EstimatedInputs(*place, tuple(names)) for place, names in keys.items()]


def element_colour(kind: str) -> str:
    """Colour of a kind of connection, the same in every figure."""
    return _KIND_COLOURS[list(connection_kinds()).index(kind) % len(_KIND_COLOURS)]


def windup_by_kind(chain: Chain | None, torque: float) -> dict[str, float]:
    """Share of the wind-up at a torque by kind of element, largest first; empty if rigid."""
    return {} if chain is None else _sum_by_kind(chain, windup_shares(chain, torque))


def compliance_by_kind(chain: Chain | None, torque: float) -> dict[str, float]:
    """Share of the tangent compliance at a torque by kind, largest first; empty if rigid."""
    return {} if chain is None else _sum_by_kind(chain, compliance_shares(chain, torque))


def _sum_by_kind(chain: Chain, shares: Mapping[str, float]) -> dict[str, float]:
    totals: dict[str, float] = {}
    for name, share in shares.items():
        kind = chain.elements[name].kind
        totals[kind] = totals.get(kind, 0.0) + float(share)
    return dict(sorted(totals.items(), key=lambda item: -item[1]))
