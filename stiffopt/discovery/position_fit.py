"""Simulation from commands: fitted to training runs, judged on others, stored and read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stiffopt.actuator.law import ActuatorLaw
from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.least_squares import Polished
from stiffopt.closed_loop.parameters import (
    AMPLITUDES,
    BODY_PARAMETERS,
    DELAY,
    JOINT_PARAMETERS,
    RATIO_UNITS,
    Parameters,
    zero_parameters,
)
from stiffopt.closed_loop.physics import LoopPhysics
from stiffopt.closed_loop.simulation import simulate
from stiffopt.discovery.extended.model import ExtendedModel
from stiffopt.discovery.extended.schema import ClosedLoopSection
from stiffopt.discovery.loop_effects import robot_in_loop
from stiffopt.discovery.loop_fit import (
    DRIVE_PARAMETERS,
    commanded_run,
    fit_loop,
    is_commanded,
    nominal_parameters,
)
from stiffopt.discovery.progress import Say
from stiffopt.errors import InputError
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.robot.batched_kinematics import frame_positions
from stiffopt.units import joint_unit

# Residual over the encoders' noise and the simulation's own error from which something is missing:
# fits of arms that lack nothing leave up to 1.2.
_OPEN_NOISE_RATIO = 1.3


# Values of the actuators that a stored model holds, one number a joint each.
_LAW_LISTS = ("stiffness", "damping", "drive_max", "torque_max", "tolerance", "integral")


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoopModel:
    """Nominal and fitted simulation of an arm from its commands."""

    # nominal_loop, loop: of the nominal robot, and with the findings.
    nominal_loop: CommandedArm
    loop: CommandedArm
    nominal: Parameters
    fitted: Parameters
    deviations: np.ndarray  # (p,) one standard deviation of each fitted parameter
    # The fit, and its residual (n,) over noise and own error; None of a model that was read.
    polished: Polished | None = None
    noise_ratio: np.ndarray | None = None
    # expected, expected_deviations: the same before the fit; None of a model that was read.
    expected: Parameters | None = None
    expected_deviations: np.ndarray | None = None
    # (n,) parameters over the gain with standard deviations, where torque has no scale; else nan.
    ratios: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    # Labels of effects of the extended model that the simulation fits as well without.
    without: tuple[str, ...] = ()

    @property
    def misfit(self) -> float:
        """Sum of the logarithms of the residuals; fits of the same runs differ by it."""
        assert self.polished is not None
        changing = np.isfinite(self.polished.noise)
        return float(np.log(self.polished.residual[changing]).sum())

    @property
    def left_torque(self) -> np.ndarray:
        """Return what it leaves in each joint (n,) beyond noise and its own error [N m]."""
        assert self.polished is not None
        fit = self.polished
        known = np.nan_to_num(fit.noise) ** 2 + fit.discretisation**2
        gain = self.loop.law.stiffness * (1.0 + self.fitted.of("gain"))
        return np.asarray(gain * np.sqrt(np.maximum(fit.residual**2 - known, 0.0)))

    def log_evidence(self, place: int, size: float) -> float:
        """Return the log odds that a fitted parameter is not zero, of so many deviations."""
        assert self.polished is not None
        spread = self.polished.expected_deviations[place] / self.deviations[place]
        return 0.5 * size**2 - float(np.log(spread))

    @property
    def lacks(self) -> np.ndarray:
        """Return the joints (n,) in which it leaves more than noise and its own error."""
        assert self.noise_ratio is not None
        return np.asarray(self.noise_ratio > _OPEN_NOISE_RATIO)


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionRun:
    """One run with its simulations, which saw its commands and its first position alone."""

    name: str
    role: str
    time: np.ndarray  # (K,) [s]
    # command, measured, before, after (K, n): positions in the joint order of the set [rad]; before
    # and after the diagnosis.
    command: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    # tool_before, tool_after (K,): distances of the simulated from the measured tool [m].
    tool_before: np.ndarray
    tool_after: np.ndarray


def fit_positions(
    recordings: RecordingSet,
    runs: Sequence[RecordedRun],
    model: ExtendedModel | None = None,
    estimated: Parameters | None = None,
    say: Say = lambda _: None,
    before: ClosedLoopModel | None = None,
) -> ClosedLoopModel | None:
    """Fit a simulation from commands to training runs, beginning with the findings of a model.

    `before`: a fit of the same runs with more findings; its values of joints are begun with.

    Joints whose gain gives torque no scale begin with the drives of `estimated`. Amplitudes of the
    findings are fitted with all else.

    None where a joint has no gain, which would not be held, or no command, and where the findings
    make the loop unstable.
    """
    robot, physics = recordings.robot, LoopPhysics()
    values: Mapping[tuple[str, int], float] = {}
    if model is not None:
        robot, physics, values = robot_in_loop(recordings, model)
    begun, law = nominal_parameters(recordings, robot, physics), recordings.actuator
    for (name, joint), value in values.items():
        begun.values[begun.place(name)][joint] += value
    if estimated is not None and law is not None:
        unscaled = ~law.scaled[np.argsort(recordings.order)]
        for name in DRIVE_PARAMETERS.values():
            place = begun.place(name)
            begun.values[place] = np.where(unscaled, estimated.of(name), begun.of(name))
    begun.values[:] = np.clip(begun.values, *begun.bounds.T)
    start = None if before is None else _joints_of(before, begun, physics)
    found = fit_loop(recordings, runs, begun, say, tree=robot.tree, physics=physics, start=start)
    if found is None:
        return None
    loop, fitted = found
    return ClosedLoopModel(
        nominal_loop=CommandedArm(recordings.robot.tree, loop.law, loop.middle),
        loop=loop,
        nominal=nominal_parameters(recordings, recordings.robot),
        fitted=fitted.parameters,
        deviations=fitted.deviations,
        polished=fitted,
        # A joint that stands in all runs lacks nothing.
        noise_ratio=np.nan_to_num(
            fitted.residual / np.hypot(fitted.noise, fitted.discretisation), nan=1.0
        ),
        expected=fitted.expected,
        expected_deviations=fitted.expected_deviations,
        ratios=_ratios_to_gain(loop.law, fitted),
    )


def _joints_of(before: ClosedLoopModel, begun: Parameters, physics: LoopPhysics) -> Parameters:
    """Return parameters of joints, amplitudes and delay of a fit, with the bodies of another."""
    own, values = before.fitted, begun.values.copy()
    joints = slice(0, begun.bodies.start)
    values[joints], values[-1] = own.values[joints], own.delay
    names = before.loop.physics.amplitudes.names
    known = dict(zip(names, own.values[own.amplitudes], strict=True))
    values[begun.amplitudes] = [known[name] for name in physics.amplitudes.names]
    return replace(begun, values=values)


def _ratios_to_gain(law: ActuatorLaw, fitted: Polished) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return parameters over the gain of joints whose torque has no scale; nan for the others."""
    if law.scaled.all():
        return {}
    found = {}
    for name in RATIO_UNITS:
        value, spread = fitted.over_gain(name, law.stiffness)
        found[name] = (np.where(law.scaled, np.nan, value), np.where(law.scaled, np.nan, spread))
    return found


