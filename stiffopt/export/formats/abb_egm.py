"""ABB: RAPID module that approaches the start, and joint positions for EGM."""

from __future__ import annotations

import numpy as np

from stiffopt.export.format import FORMATS, CyclicFormat, identifier, rows_text
from stiffopt.export.motion import SampledMotion

_AXIS_NAMES = tuple(f"J{axis}" for axis in range(1, 7))
_EXTERNAL_AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"


class AbbEgm(CyclicFormat):
    """Absolute joint positions in degrees, one row a cycle, and the RAPID module that takes them.

    ABB, Externally Guided Motion (application manual): EGMSetupUC, EGMActJoint and EGMRunJoint; a
    cycle of 4 ms. The sender of the rows over UDP (EgmSensor messages) and the UdpUc device
    "EGMSensor" belong to the cell.
    """

    name = "abb-egm"
    title = "ABB EGM"
    maker = "ABB"
    rate = 250.0
    rate_max = 250.0

    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Texts of module and rows."""
        name = identifier(motion.title, 16)
        name = f"stiffopt_{name}".rstrip("_")
        angles = np.degrees(motion.position)
        start, end = (
            f"[[{','.join(f'{value:.4f}' for value in row)}],{_EXTERNAL_AXES}]"
            for row in (angles[0], angles[-1])
        )
        module = [
            f"MODULE {name}",
            f"  ! Motion of the {motion.which}s, {rate:g} Hz, {motion.time[-1]:g} s.",
            f"  ! Send one row of {name}_egm.csv a cycle as planned joints; signs and zeros are",
            "  ! those of the URDF: compare them with the controller's before the first run.",
            *(f"  ! Event: {event}; the sender of the rows triggers it" for event in motion.events),
            f"  CONST jointtarget start_pose:={start};",
            f"  CONST jointtarget end_pose:={end};",
            "  VAR egmident guide;",
            "  CONST egm_minmax converged:=[-0.01,0.01];",
            "  PROC main()",
            "    MoveAbsJ start_pose,v50,fine,tool0;",
            "    EGMGetId guide;",
            '    EGMSetupUC ROB_1,guide,"default","EGMSensor"\\Joint;',
            "    EGMActJoint guide\\J1:=converged\\J2:=converged\\J3:=converged\\J4:=converged"
            "\\J5:=converged\\J6:=converged\\LpFilter:=0\\SampleRate:=4\\MaxPosDeviation:=1000;",
            "    EGMRunJoint guide,EGM_STOP_HOLD\\J1\\J2\\J3\\J4\\J5\\J6\\CondTime:=0.5"
            "\\RampInTime:=0;",
            "    EGMReset guide;",
            "    MoveAbsJ end_pose,v50,fine,tool0;",
            "  ENDPROC",
            "ENDMODULE",
        ]
        return {
            f"{name}.mod": "\n".join(module) + "\n",
            f"{name}_egm.csv": rows_text(_AXIS_NAMES, angles),
        }


FORMATS.add(AbbEgm())
