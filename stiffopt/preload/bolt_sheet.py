"""VDI 2230 verification sheet of one flange: forces, safety factors and slip probability."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.fastening import flange_load
from stiffopt.fastening.elastic_ring import elastic_ring
from stiffopt.fastening.tightening import preload_at_torque, tightening_torque
from stiffopt.fastening.tilting import tilting_flange
from stiffopt.fastening.utilisation import UtilisationRow
from stiffopt.fastening.verification import Verification
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.utilisation import governing_safety
from stiffopt.robot.tolerances import TOLERANCE_IN_STANDARD_DEVIATIONS


@dataclass(frozen=True, kw_only=True, eq=False)
class BoltSheet:
    """VDI 2230 of one flange at a design; forces of one bolt [N]."""

    key: str
    flange: BoltedFlange
    scatter: float  # alpha_A (R1)
    # delta_S, delta_P (R3) [m/N].
    bolt_compliance: float
    plate_compliance: float
    # Phi at both bounds of the load introduction factor (R3).
    factor_most: float
    factor_least: float
    loss: float  # F_Z and Delta F_Vth (R4)
    clamp_needed: float  # F_Kerf with (1 - Phi) F_A, slip with its safety (R2, R5)
    # F_Mmax and F_Mmin at assembly (R6).
    largest: float
    least: float
    in_service: float  # F_Vmin, after all losses
    # Largest F_A, and F_SA with the thermal force (R8).
    working_load: float
    additional: float
    case: str  # load case that requires the largest clamp load
    angles: np.ndarray  # (n,) angles of the bolts, the first on the x axis [rad]
    # (n,) F_A of each bolt in that case; for an elastic ring at the least favourable rib angle.
    axial: np.ndarray
    transverse: np.ndarray  # (n, 2) F_Q of each bolt in that case
    # Stiffness of the closed flange and moment that opens its edge, at F_Vmin [N m/rad], [N m]; 0
    # if no preload is left.
    tilting_stiffness: float
    opening_moment: float
    tilt: float  # tilting angle under the largest tilting moment [rad]
    chance: SlipProbability  # of a bolt whose remaining preload is below its share of the load
    loads: flange_load.FlangeLoads  # loads of all load cases at the interface
    # By symbol: step with the least value over required value of each safety factor.
    safety: Mapping[str, UtilisationRow]


def bolt_sheets(model: PreloadModel, preloads: np.ndarray) -> tuple[BoltSheet, ...]:
    """Return the sheets of all bolted flanges of a study at a design."""
    found = []
    for index, (element, steps) in enumerate(zip(model.elements, model.verifications, strict=True)):
        if steps is None:
            continue
        own = np.asarray(model.of_element(preloads, index))
        largest, smallest = float(own.max()), float(own.min())
        worst = int(np.argmax(steps.clamp_needed))
        load, angles = steps.loads.values[worst], flange_load.bolt_angles(steps.count)
        left = float(element.least(smallest))
        tilting = tilting_flange(steps.flange, left) if left > 0.0 else None
        found.append(
            BoltSheet(
                key=element.key,
                flange=steps.flange,
                scatter=element.scatter,
                bolt_compliance=steps.compliances[0],
                plate_compliance=steps.compliances[1],
                factor_most=steps.factor.most,
                factor_least=steps.factor.least,
                loss=element.loss,
                clamp_needed=float(steps.clamp_needed[worst]),
                largest=largest,
                least=smallest / element.scatter,
                in_service=left,
                working_load=max(float(steps.opening.max()), 0.0),
                additional=steps.additional,
                case=steps.loads.names[worst],
                angles=angles,
                axial=_bolt_axial_forces(steps, load, angles),
                transverse=flange_load.transverse_forces(
                    load, steps.count, steps.flange.circle_diameter / 2, angles
                ),
                tilting_stiffness=tilting.closed_stiffness if tilting else 0.0,
                opening_moment=tilting.opening_moment if tilting else 0.0,
                tilt=tilting.rotation(float(steps.loads.tilting.max())) if tilting else np.inf,
                chance=slip_probability(steps, largest),
                loads=steps.loads,
                safety=governing_safety(model, preloads, index),
            )
        )
    return tuple(found)


def _bolt_axial_forces(steps: Verification, load: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return F_A of each bolt at its angle (n,) [N]."""
    ring = elastic_ring(steps.flange)
    if ring is not None:
        return ring.bolt_forces(load)
    return flange_load.axial_forces(load, steps.count, steps.flange.circle_diameter, angles)


