"""Studies on the packaged ER3A, and its connections written out once more in plain NumPy."""

import functools
from dataclasses import replace

import numpy as np

from stiffopt.contact.fractal import FractalLaw
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.problem import PreloadProblem, Requirements
from stiffopt.robot.files import load_robot

__all__ = ["JACOBIAN", "TESTED", "Ring", "case", "er3a", "study", "with_elements"]

# Friction known from tests, ground faces: what the tests check does not move with the defaults.
TESTED = Tightening(scatter=1.6, embedding=3e-6)

# Of a tool point that all joints move, made up.
JACOBIAN = np.array(
    [
        [0.05, 0.45, 0.30, 0.02, 0.10, 0.00],
        [0.50, 0.02, 0.01, 0.08, 0.00, 0.01],
        [0.00, -0.40, -0.35, 0.01, -0.12, 0.00],
    ]
)


@functools.cache
def er3a():
    """With rings that are one's own: to be drilled anew, preloads as they are assembled."""
    robot = load_robot("er3a_c60")
    chains = [
        replace(chain, stages=tuple(_own(stage) for stage in chain.stages))
        for chain in robot.chains
    ]
    return replace(robot, chains=tuple(chains))


def _own(stage):
    if stage.element.kind != "bolted_flange":
        return stage
    return replace(
        stage, element=replace(stage.element, fixed_pattern=False, preload_is="assembly")
    )


def case(name="peak", jacobian=None, reference=None, **torques):
    """Load case with torques by joint, such as j2=60.0 [N m]."""
    torque = np.zeros(6)
    for key, value in torques.items():
        torque[int(key[1:]) - 1] = value
    return LoadCase(name=name, torque=torque, jacobian=jacobian, reference_torque=reference)


def study(*cases, joints=(2,), robot=None, needs=None, **fields):
    return PreloadProblem(
        robot=robot or er3a(),
        joints=joints,
        load_cases=cases or (case(j2=60.0),),
        requirements=Requirements(**({"slip_safety": 1.2} | (needs or {}))),
        **({"tightening": TESTED} | fields),
    )


def with_elements(joint, robot=None, group=(), **changes):
    """Robot with other fields of some elements of a joint, and a group of them in parallel."""
    robot = robot or er3a()
    chain = robot.chains[joint - 1]
    stages = tuple(
        replace(
            stage,
            element=replace(stage.element, **changes.get(stage.element.name, {})),
            group="beside" if stage.element.name in group else stage.group,
        )
        for stage in chain.stages
    )
    chains = list(robot.chains)
    chains[joint - 1] = replace(chain, stages=stages)
    return replace(robot, chains=tuple(chains))


class Ring:
    """Bolted ring of Mindlin's shear law, from physics rather than from the package's classes."""

    def __init__(self, flange):
        self.flange, self.law = flange, FractalLaw(flange.surface)
        self.inner, self.outer = flange.inner_radius, flange.outer_radius
        self.friction = flange.friction_coefficient
        surface = flange.surface
        self.shear_ratio = 4.0 * surface.contact_shear_modulus / surface.contact_modulus
        self.moment = np.pi / 2 * (self.outer**4 - self.inner**4)

    def pressure(self, force):
        """From the force of one bolt [N]."""
        return self.flange.bolt_count * force / (np.pi * (self.outer**2 - self.inner**2))

    def slip(self, force):
        lever = 2 * np.pi / 3 * (self.outer**3 - self.inner**3)
        return self.friction * self.pressure(force) * lever

    def compliance(self, torque, force):
        """Tangent compliance (k,) for the forces (k,) of one bolt."""
        rest = 1.0 - abs(torque) / self.slip(force)
        normal = self.law.normal_stiffness_per_area(self.pressure(force))
        stiffness = self.shear_ratio * normal * self.moment * np.cbrt(np.maximum(rest, 0.0))
        with np.errstate(divide="ignore"):
            return 1.0 / stiffness

    def windup(self, torque, force):
        """Integral of the compliance in closed form: (3/2) (T_slip/K_0) (1 - (1 - t)^(2/3))."""
        slip = self.slip(force)
        rest = np.maximum(1.0 - abs(torque) / slip, 0.0)
        unloaded = self.compliance(0.0, force)
        return np.sign(torque) * 1.5 * slip * unloaded * (1.0 - np.cbrt(rest) ** 2)
