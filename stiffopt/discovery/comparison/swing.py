"""Links that swing on the springs of their joints as the motors' recorded motion makes them.

Motor motion in, link motion and spring torque out: a mode within the band of the recordings is then
part of what the model explains. Small changes (of masses, springs, damping) move the links along
the linear response about that motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.elastic.response import SwingResponse

# Of the wind-up that links are taken to have at first, without swing [Hz].
SLOW_CUTOFF = 20.0
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
# Modes that ring longer than that filter takes to settle [Hz].
_RINGING = 80.0
# Of a swing, by which positions and velocities are compared [rad/s].
_RATE = 60.0
# Rounds of weights in which a sum of distances becomes least, and the distance, of a usual one,
# below which all count alike.
_WEIGHINGS, _ALIKE = 8, 1e-2
# Slope of a wind-up with what was found over the nominal one; beyond, a wave or a gap is no
# spring's.
_SOFTER = (0.3, 10.0)


def slow_filter(dt: float) -> ZeroPhaseFilter:
    """What leaves the slow part of a motion sampled every `dt` [s], however seldom that is."""
    return ZeroPhaseFilter(1.0 / dt, min(SLOW_CUTOFF, 0.24 / dt))


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """Motion of the links and torque between motor and link, (K, n) each.

    Parameters
    ----------
    position, velocity, acceleration : array
        [rad], [rad/s], [rad/s^2].
    torque : array
        Between motor and link, that of the joint's damping in it [N m].
    spring : array
        In the spring alone [N m].
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    spring: np.ndarray

    def until(self, count: int) -> LinkMotion:
        """Its first samples."""
        return LinkMotion(*(part[:count] for part in vars(self).values()))

    @property
    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity (n,) of the first sample."""
        return self.position[0], self.velocity[0]

    def less(self, other: LinkMotion) -> LinkMotion:
        """The motion relative to another one; torques stay."""
        return self.moved(-other.position, -other.velocity, -other.acceleration)

    def apart(self, other: LinkMotion, window: slice) -> np.ndarray:
        """Differences to another motion in a window (k, 2 n), as velocities [rad/s]."""
        position, velocity = self.position - other.position, self.velocity - other.velocity
        return np.concatenate([_RATE * position[window], velocity[window]], axis=1)

    def distance(self, other: LinkMotion, window: slice) -> float:
        """Sum of the distances from another motion in a window [rad/s]."""
        return float(np.sum(np.linalg.norm(self.apart(other, window), axis=1)))

    def moved(self, z: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> LinkMotion:
        """The motion with a change; torques stay."""
        return replace(
            self,
            position=self.position + z,
            velocity=self.velocity + velocity,
            acceleration=self.acceleration + acceleration,
        )


@dataclass(frozen=True, eq=False)
class Swing:
    """Small changes about a link motion.

    Parameters
    ----------
    response : SwingResponse
    stiffness : array (K, n)
        Of the springs along the motion [N m/rad].
    damping : array (n,)
        Of the joints [N m s/rad].
    bodies : tuple of array (K, n, n)
        Slopes of the torques of the nominal bodies along position, velocity and acceleration.
    begin : LinkMotion
        Motion that it is about.
    softer : array (K, n) or float
        Compliance over the nominal one.
    heavier : array (K, n, n) or float
        Added to the nominal inertia [kg m^2].
    """

    response: SwingResponse
    stiffness: np.ndarray
    damping: np.ndarray
    bodies: tuple[np.ndarray, np.ndarray, np.ndarray]
    begin: LinkMotion
    softer: np.ndarray | float
    heavier: np.ndarray | float

    def copy(self) -> Swing:
        """One whose springs may be changed."""
        return replace(self, response=self.response.copy(), stiffness=self.stiffness.copy())

    def change_springs(
        self, samples: slice, stiffness: np.ndarray, force: np.ndarray, away: np.ndarray
    ) -> None:
        """Take another stiffness of (K, n) at some samples; elsewhere it stays.

        So does a small motion of positions `away` (K, n) there: the force that it needs follows.
        """
        own = stiffness[samples]
        force[samples] += (own - self.stiffness[samples]) * away[samples]
        self.stiffness[samples] = own
        springs = own[..., None] * np.eye(self.response.n)
        self.response.change_springs(samples, self.bodies[0][samples] + springs)

    @property
    def possible(self) -> bool:
        """Whether its masses can be, along the whole motion: else what swings grows without end."""
        mobility = self.response.mobility
        try:
            np.linalg.cholesky(mobility + mobility.swapaxes(1, 2))
        except np.linalg.LinAlgError:
            return False
        return True

    @property
    def fading(self) -> float:
        """Time in which the mode that rings longest falls to 1/e, as the run begins [s]."""
        frequencies, shapes = self.response.modes(0)
        told = shapes[:, (frequencies > 0.0) & (frequencies < _RINGING)]
        rates = 0.5 * np.sum(self.damping[:, None] * told**2, axis=0)
        return float(1.0 / np.min(rates, initial=np.inf)) if np.all(rates > 0.0) else np.inf

    def force(self, away: LinkMotion) -> np.ndarray:
        """Torque on the links (K, n) that a small motion needs [N m]."""
        weight, rate, inertia = self.bodies
        springs, dampers = self.stiffness * away.position, self.damping * away.velocity
        parts = (
            (inertia + self.heavier, away.acceleration),
            (rate, away.velocity),
            (weight, away.position),
        )
        needed = sum((matrix @ moved[..., None])[..., 0] for matrix, moved in parts)
        return np.asarray(needed + springs + dampers)

    def answer(
        self, link_torque: np.ndarray | None, deflection: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Change of torque and deflection (K, n) between motor and link.

        Parameters
        ----------
        link_torque : array (K, n) or None
            That the links need in addition [N m].
        deflection : array (K, n) or None
            By which the springs' ends are displaced [rad].
        """
        pushed = 0.0 if deflection is None else self.stiffness * deflection
        needed = pushed if link_torque is None else pushed + link_torque
        z, velocity = self.response.moved(-np.asarray(needed))
        return -self.stiffness * z - pushed - self.damping * velocity, -z

    def pushed(
        self, joints: np.ndarray, link_torque: np.ndarray, deflection: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes as `answer` gives them, (m, K, n) each, of m pushes (m, K), each at one joint."""
        wound = self.stiffness.T[joints] * deflection
        z, velocity = self.response.pushed(joints, -(wound + link_torque))
        torque = -self.stiffness * z - self.damping * velocity
        torque[np.arange(len(joints)), :, joints] -= wound
        return torque, -z

    def begun_near(self, links: LinkMotion, near: LinkMotion, window: slice) -> LinkMotion:
        """Link motion that begins otherwise, so that it is nearest to another one in a window.

        In modes that have not fallen off before it. The sum of distances counts, not of their
        squares: a corner of the motion swings links aside and passes, what a run began with rings
        on.
        """
        states = self._states(_RINGING)
        if not states.size:
            return links
        free = self.response.free(states)
        basis = np.concatenate([_RATE * free[0][window], free[1][window]], axis=1)
        away = near.apart(links, window)
        weight = np.ones(len(away))
        for _ in range(_WEIGHINGS):
            weighted = (basis * weight[:, None, None]).reshape(away.size, -1)
            state = np.linalg.lstsq(weighted, (away * weight[:, None]).ravel())[0]
            distance = np.linalg.norm(away - basis @ state, axis=1)
            usual = float(np.sqrt(np.mean(distance**2)))
            if not usual:
                break
            weight = 1.0 / np.sqrt(np.maximum(distance / usual, _ALIKE))
        return links.moved(*(part @ state for part in free))

    def starts(self, deflection: np.ndarray, band: float) -> np.ndarray:
        """Displacements and speeds (2 n, m) of the swings that a run may begin with.

        Each as large as the run's own motion of its springs.

        Parameters
        ----------
        deflection : array (K, n)
            Of the springs along the run [rad].
        band : float
            Modes up to this frequency are told [Hz].
        """
        states = self._states(band)
        n = self.response.n
        energy = float(np.sum(self.stiffness[0] * np.var(deflection, axis=0)))
        own = np.sum(self.stiffness[0] * states[:n, ::2].T ** 2, axis=1)
        return np.asarray(states * np.repeat(np.sqrt(energy / own), 2))

    def _states(self, band: float) -> np.ndarray:
        """Displacement and velocity (2 n, m) of every mode up to a frequency [Hz], in pairs.

        None of masses that cannot be, as a fit on its way may have them: their swing would grow.
        """
        frequencies, shapes = self.response.modes(0)
        still = np.zeros(self.response.n)
        states = [np.zeros((2 * self.response.n, 0))]
        if not np.all(frequencies > 0.0):
            return states[0]
        for frequency, shape in zip(frequencies, shapes.T, strict=True):
            if 0.0 < frequency < band:
                moving = np.append(still, 2.0 * np.pi * frequency * shape)
                states.append(np.column_stack([np.append(shape, still), moving]))
        return np.hstack(states)

    def left_alone(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torque and deflection (K, n, m) of swings from displacements and speeds (2 n, m)."""
        z, velocity, _ = self.response.free(state)
        return -self.stiffness[..., None] * z - self.damping[:, None] * velocity, -z


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
    """

    def __init__(
        self,
        robot: RobotModel,
        motor: np.ndarray,
        speed: np.ndarray,
        dt: float,
        damping: np.ndarray | None = None,
    ) -> None:
        self.robot, self.motor, self.speed, self.dt = robot, motor, speed, dt
        self.damping = damping_of(robot) if damping is None else damping

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
        response = SwingResponse(
            inertia + heavier,
            rate + self.damping * own,
            weight + stiffness[..., None] * own,
            self.dt,
            mobility,
        )
        return Swing(response, stiffness, self.damping, bodies, links, softer, heavier)

    def _stiffness(self, links: LinkMotion, softer: np.ndarray | float) -> np.ndarray:
        """Stiffness of the springs (K, n) along a motion [N m/rad]."""
        return np.asarray(1.0 / (self.robot.compliance(links.spring) * np.clip(softer, *_SOFTER)))

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
        found = []
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
        # From afar either may lead to a swing that springs do not let go on so.
        return min(found, key=lambda each: each.distance(begin, windows[1]), default=None)

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
        count = end = len(self.motor)
        reached = [0]
        settled = np.full(count, _SETTLED)
        torque = np.zeros_like(self.motor)
        away = links.less(slow)
        force = swing.force(away)
        while True:
            # From the first sample on with the springs as they are by now, so that it does not
            # matter which they were on the way.
            links = slow.moved(*swing.response.driven(force, *away.state))
            # None of it counts where it runs away.
            if not np.all(np.abs(links.acceleration) < _ABSURD):
                return None
            for known in (min(end + _FEWEST, count), count):
                # What comes much later is not asked for before all until then is settled.
                own, gaps = self._gaps(links.until(known), torque[:known], added)
                sizes = np.max(np.abs(gaps), axis=1)
                if known == count or np.any(sizes[:end] >= settled[:known][:end]):
                    break
            if np.all(sizes < settled[:known]):
                return own
            first = int(np.argmax(sizes >= settled[:known]))
            reached.append(first)
            if len(reached) > _PATIENCE and first <= reached[-_PATIENCE]:
                settled[first] = _STEP
                if sizes[first] > _STEP:
                    return None
            if first >= end:
                before, end = np.inf, min(len(sizes), 2 * end)
                growing = changed = 0
            worst = float(np.max(sizes[:end]))
            if worst > _SLOW * before:
                # Springs bend where the motion was taken to be: anew about where it is, as far as
                # it is followed.
                stiffness = self._bent(own, swing, softer, halfway=changed > _TO_AND_FRO)
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
            force[:end] += swing.stiffness[:end] * gaps[:end]

    def _bent(
        self, links: LinkMotion, swing: Swing, softer: Softer | None, *, halfway: bool
    ) -> np.ndarray:
        """Stiffness of the springs (k, n) along the first samples of a motion, or half way to it.

        [N m/rad]
        """
        k = len(links.position)
        ratio = np.broadcast_to(swing.softer, self.motor.shape)[:k]
        stiffness = self._stiffness(links, ratio if softer is None else softer(links))
        return 0.5 * (stiffness + swing.stiffness[:k]) if halfway else stiffness

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
        wound = self.robot.windup(links.spring)
        return links, self.motor[:k] - links.position - wound - displaced


def damping_of(robot: RobotModel) -> np.ndarray:
    """Damping of the joints (n,) [N m s/rad]."""
    damping = robot.recordings.nominal.joint_damping
    assert damping is not None
    return damping
