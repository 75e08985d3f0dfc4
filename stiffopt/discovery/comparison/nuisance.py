"""Nuisance values: nominal values within their tolerances, fitted before any effect counts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.inertial_parameters import all_body_parameter_names
from stiffopt.discovery.comparison.located_effect import Contribution
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.signals import PARAMETERS_PER_BODY, JointConstants, RobotConstants
from stiffopt.recording.nominal import Tolerance

# Relative standard deviation and width of the slope changes of a reducer over the torque.
_RELATIVE_KNEE_SD = 0.08
# Kinds of values that move the links.
SPRING_VALUES = ("stiffness", "T1", "T2", "rounding T1", "rounding T2")
BODY_VALUES = ("mass", "com", "body")
LINK_MOVING_VALUES = (*SPRING_VALUES, "joint_damping", *BODY_VALUES)

# Relative values that act on the drive torque alone.
_DRIVE_VALUES = ("rotor_inertia", "coulomb", "viscous", "torque_constant")
# Value in proportion to the whole drive torque.
LOAD_VALUE = "torque_constant"

# Delay of commands beyond the assumed one [s], of torques that an actuator's law gives.
COMMAND_DELAY = ValueName("command_delay", 0)
# Kinds of values of an actuator, relative: gain of the position error, and damping.
GAIN, DAMPING = "actuator_gain", "actuator_damping"

# Selects values by name.
NameFilter = Callable[[ValueName], bool]


@dataclass(frozen=True, eq=False)
class NuisanceColumn:
    """Contribution of one nominal value to the channels, or to those of one joint."""

    name: ValueName  # of a value of one joint its place is the joint
    sd: float  # tolerance of the value, one standard deviation
    field: str  # field of `Contribution`
    values: np.ndarray  # per unit of the value: (K, n), or (K,) of one joint

    def contribution(self, like: np.ndarray) -> Contribution:
        """Return the contribution per unit to all channels; signals are like (K, n) others."""
        if self.values.ndim > 1:
            return Contribution(**{self.field: self.values})
        return Contribution.of_joint(self.name.place, like, **{self.field: self.values})


# Tolerances from nominal beyond which a value is outside its tolerance, which is one standard
# deviation: chance puts one of forty values there in one set of fifty.
MIN_TOLERANCES_OUTSIDE = 3.5


@dataclass(frozen=True)
class OutsideValue:
    """A nominal value that the recordings put outside its tolerance."""

    name: ValueName
    # change, sd: fitted change from nominal, and its standard deviation: relative, or [m].
    change: float
    sd: float
    tolerance: float  # one standard deviation of the nominal value, as stated

    @property
    def of_body(self) -> bool:
        """True for masses and centres of mass."""
        return self.name.kind in BODY_VALUES


def nuisance_columns(
    run: PreparedRun, tolerance: Tolerance, bodies: np.ndarray | None, selected: NameFilter
) -> Iterator[NuisanceColumn]:
    """Yield columns of nominal values along a run, in the same order for every run.

    `bodies` (n, 10): standard deviations of all inertial parameters, in place of mass and centre of
    mass. `selected`: selects values by name.
    """
    if bodies is None:
        yield from _body_columns(run, tolerance, selected)
    else:
        names = all_body_parameter_names(run.robot)
        for k, (name, sd) in enumerate(zip(names, bodies.ravel(), strict=True)):
            if selected(name):
                torque = run.signals.body_regressor[..., k]
                yield NuisanceColumn(name, float(sd), "link_torque", torque)
    law, rate = run.robot.recordings.actuator, run.signals.command_rate
    if law is not None and law.delay_deviation and rate is not None and selected(COMMAND_DELAY):
        yield NuisanceColumn(COMMAND_DELAY, law.delay_deviation, "torque", np.asarray(rate))
    yield from joint_columns(run, tolerance, selected)


def joint_columns(
    run: PreparedRun, tolerance: Tolerance, selected: NameFilter
) -> Iterator[NuisanceColumn]:
    """Yield the columns of nominal values that act on one joint each, joint by joint."""
    signals = run.signals
    for j in range(run.robot.n):
        for kind in _DRIVE_VALUES:
            sd, name = getattr(tolerance, kind), ValueName(kind, j)
            if not sd or not selected(name):
                continue
            if np.any(values := _drive_torque_column(run, kind, j)):
                yield NuisanceColumn(name, sd, "torque", values)
        yield from _servo_columns(run, j, selected)
        if tolerance.stiffness:
            yield from _spring_columns(run, j, tolerance.stiffness, selected)
        name = ValueName("joint_damping", j)
        if tolerance.joint_damping and run.vibration is not None and selected(name):
            # Damping torque relieves the spring, which deflects less by it.
            nominal = signals.constants.joints[j].joint_damping
            taken = nominal * (signals.motor_velocity[:, j] - signals.link_velocity[:, j])
            relief = -taken / run.vibration.stiffness[:, j]
            yield NuisanceColumn(name, tolerance.joint_damping, "deflection", relief)
        name = ValueName("encoder_zero", j)
        if tolerance.encoder_zero and selected(name):
            values = np.ones(len(signals.time))
            yield NuisanceColumn(name, tolerance.encoder_zero, "reading", values)


def _servo_columns(run: PreparedRun, j: int, selected: NameFilter) -> Iterator[NuisanceColumn]:
    """Yield gain and damping of the servo of a joint that torques are derived from.

    They nearly cancel in motion: an error of either looks like viscous friction many times its
    share of the torque that they leave. A gain that the recordings told is as free as an unstated
    one is, it was told without the effects; unless nobody vouches for the masses that told it.
    """
    law, signals = run.robot.recordings.actuator, run.signals
    if law is None or not law.scaled[j]:
        return
    vouched = run.robot.recordings.tolerance.mass is not None
    deviation = float((law.stated_tolerance if vouched else law.tolerance)[j])
    if not vouched and law.damping[j] == 0.0:
        return
    damping = law.damping[j] * signals.motor_velocity[:, j]
    for kind, values in ((GAIN, signals.drive_torque[:, j] + damping), (DAMPING, damping)):
        if values.any() and selected(name := ValueName(kind, j)):
            yield NuisanceColumn(name, deviation, "torque", values)


def _drive_torque_column(run: PreparedRun, kind: str, j: int) -> np.ndarray:
    """Return the drive torque (K,) of one joint per unit of a relative value."""
    signals = run.signals
    if kind == "torque_constant":
        return np.asarray(signals.drive_torque[:, j])
    if kind == "rotor_inertia":
        return np.asarray(run.robot.rotor_inertia[j] * signals.motor_acceleration[:, j])
    if kind == "viscous":
        return np.asarray(run.robot.viscous[j] * signals.motor_velocity[:, j])
    return np.asarray(run.robot.coulomb[j] * signals.motor_direction[:, j])


def _spring_columns(
    run: PreparedRun, j: int, sd: float, selected: NameFilter
) -> Iterator[NuisanceColumn]:
    signals = run.signals
    elastic = signals.windup[:, j]
    if run.vibration is not None:
        # A relative compliance scales the whole elastic deflection of vibrating links, without
        # play.
        elastic = signals.motor_position[:, j] - signals.link_position[:, j]
        elastic -= run.play[:, j] if isinstance(run.play, np.ndarray) else run.play
    joint, spring = signals.constants.joints[j], signals.spring_torque[:, j]
    yield from _columns_of_spring(joint, elastic, spring, sd, selected)


def spring_deflection(
    constants: RobotConstants,
    values: Mapping[ValueName, float],
    elastic: np.ndarray,
    spring: np.ndarray,
) -> np.ndarray:
    """Return the deflection (K, n) by nominal values of springs [rad].

    `values`: changes, of `SPRING_VALUES`. `elastic` (K, n): elastic deflection of vibrating links
    [rad]. `spring` (K, n): torque of the springs [N m].
    """
    found = np.zeros_like(elastic)
    asked = {name for name, value in values.items() if value}
    for j, joint in enumerate(constants.joints if asked else ()):
        for own in _columns_of_spring(joint, elastic[:, j], spring[:, j], 1.0, asked.__contains__):
            found[:, j] += values[own.name] * own.values
    return found


def _columns_of_spring(
    constants: JointConstants,
    elastic: np.ndarray,
    spring: np.ndarray,
    sd: float,
    selected: NameFilter,
) -> Iterator[NuisanceColumn]:
    """Yield the columns of one spring with its elastic deflection and torque (K,)."""
    j = constants.joint - 1
    own = ValueName("stiffness", j)
    knees = (ValueName(kind, j) for kind in ("T1", "rounding T1", "T2", "rounding T2"))
    asked = [name for name in (own, *knees) if selected(name)]
    if not asked or not constants.elastic or not np.any(spring):
        return
    if asked[0] == own:
        yield NuisanceColumn(own, sd, "deflection", elastic)
    yield from _knee_columns(constants, spring, asked)


def _knee_columns(
    constants: JointConstants, spring: np.ndarray, asked: Collection[ValueName]
) -> Iterator[NuisanceColumn]:
    """Yield columns for torque and roundness of a reducer's slope changes."""
    if constants.slopes is None or constants.corners is None:
        return
    j, side, size = constants.joint - 1, np.sign(spring), np.abs(spring)
    (k1, k2, k3), (t1, t2) = constants.slopes, constants.corners
    for kind, knee, before, after in (("T1", t1, k1, k2), ("T2", t2, k2, k3)):
        fall = 1.0 / before - 1.0 / after
        width = _RELATIVE_KNEE_SD * knee
        moved, rounded = ValueName(kind, j), ValueName(f"rounding {kind}", j)
        beyond = (size - knee) / width
        if moved in asked:
            values = fall * knee * (side * np.clip(beyond, 0.0, 1.0))
            yield NuisanceColumn(moved, _RELATIVE_KNEE_SD, "deflection", values)
        if rounded in asked:
            values = side * fall * width * np.exp(-np.abs(beyond))
            yield NuisanceColumn(rounded, 1.0, "deflection", values)


def _body_columns(
    run: PreparedRun, tolerance: Tolerance, selected: NameFilter
) -> Iterator[NuisanceColumn]:
    """Yield columns for mass and centre of mass of every body."""
    for name, change in run.robot.body_value_slopes.items():
        sd = getattr(tolerance, name.kind)
        if sd and selected(name):
            torque = run.signals.body_regressor.torque_of_body(name.place, change)
            yield NuisanceColumn(name, sd, "link_torque", torque)


def body_parameter_changes(robot: RobotModel, values: Mapping[ValueName, float]) -> np.ndarray:
    """Return changes of all inertial parameters (n, 10) by nominal values of given names."""
    change = [values.get(name, 0.0) for name in all_body_parameter_names(robot)]
    found = np.array(change).reshape(robot.n, PARAMETERS_PER_BODY)
    for name, slope in robot.body_value_slopes.items():
        found[name.place] += values.get(name, 0.0) * slope
    return found


def merge_tolerances(tolerance: Tolerance, default: Tolerance) -> Tolerance:
    """Return the tolerances of the set, with defaults where it states none."""
    names = vars(default)
    return Tolerance(
        **{
            name: own if (own := getattr(tolerance, name)) is not None else default_value
            for name, default_value in names.items()
        }
    )
