"""Motors whose links swing: how high their recorded motion is followed, and which way they move."""

from __future__ import annotations

from math import comb

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.signals import smooth_sign
from stiffopt.discovery.settings import SIGN_SPEED
from stiffopt.recording.channel import DEVIATION_PER_MAD

# Of the motors' motion that is followed [Hz], at least and at most: wider than a fit's filter,
# which all that comes of it passes later.
MOTOR_CUTOFF, WIDEST_CUTOFF = 60.0, 150.0
# Share of the rated torque that the noise of a motor's acceleration may come to, and of the rate of
# the samples, how high a motion they show.
_BORNE, _HIGHEST = 1e-3, 0.36
# Times that samples are subtracted from their neighbours, of which noise is left alone.
_DIFFERENCES = 5
# Of the speed within which a sign is smooth, changes by less of which leave it as it is.
_STEADY = 1e-3


def followed_to(robot: RobotModel, position: np.ndarray, dt: float) -> float:
    """Cutoff of the motors' motion [Hz], as high as encoders bear.

    Where friction turns, torque and acceleration jump against each other within milliseconds: what
    is not followed of one stays of the other. The noise of an encoder sets the limit, which
    accelerations multiply by the square of the frequency.

    Parameters
    ----------
    robot : RobotModel
    position : array (K, n)
        Of the motors, as read [rad].
    dt : float
        [s]
    """
    # Of white noise at the samples' rate, after two derivatives and a filter [N m/Hz^2.5].
    noise = (2.0 * np.pi) ** 2 * np.sqrt(0.4 * dt) * robot.rotor_inertia * _noise(position)
    borne = np.array([_BORNE * joint.torque_rated for joint in robot.constants.joints])
    if not np.all(np.isfinite(borne) & np.isfinite(noise)):
        return min(MOTOR_CUTOFF, _HIGHEST / dt)
    with np.errstate(divide="ignore"):
        bears = float(np.min(borne / noise)) ** 0.4
    return min(float(np.clip(bears, MOTOR_CUTOFF, WIDEST_CUTOFF)), _HIGHEST / dt)


def _noise(samples: np.ndarray) -> np.ndarray:
    """Standard deviations of what changes from sample to sample (n,), if it were white noise."""
    apart = np.diff(samples, _DIFFERENCES, axis=0)
    size = [
        np.median(np.abs(moved)) if (moved := own[np.isfinite(own) & (own != 0.0)]).size else 0.0
        for own in apart.T
    ]
    return np.asarray(
        DEVIATION_PER_MAD * np.array(size) / np.sqrt(comb(2 * _DIFFERENCES, _DIFFERENCES))
    )


def mean_sign(velocity: np.ndarray) -> np.ndarray:
    """Mean of the smooth sign (K, n) over the time that every sample stands for [-].

    A light joint turns between two samples: there the sign of a sample is that of half of its time
    at most, and a jump of friction comes up to half a sample too early or too late. Speeds run
    straight between the samples and the middles between them, which a cubic through four samples
    gives.

    Parameters
    ----------
    velocity : array (K, n)
        At even times, in their order [rad/s].
    """
    if len(velocity) < 4:
        return np.asarray(smooth_sign(velocity))
    middle = 0.5 * (velocity[1:] + velocity[:-1])
    middle[1:-1] += (velocity[1:-2] + velocity[2:-1] - velocity[:-3] - velocity[3:]) / 16.0
    before = np.concatenate([velocity[:1], middle])
    after = np.concatenate([middle, velocity[-1:]])
    return np.asarray(0.5 * (_sign_between(before, velocity) + _sign_between(velocity, after)))


def _sign_between(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Mean of the smooth sign while a speed goes evenly from one value to another."""
    change = last - first
    steady = np.abs(change) < _STEADY * SIGN_SPEED

    def integral(velocity: np.ndarray) -> np.ndarray:
        size = np.abs(velocity)
        return np.asarray(size + SIGN_SPEED * np.log1p(np.exp(-2.0 * size / SIGN_SPEED)))

    mean = (integral(last) - integral(first)) / np.where(steady, 1.0, change)
    return np.asarray(np.where(steady, smooth_sign(0.5 * (first + last)), mean))
