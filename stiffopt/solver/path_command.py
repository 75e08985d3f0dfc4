"""Timing of a path whose motors lead the links within their limits.

The lead depends on higher derivatives of the motion than any limit of its timing. Limits are backed
off about the instants at which the command exceeds them, until it keeps them.
"""

from __future__ import annotations

import numpy as np

from stiffopt.certificate.assess import drive_history
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command.command_search import CommandOnArms
from stiffopt.command.compensation import commands_on_arms
from stiffopt.command.simulated_solution import COMMAND_INTERRUPTED, progress_on_arms
from stiffopt.command.simulation import PlannedMotion, elastic_arm
from stiffopt.command.smoothing_width import KNOT_SPACINGS
from stiffopt.errors import NotSimulatedError
from stiffopt.interrupts import end_deferral, until_interrupted
from stiffopt.path.limit_shares import LimitShares
from stiffopt.path.timed_path import AVERAGING_WINDOWS, timed_path
from stiffopt.result.solution import Baseline
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.solve_run import SolveRun

# Back-offs: each costs a timing and a search of a command.
_MAX_BACK_OFFS = 2
# Time on either side of an excess within which the law changes it [s]: the window of its average
# and two knots of the widest spline that smooths the motion.
_BACK_OFF_REACH = AVERAGING_WINDOWS[0] + 2.0 * KNOT_SPACINGS[-1]


def led_timing(run: SolveRun) -> Baseline | None:
    """Return the fastest motion on the path, or one that the motors can lead if asked for.

    The fastest one where no back-off helps: its report says which limit the command exceeds. After
    Ctrl-C the last one so far, without a command.
    """
    run.tell("timing of the path")
    fastest = timed_path(run.problem)
    if fastest is None or not run.problem.leads_on_path:
        return None if fastest is None else fastest[0]
    timings = [fastest]

    def last_timing() -> Baseline:
        run.notes.append(COMMAND_INTERRUPTED)
        run.interrupted = True
        return timings[-1][0]

    return until_interrupted(lambda: _timing_with_command(run, timings), last_timing)


def _timing_with_command(run: SolveRun, timings: list[tuple[Baseline, Trajectory]]) -> Baseline:
    """Return a timing whose command keeps all limits, else the fastest; `timings` are tried."""
    end_deferral()
    problem, shares = run.problem, LimitShares(_BACK_OFF_REACH)
    for number in range(_MAX_BACK_OFFS + 1):
        timed, law = timings[-1]
        command = _command(run, timed)
        if command is None:
            break
        if not command.excess:
            run.command = command
            if number:
                run.notes.append(
                    "The path is timed with room for the lead of the motors, which exceeded a "
                    f"limit on the fastest timing: {law.duration:.4g} s."
                )
            return timed
        if number == _MAX_BACK_OFFS:
            break
        assert timed.assessment is not None
        histories = [timed.assessment, drive_history(problem, command.motors)[0]]
        shares.back_off([(0.0, law)], problem.active_limits, histories, command.excess)
        run.tell("timing of the path with room for the lead")
        found = timed_path(problem, shares)
        if found is None:
            break
        timings.append(found)
    return timings[0][0]


def _command(run: SolveRun, timed: Baseline) -> CommandOnArms | None:
    """Return the command of a timed motion; None for an arm that cannot be simulated."""
    assessment, motion = timed.assessment, timed.trajectory
    assert assessment is not None
    assert motion is not None
    counted = assessment.feasible(CERTIFICATE_TOLERANCE)
    try:
        arm = elastic_arm(run.problem, assessment.position[0]).under(motion.force)
    except NotSimulatedError:
        return None
    planned = PlannedMotion.of_solution(assessment, motion, counted)
    tell = progress_on_arms(run.progress, timed.objective or np.nan)
    return commands_on_arms(run.problem, arm, [planned], progress=tell)[0]
