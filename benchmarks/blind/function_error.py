"""Error of findings, and of the whole model, over the range that held-out runs met."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.discovery.comparison.extended_run import simulate_links
from stiffopt.discovery.comparison.extension_change import extension_change
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.extended.model import load_extended
from stiffopt.discovery.prediction import Predictor
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

from .store import Store

MOVING = 0.03  # slower than this, dry friction has no definite value [rad/s]


def function_errors(
    store: Store, name: str, true: dict[str, Any], answer: Path
) -> tuple[dict[str, float], dict[str, float]]:
    """Errors by role of an answer, over the range that was met, root mean squares.

    What the simulator adds is compared with what the answer adds, each along its own motion: the
    recorded one there, the predicted one here, for the links of a robot without the effects would
    vibrate otherwise. In that channel of the joint, torque or link angle, where the true effect is
    larger over the noise; both errors are shares of that effect.

    Returns
    -------
    error : dict of str to float
        Of the findings alone: the effects added to the healthy robot there, the findings to the
        nominal model here. Nominal values within tolerance count on neither side.
    whole : dict of str to float
        Of the whole model: the true robot there, findings and nominal values as they are reported
        here, both less the nominal model. It is what somebody gets who types in both; part of a
        law may be in nominal values within their tolerances.
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
    scaled = replace(training, constants=model.scaled(training.constants))
    # By role and kind: squares of both errors and of the true effect, over the noise.
    sums: dict[str, np.ndarray] = {}
    for entry in recordings.with_role("test", "extrapolate"):
        run = recordings.open(entry)
        predictor = Predictor(scaled, run)
        parts = (Extension(effects=model.extension.effects), model.extension)
        added_to = [_added_along(predictor, part) for part in parts]
        truth, healthy, nominal = (
            np.load(exact / f"{key}_{run.name}.npz") for key in ("pred", "healthy", "nominal")
        )
        own = sums.setdefault(run.role, np.zeros((2, 3)))
        for row, (kind, column, scale) in zip(own, kinds, strict=True):
            count = min(len(added_to[0][kind]), len(truth[column]))
            moving = np.ones(count, dtype=bool)
            if kind == "torque":
                moving = np.abs(predictor.velocity[:count, joint]) >= MOVING
            meant = truth[column] - healthy[column]
            aims = meant, truth[column] - nominal[column]
            wrong = [
                added[kind][:count, joint] - aim[:count]
                for added, aim in zip(added_to, aims, strict=True)
            ]
            row += [np.sum((each[:count][moving] / scale) ** 2) for each in (*wrong, meant)]
    seen = int(np.argmax(sum(own[:, 2] for own in sums.values())))
    shares = {
        role: np.sqrt(own[seen, :2] / max(own[seen, 2], 1e-300)) for role, own in sums.items()
    }
    error, whole = ({role: float(own[k]) for role, own in shares.items()} for k in (0, 1))
    return error, whole


def _added_along(predictor: Predictor, found: Extension) -> dict[str, np.ndarray]:
    """Torques and link angles (R, n) added by an extension along the motion predicted with it."""
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
