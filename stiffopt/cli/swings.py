"""`stiffopt simulate` and `stiffopt modes`: how an arm swings on the springs of its joints."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from stiffopt.cli.base import (
    Changes,
    NoChanges,
    Open,
    Out,
    app,
    number_or_text,
    refuse_changes,
    show_report,
)
from stiffopt.errors import InputError, shortened
from stiffopt.folders import output_folder

# Entries that a simulation may change: no motion depends on them.
_UNSURE = re.compile(r"\s*uncertainty\b")
_SOLVED = (
    "the motion was solved; only [uncertainty] may change, such as uncertainty.stiffness=0.3. Solve"
    " again with --set"
)
_OF_SERVOS = re.compile(r"\bservo_(bandwidth|feed_forward|delay)\b")

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from stiffopt.robot.robot import Robot


@app.command
def simulate(
    result: Path,
    *,
    problem: Path | None = None,
    out: Out | None = None,
    band: str = "0.05 mm",
    bandwidth: float | None = None,
    feed_forward: float = 1.0,
    delay: str = "0 s",
    damping: float | None = None,
    changes: Changes = (),
    open_report: Open = False,
) -> int:
    """Simulate a solved motion and its baselines on the elastic arm.

    Writes simulation.json, simulation.csv (the optimised motion every 0.5 ms) and simulation.html,
    where the arm can be seen swinging. Where the solve wrote a command.csv, it is judged anew too:
    on the arm as modelled, at the bounds of what is uncertain, and as drawn from within them; --set
    changes entries of [uncertainty], such as uncertainty.stiffness=0.3.

    Parameters
    ----------
    result
        Folder of a solve.
    problem
        Problem file, where the result does not name it or it has moved.
    out
        Default: the folder of the solve.
    band
        Within which the tool counts as settled.
    bandwidth
        Of a position loop in place of motors that follow exactly [Hz].
    feed_forward
        Share of the command's velocity that the loop is fed forward, 0 to 1.
    delay
        Dead time of the loop.
    damping
        Of all joints that yield, share of critical, in place of what the robot file states.
    """
    from stiffopt.elastic.arm import rigid_arm_error
    from stiffopt.elastic.motor import Servo
    from stiffopt.report.solve.simulation_page import write_simulation_report
    from stiffopt.report.solve.terminal import print_compensation, print_simulation
    from stiffopt.result.compensation_store import COMMAND_FILE
    from stiffopt.result.store import write_simulation
    from stiffopt.solver.compensation import recompensated
    from stiffopt.solver.simulation import elastic_arm, simulate_motions
    from stiffopt.solver.stored import read_result
    from stiffopt.units import to_si

    refuse_changes(tuple(each for each in changes if not _UNSURE.match(each)), _SOLVED)
    settled = to_si(number_or_text(band), "length", "--band")
    late = to_si(number_or_text(delay), "time", "--delay")
    if settled <= 0.0:
        raise InputError(f"band must be above 0, got {band}.")
    if bandwidth is None and (late != 0.0 or feed_forward != 1.0):
        raise InputError("delay and feed-forward are of a position loop: give its --bandwidth too.")
    for each in changes:
        if bandwidth is not None and _OF_SERVOS.search(each):
            raise InputError(
                f"--set {shortened(each)}: with --bandwidth every arm has the loop that is given, "
                "and nothing of servos is uncertain. Leave one of the two out."
            )
    servo = None if bandwidth is None else Servo(bandwidth, feed_forward, late)
    stored = read_result(result, problem, changes)
    if changes and stored.command is None:
        raise InputError(
            f"--set {shortened(changes[0])}: uncertainties are of a command, and {result} has no "
            "command.csv. result.json says why."
        )
    if not stored.problem.robot.yields:
        raise rigid_arm_error(stored.problem.robot)
    folder = out or result
    with output_folder(folder, "simulate", of="solve") as stage:
        modelled = elastic_arm(stored.problem, stored.optimised.position[0])
        arm = modelled if damping is None else modelled.damped(damping)
        motions, led = stored.motions(), None
        found = simulate_motions(stored.problem, arm, motions, servo=servo, band=settled)
        if stored.command is not None:
            led = recompensated(
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
    print(f"Wrote {path}, {path.with_suffix('.csv').name} and {page.name}")
    show_report(folder, open_report, page.name)
    return 0


@app.command
def view(
    result: Path, *, problem: Path | None = None, port: int = 8080, changes: NoChanges = ()
) -> int:
    """Show a solved motion live in the browser, until Ctrl-C; needs the extra `view`.

    Parameters
    ----------
    result
        Folder of a solve.
    problem
        Problem file, where the result does not name it or it has moved.
    port
        Of the page, on this machine alone; a port that is taken gives the next one.
    """
    from stiffopt.report.scene.live import LiveScene
    from stiffopt.report.scene.poses import stored_poses
    from stiffopt.solver.stored import read_result

    refuse_changes(changes)
    stored = read_result(result, problem)
    own, *others = stored.motions()
    ghost = next((each for each in others if each.name == "toppra"), None)
    robot = stored.problem.robot
    scene = LiveScene(
        robot,
        stored_poses(robot, own.time, own.position, stored.windup),
        None if ghost is None else stored_poses(robot, ghost.time, ghost.position),
        cell=stored.problem.cell,
        port=port,
    )
    print(f"{scene.address} shows {result}; Ctrl-C ends.", flush=True)
    scene.run()
    return 0


@app.command
def modes(
    source: str,
    *,
    at: Annotated[str | None, Parameter(help="Joint angles, such as '0 45deg -0.3 0 90deg 0'.")] = (
        None
    ),
    out: Out | None = None,
    changes: Changes = (),
) -> int:
    """Frequencies, damping and shapes of an arm's small swings about poses at rest.

    Of a problem file in its start, vias and end; of a robot at --at, else where a first problem of
    it would start; of the folder of a solve along the motion, which writes modes.csv and modes.svg.

    Parameters
    ----------
    source
        A robot (shipped name, robot TOML or URDF), a problem file, or the folder of a solve.
    """
    from stiffopt.elastic.arm import questionable_springs
    from stiffopt.elastic.modes import modes_along, modes_at, write_modes_csv
    from stiffopt.report.common.terminal import print_lines
    from stiffopt.report.solve.modes import print_modes, write_modes_figure
    from stiffopt.solver.stored import read_result

    path = Path(source)
    if path.is_dir():
        if at is not None:
            raise InputError("a folder of a solve has its own poses: leave --at out.")
        refuse_changes(changes)
        stored = read_result(path)
        rows = modes_along(stored.problem.robot, stored.optimised.time, stored.optimised.position)
        folder = out or path
        with output_folder(folder, "modes", of="solve") as stage:
            write_modes_csv(rows, stage / "modes.csv")
            figure = write_modes_figure(rows, stage / "modes.svg")
        print_modes([rows[0], rows[len(rows) // 2], rows[-1]])
        print(f"Wrote {folder / 'modes.csv'} and {folder / figure.name}")
        return 0
    robot, poses = _poses(source, at, changes)
    print_modes(modes_at(robot, poses))
    if soft := questionable_springs(robot, next(iter(poses.values()))):
        print_lines([soft])
    return 0


def _poses(
    source: str, at: str | None, changes: Sequence[str]
) -> tuple[Robot, dict[str, np.ndarray]]:
    """Robot and named joint angles: of a problem file, or of a robot at --at or its first start."""
    from stiffopt.files import load_toml
    from stiffopt.problem.files import load_problem
    from stiffopt.problem.resolve import resolve
    from stiffopt.robot.files import load_robot
    from stiffopt.starter.first_motion import first_motion

    path = Path(source)
    if path.suffix == ".toml" and path.is_file() and load_toml(path).get("kind") == "trajectory":
        problem = load_problem(path, changes).problem
        if at is not None:
            return problem.robot, {at: _pose(at, problem.robot)}
        motion = resolve(problem)
        vias = {f"via {k}": angles for k, angles in enumerate(motion.vias, start=1)}
        return problem.robot, {"start": motion.start, **vias, "end": motion.end}
    robot = load_robot(source, changes=changes)
    if at is None:
        # The pose that `init` lets the robot's first problem start in.
        return robot, {"start of its first problem": first_motion(robot).start}
    return robot, {at: _pose(at, robot)}


def _pose(text: str, robot: Robot) -> np.ndarray:
    """Joint angles (n,) [rad] of a text such as "0 45deg -0.3", or with commas."""
    import numpy as np

    from stiffopt.problem.limit import Limits
    from stiffopt.problem.resolve import check_range
    from stiffopt.units import fit_joint, joint_to_si

    values = text.split(",") if "," in text else text.split()
    if len(values) != robot.n:
        raise InputError(
            f"--at needs {robot.n} values, one a joint ({', '.join(robot.joint_names)}); got "
            f"{len(values)}."
        )
    angles = []
    for value, name, slides in zip(values, robot.joint_names, robot.prismatic, strict=True):
        angle = joint_to_si(number_or_text(value), "angle", f"--at, {name}")
        angles.append(fit_joint(angle, bool(slides), "angle", f"--at, {name}"))
    pose = np.array(angles)
    check_range(robot, Limits.of(robot), "--at", pose, "; bare numbers are rad, degrees 20deg")
    return pose
