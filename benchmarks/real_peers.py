"""Peers of a diagnosis on real recordings: friction lines, base parameters, a Gaussian process.

Both start from the same nominal prediction, are fitted to the training runs alone and predict the
held-out runs on their own stamps. Each joint follows the motion in the band in which friction lines
predict stretches of the training runs best: the peers' own choice, not the tool's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pinocchio as pin

from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.discovery.prediction import Prediction, Predictor
from stiffopt.discovery.settings import SIGN_SPEED
from stiffopt.recording.run import RecordedRun

# Samples that the Gaussian process is fitted to, and stretches its scales are chosen by.
POINTS, STRETCHES = 800, 4
LENGTHS, NOISES = (1.0, 2.0, 4.0, 8.0), (0.03, 0.1, 0.3, 1.0)
SLOW = 3.0 * SIGN_SPEED
# Bands that are tried [Hz].
BANDS = (6.0, 12.0, 20.0, 35.0, 60.0, 100.0, 150.0)


@dataclass(frozen=True, eq=False)
class Motion:
    """A run with its nominal prediction, each joint in a band of its own [Hz]."""

    run: RecordedRun
    bands: tuple[float, ...]
    predictor: Predictor
    nominal: Prediction
    velocity: np.ndarray

    @property
    def places(self) -> np.ndarray:
        """Of the kept samples among all stamps."""
        return np.searchsorted(self.run.stamps, self.run.time)

    def features(self) -> np.ndarray:
        """Postures, speeds with their signs, accelerations and nominal torques (K, f)."""
        angle, speed = _whole(self.run.position), _whole(self.velocity)
        slope = np.gradient(speed, self.run.time, axis=0)
        smooth = np.column_stack([np.convolve(c, np.ones(15) / 15, "same") for c in slope.T])
        sign = np.tanh(speed / SIGN_SPEED)
        columns = [np.sin(angle), np.cos(angle), speed, sign, smooth]
        return np.column_stack([*columns, self.nominal.torque[self.places]])


def motions(
    diagnosis: Diagnosis, train: list[RecordedRun], test: list[RecordedRun]
) -> tuple[list[Motion], list[Motion]]:
    """Runs predicted by the nominal model, every joint in the peers' own best band."""
    rate = 1.0 / max(run.step for run in train)
    bands = [band for band in BANDS if band <= 0.2 * rate]
    errors = []
    for band in bands:
        tried = [_motion(diagnosis, run, (band,) * run.n) for run in train]
        errors.append([_left_out(tried, j) for j in range(train[0].n)])
    best = tuple(bands[int(np.argmin(column))] for column in np.array(errors).T)
    return [_motion(diagnosis, r, best) for r in train], [_motion(diagnosis, r, best) for r in test]


def _motion(diagnosis: Diagnosis, run: RecordedRun, bands: tuple[float, ...]) -> Motion:
    training = diagnosis.training
    own = replace(training, settings=replace(diagnosis.settings, predict=bands))
    predictor = Predictor(own, run)
    return Motion(run, bands, predictor, predictor.predict(), predictor.velocity)


def _left_out(train: list[Motion], j: int) -> float:
    """Squares that friction lines leave of a joint's torque in stretches left out."""
    rows, left, stretch = _moving(train, j)
    if len(left) < 2 * STRETCHES:
        return 0.0
    total = 0.0
    for k in np.unique(stretch):
        own = stretch == k
        line = np.linalg.lstsq(rows[~own], left[~own], rcond=None)[0]
        total += float(np.sum((left[own] - rows[own] @ line) ** 2))
    return total


