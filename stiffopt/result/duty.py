"""Duty of the drives over a cycle: torque, speed, energy, and the rated life of the reducers.

Torques and speeds are those at the joint's output. The mean torque of a reducer weights its torque
by the turns made under it, the mean speed includes the rests, as makers' catalogues define them:

    T_m = (sum n_i t_i |T_i|^p / sum n_i t_i)^(1/p),  n_m = sum n_i t_i / sum t_i
    L10 = L_rated (T_rated / T_m)^p (n_rated / n_m)

with p = 3 for strain-wave gears, whose wave generator has ball bearings, and 10/3 for cycloidal
ones, that of roller bearings in ISO 281. Sources: Harmonic Drive SE, engineering data CSD-2A,
document 1019659 11/2014, section 4.1.2: L50 = L_n (n_N / n_av) (T_N / T_av)^3, L10 = L50 / 5, L_n
of 35000 h (HFUC, CSD, CSF, SHD) or 50000 h (CSG, SHG); Nabtesco, RV series catalogue, "Strength and
service life".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.result.assessment import Assessment
    from stiffopt.robot.robot import Robot

# Exponent of reducers without a rating: strain-wave gears.
_USUAL_EXPONENT = 3.0


@dataclass(frozen=True, kw_only=True)
class LifeRating:
    """Rated life of a reducer."""

    # At the output [N m], [rad/s].
    torque: float
    speed: float
    life: float | None  # L10 [s]; None where it is not known
    exponent: float  # of the torque


def life_rating(robot: Robot, joint: int) -> LifeRating:
    """Return the rating of the reducer of a joint; the drive's limits without one."""
    chain = robot.chains[joint]
    for stage in () if chain is None else chain.stages:
        # Elements of other kinds, which this layer does not import, have no rating.
        names = ("rated_torque", "rated_speed", "rated_life", "life_exponent")
        rated = [getattr(stage.element, name, None) for name in names]
        if None not in rated:
            torque, speed, life, exponent = np.array(rated, dtype=float).tolist()
            return LifeRating(
                torque=torque * stage.reduction,
                speed=speed / stage.ratio,
                life=life,
                exponent=exponent,
            )
    return LifeRating(
        torque=float(robot.torque_max[joint]),
        speed=float(robot.velocity_max[joint]),
        life=None,
        exponent=_USUAL_EXPONENT,
    )


@dataclass(frozen=True, kw_only=True)
class DutyHistory:
    """Loads of a motion or a rest."""

    time: np.ndarray  # (K,) [s]
    # (K, n) speed [rad/s] and torque of the drives [N m].
    velocity: np.ndarray
    torque: np.ndarray
    # (K, n) torque at the output of the reducers, without friction and rotors [N m].
    reducer_torque: np.ndarray

    @classmethod
    def of_motion(cls, motion: Assessment) -> DutyHistory:
        """Return the loads of a motion."""
        return cls(
            time=motion.time,
            velocity=motion.velocity,
            torque=motion.torque,
            reducer_torque=motion.spring_torque,
        )


@dataclass(frozen=True, kw_only=True)
class JointDuty:
    """Duty of one joint over a cycle; forces [N] and speeds [m/s] where it is prismatic."""

    name: str
    prismatic: bool
    # Of the drive [N m].
    rms_torque: float
    peak_torque: float
    torque_max: float  # limit of the drive [N m]
    # Rests included [rad/s].
    peak_speed: float
    mean_speed: float
    peak_power: float  # largest mechanical power [W]
    # Mechanical work given and taken by the drive in a cycle [J].
    energy: float
    regenerated: float
    mean_torque: float  # of the reducer [N m]
    rating: LifeRating

    @property
    def life(self) -> float | None:
        """Life L10 of the reducer under repetition of the cycle [s]; None without a rating."""
        rating = self.rating
        if rating.life is None:
            return None
        if not (self.mean_torque > 0.0 and self.mean_speed > 0.0):
            return np.inf
        ratio = (rating.torque / self.mean_torque) ** rating.exponent
        return float(rating.life * ratio * rating.speed / self.mean_speed)


@dataclass(frozen=True, kw_only=True)
class Duty:
    """Duty of all joints over a cycle of a duration [s]."""

    duration: float
    joints: tuple[JointDuty, ...]

    @property
    def energy(self) -> float:
        """Mechanical work given by all drives in a cycle, nothing regenerated [J]."""
        return sum(each.energy for each in self.joints)

    @property
    def regenerated(self) -> float:
        """Mechanical work taken by all drives in a cycle [J]."""
        return sum(each.regenerated for each in self.joints)

    @property
    def shortest_life(self) -> JointDuty | None:
        """Joint whose reducer has the shortest life; None where none is rated."""
        rated = [each for each in self.joints if each.life is not None]
        return min(rated, key=lambda each: each.life or np.inf, default=None)

    @property
    def most_loaded(self) -> JointDuty:
        """Joint whose rms torque is the largest share of its limit."""
        return max(self.joints, key=lambda each: each.rms_torque / each.torque_max)

    def document(self) -> dict[str, Any]:
        """Content of `duty` in cycle.json; SI."""
        return {
            "energy": self.energy,
            "regenerated": self.regenerated,
            "joints": [
                {
                    **{key: value for key, value in vars(each).items() if key != "rating"},
                    "reducer_life": each.life,
                    "rating": None if each.rating.life is None else dict(vars(each.rating)),
                }
                for each in self.joints
            ],
        }


