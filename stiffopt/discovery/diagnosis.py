"""Result of a diagnosis: findings, verdict, proof on held-out runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.experiment.design import ExperimentPlan
from stiffopt.discovery.extended.schema import ClosedLoopSection, LeftOpenSection
from stiffopt.discovery.judging.detection_limits import DetectionLimit
from stiffopt.discovery.judging.episodes import Episode
from stiffopt.discovery.judging.explained_shares import MismatchShare
from stiffopt.discovery.judging.modes import ModeShift
from stiffopt.discovery.judging.noise_ceiling import NoiseCeiling
from stiffopt.discovery.judging.run_deviations import Drift, NotCarriedOver
from stiffopt.discovery.judging.unexplained import ChannelVerdict, Unexplained
from stiffopt.discovery.law_search.find import FoundLaw, RefusedChannel
from stiffopt.discovery.position_fit import PositionRun
from stiffopt.discovery.prediction import RunProof, nrmse
from stiffopt.discovery.sanity.doubt import Doubt
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import FOUND_PROBABILITY, NAMED_PROBABILITY
from stiffopt.discovery.training import Training
from stiffopt.formatting import pm
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import Fault
from stiffopt.recording.state_pair import StatePair
from stiffopt.result.solution import DisplayedResult

# Standard deviation of a determined value over that before any recording: half the variance.
_DETERMINED_SHARE = 0.5**0.5

Verdict = Literal["named", "law_found", "nothing_missing", "outside_catalogue"]
Certainty = Literal["found", "likely", "one of these", "possible"]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """Reported value of a finding."""

    name: str
    # value, sd: the value and one standard deviation [unit].
    value: float
    sd: float
    unit: str
    # Standard deviation before any recording; infinite where nothing is known [unit].
    prior_sd: float = float("inf")

    @property
    def determined(self) -> bool:
        """False where the recordings say next to nothing of the value."""
        return self.sd <= max(_DETERMINED_SHARE * self.prior_sd, abs(self.value))

    @property
    def text(self) -> str:
        """Value with its standard deviation and unit, or "not determined"."""
        return pm(self.value, self.sd, self.unit) if self.determined else "not determined"


@dataclass(frozen=True, kw_only=True, eq=False)
class Rival:
    """An effect that the data do not tell apart from a finding."""

    located: LocatedEffect
    probability: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """An effect that the nominal model lacks."""

    estimated: EstimatedEffect  # effect, place, shapes and amplitudes
    link: str | None  # name of the link, of effects of a link
    probability: float  # against its rivals and an unknown cause (`misfit`)
    # Probability of an unknown cause: by what laws leave open in its channel over what it removes
    # there, by the spread of its gain in stretches left out, by the members of the perturbation
    # ensemble that lack it, by its values where these do not exclude zero, and by held-out runs
    # that are predicted better without it.
    misfit: float
    rivals: tuple[Rival, ...]
    parameters: tuple[Parameter, ...]
    where: str  # how and where the effect shows
    channel: str  # channel that it changes most, such as "torque_3"
    # Share, 0 to 1, of that channel's squared residual above noise that it removes in training runs
    # (or stretches) left out of the fit.
    variance_explained: float
    # Root mean square of what it adds to that channel in training runs: values that make up for one
    # another may be uncertain, each by itself, where their function is not. None: not estimated.
    size: Parameter | None = None
    # Root mean square residual of that channel in held-out runs over that of a model fitted without
    # the finding; None where they do not tell.
    held_out_ratio: float | None = None
    # Probability that it is not there: by the spread of its gain in stretches of the training runs
    # left out, and by its values where these do not exclude zero.
    absence: float = 0.0

    @property
    def located(self) -> LocatedEffect:
        """The effect with its place."""
        return self.estimated.located

    @property
    def effect(self) -> Effect:
        """Entry of the catalogue."""
        return self.located.effect

    @property
    def group_probability(self) -> float:
        """Probability that it or one of its rivals is the cause."""
        return self.probability + sum(rival.probability for rival in self.rivals)

    @property
    def certainty(self) -> Certainty:
        """Certainty in one word: only what is found or likely is named."""
        if self.probability >= FOUND_PROBABILITY:
            return "found"
        if self.probability >= NAMED_PROBABILITY:
            return "likely"
        together = self.rivals and self.group_probability >= NAMED_PROBABILITY
        return "one of these" if together else "possible"

    @property
    def is_change(self) -> bool:
        """True for a change between two states of the robot."""
        return bool(self.effect.only_in)

    @property
    def joint(self) -> int | None:
        """Joint from 1; None for effects of the whole robot or of a link."""
        return None if self.located.joint is None else self.located.joint + 1


@dataclass(frozen=True, kw_only=True)
class ChannelFit:
    """Residual of one channel over all test and extrapolation runs."""

    channel: str  # such as "torque_3"
    # rms_before, rms_after, noise [unit]
    rms_before: float
    rms_after: float
    noise: float
    unit: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Diagnosis(DisplayedResult):
    """Result of a diagnosis: effects that the nominal model lacks, and their proof.

    Parameters
    ----------
    model : str or None
        Path of the extended model that it started from.
    verdict : str
        "named", "law_found" (named, a law beyond the catalogue among it), "nothing_missing" or
        "outside_catalogue"; the last also where the residual beside the findings is many times the
        noise.
    findings : tuple of Finding
        The strongest first; fixed before any held-out run was read. These may refute some: their
        probability falls.
    extension : Extension
        Difference of the extended from the nominal model.
    left_open : LeftOpenSection
        Residual of the training runs beside it.
    training : Training
        Prepared training runs, noise, tolerances, constants.
    search : SearchResult
        With the residuals of the training runs: `search.before`, `.calibrated` and `.after` over
        noise by channel, rows in `search.comparison.rows` and `search.fit.residual`.
    held_out : tuple of RunProof
        Test and extrapolation runs with their predictions before and after.
    shares : tuple of Share
        Parts of the mismatch of torques, then of link encoders on held-out runs: the largest
        first, the open residual last.
    noise_ceiling : NoiseCeiling or None
        Explained share of the best attainable fit; only where no tolerance of masses is stated.
    not_carried_over : tuple of NotCarriedOver
        Single values, such as an offset, that differ between a held-out and the training runs.
    catalogue : tuple of Effect
        Effects that were tried: the catalogue's and the user's.
    detection_limits : tuple of DetectionLimit
        Least sizes of other effects that the recordings would have shown.
    unexplained : Unexplained or None
        Residual that no effect of the catalogue explains.
    laws : tuple of FoundLaw
        Laws beyond the catalogue; each is the effect of a finding where it is significant.
    lawless : tuple of RefusedChannel
        Channels in which no law holds, and what any law could explain there.
    next_experiment : str
        Description of the next recording.
    faults : tuple of (str, Fault)
        Run and fault, of all runs.
    experiment : ExperimentPlan or None
        The designed motion of `next_experiment`; None where there are no two explanations to
        separate, or no motion separates them better than the training runs.
    doubts : tuple of Doubt
        Contradictions of the recordings to their description, ignored on request.
    drift : tuple of Drift
        Friction that differs from run to run, and the error of predictions from it.
    episodes : tuple of Episode
        Contact intervals, excluded from fit and proof.
    stopped : bool
        By Ctrl-C; the first assumptions say which steps were skipped.
    channel_verdicts : tuple of ChannelVerdict
        Verdict on each recorded channel by itself.
    modes : tuple of ModeShift
        Elastic modes within the band of the fit, lowest first; none without elastic joints.
    closed_loop : ClosedLoopSection or None
        Simulation from commands, fitted to the training runs; None for recorded torques.
    positions : tuple of PositionRun
        Held-out runs simulated from their commands.
    """

    recordings: RecordingSet
    settings: Settings
    model: str | None
    verdict: Verdict
    findings: tuple[Finding, ...]
    extension: Extension
    left_open: LeftOpenSection
    training: Training
    search: SearchResult
    held_out: tuple[RunProof, ...]
    shares: tuple[MismatchShare, ...]
    noise_ceiling: NoiseCeiling | None
    not_carried_over: tuple[NotCarriedOver, ...]
    catalogue: tuple[Effect, ...]
    detection_limits: tuple[DetectionLimit, ...]
    unexplained: Unexplained | None
    next_experiment: str
    assumptions: tuple[str, ...]
    faults: tuple[tuple[str, Fault], ...]
    experiment: ExperimentPlan | None = None
    modes: tuple[ModeShift, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    stopped: bool = False
    episodes: tuple[Episode, ...] = ()
    channel_verdicts: tuple[ChannelVerdict, ...] = ()
    drift: tuple[Drift, ...] = ()
    closed_loop: ClosedLoopSection | None = None
    positions: tuple[PositionRun, ...] = ()
    laws: tuple[FoundLaw, ...] = ()
    lawless: tuple[RefusedChannel, ...] = ()

    @property
    def compares_states(self) -> bool:
        """True where two states of the robot were compared."""
        return isinstance(self.recordings, StatePair)

    @property
    def changes(self) -> tuple[Finding, ...]:
        """Findings that act in the state after alone, without those that are only possible."""
        return tuple(f for f in self.findings if f.is_change and f.certainty != "possible")

    def facts(self) -> dict[str, str]:
        """Return verdict, findings and normalised residuals as short text."""
        found: dict[str, str] = {"verdict": self.verdict}
        for number, finding in enumerate(self.findings, start=1):
            place = finding.link or (f"joint {finding.joint}" if finding.joint else "robot")
            found[f"finding {number}"] = f"{finding.effect.name} of {place}"
        for role in ("test", "extrapolate"):
            if self.proofs(role):
                before, after = self.nrmse(role)
                found[f"residual over noise, {role}"] = f"{role} {before:.3g} to {after:.3g}"
        return found

    def table(self) -> dict[str, list[object]]:
        """Return a table with one row for each parameter of a finding."""
        rows = [(f, p) for f in self.findings for p in f.parameters]
        return {
            "effect": [f.effect.name for f, _ in rows],
            "joint": [f.joint for f, _ in rows],
            "link": [f.link for f, _ in rows],
            "run": [f.located.run for f, _ in rows],
            "parameter": [p.name for _, p in rows],
            "value": [p.value for _, p in rows],
            "sd": [p.sd for _, p in rows],
            "unit": [p.unit for _, p in rows],
            "probability": [f.probability for f, _ in rows],
            "variance_explained": [f.variance_explained for f, _ in rows],
        }

    def proofs(self, role: str) -> tuple[RunProof, ...]:
        """Return the held-out runs of one role, "test" or "extrapolate"."""
        return tuple(proof for proof in self.held_out if proof.run.role == role)

    def nrmse(self, role: str) -> tuple[float, float]:
        """Return the normalised residual of a role before and after; nan without samples."""
        proofs = self.proofs(role)
        return nrmse(proofs, "before"), nrmse(proofs, "after")

    @property
    def channels(self) -> tuple[ChannelFit, ...]:
        """Residuals by channel over all held-out runs."""
        return fit_by_channel(self.held_out, [j.prismatic for j in self.training.constants.joints])


def fit_by_channel(proofs: tuple[RunProof, ...], prismatic: list[bool]) -> tuple[ChannelFit, ...]:
    """Return root mean square residuals by channel over all runs."""
    found = []
    for kind, units in (("torque", ("N m", "N")), ("link_position", ("rad", "m"))):
        for joint, slides in enumerate(prismatic):
            own = [c for p in proofs for c in p.channels if (c.kind, c.joint) == (kind, joint)]
            count = sum(c.samples for c in own)
            if not count:
                continue
            found.append(
                ChannelFit(
                    channel=own[0].name,
                    rms_before=float(np.sqrt(sum(c.before for c in own) / count)),
                    rms_after=float(np.sqrt(sum(c.after for c in own) / count)),
                    noise=own[0].noise,
                    unit=units[slides],
                )
            )
    return tuple(found)


def build_rivals(selected: Selected, known: float = 1.0) -> tuple[Rival, ...]:
    """Return the rivals of an effect; all known causes together have probability `known`."""
    return tuple(
        Rival(located=located, probability=known * share) for located, share in selected.rivals
    )
