"""Find laws in the channels that the catalogue leaves open, and fit them beside its findings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.judging.unexplained import assess_findings, channel_name
from stiffopt.discovery.law_search.fit_law import FittedLaw
from stiffopt.discovery.law_search.open_channel import OpenChannel
from stiffopt.discovery.law_search.search import ChannelLaw, family_width, search_channel
from stiffopt.discovery.laws.law import Law, law_effect
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.search.joint_fit import prune_effects
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult

# Channels that are searched, the worst first, and laws that are added at most.
_MAX_CHANNELS, MAX_LAWS = 3, 3


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundLaw:
    """A law that holds.

    Parameters
    ----------
    law : Law
    located : LocatedEffect
        The law as an effect at its joint.
    channel : str
        Such as "torque_3".
    explained, attainable : float
        Share of the channel's excess that the law, and the best free function of signals, explain
        in parts of the training runs left out.
    tried : int
        Number of laws among which it was the best.
    evidence : float
        Log evidence, less the price of its parameters and of the laws tried.
    """

    law: Law
    located: LocatedEffect
    channel: str
    explained: float
    attainable: float
    tried: int
    evidence: float


@dataclass(frozen=True, kw_only=True, eq=False)
class LawSearch:
    """Result of a search for laws.

    Parameters
    ----------
    result : SearchResult
        With the laws among its effects; the given one where none holds.
    laws : tuple of FoundLaw
    refused : tuple of ChannelLaw
        Channels in which none holds, with what any law could explain.
    """

    result: SearchResult
    laws: tuple[FoundLaw, ...] = ()
    refused: tuple[ChannelLaw, ...] = ()


def find_laws(result: SearchResult, say: Callable[[str], object]) -> LawSearch:
    """Search the residual that the catalogue leaves for laws.

    Parameters
    ----------
    result : SearchResult
        Of the catalogue, by training runs.
    say : callable
        Called with a sentence at every step.

    Notes
    -----
    It runs only where the verdict on the catalogue leaves a residual, of more than one run and
    within the band of the fit. A finding of the catalogue that a law makes superfluous is dropped.
    """
    kept, left = assess_findings(result)
    if left is None or left.brief or left.alone is not None or result.comparison.after_model:
        return LawSearch(result=result)
    state = _State(result.comparison, [each.located for each in kept])
    n = result.comparison.robot.n
    waiting = [channel_number(name, n) for name in left.channels[:_MAX_CHANNELS]]
    refused: list[ChannelLaw] = []
    while waiting and len(state.laws) < MAX_LAWS:
        number = waiting.pop(0)
        say(f"search {channel_name(number, n)} for a law that no catalogue has")
        outcome = search_channel(OpenChannel(state.comparison, state.effects, number))
        if outcome.best is None or not state.add(outcome):
            refused.append(outcome)
            continue
        say(f"found {state.laws[-1].located.effect.equation}")
    if not state.laws:
        return LawSearch(result=result, refused=tuple(refused))
    return LawSearch(
        result=state.answer(result, kept), laws=tuple(state.laws), refused=tuple(refused)
    )


def channel_number(name: str, joints: int) -> int:
    """Return the number of a channel of a name, such as "torque_3"."""
    kind, _, joint = name.rpartition("_")
    return int(joint) - 1 + (0 if kind == "torque" else joints)


class _State:
    """Effects fitted so far, laws among them."""

    def __init__(self, comparison: Comparison, effects: Sequence[LocatedEffect]) -> None:
        self.comparison, self.effects = comparison, list(effects)
        self.laws: list[FoundLaw] = []
        self._families: dict[str, tuple[list[LocatedEffect], np.ndarray]] = {}

    def add(self, outcome: ChannelLaw) -> bool:
        """Fit a law beside the effects; return False where they leave it nothing."""
        assert outcome.best is not None
        scorer = Scorer(self.comparison, self.effects)
        law, located = _choose_place(scorer, outcome.best)
        if located is None:
            return False
        effects = [*self.effects, located]
        current = self.comparison.linearised_at(self.comparison.fit(effects))
        kept = prune_effects(current, effects)
        if located not in kept:
            return False
        self.comparison = current.linearised_at(current.fit(kept))
        self.effects = kept
        self.laws.append(
            FoundLaw(
                law=law,
                located=located,
                channel=channel_name(outcome.channel.channel, self.comparison.robot.n),
                explained=outcome.explained,
                attainable=outcome.attainable,
                tried=outcome.best.tried,
                evidence=outcome.best.evidence,
            )
        )
        others = [replace(each.law, place=law.place) for each in outcome.family]
        self._families[located.label] = (
            [
                _locate(o, each.fit.amplitudes)
                for o, each in zip(others, outcome.family, strict=True)
            ],
            np.array([outcome.best.evidence, *(each.evidence for each in outcome.family)]),
        )
        return True

    def answer(self, result: SearchResult, kept: Sequence[Selected]) -> SearchResult:
        """Return the result with the laws, and without effects that they make superfluous."""
        known = {each.located.key: each for each in kept}
        selected = []
        for located in self.effects:
            if located.key in known:
                selected.append(known[located.key])
                continue
            scored = Scorer(self.comparison, [e for e in self.effects if e is not located]).score(
                located
            )
            if scored is None:
                continue
            rivals, evidence = self._families[located.label]
            own, *theirs = softmax(evidence / family_width(evidence[0])).tolist()
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


def _locate(law: Law, amplitudes: Sequence[float]) -> LocatedEffect:
    return LocatedEffect(effect=law_effect(law, amplitudes), joint=law.joint, shapes=law.shapes)


def _choose_place(scorer: Scorer, best: FittedLaw) -> tuple[Law, LocatedEffect | None]:
    """Return a law where it acts: on the motor, or on the link, which winds up the joint too."""
    places = ("drive_torque", "link_torque")
    laws = [best.law]
    if best.law.place in places and scorer.comparison.robot.elastic:
        laws = [replace(best.law, place=place) for place in places]
    scored = []
    for law in laws:
        found = scorer.score(_locate(law, best.fit.amplitudes))
        if found is not None:
            scored.append((found.evidence, law, found.located))
    if not scored:
        return best.law, None
    _, law, located = max(scored, key=lambda each: each[0])
    return law, located
