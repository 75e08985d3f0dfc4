"""Limits of the duty are kept by the motions of a cycle, at little cost of its time."""

import pytest
from small_cycles import write_cycle_file

from stiffopt.cycle.cycle_simulation import cycle_duty
from stiffopt.cycle.duty_weights import DutyWeights
from stiffopt.cycle.solve_cycle import solve_cycle
from stiffopt.problem.cycle_files import load_cycle
from stiffopt.result.duty import DutyUse


@pytest.fixture(scope="module")
def solve(tmp_path_factory):
    """Fastest cycle with limits of its duty, and the duty."""
    folder = tmp_path_factory.mktemp("cycle")

    def solved(duty=""):
        text = f"[duty]\n{duty}\n"
        path = write_cycle_file(
            folder, duration="{ upper = 20.0 }", objective="duration", extra=text
        )
        cycle = load_cycle(path).cycle
        found = solve_cycle(cycle, simulate=False)
        return found, cycle_duty(cycle, found)

    return solved


@pytest.fixture(scope="module")
def free(solve):
    return solve()


@pytest.mark.slow
def test_rms_torques_are_kept_and_just_used(solve, free):
    fastest, unlimited = free
    shares = (0.8, 0.93, 0.93)
    limits = [s * j.rms_torque for s, j in zip(shares, unlimited.joints, strict=True)]
    found, duty = solve(f"rms_torque = {limits}")
    used = [j.rms_torque / limit for j, limit in zip(duty.joints, limits, strict=True)]
    assert found.status.usable
    assert max(used) <= 1.0
    assert max(used) > 0.99
    # All legs slowed alike, by the square root of the torques' ratio at best, need 12 % more.
    assert fastest.duration < found.duration < 1.06 * fastest.duration


@pytest.mark.slow
def test_work_and_mean_torque_are_kept(solve, free):
    fastest, unlimited = free
    work, mean = 0.7 * unlimited.energy, 0.9 * unlimited.joints[1].mean_torque
    found, duty = solve(f"energy = {work}\nmean_torque = [100.0, {mean}, 100.0]")
    assert found.status.usable
    assert duty.energy <= work
    assert duty.joints[1].mean_torque <= mean
    assert found.duration < 1.03 * fastest.duration


@pytest.mark.slow
def test_a_limit_that_no_motion_keeps_is_named(solve):
    """The links are lifted, which needs more than one joule however slowly."""
    found, _ = solve("energy = 1.0")
    assert not found.status.usable
    assert "exceeds duty.energy 1 J" in found.message


def test_weights_find_the_use_of_a_power_law():
    """Integrals that fall with a power of their weight are brought to their limits."""
    weights, powers = DutyWeights(scale=2.0), (0.4, 1.5)

    def uses():
        given = {(o.name, o.joints): o.weight for o in weights.objectives()}
        shares = [
            1.8 / (1.0 + given.get(("torque_squared", (joint,)), 0.0)) ** power
            for joint, power in enumerate(powers, start=1)
        ]
        return [
            DutyUse(objective="torque_squared", joint=joint, share=share, text="")
            for joint, share in enumerate([*shares, 0.5], start=1)
        ]

    for _ in range(10):
        if weights.kept(uses()):
            break
        weights.learn(uses(), dict.fromkeys((("torque_squared", j) for j in (1, 2, 3)), 1.0))
    assert weights.kept(uses())
    assert len(weights.objectives()) == 2
