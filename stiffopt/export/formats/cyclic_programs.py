"""Programs that approach the start and follow one row a controller cycle.

ABB EGM, Fanuc stream motion, KUKA RSI and URScript of Universal Robots.
"""

from __future__ import annotations

import numpy as np

from stiffopt.errors import InputError
from stiffopt.export.format import FORMATS, CyclicFormat, identifier, rows_text
from stiffopt.export.motion import SampledMotion, StoredMotion

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


_KUKA_AXES = tuple(f"A{axis}" for axis in range(1, 7))


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
                _KUKA_AXES, corrections.min(axis=0), corrections.max(axis=0), strict=True
            )
        )
        start = ", ".join(
            f"{axis} {value:.6f}" for axis, value in zip(_KUKA_AXES, angles[0], strict=True)
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
            f"{name}_rsi.csv": rows_text(_KUKA_AXES, corrections),
        }


def _halt_on_error() -> list[str]:
    """KRL lines that halt on an RSI error."""
    return ["IF (ret <> RSIOK) THEN", "  HALT", "ENDIF"]


FORMATS.add(KrlRsi())


# Position range of these arms: one turn to either side [rad].
_MAX_ANGLE = 2.0 * np.pi
# Digital output 0 of the tool closes the gripper.
_GRIPPER_OUTPUTS = {"grip": "True", "release": "False"}


class UrScript(CyclicFormat):
    """Slow approach to the start, then one servoj per cycle.

    Universal Robots, The URScript Programming Language: servoj(q, a, v, t, lookahead_time in 0.03
    to 0.2 s, gain in 100 to 2000). e-Series controllers have a cycle of 2 ms, CB3 of 8 ms.
    """

    name = "urscript"
    title = "URScript"
    maker = "Universal Robots"
    rate = 500.0
    rate_max = 500.0

    def check(self, stored: StoredMotion, rate: float) -> None:
        """Require six revolute joints within one turn and a whole number of cycles."""
        super().check(stored, rate)
        motion = stored.sampled(rate)
        largest = np.max(np.abs(motion.position), axis=0)
        for j in np.flatnonzero(largest > _MAX_ANGLE):
            raise InputError(
                f"joint {j + 1} ({stored.joint_names[j]}) reaches {largest[j]:.4g} rad; arms of "
                "Universal Robots turn by 2 pi rad to either side. Change its range in [limits]."
            )

    def files(self, motion: SampledMotion, rate: float) -> dict[str, str]:
        """Text of the program."""
        name = identifier(motion.title, 40)
        name = f"stiffopt_{name}"
        poses = [f"[{', '.join(f'{angle:.9f}' for angle in row)}]" for row in motion.position]
        # Arguments of servoj. The shortest look-ahead time [s] rounds and delays the motion least;
        # the gain is the controller's default.
        follow = f"t={1.0 / rate:g}, lookahead_time=0.03, gain=300"
        lines = [
            f"# {motion.title}: motion of the {motion.which}s, {rate:g} Hz, {motion.time[-1]:g} s.",
            f"# Joints: {', '.join(motion.joint_names)}. Try it at reduced speed first.",
            f"def {name}():",
            f"  movej({poses[0]}, a=0.5, v=0.25)",
            *_follow_lines(motion, poses, follow),
            "  stopj(2.0)",
            "end",
            f"{name}()",
        ]
        return {"motion.script": "\n".join(lines) + "\n"}


def _follow_lines(motion: SampledMotion, poses: list[str], follow: str) -> list[str]:
    """One servoj a cycle, with the events of the gripper before the cycle that follows them."""
    lines = []
    for k in range(1, len(poses)):
        for event in motion.events_until(k):
            lines.append(f"  # {event}")
            if event.kind in _GRIPPER_OUTPUTS:
                lines.append(f"  set_tool_digital_out(0, {_GRIPPER_OUTPUTS[event.kind]})")
            lines.append(f"  set_payload_mass({event.mass:g})")
        lines.append(f"  servoj({poses[k]}, {follow})")
    return lines


FORMATS.add(UrScript())
