"""Machines that nothing was developed on: seven axes, a palletiser, a SCARA, a heavy arm."""

from __future__ import annotations

import numpy as np

from .machines import ARM6, BIG6, PLANAR2, SMALL3, X, Y, Z, row
from .robots import Body, Robot

# A light arm with a redundant joint and soft reducers.
ARM7 = Robot(
    name="arm7",
    bodies=(
        Body(
            origin=(0, 0, 0.16), axis=Z, mass=4.1, com=(0, -0.03, 0.1), inertia=(0.05, 0.045, 0.013)
        ),
        Body(
            origin=(0, 0, 0.2),
            axis=Y,
            mass=4.0,
            com=(0.001, 0.04, 0.06),
            inertia=(0.04, 0.02, 0.03),
        ),
        Body(
            origin=(0, 0, 0.2), axis=Z, mass=3.1, com=(0, 0.03, 0.11), inertia=(0.035, 0.03, 0.01)
        ),
        Body(
            origin=(0, 0, 0.21), axis=Y, mass=2.8, com=(0, 0.06, 0.03), inertia=(0.02, 0.01, 0.02)
        ),
        Body(
            origin=(0, 0, 0.19),
            axis=Z,
            mass=1.8,
            com=(0, 0.02, 0.08),
            inertia=(0.013, 0.011, 0.005),
        ),
        Body(origin=(0, 0, 0.2), axis=Y, mass=1.8, com=(0, 0, 0.01), inertia=(0.005, 0.004, 0.005)),
        Body(
            origin=(0, 0, 0.08), axis=Z, mass=0.4, com=(0.01, 0, 0.02), inertia=(5e-4, 5e-4, 8e-4)
        ),
    ),
    payload_mass=4.5,
    payload_com=(0.03, 0.02, 0.09),
    tool=(0, 0, 0.15),
    gear_ratio=row(160, 160, 160, 160, 100, 160, 160),
    rotor_inertia=row(2.4, 2.4, 1.5, 1.5, 0.4, 0.5, 0.5),
    coulomb=row(6.0, 6.2, 4.2, 4.1, 2.4, 1.6, 1.5),
    viscous=row(7.5, 7.6, 5.0, 4.8, 2.4, 1.7, 1.6),
    torque_max=row(320, 320, 176, 176, 110, 40, 40),
    torque_rated=row(120, 120, 66, 66, 40, 15, 15),
    joint_damping=row(9, 9, 5, 4, 1.5, 0.8, 0.6),
    contact_stiffness=row(1.6e5, 1.6e5, 9e4, 9e4, 5e4, 2.6e4, 2.4e4),
    connections=("key+bolts", "pins+bolts") * 3 + ("key+bolts",),
    slopes=np.array(
        [
            [2.6e4, 2.6e4, 1.6e4, 1.5e4, 9.2e3, 5.1e3, 5.0e3],
            [4.2e4, 4.2e4, 2.5e4, 2.4e4, 1.4e4, 7.4e3, 7.2e3],
            [4.8e4, 4.8e4, 2.9e4, 2.8e4, 1.6e4, 8.6e3, 8.4e3],
        ]
    ),
    corners=np.array(
        [[16.0, 16.0, 8.5, 8.2, 4.1, 1.9, 1.8], [60.0, 60.0, 32.0, 31.0, 15.0, 6.6, 6.5]]
    ),
    speed_max=row(1.7, 1.7, 1.75, 2.2, 2.4, 3.1, 3.1),
    centre=row(0.0, 0.6, 0.2, -1.1, 0.0, 0.7, 0.0),
    reach=row(0.9, 0.6, 0.7, 0.6, 1.0, 0.9, 1.2),
    torque_noise=row(0.5, 0.5, 0.3, 0.3, 0.16, 0.09, 0.08),
    motor_bits=18,
)

