"""Links that swing on the springs of their joints as the motors' recorded motion makes them.

Motor motion in, link motion and spring torque out: a mode within the band of the recordings is then
part of what the model explains. Small changes (of masses, springs, damping) move the links along
the linear response about that motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter
from stiffopt.elastic.response import ElasticResponse

# Of the wind-up that links are taken to have at first, without swing [Hz].
SLOW_CUTOFF = 20.0
# Modes that ring longer than that filter takes to settle [Hz].
_RINGING = 80.0
# Of a swing, by which positions and velocities are compared [rad/s].
_RATE = 60.0
# Rounds of weights in which a sum of distances becomes least, and the distance, of a usual one,
# below which all count alike.
_WEIGHINGS, _ALIKE = 8, 1e-2
# Of its largest stiffness, which a spring has that carries.
_CARRIES = 0.1


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
    response : ElasticResponse
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

    response: ElasticResponse
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
        frequencies, shapes = self.modes(0)
        told = shapes[:, (frequencies > 0.0) & (frequencies < _RINGING)]
        rates = 0.5 * np.sum(self.damping[:, None] * told**2, axis=0)
        return float(1.0 / np.min(rates, initial=np.inf)) if np.all(rates > 0.0) else np.inf

    @property
    def carrying(self) -> np.ndarray:
        """Stiffness of the springs (K, n) but for plays that they are within [N m/rad]."""
        return np.asarray(np.maximum(self.stiffness, _CARRIES * np.max(self.stiffness, axis=0)))

    def modes(self, sample: int) -> tuple[np.ndarray, np.ndarray]:
        """As of the response, at the sample nearest by in which no spring is within its play."""
        carried = np.flatnonzero(np.all(self.stiffness >= self.carrying, axis=1))
        near = carried[np.argmin(np.abs(carried - sample))] if carried.size else sample
        return self.response.modes(int(near))

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
        frequencies, shapes = self.modes(0)
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
