"""What the mismatch is made of: how much each part of the answer takes away on runs left out.

Every channel counts alike, as the share of the squares that the nominal model leaves there. Parts
are taken in the order of what they take away beside those before them, so that shares add up to
one with what stays open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.proof.predict import Prediction, Predictor
from stiffopt.discovery.proof.proof import used_samples

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
        Of the squared residual that the nominal model leaves on runs left out; below zero where it
        does harm there.
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
    channels : int
        Torques, then link positions.
    """

    def __init__(self, parts: Sequence[Part], channels: int) -> None:
        self._parts = tuple(parts)
        self._gram = np.zeros((channels, len(parts) + 1, len(parts) + 1))

    def add(
        self,
        predictor: Predictor,
        start: tuple[Extension, ...],
        found: Extension,
        after: Prediction,
    ) -> None:
        """Take in a run that is predicted with everything, and without each part."""
        without = [predictor.predict(*start, part.left_out_of(found)) for part in self._parts]
        run = predictor.run
        for number, (kind, joint, used) in enumerate(used_samples(run, predictor.velocity)):
            if used is None:
                continue
            places = np.searchsorted(run.stamps, run.time)[used]
            own = getattr(after, kind)[places, joint]
            left = getattr(run, kind)[used, joint] - own
            added = [own - getattr(each, kind)[places, joint] for each in without]
            columns = np.column_stack([left, *added])
            self._gram[number] += columns.T @ columns

    def found(self) -> tuple[Share, ...]:
        """Shares in the order of what they take away, what is open last; none without a run."""
        seen = self._gram.sum(axis=(1, 2)) > 0.0
        gram = self._gram[seen]
        if not len(gram):
            return ()
        whole = gram.sum(axis=(1, 2))

        def open_with(out: set[int]) -> float:
            """Mean share of the squares that is open with all parts but these."""
            kept = [0, *(k + 1 for k in sorted(out))]
            return float(np.mean(gram[:, kept][:, :, kept].sum(axis=(1, 2)) / whole))

        out, now, shares = set(range(len(self._parts))), 1.0, []
        while out:
            left = {k: open_with(out - {k}) for k in out}
            best = min(left, key=left.__getitem__)
            shares.append(Share(part=self._parts[best], share=now - left[best]))
            out.remove(best)
            now = left[best]
        return (*shares, Share(part=None, share=now))
