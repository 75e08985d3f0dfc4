"""External loads: coupling with the previous joint, and contact of the tool."""

from __future__ import annotations

from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import RobotConstants, RobotSignals
from stiffopt.symbolic import smooth_abs

# Height over which the contact force sets in [m].
_CONTACT_ROUNDING = 1e-4


def external_contact_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return -J^T n k max(z - tool height, 0) of a level surface under the tool."""
    depth = shapes[0] - signals.tool_position[..., 2]
    pressed = 0.5 * (depth + smooth_abs(depth, _CONTACT_ROUNDING))
    lever = signals.tool_jacobian[:, 2, :]
    return Term(link_torque=-amplitudes[0] * lever * pressed[:, None])


def _start_heights(constants: RobotConstants) -> tuple[float, ...]:
    low, high = constants.tool_range[:, 2]
    shares = (0.03, 0.08, 0.15, 0.25, 0.4, 0.6)
    return tuple(float(low + share * (high - low)) for share in shares)


WRIST_COUPLING = Effect(
    name="wrist_coupling",
    family="contact",
    scope="joint",
    equation="q_j += c*th_(j-1), tau_(j-1) += c*s_j",
    signature="link angle that moves with the joint before, which carries a share of the torque",
    phrase="coupling with the joint before, {c}",
    remedy="Check the coupling ratio of {where} in the controller's wrist parameters, and"
    " correct it by {c}.",
    needs=("sensor", "moves", "before"),
    # By virtual work the previous joint carries a share of the torque.
    term=lambda signals, a, s: Term(
        deflection=-a[0] * signals.previous_position, previous_torque=a[0] * signals.spring_torque
    ),
    amplitudes=(Amplitude("c", "", 0.01, -5.0, 5.0),),
    applies=lambda constants: constants.joint > 1,
    log_prior=lambda constants: 0.0 if constants.joint > 4 else -1.0,
    separate="Move the joint before while this one stands: an error of its own gear or encoder"
    " does not follow.",
)

EXTERNAL_CONTACT = Effect(
    name="external_contact",
    family="contact",
    scope="robot",
    equation="s += -J^T*n*k*max(z - z_tool, 0)",
    signature="link torques of several joints off together, and only where the tool is low",
    phrase="contact with the surroundings below {z}",
    remedy="Look for what the tool touches below {z}, and record again without it.",
    needs=("torque", "moves", "tool_frame"),
    term=external_contact_term,
    amplitudes=(Amplitude("k", "N/m", 2e4, 0.0, 50.0),),
    shapes=(Shape("z", "m", _start_heights, -10.0, 10.0),),
    separate="Visit one place several times from above, and places beside it: a payload acts"
    " everywhere, a contact only below its height.",
)

CONTACTS = (WRIST_COUPLING, EXTERNAL_CONTACT)
