"""Another simulator: torques of a law from the text of a page, by formulas of its own."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

import numpy as np

# What a page calls the signals of a joint, or of the robot.
_JOINT_SIGNALS = {
    "position": "motor_position",
    "speed": "motor_velocity",
    "direction of motion": "motor_direction",
    "acceleration": "motor_acceleration",
    "load": "spring_torque",
    "nominal wind-up": "windup",
    "drive torque": "drive_torque",
    "temperature": "temperature_rise",
}
_ROBOT_SIGNALS = {
    "time since power-on": lambda s: s.session_time,
    "time since the begin of the motion": lambda s: s.time,
    "height of the tool": lambda s: s.tool_position[:, 2],
    "place of the tool along x": lambda s: s.tool_position[:, 0],
    "place of the tool along y": lambda s: s.tool_position[:, 1],
}


def signal_of(words: str, signals) -> np.ndarray:
    """Return the signal (K,) that a page describes."""
    if words in _ROBOT_SIGNALS:
        return np.asarray(_ROBOT_SIGNALS[words](signals))
    kind, joint = re.fullmatch(r"(.+) of joint (\d+)", words).groups()
    j = int(joint) - 1
    if kind == "nominal friction":
        own = signals.constants.joints[j]
        w, side = signals.motor_velocity[:, j], signals.motor_direction[:, j]
        return own.coulomb * side + own.viscous * w
    return np.array(getattr(signals, _JOINT_SIGNALS[kind])[:, j])


def _operators(
    dt: float, history: Callable[[np.ndarray], list[float] | None]
) -> dict[str, Callable]:
    """The operators, sample by sample as the page defines them."""

    def begin(x):
        past = history(x)
        return (x[0], []) if past is None else (0.0, past)

    def lag(x, T):
        start, past = begin(x)
        p, y = math.exp(-dt / T), [start]
        for now in [*past, *x]:
            y.append(p * y[-1] + (1.0 - p) * now)
        return np.array(y[1 + len(past) :])

    def second_order(x, f, zeta, over):
        o = math.tan(math.pi * f * dt)
        start, past = begin(x)
        x, y = [start, start, *past, *x], [start, start]
        for k in range(2, len(x)):
            right = (o**2 + over * o) * x[k] + 2 * o**2 * x[k - 1] + (o**2 - over * o) * x[k - 2]
            own = 2 * (o**2 - 1) * y[k - 1] + (1 - 2 * zeta * o + o**2) * y[k - 2]
            y.append((right - own) / (1 + 2 * zeta * o + o**2))
        return np.array(y[2 + len(past) :])

    def stop(x, r):
        y = [x[0]]
        for now in x[1:]:
            y.append(min(max(y[-1], now - r), now + r))
        return np.asarray(x) - np.array(y)

    return {
        "lag": lag,
        "sprung": lambda x, f, zeta: second_order(x, f, zeta, 2 * zeta),
        "mode": lambda x, f, zeta: second_order(x, f, zeta, 0.0),
        "stop": stop,
    }


def typed_torque(equation: str, numbers: Sequence[str], meanings: Sequence[str], signals):
    """Return what an equation adds (K,), from the lines of a page alone."""
    text = equation.partition("+=")[2]
    space: dict[str, object] = {
        name: getattr(np, name) for name in ("tanh", "exp", "log", "abs", "sqrt", "sign")
    }
    moving: list[tuple[str, object]] = []  # speeds and accelerations

    def history(x):
        for words, each in moving:
            if each is x:
                kind, place = words.split(" ", 1)
                w, a = (signal_of(f"{k} {place}", signals)[0] for k in ("speed", "acceleration"))
                n = min(round(w / (a * signals.dt)), len(x)) if w * a > 0.0 else 0
                return [a if kind == "acceleration" else w * k / n for k in range(n)]
        return None

    operators = _operators(signals.dt, history)
    space |= {"cos": np.cos, "sin": np.sin, "pi": math.pi, **operators}
    for line in numbers:
        name, value = re.match(r"(\w+) = (\S+)", line).groups()
        space[name] = float(value)
    # The direction of a motion first: its symbol contains that of the speed.
    for line in sorted(meanings, key=lambda line: not line.startswith("sg(")):
        symbol, _, words = line.partition(" is the ")
        if re.fullmatch(r"\w+|sg\(\w+\)", symbol):
            name = f"signal{len(space)}"
            space[name] = signal_of(words, signals)
            if words.startswith(("speed", "acceleration")):
                moving.append((words, space[name]))
            text = re.sub(rf"(?<!\w){re.escape(symbol)}(?!\w)", name, text)
    return eval(text, space) + 0.0 * signals.time
