"""Fanuc: TP program that approaches the start, and joint positions for stream motion."""

from __future__ import annotations

import numpy as np

from stiffopt.export.format import FORMATS, CyclicFormat, rows_text
from stiffopt.export.motion import SampledMotion

_AXIS_NAMES = tuple(f"J{axis}" for axis in range(1, 7))


class FanucStream(CyclicFormat):
    """Absolute joint positions in degrees, one row a cycle, and the TP program that takes them.

    Fanuc, Stream Motion option J519 (operator's manual): IBGN start and IBGN end; a cycle of 8 ms,
    4 ms on R-30iB Plus. The sender of the packets belongs to the cell.
    """

    name = "fanuc-stream"
    title = "Fanuc stream motion"
    maker = "Fanuc"
    rate = 125.0
    rate_max = 250.0

    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Texts of program and rows."""
        angles = np.degrees(motion.position)
        lines = [
            f"!{rate:g} Hz, {motion.time[-1]:.4g} s, {motion.which}s",
            "!J3 of Fanuc turns with J2",
            *(f"!{event.kind} {event.time:.3f} s"[:32] for event in motion.events),
            "J P[1] 10% FINE",
            "IBGN start[1]",
            "IBGN end[1]",
        ]
        start = ",\n".join(
            f"\tJ{axis}= {value:.6f} deg" for axis, value in enumerate(angles[0], start=1)
        )
        program = [
            "/PROG  STIFFOPT",
            "/ATTR",
            'COMMENT = "stream motion";',
            "/MN",
            *(f"{number:4d}:  {line} ;" for number, line in enumerate(lines, start=1)),
            "/POS",
            "P[1]{",
            "   GP1:",
            "\tUF : 0, UT : 1,",
            start,
            "};",
            "/END",
        ]
        return {
            "stiffopt.ls": "\n".join(program) + "\n",
            "stiffopt_stream.csv": rows_text(_AXIS_NAMES, angles),
        }


FORMATS.add(FanucStream())
