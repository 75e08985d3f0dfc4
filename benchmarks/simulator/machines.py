"""Four machines: two links in a vertical plane, three joints, and two six-axis layouts."""

from __future__ import annotations

import numpy as np

from .robots import Body, Robot

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def row(*values: float) -> np.ndarray:
    return np.array(values, dtype=float)


PLANAR2 = Robot(
    name="planar2",
    bodies=(
        Body(origin=(0, 0, 0.3), axis=Y, mass=4.2, com=(0.16, 0, 0.01), inertia=(0.01, 0.05, 0.05)),
        Body(
            origin=(0.36, 0, 0), axis=Y, mass=1.9, com=(0.12, 0, 0.0), inertia=(0.004, 0.02, 0.02)
        ),
    ),
    payload_mass=1.2,
    payload_com=(0.31, 0.0, 0.012),
    tool=(0.34, 0, 0),
    gear_ratio=row(101, 81),
    rotor_inertia=row(0.42, 0.11),
    coulomb=row(4.4, 1.7),
    viscous=row(3.2, 1.1),
    torque_max=row(150, 66),
    torque_rated=row(50, 22),
    joint_damping=row(5, 1.2),
    contact_stiffness=row(7.5e4, 3.1e4),
    connections=("key+bolts", "belt+key+bolts"),
    slopes=np.array([[1.9e4, 9.6e3], [2.9e4, 1.35e4], [3.4e4, 1.55e4]]),
    corners=np.array([[8.0, 3.6], [28.0, 11.5]]),
    speed_max=row(3.0, 4.2),
    centre=row(-1.35, 0.5),
    reach=row(0.75, 0.8),
    torque_noise=row(0.22, 0.09),
)

SMALL3 = Robot(
    name="small3",
    bodies=(
        Body(origin=(0, 0, 0.2), axis=Z, mass=5.1, com=(0.01, 0, 0.05), inertia=(0.03, 0.03, 0.02)),
        Body(
            origin=(0.05, 0, 0.1),
            axis=Y,
            mass=3.6,
            com=(0, 0.01, 0.13),
            inertia=(0.03, 0.03, 0.006),
        ),
        Body(
            origin=(0, 0, 0.28),
            axis=Y,
            mass=1.8,
            com=(0.11, 0, 0.01),
            inertia=(0.003, 0.015, 0.015),
        ),
    ),
    payload_mass=1.5,
    payload_com=(0.27, 0.015, 0.01),
    tool=(0.3, 0, 0),
    gear_ratio=row(100, 120, 100),
    rotor_inertia=row(0.55, 0.62, 0.16),
    coulomb=row(4.0, 4.6, 2.1),
    viscous=row(3.6, 3.9, 1.4),
    torque_max=row(140, 160, 80),
    torque_rated=row(46, 52, 26),
    joint_damping=row(5, 6, 1.6),
    contact_stiffness=row(8e4, 9e4, 3.8e4),
    connections=("key+bolts", "key+bolts", "belt+key+bolts"),
    slopes=np.array([[1.7e4, 2.1e4, 1.05e4], [2.6e4, 3.3e4, 1.5e4], [3.0e4, 3.8e4, 1.8e4]]),
    corners=np.array([[7.0, 9.0, 4.2], [25.0, 31.0, 14.0]]),
    speed_max=row(3.2, 2.8, 3.6),
    centre=row(0.0, 0.35, 0.15),
    reach=row(0.9, 0.75, 0.85),
    torque_noise=row(0.22, 0.25, 0.12),
)

