"""Typical servo values by kind of controller.

Rates are those of the controllers' interfaces. Bandwidths, feed-forward shares and loop delays are
not published; they are assumed within the ranges that identified drives have: 8 to 40 Hz, 0.9 to 1,
1 to 8 ms.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ServoKind:
    """Typical values of a kind of controller."""

    bandwidth: float  # of the position loop [Hz]
    # Shares of the commanded velocity and of the torque of the commanded acceleration.
    feed_forward: float = 1.0
    torque_feed_forward: float
    delay: float = 0.0  # dead time of the loop [s]
    rate: float | None  # of the set-points [Hz]; None for continuous ones
    source: str  # of the rate


SERVO_KINDS = {
    "ideal": ServoKind(
        bandwidth=20.0,
        torque_feed_forward=1.0,
        rate=None,
        source="Follows exactly.",
    ),
    "industrial": ServoKind(
        bandwidth=20.0,
        torque_feed_forward=0.9,
        rate=250.0,
        source="KUKA.RobotSensorInterface: 4 ms cycle.",
    ),
    "collaborative": ServoKind(
        bandwidth=15.0,
        torque_feed_forward=0.9,
        rate=500.0,
        source="Universal Robots e-Series, The URScript Programming Language: 2 ms cycle.",
    ),
    "research": ServoKind(
        bandwidth=40.0,
        torque_feed_forward=0.95,
        rate=1000.0,
        source="Franka Control Interface: 1 ms cycle.",
    ),
    "cb_series": ServoKind(
        bandwidth=15.0,
        torque_feed_forward=0.8,
        rate=125.0,
        source="Universal Robots CB-Series, The URScript Programming Language: 8 ms cycle.",
    ),
}
