"""The same judge for all: an answer's control drives pinocchio's model on a fine grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

# Instants in each interval.
FINE = 20


@dataclass(frozen=True)
class Judged:
    """What a motion is worth.

    Attributes
    ----------
    objective : float
        Integral of the squared torque ratios [s], or the duration [s].
    excess : float
        Largest of velocity and torque over their limits, relative.
    miss : float
        Of the end pose [rad].
    """

    objective: float
    excess: float
    miss: float


def judge(task: dict[str, Any], answer: dict[str, Any]) -> Judged:
    """Drive the arm by the answer's control from the start."""
    model = pin.buildModelFromUrdf(task["urdf"])
    data = model.createData()
    times = np.array(answer["times"])
    q, v = np.array(task["start"]), np.zeros(model.nv)
    integral, excess = 0.0, 0.0
    speed, torque_max = np.array(task["velocity_max"]), np.array(task["torque_max"])
    for k, width in enumerate(np.diff(times)):
        local = np.linspace(0.0, width, FINE + 1)
        if "torque" in answer or "torque_held" in answer:
            if "torque" in answer:
                ends = [np.array(answer["torque"][k + i]) for i in (0, 1)]
            else:
                ends = [np.array(answer["torque_held"][k])] * 2
            torques = [ends[0] + t / width * (ends[1] - ends[0]) for t in local]
            rows = [(q, v, torques[0])]
            for before, after, h in zip(torques, torques[1:], np.diff(local), strict=False):
                q, v = _runge_kutta(model, data, q, v, (before, after), h)
                rows.append((q, v, after))
        else:
            if "acceleration" in answer:
                first, last = (np.array(answer["acceleration"][k + i]) for i in (0, 1))
            else:
                first = last = np.array(answer["acceleration_held"][k])
            jerk = (last - first) / width
            rows = []
            for t in local:
                moved = (
                    q + t * v + t**2 / 2.0 * first + t**3 / 6.0 * jerk,
                    v + t * first + t**2 / 2.0 * jerk,
                )
                tau = np.array(pin.rnea(model, data, *moved, first + t * jerk))
                rows.append((*moved, tau))
            q, v = rows[-1][:2]
        ratio = np.array([row[2] for row in rows]) / torque_max
        integral += float(np.trapezoid(np.sum(ratio**2, axis=1), local))
        fast = np.abs(np.array([row[1] for row in rows])) / speed
        excess = max(excess, float(np.abs(ratio).max()) - 1.0, float(fast.max()) - 1.0)
    free = task["kind"] == "minimum_time"
    miss = float(np.abs(q - np.array(task["end"])).max())
    return Judged(float(times[-1]) if free else integral, excess, miss)


def _runge_kutta(
    model: Any,
    data: Any,
    q: np.ndarray,
    v: np.ndarray,
    torques: tuple[np.ndarray, np.ndarray],
    h: float,
) -> tuple[np.ndarray, np.ndarray]:
    """One step under a torque that is linear in time."""

    def rate(state: np.ndarray, part: float) -> np.ndarray:
        torque = (1.0 - part) * torques[0] + part * torques[1]
        a = pin.aba(model, data, state[: model.nq], state[model.nq :], torque)
        return np.concatenate([state[model.nq :], a])

    x = np.concatenate([q, v])
    k1 = rate(x, 0.0)
    k2 = rate(x + h / 2.0 * k1, 0.5)
    k3 = rate(x + h / 2.0 * k2, 0.5)
    k4 = rate(x + h * k3, 1.0)
    x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x[: model.nq], x[model.nq :]
