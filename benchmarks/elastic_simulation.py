"""Elastic forward simulation of optimised and baseline motions, independent of the optimiser.

Each joint is a nonlinear spring with 2 % damping between a motor that follows the plan exactly and
the link. The links' motion comes from pinocchio's forward dynamics, the spring torque from the
inverse of the exact wind-up by interpolation, the integration is Runge-Kutta of fourth order with
steps of 0.1 ms, through the motion and 0.6 s of rest after it. What the quasi-static prediction of
the optimiser misses is what its motion excites. A joint without elements, such as a slide whose
drive is not described, is where its motor is; the others then move by the rest of the mass matrix.

The dynamic deflection is the tool's distance from where it would hang at rest at the same motor
position, found by iteration, so that the sag's change with the pose is not counted as vibration.

The peak of the motion of minimum squared torque lies in its first interval, where the acceleration
leaves zero at once, and depends on the mesh; its rms is what agrees with the reference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from common import Row, deflection_problem, main
from standin import standin_robot

from stiffopt.exact.chain import exact_compliance, exact_windup
from stiffopt.problem.files import load_problem
from stiffopt.problem.objective import Objective
from stiffopt.problem.trajectory import Method
from stiffopt.result.assessment import Assessment
from stiffopt.robot.robot import Robot
from stiffopt.solver.solve import solve

TITLE = "Elastic simulation, UR10 with the stand-in stiffness and ER3A-C60"
STEP = 1e-4
REST = 0.6
DAMPING = 0.02
# Quasi-static peak, simulated peak and rms in flight, peak after arrival [mm].
REFERENCE = {
    "toppra stretched": (1.782, 3.497, 1.312, 2.657),
    "quintic": (2.381, 2.600, 1.345, 0.824),
    "minimum torque squared": (2.773, 5.073, 1.970, 2.055),
    "minimum peak dynamic deflection": (0.409, 0.669, 0.414, 0.280),
}


# The same of the ER3A's pick and place, by two simulations of others where they differ.
REFERENCE_ER3A = {
    "toppra": "0.296 / 0.49 to 0.55 / – / 0.37 to 0.41",
    "quintic": "0.359 / 0.374 / – / 0.03 to 0.04",
    "optimised": "0.136 / 0.255 / – / 0.12",
}
PICK_AND_PLACE = Path(__file__).parents[1] / "problems" / "er3a_pick_and_place.toml"


@dataclass(frozen=True)
class Simulated:
    """Peak and rms of the dynamic deflection in flight and its peak after arrival [m]."""

    peak: float
    rms: float
    residual: float
    time: np.ndarray
    deviation: np.ndarray


class Springs:
    """Torque of every joint's spring at a wind-up, on one uniform grid of wind-ups a joint.

    Joints without elements have none: they are `rigid`, (n,) of bool.
    """

    def __init__(self, robot: Robot, points: int = 40001, reach: float = 1.5) -> None:
        largest, tables = [], []
        share = np.linspace(-1.0, 1.0, points)
        for chain, torque_max in zip(robot.chains, robot.torque_max, strict=True):
            if chain is None or not chain.stages:
                largest.append(np.inf)
                tables.append(np.zeros(points))
                continue
            # Cubed, so that the steep beginning of the contacts is well covered.
            torque = reach * torque_max * np.linspace(-1.0, 1.0, 4001) ** 3
            windup = exact_windup(chain, torque)
            held = np.isfinite(windup)
            torque, windup = torque[held], windup[held]
            # Beyond the table, and where a flange slips, the spring goes on straight.
            slope = (windup[-1] - windup[-2]) / (torque[-1] - torque[-2])
            torque = np.concatenate([3.0 * torque[:1], torque, 3.0 * torque[-1:]])
            further = 2.0 * slope * torque[-2]
            windup = np.concatenate([windup[:1] - further, windup, windup[-1:] + further])
            largest.append(windup[-1])
            tables.append(np.interp(share * windup[-1], windup, torque))
        self.windup_max = np.array(largest)
        self.rigid = np.isinf(self.windup_max)
        self.table = np.array(tables)
        self._joint = np.arange(len(largest))
        self._half = (points - 1) / 2

    def torque(self, windup: np.ndarray) -> np.ndarray:
        """Spring torques (n,) [N m] at wind-ups (n,) [rad]."""
        place = self._half * (1.0 + windup / self.windup_max)
        index = place.astype(int)
        low = self.table[self._joint, index]
        return low + (place - index) * (self.table[self._joint, index + 1] - low)

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Wind-ups (n,) [rad] at torques (n,) [N m]; the inverse of `torque`."""
        share = np.linspace(-1.0, 1.0, self.table.shape[1])
        found = np.zeros(len(torque))
        for j in np.flatnonzero(~self.rigid):
            found[j] = np.interp(torque[j], self.table[j], share) * self.windup_max[j]
        return found

    def stiffness(self, torque: np.ndarray, robot: Robot) -> np.ndarray:
        """Tangent stiffness (n,) [N m/rad] at torques (n,); zero where there is no spring."""
        slopes = np.zeros(len(torque))
        for j in np.flatnonzero(~self.rigid):
            slopes[j] = 1.0 / exact_compliance(robot.chains[j], torque[j : j + 1])[0]
        return slopes


