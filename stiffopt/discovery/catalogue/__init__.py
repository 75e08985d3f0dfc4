"""Catalogue of physics that a nominal robot model may lack, one effect or family per file.

Signs: terms add to the drive torque, to the spring torque, or to motor angle minus link angle, as
in `stiffopt.discovery.effect.Term`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stiffopt.discovery.catalogue.contacts import CONTACTS, COUPLED_DRIVE, TOOL_FORCES
from stiffopt.discovery.catalogue.drift import (
    COLD_START,
    FRICTION_DRIFT,
    FRICTION_IN_RUNS,
    FRICTION_WARMUP,
    GAIN_DRIFTS,
    GAIN_WARMUP,
    UNTIMED_COLD_START,
)
from stiffopt.discovery.catalogue.elastic import BACKLASH, HYSTERESIS, OUTPUT_BACKLASH
from stiffopt.discovery.catalogue.friction import (
    FRICTION,
    LUBRICATED_FRICTION,
    QUADRATIC_DRAG,
    STROKE_FRICTION,
)
from stiffopt.discovery.catalogue.geometry import BASE_TILT, JOINT_ZERO
from stiffopt.discovery.catalogue.inertial import INERTIAL
from stiffopt.discovery.catalogue.periodic import PERIODIC
from stiffopt.discovery.catalogue.preload_loss import PRELOAD_LOSS
from stiffopt.discovery.catalogue.sensors import CROSSTALK, DEADBAND, SENSORS
from stiffopt.discovery.catalogue.springs import SPRINGS
from stiffopt.discovery.catalogue.stiffness import (
    BELT_CREEP,
    JOINT_DAMPING,
    K1_SOFTENING,
    STIFFNESS_LINEAR,
)
from stiffopt.discovery.catalogue.timing import TIMING
from stiffopt.discovery.effect import Effect
from stiffopt.errors import InputError, nearest

CATALOGUE: tuple[Effect, ...] = (
    *FRICTION,
    LUBRICATED_FRICTION,
    FRICTION_DRIFT,
    FRICTION_IN_RUNS,
    COLD_START,
    UNTIMED_COLD_START,
    FRICTION_WARMUP,
    STROKE_FRICTION,
    QUADRATIC_DRAG,
    COUPLED_DRIVE,
    BACKLASH,
    OUTPUT_BACKLASH,
    HYSTERESIS,
    STIFFNESS_LINEAR,
    K1_SOFTENING,
    PRELOAD_LOSS,
    BELT_CREEP,
    JOINT_DAMPING,
    *PERIODIC,
    *INERTIAL,
    BASE_TILT,
    JOINT_ZERO,
    *SPRINGS,
    *SENSORS,
    *TIMING,
    DEADBAND,
    *GAIN_DRIFTS,
    GAIN_WARMUP,
    CROSSTALK,
    *CONTACTS,
    *TOOL_FORCES,
)

# Largest number of runs with one amplitude each.
_MAX_RUNS = 20


def confused_with(entry: Effect, effects: Sequence[Effect] = CATALOGUE) -> tuple[str, ...]:
    """Return the names of effects that ordinary motions separate poorly from one.

    Either side may declare it.
    """
    return tuple(
        other.name
        for other in effects
        if other.name in entry.confused_with or entry.name in other.confused_with
    )


def effects_of_runs(
    effects: Sequence[Effect], runs: Sequence[str], after: Sequence[str]
) -> tuple[Effect, ...]:
    """Return effects with one amplitude per run where they have such.

    Effects of runs are left out where there are too many runs.

    `runs`: names of the training runs. `after`: names of the runs in another state of the robot
    than the others.
    """
    states = ["after" if run in after else "before" for run in runs]
    return tuple(
        each if each.of_runs is None else each.of_runs(tuple(runs), states)
        for each in effects
        if each.of_runs is None or len(runs) <= _MAX_RUNS
    )


def changes_in(effects: Sequence[Effect], runs: Sequence[str]) -> tuple[Effect, ...]:
    """Return effects as changes of the robot between two states: they act in the runs of one only.

    Effects of single runs are left out: they are no property of a state.

    `runs`: names of all runs of that state.
    """
    return tuple(
        replace(each, only_in=tuple(runs), usual=False)
        for each in effects
        if each.scope not in ("run", "recording") and each.of_runs is None
    )


def effect(name: str) -> Effect:
    """Return the entry of a name.

    Raises `InputError`: no entry has this name; the message lists the names.
    """
    for entry in CATALOGUE:
        if entry.name == name:
            return entry
    names = [entry.name for entry in CATALOGUE]
    raise InputError(f"The catalogue has no effect {name!r}. {nearest(name, names)}")
