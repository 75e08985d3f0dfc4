"""What is not known exactly of an arm: how far it may be off, and arms drawn from within it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from stiffopt.declaration import POSITIVE, Bounds, Doc, Frequency, Ratio, Time, check_fields
from stiffopt.errors import ProblemError

if TYPE_CHECKING:
    from stiffopt.elastic.motor import Servo

# Of a normal distribution, taken as the bounds of what is possible: 95 %.
_BOUND_IN_STANDARD_DEVIATIONS = 2.0


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """How far the arm may be from its model: motion and command are judged by the worst case.

    Where it is stated, of plans with tool_deviation up to `price` above the least that one is taken
    whose command does best on the worst arm, if it gains more there than it costs.
    """

    stiffness: Annotated[
        Ratio | tuple[Ratio, ...],
        Bounds(least=0.0),
        Doc("Share by which the stiffness of each joint may be off, one number or one a joint."),
    ] = 0.2
    damping: Annotated[
        Ratio, Bounds(least=0.0), Doc("Share by which the damping of the joints may be off.")
    ] = 0.5
    payload: Annotated[
        Ratio,
        Bounds(least=0.0, most=1.0),
        Doc("Share by which mass and inertia of the payload may be off."),
    ] = 0.1
    servo_bandwidth: Annotated[
        Frequency, POSITIVE, Doc("Bandwidth that the motors' position loops have at least.")
    ] = 20.0
    servo_feed_forward: Annotated[
        Ratio,
        Bounds(least=0.0, most=1.0),
        Doc("Share of the command's velocity that the loops are fed forward at least."),
    ] = 1.0
    servo_delay: Annotated[
        Time, Bounds(least=0.0), Doc("Dead time that the loops have at most.")
    ] = 0.0
    price: Annotated[
        Ratio,
        Bounds(least=0.0, most=1.0),
        Doc("Share by which tool_deviation may be above the least for a command that does better."),
    ] = 0.2
    draws: Annotated[
        int, Bounds(least=50, most=10000), Doc("Arms that are drawn for the distribution.")
    ] = 60
    seed: Annotated[int, Bounds(least=0), Doc("Of the draws.")] = 1
    # Whether somebody said so; a class of its own holds what is assumed where nobody did.
    stated: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_fields(self, "uncertainty", ProblemError)
        for share in np.atleast_1d(np.asarray(self.stiffness, dtype=float)):
            if share >= 1.0:
                raise ProblemError(
                    f"uncertainty.stiffness = {share:g} lets the stiffness of a joint be zero or "
                    "negative; allowed: from 0 to below 1. Give a smaller share."
                )
        if self.damping > 1.0:
            raise ProblemError(
                f"uncertainty.damping = {self.damping:g} lets the damping of a joint be negative; "
                "allowed: from 0 to 1. Give a smaller share."
            )
        # An unstable loop is refused with the servo's own sentence.
        _ = self.servo

    @property
    def servo(self) -> Servo | None:
        """The worst servo; None where it follows exactly, with all of the velocity and at once."""
        from stiffopt.elastic.motor import Servo

        loop = Servo(self.servo_bandwidth, self.servo_feed_forward, self.servo_delay)
        return None if loop.follows_exactly else loop

    def shares(self, joints: int) -> np.ndarray:
        """Shares (n,) by which the stiffness of each joint may be off.

        Raises
        ------
        ProblemError
            They are of another number of joints.
        """
        given = np.atleast_1d(np.asarray(self.stiffness, dtype=float))
        if given.size not in (1, joints):
            raise ProblemError(
                f"uncertainty.stiffness has {given.size} numbers; allowed: one, or one for each of "
                f"the {joints} joints."
            )
        return np.array(np.broadcast_to(given, (joints,)))

    def statements(self, carries: bool, servo: bool = True) -> tuple[str, ...]:
        """What is uncertain, in words: of a payload and of the servos, where they are."""
        shares = np.atleast_1d(np.asarray(self.stiffness, dtype=float))
        sizes = "/".join(f"{100 * share:.3g}" for share in dict.fromkeys(shares.tolist()))
        from stiffopt.elastic.motor import Servo

        found = [f"stiffness of each joint within {sizes} %", f"damping {100 * self.damping:.3g} %"]
        if carries:
            found.append(f"payload {100 * self.payload:.3g} %")
        if servo:
            loop = Servo(self.servo_bandwidth, self.servo_feed_forward, self.servo_delay)
            found.append(f"servo of at least {loop}")
        return tuple(found)


class AssumedUncertainty(Uncertainty):
    """What is taken to be uncertain where nothing is stated: it judges, and changes no plan."""

    stated: ClassVar[bool] = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Departure:
    """An arm as it may be.

    Parameters
    ----------
    stiffness : array (n,)
        Of each joint, times its nominal one.
    damping, payload : float
        Times their nominal values.
    servo : float
        How much of the worst servo's lag the motors have, 0 to 1.
    label : str
        In words, for reports.
    """

    stiffness: np.ndarray
    damping: float = 1.0
    payload: float = 1.0
    servo: float = 0.0
    label: str = "nominal"

    @classmethod
    def none(cls, joints: int) -> Departure:
        """The nominal arm."""
        return cls(stiffness=np.ones(joints))

    def factors(self) -> dict[str, Any]:
        """Plain numbers: everything but the label."""
        numbers = {name: getattr(self, name) for name in ("damping", "payload", "servo")}
        return {"stiffness": self.stiffness.tolist(), **numbers}


def corners(uncertainty: Uncertainty, joints: int, carries: bool) -> list[Departure]:
    """Arms with every uncertainty at one of its bounds, all joints' stiffness alike.

    Parameters
    ----------
    uncertainty : Uncertainty
    joints : int
    carries : bool
        Whether there is a payload.
    """
    shares = uncertainty.shares(joints)
    return [
        departure_at_bounds(uncertainty, signs * np.ones(joints), damping, payload, servo)
        for signs, damping, payload, servo in product(
            _bound_signs(bool(shares.any())),
            _bound_signs(uncertainty.damping > 0.0),
            _bound_signs(carries and uncertainty.payload > 0.0),
            (0.0,) if uncertainty.servo is None else (0.0, 1.0),
        )
    ]


def one_at_a_time(uncertainty: Uncertainty, joints: int) -> list[Departure]:
    """Arms of which one joint is softer than the model."""
    shares = uncertainty.shares(joints)
    return [
        departure_at_bounds(uncertainty, -np.eye(joints)[j], 0.0, 0.0, 0.0)
        for j in np.flatnonzero(shares)
    ]


def departure_at_bounds(
    uncertainty: Uncertainty, signs: np.ndarray, damping: float, payload: float, servo: float
) -> Departure:
    """An arm at the bounds: signs (n,) of the joints' stiffness, of damping and payload; servo."""
    shares = uncertainty.shares(len(signs))
    return Departure(
        stiffness=1.0 + signs * shares,
        damping=1.0 + damping * uncertainty.damping,
        payload=1.0 + payload * uncertainty.payload,
        servo=servo,
        label=", ".join(_describe_departure(uncertainty, signs * shares, damping, payload, servo))
        or "nominal",
    )


