"""Tool error of the commanded arm against that of the best compensated rival, servo included.

The default objective on both shipped problems, on the ER3A-C60 with rough contacts, and on random
motions of the ER3A-C60 and the UR10. Motion and rivals have their best commands within the limits;
each is put on its own worst arms in flight and after arrival by the Runge-Kutta simulation of
`elastic_simulation`, behind a servo that is integrated here. Neither shares springs or integrator
with the package.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import Row, main
from elastic_simulation import simulate

from stiffopt.command.command_search import CommandOnArms
from stiffopt.command.compensation import commands_on_arms, compensate, rival_commands
from stiffopt.command.simulation import PlannedMotion, elastic_arm, rival_motions
from stiffopt.elastic.servo import Servo
from stiffopt.problem.files import load_problem
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import Method, Target, TrajectoryProblem
from stiffopt.robot.files import load_robot
from stiffopt.solver.solve import solve

TITLE = "Tool error of the commanded arm against the best compensated rival"
FOLDER = Path(__file__).parents[1] / "problems"
SEED, RANDOM_MOTIONS = 23, 2
MIDDLE = {
    "ur10": ([0.0, -1.2, 1.4, -1.7, -1.5, 0.0], 1.2),
    "er3a_c60": ([0.0, 0.3, -0.3, 0.0, -0.9, 0.0], 0.6),
    "er3a_c60_contact": ([0.0, 0.3, -0.3, 0.0, -0.9, 0.0], 0.6),
}
# Error over the best rival's up to which a motion is no worse.
NO_WORSE = 1.02
SERVO_STEP, REST, STANDSTILL = 2.5e-4, 0.2, 0.02  # [s]


class Motors:
    """Motors behind servos of which one is mixed with the other, sampled every quarter of 1 ms."""

    def __init__(self, command: Any, servos: tuple[Servo, Servo], share: float) -> None:
        self._command = command
        self.duration = float(command.duration) + REST
        self.times = SERVO_STEP * np.arange(int(np.ceil(self.duration / SERVO_STEP)) + 1)
        first, second = (self._followed(servo) for servo in servos)
        self._states = (1.0 - share) * first + share * second

    def __call__(self, t: np.ndarray, order: int) -> np.ndarray:
        if order == 2:
            values = np.gradient(self._states[:, 1], SERVO_STEP, axis=0)
        else:
            values = self._states[:, order]
        columns = [np.interp(t, self.times, column) for column in values.T]
        return np.stack(columns, axis=-1)

    def _followed(self, servo: Servo) -> np.ndarray:
        """States (K, 2, n) by the midpoint rule; set-points are continuous and sent ahead."""
        gain = 2.0 * np.pi * (servo.bandwidth or 0.0)
        inner, led = 5.0 * gain, (servo.feed_forward, servo.torque_feed_forward)
        half = 0.5 * SERVO_STEP * np.arange(2 * len(self.times) - 1)
        until = self._command.duration
        y = np.array([self._command(np.minimum(half, until), k) for k in range(3)])
        y[1:, half > until] = 0.0

        def bend(state: np.ndarray, k: int) -> np.ndarray:
            x, v = state
            place, speed, push = y[:, k]
            return np.stack([v, inner * (led[0] * speed + gain * (place - x) - v) + led[1] * push])

        state, found = np.stack([y[0, 0], 0.0 * y[0, 0]]), []
        for k in range(len(self.times)):
            found.append(state)
            if k + 1 < len(self.times):
                middle = state + 0.5 * SERVO_STEP * bend(state, 2 * k)
                state = state + SERVO_STEP * bend(middle, 2 * k + 1)
        return np.array(found)


class Held:
    """A planned motion held until the motors rest."""

    def __init__(self, motion: Any, duration: float) -> None:
        self._motion, self.duration = motion, duration

    def __call__(self, t: np.ndarray, order: int) -> np.ndarray:
        values = np.array(self._motion(np.minimum(t, self._motion.duration), order))
        if order:
            values[np.asarray(t) > self._motion.duration] = 0.0
        return values


def problems() -> Iterator[tuple[str, TrajectoryProblem]]:
    """Names and problems with the default objective."""
    for name in ("er3a_tool_deviation", "ur10_tool_deviation"):
        yield name, replace(load_problem(FOLDER / f"{name}.toml").problem, objectives=())
    random = np.random.default_rng(SEED)
    for name, (middle, duration) in MIDDLE.items():
        robot = load_robot(name)
        low, high = robot.position_lower + 0.05, robot.position_upper - 0.05
        for number in range(1, RANDOM_MOTIONS + 1):
            ends = [np.clip(middle + random.uniform(-0.5, 0.5, 6), low, high) for _ in range(2)]
            yield (
                f"{name}, random motion {number}",
                TrajectoryProblem(
                    robot=robot.with_payload(1.0, (0.0, 0.0, 0.05), (1e-3, 1e-3, 1e-3)),
                    start=Target(joints=ends[0]),
                    end=Target(joints=ends[1]),
                    duration=(duration, duration),
                    method=Method(collisions="check"),
                ),
            )


def worst_errors(problem: TrajectoryProblem, found: CommandOnArms) -> np.ndarray:
    """Peaks [m] in flight and after arrival, each on the package's worst arm for it."""
    servos = problem.servo, problem.uncertainty.worst_servo(problem.servo)
    peaks = []
    for phase in ("flight", "after"):
        arm = getattr(found.compensated, phase).worst_arm
        motors = Motors(found.motors, servos, arm["servo"])
        plan = Held(found.motion.planned_path, motors.duration)
        one = simulate(
            problem.robot,
            motors,
            reference=plan,
            stiffness=np.array(arm["stiffness"]),
            payload=arm["payload"],
            damping=arm["damping"],
            rest=STANDSTILL,
        )
        away = one.deviation
        arrived = one.time >= found.motion.time[-1]
        peaks.append(away[~arrived].max() if phase == "flight" else away[arrived].max())
    return np.array(peaks)


