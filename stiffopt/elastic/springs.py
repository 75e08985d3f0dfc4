"""Joint springs by the exact law, tabulated from wind-up to torque and back.

Cubic Hermite interpolation with the exact slopes, up to three times the drive's torque or 99.9 % of
the slip torque of a connection; beyond, linear with the last tangent stiffness, which simulations
report (`JointSpring.torque_reach`).
"""

from __future__ import annotations

import copy
import functools
from bisect import bisect_right
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import NotSimulatedError
from stiffopt.exact.chain import breakpoints, exact_compliance, exact_windup

if TYPE_CHECKING:
    from stiffopt.drivetrain.chain import Chain
    from stiffopt.robot.robot import Robot

_TABLE_TORQUE_RATIO = 3.0
_USED_SHARE_OF_SLIP_TORQUE = 0.999
_TABLE_POINTS = 500
# Wind-up to which tables of a linear spring go [rad]; it is linear beyond as well.
_LINEAR_REACH = 1e-2


class JointSpring:
    """Nonlinear spring of one joint.

    `torque_max`: of the joint's drive [N m]. `name`: of the joint, for messages.
    """

    def __init__(self, chain: Chain, torque_max: float, name: str) -> None:
        torque = _table_torques(
            chain, _largest_finite_torque(chain, _TABLE_TORQUE_RATIO * torque_max)
        )
        windup, compliance = exact_windup(chain, torque), exact_compliance(chain, torque)
        sound = np.isfinite(windup) & np.isfinite(compliance) & (compliance > 0.0)
        if not sound.all():
            raise NotSimulatedError(
                f"the drivetrain of {name} has no finite stiffness: its wind-up diverges at "
                f"{torque[~sound][0]:.3g} N m, as of a contact without pressure. Give its contacts "
                "a pre-pressure or preload."
            )
        self.torque_reach = float(torque[-1])
        """Torque [N m] up to which the law is followed."""
        self.windup_reach = float(windup[-1])
        """Wind-up [rad] there."""
        self._torques, self._windups = torque, windup
        self._by_windup = _hermite_coefficients(windup, torque, 1.0 / compliance)
        self._by_torque = _hermite_coefficients(torque, windup, compliance)
        self._list_pieces()

    def _list_pieces(self) -> None:
        """List wind-ups and polynomials, which are read faster than arrays at single instants."""
        self._breaks = self._windups.tolist()
        self._pieces = [tuple(piece) for piece in self._by_windup.tolist()]

    @classmethod
    def linear(cls, stiffness: float) -> JointSpring:
        """Return a linear spring without a limit [N m/rad]."""
        spring = cls.__new__(cls)
        spring.torque_reach, spring.windup_reach = np.inf, _LINEAR_REACH
        torque, windup = (np.array([0.0, size * _LINEAR_REACH]) for size in (stiffness, 1.0))
        spring._torques, spring._windups = torque, windup
        slope = np.full(2, stiffness)
        spring._by_windup = _hermite_coefficients(windup, torque, slope)
        spring._by_torque = _hermite_coefficients(torque, windup, 1.0 / slope)
        spring._list_pieces()
        return spring

    def times(self, factor: float) -> JointSpring:
        """Return the spring with its torque times `factor` at every wind-up."""
        other = copy.copy(self)
        other.torque_reach = factor * self.torque_reach
        other._torques = factor * self._torques
        other._by_windup = factor * self._by_windup
        other._by_torque = self._by_torque / factor ** np.arange(4)
        other._list_pieces()
        return other

    @property
    def by_windup(self) -> tuple[np.ndarray, np.ndarray]:
        """Breaks (k,) [rad] and torque polynomials (k, 4) from each on, lowest power first."""
        return self._windups, self._by_windup

    def torque_at(self, windup: float) -> tuple[float, float]:
        """Torque [N m] and tangent stiffness [N m/rad] at one wind-up [rad]."""
        size = windup if windup >= 0.0 else -windup
        k = bisect_right(self._breaks, size) - 1
        c0, c1, c2, c3 = self._pieces[k]
        x = size - self._breaks[k]
        torque = c0 + x * (c1 + x * (c2 + x * c3))
        return (torque if windup >= 0.0 else -torque), c1 + x * (2.0 * c2 + x * 3.0 * c3)

    def torque_alone(self, windup: float) -> float:
        """Torque [N m] at one wind-up [rad], without the stiffness there."""
        size = windup if windup >= 0.0 else -windup
        k = bisect_right(self._breaks, size) - 1
        c0, c1, c2, c3 = self._pieces[k]
        x = size - self._breaks[k]
        torque: float = c0 + x * (c1 + x * (c2 + x * c3))
        return torque if windup >= 0.0 else -torque

    def torque(self, windup: np.ndarray) -> np.ndarray:
        """Torques (k,) [N m] at wind-ups (k,) [rad]."""
        return _evaluate_odd_cubics(self._by_windup, self._windups, windup)

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Wind-ups (k,) [rad] at torques (k,) [N m]; the inverse of `torque`."""
        return _evaluate_odd_cubics(self._by_torque, self._torques, torque)

    def compliance(self, torque: np.ndarray) -> np.ndarray:
        """Tangent compliances (k,) [rad/(N m)] at torques (k,) [N m]."""
        size, breaks = np.abs(torque), self._torques
        piece = np.searchsorted(breaks, size, side="right") - 1
        _, c1, c2, c3 = self._by_torque[piece].T
        x = size - breaks[piece]
        return np.asarray(c1 + x * (2.0 * c2 + x * 3.0 * c3))


def joint_springs(robot: Robot) -> tuple[JointSpring | None, ...]:
    """Spring of each joint, None where it is rigid.

    Raises `NotSimulatedError`: the wind-up of a joint diverges.
    """
    return tuple(
        None if chain is None or not chain.stages else _joint_spring(chain, float(torque), name)
        for chain, torque, name in zip(
            robot.chains, robot.torque_max, robot.joint_names, strict=True
        )
    )


@functools.lru_cache(maxsize=64)
def _joint_spring(chain: Chain, torque_max: float, name: str) -> JointSpring:
    return JointSpring(chain, torque_max, name)


def _largest_finite_torque(chain: Chain, wanted: float) -> float:
    """Largest torque at which the compliance is finite, `wanted` at most."""
    held, slips = 0.0, wanted
    # Few calls with many torques each: the law costs little more for many than for one.
    for _ in range(4):
        tried = np.linspace(held, slips, 33)[1:]
        broken = np.flatnonzero(~np.isfinite(exact_compliance(chain, tried)))
        if not broken.size:
            return wanted
        first = int(broken[0])
        held, slips = (float(tried[first - 1]) if first else held), float(tried[first])
    return _USED_SHARE_OF_SLIP_TORQUE * held


def _table_torques(chain: Chain, reach: float) -> np.ndarray:
    """Torques of the table, dense near zero, where contacts begin steeply."""
    share = np.linspace(0.0, 1.0, _TABLE_POINTS)
    # Dense at the other end too: towards slip the stiffness falls steeply.
    graded = 0.5 * share**3 + 0.5 * (1.0 - (1.0 - share) ** 3)
    torques = reach * np.concatenate([graded, share**3])
    kinks = [torque for torque in breakpoints(chain) if torque < reach]
    # Either side of a kink, so that no cubic spans it.
    beside = [torque * factor for torque in kinks for factor in (1.0 - 1e-9, 1.0 + 1e-9)]
    ordered = np.unique(np.concatenate([torques, beside]))
    return np.asarray(ordered[np.concatenate([[True], np.diff(ordered) > 1e-12 * reach])])


def _hermite_coefficients(x: np.ndarray, y: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Coefficients (k, 4), lowest power first, of Hermite cubics; the last one is linear."""
    h, rise = np.diff(x), np.diff(y)
    mean = rise / h
    c2 = (3.0 * mean - 2.0 * slope[:-1] - slope[1:]) / h
    c3 = (slope[:-1] + slope[1:] - 2.0 * mean) / h**2
    inner = np.column_stack([y[:-1], slope[:-1], c2, c3])
    return np.vstack([inner, [y[-1], slope[-1], 0.0, 0.0]])


def _evaluate_odd_cubics(cubics: np.ndarray, knots: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Evaluate an odd function given by cubics for positive arguments."""
    size = np.abs(np.asarray(x, dtype=float))
    k = np.searchsorted(knots, size, side="right") - 1
    local = size - knots[k]
    c = cubics[k]
    value = c[..., 0] + local * (c[..., 1] + local * (c[..., 2] + local * c[..., 3]))
    return np.asarray(np.sign(x) * value)
