"""What to record next: about the largest part that is open."""

from __future__ import annotations

from stiffopt.discovery.judging.unexplained import Unexplained

# By what a remainder follows, how to repeat a motion so that its cause shows.
_REPEAT = {
    "session_time": "cold and after half an hour of work",
    "time": "once more without a change, to see what repeats",
    "q": "with joint {} in three other places",
    "qd": "at three speeds up to the fastest",
    "qdd": "once in short, hard accelerations and once in long, soft ones",
    "torque": "with two payloads",
}


def next_recording(unexplained: Unexplained) -> str:
    """The motion that would show most of what nothing explains yet.

    Parameters
    ----------
    unexplained : Unexplained
    """
    kind, _, joint = unexplained.channels[0].rpartition("_")
    words = "torque" if kind == "torque" else "link encoder"
    repeats = []
    for regressor in unexplained.regressors:
        signal, _, of = regressor.partition(" x ")[0].rpartition("_")
        how = _REPEAT.get(regressor, _REPEAT.get(signal, ""))
        if how and not (signal == "q" and of == joint):
            repeats.append(how.format(of))
    text = (
        f"Most of what is open is in the {words} of joint {joint}: move that joint alone through"
        " its stroke, slowly and both ways, the others at rest"
    )
    if repeats:
        text += f"; then {', '.join(dict.fromkeys(repeats))}"
    return f"{text}."
