"""Score every effect at every place beside those already found."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.evidence import (
    AddedColumnsPosterior,
    AddedPosterior,
    AddedSums,
    log_likelihood_gain,
    posterior,
)
from stiffopt.discovery.comparison.located_effect import LocatedEffect, effect_places
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.progress import RoundProgress, Say
from stiffopt.discovery.thresholds import MIN_ACTIVE_SHARE, NAMED_DEVIATIONS, NAMED_EVIDENCE

# Entropy of an exponential distribution of unit mean less the normal one's log density at its peak.
_EXPONENTIAL_COST = 1.0 - 0.5 * math.log(2.0 * math.pi)
# Nelder-Mead evaluations per shape.
_MAX_REFINEMENT_STEPS = 40
# Fits of a secant, and the change of its shapes that ends them, relative and in their unit.
_MAX_SECANT_STEPS, _SECANT_TOLERANCE = 20, 1e-5


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at a place, scored beside those already found."""

    located: LocatedEffect
    amplitudes: np.ndarray  # (k,) in units of their typical sizes
    covariance: np.ndarray  # (k, k)
    evidence: float  # log evidence gained by it, less the price of the shapes tried
    deviations: float  # square root of the amplitudes' chi-square: standard deviations from zero
    gained: Callable[[], float]  # -> gain of the log predictive density of blocks left out
    # -> the channel that it changes most, and the share of the squared residual removed there.
    change: Callable[[], tuple[int, float]]
    # Part of the loss of evidence that fitted shapes may remove.
    removable: float = 0.0

    @property
    def prospect(self) -> float:
        """Largest evidence that fitted shapes may reach."""
        return self.evidence + self.removable

    @cached_property
    def gain(self) -> float:
        """Gain of the log predictive density of blocks left out."""
        return self.gained()

    @cached_property
    def log_likelihood(self) -> float:
        """Gain of the log likelihood at its best amplitudes, whatever their prior."""
        fitted = np.flatnonzero(np.diag(self.covariance))
        return log_likelihood_gain(self.amplitudes[fitted], self.covariance[np.ix_(fitted, fitted)])

    @property
    def explained(self) -> float:
        """Share of the squared residual removed in the channel that it changes most."""
        return self._channel_change[1]

    @property
    def channel(self) -> int:
        """Channel that it changes most."""
        return self._channel_change[0]

    @cached_property
    def _channel_change(self) -> tuple[int, float]:
        return self.change()


