"""The motion of a result folder, sampled anew at the rate of what shall run it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.interpolate import BPoly, CubicSpline

from stiffopt.certificate.violations import CERTIFIED
from stiffopt.errors import InputError, InputFileError, relative
from stiffopt.files import read_table
from stiffopt.folders import check_result
from stiffopt.result.compensation_store import COMMAND_FILE
from stiffopt.result.store import (
    RESULT_FILE,
    TRAJECTORY_FILE,
    export_times,
    joints_of,
    read_document,
)

Which = Literal["motor", "link"]


@dataclass(frozen=True, kw_only=True)
class SampledMotion:
    """A motion as a controller takes it.

    Parameters
    ----------
    title : str
        Of the result.
    which : "motor" or "link"
        Whose motion it is.
    joint_names : tuple of str
    prismatic : array (n,) of bool
        Which joints slide.
    time : array (K,) [s]
        From 0.
    position, velocity, acceleration : array (K, n)
        [rad], [rad/s], [rad/s^2]; metres for radians where a joint slides.
    """

    title: str
    which: Which
    joint_names: tuple[str, ...]
    prismatic: np.ndarray
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


@dataclass(frozen=True, kw_only=True)
class StoredMotion:
    """The motion of a result folder between the rows of its trajectory.csv.

    Parameters
    ----------
    title : str
    which : "motor" or "link"
    joint_names : tuple of str
    prismatic : array (n,) of bool
    curve : BPoly or CubicSpline
        Position over time [s].
    """

    title: str
    which: Which
    joint_names: tuple[str, ...]
    prismatic: np.ndarray
    curve: BPoly | CubicSpline

    def sampled(self, rate: float, *, whole_steps: bool = False) -> SampledMotion:
        """Sample at a rate [Hz].

        Parameters
        ----------
        rate : float [Hz]
        whole_steps : bool
            All steps are 1/rate: the end position is held to the next whole step. Else the last
            step ends exactly with the motion.
        """
        end = float(self.curve.x[-1])
        times = export_times(end, rate)
        if whole_steps:
            times = np.arange(math.ceil(end * rate - 1e-6) + 1) / rate
        moving = times <= end
        inside = np.minimum(times, end)
        # Held at the end: at rest, whatever the curve's derivatives say of its last instant.
        velocity, acceleration = (self.curve.derivative(k)(inside) for k in (1, 2))
        return SampledMotion(
            title=self.title,
            which=self.which,
            joint_names=self.joint_names,
            prismatic=self.prismatic,
            time=times,
            position=self.curve(inside),
            velocity=np.where(moving[:, None], velocity, 0.0),
            acceleration=np.where(moving[:, None], acceleration, 0.0),
        )


def read_motion(folder: Path, which: Which = "motor") -> StoredMotion:
    """Motion of a result folder.

    Parameters
    ----------
    folder : Path
        Of `stiffopt solve`.
    which : "motor" or "link"
        What the drives are commanded (command.csv where there is one), or what the links shall do.

    Raises
    ------
    InputFileError
        No result, or none whose motion keeps its limits, or no columns of the links.
    """
    path = folder / RESULT_FILE
    document = read_document(path)
    certificate = document.get("certificate")
    if not isinstance(certificate, dict):
        raise InputFileError(path, "certificate", "this solve found no motion to export.")
    try:
        worst = float(certificate["worst_violation"]["value"])
        limit = str(certificate["worst_violation"]["limit"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputFileError(path, "certificate", f"has no usable {error}.") from error
    if not worst <= CERTIFIED:
        raise InputFileError(
            path,
            "certificate",
            f"the motion exceeds {limit.replace('_', ' ')} by {relative(worst)}, so it is not "
            "exported. Solve again until every limit holds.",
        )
    names, prismatic = joints_of(document, path)
    curve = _link_curve(folder, len(names)) if which == "link" else _motor_curve(folder, len(names))
    return StoredMotion(
        title=str(document.get("title") or folder.resolve().name),
        which=which,
        joint_names=names,
        prismatic=prismatic,
        curve=curve,
    )


def _motor_curve(folder: Path, joints: int) -> BPoly:
    """Of command.csv where there is one, else of trajectory.csv."""
    command = folder / COMMAND_FILE
    check_result(folder, COMMAND_FILE)
    return _curve(command if command.is_file() else folder / TRAJECTORY_FILE, joints)


def _link_curve(folder: Path, joints: int) -> BPoly | CubicSpline:
    """The links' columns; without them the plan, where a command of the motors stands beside it."""
    path, names = folder / TRAJECTORY_FILE, [f"link{j}" for j in range(1, joints + 1)]
    table = read_table(path, ["t"], names)
    if all(name in table for name in names):
        positions = np.array([table[name] for name in names]).T
        return CubicSpline(_time(path, table), positions, bc_type="clamped")
    if (folder / COMMAND_FILE).is_file():
        return _curve(path, joints)
    raise InputFileError(
        path,
        names[0],
        "one motion is planned for motors and links, so there is none of the links alone. "
        "Export the motors'.",
    )


def _curve(path: Path, joints: int) -> BPoly:
    """Quintic between the rows: position, velocity and acceleration are those of the file."""
    names = [[f"{quantity}{j}" for j in range(1, joints + 1)] for quantity in ("q", "qd", "qdd")]
    table = read_table(path, ["t", *chain(*names)])
    derivatives = np.array([[table[name] for name in own] for own in names])
    return BPoly.from_derivatives(_time(path, table), derivatives.transpose(2, 0, 1))


def _time(path: Path, table: dict[str, list[float]]) -> np.ndarray:
    time = np.array(table["t"])
    if time[0] != 0.0 or not np.all(np.diff(time) > 0.0):
        raise InputFileError(path, "t", "the times must begin at 0 and increase.")
    return time


def check_rate(rate: float, most: float, owner: str) -> None:
    """Raise `InputError` unless 0 < rate <= most [Hz]."""
    if not (math.isfinite(rate) and 0.0 < rate <= most):
        raise InputError(f"--rate {rate:g} Hz: {owner} takes above 0 and up to {most:g} Hz.")