# Four axes: stiff reducers, heavy links, a load of which the last joint feels the inertia alone.
PALLET4 = Robot(
    name="pallet4",
    bodies=(
        Body(origin=(0, 0, 0.3), axis=Z, mass=85.0, com=(0.05, 0, 0.15), inertia=(2.6, 3.0, 2.2)),
        Body(
            origin=(0.22, 0, 0.35), axis=Y, mass=42.0, com=(0, 0.05, 0.34), inertia=(4.2, 4.0, 0.5)
        ),
        Body(
            origin=(0, 0, 0.85), axis=Y, mass=27.0, com=(0.38, -0.03, 0.04), inertia=(0.3, 2.4, 2.4)
        ),
        Body(
            origin=(0.95, 0, -0.1), axis=X, mass=6.5, com=(0.06, 0, 0), inertia=(0.05, 0.04, 0.04)
        ),
    ),
    payload_mass=25.0,
    payload_com=(0.2, 0.06, 0.05),
    tool=(0.3, 0, 0),
    gear_ratio=row(175, 190, 190, 120),
    rotor_inertia=row(32, 36, 28, 5.5),
    coulomb=row(75, 90, 65, 14),
    viscous=row(60, 70, 48, 10),
    torque_max=row(3100, 3900, 2700, 420),
    torque_rated=row(1000, 1300, 900, 140),
    joint_damping=row(320, 340, 190, 16),
    contact_stiffness=row(4.2e6, 4.6e6, 3.1e6, 3.6e5),
    connections=("pins+bolts", "pins+bolts", "2 keys+pins+bolts", "belt+key+bolts"),
    slopes=np.array(
        [[1.1e6, 1.3e6, 8.6e5, 8.8e4], [1.7e6, 2.0e6, 1.3e6, 1.4e5], [2.0e6, 2.3e6, 1.5e6, 1.6e5]]
    ),
    corners=np.array([[190.0, 240.0, 170.0, 30.0], [680.0, 850.0, 600.0, 105.0]]),
    speed_max=row(1.9, 1.7, 1.9, 3.4),
    centre=row(0.0, 0.1, 0.35, 0.0),
    reach=row(1.1, 0.5, 0.5, 1.4),
    torque_noise=row(5.0, 6.0, 4.2, 0.8),
    motor_bits=19,
)

# Upright axes, which gravity does not load, a quill that slides, and belts to the last two.
SCARA4 = Robot(
    name="scara4",
    bodies=(
        Body(origin=(0, 0, 0.3), axis=Z, mass=11.0, com=(0.16, 0, 0.03), inertia=(0.04, 0.2, 0.2)),
        Body(
            origin=(0.35, 0, 0.06), axis=Z, mass=7.5, com=(0.14, 0, 0.05), inertia=(0.03, 0.1, 0.1)
        ),
        Body(
            origin=(0.3, 0, 0),
            axis=Z,
            mass=1.6,
            com=(0, 0, 0.05),
            inertia=(0.012, 0.012, 4e-4),
            slides=True,
        ),
        Body(origin=(0, 0, -0.12), axis=Z, mass=0.5, com=(0, 0, 0), inertia=(6e-4, 6e-4, 5e-4)),
    ),
    payload_mass=4.0,
    payload_com=(0.05, 0.01, -0.04),
    tool=(0.05, 0, -0.08),
    gear_ratio=row(80, 50, 2 * np.pi / 0.02, 20),
    rotor_inertia=row(1.9, 0.55, 7.0, 0.03),
    coulomb=row(5.5, 2.6, 16.0, 0.5),
    viscous=row(5.0, 2.0, 45.0, 0.25),
    torque_max=row(210, 95, 700, 14),
    torque_rated=row(70, 32, 230, 4.6),
    joint_damping=row(9.0, 2.5, 60.0, 0.05),
    contact_stiffness=row(1.4e5, 6e4, 5e6, 3e3),
    connections=("key+bolts", "key+bolts", "belt+key+bolts", "belt+key+bolts"),
    slopes=np.array(
        [[2.7e4, 1.2e4, 6.0e5, 420.0], [4.2e4, 1.8e4, 7.5e5, 520.0], [5.0e4, 2.1e4, 8.5e5, 580.0]]
    ),
    corners=np.array([[12.0, 5.5, 60.0, 1.0], [42.0, 19.0, 220.0, 3.6]]),
    speed_max=row(4.2, 6.0, 1.1, 12.0),
    centre=row(0.0, 0.9, -0.1, 0.0),
    reach=row(1.1, 1.0, 0.085, 1.8),
    torque_noise=row(0.35, 0.16, 1.2, 0.025),
)