class Scorer:
    """Scores of candidates beside a base model.

    `base`: effects already found.
    """

    def __init__(self, comparison: Comparison, base: Sequence[LocatedEffect] = ()) -> None:
        self.comparison, self.base = comparison, tuple(base)
        _, sd = comparison.priors
        self._sums = comparison.sums(self.base)
        amplitudes = self._sums.own.moment.shape[1] - len(sd)
        self._prior = np.concatenate([sd, np.ones(amplitudes)])
        self.start = posterior(self._sums.own, self._prior, cross_validate=False)
        self._beside = AddedColumnsPosterior(self._sums.own, self._prior)
        self._general_scorers: dict[tuple[object, ...], Scorer] = {}
        self._known_evidence: dict[tuple[object, ...], float] = {}

    @cached_property
    def _squares(self) -> np.ndarray:
        """Squares (2 n,) that the base model leaves in every channel."""
        return self._by_channel(self._residual_beside(self.start.mean) ** 2)

    def _by_channel(self, squares: np.ndarray) -> np.ndarray:
        """Return the sums (2 n,) over the rows (m,) of every channel."""
        channels, size = self.comparison.rows.channel, 2 * self.comparison.robot.n
        return np.bincount(channels, squares, minlength=size)

    def _residual_beside(self, values: np.ndarray) -> np.ndarray:
        """Return what the base model with values (p,) leaves of the target (m,)."""
        return np.asarray(self.comparison.target - self.comparison.model_rows(self.base, values))

    @cached_property
    def by_block(self) -> np.ndarray:
        """Log predictive density (b,) of every block given the other blocks."""
        return posterior(self._sums.own, self._prior).by_block

    def score(self, located: LocatedEffect, price: float = 0.0) -> Candidate | None:
        """Score one candidate; None if it changes nothing or leaves its bounds.

        `price`: log of the number of shapes tried.
        """
        if not located.possible(self.comparison.constants):
            return None
        sums = self._sums.added_sums(located)
        size = np.diag(sums.total[1])
        if not np.isfinite(size).all() or not np.any(size > 1e-12):
            return None
        found, kept = self._fit_within_bounds(located, sums)
        if (
            found is None
            or not _has_own_amplitude(located, found, kept)
            or not self._beats_general_forms(located)
        ):
            return None
        mean = np.zeros(len(size))
        covariance = np.zeros((len(size),) * 2)
        mean[kept] = found.mean
        covariance[kept[:, None], kept] = found.covariance
        evidence, removable = found.log_evidence - self.start.log_evidence, 0.0
        if located.effect.takes_recorded:
            known = found.log_likelihood_at(np.ones(1))
            fixed, rest = self._cost_of_taken(located, found)
            removable = max(evidence - known, 0.0) + rest
            evidence = known - fixed - rest
        return Candidate(
            located=located,
            amplitudes=mean,
            covariance=covariance,
            evidence=evidence - price - self.comparison.inherited_evidence(located),
            deviations=math.sqrt(max(float(found.mean @ found.precision @ found.mean), 0.0)),
            gained=lambda: self._beside.log_predictive(sums, kept) - float(np.sum(self.by_block)),
            change=lambda: self._most_changed_channel(located, found.base(), mean),
            removable=removable,
        )

    def _cost_of_taken(self, located: LocatedEffect, found: AddedPosterior) -> tuple[float, float]:
        """Return log densities that samples lose which an effect takes from the recording.

        They are predicted as an exponential distribution of their own mean, in place of the
        noise's normal one. And what the effect leaves of them has to be noise as stated: any law
        that nobody knows is smaller in the rest of a sample than in all of it.
        """
        comparison = self.comparison
        columns, rows = comparison.effect_columns(located), comparison.rows.channel
        size = np.abs(columns).sum(axis=1)
        taken = size > 1.0
        if not taken.any():
            return 0.0, 0.0
        rest = (self._residual_beside(found.base()) - columns.sum(axis=1))[taken]
        unexplained = (comparison.inflation / comparison.least)[rows[taken]]
        each = math.log(size[taken].mean()) + _EXPONENTIAL_COST
        return (
            np.count_nonzero(taken) * each,
            0.5 * float(np.sum(rest**2 * (unexplained**2 - 1.0))),
        )

    def unbounded(self, located: LocatedEffect) -> AddedPosterior | None:
        """Return the posterior of amplitudes without bounds; None if they change nothing."""
        sums = self._sums.added_sums(located)
        _, inner, _ = sums.total
        if not np.isfinite(inner).all() or not np.any(np.diag(inner) > 1e-12):
            return None
        return self._beside.added(sums, np.arange(len(inner)))

    def deviation(self, located: LocatedEffect) -> float | None:
        """Return the standard deviation of a single amplitude over its size; None if unseen."""
        cross, inner, _ = self._sums.added_sums(located).total
        if not np.isfinite(inner).all() or not np.any(inner):
            return None
        seen = float(np.sum(inner) - np.sum(cross * (self.start.covariance @ cross)))
        return 1.0 / float(np.sqrt(seen)) if seen > 0.0 else None

    def prior_relief(self, located: LocatedEffect) -> float:
        """Return the log prior that the nominal values regain beside an effect."""
        _, sd = self.comparison.priors
        found, _ = self._fit_within_bounds(located, self._sums.added_sums(located))
        without = self.start.mean[: len(sd)] / sd
        within = (self.start.mean if found is None else found.base())[: len(sd)] / sd
        return 0.5 * float(without @ without - within @ within)

    def _fit_within_bounds(
        self, located: LocatedEffect, sums: AddedSums
    ) -> tuple[AddedPosterior | None, np.ndarray]:
        """Fit amplitudes; remove those outside their bounds one after another."""
        bounds = located.bounds(self.comparison.constants)
        kept = np.arange(len(bounds))
        while kept.size:
            found = self._beside.added(sums, kept)
            mean = found.mean
            spread = np.sqrt(np.diag(found.covariance))
            lower, upper = bounds[kept].T
            beyond = np.maximum(lower - mean, mean - upper) / spread
            worst = int(np.argmax(beyond))
            if beyond[worst] <= 1.0:
                return found, kept
            kept = np.delete(kept, worst)
        return None, kept

    def _beats_general_forms(self, located: LocatedEffect) -> bool:
        """True if it is significant beside a more general form, and likelier than that form."""
        free, freer = located.effect.beside, located.effect.likelier_than
        if free is None:
            return True
        # It acts in the runs in which the special form acts.
        law = replace(located, effect=replace(free, only_in=located.effect.only_in), shapes=())
        if law.key not in self._general_scorers:
            self._general_scorers[law.key] = Scorer(self.comparison, (*self.base, law))
        scorer = self._general_scorers[law.key]
        alone = replace(located.effect, beside=None, likelier_than=None)
        found = scorer.score(replace(located, effect=alone))
        if found is None or found.evidence < NAMED_EVIDENCE:
            return False
        if freer is None:
            return True
        ahead = found.evidence - scorer.evidence_of(replace(located, effect=freer, shapes=()))
        return ahead >= NAMED_EVIDENCE

    def evidence_of(self, located: LocatedEffect) -> float:
        """Return the cached evidence of an effect to compare with; -inf if it has none."""
        if located.key not in self._known_evidence:
            found = self.score(located)
            self._known_evidence[located.key] = -math.inf if found is None else found.evidence
        return self._known_evidence[located.key]

    def _most_changed_channel(
        self, located: LocatedEffect, base_mean: np.ndarray, mean: np.ndarray
    ) -> tuple[int, float]:
        """Return the channel whose squares it reduces most, and the share that is removed.

        Only channels that it acts on count: others improve indirectly, through nominal values.
        """
        added = self.comparison.effect_columns(located)
        residual = self._residual_beside(base_mean) - added @ mean
        before, after = self._squares, self._by_channel(residual**2)
        acted = self._by_channel(np.sum(added**2, axis=1))
        # Less is vibration excited through other links.
        own = acted > MIN_ACTIVE_SHARE * acted.max()
        fall = np.where(own, before - after, -np.inf)
        channel = int(np.argmax(fall))
        rows = self.comparison.rows.channel == channel
        whole = before[channel] + self._resembled_square(located, added[rows] @ mean, rows)
        return channel, float(fall[channel] / whole) if whole > 0.0 else 0.0

    def _resembled_square(
        self, located: LocatedEffect, added: np.ndarray, rows: np.ndarray
    ) -> float:
        """Return the square of the base effects in some rows as far as a candidate resembles them.

        What it adds (m,) in proportion to another effect is that effect's form before it is physics
        of its own: to one at its place wherever the candidate acts, to others in all rows. A law
        without shapes cannot bend to the form of another.
        """
        if not located.effect.shapes:
            return 0.0
        own = added**2
        acts = own > MIN_ACTIVE_SHARE * own.max()
        square = 0.0
        for other, contribution in self._base_contributions:
            part = contribution[rows]
            seen = acts if located.is_beside(other) else np.ones_like(acts)
            known = float(np.sum(part[seen] ** 2))
            if known > 0.0:
                along = float(part[seen] @ added[seen]) ** 2 / float(np.sum(own[seen]))
                square += along / known * float(np.sum(part**2))
        return square

    @cached_property
    def _base_contributions(self) -> list[tuple[LocatedEffect, np.ndarray]]:
        """Base effects with their contributions (m,), except values that every joint has."""
        begin, found = len(self.comparison.priors[1]), []
        for located in self.base:
            columns = self.comparison.effect_columns(located)
            values = self.start.mean[begin : begin + columns.shape[1]]
            begin += columns.shape[1]
            if not located.calibrated:
                found.append((located, np.asarray(columns @ values)))
        return found

    def refine(self, candidate: Candidate, price: float = 0.0) -> Candidate:
        """Fit the shapes of a candidate within their bounds, from their current values."""
        candidate = self._follow_secants(candidate, price)
        every = candidate.located.effect.shapes
        free = [i for i, shape in enumerate(every) if shape.fit == "free"]
        if not free:
            return candidate
        shapes = [every[i] for i in free]
        start = np.array(candidate.located.shapes)[free]
        scale = np.where(start != 0.0, np.abs(start), 1.0)
        best = candidate

        def cost(scaled: np.ndarray) -> float:
            nonlocal best
            values = np.clip(scaled * scale, [s.lower for s in shapes], [s.upper for s in shapes])
            changed = list(candidate.located.shapes)
            for i, value in zip(free, values, strict=True):
                changed[i] = float(value)
            moved = replace(candidate.located, shapes=tuple(changed))
            found = self.score(moved, price)
            if found is None:
                return 1e12
            if found.evidence > best.evidence:
                best = found
            outside = float(np.sum((scaled * scale - values) ** 2 / scale**2))
            return -found.evidence + 1e3 * outside

        simplex = [start / scale]
        for i in range(len(start)):
            corner = start / scale
            corner[i] *= 1.25
            simplex.append(corner)
        minimize(
            cost,
            start / scale,
            method="Nelder-Mead",
            options={
                "maxfev": _MAX_REFINEMENT_STEPS * len(shapes),
                "initial_simplex": np.array(simplex),
                "xatol": 1e-3,
                "fatol": 1e-2,
            },
        )
        return best

    def _follow_secants(self, candidate: Candidate, price: float) -> Candidate:
        """Repeat the fit until the shapes of a secant equal the amplitudes."""
        shapes = candidate.located.effect.shapes
        secant = [i for i, shape in enumerate(shapes) if shape.fit == "secant"]
        for _ in range(_MAX_SECANT_STEPS if secant else 0):
            located = candidate.located
            amplitudes = candidate.amplitudes * located.sizes(self.comparison.constants)
            moved = list(located.shapes)
            for i in secant:
                moved[i] = float(np.clip(amplitudes[i], shapes[i].lower, shapes[i].upper))
            if np.allclose(moved, located.shapes, rtol=_SECANT_TOLERANCE, atol=_SECANT_TOLERANCE):
                break
            found = self.score(replace(located, shapes=tuple(moved)), price)
            if found is None:
                break
            candidate = found
        return candidate


