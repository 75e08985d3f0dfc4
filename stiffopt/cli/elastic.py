"""`stiffopt simulate`, `view` and `modes`: elastic simulation and elastic modes."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from stiffopt.cli import base
from stiffopt.errors import InputError, shortened
from stiffopt.folders import output_folder

# Entries that --set may change in a simulation: no motion depends on them.
_UNCERTAINTY_ENTRY = re.compile(r"\s*uncertainty\b")
_SOLVED_MOTION_REASON = (
    "a solved motion allows changes of [uncertainty] only, such as uncertainty.stiffness=0.3. Run"
    " solve again with --set."
)
_SERVO_ENTRY = re.compile(r"\bservo_(bandwidth|feed_forward|delay)\b")

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.recipe.stored_result import StoredResult
    from stiffopt.robot.robot import Robot


def _with_model(problem: TrajectoryProblem, model: Path, effects: Path | None) -> TrajectoryProblem:
    """Return the problem with the robot of an extended model."""
    from stiffopt.discovery.extended.planning import extended_problem, planner_model, read_model

    return extended_problem(problem, planner_model(problem.robot, read_model(model, effects)))


@base.app.command
def simulate(
    result: Path,
    *,
    problem: base.SolvedProblem = None,
    out: base.Out | None = None,
    band: str = "0.05 mm",
    bandwidth: float | None = None,
    feed_forward: float | None = None,
    delay: str | None = None,
    damping: float | None = None,
    model: Path | None = None,
    effects: Path | None = None,
    changes: base.Changes = (),
    open_report: base.Open = False,
) -> int:
    """Simulate a solved motion and its baselines on the elastic arm.

    Writes simulation.json, simulation.csv (the optimised motion every 0.5 ms) and simulation.html
    with a 3D view of the vibration; of a cycle, with its changes of payload, the first two. A
    command.csv of the solve is evaluated too: on the nominal arm, at the bounds of the uncertainty
    and on arms sampled within them; --set changes entries of [uncertainty], such as
    uncertainty.stiffness=0.3.

    Parameters
    ----------
    result
        Folder of a solve.
    out
        Folder for the results; default: the folder of the solve.
    band
        Settling band: largest deviation of a settled tool.
    bandwidth
        Bandwidth of the position loop [Hz] in place of that of the problem. Set-points are sent
        ahead by the dead time that the problem's loop has, whatever loop follows them.
    feed_forward
        Velocity feedforward of the loop, 0 to 1, in place of that of the problem.
    delay
        Dead time of the loop in place of that of the problem.
    damping
        Damping ratio of each elastic joint on its own, in place of the robot file's damping.
    model
        extended.toml of a diagnosis of this arm: the arm that the motion is simulated on; default:
        the one that it was planned with.
    effects
        Python file of its user-defined effects.
    """
    from stiffopt.command.compensation import judge_existing_command
    from stiffopt.command.simulation import elastic_arm, simulate_motions
    from stiffopt.elastic.arm import rigid_arm_error
    from stiffopt.recipe.stored_result import read_result
    from stiffopt.report.solve.simulation import write_simulation_report
    from stiffopt.report.solve.terminal import print_compensation, print_simulation
    from stiffopt.report.solve.wording import rival_text
    from stiffopt.result.compensation import COMMAND_FILE
    from stiffopt.result.cycle import CYCLE_FILE
    from stiffopt.result.store import write_simulation
    from stiffopt.units import to_si

    base.refuse_changes(
        tuple(each for each in changes if not _UNCERTAINTY_ENTRY.match(each)), _SOLVED_MOTION_REASON
    )
    settled = to_si(base.number_or_text(band), "length", "--band")
    late = None if delay is None else to_si(base.number_or_text(delay), "time", "--delay")
    given = {"bandwidth": bandwidth, "feed_forward": feed_forward, "delay": late}
    loop: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if settled <= 0.0:
        raise InputError(f"--band {band}: must be above 0.")
    for each in changes:
        if loop and _SERVO_ENTRY.search(each):
            raise InputError(
                f"--set {shortened(each)}: with --bandwidth, --feed-forward or --delay all arms "
                "have the given loop, without uncertainty of servos. Omit one of the two."
            )
    if (result / CYCLE_FILE).is_file():
        base.refuse_changes(changes, "a simulated cycle has the arm as modelled. Omit --set.")
        if model is not None:
            raise InputError("--model: a cycle is simulated on its own arm. Omit the option.")
        return _simulate_cycle(
            result, out or result, problem, loop=loop, band=settled, damping=damping
        )
    stored = _stored_on_model(read_result(result, problem, changes, _with_model), model, effects)
    servo = replace(stored.problem.servo, **loop) if loop else None
    if changes and stored.command is None:
        raise InputError(
            f"--set {shortened(changes[0])}: uncertainties apply to a command, and {result} has no "
            "command.csv. See result.json for the reason."
        )
    if not stored.problem.robot.yields:
        raise rigid_arm_error(stored.problem.robot)
    folder = out or result
    with output_folder(folder, "simulate", of="solve") as stage:
        modelled = elastic_arm(stored.problem, stored.optimised.position[0]).under(stored.force)
        arm = modelled if damping is None else modelled.damped(damping)
        motions, led = stored.motions(), None
        found = simulate_motions(stored.problem, arm, motions, servo=servo, band=settled)
        if stored.command is not None:
            led = judge_existing_command(
                stored.problem,
                modelled,
                motions,
                stored.command,
                uncertainty=stored.uncertainty,
                damping=damping,
                servo=servo,
                file=Path(os.path.relpath(result / COMMAND_FILE, folder)).as_posix(),
            )
        path = folder / write_simulation(found, stage, led).name
        page = write_simulation_report(stored.problem, arm, found, stage, led)
    print_simulation(found)
    if led is not None:
        print_compensation(replace(led, file=str(result / COMMAND_FILE)))
        print(rival_text(led))
    print(f"Wrote {path}, {path.with_suffix('.csv').name} and {page.name}")
    base.show_report(folder, open_report, page.name)
    return 0


def _stored_on_model(
    stored: StoredResult, model: Path | None, effects: Path | None
) -> StoredResult:
    """Return a result whose problem has the arm of an extended model."""
    if model is None:
        return stored
    if stored.model is not None:
        raise InputError(
            f"--model: the motion was planned with {stored.model}, and is simulated on that arm."
            " Omit the option, or solve without a model."
        )
    return replace(stored, problem=_with_model(stored.problem, model, effects))


def _simulate_cycle(
    result: Path, folder: Path, problem: Path | None, *, loop: dict[str, Any], **settings: Any
) -> int:
    """Simulate the commands of a solved cycle with other settings, and write what it found."""
    import numpy as np

    from stiffopt.cycle.cycle_simulation import simulate_motions
    from stiffopt.export.folder_motions import StoredCycle, read_stored
    from stiffopt.export.motion import SplineMotion
    from stiffopt.files import load_json
    from stiffopt.problem.cycle_files import load_cycle
    from stiffopt.recipe.stored_result import problem_file, read_changes
    from stiffopt.report.pages.cycle import print_simulated_cycle
    from stiffopt.result.cycle import CYCLE_FILE, write_cycle_simulation

    stored = read_stored(result, "motor", problem)
    assert isinstance(stored, StoredCycle)
    path = result / CYCLE_FILE
    document = load_json(path)
    changes = read_changes(path, document)
    cycle = load_cycle(problem_file(path, document, problem), changes).cycle
    commands = [SplineMotion(leg.curve) for leg in stored.legs]
    plans = [SplineMotion(leg.curve if leg.link is None else leg.link) for leg in stored.legs]
    # A command that leads the servo's lag ends after the plan's arrival.
    for plan, leg in zip(plans, document["legs"], strict=True):
        plan.duration = leg["arrival"] - leg["start"]
    rests = np.array([leg["dwell"] for leg in document["legs"]])
    servo = replace(cycle.first.servo, **loop) if loop else None
    found = simulate_motions(cycle, commands, plans, rests, servo=servo, **settings)
    with output_folder(folder, "simulate", of="solve") as stage:
        written = write_cycle_simulation(found, stage)
    print_simulated_cycle(cycle, found)
    print(f"Wrote {', '.join(str(folder / name) for name in written)}")
    return 0


@base.app.command
def view(
    result: Path,
    *,
    problem: base.SolvedProblem = None,
    out: base.Out | None = None,
    show: Annotated[bool, Parameter(name="--open", help="Open the page in the browser.")] = True,
    changes: base.NoChanges = (),
) -> int:
    """Show a solved motion in the browser: scene.html, which needs no network.

    `result`: folder of a solve. `out`: folder for the page; default: the folder of the solve.
    """
    from stiffopt.recipe.stored_result import read_result
    from stiffopt.report.scene.poses import stored_poses
    from stiffopt.report.scene.still import write_scene_page

    base.refuse_changes(changes)
    stored = read_result(result, problem)
    own, *others = stored.motions()
    robot, folder = stored.problem.robot, out or result
    motions = {"planned": stored_poses(robot, own.time, own.position, stored.windup)}
    motions |= {
        each.name: stored_poses(robot, each.time, each.position)
        for each in others
        if each.name == "toppra"
    }
    with output_folder(folder, "view", of="solve") as stage:
        title = stored.problem.title or robot.name
        page = write_scene_page(title, robot, motions, stage / "scene.html", stored.problem.cell)
    print(f"Wrote {folder / page.name}")
    base.show_report(folder, show, page.name)
    return 0


@base.app.command
def modes(
    source: str,
    *,
    at: Annotated[str | None, Parameter(help="Joint angles, such as '0 45deg -0.3 0 90deg 0'.")] = (
        None
    ),
    out: base.Out | None = None,
    changes: base.Changes = (),
) -> int:
    """Compute the elastic modes of an arm: frequencies, damping ratios and mode shapes.

    Poses: start, vias and end of a problem file; --at of a robot, by default the start of its
    starter problem; along the motion of a solve, which writes modes.csv and modes.svg. `source`:
    robot (shipped name, robot file, URDF or MJCF), problem file, or folder of a solve. `out`:
    folder for the results of a solve's motion; default: the folder of the solve.
    """
    from stiffopt.elastic.arm import questionable_springs
    from stiffopt.elastic.modes import modes_along, modes_at, write_modes_csv
    from stiffopt.recipe.stored_result import read_result
    from stiffopt.report.common.terminal import print_lines
    from stiffopt.report.solve.simulation import print_modes, write_modes_figure

    path = Path(source)
    if path.is_dir():
        if at is not None:
            raise InputError("--at: the poses are those of the solve's motion. Omit --at.")
        base.refuse_changes(changes)
        stored = read_result(path)
        rows = modes_along(stored.problem.robot, stored.optimised.time, stored.optimised.position)
        folder = out or path
        with output_folder(folder, "modes", of="solve") as stage:
            write_modes_csv(rows, stage / "modes.csv")
            figure = write_modes_figure(rows, stage / "modes.svg")
        print_modes([rows[0], rows[len(rows) // 2], rows[-1]])
        print(f"Wrote {folder / 'modes.csv'} and {folder / figure.name}")
        return 0
    robot, poses = _named_poses(source, at, changes)
    print_modes(modes_at(robot, poses))
    if soft := questionable_springs(robot, next(iter(poses.values()))):
        print_lines([soft])
    return 0


def _named_poses(
    source: str, at: str | None, changes: Sequence[str]
) -> tuple[Robot, dict[str, np.ndarray]]:
    """Return robot and named poses: of a problem file, at --at, or the start of `init problem`."""
    from stiffopt.files import load_toml
    from stiffopt.path.load import load_problem
    from stiffopt.problem.resolve import resolve
    from stiffopt.robot.files import load_robot
    from stiffopt.starter.problem_file import first_motion

    path = Path(source)
    if path.suffix == ".toml" and path.is_file() and load_toml(path).get("kind") == "trajectory":
        problem = load_problem(path, changes).problem
        if at is not None:
            return problem.robot, {at: _parse_pose(at, problem.robot)}
        motion = resolve(problem)
        vias = {f"via {k}": angles for k, angles in enumerate(motion.vias, start=1)}
        return problem.robot, {"start": motion.start, **vias, "end": motion.end}
    robot = load_robot(source, changes=changes)
    if at is None:
        return robot, {"start of its starter problem": first_motion(robot).start}
    return robot, {at: _parse_pose(at, robot)}


def _parse_pose(text: str, robot: Robot) -> np.ndarray:
    """Parse joint angles (n,) [rad] such as "0 45deg -0.3", separated by blanks or commas."""
    import numpy as np

    from stiffopt.problem.limit import Limits
    from stiffopt.problem.resolve import check_range
    from stiffopt.units import fit_joint, joint_to_si

    values = text.split(",") if "," in text else text.split()
    if len(values) != robot.n:
        raise InputError(
            f"--at needs {robot.n} values, one per joint ({', '.join(robot.joint_names)}); got "
            f"{len(values)}."
        )
    angles = []
    for value, name, slides in zip(values, robot.joint_names, robot.prismatic, strict=True):
        angle = joint_to_si(base.number_or_text(value), "angle", f"--at, {name}")
        angles.append(fit_joint(angle, bool(slides), "angle", f"--at, {name}"))
    pose = np.array(angles)
    check_range(robot, Limits.of(robot), "--at", pose, "; bare numbers are rad, degrees 20deg")
    return pose
