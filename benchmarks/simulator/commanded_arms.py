"""Arms whose joints follow commanded positions: drawn links and servos, their URDF and MJCF."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

# Relative deviations of links and drives from one drawn arm to the next.
_LENGTH_SPREAD, _DRIVE_SPREAD = 0.15, 0.25
_TOOL_CLEARANCE = 0.01  # from the tip of the last rod to the tool frame [m]
_LINK_RADIUS = 0.028  # of links [m]
_ROTOR_MASS = 1e-6  # of rotors as bodies of their own, whose inertia is an armature [kg]


@dataclass(frozen=True, kw_only=True)
class Arm:
    """Nominal arm: uniform rods along z at angle zero, servos, logging; one number a joint, SI.

    Parameters
    ----------
    axes : str
        Axis of each joint, "x", "y" or "z".
    upward : bool
        Rods stand on the base; otherwise they hang from it.
    lengths, masses : tuple of float
        Of the rods.
    kp, kd, armature, coulomb, viscous : tuple of float
        At the joints.
    rate, held : float
        Of the log [Hz], and interval of the commands [s].
    count, noise : float
        Of the encoders [rad].
    commands_counted : bool
        Commands are whole counts as well.
    delays : tuple of float
        Range of the commands' delay [s].
    backlash : float
        Of a worn gear [rad].
    """

    axes: str
    upward: bool
    lengths: tuple[float, ...]
    masses: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    armature: tuple[float, ...]
    coulomb: tuple[float, ...]
    viscous: tuple[float, ...]
    rate: float
    held: float
    count: float
    noise: float
    commands_counted: bool
    delays: tuple[float, float]
    backlash: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.axes)

    @property
    def torque_max(self) -> np.ndarray:
        """Torque (n,) at a position error that no healthy servo reaches [N m]."""
        return 1.5 * np.array(self.kp)

    @property
    def places(self) -> np.ndarray:
        """Distances (n + 1,) from each joint to the one before it, and to the tool [m]."""
        ends = np.array([0.0, *self.lengths[:-1], self.lengths[-1] + _TOOL_CLEARANCE])
        return ends if self.upward else -ends

    def drawn(self, rng: np.random.Generator) -> Arm:
        """Return another arm of this kind: lengths, masses and drives of its own."""

        def vary(values: tuple[float, ...], spread: float) -> tuple[float, ...]:
            factors = np.exp(spread * rng.uniform(-1.0, 1.0, len(values)))
            return tuple(float(f"{x:.4g}") for x in factors * values)

        names = ("kp", "kd", "armature", "coulomb", "viscous", "masses")
        return replace(
            self,
            lengths=vary(self.lengths, _LENGTH_SPREAD),
            **{name: vary(getattr(self, name), _DRIVE_SPREAD) for name in names},
        )


ARMS = {
    "servo": Arm(
        axes="zyyyxz", upward=True, lengths=(0.06, 0.12, 0.13, 0.06, 0.04, 0.08),
        masses=(0.15, 0.18, 0.15, 0.08, 0.06, 0.1), kp=(18.0, 18.0, 18.0, 12.0, 12.0, 12.0),
        kd=(0.6, 0.6, 0.6, 0.3, 0.3, 0.3), armature=(0.03, 0.03, 0.03, 0.02, 0.02, 0.02),
        coulomb=(0.06, 0.06, 0.06, 0.04, 0.04, 0.04), viscous=(0.2, 0.2, 0.2, 0.1, 0.1, 0.1),
        rate=50.0, held=0.02, count=2.0 * np.pi / 4096, noise=0.0, commands_counted=True,
        delays=(0.005, 0.025), backlash=0.012,
    ),
    "leg": Arm(
        axes="xyy", upward=False, lengths=(0.1, 0.21, 0.21), masses=(0.7, 1.1, 0.25),
        kp=(20.0, 20.0, 25.0), kd=(1.0, 1.0, 1.0), armature=(0.012, 0.012, 0.03),
        coulomb=(0.2, 0.2, 0.4), viscous=(0.15, 0.15, 0.2), rate=200.0, held=0.02, count=1e-4,
        noise=1e-4, commands_counted=False, delays=(0.002, 0.01), backlash=0.012,
    ),
    "industrial": Arm(
        axes="zyyxyx", upward=True, lengths=(0.4, 0.6, 0.5, 0.15, 0.12, 0.1),
        masses=(12.0, 14.0, 9.0, 3.0, 2.0, 1.0), kp=(9e3, 9e3, 6e3, 900.0, 900.0, 500.0),
        kd=(300.0, 300.0, 200.0, 25.0, 25.0, 12.0), armature=(4.0, 4.0, 2.5, 0.3, 0.3, 0.2),
        coulomb=(15.0, 16.0, 10.0, 2.5, 2.5, 2.0), viscous=(14.0, 14.0, 9.0, 1.8, 1.8, 1.4),
        rate=250.0, held=0.004, count=1e-5, noise=5e-6, commands_counted=False,
        delays=(0.004, 0.016), backlash=0.002,
    ),
}  # fmt: skip


def _inertia(length: float, mass: float) -> tuple[float, float]:
    """Return the inertia of a solid cylinder across and along its axis [kg m^2]."""
    return mass * (length**2 / 12.0 + _LINK_RADIUS**2 / 4.0), mass * _LINK_RADIUS**2 / 2.0


def _axis(letter: str) -> str:
    return " ".join("1" if letter == each else "0" for each in "xyz")


def urdf_text(arm: Arm) -> str:
    """Return the URDF of an arm."""
    parts = ['<?xml version="1.0"?>', '<robot name="arm"><link name="base"/>']
    sign, before = (1.0 if arm.upward else -1.0), "base"
    for k in range(arm.n):
        across, along = _inertia(arm.lengths[k], arm.masses[k])
        limit = f'lower="-3" upper="3" effort="{arm.torque_max[k]:g}" velocity="12"'
        name = f"l{k + 1}"
        parts.append(
            f'<joint name="j{k + 1}" type="revolute"><parent link="{before}"/>'
            f'<child link="{name}"/><origin xyz="0 0 {arm.places[k]:.9g}"/>'
            f'<axis xyz="{_axis(arm.axes[k])}"/><limit {limit}/></joint>'
            f'<link name="{name}"><inertial><origin xyz="0 0 {0.5 * sign * arm.lengths[k]:.9g}"/>'
            f'<mass value="{arm.masses[k]:.9g}"/><inertia ixx="{across:.9g}" iyy="{across:.9g}"'
            f' izz="{along:.9g}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        before = name
    parts.append(
        f'<link name="tool"/><joint name="flange" type="fixed"><parent link="{before}"/>'
        f'<child link="tool"/><origin xyz="0 0 {arm.places[-1]:.9g}"/></joint>'
    )
    return "\n".join([*parts, "</robot>"])


def mjcf_text(arm: Arm, scale: np.ndarray, rotors: frozenset[int]) -> str:
    """Return the MJCF of an arm, its links heavier by factors (n,).

    Joints of `rotors` get a body "r" of the motor's angle beside the link, for gears with backlash.
    """
    sign = 1.0 if arm.upward else -1.0
    parts, ends = ["<mujoco><compiler angle='radian'/><worldbody>"], []
    for k in range(arm.n):
        across, along = scale[k] * np.array(_inertia(arm.lengths[k], arm.masses[k]))
        place = f"pos='0 0 {arm.places[k]:.9g}'"
        hinge = f"type='hinge' axis='{_axis(arm.axes[k])}'"
        if k in rotors:
            parts.append(
                f"<body {place}><joint name='r{k}' {hinge}/><inertial pos='0 0 0'"
                f" mass='{_ROTOR_MASS}' diaginertia='1e-9 1e-9 1e-9'/></body>"
            )
        parts.append(
            f"<body name='l{k}' {place}><joint name='j{k}' {hinge}/>"
            f"<inertial pos='0 0 {0.5 * sign * arm.lengths[k]:.9g}'"
            f" mass='{scale[k] * arm.masses[k]:.9g}'"
            f" diaginertia='{across:.9g} {across:.9g} {along:.9g}'/>"
        )
        ends.append("</body>")
    parts.append(f"<site name='tool' pos='0 0 {arm.places[-1]:.9g}'/>")
    return "".join([*parts, *ends, "</worldbody></mujoco>"])
