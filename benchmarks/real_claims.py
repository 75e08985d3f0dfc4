"""Whether a diagnosis of real recordings overreaches: refuted claims, and answers of shorter runs.

A claim is refuted where the model fitted without it predicts the finding's channel of the held-out
runs better, and confirmed where it predicts worse; within 0.5 % these runs do not tell.
An answer is stable where training runs with a shorter start give the same names at P >= 0.8 and a
held-out residual within 5 %.
"""

from __future__ import annotations

import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.blind.sets import write_set
from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.diagnosis import Diagnosis, fit_by_channel
from stiffopt.discovery.prediction import Predictor, compare_predictions, nrmse
from stiffopt.discovery.search.uncertainty import estimate_parameters

# A finding of at least this probability is a claim.
CLAIM_PROBABILITY = 0.8
# Shares of the training runs' start that are left out.
START_CUTS = (0.03, 0.05, 0.10)
# Relative difference of held-out residuals below which runs do not tell two models apart.
INDIFFERENCE = 0.005
# Held-out residuals within this ratio agree.
AGREEMENT_RATIO = 1.05
# What every joint has and the nominal model may not state: no claim of missing physics.
FRICTION_NAMES = frozenset({"coulomb", "viscous", "rotor_inertia", "torque_offset"})


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A claim, and the held-out residual of its channel by models fitted with and without it."""

    label: str
    probability: float
    fitted_with: float
    fitted_without: float

    @property
    def judgement(self) -> str:
        """Return "confirmed", "refuted", or "not told" where held-out runs cannot tell."""
        ratio = self.fitted_without / self.fitted_with
        if abs(ratio - 1.0) <= INDIFFERENCE:
            return "not told"
        return "confirmed" if ratio > 1.0 else "refuted"


def claims(diagnosis: Diagnosis) -> list[Claim]:
    """Judge each claim beyond friction on the held-out runs."""
    located = [entry.located for entry in diagnosis.extension.effects]
    whole = _residual_by_channel(diagnosis, located)
    found = []
    for finding in diagnosis.findings:
        if finding.probability < CLAIM_PROBABILITY or finding.effect.name in FRICTION_NAMES:
            continue
        others = [each for each in located if each.key != finding.located.key]
        without = _residual_by_channel(diagnosis, others)
        found.append(
            Claim(
                label=f"{finding.effect.name} {finding.joint or finding.link or ''}".strip(),
                probability=finding.probability,
                fitted_with=whole[finding.channel],
                fitted_without=without[finding.channel],
            )
        )
    return found


def _residual_by_channel(
    diagnosis: Diagnosis, located: Sequence[LocatedEffect]
) -> dict[str, float]:
    """Held-out residuals of a model of these effects, refitted to the training runs."""
    estimate = estimate_parameters(diagnosis.search.comparison, tuple(located))
    fitted = Extension(calibration=estimate.calibration(), effects=estimate.effects)
    training = diagnosis.training
    proofs = []
    for proof in diagnosis.held_out:
        predictor = Predictor(training, proof.run)
        predicted = list(predictor.predict_each([(), (fitted,)]))
        proofs.append(
            compare_predictions(proof.run, predictor.velocity, *predicted, training.noise)
        )
    prismatic = [joint.prismatic for joint in training.constants.joints]
    return {fit.channel: fit.rms_after for fit in fit_by_channel(tuple(proofs), prismatic)}


@dataclass(frozen=True, kw_only=True)
class CutAnswer:
    """Answer to training runs with a shorter start.

    `remaining` is the held-out residual over that of the nominal model: the noise by which
    residuals are divided is itself estimated from the training runs.
    """

    share: float
    names: frozenset[str]
    remaining: float

    def agrees(self, names: frozenset[str], remaining: float) -> bool:
        """Same names, and a held-out residual within `AGREEMENT_RATIO`."""
        ratio = self.remaining / remaining
        return self.names == names and 1.0 / AGREEMENT_RATIO <= ratio <= AGREEMENT_RATIO


def claimed_names(diagnosis: Diagnosis) -> frozenset[str]:
    """Names and places of all findings at P >= 0.8."""
    return frozenset(
        f"{f.effect.name} {f.joint or f.link or ''}".strip()
        for f in diagnosis.findings
        if f.probability >= CLAIM_PROBABILITY
    )


def remaining_residual(diagnosis: Diagnosis) -> float:
    """Held-out residual of the extended model over that of the nominal model."""
    proofs = list(diagnosis.held_out)
    return nrmse(proofs, "after") / nrmse(proofs, "before")


def answers_of_cut_runs(source: Path) -> list[CutAnswer]:
    """Diagnose a set again with the start of each training run left out."""
    told = tomllib.loads((source / "recordings.toml").read_text(encoding="utf-8"))
    training = {Path(r["file"]).stem for r in told["runs"] if r.get("role", "train") == "train"}
    found = []
    for share in START_CUTS:

        def cut(name: str, columns: dict[str, np.ndarray], part: float = share) -> dict:
            if name not in training:
                return columns
            begin = round(part * len(next(iter(columns.values()))))
            return {key: values[begin:] for key, values in columns.items()}

        with tempfile.TemporaryDirectory() as folder:
            again = diagnose(write_set(source, Path(folder) / "set", told, cut), experiment=False)
        found.append(
            CutAnswer(
                share=share,
                names=claimed_names(again),
                remaining=remaining_residual(again),
            )
        )
    return found