def simulate_run(recordings: RecordingSet, model: ClosedLoopModel, run: RecordedRun) -> PositionRun:
    """Simulate a run from its commands and its first position with both models."""
    own, order = commanded_run(recordings, run), recordings.order
    before, after = (
        simulate(loop, own, parameters)
        for loop, parameters in (
            (model.nominal_loop, model.nominal),
            (model.loop, model.fitted),
        )
    )
    robot = recordings.robot
    places = [frame_positions(robot.tree, robot.tool, q) for q in (own.position, before, after)]
    return PositionRun(
        name=run.name,
        role=run.role,
        time=own.time,
        command=own.command[:, order],
        measured=own.position[:, order],
        before=before[:, order],
        after=after[:, order],
        tool_before=np.linalg.norm(places[1] - places[0], axis=1),
        tool_after=np.linalg.norm(places[2] - places[0], axis=1),
    )


def simulate_held_out(
    recordings: RecordingSet, loop: ClosedLoopModel | None
) -> tuple[PositionRun, ...]:
    """Simulate held-out runs from their commands."""
    if loop is None:
        return ()
    runs = (recordings.open(entry) for entry in recordings.with_role("test", "extrapolate"))
    return tuple(simulate_run(recordings, loop, run) for run in runs if is_commanded(run))


def model_section(
    recordings: RecordingSet, model: ClosedLoopModel | None
) -> ClosedLoopSection | None:
    """Return a closed loop as a section of extended.toml, in the joint order of the set."""
    if model is None:
        return None
    law, order = model.loop.law.reordered(recordings.order), recordings.order

    def table(own: Parameters | None) -> dict[str, tuple[float, ...]]:
        if own is None:
            return {}
        found = {name: tuple(own.of(name)[order]) for name in JOINT_PARAMETERS}
        found |= {name: tuple(own.of_bodies(name)[order]) for name in BODY_PARAMETERS}
        found[AMPLITUDES] = tuple(own.values[own.amplitudes])
        return found | {DELAY: (own.delay,)}

    def spread(deviations: np.ndarray | None) -> Parameters | None:
        return None if deviations is None else replace(model.fitted, values=deviations)

    return ClosedLoopSection(
        **{name: tuple(getattr(law, name)) for name in _LAW_LISTS},
        delay=model.nominal.delay,
        middle=tuple(model.loop.middle[order]),
        values=table(model.fitted),
        deviations=table(spread(model.deviations)),
        expected=table(model.expected),
        expected_deviations=table(spread(model.expected_deviations)),
        ratios={name: tuple(value[order]) for name, (value, _) in model.ratios.items()},
        ratio_deviations={name: tuple(sd[order]) for name, (_, sd) in model.ratios.items()},
        without=model.without,
    )


