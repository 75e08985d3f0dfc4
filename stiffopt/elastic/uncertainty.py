"""Uncertain parameters of an elastic arm: bounds, corner cases and random draws."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated, Any, ClassVar

import numpy as np

from stiffopt.declaration import POSITIVE, Bounds, Doc, Frequency, Ratio, Time, check_fields
from stiffopt.elastic.servo import Servo
from stiffopt.errors import ProblemError

# Bounds where none are stated: identified position loops vary by a fifth, and the inertia that the
# torque feed-forward relies on is known within a tenth.
_SERVO_BANDWIDTH_RATIO, _TORQUE_FEED_FORWARD_BOUND = 0.8, 0.1
# 95 % interval of a normal distribution.
_BOUND_IN_STANDARD_DEVIATIONS = 2.0


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """Bounds of the arm's parameters; motion and command are judged by the worst case.

    Where stated, a plan whose tool_deviation is up to `price` above the least is chosen if its
    command gains more on the worst arm than the plan costs.
    """

    stiffness: Annotated[
        Ratio | tuple[Ratio, ...],
        Bounds(least=0.0),
        Doc("Relative bound of the stiffness of each joint, one number or one a joint."),
    ] = 0.2
    bearing_stiffness: Annotated[
        Ratio,
        Bounds(least=0.0, below=1.0),
        Doc("Relative bound of the stiffness of each output bearing and bending link."),
    ] = 0.2
    damping: Annotated[
        Ratio, Bounds(least=0.0), Doc("Relative bound of the damping of the joints.")
    ] = 0.5
    payload: Annotated[
        Ratio,
        Bounds(least=0.0, most=1.0),
        Doc("Relative bound of mass and inertia of the payload."),
    ] = 0.1
    servo_bandwidth: Annotated[
        Frequency | None,
        POSITIVE,
        Doc("Least bandwidth of the motors' position loops; default 0.8 of that of [servo]."),
    ] = None
    servo_feed_forward: Annotated[
        Ratio | None,
        Bounds(least=0.0, most=1.0),
        Doc("Least velocity feed-forward of the loops, as a share; default that of [servo]."),
    ] = None
    servo_torque_feed_forward: Annotated[
        Ratio | None,
        Bounds(least=0.0, most=1.0),
        Doc("Least torque feed-forward of the loops, as a share; default 0.1 below [servo]."),
    ] = None
    servo_delay: Annotated[
        Time | None,
        Bounds(least=0.0),
        Doc("Largest dead time of the loops; default that of [servo]."),
    ] = None
    price: Annotated[
        Ratio,
        Bounds(least=0.0, most=1.0),
        Doc("Relative increase of tool_deviation allowed for a better command."),
    ] = 0.2
    draws: Annotated[
        int, Bounds(least=50, most=10000), Doc("Number of random arms for the distribution.")
    ] = 60
    seed: Annotated[int, Bounds(least=0), Doc("Seed of the random draws.")] = 1
    # Stated by the user; `AssumedUncertainty` holds the defaults otherwise.
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
        # The servo's own check refuses an unstable loop.
        self.worst_servo(Servo())

    def worst_servo(self, servo: Servo) -> Servo:
        """Return the worst servo within the bounds, about a nominal one."""

        def given(value: float | None, default: float | None) -> float | None:
            return default if value is None else value

        torque = max((servo.torque_feed_forward or 0.0) - _TORQUE_FEED_FORWARD_BOUND, 0.0)
        slowest = _SERVO_BANDWIDTH_RATIO * (servo.bandwidth or 0.0)
        return replace(
            servo,
            bandwidth=given(self.servo_bandwidth, slowest),
            feed_forward=given(self.servo_feed_forward, servo.feed_forward),
            torque_feed_forward=given(self.servo_torque_feed_forward, torque),
            delay=given(self.servo_delay, servo.delay),
        )

    def shares(self, joints: int) -> np.ndarray:
        """Shares (n,) by which the stiffness of each joint may be off.

        Raises
        ------
        ProblemError
            Their number is not that of the joints.
        """
        given = np.atleast_1d(np.asarray(self.stiffness, dtype=float))
        if given.size not in (1, joints):
            raise ProblemError(
                f"uncertainty.stiffness has {given.size} numbers; allowed: one, or one for each of "
                f"the {joints} joints."
            )
        return np.array(np.broadcast_to(given, (joints,)))

    def statements(self, carries: bool, servo: Servo | None = None) -> tuple[str, ...]:
        """Describe the bounds, those of a payload and about a nominal servo on request."""
        shares = np.atleast_1d(np.asarray(self.stiffness, dtype=float))
        sizes = "/".join(f"{100 * share:.3g}" for share in dict.fromkeys(shares.tolist()))
        found = [f"stiffness of each joint within {sizes} %", f"damping {100 * self.damping:.3g} %"]
        if carries:
            found.append(f"payload {100 * self.payload:.3g} %")
        if servo is not None:
            found.append(f"servo of {servo}, at least {self.worst_servo(servo)}")
        return tuple(found)


class AssumedUncertainty(Uncertainty):
    """Default uncertainty where none is stated: used to judge plans, not to change them."""

    stated: ClassVar[bool] = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Departure:
    """Departure of an arm's parameters from their nominal values.

    Parameters
    ----------
    stiffness : array (n,)
        Factor of each joint's stiffness.
    bearings : array (n,) or float
        Factor of each output bearing's stiffness.
    damping, payload : float
        Factors of their nominal values.
    servo : float
        Share of the difference of the worst servo to the nominal one, 0 to 1.
    label : str
        Description for reports.
    """

    stiffness: np.ndarray
    bearings: np.ndarray | float = 1.0
    damping: float = 1.0
    payload: float = 1.0
    servo: float = 0.0
    label: str = "nominal"

    @classmethod
    def none(cls, joints: int) -> Departure:
        """Return the nominal arm."""
        return cls(stiffness=np.ones(joints))

    def factors(self) -> dict[str, Any]:
        """Return all factors as plain numbers."""
        numbers = {name: getattr(self, name) for name in ("damping", "payload", "servo")}
        bearings = np.broadcast_to(self.bearings, self.stiffness.shape).tolist()
        return {"stiffness": self.stiffness.tolist(), "bearings": bearings, **numbers}


def corners(
    uncertainty: Uncertainty, joints: int, carries: bool, *, servo: bool = True
) -> list[Departure]:
    """Return the corner cases: every parameter at a bound, all stiffnesses alike.

    Parameters
    ----------
    uncertainty : Uncertainty
    joints : int
    carries : bool
        True with a payload.
    servo : bool
        True where the servo is uncertain.
    """
    shares = uncertainty.shares(joints)
    return [
        departure_at_bounds(uncertainty, signs * np.ones(joints), damping, payload, share)
        for signs, damping, payload, share in product(
            _bound_signs(bool(shares.any())),
            _bound_signs(uncertainty.damping > 0.0),
            _bound_signs(carries and uncertainty.payload > 0.0),
            (0.0, 1.0) if servo else (0.0,),
        )
    ]


def one_at_a_time(uncertainty: Uncertainty, joints: int) -> list[Departure]:
    """Return departures with one joint at its lower stiffness bound."""
    shares = uncertainty.shares(joints)
    return [
        departure_at_bounds(uncertainty, -np.eye(joints)[j], 0.0, 0.0, 0.0)
        for j in np.flatnonzero(shares)
    ]


def departure_at_bounds(
    uncertainty: Uncertainty, signs: np.ndarray, damping: float, payload: float, servo: float
) -> Departure:
    """Return the departure at bounds of given signs: stiffness (n,), damping, payload.

    Bearings are soft or stiff as the joints are in their sum.
    """
    shares = uncertainty.shares(len(signs))
    return Departure(
        stiffness=1.0 + signs * shares,
        bearings=1.0 + float(np.sign(signs.sum())) * uncertainty.bearing_stiffness,
        damping=1.0 + damping * uncertainty.damping,
        payload=1.0 + payload * uncertainty.payload,
        servo=servo,
        label=", ".join(_describe_departure(uncertainty, signs * shares, damping, payload, servo))
        or "nominal",
    )


def draw_departures(
    uncertainty: Uncertainty, joints: int, carries: bool, *, servo: bool = True
) -> list[Departure]:
    """Draw departures uniformly within the bounds, joints independently."""
    random = np.random.default_rng(uncertainty.seed)
    # A stream of its own: arms without elastic bearings are drawn as before.
    (of_bearings,) = random.spawn(1)
    shares = uncertainty.shares(joints)
    found = []
    for number in range(1, uncertainty.draws + 1):
        stiffness, rest = random.uniform(-1.0, 1.0, joints), random.uniform(-1.0, 1.0, 3)
        found.append(
            Departure(
                stiffness=1.0 + stiffness * shares,
                bearings=1.0
                + of_bearings.uniform(-1.0, 1.0, joints) * uncertainty.bearing_stiffness,
                damping=1.0 + float(rest[0]) * uncertainty.damping,
                payload=1.0 + float(rest[1]) * uncertainty.payload * carries,
                servo=0.5 * (1.0 + float(rest[2])) if servo else 0.0,
                label=f"draw {number}",
            )
        )
    return found


def bounds_from_deviations(
    uncertainty: Uncertainty, stiffness: np.ndarray, payload: float = np.nan
) -> Uncertainty:
    """Return the uncertainty with bounds of two relative standard deviations, NaN if unknown.

    The bound of a stiffness is limited to 99 %: it must stay positive.

    Parameters
    ----------
    uncertainty : Uncertainty
    stiffness : array (n,)
        Relative standard deviation of each joint's.
    payload : float
        Relative standard deviation of its mass.
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
        yield "worst servo"


def _describe_joint_stiffness(stiffness: np.ndarray) -> str:
    sizes = {f"{100 * share:+.3g} %": [] for share in stiffness if share}  # type: dict[str, list[str]]
    for j, share in enumerate(stiffness, start=1):
        if share:
            sizes[f"{100 * share:+.3g} %"].append(str(j))
    return ", ".join(f"{size} of J{'/'.join(own)}" for size, own in sizes.items())
