"""KUKA: KRL program that approaches the start, and axis corrections for RSI."""

from __future__ import annotations

import numpy as np

from stiffopt.export.format import FORMATS, CyclicFormat, identifier, rows_text
from stiffopt.export.motion import SampledMotion

_AXIS_NAMES = tuple(f"A{axis}" for axis in range(1, 7))


class KrlRsi(CyclicFormat):
    """Absolute axis corrections from the start in degrees, one row per cycle.

    KUKA.RobotSensorInterface: a cycle of 4 ms (IPO_FAST) or 12 ms; with RSI_ON(#ABSOLUTE) a
    correction is relative to the start of the sensor-guided motion. The sender of the rows over
    Ethernet and the correction limits of the RSI context belong to the cell.
    """

    name = "krl-rsi"
    title = "KUKA RSI"
    maker = "KUKA"
    rate = 250.0
    rate_max = 250.0

    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Texts of program and rows; the program's head states the range of each correction."""
        name = identifier(motion.title, 12)
        name = f"stiffopt_{name}".rstrip("_")
        angles = np.degrees(motion.position)
        corrections = angles - angles[0]
        spans = ", ".join(
            f"{axis} {low:.3f} to {high:.3f}"
            for axis, low, high in zip(
                _AXIS_NAMES, corrections.min(axis=0), corrections.max(axis=0), strict=True
            )
        )
        start = ", ".join(
            f"{axis} {value:.6f}" for axis, value in zip(_AXIS_NAMES, angles[0], strict=True)
        )
        # KRL sources are ASCII.
        title = motion.title.encode("ascii", "replace").decode()
        program = [
            "&ACCESS RVP",
            f"DEF {name}( )",
            f"; {title}: motion of the {motion.which}s, {rate:g} Hz, {motion.time[-1]:g} s",
            f"; Send one row of {name}_rsi.csv a cycle as AKorr; signs and zeros of the axes are",
            "; those of the URDF: compare them with the controller's before the first run.",
            f"; Corrections [deg]: {spans}",
            *(f"; Event: {event}; the sender of the rows triggers it" for event in motion.events),
            "DECL INT ret",
            "DECL INT context",
            "BAS (#INITMOV,0)",
            "BAS (#VEL_PTP,10)",
            f"PTP {{{start}}}",
            f'ret = RSI_CREATE("{name}.rsi", context, TRUE)',
            *_halt_on_error(),
            "ret = RSI_ON(#ABSOLUTE)",
            *_halt_on_error(),
            "RSI_MOVECORR()",
            "ret = RSI_OFF()",
            *_halt_on_error(),
            "END",
        ]
        return {
            f"{name}.src": "\n".join(program) + "\n",
            f"{name}_rsi.csv": rows_text(_AXIS_NAMES, corrections),
        }


def _halt_on_error() -> list[str]:
    """KRL lines that halt on an RSI error."""
    return ["IF (ret <> RSIOK) THEN", "  HALT", "ENDIF"]


FORMATS.add(KrlRsi())
