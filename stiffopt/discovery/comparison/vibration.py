"""Vibration of the links on their joint springs under the recorded motion of the motors.

Motor motion in, link motion and spring torque out: a mode within the band of the recordings is then
part of the model. Small changes (of masses, springs, damping) move the links along the linear
response about that motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter
from stiffopt.elastic.response import ElasticResponse

# Cutoff of the slow motion that links have before vibration is added [Hz].
SLOW_CUTOFF = 20.0
# Modes below this ring longer than that filter settles [Hz].
_MAX_RINGING_FREQUENCY = 80.0
# Weight of positions against velocities in distances between motions [rad/s].
_POSITION_WEIGHT = 60.0
# Rounds of iteratively reweighted least squares for a sum of distances, and the distance over the
# mean one below which weights are equal.
_REWEIGHTING_ROUNDS, _MIN_RELATIVE_DISTANCE = 8, 1e-2
# Share of its largest stiffness above which a spring is outside its play.
_MIN_CARRYING_SHARE = 0.1


def slow_filter(dt: float) -> ZeroPhaseFilter:
    """Return the filter for the slow part of a motion with time step `dt` [s]."""
    return ZeroPhaseFilter(1.0 / dt, min(SLOW_CUTOFF, 0.24 / dt))


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """Motion of the links and torque between motor and link, (K, n) each."""

    # position, velocity, acceleration [rad], [rad/s], [rad/s^2].
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray  # between motor and link, including the joint damping [N m]
    spring: np.ndarray  # in the spring alone [N m]

    def head(self, count: int) -> LinkMotion:
        """Return the first samples."""
        return LinkMotion(*(part[:count] for part in vars(self).values()))

    @property
    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity (n,) of the first sample."""
        return self.position[0], self.velocity[0]

    def minus(self, other: LinkMotion) -> LinkMotion:
        """Return the motion relative to another one, with unchanged torques."""
        return self.shifted(-other.position, -other.velocity, -other.acceleration)

    def difference(self, other: LinkMotion, window: slice) -> np.ndarray:
        """Return differences to another motion in a window (k, 2 n), as velocities [rad/s]."""
        position, velocity = self.position - other.position, self.velocity - other.velocity
        return np.concatenate([_POSITION_WEIGHT * position[window], velocity[window]], axis=1)

    def distance(self, other: LinkMotion, window: slice) -> float:
        """Return the sum of the distances to another motion in a window [rad/s]."""
        return float(np.sum(np.linalg.norm(self.difference(other, window), axis=1)))

    def shifted(self, z: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> LinkMotion:
        """Return the motion with a change added, with unchanged torques."""
        return replace(
            self,
            position=self.position + z,
            velocity=self.velocity + velocity,
            acceleration=self.acceleration + acceleration,
        )


@dataclass(frozen=True, eq=False)
class Vibration:
    """Linear response of the links about a motion."""

    response: ElasticResponse
    stiffness: np.ndarray  # (K, n) tangent stiffness of the springs along the motion [N m/rad]
    damping: np.ndarray  # (n,) damping of the joints [N m s/rad]
    # (K, n, n) torque derivatives of the nominal bodies by position, velocity and acceleration.
    bodies: tuple[np.ndarray, np.ndarray, np.ndarray]
    reference: LinkMotion  # motion of the linearisation
    compliance_ratio: np.ndarray | float  # (K, n) compliance over the nominal one
    added_inertia: np.ndarray | float  # (K, n, n) added to the nominal inertia [kg m^2]

    def copy(self) -> Vibration:
        """Return a copy whose springs may be changed."""
        return replace(self, response=self.response.copy(), stiffness=self.stiffness.copy())

    def change_springs(
        self, samples: slice, stiffness: np.ndarray, force: np.ndarray, away: np.ndarray
    ) -> None:
        """Set another stiffness (K, n) at some samples.

        The force on a small motion of positions `away` (K, n) is updated so that the motion stays
        the same.
        """
        own = stiffness[samples]
        force[samples] += (own - self.stiffness[samples]) * away[samples]
        self.stiffness[samples] = own
        springs = own[..., None] * np.eye(self.response.n)
        self.response.change_springs(samples, self.bodies[0][samples] + springs)

    @property
    def has_positive_inertia(self) -> bool:
        """True where mass matrices are positive definite, without which vibration grows."""
        mobility = self.response.mobility
        try:
            np.linalg.cholesky(mobility + mobility.swapaxes(1, 2))
        except np.linalg.LinAlgError:
            return False
        return True

    @property
    def decay_time(self) -> float:
        """Time in which the least damped mode decays to 1/e at the begin of the run [s]."""
        frequencies, shapes = self.modes(0)
        told = shapes[:, (frequencies > 0.0) & (frequencies < _MAX_RINGING_FREQUENCY)]
        rates = 0.5 * np.sum(self.damping[:, None] * told**2, axis=0)
        return float(1.0 / np.min(rates, initial=np.inf)) if np.all(rates > 0.0) else np.inf

    @property
    def carrying_stiffness(self) -> np.ndarray:
        """Stiffness of the springs (K, n) outside their plays [N m/rad]."""
        return np.asarray(
            np.maximum(self.stiffness, _MIN_CARRYING_SHARE * np.max(self.stiffness, axis=0))
        )

    def modes(self, sample: int) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies and shapes at the nearest sample outside all plays."""
        carried = np.flatnonzero(np.all(self.stiffness >= self.carrying_stiffness, axis=1))
        near = carried[np.argmin(np.abs(carried - sample))] if carried.size else sample
        return self.response.modes(int(near))

    def force(self, away: LinkMotion) -> np.ndarray:
        """Return the torque on the links (K, n) that a small motion needs [N m]."""
        weight, rate, inertia = self.bodies
        springs, dampers = self.stiffness * away.position, self.damping * away.velocity
        parts = (
            (inertia + self.added_inertia, away.acceleration),
            (rate, away.velocity),
            (weight, away.position),
        )
        needed = sum((matrix @ moved[..., None])[..., 0] for matrix, moved in parts)
        return np.asarray(needed + springs + dampers)

    def respond(
        self, loads: Sequence[tuple[np.ndarray | None, np.ndarray | None]]
    ) -> list[tuple[np.ndarray | None, np.ndarray | None]]:
        """Return the changes of torque and deflection (K, n) between motor and link, by load.

        Loads are integrated together. A load of nothing changes nothing: None.

        `loads` (K, n): added torque on the links [N m], and displacement of the springs' ends
        [rad].
        """
        acting = [k for k, load in enumerate(loads) if any(part is not None for part in load)]
        pushed = np.zeros((len(acting), *self.stiffness.shape))
        needed = np.empty_like(pushed)
        for own, whole, k in zip(pushed, needed, acting, strict=True):
            link_torque, deflection = loads[k]
            if deflection is not None:
                np.multiply(self.stiffness, deflection, out=own)
            np.add(own, 0.0 if link_torque is None else link_torque, out=whole)
        moved, torque = self._spring_response(*self.response.moved(-needed))
        torque -= pushed
        found: list[tuple[np.ndarray | None, np.ndarray | None]] = [(None, None)] * len(loads)
        for k, changed, away in zip(acting, torque, moved, strict=True):
            found[k] = changed, away
        return found

    def _spring_response(
        self, z: np.ndarray, velocity: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return deflection and torque (m, K, n) of springs whose links move, in place."""
        velocity *= self.damping
        velocity += self.stiffness * z
        return np.negative(z, out=z), np.negative(velocity, out=velocity)

    def respond_at_joints(
        self, joints: np.ndarray, link_torque: np.ndarray, deflection: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the responses (m, K, n) to m loads (m, K), each at one joint."""
        wound = self.stiffness.T[joints] * deflection
        moved, torque = self._spring_response(*self.response.pushed(joints, -(wound + link_torque)))
        torque[np.arange(len(joints)), :, joints] -= wound
        return torque, moved

    def with_nearest_start(self, links: LinkMotion, near: LinkMotion, window: slice) -> LinkMotion:
        """Return the link motion with the initial state nearest to another motion in a window.

        Only modes that have not decayed before it are changed. The sum of distances is minimised,
        not of squares: acceleration phases excite the links for a short time, an initial vibration
        lasts.
        """
        states = self._mode_states(_MAX_RINGING_FREQUENCY)
        if not states.size:
            return links
        free = self.response.free(states)
        basis = np.concatenate([_POSITION_WEIGHT * free[0][window], free[1][window]], axis=1)
        away = near.difference(links, window)
        weight = np.ones(len(away))
        for _ in range(_REWEIGHTING_ROUNDS):
            weighted = (basis * weight[:, None, None]).reshape(away.size, -1)
            state = np.linalg.lstsq(weighted, (away * weight[:, None]).ravel())[0]
            distance = np.linalg.norm(away - basis @ state, axis=1)
            usual = float(np.sqrt(np.mean(distance**2)))
            if not usual:
                break
            weight = 1.0 / np.sqrt(np.maximum(distance / usual, _MIN_RELATIVE_DISTANCE))
        return links.shifted(*(part @ state for part in free))

    def initial_states(self, deflection: np.ndarray, band: float) -> np.ndarray:
        """Return displacements and velocities (2 n, m) of likely initial vibrations.

        Each has the energy of the run's own spring deflection.

        `deflection` (K, n): of the springs along the run [rad]. `band`: highest mode [Hz].
        """
        states = self._mode_states(band)
        n = self.response.n
        energy = float(np.sum(self.stiffness[0] * np.var(deflection, axis=0)))
        own = np.sum(self.stiffness[0] * states[:n, ::2].T ** 2, axis=1)
        return np.asarray(states * np.repeat(np.sqrt(energy / own), 2))

    def _mode_states(self, band: float) -> np.ndarray:
        """Return displacement and velocity (2 n, m) of modes up to a frequency [Hz].

        In pairs; empty where masses are not positive definite, as during a fit: their vibration
        would grow.
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

    def free_vibration(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return torque and deflection (K, n, m) of free vibration from initial states (2 n, m)."""
        z, velocity, _ = self.response.free(state)
        return -self.stiffness[..., None] * z - self.damping[:, None] * velocity, -z
