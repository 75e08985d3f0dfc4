"""Pages in Chromium: no console errors, moving scene, no overflow."""

import io
from dataclasses import replace

import numpy as np
import pytest
from browser import CHROMIUM, Browser
from shaped_arms import MESH, with_shapes, write_stl
from small_arms import write_problem, write_robot
from synthetic_solution import solution

from stiffopt.certificate.assess import assess
from stiffopt.command.simulation import PlannedMotion, elastic_arm, simulate_motions
from stiffopt.problem.files import load_problem
from stiffopt.report.diagnosis.page import write_diagnosis_report
from stiffopt.report.solve.page import write_solve_report
from stiffopt.report.solve.simulation import write_simulation_report
from stiffopt.result.solution import Baseline
from stiffopt.result.trajectory import Trajectory
from tests.discovery.simulated_sets import COULOMB, diagnosed

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine"),
]

SIZES = [(1280, 900), (390, 844)]


def swing(problem, far=1.0):
    """Half a second from rest to rest along the joints' straight line, `far` of the way."""
    start, end = problem.start.joints, problem.end.joints
    nodes = np.outer([0.0, 1.0, -1.0, 0.0], 16.0 * far * (end - start))
    times = np.array([0.0, 0.125, 0.375, 0.5])
    return assess(
        problem,
        Trajectory.piecewise_linear_acceleration(times, nodes, start, np.zeros_like(start)),
    )


