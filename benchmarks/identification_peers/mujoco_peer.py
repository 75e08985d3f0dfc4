"""mujoco.sysid: parameters declared by hand, fitted to torques of its own inverse dynamics.

Declared of every joint: damping, frictionloss, armature, and an offset of the torque; of every
body: its pseudo-inertia, in the toolbox's own bounds. Recordings are of closed loops, which a
simulation driven by the torques leaves within a second: hence `mj_inverse` in place of the rollout.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from given import Given, Samples, answer
from mujoco import sysid

MOST, ITERATIONS = 1200, 30
# Least of a moving body, where a URDF has none [kg, kg m^2].
MASS, INERTIA = 1e-3, 1e-4
# Friction's dead band is this time constant [s], so narrow that its sign is that of the speed.
SHARP = 0.002


def spec_of(given: Given) -> mujoco.MjSpec:
    """The URDF as MuJoCo reads it, with a motor and a torque sensor of every joint."""
    spec = mujoco.MjSpec.from_file(given.urdf)
    spec.compiler.boundmass, spec.compiler.boundinertia = MASS, INERTIA
    spec.option.timestep = SHARP / 2.0
    for name in given.joints:
        spec.joint(name).solref_friction = [SHARP, 1.0]
        spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        spec.add_sensor(
            name=f"torque_{name}",
            type=mujoco.mjtSensor.mjSENS_JOINTACTFRC,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
    return spec


def declared(given: Given, spec: mujoco.MjSpec) -> sysid.ParameterDict:
    """What a user declares, with bounds from the sizes of what was measured."""
    parameters = sysid.ParameterDict()
    for j, name in enumerate(given.joints):
        used, band = given.moving(j), given.band_of[j]
        torque = given.train.torque[used, j]
        if not torque.size:
            continue
        most = float(np.abs(torque).max())
        speed, acceleration = (
            values[band, used, j].std() for values in (given.train.v, given.train.a)
        )
        rotor = float(given.rotor_inertia[j])
        bounds = {
            "damping": (0.01 * most / speed, 3.0 * most / speed),
            "frictionloss": (0.01 * most, most),
            "armature": (
                max(rotor, 0.01 * most / acceleration),
                max(3.0 * rotor, 3.0 * most / acceleration),
            ),
        }
        for what, (start, high) in bounds.items():

            def write(spec: mujoco.MjSpec, found: Any, name: str = name, what: str = what) -> None:
                value = float(found.value[0])
                setattr(spec.joint(name), what, [value, 0.0, 0.0] if what == "damping" else value)

            parameters.add(sysid.Parameter(f"{what}_{name}", start, 0.0, high, modifier=write))
        parameters.add(sysid.Parameter(f"offset_{name}", 0.0, -most, most))
    model = spec.copy().compile()
    for name in given.joints:
        body = model.body(model.joint(name).bodyid[0]).name

        def body_write(spec: mujoco.MjSpec, found: Any, body: str = body) -> None:
            sysid.apply_body_inertia(spec, body, found)
            # It leaves nan there, which mujoco 4.0.0 does not take.
            spec.body(body).iquat = [1.0, 0.0, 0.0, 0.0]

        parameters.add(
            sysid.body_inertia_param(
                spec.copy(),
                model,
                body,
                inertia_type=sysid.InertiaType.Pseudo,
                modifier=body_write,
            )
        )
    return parameters


def inverse(given: Given, model: mujoco.MjModel, samples: Samples, rows: np.ndarray) -> np.ndarray:
    """Torques of MuJoCo's inverse dynamics (rows, n), each joint in its own band."""
    data = mujoco.MjData(model)
    columns = np.array([model.joint(name).dofadr[0] for name in given.joints])
    out = np.empty((len(rows), len(columns)))
    for band in np.unique(given.band_of):
        own = np.flatnonzero(given.band_of == band)
        for k, row in enumerate(rows):
            data.qpos[columns] = samples.q[band, row]
            data.qvel[columns] = samples.v[band, row]
            data.qacc[columns] = samples.a[band, row]
            mujoco.mj_inverse(model, data)
            out[k, own] = data.qfrc_inverse[columns[own]]
    return out


def offsets(given: Given, parameters: sysid.ParameterDict) -> np.ndarray:
    """Of the torque of every joint (n,)."""
    names = [f"offset_{name}" for name in given.joints]
    return np.array([parameters[n].value[0] if n in parameters else 0.0 for n in names])


def predict(given: Given) -> tuple[np.ndarray, str]:
    """All joints."""
    spec = spec_of(given)
    parameters = declared(given, spec.copy())
    total = len(given.train.torque)
    rows = np.linspace(0, total - 1, min(MOST, total)).astype(int)
    counts = np.column_stack([given.moving(j)[rows] for j in range(len(given.joints))])
    measured = np.where(counts, given.train.torque[rows], 0.0)
    size = np.array(
        [c[u].std() if u.any() else 1.0 for c, u in zip(measured.T, counts.T, strict=True)]
    )
    model = spec.copy().compile()
    times = np.arange(float(len(rows)))
    names = [f"torque_{name}" for name in given.joints]
    series = sysid.TimeSeries.from_names(times, measured, model, names)
    state = np.column_stack([times, np.zeros((len(rows), 2 * len(names)))])

    def rollout(models: Any, control_signal: Any, initial_states: Any, **_: Any) -> list[Any]:
        return [
            sysid.SystemTrajectory(
                model=each,
                control=control,
                sensordata=sysid.TimeSeries(
                    times, inverse(given, each, given.train, rows), series.signal_mapping
                ),
                initial_state=start,
                state=sysid.TimeSeries(times, state),
            )
            for each, control, start in zip(models, control_signal, initial_states, strict=True)
        ]

    def residual(
        found: Any, predicted: Any, recorded: Any, model: Any, every: bool, **_: Any
    ) -> tuple[np.ndarray, Any, Any]:
        left = predicted.data + offsets(given, found) - recorded.data
        return np.where(counts, left / size, 0.0), predicted, recorded

    start = sysid.create_initial_state(model, np.zeros(model.nq), np.zeros(model.nv), np.zeros(0))
    sequences = sysid.ModelSequences(
        "arm",
        spec,
        "train",
        start,
        sysid.TimeSeries.from_control_names(times, measured, model, list(given.joints)),
        series,
    )

    def build(found: Any, spec: Any) -> mujoco.MjModel:
        # A copy, as modifiers write into what they are given.
        return sysid.apply_param_modifiers(found, spec.copy())

    objective = sysid.build_residual_fn(
        models_sequences=[sequences],
        build_model=build,
        custom_rollout=rollout,
        modify_residual=residual,
        resample_true=False,
        n_threads=1,
    )
    found, _ = sysid.optimize(
        parameters, objective, verbose=False, max_iters=ITERATIONS, x_scale="jac"
    )
    after = build(found, spec)
    torque = inverse(given, after, given.test, np.arange(len(given.test.nominal)))
    return torque + offsets(given, found), f"{found.size} values"


if __name__ == "__main__":
    answer(predict)
