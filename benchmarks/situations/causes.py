"""What is concealed in a situation: its size, and the findings that name it rightly."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .world import World

# Friction and rotors of every real joint, which a URDF lacks: no cause.
FRICTION = ("coulomb", "viscous", "stribeck", "lubricated_friction")
USUAL = (*FRICTION, "rotor_inertia")
SESSION = ("cold_start", "untimed_cold_start")
OF_RUNS = ("friction_in_runs", "friction_drift")
# Kinds that take the same property of the world, or hide each other: not drawn together.
_APART = (
    {"friction", "odd_run", "last_runs", "warm_up"},
    {"joint_late", "all_late", "filtered"},
    {"tilt3", "tilt12"},
    {"payload", "part", "force"},
)
_ALONE = ("asymmetric", "zero", "gain", "limit", "drag", "push", "spring", "leak", "dead")
CAUSES = tuple(sorted({*_ALONE}.union(*_APART)))


@dataclass(frozen=True)
class Truth:
    """Effects that name it, the joint (from 1) where it has one, and values by parameter."""

    kind: str
    effects: tuple[str, ...]
    joint: int | None = None
    values: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Programme:
    """Runs of a set: torques asked for without a cause (K, n), number of runs, session time [s]."""

    torques: np.ndarray
    runs: int
    session: float


def go_together(first: str, second: str) -> bool:
    """True where both can be told in one situation."""
    return first != second and not any({first, second} <= group for group in _APART)


def conceal(  # noqa: C901, PLR0912  one kind a case
    kind: str, world: World, rng: np.random.Generator, plan: Programme
) -> Truth:
    """Put a cause into the world; return what names it."""
    arm, n = world.arm, len(world.arm.masses)
    j = int(rng.integers(0 if "friction" in kind else 1, min(5, n - 1)))
    here, weight = np.eye(n)[j], 9.81 * float(arm.masses.sum())
    way = rng.normal(size=3)
    way = way / np.linalg.norm(way)
    part = float(rng.uniform(1.0, 3.0)) * min(1.0, weight / 200.0)
    match kind:
        case "friction":
            world.friction = lambda run, session: 1.0 + 0.5 * here
            return Truth("friction x 1.5", FRICTION[:1], j + 1, {"dFc": 1.5 * arm.dry[j]})
        case "odd_run":
            odd = int(rng.integers(1, plan.runs - 2))
            world.friction = lambda run, session: 1.0 + here * (run == odd)
            return Truth(f"friction x 2 in run {odd + 1}", OF_RUNS, j + 1)
        case "last_runs":
            world.friction = lambda run, session: 1.0 + here * (run >= plan.runs - 2)
            return Truth("friction x 2 in the last runs", (*OF_RUNS, *SESSION), j + 1)
        case "warm_up":
            tau = 0.4 * plan.session
            world.friction = lambda run, session: 1.0 + here * np.exp(-session / tau)
            return Truth("warm-up over the session", SESSION, j + 1, {"tau_w": tau})
        case "asymmetric":
            world.asymmetry = 0.3 * here
            return Truth("asymmetric friction", ("asym_friction", "torque_offset"), j + 1)
        case "drag":
            drag = 8.0 * arm.dry[j] / arm.speeds[j] ** 2
            world.drag = drag * here
            return Truth("drag", ("quadratic_drag",), j + 1, {"D": drag})
        case "payload":
            world.payload, world.payload_at = part, np.array([rng.uniform(0.0, 0.08), 0.0, 0.02])
            return Truth("payload", ("payload", "inertial_error"), None, {"dm": part})
        case "part":
            world.carried, world.carried_at = part, np.array([0.06, 0.0, 0.0])
            return Truth("part carried", ("carried_part",), None, {"m": part})
        case "force":
            world.force = 0.08 * weight * way
            values = dict(zip(("fx", "fy", "fz"), world.force.tolist(), strict=True))
            return Truth("force at the tool", ("tool_force",), None, values)
        case "push":
            world.push_run, world.push = int(rng.integers(0, plan.runs - 1)), 0.12 * weight * way
            return Truth(f"push in run {world.push_run + 1}", ("episode",))
        case "tilt3" | "tilt12":
            world.tilt = np.radians(float(kind[4:])) * way[:2] / np.linalg.norm(way[:2])
            values = dict(zip(("rx", "ry"), world.tilt.tolist(), strict=True))
            return Truth(f"base tilt {kind[4:]} deg", ("base_tilt",), None, values)
        case "spring":
            stiffness = 0.3 * float(np.max(np.abs(plan.torques[:, 1])))
            world.spring, world.spring_at = stiffness * np.eye(n)[1], float(rng.uniform(-0.3, 0.3))
            return Truth("balancer", ("gravity_spring", "cable_spring"), 2)
        case "zero":
            off = float(rng.choice([-1, 1]) * rng.uniform(0.04, 0.12))
            world.zeros = off * here
            return Truth("joint zero", ("joint_zero",), j + 1, {"dq": -off})
        case "joint_late":
            world.delays = 0.04 * here
            return Truth("torque of one joint late", ("joint_delay",), j + 1, {"d": 0.04})
        case "all_late":
            world.delays = float(rng.choice([0.016, 0.03, 0.05]))
            return Truth("torques late", ("time_delay",), None, {"d": world.delays})
        case "filtered":
            world.lag = 0.04
            return Truth("torques filtered", ("reading_filter",), None, {"T": world.lag})
        case "gain":
            eps = float(rng.choice([-0.12, 0.12]))
            world.gains = 1.0 + eps * here
            return Truth("torque scale 12 %", ("torque_gain",), j + 1, {"eps": eps})
        case "limit":
            limit = 0.8 * float(np.abs(plan.torques[:, j]).max())
            world.limits = np.where(here > 0.0, limit, np.inf)
            return Truth("drive at its limit", ("saturation",), j + 1, {"limit": limit})
        case "leak":
            source, to = int(rng.integers(1, 3)), int(rng.choice([3, 4]))
            share = float(rng.choice([-0.15, 0.15])) * arm.torques[to] / arm.torques[source]
            world.leak = (to, source, share)
            return Truth("leak of torque", ("crosstalk",), to + 1, {"c": share})
        case "dead":
            world.dead = j
            return Truth("dead channel", ("fault",), j + 1)
    raise ValueError(kind)
