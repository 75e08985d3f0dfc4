"""Load effects of a user's Python file, and validate effects on signals of a sample arm."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import inspect
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, get_args

import numpy as np

from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.effect import NEEDS, Effect, Scope, Term
from stiffopt.discovery.signals import (
    JointConstants,
    JointSignals,
    RobotConstants,
    RobotSignals,
    smooth_sign,
)
from stiffopt.errors import InputFileError
from stiffopt.recording.nominal_files import build_joint_chain

_FILE_HINT = (
    "A file of effects holds `stiffopt.discovery.effect.Effect` objects at module level, or"
    " functions without arguments that are annotated `-> Effect`."
)


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Load the effects that a Python file defines, validated like those of the catalogue.

    `path`: the file; it is run. Effects are in the order of the file.

    Raises `InputFileError`: the file cannot be run, defines no effect, uses a name twice or one of
    the catalogue, or an effect is invalid: not linear in its amplitudes, out of bounds.

    A term maps (signals, amplitudes, shapes) to a `Term`, with NumPy's functions. Simulation from
    commands contains those that are plain formulas of angle, speed and torque.
    """
    path = Path(path)
    module = _execute_file(path)
    found = list(_collect_effects(module, path))
    if not found:
        raise InputFileError(path, "", f"no effect is defined here. {_FILE_HINT}")
    taken = {entry.name: "the catalogue" for entry in CATALOGUE}
    for where, effect in found:
        if effect.name in taken:
            raise InputFileError(
                path,
                where,
                f"the name {effect.name!r} is taken by {taken[effect.name]}; choose another.",
            )
        taken[effect.name] = where
        for fault in find_faults(effect):
            raise InputFileError(path, where, f"effect {effect.name!r} cannot be used: {fault}")
    return tuple(effect for _, effect in found)


def _execute_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise InputFileError(path, "", "no such file; give the path of a Python file of effects.")
    name = f"stiffopt_user_effects_{path.stem}"
    loader = importlib.machinery.SourceFileLoader(name, str(path))
    spec = importlib.util.spec_from_loader(name, loader)
    if spec is None:
        raise InputFileError(path, "", "this is no Python file.")
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look up their module while the file runs.
    sys.modules[name] = module
    try:
        loader.exec_module(module)
    except Exception as error:
        raise InputFileError(
            path,
            _error_line(error, path),
            f"the file cannot be run: {type(error).__name__}: {error}",
        ) from error
    finally:
        sys.modules.pop(name, None)
    return module


def _error_line(error: Exception, path: Path) -> str:
    """Return the last line of the file in an error's traceback, or ""."""
    trace, line = error.__traceback__, ""
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = f"line {trace.tb_lineno}"
        trace = trace.tb_next
    return line


def _collect_effects(module: ModuleType, path: Path) -> Iterator[tuple[str, Effect]]:
    seen: list[Effect] = []
    for name, value in vars(module).items():
        if name.startswith("_"):
            continue
        for effect in _effects_of_name(module, path, name, value):
            if any(effect is other for other in seen) or any(effect is e for e in CATALOGUE):
                continue
            seen.append(effect)
            yield name, effect


def _effects_of_name(module: ModuleType, path: Path, name: str, value: Any) -> Sequence[Effect]:
    """Return the effects that one module-level name holds or returns."""
    if isinstance(value, Effect):
        return [value]
    if isinstance(value, list | tuple) and any(isinstance(v, Effect) for v in value):
        return [v for v in value if isinstance(v, Effect)]
    if not inspect.isfunction(value) or value.__module__ != module.__name__:
        return []
    signature = inspect.signature(value)
    if signature.return_annotation not in (Effect, "Effect", "effect.Effect"):
        return []
    if signature.parameters:
        raise InputFileError(
            path, name, f"a function annotated `-> Effect` takes no arguments. {_FILE_HINT}"
        )
    try:
        made = value()
    except Exception as error:
        raise InputFileError(
            path, name, f"the function fails with {type(error).__name__}: {error}"
        ) from error
    if not isinstance(made, Effect):
        raise InputFileError(
            path, name, f"it returns a {type(made).__name__}, no Effect. {_FILE_HINT}"
        )
    return [made]


TERM_PARTS = ("drive_torque", "link_torque", "deflection", "reading", "previous_torque")
SCOPES = get_args(Scope)
# A scan of the catalogue tries every combination of initial shapes at every place.
MAX_SHAPE_STARTS = 30
# More than arms have: laws of a user's file name the joints of their robot.
_SAMPLE_JOINTS = 8
_RELATIVE_TOLERANCE = 1e-9


