"""What the mismatch is made of: how much each part of the answer takes away on runs left out.

The mismatch is the squares over the sensors' noise that the nominal model leaves above it, all
channels together, as in the residuals over noise that an answer states. Parts are taken in the
order of what they take away beside those before them, so that shares add up to one with what stays
open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.proof.predict import Predictor
from stiffopt.discovery.proof.proof import RunProof, used_samples

Kind = Literal["unstated", "nominal", "usual", "finding"]


@dataclass(frozen=True, kw_only=True)
class Part:
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
class Share:
    """How much of the mismatch a part takes away.

    Parameters
    ----------
    part : Part or None
        None for what stays open.
    share : float
        Of the squares above noise that the nominal model leaves on runs left out; below zero where
        it does harm there.
    """

    part: Part | None
    share: float


def parts_of(extension: Extension, unstated: Sequence[str]) -> tuple[Part, ...]:
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
    return tuple(Part(kind=kind, effects=tuple(own)) for (kind, _), own in by_name.items())


class Shares:
    """Sums over held-out runs that shares are made of.

    Parameters
    ----------
    parts : sequence of Part
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self._parts = tuple(parts)
        # Products of what stays open and of what each part takes away, over the noise's variance.
        self._gram = np.zeros((len(parts) + 1, len(parts) + 1))
        self._samples = 0

    def add(
        self,
        predictor: Predictor,
        start: tuple[Extension, ...],
        found: Extension,
        proof: RunProof,
    ) -> None:
        """Take in a run that is predicted with everything, and without each part."""
        without = [predictor.predict(*start, part.left_out_of(found)) for part in self._parts]
        run = predictor.run
        judged = {(each.kind, each.joint): each for each in proof.channels}
        gram, samples = self._gram.copy(), self._samples
        for kind, joint, used in used_samples(run, predictor.velocity):
            if used is None or (kind, joint) not in judged:
                continue
            channel = judged[kind, joint]
            samples += channel.samples
            places = np.searchsorted(run.stamps, run.time)[used]
            own = getattr(proof.after, kind)[places, joint]
            left = getattr(run, kind)[used, joint] - own
            added = [own - getattr(each, kind)[places, joint] for each in without]
            columns = np.column_stack([left, *added]) / channel.noise
            gram += columns.T @ columns
        # The whole run or, where an interruption comes before, none of it.
        self._gram, self._samples = gram, samples

    def found(self) -> tuple[Share, ...]:
        """Shares in the order of what they take away, what is open last; may be none."""
        mismatch = float(self._gram.sum()) - self._samples
        if mismatch <= 0.0:
            return ()

        def open_with(out: set[int]) -> float:
            """Share of the mismatch that is open with all parts but these."""
            kept = [0, *(k + 1 for k in sorted(out))]
            return (float(self._gram[np.ix_(kept, kept)].sum()) - self._samples) / mismatch

        out, now, shares = set(range(len(self._parts))), 1.0, []
        while out:
            left = {k: open_with(out - {k}) for k in out}
            best = min(left, key=left.__getitem__)
            shares.append(Share(part=self._parts[best], share=now - left[best]))
            out.remove(best)
            now = left[best]
        return (*shares, Share(part=None, share=now))
