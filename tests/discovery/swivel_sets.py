"""Recordings of one joint with friction and a further torque, and an extended model of it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from small_arms import SWIVEL

RECORDINGS = """schema = 1
name = "swivel"
robot = "robot.urdf"
joints = ["swivel"]
signals = { time = "t", position = ["q"], torque = ["tau"], torque_side = "motor" }
"""


def swivel_model(left: float, *, link: str = "upper", rated: float = 20.0) -> str:
    """Text of a model with the friction that leaves so much torque open, as unfiltered noise."""
    return f"""schema = 1
kind = "extended"
name = "swivel"
joints = ["swivel"]
links = ["{link}"]
[nominal]
[scales]
torque_rated = [{rated}]
torque_max = [{3.0 * rated}]
fastest = [1.5]
[left_open]
cutoff = 12.0
predict = [20.0]
torque = [{left}]
link_position = [0.0]
[[effect]]
name = "coulomb"
joint = 1
term = {{ dFc = 5.0 }}
[[effect]]
name = "viscous"
joint = 1
term = {{ dFv = 3.0 }}
"""


def recorded(
    folder: Path,
    further: Callable[[np.ndarray], np.ndarray],
    extended: str,
    *,
    step: float = 0.01,
) -> Path:
    """Two training runs and a test run of 8 s; `further` gives the torque beside the friction."""
    rng, t, text = np.random.default_rng(0), np.arange(0.0, 8.0, step), RECORDINGS
    for name, role, rate in (("a", "train", 1.0), ("b", "train", 1.4), ("c", "test", 1.2)):
        q = 0.8 * np.sin(rate * t) + 0.3 * np.sin(3.1 * rate * t)
        v = np.gradient(q, t)
        tau = 0.09 * np.gradient(v, t) + 5.0 * np.tanh(v / 0.02) + 3.0 * v
        tau += further(q) + rng.normal(0.0, 0.1, t.size)
        np.savez(folder / f"{name}.npz", t=t, q=q, tau=tau)
        text += f'[[runs]]\nfile = "{name}.npz"\nrole = "{role}"\n'
    (folder / "robot.urdf").write_text(SWIVEL)
    (folder / "recordings.toml").write_text(text)
    (folder / "extended.toml").write_text(extended)
    return folder
