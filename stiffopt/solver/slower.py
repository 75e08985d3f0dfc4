"""Where no motion was found in the time that is given: how long one takes that keeps every limit.

What a limit is exceeded by falls with the second or third power of the time, at a corner of the
motors' law faster still, so that little more time often does.
"""

from __future__ import annotations

import math

from stiffopt.baseline.baselines import slowed_quintic
from stiffopt.certificate.assess import assess, drive_violations
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.problem.motor_model import LAW_SMOOTHING_FACTOR
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stages import Outcome

# Times the duration that are tried.
_SLOWER = (1.01, 1.02, 1.04, 1.06, 1.08, 1.12, 1.16, 1.24, 1.32, 1.5)
# Times a duration that is just possible: a solve needs room for its corrections.
_ROOM = 1.03


def slower_advice(run: SolveRun, outcome: Outcome) -> str:
    """Sentence on a duration in which a motion keeps every limit, tried; "" where none is known.

    Of links planned in a fixed time from rest to rest.
    """
    shortest, longest = run.problem.duration
    if run.lag is None or shortest < longest:
        return ""
    tried = {"the same": _slowed(run, outcome), "the quintic": _quintic(run)}
    known = {name: each for name, each in tried.items() if each is not None}
    if not known:
        return ""
    name, duration = min(known.items(), key=lambda each: each[1])
    # Rounded up: what is named must be possible.
    step = 10.0 ** (math.floor(math.log10(duration)) - 2)
    kept, roomy = (
        f"{math.ceil(each / step) * step:.6g} s" for each in (duration, _ROOM * duration)
    )
    return (
        f"In {kept} {name} motion keeps every limit: "
        f'motion.duration = "{roomy}" leaves the solver a little room.'
    )


def _slowed(run: SolveRun, outcome: Outcome) -> float | None:
    """Duration [s] in which the links of an outcome, with motors of their own, keep every limit."""
    problem, link = run.problem, outcome.trajectory.link
    if link is None:
        return None
    for times in _SLOWER:
        slow = link.scaled_to(times * link.duration)
        motors = run.motors.motion(slow, LAW_SMOOTHING_FACTOR * outcome.smoothing.law, run.lag)
        if drive_violations(problem, motors)[0].value > CERTIFIED:
            continue
        if with_collisions(problem, assess(problem, motors)).feasible(CERTIFIED):
            return motors.duration
    return None


def _quintic(run: SolveRun) -> float | None:
    slowed = slowed_quintic(run.problem, run.motion)
    return None if slowed is None else slowed.duration