CELL = """
[cell]
floor = -2.0
[[cell.box]]
name = "box"
size = [0.2, 0.2, 0.2]
position = [2.0, 0.0, 0.0]
[[cell.plane]]
name = "wall"
point = [-3.0, 0.0, 0.0]
normal = [1.0, 0.0, 0.0]
[[cell.mesh]]
name = "table"
file = "link.stl"
position = [0.0, 0.0, -1.5]
scale = 0.001
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    write_stl(folder / "link.stl", 300.0)
    path = write_problem(folder, minimise='objective = "dynamic_deflection"')
    text = with_shapes("upper", MESH.format(purpose="visual", name="link.stl"))
    write_robot(folder, urdf_text=text)
    path.write_text(path.read_text() + CELL)
    problem = load_problem(path).problem
    slower = Baseline(
        name="toppra", assessment=swing(problem, 0.8), objective=1e-4, feasible=True, reason=""
    )
    found = solution(2, assessment=swing(problem), baselines={"toppra": slower})
    return write_solve_report(problem, found, folder)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def shown(browser, page):
    """Open the page in a state at a size; the scene is drawn then."""

    def show(state="", size=SIZES[0], dark=False):
        browser.console.clear()
        browser.size(*size, dark=dark)
        browser.open(page, state)
        browser.until("document.getElementById('scene').dataset.tool !== undefined")
        return browser

    return show


def pixels(png):
    from matplotlib.image import imread

    return imread(io.BytesIO(png))[..., :3]


def tool(browser):
    text = browser.value("document.getElementById('scene').dataset.tool")
    return np.array([float(part) for part in text.split()])


def slide(browser, role, value):
    """Move a slider and wait for the picture."""
    browser.value(
        f"(() => {{ const e = document.querySelector('[data-role={role}]'); e.value = {value}; "
        "e.dispatchEvent(new Event('input', {bubbles: true})); "
        "return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))); "
        "})()"
    )


@pytest.mark.parametrize("size", SIZES, ids=["desk", "phone"])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_page_fits_the_window_without_console_errors(shown, size, dark):
    browser = shown(size=size, dark=dark)
    wide, window = browser.value("[document.documentElement.scrollWidth, window.innerWidth]")
    assert wide <= window == size[0]
    ground = browser.value("getComputedStyle(document.body).backgroundColor")
    assert ground == ("rgb(20, 24, 29)" if dark else "rgb(255, 255, 255)")
    # No cell is broken to a letter a line: all are wider than tall letters stacked.
    narrow = browser.value(
        "[...document.querySelectorAll('td')].filter((cell) => cell.textContent.trim().length > 6 "
        "&& cell.clientHeight > 6 * cell.clientWidth).length"
    )
    assert narrow == 0
    cut = browser.value(
        "[...document.querySelectorAll('table')]"
        ".filter(e => e.getBoundingClientRect().right > innerWidth).map(e => e.textContent)"
    )
    assert cut == []
    assert browser.console == []


def test_contents_list_every_section(shown):
    browser = shown()
    titles, links = browser.value(
        "[[...document.querySelectorAll('h2')].map((h) => `#${h.id} ${h.textContent}`), "
        "[...document.querySelectorAll('.contents a')].map((a) => "
        "`${a.getAttribute('href')} ${a.textContent}`)]"
    )
    assert len(titles) > 4
    assert titles == links


def test_sliders_move_the_arm_and_the_cursors(shown, page):
    browser = shown("#time=0&factor=0&ghost=0&planned=0")
    rest, first = tool(browser), pixels(browser.picture("#scene canvas"))
    # More than the ground and the grid are drawn.
    ground = np.median(first.reshape(-1, 3), axis=0)
    drawn = np.abs(first - ground).max(axis=2) > 0.1
    assert 0.01 < drawn.mean() < 0.6
    cursors = "[...document.querySelectorAll('.cursor')].map((c) => Number(c.getAttribute('x1')))"
    before = browser.value(cursors)
    assert len(before) > 8
    slide(browser, "time", 500)
    moved, second = tool(browser), pixels(browser.picture("#scene canvas"))
    assert np.linalg.norm(moved - rest) > 0.1
    assert (np.abs(second - first).max(axis=2) > 0.1).mean() > 0.005
    assert all(b > a for a, b in zip(before, browser.value(cursors), strict=True))
    slide(browser, "time", 250)
    moved, second = tool(browser), pixels(browser.picture("#scene canvas"))
    *_, size, unit = browser.value("document.querySelector('[data-role=deflection]').value").split()
    assert unit == "mm"
    slide(browser, "factor", 51)
    enlarged = browser.value("document.querySelector('[data-role=factor-shown]').value")
    # So much, but for the arm's turning meanwhile.
    wanted = 1e-3 * float(size) * float(enlarged.split()[-1])
    assert np.linalg.norm(tool(browser) - moved) == pytest.approx(wanted, rel=0.05)
    third = pixels(browser.picture("#scene canvas"))
    assert (np.abs(third - second).max(axis=2) > 0.1).mean() > 0.0005
    assert browser.console == []


def test_scene_is_drawn_after_resizing(shown):
    browser = shown("#time=0")
    # After resizing, read when the last observer has run.
    drawn = browser.value(
        "new Promise((done) => { const canvas = document.querySelector('#scene canvas'); "
        "const box = canvas.parentElement, small = document.createElement('canvas'); "
        "small.width = small.height = 100; const flat = small.getContext('2d'); let calls = 0; "
        "const read = () => { if (!calls++) { box.style.width = '60%'; return; } "
        "flat.drawImage(canvas, 0, 0, 100, 100); "
        "done(flat.getImageData(0, 0, 100, 100).data.filter((v, k) => k % 4 == 3 && v).length); }; "
        "new ResizeObserver(read).observe(box); })"
    )
    assert drawn > 0.05 * 100 * 100


def test_simulation_page_shows_the_vibration(browser, page):
    problem = load_problem(page.parent / "problem.toml").problem
    assessment = swing(problem)
    arm = elastic_arm(problem, assessment.position[0])
    motion = PlannedMotion.of("optimised", assessment, counted=True)
    simulation = simulate_motions(problem, arm, [motion, replace(motion, name="toppra")])
    own = write_simulation_report(problem, arm, simulation, page.parent)
    for size in SIZES:
        browser.console.clear()
        browser.size(*size, dark=False)
        browser.open(own, "#time=0&factor=0")
        browser.until("document.getElementById('scene').dataset.tool !== undefined")
        wide, window = browser.value("[document.documentElement.scrollWidth, window.innerWidth]")
        assert wide <= window == size[0]
        rest = tool(browser)
        slide(browser, "time", 500)
        assert np.linalg.norm(tool(browser) - rest) > 0.1
        said = browser.value("document.querySelector('[data-role=deflection]').value")
        assert said.startswith("vibratory deflection of the tool")
        assert browser.console == []


def test_a_click_in_a_plot_sets_the_time(shown):
    browser = shown()
    browser.value(
        "(() => { const svg = document.querySelector('svg[data-times]'); "
        "svg.scrollIntoView({block: 'center'}); "
        "const [l, t, r, b, f, e] = JSON.parse(svg.dataset.times)[0]; "
        "const p = new DOMPoint(l + (r - l) * (0.1 - f) / (e - f), (t + b) / 2)"
        ".matrixTransform(svg.getScreenCTM()); svg.dispatchEvent(new MouseEvent('click', "
        "{clientX: p.x, clientY: p.y, bubbles: true})); })()"
    )
    # A pixel is 1 ms.
    browser.until(
        "Math.abs(parseFloat(document.querySelector('[data-role=time-shown]').value) - 0.1)"
        " < 0.0021"
    )


def test_without_webgl_the_still_remains(tmp_path, page):
    from browser import SWITCHES

    with Browser(tmp_path, [*SWITCHES, "--disable-3d-apis"]) as browser:
        browser.open(page)
        assert browser.value("document.getElementById('scene')") is None
        assert browser.value("document.querySelector('header .plot.whole svg') !== null")


def test_diagnosis_fits_a_narrow_screen(tmp_path):
    """Tables become lists and figures are scaled: nothing scrolls sideways."""
    path = write_diagnosis_report(diagnosed(COULOMB), tmp_path)
    with Browser(tmp_path / "profile") as browser:
        browser.size(390, 844)
        browser.open(path)
        browser.value("document.querySelectorAll('details').forEach(each => each.open = true)")
        cut = browser.value(
            "[...document.querySelectorAll('table, svg')]"
            ".filter(e => e.getBoundingClientRect().right > innerWidth)"
            ".map(e => e.tagName + ' ' + e.textContent.trim().slice(0, 40))"
        )
        assert cut == []
        assert not browser.console
