"""Joint springs between motors that move as recorded and links that follow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.vibration import LinkMotion, Vibration, slow_filter
from stiffopt.elastic.response import SwingResponse

# Of the largest torque, changes by less of which have no mean slope.
_MIN_TORQUE_CHANGE = 1e-9


@dataclass(frozen=True, eq=False)
class SpringLaw:
    """A spring with a play by a table, straight between its entries and beyond them.

    Parameters
    ----------
    carried : array (m,)
        Torques, rising [N m].
    deflection : array (m,)
        Under them, rising [rad].
    windup : array (m,)
        Of that, the spring's own [rad].
    """

    carried: np.ndarray
    deflection: np.ndarray
    windup: np.ndarray

    @cached_property
    def max_stiffness(self) -> float:
        """Largest slope of its torque [N m/rad]."""
        return float(1.0 / np.min(self._interval_compliance))

    def share_of_play(self, deflection: np.ndarray) -> np.ndarray:
        """Of rates of deflections (k,), what share is free travel."""
        cell = self._interval(self.deflection, deflection)
        return np.asarray(1.0 - (np.diff(self.windup) / np.diff(self.deflection))[cell])

    def play(self, deflection: np.ndarray) -> np.ndarray:
        """Of deflections (k,), what is free travel [rad]."""
        return np.asarray(np.interp(deflection, self.deflection, self.deflection - self.windup))

    def torque(self, deflection: np.ndarray) -> np.ndarray:
        """Torque [N m] of deflections (k,) [rad]."""
        cell = self._interval(self.deflection, deflection)
        along = deflection - self.deflection[cell]
        return np.asarray(self.carried[cell] + along / self._interval_compliance[cell])

    def compliance(self, torque: np.ndarray) -> np.ndarray:
        """Mean slope of the deflection [rad/(N m)] over the time that each sample (k,) stands for.

        At the edge of a play the slope is another one a moment later.
        """
        passed = np.interp(torque, self.carried, self.deflection)
        middle = 0.5 * (passed[1:] + passed[:-1])
        before = np.concatenate([passed[:1], middle])
        after = np.concatenate([middle, passed[-1:]])
        change = self.torque(after) - self.torque(before)
        still = np.abs(change) < _MIN_TORQUE_CHANGE * np.max(np.abs(torque))
        here = self._interval_compliance[self._interval(self.carried, torque)]
        return np.asarray(np.where(still, here, (after - before) / np.where(still, 1.0, change)))

    @cached_property
    def _interval_compliance(self) -> np.ndarray:
        return np.diff(self.deflection) / np.diff(self.carried)

    @staticmethod
    def _interval(entries: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.clip(np.searchsorted(entries, values, "right") - 1, 0, len(entries) - 2)


# Spring and link motion agree within this [rad]; far below any encoder's noise.
_GAP_TOLERANCE = 3e-8
# Within so many rounds it must agree further,
_MAX_STALLED_ROUNDS = 16
# or where it stands still agree to this, as at a step in what was found [rad].
_STALLED_GAP_TOLERANCE = 1e-6
# No link accelerates like this [rad/s^2].
_MAX_ACCELERATION = 1e9
# Samples that are followed at once, at least.
_MIN_STRETCH_SAMPLES = 25
# Rounds in which the gap grows in spite of all of these: there is no such motion then.
_MAX_GROWING_ROUNDS = 4
# Gap of a round over that of the round before from which springs are taken anew.
_MAX_GAP_RATIO = 0.4
# Times that springs are taken anew as they are; from then on half of the way, since about a bend
# they go to and fro.
_MAX_FULL_UPDATES = 3
# Behind the settling of the filter, over which links begin without vibration as far as can be [s], at
# least: longer than most corners of a motion. Besides, as long as a vibration takes to fade.
_MIN_START_WINDOW = 0.6
# Times that links are begun anew.
_START_ROUNDS = 2
# Slope of a wind-up with what was found over the nominal one; beyond, a wave or a gap is no
# spring's. And that of a play, in which a link flies free but for this.
_COMPLIANCE_RATIO_RANGE, _MAX_PLAY_COMPLIANCE_RATIO = (0.3, 10.0), 100.0

# From link motion, or its first samples, to what is added: torque on the links, displacement of the
# springs' ends.
AddedLoad = Callable[[LinkMotion], tuple[np.ndarray, np.ndarray]]
# From the same to the compliance of the springs (K, n) over the nominal one.
ComplianceRatio = Callable[[LinkMotion], np.ndarray]


class Springs:
    """Springs between motors that move as recorded and links that follow.

    Parameters
    ----------
    robot : RobotModel
        That swings.
    motor, speed : array (K, n)
        Position and speed of the motors [rad], [rad/s].
    dt : float
        [s]
    damping : array (n,), optional
        Of the joints, in place of the nominal one [N m s/rad].
    laws : mapping of int to SpringLaw, optional
        Springs with a play, by their joints (from 0).
    """

    def __init__(
        self,
        robot: RobotModel,
        motor: np.ndarray,
        speed: np.ndarray,
        dt: float,
        damping: np.ndarray | None = None,
        laws: Mapping[int, SpringLaw] | None = None,
    ) -> None:
        self.robot, self.motor, self.speed, self.dt = robot, motor, speed, dt
        self.damping = nominal_damping(robot) if damping is None else damping
        self.laws = laws or {}

    def play(self, links: LinkMotion) -> np.ndarray | float:
        """Of the deflections along a motion, or its first samples, what is free travel [rad]."""
        if not self.laws:
            return 0.0
        deflection = self.motor[: len(links.position)] - links.position
        free = np.zeros_like(deflection)
        for joint, law in self.laws.items():
            free[:, joint] = law.play(deflection[:, joint])
        return np.asarray(free)

    def with_torques(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, link_torque: np.ndarray | float = 0.0
    ) -> LinkMotion:
        """The torques that belong to a motion of the links, or to the first samples of one."""
        torque = self.robot.spring_torque(q, v, a) + link_torque
        spring = torque - self.damping * (self.speed[: len(v)] - v)
        return LinkMotion(q, v, a, torque, spring)

    def linearise(
        self,
        links: LinkMotion,
        compliance_ratio: np.ndarray | float = 1.0,
        added_inertia: np.ndarray | float = 0.0,
        near: Vibration | None = None,
    ) -> Vibration:
        """Linear response about a link motion.

        Parameters
        ----------
        links : LinkMotion
        compliance_ratio : array (K, n)
            Compliance over the nominal one.
        added_inertia : array (K, n, n)
            Added to the nominal inertia [kg m^2].
        near : Swing, optional
            Of a motion in the same postures.
        """
        bodies = (
            self.robot.torque_slopes(links.position, links.velocity, links.acceleration)
            if near is None
            else near.bodies
        )
        weight, rate, inertia = bodies
        stiffness = self._spring_stiffness(links, compliance_ratio)
        own = np.eye(self.robot.n)
        mobility = None
        if near is not None and not np.any(added_inertia) and not np.any(near.added_inertia):
            mobility = near.response.mobility
        response = SwingResponse(
            inertia + added_inertia,
            rate + self.damping * own,
            weight + stiffness[..., None] * own,
            self.dt,
            mobility,
        )
        return Vibration(
            response, stiffness, self.damping, bodies, links, compliance_ratio, added_inertia
        )

    def _spring_stiffness(
        self, links: LinkMotion, compliance_ratio: np.ndarray | float
    ) -> np.ndarray:
        """Stiffness of the springs (K, n) along a motion [N m/rad]."""
        nominal = self.robot.compliance(links.spring)
        compliance = nominal * np.clip(compliance_ratio, *_COMPLIANCE_RATIO_RANGE)
        for j, law in self.laws.items():
            compliance[:, j] += law.compliance(links.spring[:, j]) - nominal[:, j]
            compliance[:, j] = np.minimum(
                compliance[:, j], _MAX_PLAY_COMPLIANCE_RATIO * nominal[:, j]
            )
        return np.asarray(1.0 / compliance)

    def solve_from_slow(
        self,
        begin: LinkMotion,
        vibration: Vibration,
        added: AddedLoad | None = None,
        compliance_ratio: ComplianceRatio | None = None,
        aside: np.ndarray | None = None,
    ) -> LinkMotion | None:
        """Link motion that begins as near to a slow one as can be; None where none is found.

        Parameters
        ----------
        begin : LinkMotion
            Slow; near its ends its filter makes up some of it.
        vibration : Swing
            Response near it.
        added : callable, optional
            What acts beside the nominal robot.
        compliance_ratio : callable, optional
            What it makes of the springs.
        aside : array (2 n,), optional
            Displacement and speed by which links are known to begin beside that [rad], [rad/s].
        """
        found = self._solve_nearest_start(begin, vibration, added, compliance_ratio)
        if found is None or aside is None:
            return found
        ratio = vibration.compliance_ratio if compliance_ratio is None else compliance_ratio(found)
        about = self.linearise(found, ratio, vibration.added_inertia, vibration)
        moved = found.shifted(*(part[..., 0] for part in about.response.free(aside[:, None])))
        return self.solve(moved, about, begin, added, compliance_ratio) or found

    def _solve_nearest_start(
        self,
        begin: LinkMotion,
        vibration: Vibration,
        added: AddedLoad | None,
        compliance_ratio: ComplianceRatio | None,
    ) -> LinkMotion | None:
        """Link motion that begins as near to a slow one as can be."""
        first = slow_filter(self.dt).settling
        at_first = self.solve(begin, vibration, begin, added, compliance_ratio)
        if at_first is None or len(self.motor) <= first + 2:
            return at_first
        whole = len(self.motor) * self.dt
        windows = [
            slice(first, first + max(2, round(min(length, whole) / self.dt)))
            for length in (_MIN_START_WINDOW, max(_MIN_START_WINDOW, vibration.decay_time))
        ]
        found = [at_first]
        for window in windows if windows[0] != windows[1] else windows[:1]:
            near: LinkMotion | None = at_first
            for _ in range(_START_ROUNDS):
                if near is None:
                    break
                # Springs bend: about the motion as it is by now.
                ratio = (
                    vibration.compliance_ratio
                    if compliance_ratio is None
                    else compliance_ratio(near)
                )
                about = self.linearise(near, ratio, vibration.added_inertia, vibration)
                begun = about.with_nearest_start(near, begin, window)
                near = self.solve(begun, about, begin, added, compliance_ratio)
                if near is not None:
                    found.append(near)
        # From afar, or through a play, any may lead to a vibration that springs do not let go on so.
        return min(found, key=lambda each: each.distance(begin, windows[1]))

    def solve(
        self,
        links: LinkMotion,
        vibration: Vibration,
        slow: LinkMotion,
        added: AddedLoad | None = None,
        compliance_ratio: ComplianceRatio | None = None,
    ) -> LinkMotion | None:
        """Link motion that agrees with springs and motors; None where none is found.

        Parameters
        ----------
        links : LinkMotion
            To start from; at the first sample it stays.
        vibration : Swing
            Response near that motion.
        slow : LinkMotion
            Near by, without vibration: steps are exact of it, linear of what is beside it.
        added : callable, optional
            What acts beside the nominal robot.
        compliance_ratio : callable, optional
            What it makes of the springs.
        """
        before, growing, changed, vibration = np.inf, 0, 0, vibration.copy()
        end = len(self.motor)
        reached = [0]
        settled = np.full(end, _GAP_TOLERANCE)
        torque = np.zeros_like(self.motor)
        away = links.minus(slow)
        force = vibration.force(away)
        while True:
            # From the first sample on with the springs as they are by now, so that it does not
            # matter which they were on the way.
            within = self._torque_within_steps(vibration, links.position - slow.position)
            links = slow.shifted(*vibration.response.driven(force, *away.state, within))
            # None of it counts where it runs away.
            if not np.all(np.abs(links.acceleration) < _MAX_ACCELERATION):
                return None
            own, gaps = self._residuals_until(end, links, torque, added, settled)
            sizes = np.max(np.abs(gaps), axis=1)
            if np.all(sizes < settled[: len(sizes)]):
                return own
            first = int(np.argmax(sizes >= settled[: len(sizes)]))
            reached.append(first)
            if len(reached) > _MAX_STALLED_ROUNDS and first <= reached[-_MAX_STALLED_ROUNDS]:
                if sizes[first] > _STALLED_GAP_TOLERANCE:
                    return None
                settled[first] = _STALLED_GAP_TOLERANCE
            onward = first >= end
            # Behind a play what comes later may be far off, as long as more and more is settled.
            if onward or (self.laws and first > max(reached[:-1])):
                growing = changed = 0
            if onward:
                before, end = np.inf, min(len(sizes), 2 * end)
            worst = float(np.max(sizes[:end]))
            if worst > _MAX_GAP_RATIO * before:
                # Springs bend where the motion was taken to be: anew about where it is, as far as
                # it is followed.
                stiffness = self._updated_stiffness(
                    own, vibration, compliance_ratio, 1.0 / max(changed - _MAX_FULL_UPDATES + 1, 1)
                )
                vibration.change_springs(
                    slice(first, end), stiffness, force, links.position - slow.position
                )
                changed += 1
            if worst > before:
                # About a bend it goes to and fro by less than what is let be in the end.
                growing += end - first <= _MIN_STRETCH_SAMPLES and worst > _STALLED_GAP_TOLERANCE
                if growing > _MAX_GROWING_ROUNDS:
                    return None
                # What comes late hangs on all before it: so far, then further.
                end = first + max(_MIN_STRETCH_SAMPLES, (end - first) // 4)
            before = worst
            force[:end] += self._gap_stiffness(vibration)[:end] * gaps[:end]

    def _gap_stiffness(self, vibration: Vibration) -> np.ndarray:
        """Torque (K, n) by which a gap is closed [N m/rad]."""
        if not self.laws:
            return vibration.stiffness
        pulls = vibration.stiffness.copy()
        for j, law in self.laws.items():
            pulls[:, j] = law.max_stiffness
        return pulls

    def _torque_within_steps(self, vibration: Vibration, away: np.ndarray) -> np.ndarray | None:
        """Torques (K - 1, 2, n) at both ends of every step that its mean springs do not have.

        Of positions `away` (K, n), where springs enter a play or leave it; else they bend little.
        """
        if not self.laws:
            return None
        half = 0.5 * np.diff(vibration.stiffness, axis=0)
        return np.stack([half * away[:-1], -half * away[1:]], axis=1)

    def _updated_stiffness(
        self,
        links: LinkMotion,
        vibration: Vibration,
        compliance_ratio: ComplianceRatio | None,
        share: float,
    ) -> np.ndarray:
        """Stiffness of the springs (k, n) along the first samples of a motion, or part way to it.

        [N m/rad]
        """
        k = len(links.position)
        ratio = np.broadcast_to(vibration.compliance_ratio, self.motor.shape)[:k]
        stiffness = self._spring_stiffness(
            links, ratio if compliance_ratio is None else compliance_ratio(links)
        )
        return share * stiffness + (1.0 - share) * vibration.stiffness[:k]

    def _residuals_until(
        self,
        end: int,
        links: LinkMotion,
        torque: np.ndarray,
        added: AddedLoad | None,
        settled: np.ndarray,
    ) -> tuple[LinkMotion, np.ndarray]:
        """As `_gaps`, not much beyond `end` before all until then is below `settled` (K,) [rad]."""
        count = len(self.motor)
        known = min(end + _MIN_STRETCH_SAMPLES, count)
        found = self._residuals(links.head(known), torque[:known], added)
        if known == count or np.any(np.max(np.abs(found[1][:end]), axis=1) >= settled[:end]):
            return found
        return self._residuals(links, torque, added)

    def _residuals(
        self, links: LinkMotion, torque: np.ndarray, added: AddedLoad | None
    ) -> tuple[LinkMotion, np.ndarray]:
        """The first samples of a motion with its torques, and what springs and motors lack to it.

        Parameters
        ----------
        links : LinkMotion
        torque : array (k, n)
            That is added on the links, as known before; as of now afterwards [N m].
        added : callable or None
        """
        k = len(links.position)
        links = self.with_torques(links.position, links.velocity, links.acceleration, torque)
        displaced: np.ndarray | float = 0.0
        if added is not None:
            now, displaced = added(links)
            change = now - torque
            torque[:] = now
            links = replace(links, torque=links.torque + change, spring=links.spring + change)
        deflection = self.motor[:k] - links.position - displaced
        gaps = deflection - self.robot.windup(links.spring)
        for j, law in self.laws.items():
            # By the torque that the deflection makes; dampers have what the spring has of its rate.
            free = law.share_of_play(deflection[:, j]) * (self.speed[:k] - links.velocity)[:, j]
            carried = law.torque(deflection[:, j])
            gaps[:, j] = carried - links.spring[:, j] - self.damping[j] * free
            gaps[:, j] /= law.max_stiffness
            links.spring[:, j] = carried
        return links, gaps


def nominal_damping(robot: RobotModel) -> np.ndarray:
    """Damping of the joints (n,) [N m s/rad]."""
    damping = robot.recordings.nominal.joint_damping
    assert damping is not None
    return damping
