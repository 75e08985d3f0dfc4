"""Search a channel for a law: screen signals, fit forms, demand recurrence and brevity."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.law_search.fit_law import (
    FittedLaw,
    as_fitted,
    fit_shapes,
    log_gain,
    score_starts,
)
from stiffopt.discovery.law_search.free_function import (
    FreeTerm,
    best_sum,
    carriers,
    screen,
    screen_products,
)
from stiffopt.discovery.law_search.open_channel import OpenChannel
from stiffopt.discovery.laws.law import Factor, Law, Place
from stiffopt.discovery.laws.shapes import SignalRange
from stiffopt.discovery.laws.sources import LawSource
from stiffopt.discovery.search.rivals import Selected, tempering_width
from stiffopt.discovery.thresholds import NAMED_EVIDENCE, PARAMETER_LOG_PRICE, RIVAL_LOG_ODDS

# Pairs of carrier and signal whose forms are tried: the best ones of every carrier, for one that
# explains much does so with any signal; they explain at least this share of what the best one does.
_PAIRS_PER_CARRIER, _MIN_PAIR_SHARE = 3, 0.5
MAX_FACTORS = 3
# Laws whose shapes are fitted, of the best initial shapes of every form; and of those with another
# form, or a second one, of one signal of a fitted law, which are many and begin near it.
_MAX_REFINED, _MAX_EXCHANGED = 10, 4
# Least share of the excess that a law explains in blocks left out, over all of it and over what
# free functions of any signals explain there.
MIN_EXPLAINED, MIN_SHARE_OF_FREE = 0.5, 0.85
# Laws, the best one among them, that are compared over all channels.
_MAX_NEAR = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelLaw:
    """Outcome of the search in one channel."""

    channel: OpenChannel
    best: FittedLaw | None  # the law; None where none holds
    near: tuple[FittedLaw, ...]  # the likeliest other laws
    # Share of the excess that the best law explains in blocks left out, also if it does not hold.
    explained: float
    attainable: float  # share that the best free function of the signals explains there
    free: tuple[FreeTerm, ...]  # that function
    free_share: float  # share that it explains itself
    refusal: str  # why no law holds; "" where one does


def search_channel(channel: OpenChannel) -> ChannelLaw:
    """Search one channel for a law."""
    terms = screen(channel)
    free, left = best_sum(channel, terms)
    found = _refine(channel, _ranked([*_fit_unscreened(channel), *_fit_pairs(channel, terms)]))
    if _is_short_of(channel, found):
        products = screen_products(channel)
        more, left_more = best_sum(channel, products)
        if left_more < left:
            free, left = more, left_more
        wider = _ranked([*found, *_fit_pairs(channel, products)])
        wider = _ranked([*wider, *(_add_factor(channel, wider[0]) if wider else [])])
        found = wider if wider[:1] == found[:1] else _refine(channel, wider)
    if found:
        first = _ranked([found[0], *_add_form(channel, found[0])])[0]
        found = _ranked([first, *found[1:]])
        found = _ranked([*found, *_fit_near_frequencies(channel, found[0])])
    best = found[0] if found else None
    explained = 0.0 if best is None else channel.share(best.left)
    attainable = channel.share(left)
    refusal = "no form fits" if best is None else _refuse(channel, best, attainable)
    return ChannelLaw(
        channel=channel,
        best=None if refusal else best,
        near=() if refusal else tuple(found[1:_MAX_NEAR]),
        explained=explained,
        attainable=max(attainable, explained),
        free=tuple(free),
        free_share=attainable,
        refusal=refusal,
    )


def _is_short_of(channel: OpenChannel, found: Sequence[FittedLaw]) -> bool:
    """Return True where the best law leaves enough beyond the noise to tell another one by."""
    return not found or log_gain(channel, found[0].left, len(channel.target)) > NAMED_EVIDENCE


def _fit_unscreened(channel: OpenChannel) -> list[FittedLaw]:
    """Return fitted laws that no spline suggests: carriers alone, with memory, periodic."""
    j = channel.joint
    laws = [Law(j, _place_of(channel), carrier) for carrier in carriers(channel)]
    for source in channel.sources:
        if source.joint in (j, None):
            every = _laws_of(channel, (), source)
            laws += [law for law in every if law.factors[-1].own.unscreened]
    return _fit_best(channel, laws, len(laws))


def _fit_pairs(channel: OpenChannel, terms: Sequence[FreeTerm]) -> list[FittedLaw]:
    """Return fitted laws of the most promising pairs of carrier and signal, the best first."""
    if not terms:
        return []
    most = channel.square - terms[0].left
    # Of one carrier by identity: products of a signal with others stand each for itself.
    taken: Counter[int] = Counter()
    laws: list[Law] = []
    for term in terms:
        if channel.square - term.left < _MIN_PAIR_SHARE * most:
            break
        taken[id(term.carrier)] += 1
        if taken[id(term.carrier)] <= _PAIRS_PER_CARRIER:
            laws += _laws_of_origin(channel, term.carrier, term.source.origin)
    laws = list(dict.fromkeys(laws))
    return _fit_best(channel, laws, len(laws))


def _laws_of_origin(channel: OpenChannel, base: Sequence[Factor], origin: LawSource) -> list[Law]:
    """Return the laws of one signal beside given factors, whatever function of it is its source.

    Where one of those is a function of the same signal, so are all carriers of it.
    """
    others = tuple(factor for factor in base if factor.source.origin != origin)
    bases = [tuple(base)]
    if len(others) < len(base):
        own = [c for c in carriers(channel) if all(f.source.origin == origin for f in c)]
        bases = [(*others, *carrier) for carrier in own]
    return [
        law
        for each in bases
        for source in channel.sources
        if source.origin == origin and source not in {factor.source for factor in each}
        for law in _laws_of(channel, each, source)
    ]


def _laws_of(channel: OpenChannel, base: Sequence[Factor], source: LawSource) -> list[Law]:
    """Return the laws of one signal beside given factors, with all initial shapes."""
    extent = _extent_of(channel, source, alone=not base)
    return [
        Law(channel.joint, _place_of(channel), (*base, factor))
        for form in source.own.forms
        for factor in Factor(source, form).starts(extent)
        if sum(len(f.own.formulas) > 1 for f in (*base, factor)) <= 1
    ]


def _extent_of(channel: OpenChannel, source: LawSource, *, alone: bool = False) -> SignalRange:
    """Return the range of a signal; of a clock with the likeliest frequencies.

    `alone`: without other signals, for which a position has the likeliest orders.
    """
    extent = channel.extent(source)
    if alone and source == LawSource("position", channel.joint):
        return replace(extent, peaks=channel.orders(source))
    if "wave" in source.own.forms:
        return replace(extent, peaks=channel.frequencies(source))
    return extent


def _place_of(channel: OpenChannel) -> Place:
    return "drive_torque" if channel.kind == "torque" else "deflection"


def _fit_best(
    channel: OpenChannel, laws: Sequence[Law], tried: int, most: int = _MAX_REFINED
) -> list[FittedLaw]:
    """Fit the shapes of the best starts of every structure; return them, the best first.

    `tried`: number of laws among which the best one is the best. `most`: number of structures that
    are fitted.
    """
    best: dict[object, FittedLaw] = {}
    if not laws:
        return []
    for law, fit in zip(laws, score_starts(channel, laws), strict=True):
        scored = as_fitted(channel, law, fit, tried)
        known = best.get(law.structure)
        if known is None or scored.fit.removed > known.fit.removed:
            best[law.structure] = scored
    head = _ranked(best.values())[:most]
    return _ranked([fit_shapes(channel, each.law, each.tried) for each in head])


def _exchange_forms(channel: OpenChannel, found: Sequence[FittedLaw]) -> list[FittedLaw]:
    """Return laws with those that have another form of one signal of the best one, until none is.

    Carriers are the simplest functions of a signal, and the products of two carriers of one signal
    stand for functions that are no carriers.
    """
    ranked = list(found)
    while ranked:
        best = ranked[0]
        known = {each.law.structure for each in ranked}
        laws = [
            law
            for origin in {factor.source.origin for factor in best.law.factors}
            for law in _laws_of_origin(channel, best.law.factors, origin)
            if len(law.factors) <= MAX_FACTORS and law.structure not in known
        ]
        others = _fit_best(channel, laws, best.tried + len(laws), _MAX_EXCHANGED)
        ranked = _ranked([*ranked, *others])
        if ranked[0] is best:
            break
    return ranked


def _refine(channel: OpenChannel, found: Sequence[FittedLaw]) -> list[FittedLaw]:
    """Return laws with other forms of the signals of the best ones where these are likelier."""
    return _generalise(channel, _exchange_forms(channel, found))


def _generalise(channel: OpenChannel, found: Sequence[FittedLaw]) -> list[FittedLaw]:
    """Put more general forms in place of those of the best laws while that is likelier.

    A law is no rival of its own refinement: what it leaves over is what its formula lacks.
    """
    return _ranked(
        [*(_most_likely_form(channel, e) for e in found[:_MAX_NEAR]), *found[_MAX_NEAR:]]
    )


def _most_likely_form(channel: OpenChannel, found: FittedLaw) -> FittedLaw:
    """Return a law, or a more general one that is likelier."""
    more = []
    for number, factor in enumerate(found.law.factors):
        if factor.own.general:
            own = factor.generalised(_extent_of(channel, factor.source))
            factors = (*found.law.factors[:number], own, *found.law.factors[number + 1 :])
            law = replace(found.law, factors=factors)
            if sum(len(each.own.formulas) > 1 for each in factors) <= 1:
                more.append(fit_shapes(channel, law, found.tried + _MAX_NEAR))
    best = max([found, *more], key=lambda each: each.evidence)
    return found if best is found else _most_likely_form(channel, best)


def _add_form(channel: OpenChannel, found: FittedLaw) -> list[FittedLaw]:
    """Return fitted laws in which one factor is the sum of two forms of its signal.

    The second form, with an amplitude of its own, is what the formula of the first one lacks.
    """
    laws, rest = [], channel.beside(channel.law_columns(found.law), found.fit)
    for number, factor in enumerate(found.law.factors):
        before, after = found.law.factors[:number], found.law.factors[number + 1 :]
        if any(len(other.own.formulas) > 1 for other in (*before, *after)):
            continue
        extent = _extent_of(rest, factor.source, alone=not (before or after))
        laws += [
            replace(found.law, factors=(*before, both, *after))
            for form in ("constant", *factor.source.own.forms)
            for both in factor.plus(form, extent)
        ]
    return _fit_best(channel, laws, found.tried * len(laws), _MAX_EXCHANGED)


def _fit_near_frequencies(channel: OpenChannel, best: FittedLaw) -> list[FittedLaw]:
    """Return the law at the other frequencies that single runs do not tell from its own."""
    fitted = []
    for wave, own in [(f, own) for f in best.law.factors for own in f.frequencies]:
        half_turn = 0.5 / channel.extent(wave.source).span
        near = channel.near_frequencies(wave.source, own)
        for frequency in [f for f in near if abs(f - own) > half_turn][:_MAX_NEAR]:
            shapes = tuple(frequency if value == own else value for value in wave.shapes)
            other = replace(wave, shapes=shapes)
            factors = tuple(other if each is wave else each for each in best.law.factors)
            fitted.append(fit_shapes(channel, replace(best.law, factors=factors), best.tried))
    return fitted


def _add_factor(channel: OpenChannel, found: FittedLaw) -> list[FittedLaw]:
    """Return laws with one more factor, or with a fitted form in place of a carrier."""
    if found.law.amplitude_count > 1 or len(found.law.factors) >= MAX_FACTORS:
        return []
    terms = screen(channel, found.law.factors)[:3]
    laws = [law for term in terms for law in _laws_of(channel, found.law.factors, term.source)]
    return _fit_best(channel, laws, found.tried + len(laws))


def _ranked(found: Iterable[FittedLaw]) -> list[FittedLaw]:
    return sorted(found, key=lambda each: -each.evidence)


# Relative difference of two functions, root mean square over the range met, within which they are
# one law: that within which a law counts as found.
SAME_FUNCTION = 0.1


def may_beat(channel: OpenChannel, named: float, findings: Sequence[Selected]) -> bool:
    """Return True where a law that leaves nothing but noise would beat findings, see `beats`."""
    noise = float(len(channel.target))
    return channel.square > noise and (
        _log_odds(channel, noise, named, findings, 1) > RIVAL_LOG_ODDS
    )


def beats(
    channel: OpenChannel,
    best: FittedLaw,
    named: float,
    findings: Sequence[Selected],
    *,
    significant: bool,
) -> bool:
    """Return True where a law in place of findings, which leave the squares `named`, is likelier.

    Likelier than the findings and all their rivals, by the odds that tell these apart: nature
    follows formulas nearly, those of the catalogue and of laws alike, and each is one of as many as
    there are, of laws more. A law that is the findings' function in other words is not likelier, of
    however few parameters; values of single runs are no function, and findings without a size that
    the data tell from zero (`significant` False) have no words for it.
    """
    left, own = channel.square - best.fit.removed, best.law
    is_function = significant and all(e.located.effect.of_runs is None for e in findings)
    if is_function and named - left < SAME_FUNCTION**2 * (channel.square - left):
        return False
    odds = _log_odds(channel, left, named, findings, own.parameter_count)
    prior = min(own.log_prior(channel.comparison.robot.n), -float(np.log(len(CATALOGUE))))
    return odds + prior > RIVAL_LOG_ODDS


def _log_odds(
    channel: OpenChannel,
    left: float,
    named: float,
    findings: Sequence[Selected],
    parameters: int,
) -> float:
    """Return the log odds of a law that leaves some squares over findings and their rivals."""
    width = tempering_width(log_gain(channel, channel.square, left))
    found = [each.located for each in findings]
    of_runs = [e.effect for e in found if e.effect.of_runs is not None]
    values = sum(len(own.amplitudes) for own in of_runs)
    # Values of single runs are random, and sum to zero. As many as a law has parameters it meets
    # anyhow; each further one that it tells counts by the likelihood that its spread takes.
    free = values - len(of_runs)
    told = max(free - parameters, 0)
    chance = 0.5 * told * np.log1p(max(channel.square - named, 0.0) / max(free, 1))
    of_functions = sum(len(e.effect.amplitudes) + len(e.shapes) for e in found) - values
    fewer = of_functions - max(parameters - free, 0)
    ahead = log_gain(channel, named, left) / width + chance + PARAMETER_LOG_PRICE * fewer
    among_rivals = sum(float(np.log(each.probability)) for each in findings)
    return float(ahead + among_rivals + len(findings) * np.log(len(CATALOGUE)))


def _refuse(channel: OpenChannel, best: FittedLaw, attainable: float) -> str:
    """Return why a law does not hold; "" where it does."""
    if best.evidence < NAMED_EVIDENCE:
        return "the evidence of the best law is that of chance"
    explained = channel.share(best.left)
    if explained < MIN_EXPLAINED:
        return f"the best law explains {100 * max(explained, 0.0):.0f} % of the excess"
    if explained < MIN_SHARE_OF_FREE * attainable:
        return (
            f"the best law explains {100 * explained:.0f} % of the excess, free functions of the"
            f" signals {100 * attainable:.0f} %"
        )
    if not _recurs(channel, best):
        return "the best law differs from run to run"
    return ""


def _recurs(channel: OpenChannel, best: FittedLaw) -> bool:
    """Return True where a law improves every part, by amplitudes of the same sign in each."""
    columns = channel.law_columns(best.law)
    for b in range(int(channel.block.max()) + 1):
        own = channel.block == b
        part, goal = columns[own], channel.target[own]
        if float(np.sum(part**2)) < 1e-3 * float(np.sum(columns**2)):
            continue  # it hardly acts there
        alone = np.linalg.lstsq(part, goal)[0]
        agreement = float(alone @ (part.T @ part) @ best.fit.amplitudes)
        if agreement <= 0.0 or best.fit.left[b] > float(goal @ goal):
            return False
    return True
