"""The steps of VDI 2230 for one flange under its loads: each with value, limit and utilisation.

Every check takes the worst load case and the worst place on the bolt circle, since how the bolts
stand to the load changes as the joint turns.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputError
from stiffopt.fastening import bolts
from stiffopt.fastening.bolt_stress import largest_working_preload, working_stress
from stiffopt.fastening.clamp_load import friction_clamp_load, ring_opening_load
from stiffopt.fastening.elastic_ring import elastic_ring
from stiffopt.fastening.endurance import SAFETY as ENDURANCE_SAFETY
from stiffopt.fastening.endurance import endurance_limit
from stiffopt.fastening.flange_load import FlangeLoads, axial_forces, transverse_forces
from stiffopt.fastening.head_pressure import head_bearing
from stiffopt.fastening.load_factor import LoadFactor, load_factor
from stiffopt.fastening.self_loosening import transverse_slip_limit
from stiffopt.fastening.tightening import Tightening

# Places on the bolt circle that are looked at; between two of them a cosine is off by this much.
_PLACES = 360
_BETWEEN = 1.0 / math.cos(math.pi / _PLACES)
# Safety against slip (VDI 2230 R12) and against shear and bearing after it.
SLIP_STATIC, SLIP_ALTERNATING, SHEAR = 1.2, 1.8, 1.1
# Shear over tensile strength of bolts, and the extent of a face over the head's for which its
# pressure still is even (limit G'' of a tapped hole: 1.5 to 2, the near end).
_SHEAR_STRENGTH, _EXTENT = 0.6, 1.5


@dataclass(frozen=True, kw_only=True)
class VdiCheck:
    """One step of VDI 2230 at one design.

    Parameters
    ----------
    name, equation : str
        Such as "slip under the whole load", "R12/4".
    value, limit : float
        In `unit`.
    utilisation : float
        1 at the limit.
    case : str
        Load case, or instant of a motion, that is worst.
    warning : bool
        Tells, but stops no design.
    """

    name: str
    equation: str
    value: float
    limit: float
    unit: str
    utilisation: float
    case: str = ""
    source: str = ""
    remedy: str = ""
    provenance: str = "catalogue"
    warning: bool = False


class Verification:
    """VDI 2230 of one flange under its loads.

    Parameters
    ----------
    flange : BoltedFlange
        With its bolt.
    tightening : Tightening
    loads : FlangeLoads
        In the axes of the flange, at its face.
    slip_safety : float or None
        None: 1.2 for static, 1.8 for alternating torque.
    """

    def __init__(
        self,
        flange: BoltedFlange,
        tightening: Tightening,
        loads: FlangeLoads,
        slip_safety: float | None = None,
    ) -> None:
        self.flange, self.tightening = flange, tightening
        self.loads = loads if flange.bearing == "none" else loads.torque_alone()
        self.bolt = bolts.flange_bolt(flange)
        self.data = bolts.bolt_data(self.bolt)
        self.count = flange.bolt_count * flange.sectors
        if self.count < 3 and self.loads.tilting.any():
            raise InputError(
                f"{flange.owner}: {self.count} bolts bear no tilting moment about every axis. Give "
                'the flange three or more, or say `bearing = "beside"` in the robot file.'
            )
        usual = SLIP_ALTERNATING if loads.alternating else SLIP_STATIC
        self.slip_safety = usual if slip_safety is None else slip_safety
        self.proof_stress = catalogue.proof_stress(self.bolt.grade)

    # ---- what comes to a bolt

    @cached_property
    def angles(self) -> np.ndarray:
        """Places on the bolt circle that are looked at (m,) [rad]."""
        return 2 * math.pi / _PLACES * np.arange(_PLACES)

    @cached_property
    def sharing(self) -> tuple[float, float]:
        """What a bolt bears over its part on a rigid flange: of axial force, of tilting [-]."""
        ring = elastic_ring(self.flange)
        return (1.0, 1.0) if ring is None else ring.factors

    @cached_property
    def axial(self) -> np.ndarray:
        """F_A (K, m) [N] with either sign of the axial force as it comes."""
        values = self.loads.values.copy()
        pull, tilt = self.sharing
        values[:, 2] *= pull
        values[:, 3:5] *= tilt * _BETWEEN
        return axial_forces(values, self.count, self.flange.circle_diameter, self.angles)

    @cached_property
    def opening(self) -> np.ndarray:
        """F_A (K, m) [N] with the axial force taken to pull."""
        share = self.sharing[0] * self.loads.values[:, 2:3] / self.count
        return np.asarray(self.axial - share + np.abs(share))

    @property
    def friction_radius(self) -> float:
        """Lever of the friction of an evenly pressed ring [m]."""
        flange = self.flange
        unit = float(flange.slip_torque(1.0)) * flange.sectors
        return unit / (flange.friction_coefficient * self.count)

    @cached_property
    def clamp_against_slip(self) -> np.ndarray:
        """F_KQ (K, m) [N], shear and torque as vectors (R2/1)."""
        force = transverse_forces(self.loads.values, self.count, self.friction_radius, self.angles)
        return friction_clamp_load(force, self.flange.friction_coefficient)

    @cached_property
    def clamp_against_opening(self) -> np.ndarray:
        """Clamp load of one bolt at which the rim opens (K,) [N] (R2/3)."""
        flange = self.flange
        return ring_opening_load(
            self.sharing[0] * self.loads.axial,
            self.sharing[1] * self.loads.tilting,
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
        """F_SA,max and what warming adds [N] (R8/1)."""
        pull = max(float(self.opening.max()), 0.0)
        return self.factor.most * pull + bolts.thermal_preload(self.flange, self.tightening)

    @cached_property
    def swing(self) -> float:
        """Largest F_SAo - F_SAu of any bolt, load on and off among what alternates [N] (R9)."""
        upper = np.maximum(self.axial.max(axis=0), 0.0)
        lower = np.minimum(self.axial.min(axis=0), 0.0)
        return self.factor.most * float((upper - lower).max())

    # ---- which preloads hold

    @cached_property
    def clamp_needed(self) -> np.ndarray:
        """F_V that each case asks for in service (K,) [N], slip with its safety (R2/4, R5/1)."""
        unloaded = (1.0 - self.factor.least) * np.maximum(self.opening, 0.0)
        slip = (self.slip_safety * self.clamp_against_slip + unloaded).max(axis=1)
        return np.asarray(np.maximum(slip, self.clamp_against_opening))

    @property
    def least_preload(self) -> float:
        """F_Mmax = alpha_A (F_Kerf + (1 - Phi) F_A + F_Z + Delta F_Vth) [N] (R5/1, R6/1)."""
        return self.scatter * (float(self.clamp_needed.max()) + self.loss)

    @cached_property
    def largest_preload(self) -> float:
        """Largest F_M that stress in service, head and thread allow [N]; 0: none."""
        ends = [
            largest_working_preload(
                self.data, self.proof_stress, self.additional, self.tightening.thread_friction
            ),
            head_bearing(self.bolt).capacity - self.additional,
        ]
        before = float(endurance_limit(self.data, "before"))
        needed = ENDURANCE_SAFETY * self.swing / (2 * self.data.stress_area)
        if self.bolt.rolled == "after" and needed > before:
            share = 2.0 - needed / before
            ends.append(share * self.proof_stress * self.data.stress_area if share > 0.3 else 0.0)
        return max(min(ends), 0.0)

    # ---- the checks

    def checks(
        self, preload: float, shift: float = math.nan, least: float | None = None
    ) -> tuple[VdiCheck, ...]:
        """Every step at a largest assembly preload.

        Parameters
        ----------
        preload : float
            F_M [N].
        shift : float
            Transverse movement of the bolts by the elasticity of the face [m]; nan leaves the
            check of self-loosening out.
        least : float, optional
            F_V that is left in service [N]; default after scatter and losses.
        """
        if least is None:
            least = preload / self.scatter - self.loss
        return (
            *self._clamp(least),
            *self._stress(preload, least),
            *self._after_slip(),
            *self._warnings(least, shift),
        )

    def _worst(self, values: np.ndarray) -> tuple[int, str]:
        index = int(np.argmax(values))
        return index, self.loads.names[index]

    def _clamp(self, least: float) -> Iterator[VdiCheck]:
        unloaded = (1.0 - self.factor.least) * np.maximum(self.opening, 0.0)
        needed = self.slip_safety * self.clamp_against_slip + unloaded
        index, case = self._worst(needed.max(axis=1))
        place = int(np.argmax(needed[index]))
        left = least - float(unloaded[index, place])
        friction = float(self.clamp_against_slip[index, place])
        most = float(needed[index, place])
        kind = "alternating" if self.slip_safety == SLIP_ALTERNATING else "static"
        if not self.loads.more_than_torque:
            # The torque alone: the slip safety of the connection says the same.
            return
        extra = 100 * (self.friction_radius / (self.flange.circle_diameter / 2) - 1)
        yield VdiCheck(
            name="slip under the whole load",
            equation="R12/4",
            value=left / friction if friction > 0.0 else math.inf,
            limit=self.slip_safety,
            unit="",
            utilisation=_share(most, least),
            case=case,
            source=(
                f"{kind}: shear and torque as vectors, tension of the bolt taken off; friction at "
                f"the mean radius of the ring, {extra:.1f} % outside the bolt circle"
            ),
            remedy="more friction, more or larger bolts, a larger circle, or less scatter",
        )
        index, case = self._worst(self.clamp_against_opening)
        opens = float(self.clamp_against_opening[index])
        if opens > 0.0:
            yield VdiCheck(
                name="one-sided opening",
                equation="R2/3",
                value=least,
                limit=opens,
                unit="N",
                utilisation=_share(opens, least),
                case=case,
                source="pressure at the rim of the ring less its holes, axial force and tilting",
                remedy="more or larger bolts, a larger circle, or less scatter",
            )

    def _stress(self, preload: float, least: float) -> Iterator[VdiCheck]:
        _, case = self._worst(self.opening.max(axis=1))
        friction = self.tightening.thread_friction
        stress = float(working_stress(self.data, preload, self.additional, friction))
        yield VdiCheck(
            name="working stress",
            equation="R8/5",
            value=stress,
            limit=self.proof_stress,
            unit="Pa",
            utilisation=stress / self.proof_stress,
            case=case,
            source=f"R_p0.2 of {self.bolt.grade}, half of the torsion of tightening, safety 1.0",
            remedy="a larger bolt, a higher grade or less load",
        )
        bearing = head_bearing(self.bolt)
        force = preload + self.additional
        yield VdiCheck(
            name="head pressure in service",
            equation="R10/2",
            value=force,
            limit=bearing.capacity,
            unit="N",
            utilisation=force / bearing.capacity,
            case=case,
            source=bearing.source,
            provenance=bearing.provenance,
            remedy="a harder part or a hard washer under the head, or a larger bolt",
        )
        if self.swing > 0.0:
            mean = preload + self.swing / 2
            limit = float(endurance_limit(self.data, self.bolt.rolled, mean, self.proof_stress))
            amplitude = self.swing / (2 * self.data.stress_area)
            yield VdiCheck(
                name="alternating stress",
                equation="R9/4",
                value=amplitude,
                limit=limit / ENDURANCE_SAFETY,
                unit="Pa",
                utilisation=ENDURANCE_SAFETY * amplitude / limit,
                case=case,
                source=(
                    f"thread rolled {self.bolt.rolled} heat treatment, endurance limit over "
                    f"{ENDURANCE_SAFETY:g}; load on and off among what alternates"
                ),
                remedy="a larger bolt, a longer one, more bolts, or threads rolled at the end",
            )

    def _after_slip(self) -> Iterator[VdiCheck]:
        """What the bolts bear should the face slip all the same."""
        force = transverse_forces(
            self.loads.values, self.count, self.flange.circle_diameter / 2, self.angles
        )
        sizes = np.linalg.norm(force, axis=-1)
        index, case = self._worst(sizes.max(axis=1))
        most = float(sizes[index].max())
        if most <= 0.0:
            return
        strength = _SHEAR_STRENGTH * catalogue.tensile_strength(self.bolt.grade)
        stress = most / self.data.core_area
        yield VdiCheck(
            name="bolt shear",
            equation="R12",
            value=stress,
            limit=strength / SHEAR,
            unit="Pa",
            utilisation=SHEAR * stress / strength,
            case=case,
            source="after slip, thread in the face: core area, 0.6 R_m, safety 1.1",
            remedy="more or larger bolts, or a larger circle",
        )
        part = catalogue.clamped_material(self.bolt.head_material)
        pressure = most / (self.data.diameter * bolts.clamp_length(self.bolt))
        yield VdiCheck(
            name="hole bearing",
            equation="R12",
            value=pressure,
            limit=part.yield_stress,
            unit="Pa",
            utilisation=pressure / part.yield_stress,
            case=case,
            source=f"after slip, on the length of the clamped part; R_p0.2 of {part.name}",
            provenance=part.provenance,
            remedy="a thicker or harder part, or more bolts",
        )

    def _warnings(self, least: float, shift: float) -> Iterator[VdiCheck]:
        extent = self.flange.outer_radius - self.flange.inner_radius
        spread = _EXTENT * self.data.bearing_diameter
        yield VdiCheck(
            name="validity of even pressure",
            equation="R0, limit G",
            value=extent,
            limit=spread,
            unit="m",
            utilisation=extent / spread,
            source="width of the ring against G'' = 1.5 d_w: wider faces open and slip otherwise",
            remedy="a narrower ring, larger heads, washers, or a finite-element model",
            warning=True,
        )
        if math.isfinite(shift):
            limit = transverse_slip_limit(
                self.data,
                bolts.clamp_length(self.bolt),
                max(least, 0.0),
                self.tightening.head_friction,
            )
            yield VdiCheck(
                name="self-loosening",
                equation="Junker",
                value=shift,
                limit=limit,
                unit="m",
                utilisation=shift / limit if limit > 0.0 else math.inf,
                source="movement of the parts at a bolt against that at which its head slips",
                remedy="longer or more slender bolts, more preload, or a locking feature",
                warning=True,
            )


def _share(needed: float, present: float) -> float:
    """Utilisation of a need that what is present has to cover."""
    if needed <= 0.0:
        return 0.0
    return needed / present if present > 0.0 else math.inf
