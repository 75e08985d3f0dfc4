"""Uncertain parameters of an elastic arm: bounds, corners and random draws."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from stiffopt.declaration import POSITIVE, Bounds, Doc, Frequency, Ratio, Time, check_fields
from stiffopt.elastic.servo import Servo
from stiffopt.errors import ProblemError

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Bounds where none are stated: identified position loops vary by a fifth, and the inertia that the
# torque feed-forward relies on is known within a tenth.
_SERVO_BANDWIDTH_RATIO, _TORQUE_FEED_FORWARD_BOUND = 0.8, 0.1
# Mean square of a parameter that lies evenly between its bounds, over the bound's.
UNIFORM_MEAN_SQUARE = 1.0 / 3.0


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
    ] = 100
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

    def led_servo(self, servo: Servo) -> Servo:
        """Return the servo that a command leads, about a nominal one that is not exact.

        Its lag lies midway between the nominal and the worst one's, so that the largest error of
        both is least.
        """
        worst = self.worst_servo(servo)
        if servo.leads_exactly or worst == servo:
            return servo
        both = [vars(each) for each in (servo, worst)]
        middle: dict[str, Any] = {
            name: float(np.mean([own[name] for own in both]))
            for name in ("feed_forward", "torque_feed_forward", "delay")
        }
        middle["bandwidth"] = float(1.0 / np.mean([1.0 / own["bandwidth"] for own in both]))
        return replace(servo, **middle)

    def shares(self, joints: int) -> np.ndarray:
        """Shares (n,) by which the stiffness of each joint may be off.

        Raises `ProblemError`: their number is not that of the joints.
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
    """Departure of an arm's parameters from their nominal values."""

    stiffness: np.ndarray  # (n,) factor of each joint's stiffness
    bearings: np.ndarray | float = 1.0  # (n,) or float: factor of each output bearing's stiffness
    # Factors of their nominal values.
    damping: float = 1.0
    payload: float = 1.0
    servo: float = 0.0  # share of the difference of the worst servo to the nominal one, 0 to 1
    label: str = "nominal"  # description for reports

    @classmethod
    def none(cls, joints: int) -> Departure:
        """Return the nominal arm."""
        return cls(stiffness=np.ones(joints))

    def factors(self) -> dict[str, Any]:
        """Return all factors as plain numbers."""
        numbers = {name: getattr(self, name) for name in ("damping", "payload", "servo")}
        bearings = np.broadcast_to(self.bearings, self.stiffness.shape).tolist()
        return {"stiffness": self.stiffness.tolist(), "bearings": bearings, **numbers}


