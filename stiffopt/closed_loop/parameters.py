"""Parameters of a closed loop: names, units, values to start from and their deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Of each joint: name and unit of a revolute one.
JOINT_PARAMETERS = {
    "gain": "1",  # relative change of the actuator's stiffness
    "damping": "1",  # relative change of its damping
    "armature": "kg m^2",
    "viscous": "N m s/rad",
    "coulomb": "N m",
    "load_friction": "1",  # share of the torque that the gear transmits
    "creep": "rad/s",  # below which dry friction is in proportion to the velocity
    "friction_slope": "N m/rad",  # of dry friction over the position, about the middle
    "drag": "N m s^2/rad^2",  # of friction with the square of the velocity
    "offset": "N m",
    "zero": "rad",  # reading of the encoder less the angle of the bodies
    "lateness": "s",  # of the command, beyond the delay of all
    "integral": "1/s",  # integral over the proportional gain of a controller
    "deadband": "rad",  # position error up to which the actuator gives no torque
}
# Parameters over the actuator's gain, and units of the ratios.
RATIO_UNITS = {"armature": "s^2", "viscous": "s", "coulomb": "rad"}
# Those that decide how an arm follows, and that a fit begins with: the rest refines.
LEADING_PARAMETERS = (
    "gain",
    "damping",
    "armature",
    "viscous",
    "coulomb",
    "offset",
    "lateness",
    "integral",
    "deadband",
)
# Of each body, as changes: mass, relative, with its moments in proportion; first moment and inertia
# about its axis frame besides.
BODY_PARAMETERS = ("mass", "mcx", "mcy", "mcz", "Ixx", "Iyy", "Izz")
AMPLITUDES, DELAY = "amplitudes", "delay"
# Not below zero.
_BOUNDED_PARAMETERS = (
    "armature",
    "viscous",
    "coulomb",
    "load_friction",
    "drag",
    "creep",
    "integral",
    "deadband",
    DELAY,
)


@dataclass(frozen=True, eq=False)
class Parameters:
    """Values of a closed loop's parameters, in the order of `names`."""

    joints: tuple[str, ...]  # (n,) in the order of the robot
    # (p,) by parameter, then by joint; then of the bodies, body by body; of the physics; the delay.
    values: np.ndarray
    amplitude_bounds: np.ndarray  # (m, 2) least and greatest values of the physics

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def names(self) -> tuple[tuple[str, str], ...]:
        """Name and joint of every parameter; "" for all joints together."""
        own = [(name, joint) for name in JOINT_PARAMETERS for joint in self.joints]
        bodies = [(name, joint) for joint in self.joints for name in BODY_PARAMETERS]
        return (*own, *bodies, *[(AMPLITUDES, "")] * len(self.amplitude_bounds), (DELAY, ""))

    @property
    def bounds(self) -> np.ndarray:
        """Least and greatest values (p, 2)."""
        least = [0.0 if name in _BOUNDED_PARAMETERS else -np.inf for name, _ in self.names]
        found = np.column_stack([least, np.full(len(least), np.inf)])
        found[self.amplitudes] = self.amplitude_bounds
        return found

    def place(self, name: str) -> slice:
        """Return the places of a joint parameter."""
        first = list(JOINT_PARAMETERS).index(name) * self.n
        return slice(first, first + self.n)

    @property
    def bodies(self) -> slice:
        """Places of the body parameters."""
        first = len(JOINT_PARAMETERS) * self.n
        return slice(first, first + len(BODY_PARAMETERS) * self.n)

    @property
    def amplitudes(self) -> slice:
        """Places of the values of the physics."""
        return slice(self.bodies.stop, self.bodies.stop + len(self.amplitude_bounds))

    def body_places(self, name: str) -> slice:
        """Return the places (n,) of a body parameter, one a joint."""
        first = self.bodies.start + BODY_PARAMETERS.index(name)
        return slice(first, self.bodies.stop, len(BODY_PARAMETERS))

    @property
    def leading(self) -> np.ndarray:
        """Return which parameters (p,) a fit begins with; the delay is one of them."""
        leading = (*LEADING_PARAMETERS, AMPLITUDES, DELAY)
        return np.array([name in leading for name, _ in self.names])

    def of_bodies(self, name: str) -> np.ndarray:
        """Return the values (n,) of a body parameter."""
        return self.values[self.body_places(name)]

    def of(self, name: str) -> np.ndarray:
        """Return the values (n,) of a joint parameter."""
        return self.values[self.place(name)]

    @property
    def delay(self) -> float:
        """Delay of the command [s]."""
        return float(self.values[-1])


def zero_parameters(
    joints: tuple[str, ...], amplitude_bounds: np.ndarray | None = None
) -> Parameters:
    """Return parameters that are all zero; of a physics with bounds of its amplitudes."""
    bounds = np.zeros((0, 2)) if amplitude_bounds is None else amplitude_bounds
    count = (len(JOINT_PARAMETERS) + len(BODY_PARAMETERS)) * len(joints) + len(bounds) + 1
    return Parameters(joints, np.zeros(count), bounds)
