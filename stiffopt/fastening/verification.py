"""Verification of one flange under its loads by VDI 2230: bolt forces and admissible preloads.

Every check uses the worst load case and the worst angle on the bolt circle, since the direction of
the load relative to the bolts changes with the joint angle.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputError
from stiffopt.fastening import bolt_strength, bolts
from stiffopt.fastening.bolt_strength import MIN_ENDURANCE_SAFETY as ENDURANCE_SAFETY
from stiffopt.fastening.compliance import LoadFactor, load_factor
from stiffopt.fastening.elastic_ring import elastic_ring
from stiffopt.fastening.flange_load import (
    FlangeLoads,
    axial_forces,
    friction_clamp_load,
    ring_opening_load,
    transverse_forces,
)
from stiffopt.fastening.tightening import Tightening

# Sampled angles of the bolt circle, and the largest underestimate of a cosine between two of them.
_ANGLE_COUNT = 360
_MAX_INTERPOLATION_FACTOR = 1.0 / math.cos(math.pi / _ANGLE_COUNT)
# Required safety against slip (VDI 2230 R12) [-].
MIN_STATIC_SLIP_SAFETY, MIN_ALTERNATING_SLIP_SAFETY = 1.2, 1.8


class Verification:
    """VDI 2230 of one flange under its loads.

    `flange` has its bolt, `loads` are in the axes of the flange, at its interface. The default of
    `slip_safety` is 1.2 for static, 1.8 for alternating torque.
    """

    def __init__(
        self,
        flange: BoltedFlange,
        tightening: Tightening,
        loads: FlangeLoads,
        slip_safety: float | None = None,
    ) -> None:
        self.flange, self.tightening = flange, tightening
        self.loads = loads if flange.bearing == "none" else loads.torque_only()
        self.bolt = bolts.flange_bolt(flange)
        self.data = bolt_strength.bolt_data(self.bolt)
        self.count = flange.bolt_count * flange.sectors
        if self.count < 3 and self.loads.tilting.any():
            raise InputError(
                f"{flange.owner}: {self.count} bolts carry no tilting moment about every axis. "
                'Give three or more, or set `bearing = "beside"` in the robot file.'
            )
        usual = MIN_ALTERNATING_SLIP_SAFETY if loads.alternating else MIN_STATIC_SLIP_SAFETY
        self.slip_safety = usual if slip_safety is None else slip_safety
        self.grade = catalogue.bolt_grade(self.bolt.grade)
        self.proof_stress = self.grade.proof_stress

    # ---- forces of one bolt

    @cached_property
    def angles(self) -> np.ndarray:
        """Sampled angles of the bolt circle (m,) [rad]."""
        return 2 * math.pi / _ANGLE_COUNT * np.arange(_ANGLE_COUNT)

    @cached_property
    def bending_factors(self) -> tuple[float, float]:
        """Bolt force over that of a rigid flange, for axial force and tilting moment [-]."""
        ring = elastic_ring(self.flange)
        return (1.0, 1.0) if ring is None else ring.factors

    @cached_property
    def axial(self) -> np.ndarray:
        """F_A (K, m) [N] with the given sign of the axial force."""
        values = self.loads.values.copy()
        pull, tilt = self.bending_factors
        values[:, 2] *= pull
        values[:, 3:5] *= tilt * _MAX_INTERPOLATION_FACTOR
        return axial_forces(values, self.count, self.flange.circle_diameter, self.angles)

    @cached_property
    def opening(self) -> np.ndarray:
        """F_A (K, m) [N] with axial force and tilting moment taken to open the joint.

        The side of the carried part is unknown, and with it the opening direction: a moment opens
        at one angle or the opposite one, where shear and torque may coincide with it.
        """
        share = self.bending_factors[0] * self.loads.values[:, 2:3] / self.count
        return np.asarray(np.abs(self.axial - share) + np.abs(share))

    @property
    def friction_radius(self) -> float:
        """Friction radius of a ring under uniform pressure [m]."""
        flange = self.flange
        unit = float(flange.slip_torque(1.0)) * flange.sectors
        return unit / (flange.friction_coefficient * self.count)

    @cached_property
    def clamp_against_slip(self) -> np.ndarray:
        """F_KQ (K, m) [N], shear and torque added as vectors (R2/1)."""
        force = transverse_forces(self.loads.values, self.count, self.friction_radius, self.angles)
        return friction_clamp_load(force, self.flange.friction_coefficient)

    @cached_property
    def clamp_against_opening(self) -> np.ndarray:
        """Clamp load of one bolt at which the rim opens (K,) [N] (R2/3)."""
        flange = self.flange
        return ring_opening_load(
            self.bending_factors[0] * self.loads.axial,
            self.bending_factors[1] * self.loads.tilting,
            inner=flange.inner_radius,
            outer=flange.outer_radius,
            count=self.count,
            circle=flange.circle_diameter,
            hole=self.data.hole,
        )

    # ---- joint

    @cached_property
    def compliances(self) -> tuple[float, float]:
        """delta_S, delta_P [m/N]."""
        return bolts.joint_compliances(self.flange)

    @cached_property
    def factor(self) -> LoadFactor:
        """Phi (R3)."""
        return load_factor(*self.compliances, self.flange.load_introduction)

    @cached_property
    def loss(self) -> float:
        """F_Z + Delta F_Vth [N] (R4)."""
        return bolts.preload_loss(self.flange, self.tightening)

    @cached_property
    def scatter(self) -> float:
        """alpha_A [-] (R1)."""
        return bolts.scatter(self.flange, self.tightening)

    @cached_property
    def additional(self) -> float:
        """F_SA,max and the thermal force [N] (R8/1)."""
        pull = max(float(self.opening.max()), 0.0)
        return self.factor.most * pull + bolts.thermal_preload(self.flange, self.tightening)

    @cached_property
    def alternating_force(self) -> float:
        """Largest F_SAo - F_SAu of any bolt, loading and unloading included [N] (R9)."""
        upper = np.maximum(self.axial.max(axis=0), 0.0)
        lower = np.minimum(self.axial.min(axis=0), 0.0)
        return self.factor.most * float((upper - lower).max())

    # ---- admissible preloads

    @cached_property
    def clamp_needed(self) -> np.ndarray:
        """Required F_V in service of each case (K,) [N], slip with its safety (R2/4, R5/1)."""
        unloaded = (1.0 - self.factor.least) * np.maximum(self.opening, 0.0)
        slip = (self.slip_safety * self.clamp_against_slip + unloaded).max(axis=1)
        return np.asarray(np.maximum(slip, self.clamp_against_opening))

    @property
    def least_preload(self) -> float:
        """F_Mmax = alpha_A (F_Kerf + (1 - Phi) F_A + F_Z + Delta F_Vth) [N] (R5/1, R6/1)."""
        return self.scatter * (float(self.clamp_needed.max()) + self.loss)

    @cached_property
    def largest_preload(self) -> float:
        """Largest F_M that working stress, surface pressure and fatigue allow [N]; 0: none."""
        ends = [
            bolt_strength.largest_working_preload(
                self.data, self.proof_stress, self.additional, self.tightening.thread_friction
            ),
            bolt_strength.head_bearing(self.bolt).capacity - self.additional,
        ]
        before = float(bolt_strength.endurance_limit(self.data, "before"))
        needed = ENDURANCE_SAFETY * bolt_strength.stress_amplitude(
            self.data, self.alternating_force, 0.0
        )
        if self.bolt.rolled == "after" and needed > before:
            share = 2.0 - needed / before
            ends.append(share * self.proof_stress * self.data.stress_area if share > 0.3 else 0.0)
        return max(min(ends), 0.0)
