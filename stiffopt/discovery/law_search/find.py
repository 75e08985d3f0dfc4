"""Find laws in the channels that the catalogue leaves open, and fit them beside its findings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, LocatedEffect
from stiffopt.discovery.judging.unexplained import assess_findings
from stiffopt.discovery.law_search.fit_law import FittedLaw
from stiffopt.discovery.law_search.free_function import residual_tables
from stiffopt.discovery.law_search.open_channel import OpenChannel
from stiffopt.discovery.law_search.search import (
    ChannelLaw,
    beats,
    may_beat,
    search_channel,
)
from stiffopt.discovery.laws.law import LAW_FAMILY, Law, Place, law_effect
from stiffopt.discovery.laws.sources import LawSource
from stiffopt.discovery.laws.table import ResidualTable
from stiffopt.discovery.names import channel_name
from stiffopt.discovery.progress import Say
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.search.joint_fit import passes_thresholds, prune_effects
from stiffopt.discovery.search.left_out_gain import select_predictive
from stiffopt.discovery.search.rivals import Selected, tempering_width
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.search.uncertainty import estimate_parameters, null_probability
from stiffopt.discovery.thresholds import (
    CONFIRMED_DEVIATIONS,
    FAINT_RATIO,
    NAMED_PROBABILITY,
    PARAMETER_LOG_PRICE,
    RIVAL_LOG_ODDS,
)

# Share of the excess in parts left out from which a free function is kept as a table.
MIN_KEPT_SHARE = 0.3
# Laws that are added at most, and channels without one after which the search ends.
MAX_LAWS, _MAX_REFUSED = 3, 2


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundLaw:
    """A law that holds."""

    law: Law
    located: LocatedEffect  # the law as an effect at its joint
    channel: str  # such as "torque_3"
    # explained, attainable: share of the channel's excess that the law, and the best free function
    # of signals, explain in parts of the training runs left out.
    explained: float
    attainable: float
    tried: int  # number of laws among which it was the best
    evidence: float  # log evidence, less the price of its parameters and of the laws tried


@dataclass(frozen=True, kw_only=True, eq=False)
class RefusedChannel:
    """Channel in which no law holds."""

    channel: str  # such as "torque_3"
    reason: str  # why the best law does not hold
    # Share of the excess that the best free function of signals, or that law, explains in parts of
    # the training runs left out: what any law of recorded signals could.
    attainable: float
    signals: tuple[str, ...]  # signals of that function, in words
    tables: tuple[ResidualTable, ...]  # that function, where it is worth keeping


def located_tables(refused: RefusedChannel) -> list[EstimatedEffect]:
    """Return the tables of a channel as effects of weight 1."""
    return [
        EstimatedEffect(
            located=LocatedEffect(effect=table.effect, joint=table.joint), amplitudes=(1.0,)
        )
        for table in refused.tables
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class LawSearch:
    """Result of a search for laws."""

    result: SearchResult  # with the laws among its effects; the given one where none holds
    laws: tuple[FoundLaw, ...] = ()
    refused: tuple[RefusedChannel, ...] = ()


def find_laws(result: SearchResult, say: Say, simulated: Collection[int] = ()) -> LawSearch:
    """Search the residual that the catalogue leaves for laws.

    `result`: of the catalogue, by training runs. `say`: called with a sentence at every step.
    `simulated`: joints (from 0) that a simulation from commands explains: what is left of their
    derived torques is an error of these.

    It runs only where a channel holds more than noise beside the catalogue, in more than one run
    and within the band of the fit. A finding that a law makes superfluous is dropped.
    """
    comparison = result.comparison
    if comparison.after_model or result.stopped:
        return LawSearch(result=result)
    refused: dict[int, ChannelLaw] = {}
    n = comparison.robot.n
    closed = {c for c in range(2 * n) if c % n in simulated}
    laws: list[FoundLaw] = []
    irreplaceable: set[tuple[object, ...]] = set()
    open_names: tuple[str, ...] = ()
    while len(laws) < MAX_LAWS:
        kept, left = assess_findings(result)
        if left is not None and (left.brief or left.alone is not None):
            break
        open_names = () if left is None else left.channels
        state = _State(result.comparison, kept, irreplaceable)
        waiting = state.searched_channels(
            {c for c in range(2 * n) if channel_name(c, n) in open_names}
        )
        number = next((c for c in waiting if c not in refused and c not in closed), None)
        if number is None:
            break
        name = channel_name(number, n)
        is_open = name in open_names
        # Of channels near the noise, of which there may be many, none ends the search of open ones.
        counted = [c for c in refused if not is_open or channel_name(c, n) in open_names]
        if len(counted) >= _MAX_REFUSED:
            break
        say(f"search {name} for a law that no catalogue has")
        outcome = state.search(number, is_open=is_open)
        if outcome is None:
            closed.add(number)
            continue
        found = None if outcome.best is None else state.add(outcome)
        if state.restored:
            # The law stood beside these, not for them: searched again with them in place.
            irreplaceable |= state.restored
            continue
        if found is None:
            refused[number] = outcome
            continue
        say(f"found {found.located.effect.equation}")
        laws.append(found)
        result = state.answer(result)
    return LawSearch(
        result=result,
        laws=tuple(laws),
        refused=tuple(
            _describe_refusal(each, n)
            for number, each in refused.items()
            if channel_name(number, n) in open_names
        ),
    )


def _describe_refusal(outcome: ChannelLaw, joints: int) -> RefusedChannel:
    sources = [
        source
        for term in outcome.free
        for source in (*(factor.source for factor in term.carrier), term.source)
    ]
    return RefusedChannel(
        channel=channel_name(outcome.channel.channel, joints),
        reason=outcome.refusal or "the law leaves its bounds",
        attainable=float(np.clip(outcome.attainable, 0.0, 1.0)),
        signals=tuple(dict.fromkeys(source.words for source in sources)),
        tables=residual_tables(outcome.channel, outcome.free)
        if outcome.free_share > MIN_KEPT_SHARE
        else (),
    )


@dataclass(frozen=True, eq=False)
class _Ranked:
    """A law at a place, with its evidence over all channels and its contribution (m,) to them."""

    evidence: float
    law: Law
    located: LocatedEffect
    rows: np.ndarray

    def is_same_as(self, other: _Ranked, width: float) -> bool:
        """Return True where both are one function of the same signals, in other words.

        The rows hold less evidence of their difference, in units of `width`, than the parameters of
        one of them are worth. Waves of frequencies that the rows do not tell apart are two
        functions: they part between the recordings.
        """
        waves = self.law.frequencies, other.law.frequencies
        if all(waves) and not np.allclose(*waves):
            return False
        signals = [{f.source.origin for f in each.law.factors} for each in (self, other)]
        apart = 0.5 * float(np.sum((self.rows - other.rows) ** 2)) / width
        return signals[0] == signals[1] and apart < PARAMETER_LOG_PRICE * self.law.parameter_count


class _State:
    """Findings so far, to which a law is added."""

    def __init__(
        self,
        comparison: Comparison,
        kept: Sequence[Selected],
        irreplaceable: Collection[tuple[object, ...]],
    ) -> None:
        self.comparison, self.kept = comparison, list(kept)
        self._irreplaceable = irreplaceable
        # Keys of findings that a law took the place of but does not explain.
        self.restored: set[tuple[object, ...]] = set()
        self.effects = [each.located for each in kept]
        # Without stated tolerances many effects may be missing: laws only join them, where
        # recordings left out support all.
        self._strict = comparison.bodies is not None
        self._ranked: list[_Ranked] = []
        self._dropped: list[LocatedEffect] = []

    def searched_channels(self, unexplained: set[int]) -> list[int]:
        """Return channels that hold more than noise, and those whose findings may stand for a law.

        A channel with findings that explain it is searched in their place alone. Joints with an
        unexplained channel come first, then those findings: of what is near the noise little can be
        told. Of each, torques come first, then the worst: a torque on a link winds up its joint
        too, a deflection does not change the torque.
        """
        fit, n = self.comparison.fit(self.effects), self.comparison.robot.n
        beyond = np.nan_to_num(self.comparison.channel_ratio(fit.residual) / self.comparison.least)
        named = {
            each.channel % n
            for each in self.kept
            if not each.located.calibrated and each.located.key not in self._irreplaceable
        }
        found = [
            int(c)
            for c in np.argsort(-beyond)
            if self.comparison.rows.counts[c]
            and (
                c in unexplained
                or self._findings_at(int(c))
                or (beyond[c] > FAINT_RATIO and c % n not in named)
            )
        ]
        open_joints = {c % n for c in unexplained}
        return sorted(
            found, key=lambda c: (c % n not in open_joints, not self._findings_at(c), c >= n)
        )

    def _findings_at(self, channel: int) -> list[Selected]:
        """Return the findings at a channel's joint that a law could take the place of."""
        return [
            each
            for each in self.kept
            if each.channel % self.comparison.robot.n == channel % self.comparison.robot.n
            and self._is_replaceable(each)
        ]

    def _is_replaceable(self, selected: Selected) -> bool:
        """Return True for a finding that a law could take the place of."""
        located = selected.located
        law = located.effect.family == LAW_FAMILY
        if self._strict or located.calibrated or law:
            return False
        return located.key not in self._irreplaceable

    def search(self, number: int, *, is_open: bool) -> ChannelLaw | None:
        """Search a channel for a law in place of its findings or, where it is open, beside them.

        None where no law is likelier than findings that explain the channel.
        """
        own = self._findings_at(number)
        beside = OpenChannel(self.comparison, self.effects, number)
        if own:
            replaced = [each.located for each in own]
            others = [e for e in self.effects if e not in replaced]
            apart = OpenChannel(self.comparison, others, number)
            if may_beat(apart, beside.square, own):
                outcome = search_channel(apart)
                if outcome.best is not None and beats(
                    apart,
                    outcome.best,
                    beside.square,
                    own,
                    significant=self._are_significant(own),
                ):
                    self.effects, self._dropped = others, replaced
                    return outcome
            if not is_open:
                return None
        return search_channel(beside)

    def _are_significant(self, findings: Sequence[Selected]) -> bool:
        """Return False where one of the findings is as likely zero as not."""
        estimate = estimate_parameters(self.comparison, self.effects)
        chances = [estimate.p_value(self.effects.index(each.located)) for each in findings]
        return all(null_probability(each) < 1.0 - NAMED_PROBABILITY for each in chances)

    def add(self, outcome: ChannelLaw) -> FoundLaw | None:
        """Fit a law beside the effects; None where they leave it nothing."""
        assert outcome.best is not None
        # The noise is that beside a law: beside none, all laws would seem equally good.
        first = self._named(outcome.best.law, outcome.best.fit.amplitudes.tolist())
        beside = self.comparison.linearised_at(self.comparison.fit([*self.effects, first]))
        ranked = self._rank_places(beside, (outcome.best, *outcome.near))
        if not ranked or not self._predicts_other_runs(ranked):
            return None
        located = ranked[0].located
        effects = [*self.effects, located]
        current = self.comparison.linearised_at(self.comparison.fit(effects))
        kept = prune_effects(current, effects)
        if self._strict:
            kept = select_predictive(current, kept)
        if located not in kept or not _is_determined(current, kept, located):
            return None
        self.restored = {each.key for each in self._restorable(current, kept)}
        if self.restored:
            return None
        self.comparison = current.linearised_at(current.fit(kept))
        self.effects = kept
        self._ranked = ranked
        return FoundLaw(
            law=ranked[0].law,
            located=located,
            channel=channel_name(outcome.channel.channel, self.comparison.robot.n),
            explained=outcome.explained,
            attainable=outcome.attainable,
            tried=outcome.best.tried,
            evidence=outcome.best.evidence,
        )

    def _predicts_other_runs(self, ranked: Sequence[_Ranked]) -> bool:
        """Return False where several frequencies of one wave share the probability.

        Each fits the runs it was fitted to, and none tells the phase of another run.
        """
        first = ranked[0].law
        probabilities = softmax(self._log_odds(ranked))
        alike = [each.law.structure == first.structure for each in ranked]
        return not first.frequencies or bool(
            probabilities[0] >= NAMED_PROBABILITY * probabilities[alike].sum()
        )

    def _restorable(
        self, comparison: Comparison, effects: list[LocatedEffect]
    ) -> list[LocatedEffect]:
        """Return the findings that the law took the place of but does not explain."""
        scorer = Scorer(comparison, effects)
        scored = [(each, scorer.score(each)) for each in self._dropped]
        return [e for e, own in scored if own is not None and passes_thresholds(own, scorer)]

    def _named(self, law: Law, amplitudes: Sequence[float]) -> LocatedEffect:
        """Return a law as an effect at its joint, with a name of its own."""
        effect = law_effect(law, amplitudes)
        same = sum(each.effect.name.startswith(effect.name) for each in self.effects)
        if same:
            effect = replace(effect, name=f"{effect.name}_{same + 1}")
        return LocatedEffect(effect=effect, joint=law.joint, shapes=law.shapes)

    def _rank_places(self, comparison: Comparison, fitted: Sequence[FittedLaw]) -> list[_Ranked]:
        """Return laws where they act best, with their evidence over all channels, the best first.

        A torque acts on the motor, or on the link, which winds up the joint too: where torques are
        noisy, the deflection alone shows it.
        """
        scorer = Scorer(comparison, self.effects)
        found: list[_Ranked] = []
        for each in fitted:
            places: dict[Place, float] = {each.law.place: 1.0}  # size over that of its channel
            if each.law.place == "drive_torque" and comparison.robot.elastic:
                places["link_torque"] = 1.0
            if each.law.place == "deflection" and not each.law.yields:
                stiffness = _mean_stiffness(comparison, each.law.joint)
                if np.isfinite(stiffness):
                    places["link_torque"] = stiffness
            for place, size in places.items():
                law = replace(each.law, place=place)
                located = self._named(law, (size * each.fit.amplitudes).tolist())
                candidate = scorer.score(located)
                if candidate is not None:
                    rows = comparison.effect_columns(located) @ candidate.amplitudes
                    price = 0.5 * len(law.shapes) * np.log(len(rows))
                    found.append(_Ranked(candidate.evidence - float(price), law, located, rows))
        odds, width = self._log_odds(found), _evidence_width(found)
        kept: list[_Ranked] = []
        for number in np.argsort(-odds):
            own = found[number]
            if odds.max() - odds[number] >= RIVAL_LOG_ODDS:
                break
            same = [k for k, other in enumerate(kept) if own.is_same_as(other, width)]
            if not same:
                kept.append(own)
            elif own.evidence > kept[same[0]].evidence:
                # One function within the accuracy of formulas, so that odds do not tell its words
                # apart; those that fit better continue better beyond the range that was met.
                kept[same[0]] = own
        return kept

    def _log_odds(self, ranked: Sequence[_Ranked]) -> np.ndarray:
        """Return log odds of laws among one another, on the scale of rivals of the catalogue."""
        width, n = _evidence_width(ranked), self.comparison.robot.n
        prices = [PARAMETER_LOG_PRICE * e.law.parameter_count - e.law.log_prior(n) for e in ranked]
        return np.asarray(np.array([e.evidence for e in ranked]) / width - prices)

    def answer(self, result: SearchResult) -> SearchResult:
        """Return the result with the law, and without effects that it makes superfluous."""
        known = {each.located.key: each for each in self.kept}
        selected = []
        for located in self.effects:
            if located.key in known:
                selected.append(known[located.key])
                continue
            others = [e for e in self.effects if e is not located]
            scored = Scorer(self.comparison, others).score(located)
            if scored is None:
                continue
            own, *theirs = softmax(self._log_odds(self._ranked)).tolist()
            rivals = [each.located for each in self._ranked[1:]]
            selected.append(
                Selected(
                    located=located,
                    loss=scored.evidence,
                    deviations=scored.deviations,
                    probability=own,
                    rivals=tuple(zip(rivals, theirs, strict=True)),
                    channel=scored.channel,
                )
            )
        fit = self.comparison.fit([each.located for each in selected])
        return replace(
            result,
            selected=tuple(selected),
            comparison=self.comparison,
            fit=fit,
            after=self.comparison.channel_ratio(fit.residual),
        )


def _evidence_width(ranked: Sequence[_Ranked]) -> float:
    """Return the unit of differences of evidence among laws."""
    return tempering_width(max((each.evidence for each in ranked), default=0.0))


def _mean_stiffness(comparison: Comparison, joint: int) -> float:
    """Return a joint's load over its nominal wind-up, root mean squares of all runs [N m/rad].

    Infinite where the joint is rigid.
    """
    load, windup = (
        np.concatenate([LawSource(kind, joint).value_in(run) for run in comparison.runs])
        for kind in ("load", "windup")
    )
    wound = float(np.linalg.norm(windup))
    return float(np.linalg.norm(load)) / wound if wound > 0.0 else np.inf


def _is_determined(
    comparison: Comparison, effects: Sequence[LocatedEffect], law: LocatedEffect
) -> bool:
    """Return True where a law's function stands out of its deviation between parts and runs.

    Sharp forms in a few samples gain evidence with an amplitude that is anything.
    """
    estimate = estimate_parameters(comparison, effects)
    return estimate.deviations(list(effects).index(law)) >= CONFIRMED_DEVIATIONS