def _moving(train: list[Motion], j: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns, residual and stretch of the samples in which a joint moves."""
    rows, left, stretch = [], [], []
    for number, each in enumerate(train):
        speed, residual = each.velocity[:, j], _torque_residual(each)[:, j]
        used = np.isfinite(residual) & (np.abs(speed) >= SLOW)
        rows.append(_friction(speed[used]))
        left.append(residual[used])
        part = np.arange(len(speed)) * STRETCHES // len(speed)
        stretch.append(number * STRETCHES + part[used])
    return np.vstack(rows), np.concatenate(left), np.concatenate(stretch)


def friction_lines(train: list[Motion], test: list[Motion]) -> list[Prediction]:
    """Coulomb and viscous friction and an offset of every joint by least squares."""
    n = train[0].run.n
    fitted = np.zeros((3, n))
    for j in range(n):
        rows, left, _ = _moving(train, j)
        fitted[:, j] = np.linalg.lstsq(rows, left, rcond=None)[0]
    return [
        _moved(
            each,
            np.column_stack([_friction(each.velocity[:, j]) @ fitted[:, j] for j in range(n)]),
            np.zeros_like(each.velocity),
        )
        for each in test
    ]


def base_parameters(train: list[Motion], test: list[Motion]) -> list[Prediction]:
    """All inertial parameters with friction lines and rotors, by weighted least squares.

    Columns that the motion does not tell apart get the solution of least norm; each joint is
    weighted by what friction lines leave of it, then by its own residual.
    """
    rows = [_inertial_rows(each) for each in train]
    n = train[0].run.n
    weights = np.ones(n)
    for _ in range(3):
        blocks, values = [], []
        for each, own in zip(train, rows, strict=True):
            residual = _torque_residual(each)
            for j in range(n):
                used = np.isfinite(residual[:, j]) & (np.abs(each.velocity[:, j]) >= SLOW)
                blocks.append(weights[j] * own[used, j])
                values.append(weights[j] * residual[used, j])
        matrix, wanted = np.vstack(blocks), np.concatenate(values)
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale == 0.0] = 1.0
        fitted = np.linalg.lstsq(matrix / scale, wanted, rcond=1e-6)[0] / scale
        for j in range(n):
            left = np.concatenate(
                [
                    (_torque_residual(each)[:, j] - own[:, j] @ fitted)[
                        np.abs(each.velocity[:, j]) >= SLOW
                    ]
                    for each, own in zip(train, rows, strict=True)
                ]
            )
            left = left[np.isfinite(left)]
            weights[j] = 1.0 / max(float(np.std(left)), 1e-12) if left.size else 0.0
    return [
        _moved(each, _inertial_rows(each) @ fitted, np.zeros_like(each.velocity)) for each in test
    ]


def _inertial_rows(each: Motion) -> np.ndarray:
    """Columns of bodies, then of friction lines and rotors (K, n, p)."""
    prepared, robot = each.predictor.nominal, each.predictor.robot
    model, order, n = robot.arm.model, robot.order, each.run.n
    kept = (
        np.interp(each.run.time, prepared.time, np.arange(len(prepared.time))).round().astype(int)
    )
    signals = prepared.signals
    lines = (signals.motor_position, signals.motor_velocity, signals.motor_acceleration)
    q, v, a = (np.zeros((len(kept), model.nv)) for _ in range(3))
    for target, source in zip((q, v, a), lines, strict=True):
        target[:, order] = source[kept]
    data = model.createData()
    # A model of one joint gets its rows without the first axis.
    bodies = np.array(
        [
            pin.computeJointTorqueRegressor(model, data, *at).reshape(model.nv, -1)[order]
            for at in zip(q, v, a, strict=True)
        ]
    )
    own = np.zeros((len(kept), n, 4 * n))
    for j in range(n):
        own[:, j, 4 * j : 4 * j + 3] = _friction(v[:, order[j]])
        own[:, j, 4 * j + 3] = a[:, order[j]]
    return np.concatenate([bodies, own], axis=2)


def gaussian_process(train: list[Motion], test: list[Motion]) -> list[Prediction]:
    """Residuals of torque and link position as a Gaussian process of the motion."""
    inputs = np.vstack([each.features() for each in train])
    middle, spread = inputs.mean(axis=0), inputs.std(axis=0)
    spread[spread < 1e-9] = 1.0
    scaled = (inputs - middle) / spread / np.sqrt(inputs.shape[1])
    wanted = [(each.features() - middle) / spread / np.sqrt(inputs.shape[1]) for each in test]
    torque = np.vstack([_torque_residual(each) for each in train])
    link = np.vstack([_link_residual(each) for each in train])
    moving = np.abs(np.vstack([each.velocity for each in train])) >= SLOW
    n = train[0].run.n
    out = [[np.zeros((len(x), n)) for x in wanted] for _ in range(2)]
    for kind, residual, usable in ((0, torque, moving), (1, link, np.ones_like(moving))):
        for j in range(n):
            used = np.flatnonzero(np.isfinite(residual[:, j]) & usable[:, j])
            if not used.size:
                continue
            for k, values in enumerate(_process(scaled[used], residual[used, j], wanted)):
                out[kind][k][:, j] = values
    return [_moved(each, *pair) for each, *pair in zip(test, *out, strict=True)]


def _process(inputs: np.ndarray, values: np.ndarray, wanted: list[np.ndarray]) -> list[np.ndarray]:
    """Posterior mean at the wanted inputs; scales chosen by stretches left out."""
    chosen = np.unique(np.linspace(0, len(values) - 1, POINTS).astype(int))
    x, y = inputs[chosen], values[chosen]
    middle, size = float(y.mean()), float(y.std()) or 1.0
    y = (y - middle) / size
    stretch = np.arange(len(y)) * STRETCHES // len(y)
    scores = {}
    for length, noise in product(LENGTHS, NOISES):
        error = 0.0
        for k in range(STRETCHES):
            kept = stretch != k
            weight = _weights(x[kept], y[kept], length, noise)
            error += float(np.sum((y[~kept] - _kernel(x[~kept], x[kept], length) @ weight) ** 2))
        scores[length, noise] = error
    length, noise = min(scores, key=scores.__getitem__)
    weight = _weights(x, y, length, noise)
    return [middle + size * (_kernel(each, x, length) @ weight) for each in wanted]


def _weights(x: np.ndarray, y: np.ndarray, length: float, noise: float) -> np.ndarray:
    return np.asarray(np.linalg.solve(_kernel(x, x, length) + noise**2 * np.eye(len(x)), y))


def _kernel(a: np.ndarray, b: np.ndarray, length: float) -> np.ndarray:
    square = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * a @ b.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0.0) / length**2))


def _whole(columns: np.ndarray) -> np.ndarray:
    """Columns with single samples that are missing bridged."""
    every = np.arange(len(columns))
    found = [np.isfinite(column) for column in columns.T]
    return np.column_stack(
        [np.interp(every, every[k], c[k]) for c, k in zip(columns.T, found, strict=True)]
    )


def _friction(speed: np.ndarray) -> np.ndarray:
    return np.column_stack([np.tanh(speed / SIGN_SPEED), speed, np.ones_like(speed)])


def _torque_residual(each: Motion) -> np.ndarray:
    return each.run.torque - each.nominal.torque[each.places]


def _link_residual(each: Motion) -> np.ndarray:
    if each.run.link_position is None:
        return np.full_like(each.run.torque, np.nan)
    return each.run.link_position - each.nominal.link_position[each.places]


def _moved(each: Motion, torque: np.ndarray, link: np.ndarray) -> Prediction:
    """The nominal prediction with additions on the kept samples, bridged between them."""
    stamps, time = each.run.stamps, each.run.time

    def bridged(values: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(stamps, time, column) for column in values.T])

    return Prediction(
        stamps=stamps,
        torque=each.nominal.torque + bridged(torque),
        link_position=each.nominal.link_position + bridged(link),
    )
