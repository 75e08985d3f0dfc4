"""Re-identify the rigid model if no tolerance of nominal masses is stated.

Masses and centres of robot descriptions are wrong for nearly every arm. Without stated tolerances,
all inertial parameters are fitted with the values that the set does not state, before any effect is
searched. A single change (one body, a payload, a tilted base) is preferred if it explains as much
in recordings left out. Bodies of guessed mass are free whatever else explains the recordings.
All bodies are as free as one another: a freedom chosen for each by recordings left out changes with
their limits, and consistent bodies predict as well however free they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.inertial_parameters import (
    body_units,
    is_consistent,
    likeliest_consistent_bodies,
    nominal_bodies,
)
from stiffopt.discovery.comparison.located_effect import LocatedEffect, effect_places
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.progress import Say
from stiffopt.discovery.search.candidates import Candidate, Scorer
from stiffopt.discovery.search.cross_validation import predict_folds
from stiffopt.discovery.signals import PARAMETERS_PER_BODY
from stiffopt.discovery.thresholds import ADDED_MASS_OFFSET, NAMED_EVIDENCE, SINGLE_CHANGE_SHARE

# Prior standard deviations of inertial parameters over their typical sizes, by which free bodies
# gain in recordings left out; the last one is that of re-identified bodies.
PRIOR_WIDTHS = (0.02, 0.06, 0.2, 0.6)
# The same for a body that is held at the nominal model.
HELD_WIDTH = 0.002
# The same for a body of guessed mass, which is off by a factor of three at times.
_GUESSED_WIDTH = 2.0
# Fits with re-estimated noise until it converges.
_NOISE_ROUNDS = 3
# Least gain of squares over noise in recordings left out.
_MIN_SQUARES_GAIN = 2.0


@dataclass(frozen=True, kw_only=True)
class Counterweight:
    """A body with re-identified parameters of a counterbalance, impossible for a real body."""

    joint: int  # joint that carries it (from 0)
    # nominal, change: first moment of the body about its joint, and its change [kg m].
    nominal: float
    change: float
    # Decrease of squares over noise in recordings left out by a counterbalance in its place;
    # negative for an increase.
    gain: float

    @property
    def balanced(self) -> bool:
        """True if recordings left out prefer a counterbalance."""
        return self.gain > _MIN_SQUARES_GAIN

    @property
    def torque(self) -> float:
        """Largest torque [N m]."""
        return 9.81 * self.change


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidStage:
    """Result of the re-identification of the rigid model."""

    # Prior standard deviation of each body's inertial parameters over their typical sizes; empty if
    # nominal values within usual tolerances suffice.
    widths: tuple[float, ...]
    gain: float  # gain of log predictive density in stretches left out by free bodies
    single: Candidate | None  # single change that explains as much
    counterweights: tuple[Counterweight, ...] = ()
    nearest: Candidate | None = None  # best single change, also where it explains less
    nearest_share: float = 0.0  # share of the gain of free bodies that it has

    @property
    def freed(self) -> bool:
        """True if any body is not held at the nominal model."""
        return any(width > HELD_WIDTH for width in self.widths)

    def adopting(self, comparison: Comparison) -> RigidStage:
        """Return the stage with the freedom of bodies that another model has."""
        bodies = comparison.bodies
        if bodies is None:
            return replace(self, widths=())
        widths = np.max(bodies / body_units(comparison.robot), axis=1)
        return replace(self, widths=tuple(widths.tolist()))

    def bodies(self, comparison: Comparison) -> np.ndarray | None:
        """Return prior standard deviations of all inertial parameters (n, 10); None if held."""
        return _parameter_deviations(comparison, self.widths) if self.widths else None


def reidentify_rigid_model(
    comparison: Comparison,
    effects: Sequence[LocatedEffect],
    catalogue: Sequence[Effect],
    tell: Say = lambda _: None,
) -> RigidStage:
    """Choose between nominal bodies, a single change and all parameters by cross-validation.

    `comparison`: with nominal bodies. `effects`: effects already found. `tell`: called with a
    sentence at every step.
    """
    nominal, found = Scorer(comparison, effects), tuple(effects)
    gain = _gain_of_free_bodies(comparison, found, nominal.by_block, tell)
    nearest = single = _best_single_change(nominal, catalogue, tell)
    share = 0.0 if nearest is None or gain <= 0.0 else min(max(nearest.gain / gain, 0.0), 1.0)
    if single is not None and single.gain > max(SINGLE_CHANGE_SHARE * gain, NAMED_EVIDENCE):
        found = (*found, single.located)
        gain = _gain_of_free_bodies(comparison, found, Scorer(comparison, found).by_block, tell)
    else:
        single = None
    if gain < NAMED_EVIDENCE and not comparison.robot.guessed_bodies:
        return RigidStage(widths=(), gain=0.0, single=single, nearest=nearest)
    tell("re-identify the rigid model: counterbalances in place of bodies")
    widths = _common_widths(comparison.robot, PRIOR_WIDTHS[-1])
    free = comparison.with_bodies(_parameter_deviations(comparison, widths))
    return RigidStage(
        widths=tuple(widths),
        gain=gain,
        single=single,
        counterweights=_find_counterweights(with_own_noise(free, found), found, catalogue),
        nearest=nearest,
        nearest_share=share,
    )


def _gain_of_free_bodies(
    comparison: Comparison,
    effects: Sequence[LocatedEffect],
    without: np.ndarray,
    tell: Say,
) -> float:
    """Return the gain of one width for all bodies: the narrowest within one standard error."""
    rows = []
    for k, width in enumerate(PRIOR_WIDTHS, start=1):
        tell(f"re-identify the rigid model ({k} of {len(PRIOR_WIDTHS)} widths)")
        freed = comparison.with_bodies(common_deviations(comparison, width))
        rows.append(Scorer(freed, effects).by_block - without)
    gains = np.array(rows)
    best = int(np.argmax(gains.sum(axis=1)))
    behind = gains[best] - gains
    error = np.sqrt(gains.shape[1]) * behind.std(axis=1)
    chosen = int(np.argmax(behind.sum(axis=1) <= error))
    return float(gains[chosen].sum())


def with_own_noise(comparison: Comparison, effects: Sequence[LocatedEffect]) -> Comparison:
    """Return a model with the noise beside its own fit, whatever noise it starts from."""
    for _ in range(_NOISE_ROUNDS):
        comparison = comparison.linearised_at(comparison.fit(effects))
    return comparison


def _find_counterweights(
    free: Comparison, effects: Sequence[LocatedEffect], catalogue: Sequence[Effect]
) -> tuple[Counterweight, ...]:
    """Find bodies whose first moment changes by more than its nominal value.

    Errors of a description do not move a centre of mass to the other side of its joint; those of a
    guess do. `free`: comparison with free bodies, and the noise beside them.
    """
    assert free.bodies is not None
    moved = (
        free.fit(effects)
        .posterior.mean[: PARAMETERS_PER_BODY * free.robot.n]
        .reshape(-1, PARAMETERS_PER_BODY)
    )
    bodies, units = nominal_bodies(free.robot), body_units(free.robot)
    nominal = np.linalg.norm(bodies[:, 1:4], axis=1)
    change = np.linalg.norm(moved[:, 1:4], axis=1)
    left_out, found = predict_folds(free, effects), []
    squares = left_out.squares(free.bodies.ravel())
    far = np.flatnonzero(change > np.maximum(nominal, ADDED_MASS_OFFSET * bodies[:, 0])).tolist()
    for body in sorted({*far} - {*free.robot.guessed_bodies}):
        held = free.bodies.copy()
        held[body] = HELD_WIDTH * units[body]
        # One that moves for nothing is neither.
        if left_out.squares(held.ravel()) < squares + _MIN_SQUARES_GAIN:
            continue
        instead = [
            predict_folds(free, [*effects, located]).squares(held.ravel())
            for entry in catalogue
            if entry.twin
            for located in effect_places(entry, free.constants, ())
            if located.joint == body
        ]
        gain = squares - min(instead, default=math.inf)
        size, by = float(nominal[body]), float(change[body])
        # If the body predicts better, it is a body (the upper arm of the UR10e, by 374).
        if gain > -_MIN_SQUARES_GAIN:
            found.append(Counterweight(joint=body, nominal=size, change=by, gain=gain))
    return tuple(found)


def common_deviations(comparison: Comparison, width: float) -> np.ndarray:
    """Return prior standard deviations (n, 10) of one width, but for bodies of guessed mass."""
    return _parameter_deviations(comparison, _common_widths(comparison.robot, width))


def _common_widths(robot: RobotModel, width: float) -> list[float]:
    guessed = robot.guessed_bodies
    return [_GUESSED_WIDTH if body in guessed else width for body in range(robot.n)]


def _parameter_deviations(comparison: Comparison, widths: Sequence[float]) -> np.ndarray:
    """Return prior standard deviations (n, 10) of all inertial parameters."""
    return np.asarray(np.array(widths)[:, None] * body_units(comparison.robot))


def _best_single_change(scorer: Scorer, catalogue: Sequence[Effect], tell: Say) -> Candidate | None:
    found = []
    for entry in catalogue:
        if not entry.shifts_weight:
            continue
        for located in effect_places(entry, scorer.comparison.constants, ()):
            if any(located.same_place(other) for other in scorer.base):
                continue
            tell(f"re-identify the rigid model: {located.label} in place of all")
            scored = scorer.score(located)
            if scored is not None:
                found.append(_as_real_body(scorer.comparison, scorer.refine(scored)))
    return max(found, key=lambda c: c.gain, default=None)


def _as_real_body(comparison: Comparison, found: Candidate) -> Candidate:
    """Return a change of one body with its likeliest physically consistent parameters.

    What these fit worse counts against it. Other changes are returned as they are.
    """
    body = found.located.changed_body(comparison.constants)
    if body is None:
        return found
    sizes = found.located.sizes(comparison.constants)
    nominal, units = (own(comparison.robot)[[body]] for own in (nominal_bodies, body_units))
    change = found.amplitudes * sizes
    if is_consistent(nominal + change, units):
        return found
    # Amplitudes that left their bounds have no variance: they stay.
    held = np.where(np.diag(found.covariance) > 0.0, 0.0, np.finfo(float).eps ** 0.5)
    gram = np.linalg.inv(found.covariance + np.diag(held)) / np.outer(sizes, sizes)
    place, free = slice(0, PARAMETERS_PER_BODY), np.full(PARAMETERS_PER_BODY, np.inf)
    real = likeliest_consistent_bodies(gram, gram @ change, place, nominal, units, free)
    lost = 0.5 * float((real - change) @ gram @ (real - change))
    return replace(
        found,
        amplitudes=real / sizes,
        evidence=found.evidence - lost,
        gained=lambda: found.gain - lost,
    )


def with_single_body(comparison: Comparison, body: int, sizes: np.ndarray) -> Comparison:
    """Return the comparison with one body free, by deviations (10,), all others held."""
    deviations = HELD_WIDTH * body_units(comparison.robot)
    deviations[body] = sizes
    return comparison.with_bodies(deviations)