@dataclass(frozen=True, kw_only=True)
class DutyUse:
    """Use of one limit of a duty."""

    objective: str  # objective whose integral over the cycle the limit bounds
    joint: int  # number of its joint, from 1; 0 for all
    share: float  # integral over what the limit allows
    text: str  # the excess in words


@dataclass(frozen=True, kw_only=True, eq=False)
class DutyLimits:
    """Limits of a duty, None for none."""

    # (n,) [N m] of drives and of reducers.
    rms_torque: np.ndarray | None = None
    mean_torque: np.ndarray | None = None
    reducer_life: float | None = None  # [s]
    energy: float | None = None  # [J]

    def uses(self, duty: Duty) -> list[DutyUse]:
        """Uses of all limits."""
        found = []
        for number, each in enumerate(duty.joints, start=1):
            for name, limits, objective, power in (
                ("rms_torque", self.rms_torque, "torque_squared", 2.0),
                ("mean_torque", self.mean_torque, "reducer_load", each.rating.exponent),
            ):
                if limits is None:
                    continue
                value, limit = getattr(each, name), float(limits[number - 1])
                unit = joint_unit("N m", each.prismatic)
                words = f"the {name.replace('_', ' ')} of {each.name}, {value:.4g} {unit}, exceeds "
                text = f"{words}duty.{name} {limit:.4g} {unit}"
                found.append(DutyUse(objective=objective, joint=number,
                                     share=(value / limit) ** power, text=text))  # fmt: skip
            if self.reducer_life is not None and each.life is not None:
                text = (
                    f"the reducer of {each.name} lasts {each.life / 3600.0:.4g} h, below "
                    f"duty.reducer_life {self.reducer_life / 3600.0:.4g} h"
                )
                share = self.reducer_life / each.life
                found.append(DutyUse(objective="reducer_load", joint=number,
                                     share=share, text=text))  # fmt: skip
        if self.energy is not None:
            text = f"the work of {duty.energy:.4g} J exceeds duty.energy {self.energy:.4g} J"
            share = duty.energy / self.energy
            found.append(DutyUse(objective="drive_work", joint=0, share=share, text=text))
        return found


def duty_of(robot: Robot, histories: Sequence[DutyHistory]) -> Duty:
    """Duty of the drives over consecutive histories."""
    ratings = [life_rating(robot, j) for j in range(robot.n)]
    duration = sum(float(each.time[-1] - each.time[0]) for each in histories)

    def integral(of: Any) -> np.ndarray:
        return np.asarray(sum(np.trapezoid(of(each), each.time, axis=0) for each in histories))

    def peak(of: Any) -> np.ndarray:
        return np.asarray(np.max([np.max(of(each), axis=0) for each in histories], axis=0))

    exponents = np.array([each.exponent for each in ratings])
    square = integral(lambda h: h.torque**2)
    turns = integral(lambda h: np.abs(h.velocity))
    loaded = integral(lambda h: np.abs(h.velocity) * np.abs(h.reducer_torque) ** exponents)
    mean = np.where(turns > 0.0, loaded / np.where(turns > 0.0, turns, 1.0), 0.0)
    work = integral(lambda h: np.maximum(h.torque * h.velocity, 0.0))
    back = integral(lambda h: np.maximum(-h.torque * h.velocity, 0.0))
    columns = {
        "rms_torque": np.sqrt(square / duration),
        "peak_torque": peak(lambda h: np.abs(h.torque)),
        "torque_max": np.asarray(robot.torque_max, dtype=float),
        "peak_speed": peak(lambda h: np.abs(h.velocity)),
        "mean_speed": turns / duration,
        "peak_power": peak(lambda h: np.abs(h.torque * h.velocity)),
        "energy": work,
        "regenerated": back,
        "mean_torque": mean ** (1.0 / exponents),
    }
    joints = tuple(
        JointDuty(
            name=robot.joint_names[j],
            prismatic=bool(robot.prismatic[j]),
            rating=ratings[j],
            **{key: float(values[j]) for key, values in columns.items()},
        )
        for j in range(robot.n)
    )
    return Duty(duration=duration, joints=joints)
