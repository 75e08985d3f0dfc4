"""Programs of points that the controller times itself: Staubli VAL3 and Yaskawa INFORM."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.errors import InputError
from stiffopt.export.format import FORMATS, PointFormat, PointStep, identifier
from stiffopt.export.motion import SampledMotion, StoredMotion

_XML_HEAD = '<?xml version="1.0" encoding="utf-8"?>\n'
_INSTANCE_SCHEMA = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
_VAL3_SCHEMA = 'xmlns="http://www.staubli.com/robotics/VAL3'
# Distances [mm] from a passed point at which the arm leaves and joins the path.
_BLEND_DISTANCE = 5
_VAL3_GRIPPER = {"grip": "close(tTool)", "release": "open(tTool)"}


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
            f"{name}/start.pgx": _program(
                "start", [*code, *_val3_instructions(steps), "waitEndMove()"]
            ),
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


def _val3_instructions(steps: Sequence[PointStep]) -> Iterator[str]:
    """Instructions of the steps after the approach."""
    point = 0
    for step in steps:
        if step.speed:
            point += 1
            yield f"movej(jMotion[{point}],tTool,mMotion[{point}])"
        elif step.event:
            yield f"// {step.event}"
            yield "waitEndMove()"
            if step.event.kind in _VAL3_GRIPPER:
                yield _VAL3_GRIPPER[step.event.kind]
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


# The manual has the line in every header and says of none that it may be left out; one date for all
# jobs, so that equal motions are equal files.
_DATE_LINE = "///DATE 2000/01/01 00:00"
# Universal output 1 closes the gripper.
_INFORM_GRIPPER = {"grip": "DOUT OT#(1) ON", "release": "DOUT OT#(1) OFF"}


@dataclass(frozen=True)
class YaskawaJob(PointFormat):
    """Job of MOVJ instructions, one a sample; the first approaches the start.

    Yaskawa, NX100 data transmission manual HW0481924, section 4.1 (job data format): POSTYPE PULSE
    is the one type of robot positions that is joint by joint. FS100 INFORM manual: MOVJ with VJ in
    %, PL=0 to stop at the point, TIMER, DOUT.
    """

    # Pulses per degree of each axis, negative where the URDF turns the other way.
    pulses: tuple[float, ...] = ()

    name = "yaskawa-job"
    title = "Yaskawa INFORM"
    maker = "Yaskawa"

    def with_pulses(self, pulses: Sequence[float]) -> YaskawaJob:
        """Return the format with pulses per degree of each axis."""
        return YaskawaJob(tuple(pulses))

    def check(self, stored: StoredMotion, rate: float) -> None:
        """Require pulses per degree besides."""
        super().check(stored, rate)
        if not self.pulses:
            raise InputError(
                f"--to {self.name}: positions of jobs are in pulses. Give the pulses per degree of "
                "axes S, L, U, R, B and T as --pulses 1341.4,1907.7,...; the pendant shows pulses "
                "beside degrees."
            )
        if len(self.pulses) != 6 or not all(np.isfinite(self.pulses)) or not all(self.pulses):
            raise InputError(
                f"--pulses {','.join(f'{each:g}' for each in self.pulses)}: give 6 numbers that are"
                " not 0, the pulses per degree of axes S, L, U, R, B and T."
            )

    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Text of the job."""
        name = identifier(motion.title, 8).upper() or "STIFFOPT"
        steps = self.steps(motion)
        samples = [0, *(each.sample for each in steps if each.speed)]
        points = np.rint(np.degrees(motion.position[samples]) * self.pulses).astype(int)
        head = (f"{motion.which}s, {motion.time[-1]:.4g} s, {rate:g} Hz", *self.remarks)
        lines = [
            "/JOB",
            f"//NAME {name}",
            "//POS",
            f"///NPOS {len(points)},0,0,0,0,0",
            "///TOOL 0",
            "///POSTYPE PULSE",
            "///PULSE",
            *(f"C{k:05d}={','.join(map(str, row))}" for k, row in enumerate(points)),
            "//INST",
            _DATE_LINE,
            "///ATTR SC,RW",
            "///GROUP1 RB1",
            "NOP",
            *(f"'{line}" for line in head),
            "MOVJ C00000 VJ=10.00 PL=0",
            *_inform_instructions(steps),
            "END",
        ]
        return {f"{name}.JBI": "\r\n".join(lines) + "\r\n"}


def _inform_instructions(steps: Sequence[PointStep]) -> Iterator[str]:
    """Instructions of the steps after the approach."""
    point = 0
    for step in steps:
        if step.speed:
            point += 1
            yield f"MOVJ C{point:05d} VJ={step.speed:.2f}{' PL=0' if step.stop else ''}"
        elif step.event:
            yield f"'{step.event.kind}, then {step.event.mass:.4g} kg"
            if step.event.kind in _INFORM_GRIPPER:
                yield _INFORM_GRIPPER[step.event.kind]
        elif round(step.rest, 2):
            yield f"TIMER T={step.rest:.2f}"


FORMATS.add(YaskawaJob())
