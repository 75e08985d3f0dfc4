"""Tool error that an exact lead leaves on uncertain arms, by their simulation.

The command leads the servo in the middle of the bounds exactly, and by the mean wind-up of the
softest and the stiffest joints, without regard to limits of the motors. The error is that of the
worst arms of the `ParameterBox`, by exchange of the corners of its parameters.

In flight errors are almost additive in the parameters; after arrival they depend on the phases of
the modes, and no arm with all joints alike is the worst. From the worst corners with joints alike,
parameters whose change alone makes the error larger are changed together, those of most gain first.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.bearings import LedPlan, bearing_lead
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import ParameterBox, Uncertainty
from stiffopt.result.tool_error import LedError
from stiffopt.result.trajectory import JointMotion

# Rounds of exchanges: most searches end after three.
_MAX_ROUNDS = 5
# Relative increase of a peak that counts.
_MIN_INCREASE = 1e-3


def peaks_on_levels(
    many: UncertainArms, command: MotorMotion, box: ParameterBox, levels: np.ndarray
) -> np.ndarray:
    """Peaks (2, ..) on arms of levels (.., 2 n + 3), where it is searched [m]."""
    flat = levels.reshape(-1, levels.shape[-1])
    peaks = many.position_peaks(_members(command, box, flat), searched=True)
    return peaks.reshape(2, *levels.shape[:-1])


def corner_peaks(many: UncertainArms, command: MotorMotion, box: ParameterBox) -> np.ndarray:
    """Peaks (2, c) [m] on the corners with joints alike; from now on searched are theirs."""
    return many.search_where_worst(_members(command, box, box.alike_corners()))


def _members(command: MotorMotion, box: ParameterBox, levels: np.ndarray) -> list[Member]:
    return [Member(command=command, departure=box.departure(each)) for each in levels]


def worst_levels(
    many: UncertainArms, command: MotorMotion, box: ParameterBox, peaks: np.ndarray | None = None
) -> np.ndarray:
    """Search the levels of the worst arms of a command: the worst in flight, then after arrival.

    Levels (s, 2 n + 3) are those of s searches, of which each phase has one from soft and one from
    stiff joints. `peaks` (2, c): as of `corner_peaks`, where they are known.
    """
    simulated = functools.partial(peaks_on_levels, many, command, box)
    corners = box.alike_corners()
    peaks = corner_peaks(many, command, box) if peaks is None else peaks
    # The first half of the corners is soft, the second stiff.
    halves = np.array_split(np.arange(len(corners)), 2 if len(corners) > 1 else 1)
    chosen = [half[np.argmax(own[half])] for own in peaks for half in halves]
    phase = np.repeat([0, 1], len(halves))
    levels, worst = corners[chosen], peaks[phase, chosen]
    searches, flips = np.arange(len(levels)), len(box.free)
    active = searches if flips else searches[:0]
    for _ in range(_MAX_ROUNDS):
        if not active.size:
            break
        own = phase[active, None], np.arange(len(active))[:, None]
        # Each parameter alone, then the first, the first two, ... in order of gain.
        alone = np.repeat(levels[active, None], flips, axis=1)
        alone[:, np.arange(flips), box.free] *= -1.0
        single = simulated(alone)[(*own, np.arange(flips))]
        order = np.argsort(-single, axis=1)
        turned = np.repeat(levels[active, None], flips, axis=1)
        for k in range(flips):
            turned[own[1][:, 0], k:, box.free[order[:, k]]] *= -1.0
        gaining = int(np.max(np.sum(single > worst[active, None], axis=1), initial=0))
        together = turned[:, : max(gaining, 1)]
        joined = simulated(together)[(*own, np.arange(together.shape[1]))]
        best = np.argmax(joined, axis=1)
        found = joined[np.arange(len(active)), best]
        better = found > (1.0 + _MIN_INCREASE) * worst[active]
        levels[active[better]] = together[better, best[better]]
        worst[active[better]] = found[better]
        active = active[better]
    return levels


_TIME_STEP = 1e-3  # of the lead [s]
# Rate at which the servo's response to a constant speed is evaluated [1/s].
_SLOW_RATE = 1e-3


def led_error(
    arm: ElasticArm,
    plan: JointMotion,
    uncertainty: Uncertainty,
    servo: Servo,
    below: float = np.inf,
) -> LedError:
    """Return the worst tool errors of uncertain arms whose motors lead a plan exactly.

    `plan`: motion of the links, at rest at both ends. `servo`: the nominal one. Where the sum of
    both phases is not `below` [m] on the corners with joints alike, the errors there alone: those
    of the worst arms are no smaller.
    """
    worst_servo, led = uncertainty.worst_servo(servo), uncertainty.led_servo(servo)
    differs = worst_servo != servo
    many = UncertainArms(arm, plan, _ServoChange(led, servo), _ServoChange(led, worst_servo))
    box = ParameterBox(uncertainty, arm.robot, servo=differs)
    command = _ideal_command(arm, plan, uncertainty)
    peaks = corner_peaks(many, command, box)
    in_flight, after = peaks.max(axis=1).tolist()
    if not in_flight + after < below:
        return LedError(in_flight=in_flight, after_arrival=after, across=np.nan, shares={})
    worst = worst_levels(many, command, box, peaks)
    # Beside the worst arms the nominal one, and those with one parameter at its bound.
    alone = np.tile(box.nominal, (1 + len(box.free), 1))
    alone[np.arange(1, len(alone)), box.free] = 1.0
    levels = np.concatenate([worst, alone])
    members = [Member(command=command, departure=box.departure(each)) for each in levels]
    error = many.simulate(members)
    peaks_in_flight = error.peaks(error.flight)
    flight = peaks_in_flight["position"]
    hardest = int(np.argmax(flight[: len(worst)]))
    instant = int(np.argmax(np.where(error.flight, error.distance[hardest], -1.0)))
    nominal, *single = error.position[len(worst) :, instant]
    squares: dict[str, float] = {}
    for place, own in zip(box.free.tolist(), single, strict=True):
        kind = box.kind(place)
        squares[kind] = squares.get(kind, 0.0) + float(np.sum((own - nominal) ** 2))
    whole = sum(squares.values()) or 1.0
    return LedError(
        in_flight=float(flight.max()),
        after_arrival=float(error.peak(error.after).max()),
        across=float(peaks_in_flight["across"].max()),
        shares={kind: square / whole for kind, square in squares.items()},
    )


def _ideal_command(arm: ElasticArm, plan: JointMotion, uncertainty: Uncertainty) -> MotorMotion:
    """Motors that lead the plan by wind-up and bearings, quasi-static ones, beyond their sag."""
    time = np.linspace(0.0, plan.duration, int(np.ceil(plan.duration / _TIME_STEP)) + 1)
    if arm.robot.tilts:
        plan = LedPlan(plan, bearing_lead(arm, plan))
    q, v, a = (np.array(plan(time, k)) for k in range(3))
    # Both ends are at rest.
    v[[0, -1]] = a[[0, -1]] = 0.0
    pushed, bodies = arm.force_torque(q), arm.robot.bodies_in_motion()
    sag = arm.windup(bodies.torque(q, 0.0 * v, 0.0 * a) - pushed)
    dynamic = arm.windup(bodies.torque(q, v, a) - pushed) - sag
    # Dampers carry part of the torque, by which the wind-up is late.
    dynamic -= arm.lag(q[0]) * np.gradient(dynamic, time, axis=0)
    # Mean of 1 / (1 - b) and 1 / (1 + b).
    position = q + dynamic / (1.0 - uncertainty.shares(arm.robot.n) ** 2)
    velocity = np.gradient(position, time, axis=0)
    velocity[[0, -1]] = 0.0
    return MotorMotion(time, position, velocity)


@dataclass(frozen=True)
class _ServoChange:
    """Response of one servo to a command that leads another one exactly."""

    led: Servo
    actual: Servo

    def follow(self, command: MotorMotion, until: float, ahead: float = 0.0) -> MotorMotion:
        """Motion until a time [s], by the transfer functions, padded by as long a rest."""
        if self.actual == self.led:
            return command
        steps = int(np.ceil(until / _TIME_STEP))
        time = np.linspace(0.0, until, steps + 1)
        s = 2j * np.pi * np.fft.rfftfreq(2 * len(time), until / steps)
        s[0] = _SLOW_RATE
        spectrum = np.fft.rfft(command(time, 1), 2 * len(time), axis=0)
        spectrum *= ((self.actual.transfer(s) / self.led.transfer(s) - 1.0) / s)[:, None]
        s[0] = 0.0
        late, rate = (np.fft.irfft(spectrum * s[:, None] ** k, axis=0)[: len(time)] for k in (0, 1))
        return MotorMotion(time, command(time) + late, command(time, 1) + rate)