class ParameterBox:
    """Uncertain arms: each parameter lies anywhere between its bounds, evenly and independently.

    Worst arms, sampled arms and error budgets refer to this one set. Levels (2 n + 3,) from -1 to 1
    place an arm in it: stiffness of the joints, of their bearings, damping, payload and servo.

    Parameters
    ----------
    uncertainty : Uncertainty
    robot : Robot
    servo : bool
        True where the servo is uncertain.

    Attributes
    ----------
    free : array (m,)
        Levels that matter.
    """

    def __init__(self, uncertainty: Uncertainty, robot: Robot, *, servo: bool = True) -> None:
        self._uncertainty, self._joints = uncertainty, robot.n
        yields = [chain is not None for chain in robot.chains]
        self._bounds = np.concatenate(
            [
                uncertainty.shares(robot.n) * yields,
                uncertainty.bearing_stiffness * np.array([bool(each) for each in robot.mounts]),
                [uncertainty.damping, uncertainty.payload * (robot.payload is not None), servo],
            ]
        )
        self.free = np.flatnonzero(self._bounds)

    @property
    def nominal(self) -> np.ndarray:
        """Levels (2 n + 3,) of the arm as modelled."""
        return np.append(np.zeros(2 * self._joints + 2), -1.0)

    def kind(self, place: int) -> str:
        """Return the kind of parameter of a level."""
        kinds = ["stiffness", "bearing", "damping", "payload", "servo"]
        return kinds[
            place // self._joints if place < 2 * self._joints else place + 2 - 2 * self._joints
        ]

    def departure(self, levels: np.ndarray, label: str = "") -> Departure:
        """Return the arm at given levels; its label describes it if none is given."""
        away, n = levels * self._bounds, self._joints
        return Departure(
            stiffness=1.0 + away[:n],
            bearings=1.0 + away[n : 2 * n],
            damping=1.0 + float(away[-3]),
            payload=1.0 + float(away[-2]),
            servo=0.5 * float(self._bounds[-1] + away[-1]),
            label=label or ", ".join(_describe_departure(away, n)) or "nominal",
        )

    def alike_corners(self) -> np.ndarray:
        """Levels (c, 2 n + 3) of the corners where joints and bearings are soft or stiff alike."""
        groups = [slice(0, 2 * self._joints), *range(-3, 0)]
        varies = [bool(np.any(self._bounds[each])) for each in groups]
        signs = list(product(*((-1.0, 1.0) if each else (0.0,) for each in varies)))
        found = np.zeros((len(signs), len(self._bounds)))
        for k, each in enumerate(groups):
            values = np.array(signs)[:, k]
            found[:, each] = values[:, None] if isinstance(each, slice) else values
        return found * (self._bounds > 0.0)

    def drawn(self) -> list[Departure]:
        """Draw the arms of the uncertainty's number and seed."""
        random, n = np.random.default_rng(self._uncertainty.seed), self._joints
        # A stream of its own: arms without elastic bearings are drawn as before.
        (of_bearings,) = random.spawn(1)
        found = []
        for number in range(1, self._uncertainty.draws + 1):
            stiffness, rest = random.uniform(-1.0, 1.0, n), random.uniform(-1.0, 1.0, 3)
            levels = np.concatenate([stiffness, of_bearings.uniform(-1.0, 1.0, n), rest])
            found.append(self.departure(levels, f"draw {number}"))
        return found


def bounds_from_deviations(
    uncertainty: Uncertainty, stiffness: np.ndarray, payload: float = np.nan
) -> Uncertainty:
    """Return the uncertainty whose parameters have relative standard deviations, NaN if unknown.

    The bound of a stiffness is limited to 99 %: it must stay positive. `stiffness` (n,): relative
    standard deviation of each joint's. `payload`: relative standard deviation of its mass.
    """
    if not np.isnan(payload):
        uncertainty = replace(uncertainty, payload=min(payload / np.sqrt(UNIFORM_MEAN_SQUARE), 1.0))
    if np.all(np.isnan(stiffness)):
        return uncertainty
    shares = uncertainty.shares(len(stiffness))
    known = np.where(
        np.isnan(stiffness),
        shares,
        np.minimum(np.nan_to_num(stiffness) / np.sqrt(UNIFORM_MEAN_SQUARE), 0.99),
    )
    return replace(uncertainty, stiffness=tuple(float(share) for share in known))


def _describe_departure(away: np.ndarray, joints: int) -> Iterator[str]:
    """Describe relative departures of stiffnesses, bearings, damping and payload, and the servo."""
    for first, what in ((0, "stiffness"), (joints, "bearings")):
        own = away[first : first + joints]
        if own.any():
            alike = np.all(own == own[0])
            yield f"{what} {f'{100 * own[0]:+.3g} %' if alike else _list_by_size(own)}"
    for value, what in ((away[-3], "damping"), (away[-2], "payload")):
        if value:
            yield f"{what} {100 * value:+.3g} %"
    if away[-1] > 0.0:
        yield "worst servo"


def _list_by_size(shares: np.ndarray) -> str:
    sizes: dict[str, list[str]] = {}
    for j, share in enumerate(shares, start=1):
        if share:
            sizes.setdefault(f"{100 * share:+.3g} %", []).append(str(j))
    return ", ".join(f"{size} of J{'/'.join(own)}" for size, own in sizes.items())
