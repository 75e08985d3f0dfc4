"""Shares of the mismatch that each part of the extension explains in recordings left out.

The mismatch is the excess of squares over the sensors' noise beside the nominal model, separately
for torques and link encoders, since the small noise of an encoder would dominate. Parts are ordered
by their decrease beside the parts before them, so that all shares and the open one add up to one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect
from stiffopt.discovery.prediction import Predictor, RunProof, used_samples

# Excess over the noise variance of a residual of twice the noise.
_MIN_EXCESS_RATIO = 3.0

Kind = Literal["unstated", "nominal", "usual", "finding"]


@dataclass(frozen=True, kw_only=True)
class ExtensionPart:
    """Part of an extension."""

    # "unstated": values that the nominal model does not state; "nominal": stated values fitted
    # within tolerance or re-identified, with findings of masses; "usual": offsets, which every
    # robot has; "finding".
    kind: Kind
    effects: tuple[LocatedEffect, ...] = ()

    def left_out_of(self, extension: Extension) -> Extension:
        """Return the extension without this part."""
        if self.kind == "nominal":
            extension = replace(extension, calibration={})
        keys = {located.key for located in self.effects}
        return replace(
            extension, effects=tuple(e for e in extension.effects if e.located.key not in keys)
        )


@dataclass(frozen=True, kw_only=True)
class MismatchShare:
    """Share of the mismatch that a part explains."""

    part: ExtensionPart | None  # None for the open share
    measured: str  # "torque" or "link_position"
    # Of the excess squares beside the nominal model in held-out runs; negative if it increases
    # them.
    share: float


def split_extension(extension: Extension, unstated: Sequence[str]) -> tuple[ExtensionPart, ...]:
    """Split an extension: findings by effect, unstated values by family.

    `unstated`: nominal values that the set does not state.
    """
    by_name: dict[tuple[Kind, object], list[LocatedEffect]] = {}
    if any(extension.calibration.values()):
        by_name["nominal", ""] = []
    for each in extension.effects:
        effect = each.located.effect
        key: tuple[Kind, object] = ("finding", effect.identity)
        if effect.only_in:
            pass  # a change between two states is told apart from what both have
        elif effect.nominal in unstated:
            key = ("unstated", effect.family)
        elif effect.usual:
            key = ("usual", effect.family)
        elif each.located.joint is None and effect.family == "inertial":
            key = ("nominal", "")
        by_name.setdefault(key, []).append(each.located)
    return tuple(ExtensionPart(kind=kind, effects=tuple(own)) for (kind, _), own in by_name.items())


class MismatchShares:
    """Sums over held-out runs from which shares are calculated."""

    def __init__(self, parts: Sequence[ExtensionPart]) -> None:
        self._parts = tuple(parts)
        # By kind of channel: products of the open residual and the contribution of each part, over
        # the noise variance, and the number of samples.
        self._sums: dict[str, tuple[np.ndarray, int]] = {}

    def add(
        self, predictor: Predictor, start: Sequence[Extension], found: Extension, proof: RunProof
    ) -> None:
        """Add a run, predicted with the whole extension and without each part."""
        without = list(
            predictor.predict_each([(*start, part.left_out_of(found)) for part in self._parts])
        )
        run = predictor.run
        judged = {(each.kind, each.joint): each for each in proof.channels}
        sums, none = dict(self._sums), np.zeros((len(self._parts) + 1, len(self._parts) + 1))
        for kind, joint, used in used_samples(run, predictor.velocity):
            if (kind, joint) not in judged:
                continue
            channel = judged[kind, joint]
            places = np.searchsorted(run.stamps, run.time)[used]
            own = getattr(proof.after, kind)[places, joint]
            left = getattr(run, kind)[used, joint] - own
            added = [own - getattr(each, kind)[places, joint] for each in without]
            columns = np.column_stack([left, *added]) / channel.noise
            gram, samples = sums.get(kind, (none, 0))
            sums[kind] = gram + columns.T @ columns, samples + channel.samples
        # Assigned last: after Ctrl-C a run is added as a whole or not at all.
        self._sums = sums

    def found(self) -> tuple[MismatchShare, ...]:
        """Return shares by kind of channel in decreasing order, the open share last.

        Kinds with a nominal residual below twice the noise only if no other is above.
        """
        above = {kind: float(gram.sum()) - n for kind, (gram, n) in self._sums.items()}
        clear = [kind for kind, (_, n) in self._sums.items() if above[kind] > _MIN_EXCESS_RATIO * n]
        largest = max(above, key=above.__getitem__, default=None)
        chosen = clear or [kind for kind in above if kind == largest and above[kind] > 0.0]
        return tuple(share for kind in chosen for share in self._order_shares(kind, above[kind]))

    def _order_shares(self, measured: str, mismatch: float) -> Iterator[MismatchShare]:
        gram, samples = self._sums[measured]

        def open_with(out: set[int]) -> float:
            """Return the open share of the mismatch with all parts but these."""
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