def sample_signals(count: int = 60, dt: float = 0.01) -> RobotSignals:
    """Return signals of a sample arm: smooth, with reversals and loads of both signs.

    `count`: number of samples. `dt`: time step [s].
    """
    time = dt * np.arange(count)
    wave = np.arange(1, _SAMPLE_JOINTS + 1) * 0.7 + 2.0
    phase = 0.4 * np.arange(_SAMPLE_JOINTS)
    angle = np.outer(time, wave) + phase
    position = 0.6 * np.sin(angle)
    velocity = 0.6 * wave * np.cos(angle)
    acceleration = -0.6 * wave**2 * np.sin(angle)
    torque = 30.0 * np.cos(0.8 * angle + 1.0)
    constants = sample_constants(position, velocity, torque)
    windup = np.column_stack([c.windup(torque[:, j]) for j, c in enumerate(constants.joints)])
    motor_velocity = velocity + np.gradient(windup, dt, axis=0)
    friction = 4.0 * np.tanh(velocity / 0.01) + 3.0 * velocity
    lever = np.sin(np.arange(3 * _SAMPLE_JOINTS).reshape(3, _SAMPLE_JOINTS) + angle[:, None, :])
    body = np.cos(np.arange(10 * _SAMPLE_JOINTS) + angle[:, :, None])
    tool = np.column_stack([0.4 * np.cos(time), 0.4 * np.sin(time), 0.5 + 0.3 * np.cos(8 * time)])
    return RobotSignals(
        time=time,
        dt=dt,
        session_time=time + 60.0,
        temperature_rise=np.tile(8.0 + time[:, None], (1, _SAMPLE_JOINTS)),
        motor_position=position + windup,
        motor_velocity=motor_velocity,
        motor_acceleration=acceleration,
        motor_direction=smooth_sign(motor_velocity),
        link_position=position,
        link_velocity=velocity,
        link_acceleration=acceleration,
        transmitted_torque=torque,
        spring_torque=torque,
        windup=windup,
        drive_torque=torque + friction,
        drive_torque_rate=np.gradient(torque + friction, dt, axis=0),
        arm=SimpleNamespace(
            tool_position=tool,
            tool_jacobian=lever,
            tool_levers=np.swapaxes(np.concatenate([lever, lever[:, ::-1]], axis=1), 1, 2),
            body_regressor=body,
            weight=2.0 * np.stack([np.sin(angle), np.cos(angle), np.sin(2.0 * angle)], axis=2),
            zero_harmonics=3.0 * np.sin(np.arange(4 * _SAMPLE_JOINTS) + angle[:, :, None]),
        ),
        last_link=_SAMPLE_JOINTS - 1,
        link=2,
        constants=constants,
    )


def sample_constants(
    position: np.ndarray, velocity: np.ndarray, torque: np.ndarray
) -> RobotConstants:
    """Return constants of the sample arm, with the ranges of a motion (K, n)."""
    joints = tuple(
        JointConstants(
            joint=j + 1,
            ratio=101.0,
            coulomb=4.0,
            viscous=3.0,
            torque_rated=40.0,
            torque_max=120.0,
            rotor_inertia=0.36,
            joint_damping=60.0,
            chain=build_joint_chain((1.6e4, 2.5e4, 2.9e4, 7.0, 25.0), 6.5e4, 120.0),
            pole_pairs=4.0,
            stroke=(float(position[:, j].min()), float(position[:, j].max())),
            fastest=float(np.abs(velocity[:, j]).max()),
            measured_torque=float(np.abs(torque[:, j]).max()),
            largest_torque=float(np.abs(torque[:, j]).max()),
            joints=position.shape[1],
        )
        for j in range(position.shape[1])
    )
    return RobotConstants(
        joints=joints,
        links=tuple(f"link_{j + 1}" for j in range(len(joints))),
        masses=np.full(len(joints), 4.0),
        centres=np.full((len(joints), 3), 0.05),
        tool_range=np.array([[-0.4, -0.4, 0.2], [0.4, 0.4, 0.8]]),
    )


def sample_signals_of(effect: Effect, robot: RobotSignals) -> JointSignals | RobotSignals:
    """Return the signals for an effect's scope; of joints the fifth, which has two neighbours."""
    of_robot = effect.of_robot or effect.scope == "link" or effect.couples_joints
    return robot if of_robot else robot.of_joint(4)


def constants_at(
    effect: Effect, signals: JointSignals | RobotSignals
) -> JointConstants | RobotConstants:
    """Return the constants for sizes and shapes of an effect: of its joint, else of the robot."""
    if effect.couples_joints and isinstance(signals, RobotSignals):
        return signals.constants.joints[signals.link]
    return signals.constants


def sample_term(effect: Effect) -> Term:
    """Return the term of an effect of typical size on the sample arm."""
    signals = sample_signals_of(effect, sample_signals())
    sizes = [a.size(constants_at(effect, signals)) for a in effect.amplitudes]
    return effect.term(signals, sizes, _initial_shapes(effect, signals))


def acts_at_rest(effect: Effect) -> bool:
    """Return True if an effect acts on an arm at rest, in every pose by that pose alone.

    A delay does not: poses in the opposite order give other contributions.
    """
    moving = sample_signals()
    terms = []
    for order in (slice(None), slice(None, None, -1)):
        signals = sample_signals_of(effect, _hold_still(moving, order))
        sizes = [a.size(signals.constants) for a in effect.amplitudes]
        shapes = _initial_shapes(effect, signals)
        term = effect.term(signals, sizes, shapes)
        parts = [np.asarray(getattr(term, part), dtype=float) for part in TERM_PARTS]
        terms.append([part[order] if part.size > 1 else part for part in parts])
    ahead, back = terms
    same = all(np.allclose(one, other) for one, other in zip(ahead, back, strict=True))
    return same and any(part.size > 1 and part.any() for part in ahead)


