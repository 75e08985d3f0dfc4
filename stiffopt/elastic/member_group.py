"""Members of a batch simulation that advance together, in spans of time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.elastic import native
from stiffopt.elastic.linearization import LinearizedWeight, TabulatedSprings
from stiffopt.elastic.uncertainty import Departure

if TYPE_CHECKING:
    from stiffopt.elastic.uncertain_arms import Member, UncertainArms

_EQUILIBRIUM_ITERATIONS = 4
# Steps between the positions from whose difference the velocity without vibration is taken.
_RATE_STEPS = 4


class MemberGroup:
    """Members that advance together.

    Attributes
    ----------
    of : slice
        Their places among all members.
    """

    def __init__(self, many: UncertainArms, members: Sequence[Member], of: slice) -> None:
        self.of, self._many = of, many
        own = members[of]
        departures = many.departures(own)
        self._arms = DepartureArrays(departures)
        self._equilibria = many.equilibria(departures)
        self._commands = list(dict.fromkeys(each.command for each in own))
        self._which = np.array([self._commands.index(each.command) for each in own])
        self._links = self._rates = np.empty(0)

    def begin(self, step: int) -> None:
        """Place the members before a step: at rest before the flight, else without vibration."""
        many, before = self._many, max(step - 1, 0)
        if step == 0:
            turn = self._turns(before)
            arms = self._arms
            self._links = solve_equilibrium(many.springs, many.start, arms, turn[:, None])[:, 0]
            self._rates = np.zeros_like(self._links)
            return
        after = before + _RATE_STEPS
        self._links = self._links_without_vibration(before)
        moved = self._links_without_vibration(after) - self._links
        self._rates = moved / (many.step * _RATE_STEPS)

    def _links_without_vibration(self, step: int) -> np.ndarray:
        """Positions (B, n) of links less the plan that the planned torque holds at a step."""
        many, arms = self._many, self._arms
        poses = many.interpolation(slice(step, step + 1))
        at = min(step, many.torques.shape[1] - 1)
        planned, heavier = many.torques[:, at]
        static = between(many.weight.torque.swapaxes(0, 1), poses)[0]
        windups = [
            many.springs.windup((own + arms.payload * more) / arms.stiffness)
            for own, more in ((planned, heavier), (static[0], static[1]))
        ]
        return np.asarray(
            self.equilibrium(poses)[0] + self._turns(step) - (windups[0] - windups[1])
        )

    def _turns(self, step: int) -> np.ndarray:
        """Positions (B, n) of the motors less the plan at a step."""
        moved = self._motors(slice(step, step + 1))[0, self._which]
        return np.asarray(moved[:, 0] + self._arms.servo * moved[:, 2])

    def equilibrium(self, poses: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Static equilibria (K, B, n) at steps, as of `UncertainArms.equilibria`."""
        return between(self._equilibria, poses)

    def advance(self, steps: slice) -> np.ndarray:
        """Return positions of links less the plan (K, B, n) at the steps after the last ones."""
        first = max(steps.start - 1, 0)
        made = native.core(len(self._many.damping))
        moved = self._motors(slice(first, steps.stop))
        if made is None:
            found = self._integrate_numpy(first, moved)
        else:
            many, arms = self._many, self._arms
            found, self._rates = native.integrate_linearized(
                made,
                many.springs,
                many.rigid,
                self._links,
                self._rates,
                first=first,
                count=len(moved),
                flight=many.torques.shape[1],
                spans=many.bodies.shape[1],
                commands=moved.shape[1],
                step=many.step,
                bodies=many.bodies,
                torques=many.torques,
                span_of=many.span_of,
                commanded=moved,
                of=self._which,
                stiffness=arms.stiffness,
                damping=arms.damping * many.damping,
                payload=arms.payload,
                servo=arms.servo,
            )
        self._links = found[-1].copy()
        return found[steps.start - first :]

    def _motors(self, steps: slice) -> np.ndarray:
        return np.stack([self._many.motors(each)[steps] for each in self._commands], axis=1)

    def _integrate_numpy(self, first: int, moved: np.ndarray) -> np.ndarray:
        """Integrate without the compiled core, to the same result."""
        many, arms, rigid, of = self._many, self._arms, self._many.rigid, self._which
        damping, step, joints = arms.damping * many.damping, many.step, np.arange(len(many.damping))
        e, rate, now = self._links, self._rates, moved[0, of]
        turn, drive = now[:, 0] + arms.servo * now[:, 2], now[:, 1] + arms.servo * now[:, 3]
        found = [e]
        for k in range(first + 1, first + len(moved)):
            flies = k < many.torques.shape[1]
            own, more = many.bodies[:, many.span_of[k - 1] if flies else -1]
            planned, heavier = many.torques[:, k - 1 if flies else -1]
            bodies = own + arms.payload[..., None] * more
            right = np.einsum("bij,bj->bi", bodies[:, :, len(joints) :], np.hstack([rate, e]))
            before = arms.stiffness * many.springs.torque(turn - e) + damping * (drive - rate)
            now = moved[k - first, of]
            turn = now[:, 0] + arms.servo * now[:, 2]
            drive = now[:, 1] + arms.servo * now[:, 3]
            # Springs at the predicted position, linear from there to the end of the step.
            torque, tangent = many.springs.at(turn - e - step * rate)
            torque, tangent = arms.stiffness * torque, arms.stiffness * tangent
            ahead = torque + 0.5 * step * tangent * rate + damping * drive
            right += 0.5 * (before + ahead) - (planned + arms.payload * heavier)
            left = bodies[:, :, : len(joints)]
            left[:, joints, joints] += 0.5 * damping + 0.25 * step * tangent
            # Rigid joints follow their motors.
            left[:, rigid], left[:, rigid, rigid], right[:, rigid] = 0.0, 1.0, drive[:, rigid]
            new = np.linalg.solve(left, right[..., None])[..., 0]
            e, rate = e + 0.5 * step * (rate + new), new
            e[:, rigid] = turn[:, rigid]
            found.append(e)
        self._rates = rate
        return np.array(found)


def between(values: np.ndarray, places: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Values (K, ...) between those (M, ...) at the places before, by shares of the way (K,)."""
    left, share = places
    begin = values[left]
    return np.asarray(begin + share[:, None, None] * (values[left + 1] - begin))


class DepartureArrays:
    """Departures as arrays: stiffness (B, n), the others (B, 1)."""

    def __init__(self, departures: Sequence[Departure]) -> None:
        self.stiffness = np.array([each.stiffness for each in departures])
        self.damping = np.array([[each.damping] for each in departures])
        self.payload = np.array([[each.payload - 1.0] for each in departures])
        self.servo = np.array([[each.servo] for each in departures])


def solve_equilibrium(
    springs: TabulatedSprings, weight: LinearizedWeight, arms: DepartureArrays, turn: np.ndarray
) -> np.ndarray:
    """Static equilibrium (B, K, n) with the motors `turn` ahead of the poses of the weight."""
    static = weight.torque[0] + arms.payload[..., None] * weight.torque[1]
    stiffness = arms.stiffness[:, None]
    e = turn - springs.windup(static / stiffness)
    for _ in range(_EQUILIBRIUM_ITERATIONS - 1):
        # One matrix product per pose for all arms and payloads.
        own, more = ((e.swapaxes(0, 1) @ by.swapaxes(1, 2)).swapaxes(0, 1) for by in weight.by_q)
        e = turn - springs.windup((static + own + arms.payload[..., None] * more) / stiffness)
    return np.asarray(e)
