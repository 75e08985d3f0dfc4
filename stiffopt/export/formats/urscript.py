"""URScript: program of servoj commands for arms of Universal Robots."""

from __future__ import annotations

import numpy as np

from stiffopt.errors import InputError
from stiffopt.export.format import FORMATS, CyclicFormat, identifier
from stiffopt.export.motion import SampledMotion, StoredMotion

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
