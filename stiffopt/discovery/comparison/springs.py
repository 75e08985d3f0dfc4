"""Springs between motors that move as recorded and links that follow.

A link motion is found that agrees with the springs at every sample, by steps that are linear about
a motion near by.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.spring_law import SpringLaw
from stiffopt.discovery.comparison.swing import LinkMotion, Swing, slow_filter
from stiffopt.elastic.response import ElasticResponse

# Spring and link motion agree within this [rad]; far below any encoder's noise.
_SETTLED = 3e-8
# Within so many rounds it must agree further,
_PATIENCE = 16
# or where it stands still agree to this, as at a step in what was found [rad].
_STEP = 1e-6
# No link accelerates like this [rad/s^2].
_ABSURD = 1e9
# Samples that are followed at once, at least.
_FEWEST = 25
# Rounds in which the gap grows in spite of all of these: there is no such motion then.
_GROWING = 4
# Gap of a round over that of the round before from which springs are taken anew.
_SLOW = 0.4
# Times that springs are taken anew as they are; from then on half of the way, since about a bend
# they go to and fro.
_TO_AND_FRO = 3
# Behind the settling of the filter, over which links begin without swing as far as can be [s], at
# least: longer than most corners of a motion. Besides, as long as a swing takes to fade.
_START = 0.6
# Times that links are begun anew.
_BEGUN = 2
# Slope of a wind-up with what was found over the nominal one; beyond, a wave or a gap is no
# spring's. And that of a play, in which a link flies free but for this.
_SOFTER, _FREE = (0.3, 10.0), 100.0

# From link motion, or its first samples, to what is added: torque on the links, displacement of the
# springs' ends.
Added = Callable[[LinkMotion], tuple[np.ndarray, np.ndarray]]
# From the same to the compliance of the springs (K, n) over the nominal one.
Softer = Callable[[LinkMotion], np.ndarray]


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
        self.damping = damping_of(robot) if damping is None else damping
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

    def motion(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, link_torque: np.ndarray | float = 0.0
    ) -> LinkMotion:
        """The torques that belong to a motion of the links, or to the first samples of one."""
        torque = self.robot.spring_torque(q, v, a) + link_torque
        spring = torque - self.damping * (self.speed[: len(v)] - v)
        return LinkMotion(q, v, a, torque, spring)

    def swing(
        self,
        links: LinkMotion,
        softer: np.ndarray | float = 1.0,
        heavier: np.ndarray | float = 0.0,
        near: Swing | None = None,
    ) -> Swing:
        """Linear response about a link motion.

        Parameters
        ----------
        links : LinkMotion
        softer : array (K, n)
            Compliance over the nominal one.
        heavier : array (K, n, n)
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
        stiffness = self._stiffness(links, softer)
        own = np.eye(self.robot.n)
        mobility = None
        if near is not None and not np.any(heavier) and not np.any(near.heavier):
            mobility = near.response.mobility
        response = ElasticResponse(
            inertia + heavier,
            rate + self.damping * own,
            weight + stiffness[..., None] * own,
            self.dt,
            mobility,
        )
        return Swing(response, stiffness, self.damping, bodies, links, softer, heavier)

    def _stiffness(self, links: LinkMotion, softer: np.ndarray | float) -> np.ndarray:
        """Stiffness of the springs (K, n) along a motion [N m/rad]."""
        nominal = self.robot.compliance(links.spring)
        compliance = nominal * np.clip(softer, *_SOFTER)
        for j, law in self.laws.items():
            compliance[:, j] += law.compliance(links.spring[:, j]) - nominal[:, j]
            compliance[:, j] = np.minimum(compliance[:, j], _FREE * nominal[:, j])
        return np.asarray(1.0 / compliance)

    def started(
        self,
        begin: LinkMotion,
        swing: Swing,
        added: Added | None = None,
        softer: Softer | None = None,
        aside: np.ndarray | None = None,
    ) -> LinkMotion | None:
        """Link motion that begins as near to a slow one as can be; None where none is found.

        Parameters
        ----------
        begin : LinkMotion
            Slow; near its ends its filter makes up some of it.
        swing : Swing
            Response near it.
        added : callable, optional
            What acts beside the nominal robot.
        softer : callable, optional
            What it makes of the springs.
        aside : array (2 n,), optional
            Displacement and speed by which links are known to begin beside that [rad], [rad/s].
        """
        found = self._nearest(begin, swing, added, softer)
        if found is None or aside is None:
            return found
        ratio = swing.softer if softer is None else softer(found)
        about = self.swing(found, ratio, swing.heavier, swing)
        moved = found.moved(*(part[..., 0] for part in about.response.free(aside[:, None])))
        return self.follow(moved, about, begin, added, softer) or found

    def _nearest(
        self, begin: LinkMotion, swing: Swing, added: Added | None, softer: Softer | None
    ) -> LinkMotion | None:
        """Link motion that begins as near to a slow one as can be."""
        first = slow_filter(self.dt).settling
        at_first = self.follow(begin, swing, begin, added, softer)
        if at_first is None or len(self.motor) <= first + 2:
            return at_first
        whole = len(self.motor) * self.dt
        windows = [
            slice(first, first + max(2, round(min(length, whole) / self.dt)))
            for length in (_START, max(_START, swing.fading))
        ]
        found = [at_first]
        for window in windows if windows[0] != windows[1] else windows[:1]:
            near: LinkMotion | None = at_first
            for _ in range(_BEGUN):
                if near is None:
                    break
                # Springs bend: about the motion as it is by now.
                ratio = swing.softer if softer is None else softer(near)
                about = self.swing(near, ratio, swing.heavier, swing)
                begun = about.begun_near(near, begin, window)
                near = self.follow(begun, about, begin, added, softer)
                if near is not None:
                    found.append(near)
        # From afar, or through a play, any may lead to a swing that springs do not let go on so.
        return min(found, key=lambda each: each.distance(begin, windows[1]))

    def follow(
        self,
        links: LinkMotion,
        swing: Swing,
        slow: LinkMotion,
        added: Added | None = None,
        softer: Softer | None = None,
    ) -> LinkMotion | None:
        """Link motion that agrees with springs and motors; None where none is found.

        Parameters
        ----------
        links : LinkMotion
            To start from; at the first sample it stays.
        swing : Swing
            Response near that motion.
        slow : LinkMotion
            Near by, without swing: steps are exact of it, linear of what is beside it.
        added : callable, optional
            What acts beside the nominal robot.
        softer : callable, optional
            What it makes of the springs.
        """
        before, growing, changed, swing = np.inf, 0, 0, swing.copy()
        end = len(self.motor)
        reached = [0]
        settled = np.full(end, _SETTLED)
        torque = np.zeros_like(self.motor)
        away = links.less(slow)
        force = swing.force(away)
        while True:
            # From the first sample on with the springs as they are by now, so that it does not
            # matter which they were on the way.
            within = self._within_steps(swing, links.position - slow.position)
            links = slow.moved(*swing.response.driven(force, *away.state, within))
            # None of it counts where it runs away.
            if not np.all(np.abs(links.acceleration) < _ABSURD):
                return None
            own, gaps = self._gaps_up_to(end, links, torque, added, settled)
            sizes = np.max(np.abs(gaps), axis=1)
            if np.all(sizes < settled[: len(sizes)]):
                return own
            first = int(np.argmax(sizes >= settled[: len(sizes)]))
            reached.append(first)
            if len(reached) > _PATIENCE and first <= reached[-_PATIENCE]:
                if sizes[first] > _STEP:
                    return None
                settled[first] = _STEP
            onward = first >= end
            # Behind a play what comes later may be far off, as long as more and more is settled.
            if onward or (self.laws and first > max(reached[:-1])):
                growing = changed = 0
            if onward:
                before, end = np.inf, min(len(sizes), 2 * end)
            worst = float(np.max(sizes[:end]))
            if worst > _SLOW * before:
                # Springs bend where the motion was taken to be: anew about where it is, as far as
                # it is followed.
                stiffness = self._bent(own, swing, softer, 1.0 / max(changed - _TO_AND_FRO + 1, 1))
                swing.change_springs(
                    slice(first, end), stiffness, force, links.position - slow.position
                )
                changed += 1
            if worst > before:
                # About a bend it goes to and fro by less than what is let be in the end.
                growing += end - first <= _FEWEST and worst > _STEP
                if growing > _GROWING:
                    return None
                # What comes late hangs on all before it: so far, then further.
                end = first + max(_FEWEST, (end - first) // 4)
            before = worst
            force[:end] += self._pulls(swing)[:end] * gaps[:end]

    def _pulls(self, swing: Swing) -> np.ndarray:
        """Torque (K, n) by which a gap is closed [N m/rad]."""
        if not self.laws:
            return swing.stiffness
        pulls = swing.stiffness.copy()
        for j, law in self.laws.items():
            pulls[:, j] = law.steepest
        return pulls

    def _within_steps(self, swing: Swing, away: np.ndarray) -> np.ndarray | None:
        """Torques (K - 1, 2, n) at both ends of every step that its mean springs do not have.

        Of positions `away` (K, n), where springs enter a play or leave it; else they bend little.
        """
        if not self.laws:
            return None
        half = 0.5 * np.diff(swing.stiffness, axis=0)
        return np.stack([half * away[:-1], -half * away[1:]], axis=1)

    def _bent(
        self, links: LinkMotion, swing: Swing, softer: Softer | None, share: float
    ) -> np.ndarray:
        """Stiffness of the springs (k, n) along the first samples of a motion, or part way to it.

        [N m/rad]
        """
        k = len(links.position)
        ratio = np.broadcast_to(swing.softer, self.motor.shape)[:k]
        stiffness = self._stiffness(links, ratio if softer is None else softer(links))
        return share * stiffness + (1.0 - share) * swing.stiffness[:k]

    def _gaps_up_to(
        self,
        end: int,
        links: LinkMotion,
        torque: np.ndarray,
        added: Added | None,
        settled: np.ndarray,
    ) -> tuple[LinkMotion, np.ndarray]:
        """As `_gaps`, not much beyond `end` before all until then is below `settled` (K,) [rad]."""
        count = len(self.motor)
        known = min(end + _FEWEST, count)
        found = self._gaps(links.until(known), torque[:known], added)
        if known == count or np.any(np.max(np.abs(found[1][:end]), axis=1) >= settled[:end]):
            return found
        return self._gaps(links, torque, added)

    def _gaps(
        self, links: LinkMotion, torque: np.ndarray, added: Added | None
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
        links = self.motion(links.position, links.velocity, links.acceleration, torque)
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
            gaps[:, j] /= law.steepest
            links.spring[:, j] = carried
        return links, gaps


def damping_of(robot: RobotModel) -> np.ndarray:
    """Damping of the joints (n,) [N m s/rad]."""
    damping = robot.recordings.nominal.joint_damping
    assert damping is not None
    return damping
