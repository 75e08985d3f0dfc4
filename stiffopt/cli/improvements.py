"""`stiffopt improve`: a given motion on the same path, with limits kept and motors that lead."""

from __future__ import annotations

import os
from pathlib import Path

from stiffopt.cli.base import Changes, Open, Out, app, default_folder, show_report
from stiffopt.errors import InputError
from stiffopt.folders import output_folder
from stiffopt.interrupts import defer_while_writing


@app.command
def improve(
    motion: Path,
    *,
    robot: str | None = None,
    problem: Path | None = None,
    retime: bool = False,
    rate: float | None = None,
    out: Out | None = None,
    changes: Changes = (),
    open_report: Open = False,
) -> int:
    """Improve a given motion: same path, limits kept, motors that lead the links.

    Writes command.csv, trajectory.csv, improvement.json and report.html, which says what the motion
    does wrong as it is: limits, tool error, vibration after arrival.

    Parameters
    ----------
    motion
        Joint positions over time: CSV and other tables, JointTrajectory or RobotTrajectory as YAML
        or JSON, MCAP, rosbag2. Set points are preferred to measured positions.
    robot
        Shipped name, robot file or URDF.
    problem
        Problem file whose robot, payload, tool, limits, servo and uncertainty are taken instead.
    retime
        Time the motion anew, as fast as the limits allow; default: slow it only where it exceeds a
        limit.
    rate
        Rows a second [Hz], if no column of the file is a time.
    out
        Folder for the results; default: out/NAME-improved.
    """
    from stiffopt.improvement.given_motion import GivenMotion
    from stiffopt.improvement.improvement import improve as improve_motion
    from stiffopt.improvement.improvement_files import write_improvement
    from stiffopt.path.load import load_problem
    from stiffopt.problem.limit import Limits
    from stiffopt.report.pages.improvement import print_improvement, write_improvement_report
    from stiffopt.result.compensation import COMMAND_FILE
    from stiffopt.result.store import TRAJECTORY_FILE
    from stiffopt.robot.files import load_robot
    from stiffopt.starter.timed_motion import read_timed_motion

    if (robot is None) == (problem is None):
        raise InputError(
            "improve needs the arm of the motion: give either --robot (a shipped name, robot file "
            "or URDF) or --problem (a problem file with payload, tool and limits)."
        )
    folder = out or default_folder(f"{motion.stem}-improved", changes)
    given_arm = Path(str(robot if problem is None else problem))
    origin = {
        "title": motion.stem,
        "robot" if problem is None else "problem": Path(
            os.path.relpath(given_arm, folder)
        ).as_posix()
        if given_arm.is_file()
        else str(given_arm),
        "changes": list(changes),
    }
    if problem is not None:
        settings = load_problem(problem, changes).problem
        arm = settings.robot
    else:
        settings, arm = None, load_robot(str(robot), changes=changes)
    read = read_timed_motion(motion, arm, rate)
    jerk_max = (Limits.of(arm) if settings is None else settings.active_limits).jerk
    given = GivenMotion(read.time, read.position, read.velocity, read.acceleration, jerk_max)
    maybe = (COMMAND_FILE, TRAJECTORY_FILE)
    with output_folder(folder, "improve", maybe=maybe) as stage:
        found = improve_motion(arm, given, retime=retime, settings=settings)
        with defer_while_writing():
            write_improvement_report(motion.stem, found, stage, read.reasons)
            write_improvement(found, stage, origin)
    print_improvement(found, folder, read.reasons)
    show_report(folder, open_report)
    return 0 if found.kept else 3