def draw_departures(uncertainty: Uncertainty, joints: int, carries: bool) -> list[Departure]:
    """Arms drawn evenly from within the bounds, each joint's stiffness on its own."""
    random = np.random.default_rng(uncertainty.seed)
    shares = uncertainty.shares(joints)
    found = []
    for number in range(1, uncertainty.draws + 1):
        stiffness, rest = random.uniform(-1.0, 1.0, joints), random.uniform(-1.0, 1.0, 3)
        found.append(
            Departure(
                stiffness=1.0 + stiffness * shares,
                damping=1.0 + float(rest[0]) * uncertainty.damping,
                payload=1.0 + float(rest[1]) * uncertainty.payload * carries,
                servo=0.0 if uncertainty.servo is None else 0.5 * (1.0 + float(rest[2])),
                label=f"draw {number}",
            )
        )
    return found


def bounds_from_deviations(
    uncertainty: Uncertainty, stiffness: np.ndarray, payload: float = np.nan
) -> Uncertainty:
    """The same with bounds by relative standard deviations, NaN where unknown.

    Two standard deviations are taken as the bound; at 99 % a stiffness is as good as unknown.

    Parameters
    ----------
    uncertainty : Uncertainty
    stiffness : array (n,)
        Of each joint.
    payload : float
        Of its mass.
    """
    if not np.isnan(payload):
        uncertainty = replace(
            uncertainty, payload=min(_BOUND_IN_STANDARD_DEVIATIONS * payload, 1.0)
        )
    if np.all(np.isnan(stiffness)):
        return uncertainty
    shares = uncertainty.shares(len(stiffness))
    known = np.where(
        np.isnan(stiffness),
        shares,
        np.minimum(_BOUND_IN_STANDARD_DEVIATIONS * np.nan_to_num(stiffness), 0.99),
    )
    return replace(uncertainty, stiffness=tuple(float(share) for share in known))


def _bound_signs(varies: bool) -> tuple[float, ...]:
    return (-1.0, 1.0) if varies else (0.0,)


def _describe_departure(
    uncertainty: Uncertainty, stiffness: np.ndarray, damping: float, payload: float, servo: float
) -> Iterator[str]:
    if stiffness.any():
        alike = np.all(stiffness == stiffness[0])
        own = f"{100 * stiffness[0]:+.3g} %" if alike else _describe_joint_stiffness(stiffness)
        yield f"stiffness {own}"
    if damping * uncertainty.damping:
        yield f"damping {100 * damping * uncertainty.damping:+.3g} %"
    if payload * uncertainty.payload:
        yield f"payload {100 * payload * uncertainty.payload:+.3g} %"
    if servo:
        yield f"servo of {uncertainty.servo_bandwidth:g} Hz"


def _describe_joint_stiffness(stiffness: np.ndarray) -> str:
    sizes = {f"{100 * share:+.3g} %": [] for share in stiffness if share}  # type: dict[str, list[str]]
    for j, share in enumerate(stiffness, start=1):
        if share:
            sizes[f"{100 * share:+.3g} %"].append(str(j))
    return ", ".join(f"{size} of J{'/'.join(own)}" for size, own in sizes.items())
