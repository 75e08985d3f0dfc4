"""How much of a channel's residual an effect takes away in recordings left out of the fit."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.evidence import BlockSums, Sums, posterior
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search.uncertainty import stretches


def variance_explained(
    comparison: Comparison, effects: tuple[LocatedEffect, ...], channels: tuple[int, ...]
) -> tuple[float, ...]:
    """Share of the squared residual above noise that each effect takes away.

    Parameters
    ----------
    comparison : Comparison
    effects : tuple of LocatedEffect
    channels : tuple of int
        The channel that is looked at for each effect.

    Returns
    -------
    tuple of float
        0 to 1, one an effect.

    Notes
    -----
    Every block (a training run; a stretch where runs are few, and for what is of each run) is
    predicted with nominal values and
    amplitudes fitted to the other blocks, once with all of it and once without what the effect in
    question adds. Nominal values stay as fitted beside the effect: fitted without it, they leave
    their tolerances to stand in for it. Above noise: less what the rows' stated noise alone would
    leave.
    """
    runs = comparison.rows.block if comparison.blocks > 1 else stretches(comparison)
    # One run cannot be predicted from others where there is none, nor what is of one run alone.
    by_run = [each.is_run_specific for each in effects]
    ways = [_left_out(comparison, effects, runs)]
    if any(by_run):
        ways.append(_left_out(comparison, effects, stretches(comparison)))
    shares = []
    for index, channel in enumerate(channels):
        residual, added = ways[by_run[index]]
        own_part = added[index]
        own = comparison.rows.channel == channel
        noise = float(own.sum())
        before = float(np.sum((residual + own_part)[own] ** 2)) - noise
        after = float(np.sum(residual[own] ** 2)) - noise
        shares.append(float(np.clip(1.0 - after / before, 0.0, 1.0)) if before > 0.0 else 0.0)
    return tuple(shares)


def _left_out(
    comparison: Comparison, effects: tuple[LocatedEffect, ...], block: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residual (m,) of blocks that the fit did not see, and what each effect adds to them (e, m).

    Both over the stated noise.
    """
    _, sd, nuisance = comparison.nuisance
    parts = [comparison.effect_columns(e) for e in effects]
    columns = np.column_stack([nuisance, *parts])
    prior = np.concatenate([sd, np.ones(sum(p.shape[1] for p in parts))])
    sums = BlockSums(columns, comparison.target, block, int(block.max()) + 1)
    gram, moment, square = (x.sum(axis=0) for x in (sums.gram, sums.moment, sums.square))
    residual = np.empty_like(comparison.target)
    added = np.empty((len(effects), len(residual)))
    for b in range(len(sums.square)):
        rest = Sums(
            (gram - sums.gram[b])[None],
            (moment - sums.moment[b])[None],
            np.array([square - sums.square[b]]),
        )
        own = block == b
        mean = posterior(rest, prior, cross_validate=False).mean
        residual[own] = comparison.target[own] - columns[own] @ mean
        begin = len(sd)
        for index, part in enumerate(parts):
            end = begin + part.shape[1]
            added[index, own] = part[own] @ mean[begin:end]
            begin = end
    weight = comparison.inflation[comparison.rows.channel]
    return residual * weight, added * weight
