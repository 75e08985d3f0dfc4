"""Staubli: VAL3 application of joint moves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from stiffopt.export.format import FORMATS, PointFormat, PointStep, identifier
from stiffopt.export.motion import SampledMotion

_XML_HEAD = '<?xml version="1.0" encoding="utf-8"?>\n'
_INSTANCE_SCHEMA = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
_VAL3_SCHEMA = 'xmlns="http://www.staubli.com/robotics/VAL3'
# Distances [mm] from a passed point at which the arm leaves and joins the path.
_BLEND_DISTANCE = 5
_GRIPPER_INSTRUCTIONS = {"grip": "close(tTool)", "release": "open(tTool)"}


class StaubliVal3(PointFormat):
    """Application with joint positions and motion descriptors as data, and programs start and stop.

    Staubli, VAL3 reference manual: jointRx, mdesc, movej, waitEndMove, delay, open and close (which
    act on the valve of a tool); VAL3 XML format of applications: project, data and program files.
    """

    name = "staubli-val3"
    title = "Staubli VAL3"
    maker = "Staubli"

    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Texts of project, data and programs, in a folder of the application's name."""
        name = identifier(motion.title, 15) or "stiffopt"
        steps = self.steps(motion)
        moves = [each for each in steps if each.speed]
        angles = np.degrees(motion.position[[0, *(each.sample for each in moves)]])
        speeds = [("off", 10.0)] + [("off" if each.stop else "joint", each.speed) for each in moves]
        data = [
            _data("jMotion", "jointRx", (_joints(row) for row in angles)),
            _data("mMotion", "mdesc", (_descriptor(*each) for each in speeds)),
            _data("tTool", "tool", ['fatherId="flange[0]" ioLink="valve1"']),
        ]
        head = (
            f"{motion.title}: {motion.which}s, {motion.time[-1]:.4g} s, {rate:g} Hz",
            *self.remarks,
        )
        code = [f"// {line}" for line in head] + ["movej(jMotion[0],tTool,mMotion[0])"]
        project = (
            f'<Project {_VAL3_SCHEMA}/Project/3">\n'
            '  <Parameters version="s7.3.1" stackSize="5000" millimeterUnit="true" />\n'
            '  <Programs>\n    <Program file="start.pgx" />\n    <Program file="stop.pgx" />\n'
            f'  </Programs>\n  <Database>\n    <Data file="{name}.dtx" />\n  </Database>\n'
            "  <Libraries />\n</Project>\n"
        )
        head_line, values = f'<Database {_INSTANCE_SCHEMA} {_VAL3_SCHEMA}/Data/2">', "".join(data)
        table = f"{head_line}\n  <Datas>\n{values}  </Datas>\n</Database>\n"
        return {
            f"{name}/{name}.pjx": _XML_HEAD + project,
            f"{name}/{name}.dtx": _XML_HEAD + table,
            f"{name}/start.pgx": _program("start", [*code, *_instructions(steps), "waitEndMove()"]),
            f"{name}/stop.pgx": _program("stop", ["resetMotion()"]),
        }


def _data(name: str, kind: str, values: Iterable[str]) -> str:
    """Format an array of a data file."""
    rows = [f'      <Value key="{key}" {value} />\n' for key, value in enumerate(values)]
    head = f'    <Data name="{name}" access="private" xsi:type="array" type="{kind}"'
    return f'{head} size="{len(rows)}">\n{"".join(rows)}    </Data>\n'


def _joints(angles: np.ndarray) -> str:
    """Format a joint position [deg]."""
    return " ".join(f'j{axis}="{value:.5f}"' for axis, value in enumerate(angles, start=1))


def _descriptor(blend: str, speed: float) -> str:
    """Format a motion descriptor of a speed [%]."""
    return (
        f'accel="100" vel="{speed:.2f}" decel="100" tmax="99999" rmax="99999" blend="{blend}" '
        f'leave="{_BLEND_DISTANCE}" reach="{_BLEND_DISTANCE}"'
    )


def _instructions(steps: Sequence[PointStep]) -> Iterator[str]:
    """Instructions of the steps after the approach."""
    point = 0
    for step in steps:
        if step.speed:
            point += 1
            yield f"movej(jMotion[{point}],tTool,mMotion[{point}])"
        elif step.event:
            yield f"// {step.event}"
            yield "waitEndMove()"
            if step.event.kind in _GRIPPER_INSTRUCTIONS:
                yield _GRIPPER_INSTRUCTIONS[step.event.kind]
        else:
            yield "waitEndMove()"
            yield f"delay({step.rest:.3f})"


def _program(name: str, code: Iterable[str]) -> str:
    """Format a program file."""
    lines = "\n".join(f"  {line}" for line in code).replace("]]>", "]] >")
    return (
        f'{_XML_HEAD}<Programs {_INSTANCE_SCHEMA} {_VAL3_SCHEMA}/Program/2">\n'
        f'  <Program name="{name}">\n    <Code><![CDATA[begin\n{lines}\nend]]></Code>\n'
        "  </Program>\n</Programs>\n"
    )


FORMATS.add(StaubliVal3())
