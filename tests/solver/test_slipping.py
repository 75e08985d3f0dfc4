"""A motion that makes a connection slip: name, slip torque, report."""

import pytest
from small_arms import load, on_one_element, small_flange

from stiffopt.certificate.violations import find_slips
from stiffopt.report.solve.page import write_solve_report
from stiffopt.solver.solve import solve


@pytest.fixture(scope="module", params=["dynamic_deflection", "torque_squared"])
def slipping(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("slipping")
    minimise = f'objective = "{request.param}"'
    problem = on_one_element(load(folder, "pendulum", minimise=minimise), small_flange(200.0))
    return request.param, problem, solve(problem, throw=False)


def test_slipping_connection_is_named_with_its_slip_torque(slipping):
    name, problem, solution = slipping
    (slip,) = find_slips(problem.robot, solution.assessment)
    assert (slip.element, slip.joint) == ("flange", 1)
    assert slip.holds == pytest.approx(12.0e-3 * 200.0, rel=1e-2)
    assert slip.carries == pytest.approx(abs(solution.assessment.spring_torque).max())
    text = f"flange of joint 1 holds {slip.holds:.3g} N m"
    if name == "dynamic_deflection":
        assert solution.status.value == "certificate_failed"
        assert text in solution.message
        assert "please report" not in solution.message
    else:
        assert any(text in note for note in solution.notes)


def test_report_of_slipping_motion_is_written(slipping, tmp_path):
    _, problem, solution = slipping
    page = write_solve_report(problem, solution, tmp_path)
    assert "slips" in page.read_text()