def judge(
    name: str,
    problem: TrajectoryProblem,
    errors: Callable[[TrajectoryProblem, CommandOnArms], np.ndarray] = worst_errors,
) -> list[Row]:
    """Rows of one problem; `errors` simulates a command on its worst arms."""
    begin = time.process_time()
    solution, motion = solve(problem, throw=False), resolve(problem)
    took = time.process_time() - begin
    if solution.assessment is None or solution.trajectory is None:
        return [Row(name, f"no motion: {solution.status}")]
    arm = elastic_arm(problem, motion.start)
    own = PlannedMotion.of_solution(solution.assessment, solution.trajectory)
    motions = [own, *rival_motions(problem, motion, solution.assessment.duration)]
    (ours,) = commands_on_arms(problem, arm, [own])
    rivals = rival_commands(problem, arm, motions[1:], ours.law)
    led = compensate(problem, arm, motions, known=ours, rivals=rivals)
    beside = led.beside_best
    mine = 1e6 * errors(problem, ours)
    text = f"{mine[0]:.0f} / {mine[1]:.0f} um"
    predicted = 1e6 * ours.compensated.flight.worst, 1e6 * ours.compensated.after.worst
    status = f"{solution.status}, {took:.1f} s" + (", command exceeds" if ours.excess else "")
    status += f", as predicted {predicted[0]:.0f} / {predicted[1]:.0f}"
    if beside is None:
        return [Row(name, text, f"no rival's command keeps the limits; {status}")]
    best = next(each for each in rivals if each.motion.name == beside.rival.name)
    theirs = 1e6 * errors(problem, best)
    rival = f"{best.motion.name} of {best.motion.duration:.3f} s {theirs[0]:.0f} / {theirs[1]:.0f}"
    if beside.own is not led.optimised:
        # At the duration of a slower rival.
        (slowed,) = rival_commands(problem, arm, [own.slowed_to(problem, best.motion.duration)])
        mine = 1e6 * errors(problem, slowed)
        text += f", slowed to {slowed.motion.duration:.3f} s {mine[0]:.0f} / {mine[1]:.0f} um"
    ratio = mine / theirs
    return [
        Row(name, text, f"{rival} um; {status}"),
        Row(
            f"{name}: over the rival",
            f"{ratio[0]:.2f} / {ratio[1]:.2f}",
            "",
            f"at most {NO_WORSE}",
            bool(np.all(ratio <= NO_WORSE)),
        ),
    ]


def run() -> list[Row]:
    """Problems whose names contain a word of the command line, else all."""
    rows = []
    for name, problem in problems():
        if not sys.argv[1:] or any(word in name for word in sys.argv[1:]):
            rows += judge(name, problem)
            print(*rows[-2:], sep="\n", file=sys.stderr, flush=True)
    return rows


if __name__ == "__main__":
    main(TITLE, run)
