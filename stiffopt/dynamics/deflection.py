"""Deflection of the tool by the wind-up of the joints, split by its cause.

`dynamics.bearings` has that by bearings and links.

The deflection is the elastic position minus the planned position, -J phi, to first order in the
wind-up phi; J is the position Jacobian in base axes. Three parts add up to the total:

- static: -J phi(tau_gravity), the sag at rest in the same pose, which calibration can remove;
- dynamic: -J [phi(tau_0) - phi(tau_gravity)], added by the motion;
- process: -J [phi(tau_spring) - phi(tau_0)], added by a force on the tool.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from stiffopt.dynamics.newton_euler import newton_euler
from stiffopt.robot.body_tree import BodyTree
from stiffopt.symbolic import Quantity


@dataclass(frozen=True, kw_only=True)
class SpringTorques:
    """Torques in the joints' springs, without rotor inertia and friction."""

    gravity: Quantity  # (n,) at rest in the same pose [N m] or [N]
    motion: Quantity  # (n,) tau_0: links and payload in motion [N m] or [N]
    # (n,) tau_0 minus J^T F; the same as `motion` without a process force [N m] or [N].
    spring: Quantity
    # (n,) at rest under the process force; the same as `gravity` without one [N m] or [N].
    held: Quantity


@dataclass(frozen=True, kw_only=True)
class Deflection:
    """Parts of the tool's deflection (3,) in base axes. [m]."""

    static: Quantity
    dynamic: Quantity
    process: Quantity

    @property
    def total(self) -> Quantity:
        """Elastic position minus planned position (3,) [m]."""
        return self.static + self.dynamic + self.process

    def __add__(self, other: Deflection) -> Deflection:
        return Deflection(
            static=self.static + other.static,
            dynamic=self.dynamic + other.dynamic,
            process=self.process + other.process,
        )


def spring_torques(
    tree: BodyTree, q: Quantity, v: Quantity, a: Quantity, pushed: Quantity = None
) -> SpringTorques:
    """Return the spring torques of an arm in motion (q, v, a) under a process force on its tool.

    `pushed` (n,): joint torques J^T F of the force F ON the tool [N m] or [N].
    """
    rest = np.zeros(tree.n)
    gravity = newton_euler(tree, q, rest, rest)
    motion = newton_euler(tree, q, v, a)
    if pushed is None:
        return SpringTorques(gravity=gravity, motion=motion, spring=motion, held=gravity)
    return SpringTorques(
        gravity=gravity, motion=motion, spring=motion - pushed, held=gravity - pushed
    )


def tool_deflection(
    jacobian: Quantity, torques: SpringTorques, windup: Callable[[Quantity], Quantity]
) -> Deflection:
    """Return the deflection of the tool under spring torques.

    `jacobian` (3, n): position Jacobian of the tool, base axes [m/rad] or [1]. `windup`: spring
    torques (n,) -> wind-up angles (n,) [rad] (or shortening [m]).
    """
    sag, moving = windup(torques.gravity), windup(torques.motion)
    # Without a process force both are the same expression, and the process part is exactly zero.
    loaded = moving if torques.spring is torques.motion else windup(torques.spring)
    symbolic = isinstance(jacobian, ca.SX | ca.MX)

    def at_tool(angles: Quantity) -> Quantity:
        moved: Quantity = ca.mtimes(jacobian, angles) if symbolic else jacobian @ angles
        return -moved

    return Deflection(
        static=at_tool(sag), dynamic=at_tool(moving - sag), process=at_tool(loaded - moving)
    )
