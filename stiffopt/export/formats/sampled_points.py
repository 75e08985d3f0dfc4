"""Points of a sampled motion: CSV, and trajectory_msgs/msg/JointTrajectory of ROS 2 as YAML."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterable
from importlib import resources

import numpy as np

from stiffopt.export.format import FORMATS, ExportFormat
from stiffopt.export.motion import SampledMotion


class Csv(ExportFormat):
    """CSV file with one header row, SI numbers with full precision; events if there are any."""

    name = "csv"
    title = "CSV"
    rate = 500.0
    rate_max = 20000.0

    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Text of the one file."""
        names = ["time"]
        for suffix in ("", "_velocity", "_acceleration"):
            names += [f"{joint}{suffix}" for joint in motion.joint_names]
        columns = [motion.time[:, None], motion.position, motion.velocity, motion.acceleration]
        rows = np.hstack(columns).tolist()
        if motion.events:
            names.append("event")
            for k, row in enumerate(rows):
                row.append(" ".join(each.kind for each in motion.events_until(k)))
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(rows)
        return {f"{motion.which}.csv": text.getvalue()}


FORMATS.add(Csv())


MESSAGE_FILE, SCRIPT_FILE = "joint_trajectory.yaml", "publish_trajectory.py"


class Ros2(ExportFormat):
    """Message fields in their order; efforts stay empty.

    Fields after https://github.com/ros2/common_interfaces, trajectory_msgs: JointTrajectory and
    JointTrajectoryPoint. Controllers refuse points whose times do not increase, and some refuse
    efforts, so the list of efforts stays empty.
    """

    name = "ros2"
    title = "a ROS 2 joint trajectory"
    rate = 500.0
    rate_max = 20000.0

    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Text of the message."""
        lines = [
            f"# {motion.title}: motion of the {motion.which}s at {rate:g} Hz, "
            "trajectory_msgs/msg/JointTrajectory. Run it with:",
            f"# python3 {SCRIPT_FILE}",
            *(f"# Event: {event}; the message has no field for it." for event in motion.events),
            'header: {stamp: {sec: 0, nanosec: 0}, frame_id: ""}',
            f"joint_names: {json.dumps(list(motion.joint_names), ensure_ascii=False)}",
            "points:",
        ]
        rows = zip(
            motion.time, motion.position, motion.velocity, motion.acceleration, strict=True
        )  # fmt: skip
        for time, position, velocity, acceleration in rows:
            seconds, nanoseconds = divmod(round(float(time) * 10**9), 10**9)
            lines += [
                f"- positions: {_format_numbers(position)}",
                f"  velocities: {_format_numbers(velocity)}",
                f"  accelerations: {_format_numbers(acceleration)}",
                "  effort: []",
                f"  time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}",
            ]
        return {MESSAGE_FILE: "\n".join(lines) + "\n"}

    def programs(self, texts: dict[str, str]) -> dict[str, str]:
        """Script that publishes the message, which is too long for a command line."""
        script = (
            resources.files("stiffopt.export").joinpath("publish_trajectory.py.txt").read_text()
        )
        content = hashlib.sha256(texts[MESSAGE_FILE].encode()).hexdigest()
        return {SCRIPT_FILE: script.replace("@FILE@", MESSAGE_FILE).replace("@SHA256@", content)}


def _format_numbers(values: Iterable[float]) -> str:
    """Format a list of floats; YAML reads 1e-05 as text, 1.0e-05 as a number."""
    texts = [repr(float(value)) for value in values]
    exact = [t if "." in t or "e" not in t else t.replace("e", ".0e") for t in texts]
    return f"[{', '.join(exact)}]"


FORMATS.add(Ros2())
