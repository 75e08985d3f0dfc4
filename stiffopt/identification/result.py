"""What a static set says of an arm: stiffness of its joints, errors, torque dependence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiffopt.identification.rows import StaticRows
from stiffopt.identification.torque_dependence import TorqueDependence
from stiffopt.recording.static_set import StaticSet

Status = Literal["identified", "lower_bound", "not_loaded", "confounded"]


@dataclass(frozen=True, kw_only=True)
class JointStiffness:
    """Stiffness of one joint as the poses show it [N m/rad, N/m for a prismatic joint].

    Parameters
    ----------
    joint : int
        From 1.
    name : str
    unit : str
    status : str
        "identified"; "lower_bound": the poses do not exclude a rigid joint; "not_loaded" and
        "confounded": they say nothing of this joint alone.
    reason : str
        A sentence; empty if identified.
    stiffness, sd : float or None
        Estimate and its standard deviation.
    lower, upper : float or None
        95 % interval; an upper end of None is rigid.
    least_squares : float or None
        Plain least squares, every pose in full.
    compliance : float or None
        [rad/(N m)]
    compliance_sd, compliance_sd_alike, compliance_sd_bootstrap : float or None
        By leaving out poses; if all errors were alike; by drawing poses anew. The first two are
        combined into `sd` and the interval: the larger one counts.
    bootstrap_lower, bootstrap_upper : float or None
        Interval of the middle 95 % of the fits to poses drawn anew.
    nominal : float or None
    z_nominal : float or None
        Identified less nominal compliance, in standard deviations.
    torque : tuple of 3 float
        5, 50 and 95 % of the poses load the joint by no more than this (magnitude) [N m].
    leverage : float
        How far the joint moves the tool over the joint that moves it most, at equal stiffness.
    """

    joint: int
    name: str
    unit: str
    status: Status
    reason: str
    stiffness: float | None
    sd: float | None
    lower: float | None
    upper: float | None
    least_squares: float | None
    compliance: float | None
    compliance_sd: float | None
    compliance_sd_alike: float | None
    compliance_sd_bootstrap: float | None
    bootstrap_lower: float | None
    bootstrap_upper: float | None
    nominal: float | None
    z_nominal: float | None
    torque: tuple[float, float, float]
    leverage: float


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Root mean square of one component of the displacement or of its error [m].

    Parameters
    ----------
    displacement : float
        Measured.
    fit, left_out : float
        Of the robust fit on its own poses; on poses left out one at a time.
    least_squares, least_squares_left_out : float
        The same by plain least squares.
    nominal : float or None
        With the nominal stiffness.
    """

    displacement: float
    fit: float
    left_out: float
    least_squares: float
    least_squares_left_out: float
    nominal: float | None


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticStiffness:
    """Answer of `identify_stiffness`.

    Parameters
    ----------
    source : StaticSet
    rows : StaticRows
    joints : tuple of JointStiffness
    errors : Errors
    predicted, left_out : array (m, 3)
        Displacement by the fit, and by the fit without that pose [m].
    weight : array (m,)
        How far each pose counts.
    scale : float
        Robust standard deviation of one component [m].
    outliers : tuple of int
        Poses that do not fit the others, from 1.
    correlation : array (n, n)
        Of the compliances; nan for joints that are not identifiable.
    torque_dependence : TorqueDependence
    assumptions : tuple of str
    """

    source: StaticSet
    rows: StaticRows
    joints: tuple[JointStiffness, ...]
    errors: Errors
    predicted: np.ndarray
    left_out: np.ndarray
    weight: np.ndarray
    scale: float
    outliers: tuple[int, ...]
    correlation: np.ndarray
    torque_dependence: TorqueDependence
    assumptions: tuple[str, ...]