ARM6 = Robot(
    name="arm6",
    bodies=(
        Body(origin=(0, 0, 0.18), axis=Z, mass=7.1, com=(0.02, 0, 0.1), inertia=(0.06, 0.06, 0.03)),
        Body(
            origin=(0.05, 0, 0.17),
            axis=Y,
            mass=5.6,
            com=(0, -0.01, 0.14),
            inertia=(0.06, 0.06, 0.014),
        ),
        Body(
            origin=(0, 0, 0.28), axis=Y, mass=3.7, com=(0.04, 0, 0.02), inertia=(0.011, 0.02, 0.02)
        ),
        Body(
            origin=(0.11, 0, 0.03),
            axis=X,
            mass=1.8,
            com=(0.08, 0, 0),
            inertia=(0.002, 0.007, 0.007),
        ),
        Body(
            origin=(0.16, 0, 0), axis=Y, mass=0.85, com=(0.02, 0, 0), inertia=(8e-4, 1.1e-3, 1.1e-3)
        ),
        Body(
            origin=(0.07, 0, 0), axis=X, mass=0.25, com=(0.012, 0, 0), inertia=(1.4e-4, 1e-4, 1e-4)
        ),
    ),
    payload_mass=2.7,
    payload_com=(0.06, 0.02, 0.026),
    tool=(0.11, 0, 0),
    gear_ratio=row(121, 121, 101, 81, 81, 51),
    rotor_inertia=row(0.95, 1.1, 0.38, 0.095, 0.09, 0.045),
    coulomb=row(5.6, 6.6, 3.8, 1.5, 1.5, 0.8),
    viscous=row(4.8, 5.2, 2.8, 1.0, 0.9, 0.45),
    torque_max=row(195, 205, 118, 70, 70, 26),
    torque_rated=row(65, 68, 39, 23, 23, 8.5),
    joint_damping=row(9, 9, 4, 0.9, 0.8, 0.3),
    contact_stiffness=row(1.25e5, 1.35e5, 6.2e4, 3.2e4, 3.0e4, 1.4e4),
    connections=("key+bolts",) * 2 + ("belt+key+bolts",) * 3 + ("2 keys+pins+bolts",),
    slopes=np.array(
        [
            [3.0e4, 3.2e4, 1.55e4, 9.8e3, 9.8e3, 4.4e3],
            [4.9e4, 5.1e4, 2.4e4, 1.4e4, 1.4e4, 5.9e3],
            [5.6e4, 5.9e4, 2.8e4, 1.6e4, 1.6e4, 6.9e3],
        ]
    ),
    corners=np.array([[14.0, 14.0, 7.0, 3.9, 3.9, 1.6], [47.0, 49.0, 25.0, 12.0, 12.0, 6.0]]),
    speed_max=row(3.3, 2.8, 3.3, 4.6, 4.6, 6.0),
    centre=row(0.0, 0.4, 0.1, 0.0, 0.6, 0.0),
    reach=row(0.9, 0.7, 0.7, 1.1, 1.0, 1.5),
    torque_noise=row(0.34, 0.35, 0.2, 0.085, 0.08, 0.05),
)

# Three parallel axes, then a wrist of crossed axes: another kinematic layout, four times the mass.
BIG6 = Robot(
    name="big6",
    bodies=(
        Body(origin=(0, 0, 0.22), axis=Z, mass=22.0, com=(0, 0.02, 0.06), inertia=(0.4, 0.4, 0.3)),
        Body(origin=(0, 0.17, 0), axis=Y, mass=26.0, com=(0.3, 0.02, 0), inertia=(0.12, 1.6, 1.6)),
        Body(
            origin=(0.66, -0.05, 0), axis=Y, mass=11.0, com=(0.27, 0, 0), inertia=(0.04, 0.6, 0.6)
        ),
        Body(origin=(0.58, 0, 0), axis=Y, mass=3.4, com=(0, 0.08, 0), inertia=(0.015, 0.01, 0.015)),
        Body(
            origin=(0, 0.12, 0), axis=Z, mass=3.2, com=(0, 0, -0.06), inertia=(0.013, 0.013, 0.008)
        ),
        Body(
            origin=(0, 0, -0.12), axis=Y, mass=1.1, com=(0, 0.05, 0), inertia=(0.002, 0.002, 0.002)
        ),
    ),
    payload_mass=9.5,
    payload_com=(0.045, 0.13, 0.03),
    tool=(0, 0.18, 0),
    gear_ratio=row(160, 160, 160, 101, 101, 101),
    rotor_inertia=row(7.5, 8.0, 4.2, 0.8, 0.75, 0.5),
    coulomb=row(24, 28, 16, 5.5, 5.2, 4.0),
    viscous=row(22, 24, 14, 4.0, 3.8, 2.6),
    torque_max=row(1000, 1100, 560, 170, 165, 120),
    torque_rated=row(330, 360, 185, 56, 55, 40),
    joint_damping=row(70, 75, 34, 5, 5, 3),
    contact_stiffness=row(8.5e5, 9e5, 4.5e5, 1.2e5, 1.15e5, 7.5e4),
    connections=("pins+bolts",) * 3 + ("key+bolts",) * 3,
    slopes=np.array(
        [
            [2.4e5, 2.6e5, 1.2e5, 3.1e4, 3.0e4, 2.0e4],
            [3.7e5, 4.0e5, 1.9e5, 5.0e4, 4.8e4, 3.1e4],
            [4.4e5, 4.7e5, 2.2e5, 5.7e4, 5.5e4, 3.6e4],
        ]
    ),
    corners=np.array(
        [[62.0, 66.0, 34.0, 13.0, 13.0, 9.0], [220.0, 235.0, 120.0, 46.0, 45.0, 30.0]]
    ),
    speed_max=row(2.1, 2.1, 2.6, 3.2, 3.2, 3.6),
    centre=row(0.0, -1.15, 0.9, 0.3, 0.0, 0.0),
    reach=row(0.9, 0.6, 0.7, 1.0, 1.0, 1.3),
    torque_noise=row(1.6, 1.7, 0.9, 0.28, 0.27, 0.2),
    motor_bits=19,
)