def loop_values(
    section: ClosedLoopSection | None, prismatic: Sequence[bool] | np.ndarray
) -> list[dict[str, Any]]:
    """Return the fitted values of joints and of the arm with what was expected of them.

    Gains and damping of an actuator are told whole, not as changes.
    """
    if section is None or not section.expected:
        return []
    found: list[dict[str, Any]] = []
    whole = {"gain": section.stiffness, "damping": section.damping}
    units = {"gain": "N m/rad", "damping": "N m s/rad"}
    for name, values in section.values.items():
        if name in (*BODY_PARAMETERS, AMPLITUDES):
            continue
        tables = (section.deviations, section.expected, section.expected_deviations)
        for j, four in enumerate(zip(values, *(table[name] for table in tables), strict=True)):
            value, sd, expected, expected_sd = four
            if name in whole:
                nominal = whole[name][j]
                value, expected = nominal * (1.0 + value), nominal * (1.0 + expected)
                sd, expected_sd = nominal * sd, nominal * expected_sd
            unit = units.get(name, JOINT_PARAMETERS.get(name, "s"))
            found.append(
                {
                    "joint": None if name == DELAY else j + 1,
                    "parameter": name,
                    "unit": joint_unit(unit, bool(prismatic[j])),
                    "value": value,
                    "sd": sd,
                    "expected": expected,
                    "expected_sd": expected_sd,
                }
            )
    return found


def read_model(recordings: RecordingSet, model: ExtendedModel) -> ClosedLoopModel:
    """Return the closed loop of an extended model.

    Raises `InputError`: a list of another length than the joints, an unknown or missing parameter,
    or a value that none can have.
    """
    section = model.closed_loop
    assert section is not None
    n, back = recordings.n, np.argsort(recordings.order)
    every = model.extension.effects
    own = tuple(each for each in every if each.located.label not in section.without)
    simulated = replace(model, extension=replace(model.extension, effects=own))
    robot, physics, _ = robot_in_loop(recordings, simulated)
    lists: dict[str, Any] = {
        name: np.array(getattr(section, name)) for name in (*_LAW_LISTS, "middle")
    }
    lists["integral"] = lists["integral"] if section.integral else np.zeros(n)
    if any(len(each) != n for each in lists.values()):
        raise InputError(f"closed_loop needs one number a joint ({n}) in every list.")
    middle = lists.pop("middle")[back]
    law = ActuatorLaw(delay=section.delay, **lists)
    inside = law.reordered(back)
    known = recordings.with_actuator(law)
    none = zero_parameters(recordings.robot.joint_names, physics.amplitudes.bounds)
    fitted, spread = (
        _read_parameters(getattr(section, key), f"closed_loop.{key}", none, back)
        for key in ("values", "deviations")
    )
    wrong = ~np.isfinite(fitted.values)
    # The delay of all joints together may lie before one that a joint has of its own.
    least, greatest = fitted.bounds.T
    wrong[:-1] |= ((fitted.values < least) | (fitted.values > greatest))[:-1]
    if wrong.any():
        name, _ = fitted.names[int(np.argmax(wrong))]
        value, low, high = (own[wrong][0] for own in (fitted.values, least, greatest))
        raise InputError(
            f"closed_loop.values.{name} has {value:.4g}: finite numbers from {low:g} to {high:g}"
            " are allowed. Diagnose the recordings again."
        )
    return ClosedLoopModel(
        nominal_loop=CommandedArm(recordings.robot.tree, inside, middle),
        loop=CommandedArm(robot.tree, inside, middle, physics),
        nominal=nominal_parameters(known, recordings.robot),
        fitted=fitted,
        deviations=spread.values,
    )


def _read_parameters(
    table: Mapping[str, tuple[float, ...]], where: str, none: Parameters, back: np.ndarray
) -> Parameters:
    """Return the parameters of a table in the joint order of the robot; `none`: all zero.

    Those that files of earlier versions lack are none.
    """
    table = {**dict.fromkeys(("creep", "integral", "deadband"), (0.0,) * none.n), **table}
    found = replace(none, values=none.values.copy())
    sizes = {**dict.fromkeys((*JOINT_PARAMETERS, *BODY_PARAMETERS), none.n), DELAY: 1}
    sizes[AMPLITUDES] = len(none.amplitude_bounds)
    for name in {**sizes, **table}:
        if name not in table or len(table[name]) != sizes.get(name):
            given = f"has {len(table[name])} numbers" if name in table else "is missing"
            needed = f"{sizes[name]} needed" if name in sizes else "no parameter has this name"
            raise InputError(f"{where}.{name} {given}, {needed}. Diagnose the recordings again.")
    for name in JOINT_PARAMETERS:
        found.values[found.place(name)] = np.array(table[name])[back]
    for name in BODY_PARAMETERS:
        found.values[found.body_places(name)] = np.array(table[name])[back]
    found.values[found.amplitudes] = table[AMPLITUDES]
    found.values[-1] = table[DELAY][0]
    return found