@dataclass(frozen=True, kw_only=True)
class SlipProbability:
    """Probability that the remaining preload of a bolt is below its share of the load."""

    stated: float  # in closed form
    drawn: float  # share of random draws
    draws: int
    # Preload in service at which the bolt's share of the interface slips or opens, safety 1 [N].
    needed: float
    # Of the draws, in service [N].
    least: float
    largest: float

    @property
    def agrees(self) -> bool:
        """True if the draws are within four standard deviations of the stated probability."""
        spread = math.sqrt(self.stated * (1.0 - self.stated) / self.draws)
        return abs(self.drawn - self.stated) <= 4.0 * spread + 1.0 / self.draws


def slip_probability(
    steps: Verification, preload: float, *, draws: int = 1000, seed: int = 0
) -> SlipProbability:
    """Compute the probability of too little preload, and confirm it by random tightening.

    The wrench setting gives `preload` (the largest assembly preload) at the stated friction.
    Friction in thread and under the head is independent and normal: two standard deviations below
    the mean is the stated, lowest value, two above it the value that leaves `preload`/alpha_A. The
    wrench error of +-5 % is two standard deviations. A preload is below F where the torque M is
    less than F times the lever, which is linear in both frictions: M - F lever is normal, so the
    closed form is exact. A flange carries by the sum of its bolts, so it slips less often than a
    single bolt is too loose.
    """
    tightening, bolt = steps.tightening, steps.data
    lowest = (tightening.thread_friction, tightening.head_friction)
    setting = float(tightening_torque(bolt, preload, *lowest))
    pitch = float(tightening_torque(bolt, 1.0, 0.0, 0.0))
    levers = [float(tightening_torque(bolt, 1.0, *unit)) - pitch for unit in ((1, 0), (0, 1))]
    # Factor on the lowest friction at the upper end of the scatter.
    factor = (steps.scatter * setting / preload - pitch) / (setting / preload - pitch)
    means = [mu * (1.0 + factor) / 2.0 for mu in lowest]
    deviations = [mu * (factor - 1.0) / (2.0 * TOLERANCE_IN_STANDARD_DEVIATIONS) for mu in lowest]
    # Accuracy of a torque wrench, +-5 %.
    wrench = setting * 0.05 / TOLERANCE_IN_STANDARD_DEVIATIONS
    needed = _needed_preload(steps)
    force = needed + steps.loss
    mean = setting - force * (pitch + sum(a * mu for a, mu in zip(levers, means, strict=True)))
    spread = math.hypot(wrench, *(force * a * sd for a, sd in zip(levers, deviations, strict=True)))
    rng = np.random.default_rng(seed)
    thread, head = (
        rng.normal(mu, sd, size=draws) for mu, sd in zip(means, deviations, strict=True)
    )
    torque = rng.normal(setting, wrench, size=draws)
    left = np.asarray(preload_at_torque(bolt, torque, thread, head)) - steps.loss
    return SlipProbability(
        stated=0.5 * math.erfc(mean / spread / math.sqrt(2.0)),
        drawn=float((left < needed).mean()),
        draws=draws,
        needed=needed,
        least=float(left.min()),
        largest=float(left.max()),
    )


def _needed_preload(steps: Verification) -> float:
    """Return the required preload in service of the worst bolt at safety 1 [N]."""
    unloaded = (1.0 - steps.factor.least) * np.maximum(steps.opening, 0.0)
    slip = float((steps.clamp_against_slip + unloaded).max())
    return max(slip, float(steps.clamp_against_opening.max()))