def simulate(
    robot: Robot,
    motion: Any,
    *,
    reference: Any = None,
    stiffness: np.ndarray | float = 1.0,
    payload: float = 1.0,
    damping: float = 1.0,
    rest: float = REST,
) -> Simulated:
    """Simulate one motion (callable motion(t, order) with attribute duration).

    The deviation is from where the tool hangs at the motor position of `reference`, which is the
    motion itself where left out. The others are factors on the arm's own values.
    """
    springs, nominal = Springs(robot), robot
    model = robot.with_payload_times(payload).model
    data = model.createData()
    reference = motion if reference is None else reference
    steps = round((motion.duration + rest) / STEP)
    # Motor position and speed at every half step, at rest after arrival.
    times = np.minimum(STEP / 2 * np.arange(2 * steps + 1), motion.duration)
    motor, speed, push = (motion(times, order) for order in range(3))
    arrived = STEP / 2 * np.arange(2 * steps + 1) > motion.duration
    speed[arrived] = push[arrived] = 0.0
    rigid, soft = np.flatnonzero(springs.rigid), np.flatnonzero(~springs.rigid)

    def hanging(at: np.ndarray) -> np.ndarray:
        """Link position at rest for a motor position."""
        q = at.copy()
        for _ in range(8):
            q = at - springs.windup(pin.computeGeneralizedGravity(model, data, q))
        return q

    # Damping is that of the nominal arm at rest.
    own = nominal.model.createData()
    at_rest = motor[0].copy()
    for _ in range(8):
        held = pin.computeGeneralizedGravity(nominal.model, own, at_rest)
        at_rest = motor[0] - springs.windup(held)
    inertia = np.diag(pin.crba(nominal.model, own, at_rest))
    tangent = springs.stiffness(held, nominal)
    friction = damping * 2.0 * DAMPING * np.sqrt(tangent * inertia)
    springs.table = springs.table * np.broadcast_to(stiffness, (robot.n,))[:, None]
    q = hanging(motor[0])
    v = np.zeros(robot.n)

    def acceleration(q: np.ndarray, v: np.ndarray, half: int) -> np.ndarray:
        torque = springs.torque(motor[half] - q) + friction * (speed[half] - v)
        if not rigid.size:
            return pin.aba(model, data, q, v, torque)
        q, v = held_to(motor[half], q), held_to(speed[half], v)
        upper = np.triu(pin.crba(model, data, q))
        mass = upper + np.triu(upper, 1).T
        found = held_to(push[half], np.zeros(robot.n))
        free = torque - pin.nonLinearEffects(model, data, q, v) - mass @ found
        found[soft] = np.linalg.solve(mass[np.ix_(soft, soft)], free[soft])
        return found

    def held_to(at: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values of the links, those of joints without springs as the motors have them."""
        values = values.copy()
        values[rigid] = at[rigid]
        return values

    def tool(q: np.ndarray) -> np.ndarray:
        pin.forwardKinematics(model, data, q)
        return data.oMi[robot.tool.joint].act(np.asarray(robot.tool.offset))

    every = 10
    instants = np.minimum(STEP * every * np.arange(steps // every + 1), reference.duration)
    wanted = reference(instants, 0)
    distance, at = [], []
    for k in range(steps):
        if k % every == 0:
            distance.append(np.linalg.norm(tool(q) - tool(hanging(wanted[k // every]))))
            at.append(k * STEP)
        h = STEP
        a1 = acceleration(q, v, 2 * k)
        v2 = v + h / 2 * a1
        a2 = acceleration(q + h / 2 * v, v2, 2 * k + 1)
        v3 = v + h / 2 * a2
        a3 = acceleration(q + h / 2 * v2, v3, 2 * k + 1)
        v4 = v + h * a3
        a4 = acceleration(q + h * v3, v4, 2 * k + 2)
        q = held_to(motor[2 * k + 2], q + h / 6 * (v + 2 * v2 + 2 * v3 + v4))
        v = held_to(speed[2 * k + 2], v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4))
    size, when = np.array(distance), np.array(at)
    flight = when <= motion.duration
    return Simulated(
        peak=float(size[flight].max()),
        rms=float(np.sqrt(np.mean(size[flight] ** 2))),
        residual=float(size[~flight].max()),
        time=when,
        deviation=size,
    )


class Sampled:
    """Motion of an assessment, cubic between its samples."""

    def __init__(self, assessment: Assessment) -> None:
        from scipy.interpolate import CubicHermiteSpline

        time, first = np.unique(assessment.time, return_index=True)
        self._spline = CubicHermiteSpline(
            time, assessment.position[first], assessment.velocity[first]
        )
        self.duration = float(time[-1])

    def __call__(self, t: np.ndarray, order: int) -> np.ndarray:
        return np.asarray(self._spline(t, order))


def motions(robot: Robot) -> dict[str, Assessment]:
    """Baselines and optimised motions of the same ends, duration and limits."""
    problem = deflection_problem(robot, Method(intervals=60))
    best = solve(problem, throw=False)
    torque = solve(replace(problem, objectives=(Objective(name="torque_squared"),)), throw=False)
    found = {
        "toppra stretched": best.baselines["toppra"].assessment,
        "quintic": best.baselines["quintic"].assessment,
        "minimum torque squared": torque.assessment,
        "minimum peak dynamic deflection": best.assessment,
    }
    return {name: motion for name, motion in found.items() if motion is not None}


def run() -> list[Row]:
    """Predicted against simulated, with the gains over the baselines."""
    return [*_ur10(), *_er3a()]


def _ur10() -> list[Row]:
    robot = standin_robot()
    rows, simulated = [], {}
    for name, assessment in motions(robot).items():
        predicted = 1e3 * assessment.deflection_summary()["dynamic"].peak
        outcome = simulated[name] = simulate(robot, Sampled(assessment))
        known = REFERENCE[name]
        numbers = (predicted, 1e3 * outcome.peak, 1e3 * outcome.rms, 1e3 * outcome.residual)
        rows.append(
            Row(
                f"{name}: predicted peak / simulated peak / rms / after arrival",
                " / ".join(f"{value:.3f}" for value in numbers) + " mm",
                " / ".join(f"{value:.3f}" for value in known) + " mm",
            )
        )
    best = simulated["minimum peak dynamic deflection"]
    for name in ("toppra stretched", "quintic"):
        rival, known = simulated[name], REFERENCE[name]
        ours = REFERENCE["minimum peak dynamic deflection"]
        rows.append(
            Row(
                f"simulated gain over {name}, in flight / after arrival",
                f"{rival.peak / best.peak:.2f} / {rival.residual / best.residual:.2f}",
                f"{known[1] / ours[1]:.2f} / {known[3] / ours[3]:.2f}",
                "above 1",
                bool(rival.peak > best.peak and rival.residual > best.residual),
            )
        )
    return rows


def _er3a() -> list[Row]:
    """The shipped pick and place, beside what the package simulates of it."""
    problem = load_problem(PICK_AND_PLACE).problem
    best = solve(problem, simulate=True)
    assert best.simulation is not None
    motions = {name: b.assessment for name, b in best.baselines.items()}
    own = {motion.name: motion.simulated for motion in best.simulation.motions}
    rows = []
    for name, assessment in {**motions, "optimised": best.assessment}.items():
        assert assessment is not None
        predicted = 1e3 * assessment.deflection_summary()["dynamic"].peak
        outcome = simulate(problem.robot, Sampled(assessment))
        numbers = (outcome.peak, outcome.rms, outcome.residual)
        shown = " / ".join(f"{1e3 * value:.3f}" for value in numbers)
        rows.append(
            Row(
                f"ER3A {name}: predicted peak / simulated peak / rms / after arrival",
                f"{predicted:.3f} / {shown} mm",
                f"{REFERENCE_ER3A[name]} mm",
            )
        )
        found = (own[name].peak, own[name].rms, own[name].peak_after or 0.0)
        off = max(abs(ours / value - 1.0) for ours, value in zip(found, numbers, strict=True))
        rows.append(
            Row(
                f"ER3A {name}: the same by `stiffopt solve`, simulated",
                " / ".join(f"{1e3 * value:.3f}" for value in found) + " mm",
                f"{shown} mm",
                "within 1 %",
                bool(off < 0.01),
            )
        )
    return rows


if __name__ == "__main__":
    main(TITLE, run)
