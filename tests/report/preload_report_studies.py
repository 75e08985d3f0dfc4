"""Preload studies of the packaged ER3A for tests of pages and figures."""

import functools
from dataclasses import replace

import numpy as np

from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.motion_study import MotionRound, MotionStudy, describe_gain
from stiffopt.preload.problem import Choice, PreloadProblem, Requirements
from stiffopt.preload.study import preload_study
from stiffopt.result.status import SolveStatus
from stiffopt.robot.files import load_robot

__all__ = ["cannot", "case", "flange", "run", "several", "stiff", "with_motion"]

ROBOT = load_robot("er3a_c60")


def case(name, *shares):
    return LoadCase(name=name, torque=np.array(shares) * ROBOT.torque_max)


def run(front_points=4, **fields):
    fields = {"robot": ROBOT, "tightening": Tightening(scatter=1.6, embedding=3e-6)} | fields
    return preload_study(PreloadProblem(**fields), front_points=front_points)


def open_flange():
    """The arm with a flexspline flange at joint 2 that has no bearing beside it."""
    chain = ROBOT.chains[1]
    stages = tuple(
        replace(s, element=replace(s.element, bearing="none"))
        if s.element.name == "flexspline_flange"
        else s
        for s in chain.stages
    )
    chains = (ROBOT.chains[0], replace(chain, stages=stages), *ROBOT.chains[2:])
    return replace(ROBOT, chains=chains)


@functools.cache
def flange(**fields):
    """One flange, set by slip, chosen from a catalogue."""
    return run(
        joints=(2,),
        free=("flexspline_flange",),
        load_cases=(case("peak torque", 0, 1, 0, 0, 0, 0), case("hold", 0, 0.5, 0, 0, 0, 0)),
        choose=Choice(sizes=("M4", "M5"), grades=("12.9",), counts=(8, 9), redrill=True),
        **{"title": "Flange of J2", **fields},
    )


@functools.cache
def stiff():
    """Set by stiffness: a little more than slip leaves."""
    one = {
        "joints": (2,),
        "free": ("flexspline_flange",),
        "load_cases": (case("hold", 0, 0.6, 0, 0, 0, 0),),
        "front_points": 0,
    }
    least = float(run(**one).solution.stiffness.min())
    return run(requirements=Requirements(joint_stiffness={2: 1.001 * least}), **one)


@functools.cache
def cannot():
    """Cannot be met: slip."""
    return run(joints=(2,), load_cases=(case("overload", 0, 1.5, 0, 0, 0, 0),))


@functools.cache
def several():
    """Bolts and pins of two joints."""
    peak = case("peak torque", *[0.9] * 6)
    free = ("flexspline_flange", "pulley_pins")
    return run(joints=(2, 3), free=free, load_cases=(peak,), front_points=0)


def with_motion(study, gain):
    """The study with a joint study of this gain."""
    separate = 2e-4
    joint = separate * (1 - gain)
    motion = MotionStudy(
        status=SolveStatus.OPTIMAL,
        objective_name="dynamic_deflection",
        start=2.1e-4,
        separate=separate,
        joint=joint,
        gain=gain,
        rounds=(
            MotionRound(
                deflection_before_preload=1.05 * joint,
                deflection_after=joint,
                preloads=study.solution.preloads,
            ),
        ),
        start_preloads=study.solution.preloads,
        separate_preloads=study.solution.preloads,
        preloads=study.solution.preloads,
        trajectory=None,
        separate_trajectory=None,
        preload_solution=None,
        note=describe_gain(SolveStatus.OPTIMAL, gain),
        seconds=1.0,
    )
    return replace(study, motion=motion)
