"""One case from its specification: the true robot, its recordings and the sealed truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import (  # noqa: F401
    effects_elastic,
    effects_friction,
    effects_laws,
    effects_load,
    effects_outside,
    effects_sensor,
    effects_timing,
)
from .effects import apply
from .integrator import integrate
from .motion import nominal_torque, references, run_plans
from .other_machines import ROBOTS
from .robots import Robot
from .spec import Case, CaseSpec, RunRecord, Trace
from .world import Signals, World, true_world

_STREAMS = ("plans", "motion", "tolerance", "noise", "effects")


def build_world(spec: CaseSpec) -> tuple[World, dict[str, object]]:
    """The true robot and the truth about it, before anything moves."""
    robot = ROBOTS[spec.robot]
    if spec.payload is not None:
        robot = replace(robot, payload_mass=spec.payload)
    streams = _streams(spec)
    plans = run_plans(spec, robot.joints, streams["plans"])
    motion = references(spec, robot, plans, streams["motion"])
    step = 1.0 / (spec.rate * spec.substeps)
    torque = np.array([nominal_torque(robot, path, step, spec.substeps) for path in motion])
    world = true_world(spec, robot, plans, motion, torque, streams["tolerance"])
    draws = streams["effects"].spawn(max(len(spec.effects), 1))
    lines = [
        apply(world, name, joint, severity, draw)
        for (name, joint, severity), draw in zip(spec.effects, draws, strict=False)
    ]
    truth: dict[str, object] = {
        "case": spec.case_name,
        "robot": spec.robot,
        "seed": spec.seed,
        "none": not lines,
        "pair": len(lines) > 1,
        "out_of_library": any(line["outside"] for line in lines),
        "severity": max((line["severity"] for line in lines), default=0.0),
        "effects": lines,
        "families": [line["family"] for line in lines],
        "true_tolerances": world.tolerances,
    }
    return world, truth


def _streams(spec: CaseSpec) -> dict[str, np.random.Generator]:
    children = np.random.SeedSequence(spec.seed).spawn(len(_STREAMS))
    return {name: np.random.default_rng(s) for name, s in zip(_STREAMS, children, strict=True)}


def noise_levels(spec: CaseSpec, robot: Robot) -> dict[str, object]:
    """One standard deviation of each sensor's noise, and its counts."""
    return {
        "torque": robot.torque_noise * spec.noise,
        "velocity": robot.velocity_noise * spec.noise,
        "link_position": robot.link_noise * spec.noise,
        "position_resolution": robot.motor_count,
        "link_position_resolution": robot.link_count,
    }


def _sense(world: World, trace: Trace, rng: np.random.Generator) -> tuple[RunRecord, ...]:
    spec, robot = world.spec, world.robot
    signals = Signals(
        torque=trace.command.copy(),
        link=trace.link + world.link_zero,
        step=trace.step,
        plans=world.plans,
    )
    for read in world.sensors:
        read(signals)
    every = slice(None, round(spec.seconds * spec.rate) * spec.substeps, spec.substeps)
    motor, speed = trace.motor[:, every], trace.motor_velocity[:, every]
    torque, link = signals.torque[:, every], signals.link[:, every]
    noisy_torque = torque + spec.noise * robot.torque_noise * rng.standard_normal(torque.shape)
    noisy_speed = speed + spec.noise * robot.velocity_noise * rng.standard_normal(speed.shape)
    noisy_link = link + spec.noise * robot.link_noise * rng.standard_normal(link.shape)
    counted = np.round(motor / robot.motor_count) * robot.motor_count
    counted_link = np.round(noisy_link / robot.link_count) * robot.link_count
    time = np.arange(motor.shape[1]) / spec.rate
    runs = []
    for r, plan in enumerate(world.plans):
        columns, clean = {"t": time}, {"t": time}
        for j in range(robot.joints):
            names = (f"q{j + 1}", f"qd{j + 1}", f"tau{j + 1}", f"ql{j + 1}")
            read_out = (counted, noisy_speed, noisy_torque, counted_link)
            exact = (motor, speed, torque, link)
            for name, values, pure in zip(names, read_out, exact, strict=True):
                if name.startswith("ql") and not spec.link_encoders:
                    continue
                columns[name], clean[name] = values[r, :, j].copy(), pure[r, :, j].copy()
        runs.append(RunRecord(plan=plan, columns=columns, clean=clean))
    return tuple(runs)


def simulate(spec: CaseSpec) -> Case:
    """Make all recordings of a case."""
    world, truth = build_world(spec)
    trace = integrate(world)
    runs = _sense(world, trace, _streams(spec)["noise"])
    return Case(
        spec=spec,
        robot=world.robot,
        runs=runs,
        truth=truth,
        trace=trace,
        noise=noise_levels(spec, world.robot),
    )
