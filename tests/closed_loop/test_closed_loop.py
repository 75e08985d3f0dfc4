"""Simulation from commands: against another integrator, and its derivatives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from servo_sets import (
    ARMATURE,
    COULOMB,
    DELAY,
    GRAVITY,
    INERTIA,
    KP,
    LEVER,
    MASS,
    STEP,
    URDF,
    VISCOUS,
    commanded_motion,
)

from stiffopt.actuator.law import ActuatorLaw
from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.dry_friction import mean_friction
from stiffopt.closed_loop.least_squares import LoopFit, SimulatedPoint
from stiffopt.closed_loop.parameters import Parameters, zero_parameters
from stiffopt.closed_loop.physics import Amplitudes, LoopPhysics, LoopSpring
from stiffopt.closed_loop.polish import polish, score_amplitudes
from stiffopt.closed_loop.simulation import (
    CommandedRun,
    Stretch,
    moving_rows,
    simulate,
    simulate_stretches,
)
from stiffopt.robot.files import load_robot

LIMIT = 1.4  # [N m]


@pytest.fixture(name="loop")
def pendulum_loop(tmp_path: Path) -> CommandedArm:
    """Pendulum on a servo of the true gain."""
    (tmp_path / "robot.urdf").write_text(URDF, encoding="utf-8")
    robot = load_robot(str(tmp_path / "robot.urdf")).with_gravity((0.0, 0.0, -9.81))
    law = ActuatorLaw(
        stiffness=np.array([KP]),
        damping=np.zeros(1),
        drive_max=np.array([np.inf]),
        torque_max=np.array([8.0]),
        delay=DELAY,
        integral=np.zeros(1),
        tolerance=np.full(1, 0.05),
    )
    return CommandedArm(robot.tree, law, np.zeros(1))


def recorded(seed: int, seconds: float = 8.0, limit: float = np.inf) -> CommandedRun:
    """Run of the pendulum."""
    time, command, position = commanded_motion(seed, seconds, limit=limit)
    velocity = np.gradient(position, time)
    return CommandedRun("run", time, *(x[:, None] for x in (command, position, velocity)))


def true_parameters() -> Parameters:
    """Parameters that the recorded runs were made with."""
    found = zero_parameters(("servo",))
    for name, value in (("armature", ARMATURE), ("viscous", VISCOUS), ("coulomb", COULOMB)):
        found.values[found.place(name)] = value
    found.values[-1] = DELAY
    return found


def test_simulation_follows_another_integrator(loop: CommandedArm) -> None:
    run = recorded(5)
    error = simulate(loop, run, true_parameters()) - run.position
    # Noise is 0.02 mrad.
    assert float(np.sqrt(np.mean(error**2))) < 5e-5
    assert float(np.ptp(run.position)) > 1.0


def test_a_joint_that_friction_holds_does_not_creep(loop: CommandedArm) -> None:
    """Friction of a light joint stops it within a step from 2 rad/s: no speed is small beside."""
    held = true_parameters()
    held.values[held.place("coulomb")] = 40.0
    run = recorded(5, 4.0)
    still = replace(run, position=np.full_like(run.position, 0.3), velocity=0.0 * run.velocity)
    whole = Stretch(still, 0, len(run.time) - 1, np.zeros(1))
    (found,) = simulate_stretches(loop, [whole], held, np.arange(2))
    np.testing.assert_allclose(found.position, 0.3, atol=1e-9)
    np.testing.assert_allclose(found.slopes, 0.0, atol=1e-4)


def test_friction_that_falls_along_the_stroke_never_drives(loop: CommandedArm) -> None:
    """Beyond the end of its slope there is none: a level below zero would push a joint along."""
    without, sloped = true_parameters(), true_parameters()
    for own in (without, sloped):
        own.values[own.place("coulomb")] = 0.0
    sloped.values[sloped.place("friction_slope")] = -0.5
    run = recorded(5, 4.0)
    run = replace(run, position=np.abs(run.position) + 0.2, command=np.abs(run.command) + 0.5)
    found = [simulate(loop, run, own) for own in (without, sloped)]
    assert min(each.min() for each in found) > 0.0
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    # A fit begins with none: its slope there is that beside none.
    free, whole = np.array([without.place("coulomb").start]), Stretch(run, 0, 100, np.ones(1))
    slopes = []
    for level in (0.0, 1e-9):
        without.values[without.place("coulomb")] = level
        slopes.append(simulate_stretches(loop, [whole], without, free)[0].slopes[:, 0, 0])
    assert np.abs(slopes[0]).max() > 0.0
    np.testing.assert_allclose(*slopes, rtol=1e-6, atol=1e-9)


def test_a_fit_reads_the_motion_of_every_joint_not_the_rest_before_it() -> None:
    """Two joints that rest at first, and then move in turn, one of them a tenth as long."""
    time = np.arange(0.0, 120.0, 0.02)
    spans = ((30.0, 90.0), (100.0, 106.0))
    position = np.column_stack(
        [np.sin(2.0 * time) * ((time > begin) & (time < end)) for begin, end in spans]
    )
    run = CommandedRun("turns", time, position, position, position)
    parts = moving_rows([run, run], 0.02, 20.0)
    rows = [time[part.first : part.end] for part in parts]
    for begin, end in spans:
        inside = [(own > begin) & (own < end) for own in rows]
        assert sum(own.sum() for own in inside) * 0.02 > 4.0
    moving = sum(((own > 30.0) & (own < 106.0)).sum() for own in rows)
    assert moving > 0.9 * sum(map(len, rows))
    assert 20.0 <= 0.02 * sum(map(len, rows)) <= 22.0
    (whole,) = moving_rows([replace(run, time=time[:500])], 0.02, 20.0)
    assert (whole.first, whole.end) == (25, 500)


def test_friction_holds_within_its_levels_and_opposes_what_moves() -> None:
    """From rest: no motion within the levels, and the whole level against motion."""
    n, rng = 4, np.random.default_rng(0)
    symbols = [ca.SX.sym(name, n) for name in ("before", "free", "forth", "back")]
    mobility = ca.SX.sym("mobility", n, n)
    found = mean_friction(*symbols[:2], mobility, (symbols[2], symbols[3]), ca.SX.zeros(n))
    solve_friction = ca.Function("friction", [*symbols, mobility], [found])
    kept = 0
    for _ in range(100):
        lever = np.tril(rng.uniform(0.5, 1.5, (n, n)))
        mass = lever.T @ lever
        moves = np.linalg.inv(mass + np.diag(np.diag(mass)))
        forth, back = rng.uniform(0.2, 1.0, (2, n))
        force = 1.5 * rng.uniform(-back, forth)
        own = np.asarray(solve_friction(0, moves @ force, forth, back, moves))[:, 0]
        after = moves @ (force - own)
        assert (own <= forth + 1e-9).all()
        assert (own >= -back - 1e-9).all()
        wanted = np.where(after > 0.0, forth, -back)
        moved = np.abs(after) > 0.02 * np.abs(moves @ force).max()
        np.testing.assert_allclose(own[moved], wanted[moved], atol=0.02)
        kept += int((~moved).sum())
    assert 100 < kept < 300


def test_friction_that_creeps_goes_with_the_speed() -> None:
    """The level at the speed of creep, half of it at half the speed; no more when sliding."""
    symbols, creep, level, mobility = ca.SX.sym("x", 2), 0.02, 0.5, 1e-3
    levels = (ca.SX(level), ca.SX(level))
    found = mean_friction(symbols[0], symbols[1], ca.SX(mobility), levels, ca.SX(creep))
    solve_friction = ca.Function("friction", [symbols], [found])
    for speed in (0.002, 0.01, -0.01, 0.3):
        wanted = np.clip(level * speed / creep, -level, level)
        steady = float(solve_friction([speed, speed + mobility * wanted]))
        assert steady == pytest.approx(wanted, rel=1e-6)


def test_stretches_side_by_side_are_those_alone(loop: CommandedArm) -> None:
    runs, free = [recorded(5, 1.5), recorded(6, 0.7)], np.array([0, 2])
    rows = [(0, 90), (37, len(runs[1].time) - 1), (100, 101)]
    cut = [
        Stretch(run, first, last, run.velocity[first])
        for run, (first, last) in zip((*runs, runs[0]), rows, strict=True)
    ]
    together = simulate_stretches(loop, cut, true_parameters(), free)
    for own, found in zip(cut, together, strict=True):
        (alone,) = simulate_stretches(loop, [own], true_parameters(), free)
        assert len(found.position) == own.end - own.begin + 1
        np.testing.assert_array_equal(found.position, alone.position)
        np.testing.assert_array_equal(found.slopes, alone.slopes)


def test_derivatives_are_those_of_differences(loop: CommandedArm) -> None:
    run, start = recorded(6, 1.5), true_parameters()
    # Between the edges of steps, at which means of commands have a corner.
    start.values[-1] += 0.3e-3
    free = np.arange(len(start.values) - 1)
    whole = [Stretch(run, 0, len(run.time) - 1, run.velocity[0])]
    slopes = simulate_stretches(loop, whole, start, free)[0].slopes[:, 0]
    for k in (
        *(start.place(name).start for name in ("gain", "viscous", "coulomb", "zero", "lateness")),
        -1,
    ):
        moved = []
        for sign in (1.0, -1.0):
            values = start.values.copy()
            values[k] += sign * 1e-6
            own = replace(start, values=values)
            moved.append(simulate_stretches(loop, whole, own)[0].position[:, 0])
        numeric = (moved[0] - moved[1]) / 2e-6
        np.testing.assert_allclose(slopes[:, k], numeric, atol=1e-4 * np.abs(numeric).max())


def test_polish_finds_friction_armature_and_delay_from_none(loop: CommandedArm) -> None:
    prior = zero_parameters(("servo",))
    deviations = np.zeros_like(prior.values)
    for name, size in (("armature", 0.05), ("viscous", 0.5), ("coulomb", 0.5)):
        deviations[prior.place(name)] = size
    deviations[-1] = 0.01
    found = polish(loop, [recorded(7), recorded(8)], prior, deviations)
    own = found.parameters
    np.testing.assert_allclose(own.of("coulomb"), COULOMB, rtol=0.03)
    np.testing.assert_allclose(own.of("viscous"), VISCOUS, rtol=0.05)
    np.testing.assert_allclose(own.of("armature"), ARMATURE, rtol=0.1)
    assert abs(own.delay - DELAY) < 1e-3
    assert found.residual[0] < 1e-3
    assert (found.deviations[deviations == 0.0] == 0.0).all()


def test_stated_friction_and_rotor_give_an_estimated_gain_its_scale(loop: CommandedArm) -> None:
    """Beside a payload that nobody knows, and however far the estimate without it was."""
    begun = 0.4
    law = replace(loop.law, stiffness=begun * loop.law.stiffness, estimated=np.array([True]))
    own = CommandedArm(loop.tree, law, loop.middle)
    prior = true_parameters()
    prior.values[prior.place("viscous")] *= begun
    deviations = np.zeros_like(prior.values)
    sizes = {"gain": 1.0, "armature": 0.1 * ARMATURE, "viscous": 0.5, "coulomb": 0.1 * COULOMB}
    for name, size in sizes.items():
        deviations[prior.place(name)] = size
    deviations[prior.body_places("mass")] = 1.0
    deviations[-1] = 0.01
    found = polish(own, [recorded(7), recorded(8)], prior, deviations)
    (gain,) = begun * (1.0 + found.parameters.of("gain"))
    spread = begun * found.deviations[prior.place("gain")][0]
    assert abs(gain - 1.0) < 2.0 * spread < 0.2


def test_noise_of_encoders_is_not_the_motion_that_held_commands_bend(loop: CommandedArm) -> None:
    prior, noise = true_parameters(), 2e-5
    deviations = np.where(prior.values > 0.0, 0.1 * prior.values, 0.0)
    runs = [recorded(7), recorded(8)]
    moving = polish(loop, runs, prior, deviations).noise
    assert abs(moving[0] - noise) < 0.15 * noise
    bent = np.std(np.diff(runs[0].position[:, 0], n=3)) / np.sqrt(20.0)
    assert bent > 1.5 * noise
    still = replace(runs[0], name="still", position=0.0 * runs[0].position)
    fit = LoopFit(loop, [runs[0], still], prior, deviations)
    point = fit.evaluate(prior)
    own = point.residual[: len(point.residual) // 2]
    twice, both = LoopFit(loop, [runs[0]] * 2, prior, deviations), np.vstack([own, own])
    np.testing.assert_allclose(
        fit.encoder_noise(point), twice.encoder_noise(SimulatedPoint(both, both))
    )
    none = LoopFit(loop, [still], prior, deviations)
    assert np.isnan(none.encoder_noise(none.evaluate(prior))).all()


@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_friction_by_load_goes_with_the_torque_past_the_rotor(
    loop: CommandedArm, offset: float
) -> None:
    """A heavy rotor turns to and fro on its own torque, which its gear does not transmit.

    It transmits what a drive gives beyond its law.
    """
    share, rotor, wave, h = 0.3, 0.2, 9.0, 5e-5
    link = INERTIA + MASS * LEVER**2
    grid = np.arange(0.0, 2.0, STEP)
    command = np.repeat(0.2 * np.sin(wave * grid[::2]), 2)
    q = v = 0.0
    path = np.empty(len(grid))
    for k, target in enumerate(command):
        path[k] = q
        for _ in range(round(STEP / h)):
            drive = KP * (target - q) - VISCOUS * v + offset
            weight = MASS * GRAVITY * LEVER * np.sin(q)
            for sign in (1.0, -1.0):  # of the load
                less = share * sign * np.tanh(v / 0.005)
                rate = (drive - weight * (1.0 + less)) / (rotor + link * (1.0 + less))
                if sign * (link * rate + weight) >= 0.0:
                    break
            v += h * rate
            q += h * v
    run = CommandedRun("run", grid, command[:, None], path[:, None], 0.0 * path[:, None])
    parameters = zero_parameters(("servo",))
    for name, value in (("armature", rotor), ("viscous", VISCOUS), ("load_friction", share)):
        parameters.values[parameters.place(name)] = value
    parameters.values[parameters.place("offset")] = offset
    whole = Stretch(run, 0, len(grid) - 1, np.zeros(1))
    (found,) = simulate_stretches(loop, [whole], parameters)
    error = found.position - run.position
    assert float(np.sqrt(np.mean(error**2))) < 2e-3
    assert float(np.ptp(path)) > 0.5


def test_amplitudes_of_physics_are_fitted_as_parameters_are(loop: CommandedArm) -> None:
    """Viscous friction as a finding has the value and the deviation of the parameter."""
    unknown = ca.SX.sym("Fv")
    sizes = {"deviations": np.array([0.5]), "bounds": np.array([[0.0, np.inf]])}
    amplitudes = Amplitudes(names=(("Fv", 0),), symbols=unknown, values=np.zeros(1), **sizes)
    physics = LoopPhysics(torque=lambda own: unknown * own.velocity, amplitudes=amplitudes)
    damped = CommandedArm(loop.tree, loop.law, np.zeros(1), physics)
    values, spreads = [], []
    for own, bounds in ((loop, np.zeros((0, 2))), (damped, amplitudes.bounds)):
        prior = zero_parameters(("servo",), bounds)
        prior.values[:] = np.insert(true_parameters().values, -1, np.zeros(len(bounds)))
        prior.values[prior.place("viscous")] = 0.0
        place = prior.amplitudes if len(bounds) else prior.place("viscous")
        deviations = np.zeros_like(prior.values)
        deviations[place] = 0.5
        found = polish(own, [recorded(7, 4.0)], prior, deviations)
        values.append(found.parameters.values[place][0])
        spreads.append(found.deviations[place][0])
    np.testing.assert_allclose(values, VISCOUS, rtol=0.05)
    np.testing.assert_allclose(*values, rtol=1e-3)
    np.testing.assert_allclose(*spreads, rtol=1e-2)


def test_amplitudes_of_physics_stay_within_their_bounds(loop: CommandedArm) -> None:
    """A best value beyond either bound ends at it, in a fit, and is none of a further effect."""
    unknown = ca.SX.sym("Fv")
    for low, high in ((0.0, 0.5 * VISCOUS), (2.0 * VISCOUS, 4.0 * VISCOUS)):
        amplitudes = Amplitudes(
            names=(("Fv", 0),),
            symbols=unknown,
            values=np.array([low]),
            deviations=np.array([0.5]),
            bounds=np.array([[low, high]]),
        )
        physics = LoopPhysics(torque=lambda own: unknown * own.velocity, amplitudes=amplitudes)
        own = CommandedArm(loop.tree, loop.law, np.zeros(1), physics)
        prior = zero_parameters(("servo",), amplitudes.bounds)
        prior.values[:] = np.insert(true_parameters().values, -1, low)
        prior.values[prior.place("viscous")] = 0.0
        deviations = np.zeros_like(prior.values)
        deviations[prior.amplitudes] = 0.5
        found = polish(own, [recorded(7, 4.0)], prior, deviations)
        value = found.parameters.values[prior.amplitudes][0]
        np.testing.assert_allclose(value, high if high < VISCOUS else low, rtol=1e-9)


def test_physics_with_which_a_simulation_diverges_has_no_score(loop: CommandedArm) -> None:
    """Torques that grow with the speed push the joint past all bounds, whatever their amplitude."""
    runs, unknown = [recorded(7, 4.0)], ca.SX.sym("Fv")
    prior = true_parameters()
    deviations = np.zeros_like(prior.values)
    deviations[prior.place("viscous")] = 0.5
    fitted = polish(loop, runs, prior, deviations)
    amplitudes = Amplitudes(
        names=(("Fv", 0),),
        symbols=unknown,
        values=np.zeros(1),
        deviations=np.array([0.5]),
        bounds=np.array([[-np.inf, np.inf]]),
    )
    for pushed in (0.0, 50.0):
        physics = LoopPhysics(
            torque=lambda own, pushed=pushed: (unknown - pushed) * own.velocity,
            amplitudes=amplitudes,
        )
        more = CommandedArm(loop.tree, loop.law, np.zeros(1), physics)
        whole = replace(
            fitted.parameters,
            values=np.insert(fitted.parameters.values, -1, 0.0),
            amplitude_bounds=amplitudes.bounds,
        )
        fit = LoopFit(more, runs, whole, np.insert(deviations, -1, 0.5))
        assert np.isfinite(fit.misfit(whole)) == (pushed == 0.0)
        if pushed == 0.0:
            assert score_amplitudes(more, runs, fitted, [[0]], 0)[0] is not None
        else:
            with pytest.raises(FloatingPointError, match="diverges"):
                score_amplitudes(more, runs, fitted, [[0]], 0)


def settle(loop: CommandedArm, command: float) -> float:
    """Return where the servo comes to rest under a constant command, without dry friction."""
    run = recorded(6, 3.0)
    run = replace(run, command=np.full_like(run.command, command))
    free = true_parameters()
    free.values[free.place("coulomb")] = 0.0
    return float(simulate(loop, run, free)[-1, 0])


def test_unstated_damping_may_be_the_actuators_own_within_its_limit(loop: CommandedArm) -> None:
    run, inside = recorded(5, 4.0), true_parameters()
    inside.values[inside.place("viscous")] = 0.0
    law = replace(loop.law, damping=np.array([VISCOUS]), torque_max=np.array([LIMIT]))
    stated = simulate(CommandedArm(loop.tree, law, loop.middle), run, inside)
    share = ca.SX.sym("share")
    physics = LoopPhysics(
        limits={0: ca.SX(LIMIT)},
        damped={0: share},
        amplitudes=Amplitudes(
            names=(("share", 0),),
            symbols=share,
            values=np.ones(1),
            deviations=np.ones(1),
            bounds=np.array([[0.0, 1.0]]),
        ),
    )
    limited, outside = CommandedArm(loop.tree, loop.law, loop.middle, physics), true_parameters()
    for value, largest in ((1.0, 1e-9), (0.0, np.inf)):
        values = np.concatenate([outside.values[:-1], [value], outside.values[-1:]])
        own = replace(outside, values=values, amplitude_bounds=physics.amplitudes.bounds)
        away = float(np.max(np.abs(simulate(limited, run, own) - stated)))
        assert away < largest
    assert away > 1e-3


def test_a_limit_of_the_physics_bounds_the_torque(loop: CommandedArm) -> None:
    physics = LoopPhysics(limits={0: ca.SX(0.5)})
    own = CommandedArm(loop.tree, loop.law, np.zeros(1), physics)
    end = settle(own, 0.8)
    assert KP * (0.8 - end) > 0.5
    np.testing.assert_allclose(MASS * GRAVITY * LEVER * np.sin(end), 0.5, rtol=0.05)


@pytest.mark.parametrize("begun", [0.75, 1.25])
def test_a_limit_is_fitted_from_where_it_never_acts_or_lets_the_joint_drift(
    loop: CommandedArm, begun: float
) -> None:
    limit = ca.SX.sym("limit")
    amplitudes = Amplitudes(
        names=(("limit", 0),),
        symbols=limit,
        values=np.array([begun * LIMIT]),
        deviations=np.array([0.2 * LIMIT]),
        bounds=np.array([[0.0, np.inf]]),
    )
    physics = LoopPhysics(limits={0: limit}, amplitudes=amplitudes)
    own = CommandedArm(loop.tree, loop.law, np.zeros(1), physics)
    prior = zero_parameters(("servo",), amplitudes.bounds)
    prior.values[:] = np.insert(true_parameters().values, -1, begun * LIMIT)
    deviations = np.zeros_like(prior.values)
    deviations[prior.amplitudes] = amplitudes.deviations
    found = polish(own, [recorded(7, limit=LIMIT)], prior, deviations)
    np.testing.assert_allclose(found.parameters.values[prior.amplitudes], LIMIT, rtol=0.02)
    assert 0.0 < found.discretisation[0] < found.residual[0] < 1e-3


def test_delays_of_single_joints_are_told_from_that_of_all(tmp_path: Path) -> None:
    hand = URDF.split('<link name="base"/>')[1].replace("</robot>", "")
    for name, other in (("base", "arm"), ("arm", "hand"), ("servo", "wrist")):
        hand = hand.replace(f'parent link="{name}"', f'parent link="{other}"', 1)
        hand = hand.replace(f'child link="{name}"', f'child link="{other}"', 1)
        hand = hand.replace(f'name="{name}"', f'name="{other}"', 1)
    hand = hand.replace('parent link="hand"', 'parent link="arm"').replace("0 0 0.5", "0 0 -0.28")
    (tmp_path / "robot.urdf").write_text(URDF.replace("</robot>", hand + "</robot>"), "utf-8")
    robot = load_robot(str(tmp_path / "robot.urdf")).with_gravity((0.0, 0.0, -9.81))
    law = ActuatorLaw(
        stiffness=np.array([2.0 * KP, KP]),
        damping=np.full(2, 0.2),
        drive_max=np.full(2, np.inf),
        torque_max=np.full(2, 20.0),
        delay=0.0,
        integral=np.zeros(2),
        tolerance=np.full(2, 0.05),
    )
    own = CommandedArm(robot.tree, law, np.zeros(2))
    both = [recorded(seed, 4.0) for seed in (7, 8)]
    command = np.hstack([each.command for each in both])
    run = replace(both[0], command=command, position=0.0 * command, velocity=0.0 * command)
    true = zero_parameters(robot.joint_names)
    true.values[true.place("armature")] = ARMATURE
    true.values[true.place("lateness")] = 0.0, 0.008
    true.values[-1] = 0.006
    position = simulate(own, run, true)
    velocity = np.gradient(position, run.time, axis=0)
    run = replace(run, position=position, velocity=velocity)
    prior = replace(true, values=true.values.copy())
    prior.values[prior.place("lateness")] = 0.0
    deviations = np.zeros_like(prior.values)
    deviations[prior.place("lateness")] = 2e-3
    deviations[prior.place("viscous")] = 0.1
    deviations[-1] = 5e-3
    found = polish(own, [run], prior, deviations)
    np.testing.assert_allclose(found.parameters.of("lateness"), [0.0, 0.008], atol=2e-4)
    assert abs(found.parameters.delay - 0.006) < 2e-4
    assert (found.deviations[prior.place("lateness")] < 1e-3).all()


# Of a joint with backlash: width [rad], rounding of its flanks [N m], their stiffness [N m/rad].
WIDTH, ROUNDING, FLANK, SPRING_DAMPING = 0.03, 0.03, 60.0, 0.05


def wound(torque: float | np.ndarray | ca.SX) -> float | np.ndarray | ca.SX:
    """Motor less link angle."""
    return 0.5 * WIDTH * torque / (torque**2 + ROUNDING**2) ** 0.5 + torque / FLANK


def two_masses(run: CommandedRun, *, at_output: bool) -> np.ndarray:
    """Readings (K,) of a motor and a pendulum with backlash between them, in small steps."""
    loads = np.sinh(np.linspace(-9.0, 9.0, 4001)) * 1e-3
    angles = np.asarray(wound(loads))
    h, motor, link, v, w = 2e-5, run.position[0, 0], run.position[0, 0], 0.0, 0.0
    # The spring carries the weight from the beginning.
    weight = MASS * GRAVITY * LEVER * np.sin(link)
    if at_output:
        motor = link + float(np.asarray(wound(weight)))
    else:
        link = motor - float(np.asarray(wound(weight)))
    found = np.empty(len(run.time))
    every = round((run.time[1] - run.time[0]) / h)
    late = round(DELAY / h)
    sent = np.repeat(run.command[:, 0], every)
    about = INERTIA + MASS * LEVER**2
    for k in range(len(found)):
        found[k] = link if at_output else motor
        for s in range(every):
            u = sent[max(k * every + s - late, 0)]
            carried = np.interp(motor - link, angles, loads) + SPRING_DAMPING * (w - v)
            drive = KP * (u - (link if at_output else motor)) - carried
            free = w + h * (drive - VISCOUS * w) / ARMATURE
            most = h * COULOMB / ARMATURE
            w = 0.0 if abs(free) < most else free - most * np.sign(free)
            v += h * (carried - MASS * GRAVITY * LEVER * np.sin(link)) / about
            motor, link = motor + h * w, link + h * v
    return found


@pytest.mark.parametrize("at_output", [False, True])
def test_backlash_moves_both_sides_as_two_masses_do(loop: CommandedArm, at_output: bool) -> None:
    run = recorded(5, 2.0)
    run = replace(run, position=np.zeros_like(run.position), velocity=np.zeros_like(run.velocity))
    spring = LoopSpring(windup=wound, damping=SPRING_DAMPING, encoder_at_output=at_output)
    own = CommandedArm(loop.tree, loop.law, np.zeros(1), LoopPhysics(springs={0: spring}))
    found = simulate(own, run, true_parameters())[:, 0]
    wanted = two_masses(run, at_output=at_output)
    plain = simulate(loop, run, true_parameters())[:, 0]
    away = float(np.std(wanted - plain))
    assert away > 2e-3
    assert float(np.std(found - wanted)) < 0.1 * away


def test_derivatives_pass_through_a_spring(loop: CommandedArm) -> None:
    spring = LoopSpring(windup=lambda torque: torque / FLANK, damping=SPRING_DAMPING)
    own = CommandedArm(loop.tree, loop.law, np.zeros(1), LoopPhysics(springs={0: spring}))
    run, start = recorded(6, 0.6), true_parameters()
    place = start.place("armature").start
    whole = [Stretch(run, 0, len(run.time) - 1, run.velocity[0])]
    slopes = simulate_stretches(own, whole, start, np.array([place]))[0].slopes[:, 0, 0]
    moved = []
    for sign in (1.0, -1.0):
        values = start.values.copy()
        values[place] += sign * 1e-6
        moved.append(simulate_stretches(own, whole, replace(start, values=values))[0].position)
    numeric = (moved[0] - moved[1])[:, 0] / 2e-6
    np.testing.assert_allclose(slopes, numeric, atol=1e-4 * np.abs(numeric).max())


def test_torques_by_accelerations_count_as_inertia(loop: CommandedArm) -> None:
    """A rotor stated as an added torque is the rotor stated as an armature."""
    run, more = recorded(6, 1.0), 0.02
    added = LoopPhysics(torque=lambda signals: more * signals.acceleration)
    own = CommandedArm(loop.tree, loop.law, np.zeros(1), added)
    heavier = true_parameters()
    heavier.values[heavier.place("armature")] += more
    np.testing.assert_allclose(
        simulate(own, run, true_parameters()), simulate(loop, run, heavier), atol=1e-9
    )


def test_a_displaced_link_carries_its_weight_there(loop: CommandedArm) -> None:
    physics = LoopPhysics(displacement=lambda position: 0.3 * position)
    own = CommandedArm(loop.tree, loop.law, np.zeros(1), physics)
    end = settle(own, 0.8)
    # By virtual work the motor carries 0.7 of the weight at 0.7 of its angle.
    carried = 0.7 * MASS * GRAVITY * LEVER * np.sin(0.7 * end)
    np.testing.assert_allclose(KP * (0.8 - end), carried, rtol=1e-3)
