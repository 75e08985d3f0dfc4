"""Dry friction over one step of an integrator: joints slide, stop, stick and turn within it.

Between the ends of a step velocities are linear in time. Friction opposes motion with its whole
level and holds a joint at rest with any torque within it. A joint that would turn reaches rest
where its velocity vanishes, and from there moves on against its friction or sticks: no width of
friction over speed is needed, and velocities after the step are continuous in all that they depend
on. Coupled joints are solved in turns (Gauss-Seidel), then together by a step of Newton's method.
"""

from __future__ import annotations

import casadi as ca

from stiffopt.closed_loop.physics import factorize, solve

# Turns through all joints.
_SWEEP_COUNT = 4
# Velocities [rad/s] and friction [N m] that are none, so that nothing is divided by zero.
_NO_SPEED, _NO_FRICTION = 1e-12, 1e-9

# Friction (n,) against motion in the positive and in the negative direction.
Levels = tuple[ca.SX, ca.SX]


def friction_share(friction: ca.SX, speed: ca.SX, levels: Levels) -> ca.SX:
    """Return friction (n,) over its level, -1 to 1; of none that of the motion."""
    level = ca.if_else(friction > 0.0, *levels)
    given = ca.fabs(level) > _NO_FRICTION
    return ca.if_else(given, friction / ca.if_else(given, level, 1.0), ca.sign(speed))


def friction_torque(share: ca.SX, levels: Levels) -> ca.SX:
    """Return the friction (n,) of shares of its levels."""
    return ca.fmax(share, 0.0) * levels[0] + ca.fmin(share, 0.0) * levels[1]


def mean_friction(
    before: ca.SX, free: ca.SX, mobility: ca.SX, levels: Levels, creep: ca.SX
) -> ca.SX:
    """Return the friction (n,) of joints, mean over a step.

    `before`, `free`: velocities (n,) before the step, and after it without friction; `mobility`
    (n, n): decrease of the latter per friction; `creep` (n,): velocities up to which it grows.
    """
    n = before.shape[0]
    speed, friction = ca.SX(free), ca.SX.zeros(n)
    for sweep in range(_SWEEP_COUNT if n > 1 else 1):
        for i in range(n) if sweep % 2 == 0 else reversed(range(n)):
            own = mobility[i, i]
            alone = speed[i] + own * friction[i]
            lost = own * levels[0][i], own * levels[1][i]
            reached, _ = _speed_after(before[i], alone, *lost, creep[i])
            more = (alone - reached) / own - friction[i]
            speed -= mobility[:, i] * more
            friction[i] += more
        if n > 1:
            matrix, error = friction_error(before, speed, friction, mobility, levels, creep)
            more = friction - solve(factorize(matrix, symmetric=False), error)
            more = ca.fmax(ca.fmin(more, levels[0]), -levels[1]) - friction
            speed -= ca.mtimes(mobility, more)
            friction += more
    return friction


def friction_error(
    before: ca.SX, after: ca.SX, friction: ca.SX, mobility: ca.SX, levels: Levels, creep: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return the slopes (n, n) by the friction of its error, and this (n,).

    The error is by how much larger the velocities after the step would be by the friction of each
    joint alone. `after`: those with the friction.
    """
    own = ca.diag(mobility)
    alone = after + own * friction
    reached, slope = _speed_after(before, alone, own * levels[0], own * levels[1], creep)
    return mobility - ca.mtimes(ca.diag(slope), mobility - ca.diag(own)), reached - after


def _speed_after(
    before: ca.SX, free: ca.SX, forth: ca.SX, back: ca.SX, creep: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return the velocity after a step with friction, and its slope by that without.

    `free`: without it; `forth`, `back`: changes of the velocity by the friction of motion in the
    positive and in the negative direction over a whole step; `creep`: velocity below which friction
    is in proportion to it, at the end of the step.
    """
    moving, gained = ca.fabs(before) > _NO_SPEED, free - before
    way, size = moving * ca.sign(before), moving * ca.fabs(before)
    loss = 0.5 * ((1.0 + way) * forth + (1.0 - way) * back) - way * gained
    # The share of the step that is left at rest, and the velocity gained in a step from rest.
    stopped = size / ca.fmax(loss, _NO_SPEED)
    left = ca.fmax(0.0, 1.0 - stopped)
    turned = ca.fmax(gained - forth, 0.0) + ca.fmin(gained + back, 0.0)
    slope = (
        way**2 * (size > loss)
        + left * ((gained > forth) + (gained < -back))
        - turned * way * (left > 0.0) * stopped / ca.fmax(loss, _NO_SPEED)
    )
    sliding = way * ca.fmax(size - loss, 0.0) + left * turned
    share = creep / (creep + ca.if_else(free > 0.0, forth, back) + _NO_SPEED)
    faster = ca.fabs(share * free) > ca.sign(free) * sliding
    return ca.if_else(faster, share * free, sliding), ca.if_else(faster, share, slope)
