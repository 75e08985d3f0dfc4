"""A new objective and a new limit, each added by one class."""

import numpy as np
import pytest
from small_arms import load

from stiffopt import assess, solve, write_solve_report
from stiffopt.problem.limit import LIMITS, LimitKey, LimitKind
from stiffopt.problem.limits.joint_magnitude import worst_joint
from stiffopt.problem.objective import OBJECTIVES, ObjectiveKind
from stiffopt.problem.schema import problem_file
from stiffopt.problem.stage_terms import ObjectiveTerms, PathRows, StaticVariable
from stiffopt.report.file_reference import file_schema, reference_page
from stiffopt.report.solve.wording import objective_phrase


class PeakVelocity(ObjectiveKind):
    """The largest velocity of the joints that count, through an upper bound on it."""

    name = "peak_velocity"
    unit = "rad/s"
    description = "Largest velocity of `joints` over the motion."
    phrase = "largest joint velocity"

    def static_variables(self, objective, problem, sides):
        start = StaticVariable(
            name="peak velocity", start=lambda motion: self.certified_value(objective, motion)
        )
        return (start,)

    def terms(self, given):
        (bound,) = given.statics
        joints = given.objective.numbers(given.problem.joints)
        rows = PathRows(
            name="peak velocity",
            labels=tuple(f"joint {j} {way}" for j in joints for way in ("forward", "backward")),
            expressions=tuple(
                (sign * given.model.velocity[j - 1] - bound) / given.scale
                for j in joints
                for sign in (1, -1)
            ),
        )
        return ObjectiveTerms(value=lambda integrals, duration: bound, path_rows=(rows,))

    def certified_value(self, objective, motion):
        columns = np.array(objective.numbers(motion.position.shape[1])) - 1
        return float(np.max(np.abs(motion.velocity[:, columns])))


class JointPower(LimitKind):
    """|torque velocity| of every drive below one value."""

    name = "joint_power"
    keys = (
        LimitKey(
            key="joint_power",
            form=float | None,
            description="Largest mechanical power of each drive [W].",
            value=lambda robot: np.inf,
        ),
    )

    def active(self, limits):
        return bool(np.isfinite(limits.joint_power))

    def read(self, section, joints):
        given = section.joint_power
        return {"joint_power": np.inf if given is None else given}

    def rows(self, problem, model, margin):
        power = [
            model.drive_torque[j] * model.velocity[j] / problem.active_limits.joint_power
            for j in range(problem.joints)
        ]
        labels = tuple(f"joint {j + 1}" for j in range(problem.joints))
        allowed = 1.0 - margin
        return [
            PathRows(
                name=self.name,
                labels=labels,
                expressions=tuple(power),
                lower=-allowed,
                upper=allowed,
            )
        ]

    def violations(self, limits, motion):
        power = np.abs(motion.torque * motion.velocity)
        return [worst_joint(self.name, power / limits.joint_power - 1.0, motion)]

    def statements(self, limits, robot):
        return [("power of a drive at most", limits.joint_power, "W")]


@pytest.fixture(autouse=True)
def _registered():
    OBJECTIVES.add(PeakVelocity())
    LIMITS.add(JointPower())
    yield
    OBJECTIVES.discard("peak_velocity")
    LIMITS.discard("joint_power")


GOAL = 'objective = "peak_velocity"\njoints = [1]'


def test_schema_and_reference_contain_new_kinds():
    text = str(file_schema("trajectory"))
    page = reference_page()
    for kind in (PeakVelocity, JointPower):
        assert kind.name in text
        assert kind.name in page
    assert PeakVelocity.description in page
    assert JointPower.keys[0].description in page


def test_optimiser_and_certificate_use_new_kinds(tmp_path):
    free = solve(load(tmp_path, minimise=GOAL))
    assert free.status == "optimal"
    # From -0.6 to 0.5 rad in 0.5 s, at rest at both ends: the mean velocity is a bound.
    assert free.objective.value > 1.1 / 0.5
    assert free.ratio_to_better_baseline < 1.0
    motion = free.assessment
    power = float(np.max(np.abs(motion.torque * motion.velocity)))

    problem = load(tmp_path, minimise=GOAL, limits=f"joint_power = {0.9 * power}")
    exceeded = assess(problem, free.trajectory).worst_violation
    assert exceeded.limit == "joint_power"
    assert exceeded.value == pytest.approx(1.0 / 0.9 - 1.0)
    capped = solve(problem)
    assert capped.status == "optimal"
    (margin,) = (v for v in capped.assessment.violations if v.limit == "joint_power")
    assert margin.value < 5e-3
    # The least peak is one number at the nodes; between them optima of equal worth differ.
    peak_free, peak_capped = (
        np.abs(motion(motion.times, 1)[:, 0]).max()
        for motion in (free.trajectory, capped.trajectory)
    )
    assert peak_capped >= (1.0 - 1e-6) * peak_free

    page = write_solve_report(problem, capped, tmp_path).read_text()
    assert "argest joint velocity" in page
    assert "power of a drive at most" in page
    assert "joint power" in page


def test_messages_name_new_kinds(tmp_path):
    assert objective_phrase("peak_velocity", "") == "largest joint velocity"
    assert "joint_power" in problem_file().model_fields["limits"].annotation.model_fields
