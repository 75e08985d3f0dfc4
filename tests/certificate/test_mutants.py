"""Defects put into the optimiser's model alone, one at a time: the certificate notices them."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from small_arms import (
    JOINTS,
    joint,
    load,
    on_one_element,
    reducer,
    small_flange,
    write_problem,
    write_robot,
)

from stiffopt import SolveStatus, solve
from stiffopt.connection import BoltedFlange, Key, Reducer
from stiffopt.contact import surrogate
from stiffopt.contact.fractal import FractalLaw
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Stage
from stiffopt.dynamics import deflection, newton_euler
from stiffopt.problem import stage_model
from stiffopt.problem.files import load_problem
from stiffopt.problem.limit import LIMITS
from stiffopt.result.solution import Baseline

# The package has a function of the same name as this module.
solving = importlib.import_module("stiffopt.solver.solve")
DEFLECTION = 'objective = "dynamic_deflection"'


# ---- problems, each small and loaded where its mutants bite


def swinging_arm(folder):
    """A vertical axis and two that gravity loads, with heavy rotors, moved fast."""
    rotor = "rotor_inertia = 0.05\ntorque_max"
    joints = [text.replace("torque_max", rotor) for text in JOINTS["spatial"]]
    path = write_problem(folder, "spatial", duration="0.4")
    write_robot(folder, "spatial", joints)
    return load_problem(path).problem


def pendulum(folder, **pieces):
    """One link of 4 N m of weight, with a reducer whose first corner it passes."""
    path = write_problem(folder, "pendulum", **({"minimise": DEFLECTION} | pieces))
    write_robot(folder, "pendulum", [joint("shoulder", reducer(k1=4e3, k2=8e3, t1=2.5, t2=20.0))])
    return load_problem(path).problem


def hurried(folder):
    """Torque-limited minimum duration; with free end accelerations toppra has no finer ramp."""
    return pendulum(
        folder,
        motion='boundary_acceleration = "free"',
        duration="{ lower = 0.1, upper = 2.0 }",
        minimise='objective = "duration"',
        limits="torque = [9.0]",
    )


def capped(folder):
    """Minimum duration limited by the dynamic deflection."""
    return pendulum(
        folder,
        duration="{ lower = 0.1, upper = 2.0 }",
        minimise='objective = "duration"',
        limits='dynamic_deflection = "0.2 mm"',
    )


def keyed(folder, **changes):
    """The pendulum on a key alone, in front of a gear of 2."""
    numbers = {
        "name": "key",
        "torque_max": 30.0,
        "shaft_diameter": 14e-3,
        "length": 10e-3,
        "shaft_flank_height": 2.5e-3,
        "hub_flank_height": 2.0e-3,
        "surface": catalogue.surface("rough_steel"),
        "prepressure": 1e6,
    }
    problem = load(folder, "pendulum", minimise=DEFLECTION)
    return on_one_element(problem, Key(**(numbers | changes)), ratio=2.0)


def flanged(folder):
    """The pendulum on a bolted flange alone, loaded to four fifths of its slip torque."""
    problem = load(folder, "pendulum", minimise=DEFLECTION)
    return on_one_element(problem, small_flange(560.0))


# ---- mutants


def scaled_stiffness(name):
    def mutate(patch):
        sound = Reducer.windup

        def windup(self, *given, **named):
            return sound(replace(self, **{name: 0.8 * getattr(self, name)}), *given, **named)

        patch.setattr(Reducer, "windup", windup)

    return mutate


def no_coriolis(patch):
    sound = deflection.newton_euler

    def without_speed(tree, q, v, a):
        return sound(tree, q, np.zeros(q.shape[0]), a)

    patch.setattr(deflection, "newton_euler", without_speed)


def no_gyroscopic(patch):
    sound = newton_euler._outward_recursion

    def outward(gravity, joints, poses, v, a):
        forces, moments = sound(gravity, joints, poses, v, a)
        spins = [ca.SX.zeros(3)]
        for i, (own, (rotation, _)) in enumerate(zip(joints, poses, strict=True)):
            spin = ca.mtimes(rotation.T, spins[own.parent]) + ca.vertcat(0, 0, v[i])
            spins.append(spin)
            moments[i] -= ca.cross(spin, ca.mtimes(own.inertia, spin))
        return forces, moments

    patch.setattr(newton_euler, "_outward_recursion", outward)


def gravity_turned(patch):
    sound = newton_euler._outward_recursion
    patch.setattr(newton_euler, "_outward_recursion", lambda gravity, *rest: sound(-gravity, *rest))


def lighter_rotors(patch):
    sound = stage_model.drive_torque

    def drive_torque(*given, rotor_inertia, **named):
        return sound(*given, rotor_inertia=0.8 * np.asarray(rotor_inertia), **named)

    patch.setattr(stage_model, "drive_torque", drive_torque)


def shorter_tool(patch):
    sound = stage_model.frame_jacobian

    def frame_jacobian(tree, frame, q):
        return sound(tree, replace(frame, offset=0.9 * frame.offset), q)

    patch.setattr(stage_model, "frame_jacobian", frame_jacobian)


def static_left_in(patch):
    sound = stage_model.tool_deflection

    def tool_deflection(*given):
        parts = sound(*given)
        return replace(parts, dynamic=parts.dynamic + parts.static)

    patch.setattr(stage_model, "tool_deflection", tool_deflection)


def no_reflection(patch):
    patch.setattr(Stage, "windup_factor", property(lambda stage: stage.reduction))


def smaller_key(patch):
    sound = Key.areas.fget
    patch.setattr(Key, "areas", property(lambda key: tuple(0.8 * area for area in sound(key))))


def other_spots(patch):
    class Mutated(FractalLaw):
        @property
        def spots(self):
            own = FractalLaw(self.surface).spots
            return tuple(replace(s, stiffness_exponent=s.stiffness_exponent + 0.02) for s in own)

    patch.setattr(surrogate, "FractalLaw", Mutated)


def early_slip(patch):
    sound = BoltedFlange.slip_torque
    patch.setattr(BoltedFlange, "slip_torque", lambda *given: 0.8 * sound(*given))


def dropped_rows(name):
    return lambda patch: patch.setattr(LIMITS[name], "rows", lambda *given: [])


@dataclass(frozen=True)
class Mutant:
    """A defect, the problem that is solved with it, and the quantity that the message names."""

    mutate: Callable
    problem: Callable
    named: str


MUTANTS = {
    "K1": Mutant(scaled_stiffness("K1"), pendulum, "wind-up of joint 1"),
    "K2": Mutant(scaled_stiffness("K2"), pendulum, "wind-up of joint 1"),
    "Coriolis": Mutant(no_coriolis, swinging_arm, "spring torque of joint"),
    "gyroscopic": Mutant(no_gyroscopic, swinging_arm, "spring torque of joint"),
    "gravity sign": Mutant(gravity_turned, swinging_arm, "spring torque of joint"),
    "rotor inertia": Mutant(lighter_rotors, swinging_arm, "drive torque of joint"),
    "tool offset": Mutant(shorter_tool, pendulum, "deflection"),
    "reflection": Mutant(no_reflection, keyed, "wind-up of joint 1"),
    "key area": Mutant(smaller_key, keyed, "wind-up of joint 1"),
    "spot exponent": Mutant(other_spots, keyed, "wind-up of joint 1"),
    "slip torque": Mutant(early_slip, flanged, "wind-up of joint 1"),
    "static part": Mutant(static_left_in, pendulum, "dynamic deflection"),
    "torque row": Mutant(dropped_rows("torque"), hurried, "No correction kept torque"),
    "deflection cap": Mutant(
        dropped_rows("dynamic_deflection"), capped, "exceeds dynamic deflection"
    ),
}


@pytest.fixture(autouse=True)
def _own_models():
    """Fits of contact laws and dynamics are kept: a mutant must neither find nor leave any."""
    kept = (surrogate.fit_log_cubic, newton_euler._cached_recursion)
    for each in kept:
        each.cache_clear()
    yield
    for each in kept:
        each.cache_clear()


@pytest.mark.parametrize("name", MUTANTS)
def test_the_certificate_notices_a_defect_of_the_optimiser(name, tmp_path, monkeypatch):
    mutant = MUTANTS[name]
    problem = mutant.problem(tmp_path)
    mutant.mutate(monkeypatch)
    solution = solve(problem, throw=False)
    # A motion of free duration is slowed until the exceeded limit holds; that is no optimum.
    slowed = "the motion is slowed" in solution.message
    assert solution.status is (SolveStatus.ACCEPTABLE if slowed else SolveStatus.CERTIFICATE_FAILED)
    assert mutant.named in solution.message


@pytest.mark.parametrize(
    "problem", [swinging_arm, pendulum, hurried, capped, keyed, flanged], ids=lambda p: p.__name__
)
def test_sound_optimiser_passes(problem, tmp_path):
    solution = solve(problem(tmp_path), throw=False)
    assert solution.status is SolveStatus.OPTIMAL, solution.message


def test_contact_law_changes_the_optimiser_model(tmp_path):
    """The two fits wind up differently; their errors against the exact law are reported."""
    torque = np.linspace(0.5, 6.0, 40)
    near, far = (keyed(tmp_path, contact_law=law) for law in ("log_cubic", "power_law"))
    models = [stage_model.CompactChain(p.robot.chains[0], 60.0) for p in (near, far)]
    cubic, power = (model.windup(torque) for model in models)
    assert np.max(np.abs(power / cubic - 1.0)) > 0.02
    solution = solve(far, throw=False)
    assert solution.status is SolveStatus.ACCEPTABLE
    assert "wind-up of joint 1" in solution.message
    assert "log_cubic" in solution.message


def test_better_baseline_prevents_status_optimal(tmp_path, monkeypatch):
    """A coarse motion beside a fine one that keeps all limits is not called optimal."""
    fine = solve(pendulum(tmp_path))
    rival = Baseline(
        name="toppra",
        assessment=fine.assessment,
        objective=fine.objective.value,
        feasible=True,
        reason="",
    )
    sound = solving.baselines
    monkeypatch.setattr(solving, "baselines", lambda *given: sound(*given) | {"toppra": rival})
    coarse = solve(pendulum(tmp_path, method="intervals = 4"))
    assert coarse.objective.value > 1.01 * fine.objective.value
    assert coarse.status is SolveStatus.ACCEPTABLE
    assert "toppra motion has a better objective" in coarse.message
