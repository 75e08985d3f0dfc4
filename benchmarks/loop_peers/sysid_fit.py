"""Fit by mujoco.sysid, the system identification that MuJoCo ships: Gauss-Newton over a whole run.

Armature, damping and dry friction of each joint and one delay of all, within the bounds of the
published script for this robot; on request also masses and centres of mass of all links and the
gains of all servos, with the bounds that the script offers for bodies. Needs `mujoco[sysid]`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from mujoco import sysid

from .leg import DAMPING, JOINTS, STIFFNESS, Run, build_spec, initial_state, set_value, simulate

if not hasattr(sysid, "ParameterDict"):
    # MuJoCo alone has an empty package of that name.
    raise ModuleNotFoundError("mujoco lacks its extra sysid")

BOUNDS = {"armature": (0.001, 0.5), "damping": (0.001, 7.0), "frictionloss": (0.001, 1.0)}
DELAY_BOUNDS = (0.0, 0.025)  # [s]
_INITIAL_DELAY = 5e-3  # [s]
_MASS_BOUNDS, _CENTRE_BOUNDS, _GAIN_BOUNDS = (0.5, 5.0), (-0.03, 0.03), (0.5, 2.0)


def _set_joint(joint: str, key: str, spec: Any, parameter: Any) -> None:
    set_value(spec.joint(joint), key, float(parameter.value[0]))


def _set_gain(
    joint: str, apply: Callable[[Any, str, float], object], spec: Any, parameter: Any
) -> None:
    apply(spec, joint, float(parameter.value[0]))


def _parameters(spec: Any, *, bodies: bool) -> Any:
    found, model = sysid.ParameterDict(), spec.compile()
    for joint in JOINTS:
        for key, (low, high) in BOUNDS.items():
            value = float(np.ravel(getattr(spec.joint(joint), key))[0])
            set_value = partial(_set_joint, joint, key)
            found.add(sysid.Parameter(f"{key} {joint}", value, low, high, modifier=set_value))
        if bodies:
            name, factors = f"{joint}_link", np.array(_MASS_BOUNDS)
            found.add(
                sysid.body_inertia_param(
                    spec, model, name, sysid.InertiaType.MassIpos, scale_rot_inertia=True,
                    mass_bound_mult=factors, ipos_bound_off=np.array(_CENTRE_BOUNDS),
                )
            )  # fmt: skip
            for key, value, apply in (
                ("gain", STIFFNESS, sysid.apply_pgain), ("kd", DAMPING, sysid.apply_dgain),
            ):  # fmt: skip
                low, high = value * np.array(_GAIN_BOUNDS)
                own = sysid.Parameter(
                    f"{key} {joint}", value, low, high, modifier=partial(_set_gain, joint, apply)
                )
                found.add(own)
    found.add(sysid.Parameter("delay", _INITIAL_DELAY, *DELAY_BOUNDS))
    return found


def fit(urdf: Any, run: Run, iterations: int, *, bodies: bool = False) -> tuple[Any, ...]:
    """Return a simulation of runs by the fitted model, and the fitted values.

    `bodies`: masses, centres and gains are fitted as well.
    """
    spec = build_spec(urdf)
    model, count = spec.compile(), len(JOINTS)
    steps = np.append(0.0, run.grid)

    def late(given: Any, delay: float) -> Any:
        command = run.mean_command(delay)
        return sysid.TimeSeries(given.times, np.vstack([command, command[-1:]]), None)

    def roll_out(
        control_signal: Sequence[Any], param_dicts: Sequence[Any], **others: Any
    ) -> Sequence[Any]:
        delays = [float(own["delay"].value[0]) for own in param_dicts]
        controls = [late(*each) for each in zip(control_signal, delays, strict=True)]
        return sysid.sysid_rollout(control_signal=controls, **others)

    command = run.mean_command(0.0)
    sequences = sysid.ModelSequences(
        "leg",
        spec,
        "train",
        initial_state(model, run, np.zeros(count)),
        sysid.TimeSeries.from_control_names(steps, np.vstack([command, command[-1:]]), model),
        sysid.TimeSeries.from_names(run.time, run.position, model),
    )
    residual = sysid.build_residual_fn(models_sequences=[sequences], custom_rollout=roll_out)
    parameters = _parameters(spec, bodies=bodies)
    found, _ = sysid.optimize(
        parameters, residual, optimizer="mujoco", verbose=False, max_iters=iterations
    )
    fitted = sysid.apply_param_modifiers(found, spec)
    delay = float(found["delay"].value[0])

    def predict(own: Run) -> np.ndarray:
        none = np.zeros(count)
        return np.asarray(simulate([fitted], own, [own.mean_command(delay)], [none])[0])

    return predict, {name: own.value for name, own in found.items()}
