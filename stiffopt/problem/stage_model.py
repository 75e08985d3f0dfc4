"""Symbolic torques, stiffness and deflection at one instant, built on demand.

Rotor inertia and friction load the drive, not the spring.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from stiffopt.drivetrain.compact import CompactChain
from stiffopt.dynamics.bearings import bearing_deflection
from stiffopt.dynamics.deflection import (
    Deflection,
    SpringTorques,
    spring_torques,
    tool_deflection,
)
from stiffopt.dynamics.friction import drive_torque, dry_friction_width
from stiffopt.dynamics.kinematics import frame_jacobian
from stiffopt.errors import ProblemError
from stiffopt.robot.added_torque import MotionState, sum_added_torques
from stiffopt.robot.robot import Robot
from stiffopt.symbolic import Quantity

# Step of a speed that is rounded to a constant, relative to the friction's smoothing width.
_SPEED_STEP = 1e-12


def compact_chains(robot: Robot) -> list[CompactChain | None]:
    """Compact form of the drivetrains of a robot."""
    return [
        None if chain is None else CompactChain(chain, float(robot.torque_max[j]))
        for j, chain in enumerate(robot.chains)
    ]


def windups(
    chains: Sequence[CompactChain | None], torque: Quantity, smoothing: Quantity
) -> Quantity:
    """Wind-up of every joint (n,) [rad] under spring torques (n,), with a smoothing factor."""
    angles = [
        0.0 if chain is None else chain.windup(torque[j], smoothing=smoothing)
        for j, chain in enumerate(chains)
    ]
    return ca.vertcat(*angles)


class StageModel:
    """Symbolic torques, stiffness and deflection of a robot at one instant.

    Parameters
    ----------
    position, velocity, acceleration : SX (n,)
    process_force : array (3,) [N]
        Force on the tool, base frame.
    smoothing : SX or float
        Factor on every smoothing width of the stiffness model.
    sides : array (n,)
        Sign of the spring torque of joints that can keep it; 0 for the others.
    friction : (SX or float, SX or float, SX or float)
        `kinks`, `creeping` and `convexity` of `Smoothing`.
    """

    def __init__(
        self,
        robot: Robot,
        position: Quantity,
        velocity: Quantity,
        acceleration: Quantity,
        process_force: np.ndarray,
        smoothing: Quantity,
        sides: np.ndarray,
        friction: tuple[Quantity, Quantity, Quantity] = (1.0, 0.0, 0.0),
    ) -> None:
        self.robot = robot
        self.position, self.velocity, self.acceleration = position, velocity, acceleration
        self.process_force = np.asarray(process_force, dtype=float)
        self.smoothing = smoothing
        self.sides = sides
        self.kinks, self.creeping, self.convexity = friction

    @property
    def link(self) -> tuple[Quantity, Quantity, Quantity]:
        """Position, velocity and acceleration of the links, which load the springs."""
        return self.position, self.velocity, self.acceleration

    @cached_property
    def chains(self) -> list[CompactChain | None]:
        """Compact form of the drivetrains."""
        return compact_chains(self.robot)

    @cached_property
    def torques(self) -> SpringTorques:
        """Spring torques of gravity, motion and process force."""
        return self.spring_torques()

    def spring_torques(self) -> SpringTorques:
        """Build the spring torques from the model's motion."""
        force = self.process_force
        pushed = ca.mtimes(self.jacobian.T, force) if np.any(force) else None
        bodies = spring_torques(self.robot.tree, *self.link, pushed)
        if not self.robot.added_torques:
            return bodies
        state = self._motion_state(*self.link, bodies.motion)
        rest = state.at_rest(ca.vertsplit(bodies.gravity))
        moving, still = (
            ca.vertcat(*sum_added_torques(self.robot.added_torques, each, in_spring=True))
            for each in (state, rest)
        )
        # Without a process force the two stay one expression: the process part is exactly zero.
        motion, gravity = bodies.motion + moving, bodies.gravity + still
        return SpringTorques(
            gravity=gravity,
            motion=motion,
            spring=motion if bodies.spring is bodies.motion else bodies.spring + moving,
            held=gravity if bodies.held is bodies.gravity else bodies.held + still,
        )

    def _motion_state(
        self,
        position: Quantity,
        velocity: Quantity,
        acceleration: Quantity,
        load: Quantity,
        side: float = 0.0,
    ) -> MotionState:
        """Return the motion as added torques take it, its direction shifted as an envelope's is."""
        place = velocity / ca.DM(dry_friction_width(self.robot.velocity_max)) + 2.0 * side
        parts = (position, velocity, acceleration, ca.tanh(place), load)
        return MotionState(
            **dict(
                zip(
                    ("position", "velocity", "acceleration", "direction", "load"),
                    (ca.vertsplit(ca.SX(part)) for part in parts),
                    strict=True,
                )
            )
        )

    def _added_drive_torque(self, side: float = 0.0) -> Quantity:
        """Added torques of the drives alone (n,) [N m]; 0 without any."""
        added = self.robot.added_torques
        if not added:
            return 0.0
        motion = self.position, self.velocity, self.acceleration
        state = self._motion_state(*motion, self.torques.spring, side)
        return ca.vertcat(*sum_added_torques(added, state, in_spring=False))

    @property
    def computed_torques(self) -> Quantity:
        """Torques of gravity and motion, if already built; else empty."""
        if "torques" not in self.__dict__:
            return ca.SX(0, 1)
        return ca.vertcat(self.torques.gravity, self.torques.motion)

    @cached_property
    def jacobian(self) -> Quantity:
        """Position Jacobian of the tool (3, n), base axes or those of the work."""
        return frame_jacobian(self.robot.tree, self.robot.tool, self.link[0])

    @cached_property
    def drive_torque(self) -> Quantity:
        """Torque of the drives (n,) [N m]."""
        return self._added_drive_torque() + drive_torque(
            self.torques.spring,
            self.velocity,
            self.acceleration,
            rotor_inertia=self.robot.rotor_inertia,
            coulomb=self.robot.coulomb,
            viscous=self.robot.viscous,
            velocity_max=self.robot.velocity_max,
        )

    @property
    def squared_drive_torque(self) -> Quantity:
        """Squared drive torque (n,), with the square of dry friction in full at any speed.

        The square of the smooth law alone would reward creeping: within the smoothing width there
        is less friction than by the exact law. `creeping` removes that charge.

        Where friction and the rest of the torque have one sign, the square is concave in the
        velocity. `convexity` takes that curvature out of second derivatives; the value stays.
        """
        dry = ca.DM(self.robot.coulomb)
        width = ca.DM(dry_friction_width(self.robot.velocity_max))
        place = self.velocity / width / self.kinks
        share = ca.tanh(place)
        rest = self._drive_torque_without_dry_friction + self._added_drive_torque()
        # Zero, but of slope one: only second derivatives of its square differ from zero.
        slope = place - ca.floor(place / _SPEED_STEP) * _SPEED_STEP
        concave = 2.0 * dry * ca.fmax(rest * share, 0.0) * (1.0 - share**2)
        bare = (rest + dry * share) ** 2 + (1.0 - self.creeping) * dry**2 * (1.0 - share**2)
        return bare + self.convexity * concave * slope**2

    @property
    def _drive_torque_without_dry_friction(self) -> Quantity:
        robot = self.robot
        return drive_torque(
            self.torques.spring,
            self.velocity,
            self.acceleration,
            rotor_inertia=robot.rotor_inertia,
            coulomb=np.zeros_like(robot.coulomb),
            viscous=robot.viscous,
            velocity_max=robot.velocity_max,
        )

    def torque_envelope(self, side: float) -> Quantity:
        """Drive torque (n,) [N m] with an envelope of the dry friction on one side (+1 or -1).

        Friction jumps at zero velocity, between nodes as well. On the upper side (+1) the smoothed
        friction is evaluated two smoothing widths faster, so that the limit holds for the
        discontinuous law.
        """
        width = dry_friction_width(self.robot.velocity_max)
        place = self.velocity / ca.DM(width) + 2.0 * side
        dry = ca.DM(self.robot.coulomb) * ca.tanh(place)
        return self._drive_torque_without_dry_friction + self._added_drive_torque(side) + dry

    @cached_property
    def tool_velocity(self) -> Quantity:
        """Velocity of the tool (3,) [m/s]."""
        return ca.mtimes(self.jacobian, self.velocity)

    def windup(self, torque: Quantity) -> Quantity:
        """Wind-up of every joint (n,) [rad] under spring torques (n,)."""
        return windups(self.chains, torque, self.smoothing)

    def compliance(self, joint: int) -> Quantity:
        """Tangent compliance [rad/(N m)] of a joint (1-based) at its spring torque."""
        chain = self.chains[joint - 1]
        if chain is None:
            raise ProblemError(
                f"Joint {joint} of {self.robot.name} has no drivetrain, so it has no stiffness. "
                "Describe its elements in the robot file, or leave the joint out."
            )
        return chain.tangent_compliance(self.torques.spring[joint - 1], smoothing=self.smoothing)

    @cached_property
    def deflection(self) -> Deflection:
        """Static, dynamic and process parts of the tool deflection (3,) [m]."""
        if all(chain is None for chain in self.robot.chains):
            raise ProblemError(
                f"{self.robot.name} has no drivetrain, so its tool does not deflect. Describe the "
                "joints' elements in the robot file, or minimise and limit no deflection."
            )
        return self._with_bearings(tool_deflection(self.jacobian, self.torques, self.windup))

    def _with_bearings(self, torsion: Deflection) -> Deflection:
        """Add the deflection by output bearings and bending links."""
        if not self.robot.tilts:
            return torsion
        return torsion + bearing_deflection(self.robot, *self.link, self.process_force)
