"""Yaskawa: INFORM job of joint moves, positions in pulses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.errors import InputError
from stiffopt.export.format import FORMATS, PointFormat, PointStep, identifier
from stiffopt.export.motion import SampledMotion, StoredMotion

# The manual has the line in every header and says of none that it may be left out; one date for all
# jobs, so that equal motions are equal files.
_DATE_LINE = "///DATE 2000/01/01 00:00"
# Universal output 1 closes the gripper.
_GRIPPER_INSTRUCTIONS = {"grip": "DOUT OT#(1) ON", "release": "DOUT OT#(1) OFF"}


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
            *_instructions(steps),
            "END",
        ]
        return {f"{name}.JBI": "\r\n".join(lines) + "\r\n"}


def _instructions(steps: Sequence[PointStep]) -> Iterator[str]:
    """Instructions of the steps after the approach."""
    point = 0
    for step in steps:
        if step.speed:
            point += 1
            yield f"MOVJ C{point:05d} VJ={step.speed:.2f}{' PL=0' if step.stop else ''}"
        elif step.event:
            yield f"'{step.event.kind}, then {step.event.mass:.4g} kg"
            if step.event.kind in _GRIPPER_INSTRUCTIONS:
                yield _GRIPPER_INSTRUCTIONS[step.event.kind]
        elif round(step.rest, 2):
            yield f"TIMER T={step.rest:.2f}"


FORMATS.add(YaskawaJob())