def _hold_still(moving: RobotSignals, order: slice) -> RobotSignals:
    """Return the poses of a motion without its velocities, in an order of the samples."""
    rest = np.zeros_like(moving.motor_velocity)
    places = ("motor_position", "link_position", "transmitted_torque", "spring_torque", "windup")
    speeds = ("motor_velocity", "motor_acceleration", "motor_direction", "link_velocity")
    return replace(
        moving,
        **{name: getattr(moving, name)[order] for name in places},
        **dict.fromkeys((*speeds, "link_acceleration", "drive_torque_rate"), rest),
        drive_torque=moving.spring_torque[order],
        arm=SimpleNamespace(**{name: value[order] for name, value in vars(moving.arm).items()}),
    )


def find_faults(effect: Effect) -> Iterator[str]:
    """Yield the faults of an effect, a sentence each; none for a valid one."""
    signals = sample_signals_of(effect, sample_signals())
    yield from _find_parameter_faults(effect, constants_at(effect, signals))
    try:
        with np.errstate(all="ignore"):
            found = list(_find_term_faults(effect, signals))
    except Exception as error:
        # A user's formula may raise anything; its author needs the reason.
        found = [f"its term fails with {type(error).__name__}: {error}."]
    yield from found


def _find_parameter_faults(
    effect: Effect, constants: JointConstants | RobotConstants
) -> Iterator[str]:
    if effect.scope not in SCOPES:
        yield f"scope {effect.scope!r} is none of {', '.join(SCOPES)}."
    unknown = [need for need in effect.needs if need not in NEEDS]
    if unknown:
        yield f"it needs {unknown[0]!r}; known are {', '.join(NEEDS)}."
    if not effect.amplitudes:
        yield "it has no amplitude; at least one number must scale its term."
    names = [a.name for a in effect.amplitudes] + [s.name for s in effect.shapes]
    if len(set(names)) != len(names):
        yield f"two of its parameters share a name: {', '.join(names)}."
    for amplitude in effect.amplitudes:
        size = amplitude.size(constants)
        if not (np.isfinite(size) and size > 0.0):
            yield f"amplitude {amplitude.name!r} has the scale {size}; it must be above zero."
        if not amplitude.lower < amplitude.upper:
            yield f"amplitude {amplitude.name!r} has its lower bound above its upper one."
    combinations = 1
    for shape in effect.shapes:
        starts = shape.start_values(constants)
        combinations *= len(starts)
        if not starts or not all(shape.lower <= v <= shape.upper for v in starts):
            yield (
                f"shape {shape.name!r} starts at {starts}; it needs at least one start, all"
                f" between {shape.lower:g} and {shape.upper:g}."
            )
    if combinations > MAX_SHAPE_STARTS:
        yield (
            f"its shapes have {combinations} combinations of initial values; at most"
            f" {MAX_SHAPE_STARTS} are tried."
        )


def _find_term_faults(effect: Effect, signals: JointSignals | RobotSignals) -> Iterator[str]:
    sizes = np.array([a.size(constants_at(effect, signals)) for a in effect.amplitudes])
    first, second = 0.7 * sizes, -1.3 * sizes * np.cos(np.arange(len(sizes)))
    if (
        effect.term(signals, list(0.0 * sizes), _initial_shapes(effect, signals)).__class__
        is not Term
    ):
        yield "its term returns no Term."
        return
    for shapes in product(*(s.grid(constants_at(effect, signals)) for s in effect.shapes)):
        own = stack_term(effect.term(signals, list(first), shapes))
        if not np.isfinite(own).all():
            yield f"its term is not finite at the shapes {shapes}."
            return
        reach = np.abs(own).max() + 1e-300
        if np.abs(stack_term(effect.term(signals, list(0.0 * sizes), shapes))).max() > 0.0:
            yield "its term does not vanish with its amplitudes."
            return
        other = stack_term(effect.term(signals, list(second), shapes))
        both = stack_term(effect.term(signals, list(first + second), shapes))
        if np.abs(both - own - other).max() > _RELATIVE_TOLERANCE * (reach + np.abs(other).max()):
            yield "its term is not linear in its amplitudes; make nonlinear parameters shapes."
            return


def _initial_shapes(effect: Effect, signals: JointSignals | RobotSignals) -> list[float]:
    return [s.grid(constants_at(effect, signals))[0] for s in effect.shapes]


def stack_term(term: Term) -> np.ndarray:
    """Return all parts of a term in one array, without constant zeros."""
    values = [np.asarray(getattr(term, part), dtype=float).ravel(order="F") for part in TERM_PARTS]
    return np.concatenate([v for v in values if v.size > 1] or [np.zeros(1)])
