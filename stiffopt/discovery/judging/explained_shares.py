"""What the mismatch is made of: how much each part of the answer takes away on runs left out.

The mismatch is the squares over the sensors' noise that the nominal model leaves above it, torques
and link encoders each for themselves: an encoder's noise is so small that its offset would hide all
else. Parts are taken in the order of what they take away beside those before them, so that shares
add up to one with what stays open.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.evidence import BlockSums, Sums, posterior
from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.prediction import Predictor, RunProof, used_samples
from stiffopt.discovery.search.uncertainty import number_stretches

# Mean square above the noise, over its variance, of a residual of twice the noise.
_MIN_EXCESS_RATIO = 3.0

Kind = Literal["unstated", "nominal", "usual", "finding"]


@dataclass(frozen=True, kw_only=True)
class ExtensionPart:
    """Part of an extension.

    Parameters
    ----------
    kind : str
        "unstated": values that the nominal model does not give; "nominal": those that it gives,
        moved within tolerance or re-identified, with what was found of masses; "usual": offsets,
        which every robot has; "finding".
    effects : tuple of LocatedEffect
    """

    kind: Kind
    effects: tuple[LocatedEffect, ...] = ()

    def left_out_of(self, extension: Extension) -> Extension:
        """The extension without this part."""
        if self.kind == "nominal":
            extension = replace(extension, calibration={})
        keys = {located.key for located in self.effects}
        return replace(
            extension,
            effects=tuple(e for e in extension.effects if e.located.key not in keys),
        )


@dataclass(frozen=True, kw_only=True)
class MismatchShare:
    """How much of the mismatch a part takes away.

    Parameters
    ----------
    part : Part or None
        None for what stays open.
    measured : str
        "torque" or "link_position".
    share : float
        Of the squares above noise that the nominal model leaves there on runs left out; below zero
        where it does harm.
    """

    part: ExtensionPart | None
    measured: str
    share: float


def split_extension(extension: Extension, unstated: Sequence[str]) -> tuple[ExtensionPart, ...]:
    """Parts of an answer: findings of one effect together, what nobody had given by its kind.

    Parameters
    ----------
    extension : Extension
    unstated : sequence of str
        Nominal values that the set does not give.
    """
    by_name: dict[tuple[Kind, str], list[LocatedEffect]] = {}
    if any(extension.calibration.values()):
        by_name["nominal", ""] = []
    for each in extension.effects:
        effect = each.located.effect
        key: tuple[Kind, str] = ("finding", effect.name)
        if effect.nominal in unstated:
            key = ("unstated", effect.family)
        elif effect.usual:
            key = ("usual", effect.family)
        elif each.located.joint is None and effect.family == "inertial":
            key = ("nominal", "")
        by_name.setdefault(key, []).append(each.located)
    return tuple(ExtensionPart(kind=kind, effects=tuple(own)) for (kind, _), own in by_name.items())


class MismatchShares:
    """Sums over held-out runs that shares are made of.

    Parameters
    ----------
    parts : sequence of Part
    """

    def __init__(self, parts: Sequence[ExtensionPart]) -> None:
        self._parts = tuple(parts)
        # By what is measured: products of what stays open and of what each part takes away, over
        # the noise's variance, and the number of samples.
        self._sums: dict[str, tuple[np.ndarray, int]] = {}

    def add(
        self,
        predictor: Predictor,
        start: tuple[Extension, ...],
        found: Extension,
        proof: RunProof,
    ) -> None:
        """Take in a run that is predicted with everything, and without each part."""
        each = [(*start, part.left_out_of(found)) for part in self._parts]
        without = list(predictor.predict_each(each))
        run = predictor.run
        judged = {(each.kind, each.joint): each for each in proof.channels}
        sums, none = dict(self._sums), np.zeros((len(self._parts) + 1, len(self._parts) + 1))
        for kind, joint, used in used_samples(run, predictor.velocity):
            if used is None or (kind, joint) not in judged:
                continue
            channel = judged[kind, joint]
            places = np.searchsorted(run.stamps, run.time)[used]
            own = getattr(proof.after, kind)[places, joint]
            left = getattr(run, kind)[used, joint] - own
            added = [own - getattr(each, kind)[places, joint] for each in without]
            columns = np.column_stack([left, *added]) / channel.noise
            gram, samples = sums.get(kind, (none, 0))
            sums[kind] = gram + columns.T @ columns, samples + channel.samples
        # The whole run or, where an interruption comes before, none of it.
        self._sums = sums

    def found(self) -> tuple[MismatchShare, ...]:
        """Shares by what is measured, in the order of what they take away, then what is open.

        Of what the nominal model leaves within twice its noise only if that is the largest.
        """
        above = {kind: float(gram.sum()) - n for kind, (gram, n) in self._sums.items()}
        clear = [kind for kind, (_, n) in self._sums.items() if above[kind] > _MIN_EXCESS_RATIO * n]
        largest = max(above, key=above.__getitem__, default=None)
        chosen = clear or [kind for kind in above if kind == largest and above[kind] > 0.0]
        return tuple(share for kind in chosen for share in self._order_shares(kind, above[kind]))

    def _order_shares(self, measured: str, mismatch: float) -> Iterator[MismatchShare]:
        gram, samples = self._sums[measured]

        def open_with(out: set[int]) -> float:
            """Share of the mismatch that is open with all parts but these."""
            kept = [0, *(k + 1 for k in sorted(out))]
            return (float(gram[np.ix_(kept, kept)].sum()) - samples) / mismatch

        out, now = set(range(len(self._parts))), 1.0
        while out:
            left = {k: open_with(out - {k}) for k in out}
            best = min(left, key=left.__getitem__)
            yield MismatchShare(part=self._parts[best], measured=measured, share=now - left[best])
            out.remove(best)
            now = left[best]
        yield MismatchShare(part=None, measured=measured, share=now)


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
    runs = comparison.rows.block if comparison.blocks > 1 else number_stretches(comparison)
    # One run cannot be predicted from others where there is none, nor what is of one run alone.
    by_run = [each.by_run for each in effects]
    ways = [_predict_blocks(comparison, effects, runs)]
    if any(by_run):
        ways.append(_predict_blocks(comparison, effects, number_stretches(comparison)))
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


def _predict_blocks(
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
