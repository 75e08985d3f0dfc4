"""Error of the functions that findings add, over the range that held-out runs met."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.discovery.comparison.extended_run import simulate_links
from stiffopt.discovery.comparison.extension_change import extension_change
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.prepared_run import prepare_run
from stiffopt.discovery.extended.model import load_extended
from stiffopt.discovery.prediction import Predictor
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.recording.recording_set import load_recordings
from stiffopt.recording.run import RecordedRun

from .store import Store

MOVING = 0.03  # slower than this, dry friction has no definite value [rad/s]


def function_errors(
    store: Store, name: str, true: dict[str, Any], answer: Path
) -> tuple[dict[str, float], dict[str, float]]:
    """Errors by role of the effects of an answer, over the range that was met.

    What the simulator added to the healthy robot is compared with what the findings add to the
    nominal model. Both along one motion: the recorded one there, the predicted one here, for the
    links of a robot without the effects would vibrate otherwise.

    Returns
    -------
    error : dict of str to float
        In that channel of the joint, torque or link angle, where the true effect is larger over the
        noise. Nominal values within tolerance count on neither side.
    beside : dict of str to float
        In both channels of the joint, up to a change of nominal values, whose squares over their
        tolerances count as error: two functions that differ by less are one function to whoever
        knows the nominal values no better.
    """
    exact, joint = store.oracle_predictions(name), true["joint"] - 1
    recordings = load_recordings(store.case(name))
    model = load_extended(answer / "extended.toml")
    training = prepare_training(recordings, Settings())
    noise = training.noise.channels
    kinds = (
        ("torque", f"tau{true['joint']}", noise.torque[joint]),
        ("link_position", f"ql{true['joint']}", noise.deflection[joint]),
    )
    found = Extension(effects=model.extension.effects)
    scaled = replace(training, constants=model.scaled(training.constants))
    # By role and kind: squares of the error and of the true effect, over the noise.
    sums: dict[str, np.ndarray] = {}
    compared: dict[str, list[_Compared]] = {}
    for entry in recordings.with_role("test", "extrapolate"):
        run = recordings.open(entry)
        predictor = Predictor(scaled, run)
        added_to = _added_along(predictor, found)
        truth, healthy = (np.load(exact / f"{key}_{run.name}.npz") for key in ("pred", "healthy"))
        own = sums.setdefault(run.role, np.zeros((2, 2)))
        for row, (kind, column, scale) in zip(own, kinds, strict=True):
            added = added_to[kind][:, joint]
            meant = truth[column] - healthy[column]
            count = min(len(added), len(meant))
            moving = np.ones(count, dtype=bool)
            if kind == "torque":
                moving = np.abs(predictor.velocity[:count, joint]) >= MOVING
            wrong = (added[:count] - meant[:count])[moving] / scale
            row += float(wrong @ wrong), float(np.sum((meant[:count][moving] / scale) ** 2))
        every = {
            kind: np.column_stack(
                [truth[f"{key}{j + 1}"] - healthy[f"{key}{j + 1}"] for j in range(training.robot.n)]
            )
            for kind, key in (("torque", "tau"), ("link_position", "ql"))
        }
        compared.setdefault(run.role, []).append(_compare(training, run, joint, added_to, every))
    seen = int(np.argmax(sum(own[:, 1] for own in sums.values())))
    error = {
        role: float(np.sqrt(own[seen, 0] / max(own[seen, 1], 1e-300))) for role, own in sums.items()
    }
    return error, {role: _error_beside(runs) for role, runs in compared.items()}


@dataclass(frozen=True, eq=False)
class _Compared:
    """Rows over the noise: error (m,), true effect (m,), nominal values over tolerances."""

    wrong: np.ndarray
    meant: np.ndarray
    nominal: np.ndarray  # (m, p)


def _compare(
    training: Training,
    run: RecordedRun,
    joint: int,
    added: dict[str, np.ndarray],
    meant: dict[str, np.ndarray],
) -> _Compared:
    """Compare additions to the torques and link angles (R, n) of a run at a joint."""
    ready = prepare_run(training.robot, run, 0, training.constants, training.settings)
    comparison = training.comparison().with_runs([ready])

    def rows(values: dict[str, np.ndarray]) -> np.ndarray:
        count = min(len(run.stamps), len(values["torque"]))
        torque, link = (
            np.column_stack([np.interp(ready.time, run.stamps[:count], own) for own in each.T])
            for each in (values["torque"][:count], values["link_position"][:count])
        )
        return comparison.rows.flatten([torque], [-link])[own]

    own = comparison.rows.channel % training.robot.n == joint
    _, tolerances = comparison.priors
    aim = rows(meant)
    return _Compared(rows(added) - aim, aim, comparison.columns.nuisance[own] * tolerances)


def _error_beside(runs: list[_Compared]) -> float:
    """Error up to one change of nominal values in all runs."""
    wrong, nominal = (
        np.concatenate([getattr(r, key) for r in runs]) for key in ("wrong", "nominal")
    )
    moment, gram = nominal.T @ wrong, nominal.T @ nominal
    left = wrong @ wrong - moment @ np.linalg.solve(gram + np.eye(len(gram)), moment)
    whole = sum(float(run.meant @ run.meant) for run in runs)
    return float(np.sqrt(max(left, 0.0) / max(whole, 1e-300)))


def _added_along(predictor: Predictor, found: Extension) -> dict[str, np.ndarray]:
    """Torques and link angles (R, n) added by findings along the motion predicted with them."""
    moved = simulate_links(predictor.nominal, found)
    change = extension_change(moved, found)
    load = moved.signals.spring_torque
    wound = predictor.robot.windup(load) - predictor.robot.windup(load - change.link_torque)
    stamps = predictor.run.stamps
    return {
        kind: np.column_stack([np.interp(stamps, moved.time, own) for own in values.T])
        for kind, values in (
            ("torque", moved.motion_filter(change.torque) + change.link_torque),
            ("link_position", -(wound + change.deflection + change.reading)),
        )
    }