# Six axes for 20 kg: cycloidal (RV) reducers, stiff against the bodies they carry, dry friction
# that their preload makes, an offset wrist, and encoders of few bits on both sides.
RV6 = Robot(
    name="rv6",
    bodies=(
        Body(origin=(0, 0, 0.2), axis=Z, mass=64.0, com=(0.05, 0, 0.12), inertia=(1.5, 1.6, 1.3)),
        Body(origin=(0.17, 0, 0.3), axis=Y, mass=36.0, com=(0, 0.04, 0.3), inertia=(2.4, 2.3, 0.3)),
        Body(origin=(0, 0, 0.76), axis=Y, mass=28.0, com=(0.1, 0, 0.09), inertia=(0.4, 0.9, 0.8)),
        Body(origin=(0.4, 0, 0.2), axis=X, mass=13.0, com=(0.2, 0, 0), inertia=(0.07, 0.4, 0.4)),
        Body(
            origin=(0.42, 0, 0), axis=Y, mass=5.2, com=(0.04, 0, 0), inertia=(0.015, 0.025, 0.025)
        ),
        Body(origin=(0.1, 0, 0), axis=X, mass=0.9, com=(0.015, 0, 0), inertia=(1.4e-3, 9e-4, 9e-4)),
    ),
    payload_mass=18.0,
    payload_com=(0.12, 0.05, 0.07),
    tool=(0.2, 0, 0),
    gear_ratio=row(141, 153, 129, 81, 81, 51),
    rotor_inertia=row(21, 27, 17, 2.6, 2.4, 0.9),
    coulomb=row(62, 80, 48, 12, 11, 5.5),
    viscous=row(75, 95, 52, 9, 8.5, 3.4),
    torque_max=row(2100, 2600, 1500, 300, 290, 150),
    torque_rated=row(700, 880, 500, 100, 96, 50),
    joint_damping=row(210, 260, 120, 12, 11, 5),
    contact_stiffness=row(5.4e6, 6.2e6, 3.4e6, 4.6e5, 4.4e5, 2.1e5),
    connections=("pins+bolts",) * 3 + ("key+bolts", "belt+key+bolts", "belt+key+bolts"),
    slopes=np.array(
        [
            [1.5e6, 1.9e6, 9.5e5, 9.0e4, 8.8e4, 4.2e4],
            [1.7e6, 2.1e6, 1.1e6, 1.3e5, 1.3e5, 6.0e4],
            [1.8e6, 2.2e6, 1.2e6, 1.5e5, 1.5e5, 6.8e4],
        ]
    ),
    corners=np.array(
        [[110.0, 140.0, 80.0, 24.0, 23.0, 12.0], [420.0, 530.0, 300.0, 82.0, 80.0, 42.0]]
    ),
    speed_max=row(2.6, 2.4, 2.9, 5.2, 5.0, 7.5),
    centre=row(0.0, 0.15, 0.25, 0.0, 0.7, 0.0),
    reach=row(1.0, 0.55, 0.6, 1.1, 0.9, 1.5),
    torque_noise=row(4.2, 5.0, 3.1, 0.7, 0.65, 0.35),
    link_count=2 * np.pi / 2**18,
    motor_bits=13,
)

ROBOTS = {robot.name: robot for robot in (PLANAR2, SMALL3, ARM6, BIG6, ARM7, PALLET4, SCARA4, RV6)}