def _has_own_amplitude(located: LocatedEffect, found: AddedPosterior, kept: np.ndarray) -> bool:
    """True if an amplitude that only this effect has is significant.

    Without one the candidate is a simpler effect with more freedom.
    """
    distinctive = located.effect.distinctive_amplitudes
    sure = np.abs(found.mean) > NAMED_DEVIATIONS * np.sqrt(np.diag(found.covariance))
    return not distinctive or bool(np.any(sure & np.isin(kept, distinctive)))


def scan(
    scorer: Scorer,
    catalogue: Sequence[Effect],
    *,
    refined: int = 6,
    worth: float = -math.inf,
    about: LocatedEffect | None = None,
    tell: Say = lambda _: None,
) -> list[Candidate]:
    """Score the whole catalogue; the best first, each place once.

    `refined`: number of the best candidates whose shapes are fitted. `worth`: log evidence below
    which shapes are not fitted. `about`: only possible rivals of this effect are tried. `tell`:
    called with a sentence before every effect.
    """
    constants = scorer.comparison.constants
    runs = [run.name for run in scorer.comparison.runs]
    best: list[tuple[Candidate, float]] = []
    place = "" if about is None else f" in place of {about.label}"
    pace = RoundProgress(len(catalogue))
    for number, effect in enumerate(catalogue):
        tell(f"try {effect.name}{place} ({pace.words(number)})")
        by_place: dict[tuple[int | None, int | None, str | None], list[LocatedEffect]] = {}
        for located in effect_places(effect, constants, runs):
            if about is not None and not located.is_adjacent(about):
                continue
            by_place.setdefault((located.joint, located.link, located.run), []).append(located)
        kept = [
            tried
            for tried in by_place.values()
            if not any(tried[0].same_place(other) for other in scorer.base)
        ]
        waiting = [each for tried in kept for each in tried if each.possible(constants)]
        ready = 0
        for tried in kept:
            price = float(np.log(len(tried)))
            found = []
            for each in tried:
                tell(f"try {each.label}{place} ({pace.words(number)})")
                if ready < len(waiting) and each is waiting[ready]:
                    ready += scorer.comparison.columns.prepare_effects(waiting[ready:])
                scored = scorer.score(each, price)
                if scored is not None:
                    found.append(scored)
            if found:
                best.append((max(found, key=lambda c: c.prospect), price))
    best.sort(key=lambda pair: -pair[0].prospect)
    head = []
    for candidate, price in best[:refined]:
        if candidate.prospect < worth:
            head.append(candidate)
            continue
        tell(f"fit the shapes of {candidate.located.label}{place}")
        head.append(scorer.refine(candidate, price))
    return sorted([*head, *(c for c, _ in best[refined:])], key=lambda c: -c.evidence)
