"""Dry friction over one step of an integrator: joints slide, stop, stick and turn within it.

Between the ends of a step velocities are linear in time. Friction opposes motion with its whole
level and holds a joint at rest with any torque within it. A joint that would turn reaches rest
where its velocity vanishes, and from there moves on against its friction or sticks: no width of
friction over speed is needed, and velocities after the step are continuous in all that they depend
on. Coupled joints are solved in turns (Gauss-Seidel), those that end at rest then all together.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from stiffopt.closed_loop.factors import factorize, solve

# Turns through all joints.
_SWEEP_COUNT = 3
# Velocities [rad/s] that are none, so that nothing is divided by zero.
_NO_SPEED = 1e-30


def sliding_share(speed: ca.SX, stopping: ca.SX, levels: tuple[ca.SX, ca.SX]) -> ca.SX:
    """Return friction (n,) over its level, -1 to 1, as of joints that it stops within a step.

    `stopping` (n,): torque per speed that stops a joint; `levels`: friction against motion in the
    positive and in the negative direction (n,) each.
    """
    level = ca.if_else(speed > 0.0, *levels)
    share = speed * stopping / ca.fmax(level, _NO_SPEED)
    return ca.fmax(ca.fmin(share, 1.0), -1.0)


def friction_torque(share: ca.SX, levels: tuple[ca.SX, ca.SX]) -> ca.SX:
    """Return the friction (n,) of shares of its levels."""
    return ca.fmax(share, 0.0) * levels[0] + ca.fmin(share, 0.0) * levels[1]


def mean_friction(
    before: ca.SX, after: ca.SX, assumed: ca.SX, mobility: ca.SX, levels: tuple[ca.SX, ca.SX]
) -> ca.SX:
    """Return the friction (n,) of joints, mean over a step.

    Parameters
    ----------
    before, after : SX (n,)
        Velocities at the ends of the step; those after it with the assumed friction.
    assumed : SX (n,)
    mobility : SX (n, n)
        Decrease of the velocities after the step per friction.
    levels : pair of SX (n,)
        Friction against motion in the positive and in the negative direction.
    """
    n = before.shape[0]
    speed, friction = after, ca.SX(assumed)
    for sweep in range(_SWEEP_COUNT if n > 1 else 1):
        at_rest = ca.SX(n, 1)
        for i in range(n) if sweep % 2 == 0 else reversed(range(n)):
            own = mobility[i, i]
            free = speed[i] + own * friction[i]
            reached = _speed_after(before[i], free, own * levels[0][i], own * levels[1][i])
            at_rest[i] = reached == 0.0
            more = (free - reached) / own - friction[i]
            speed = speed - mobility[:, i] * more
            friction[i] += more
        if sweep < _SWEEP_COUNT - 1 and n > 1:
            held = _holding_friction(at_rest, speed, friction, mobility, levels)
            speed = speed - ca.mtimes(mobility, held - friction)
            friction = held
    return friction


def _holding_friction(
    at_rest: ca.SX,
    speed: ca.SX,
    friction: ca.SX,
    mobility: ca.SX,
    levels: Sequence[ca.SX],
) -> ca.SX:
    """Return the friction (n,) that stops all joints at rest (n, 1 or 0), within its levels."""
    rest = ca.diag(at_rest)
    matrix = ca.mtimes([rest, mobility, rest]) + ca.diag(1.0 - at_rest)
    held = friction + solve(factorize(ca.densify(matrix), symmetric=False), at_rest * speed)
    within = ca.fmax(ca.fmin(held, levels[0]), -levels[1])
    return ca.if_else(at_rest, within, friction)


def _speed_after(before: ca.SX, free: ca.SX, forth: ca.SX, back: ca.SX) -> ca.SX:
    """Return the velocity after a step with friction.

    `free`: without it; `forth`, `back`: changes of the velocity by the friction of motion in the
    positive and in the negative direction over a whole step.
    """
    way, gained = ca.sign(before), free - before
    loss = 0.5 * ((1.0 + way) * forth + (1.0 - way) * back) - way * gained
    # The share of the step that is left at rest, and the velocity gained in a step from rest.
    left = ca.fmax(0.0, 1.0 - ca.fabs(before) / ca.fmax(loss, _NO_SPEED))
    turned = ca.fmax(gained - forth, 0.0) + ca.fmin(gained + back, 0.0)
    return way * ca.fmax(ca.fabs(before) - loss, 0.0) + left * turned
