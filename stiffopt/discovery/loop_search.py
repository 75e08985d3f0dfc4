"""Search in the simulation from commands, for effects that filtered torques do not show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erfc, expit, softmax

from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.least_squares import MAX_FIT_SECONDS, Score
from stiffopt.closed_loop.parameters import Parameters
from stiffopt.closed_loop.polish import limit_gain, score_amplitudes
from stiffopt.closed_loop.simulation import STRETCH_SECONDS, CommandedRun
from stiffopt.discovery.comparison.located_effect import (
    EstimatedEffect,
    Extension,
    LocatedEffect,
    effect_places,
)
from stiffopt.discovery.conclusions import findings_with_loop_values, refuted
from stiffopt.discovery.diagnosis import Finding, Parameter, Rival
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.extended.value_changes import extended_model
from stiffopt.discovery.judging.unexplained import Unexplained
from stiffopt.discovery.loop_effects import (
    inseparable_parameters,
    loop_parameter,
    robot_in_loop,
    stated_value,
)
from stiffopt.discovery.loop_fit import (
    commanded_run,
    is_commanded,
)
from stiffopt.discovery.names import Channel
from stiffopt.discovery.position_fit import ClosedLoopModel, fit_positions
from stiffopt.discovery.progress import Say
from stiffopt.discovery.search.rivals import tempering_width
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.thresholds import (
    EXPLAINED_SHARE,
    MAX_EFFECTS,
    NAMED_DEVIATIONS,
    NAMED_EVIDENCE,
    PARAMETER_LOG_PRICE,
    RIVAL_LOG_ODDS,
)
from stiffopt.discovery.training import Training
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.recording.state_pair import StatePair

# Chance that any of the stated values of an arm that lacks nothing is named.
MAX_CHANCE = 0.05
# Difference of the sum of log residuals over noise between fits that are equally good.
_EQUAL_MISFIT = 0.05


@dataclass(frozen=True, eq=False)
class FittedLoop:
    """Fit of the simulation that begins with some findings; without a model it is unstable."""

    found: Extension
    model: ClosedLoopModel | None

    def begins_with(self, found: Extension) -> bool:
        """Return whether its findings are these, with whatever amplitudes."""
        own, other = ([e.located.key for e in each.effects] for each in (self.found, found))
        return own == other


def explained_joints(
    recordings: RecordingSet, model: ClosedLoopModel | None, result: SearchResult
) -> tuple[int, ...]:
    """Return the joints (from 0) of a set that a simulation explains, whatever torques leave.

    It leaves noise, or less of the torques that a search leaves than findings have to explain.
    """
    if model is None:
        return ()
    comparison, n = result.comparison, recordings.n
    filtered = np.mean([run.low_pass.noise_gain for run in comparison.rows.runs])
    size = filtered * comparison.noise.torque * result.after[:n]
    small = model.left_torque[recordings.order] ** 2 < (1.0 - EXPLAINED_SHARE) * size**2
    return tuple(np.flatnonzero(small | ~model.lacks[recordings.order]).tolist())


def beyond_simulation(
    unexplained: Unexplained | None, explained: Sequence[int]
) -> Unexplained | None:
    """Return a residual of torques unless a simulation explains all its joints (from 0)."""
    if unexplained is None:
        return None
    joints = {Channel.read(name).joint - 1 for name in unexplained.channels}
    return None if joints <= set(explained) else unexplained


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopSearch:
    """Fits of the simulation, with one more effect at a time."""

    recordings: RecordingSet
    training: Training
    asked: Sequence[Effect]  # effects that the recordings can identify
    runs: Sequence[RecordedRun]
    estimated: Parameters | None  # drives of joints whose gain gives torque no scale
    say: Say

    def fit(self, found: Extension) -> FittedLoop:
        """Return the fit beginning with some findings, or with none where they are unstable."""
        model = self._fit(found)
        if model is None and found.effects:
            found = Extension()
            model = self._fit(found)
        return FittedLoop(found, model)

    def run(
        self, found: Extension, findings: Sequence[Finding], fitted: FittedLoop | None = None
    ) -> tuple[ClosedLoopModel | None, tuple[Finding, ...]]:
        """Return the fit beginning with some findings, and these with what it needs besides.

        `fitted`: a fit at hand, which is taken if it begins with the same.

        Findings that another one brings about are left out.
        """
        given, added = found.effects, list[Finding]()
        if fitted is None or not fitted.begins_with(found):
            fitted = self.fit(found)
            found = fitted.found
        model = fitted.model
        if model is None:
            return None, tuple(findings)
        if model.lacks.any():
            # A limit too low lets the joint drift: no slope leads back from there.
            limits = [each for each in found.effects if each.effect.limits_drive]
            model, found = self._fit_without(limits, model, found)
            wrong = [each for each in limits if each not in found.effects]
            findings = [refuted(f, 1.0) if f.estimated in wrong else f for f in findings]
        model, found, findings = self._leave_out_unsure(model, found, findings)
        model, found, findings = self._replace_losses(model, found, findings)
        # Joints by what they leave; what the initial shapes of an effect leave is no second effect.
        # Where torque has no scale, sizes of effects are unknown.
        searched = set[int]()
        while len(added) < MAX_EFFECTS:
            assert model.noise_ratio is not None
            ratio = np.where(model.lacks & model.loop.law.scaled, model.noise_ratio, 0.0)
            ratio[list(searched)] = 0.0
            worst = int(np.argmax(ratio))
            if ratio[worst] == 0.0:
                break
            searched.add(worst)
            self.say("search the simulation's residual")
            whole = self._model(found, added)
            least = NAMED_EVIDENCE / self._stretch_count
            for look, gain in ((self._limit, least), (self._best, 0.0)):
                new = look(model, whole, worst)
                better = None if new is None else self._fit(found, [*added, new])
                if new is not None and better is not None and better.misfit < model.misfit - gain:
                    self.say(f"found {new.located.label} in the simulation")
                    model, added = better, [*added, new]
                    break
        judged = self._judge(model, (*findings, *added))
        claimed = [each.located for each in judged if each.certainty != "possible"]
        # The model that is stored has effects that this simulation is without.
        without = tuple(e.located.label for e in given if e not in found.effects)
        own = self._judge(model, tuple(self._own_values(model, claimed)))
        # One value is told once.
        judged = tuple(f for f in judged if not any(f.located.same_place(o.located) for o in own))
        return replace(model, without=without), (*judged, *own)

    def _leave_out_unsure(
        self, model: ClosedLoopModel, found: Extension, findings: Sequence[Finding]
    ) -> tuple[ClosedLoopModel, Extension, Sequence[Finding]]:
        """Leave out findings that are not sure and that the simulation fits as well without.

        Those whose values it takes to be zero may only stand in for simpler ones. Physics of their
        own that it does not need is refuted; a value that every fit has is not left out by this.
        """
        judged = self._judge(model, findings)
        physics = {key for key, _ in model.loop.physics.amplitudes.names}
        zero = [each for each in judged if each.certainty == "possible"]
        unsure = [f for f in judged if f.certainty != "found" and f.located.key in physics]
        every = [each.estimated for each in (*zero, *unsure)]
        simpler, rest = self._fit_without(every, model, found, _EQUAL_MISFIT)
        if rest is not found:
            spare = [each.estimated for each in unsure]
            own = [refuted(f, 1.0) if f.estimated in spare else f for f in findings]
            return simpler, rest, own
        if any(each not in zero for each in unsure):
            only = [each.estimated for each in zero]
            model, found = self._fit_without(only, model, found, _EQUAL_MISFIT)
        return model, found, findings

    def _fit_without(
        self,
        spare: Sequence[EstimatedEffect],
        model: ClosedLoopModel,
        found: Extension,
        allowed: float = 0.0,
    ) -> tuple[ClosedLoopModel, Extension]:
        """Return the fit without some effects if its misfit rises by less than allowed."""
        rest = replace(found, effects=tuple(e for e in found.effects if e not in spare))
        fewer = len(rest.effects) < len(found.effects)
        # A wrong limit has strained all other values.
        strained = any(each.effect.limits_drive for each in spare)
        simpler = self._fit(rest, before=None if strained else model) if fewer else None
        if simpler is not None and simpler.misfit < model.misfit + allowed:
            return simpler, rest
        return model, found

    def _judge(self, model: ClosedLoopModel, findings: Sequence[Finding]) -> tuple[Finding, ...]:
        known = self.training
        return findings_with_loop_values(
            self.recordings, known.constants, model, findings, known.before, known.runs
        )

    def _own_values(
        self, model: ClosedLoopModel, taken: Sequence[LocatedEffect]
    ) -> Iterator[Finding]:
        """Yield values of the fit that are not the nominal ones, beside findings.

        What no nominal model has is zero. What is stated lies farther beyond its tolerance than any
        of all stated values would by chance. In a joint that the simulation leaves open it is as
        likely as the share of noise in what is left.
        """
        constants, fitted = self.training.constants, model.fitted
        assert model.polished is not None
        assert model.noise_ratio is not None
        covariance = model.polished.whole_covariance()
        order = self.recordings.order
        places = [
            (located, parameter, stated_value(self.recordings, entry, int(order[located.joint])))
            for entry in self.asked
            if (parameter := loop_parameter(entry)) is not None
            and entry.scope == "joint"
            and not entry.only_in
            and entry.nominal not in self.recordings.unstated
            for located in effect_places(entry, constants, ())
            if located.joint is not None
        ]
        count = sum(stated is not None for *_, stated in places)
        for located, parameter, stated in places:
            entry, joint = located.effect, int(order[located.joint or 0])
            shifted = entry.shifts_weight and any(each.effect.shifts_weight for each in taken)
            rows, factors = inseparable_parameters(model.loop.law, fitted, parameter.name, joint)
            place, fitted_value = rows[0], float(factors @ fitted.values[rows])
            sd = float(np.sqrt(factors @ covariance[np.ix_(rows, rows)] @ factors))
            sd *= abs(parameter.slope(fitted_value))
            known = any(located.same_place(other) for other in taken)
            if shifted or known or sd <= 0.0:
                continue
            before = (e for own in self.training.before for e in own.effects)
            alike = [e.amplitudes[0] for e in before if e.located.same_place(located)]
            value, chance = float(parameter.convert(fitted_value)) - sum(alike), 0.0
            if stated is not None:
                value -= stated[0]
                chance = count * float(erfc(abs(value) / np.hypot(sd, stated[1]) / 2**0.5))
            else:
                evidence = model.log_evidence(place, value / sd)
                chance = 0.0 if evidence > NAMED_EVIDENCE else 1.0
            if chance < MAX_CHANCE and abs(value) > NAMED_DEVIATIONS * sd:
                taken = [*taken, located]
                estimated = EstimatedEffect(located=located, amplitudes=(value,))
                # Beside a residual it may stand for its cause.
                of_noise = 1.0 / model.noise_ratio[joint] ** 2 if model.lacks[joint] else 1.0
                yield self._finding(estimated, 1.0, (1.0 - chance) * of_noise)

    def _finding(
        self,
        estimated: EstimatedEffect,
        explained: float,
        probability: float = 1.0,
        rivals: tuple[Rival, ...] = (),
    ) -> Finding:
        constants, located = self.training.constants, estimated.located
        own = located.constants(constants)
        told = located.effect.parameters(estimated.amplitudes, located.shapes, own)
        return Finding(
            estimated=estimated,
            link=None,
            probability=probability,
            misfit=0.0,
            rivals=rivals,
            parameters=tuple(
                Parameter(
                    name=name,
                    value=value,
                    sd=0.0,
                    unit=located.unit_of(name, constants),
                    prior_sd=np.inf,
                )
                for name, value in told.items()
            ),
            where=located.effect.signature,
            channel=f"torque_{(located.joint or 0) + 1}",
            variance_explained=explained,
        )

    def _model(self, found: Extension, added: Sequence[Finding]) -> Extension:
        return found.plus(Extension(effects=tuple(each.estimated for each in added)))

    def _fit(
        self,
        found: Extension,
        added: Sequence[Finding] = (),
        before: ClosedLoopModel | None = None,
    ) -> ClosedLoopModel | None:
        if isinstance(self.recordings, StatePair):
            return None  # one simulation is none of two states
        self.say("simulate the training runs from their commands")
        constants = self.training.constants
        model = extended_model(self.recordings, constants, self._model(found, added))
        return fit_positions(self.recordings, self.runs, model, self.estimated, self.say, before)

    def _best(self, model: ClosedLoopModel, whole: Extension, place: int) -> Finding | None:
        """Return the likeliest effect that a joint of the robot (from 0) lacks, with its rivals."""
        constants = self.training.constants
        joint = int(np.flatnonzero(self.recordings.order == place)[0])
        candidates = list(self._candidates(joint, [each.located for each in whole.effects]))
        scores = self._scores(model, whole, candidates, place)
        best: dict[tuple[object, ...], tuple[float, LocatedEffect, Score]] = {}
        for located, score in zip(candidates, scores, strict=True):
            if score is None:
                continue
            price = PARAMETER_LOG_PRICE * (len(score.amplitudes) + len(located.shapes))
            usual = located.effect.log_prior
            prior = usual(located.constants(constants)) if usual else 0.0
            key = located.key[:-1]
            if key not in best or score.evidence > best[key][2].evidence:
                best[key] = (score.evidence + prior - price, located, score)
        ranked = sorted(best.values(), key=lambda each: -each[0])
        if not ranked:
            return None
        most, located, score = ranked[0]
        if score.evidence < NAMED_EVIDENCE or score.deviations < NAMED_DEVIATIONS:
            return None
        width = tempering_width(score.evidence)
        near = [each for each in ranked[:4] if (each[0] - most) / width > -RIVAL_LOG_ODDS]
        shares = softmax([each[0] / width for each in near])
        rivals = tuple(
            Rival(located=each[1], probability=float(share))
            for each, share in zip(near[1:], shares[1:], strict=True)
        )
        estimated = EstimatedEffect(located=located, amplitudes=score.amplitudes)
        return self._finding(estimated, score.explained, float(shares[0]), rivals)

    @property
    def _stretch_count(self) -> float:
        """Number of stretches that a fit reads: within one residuals repeat one another."""
        recorded = sum(float(np.ptp(run.time)) for run in self._fitted_runs)
        return min(recorded, MAX_FIT_SECONDS / self.recordings.n) / STRETCH_SECONDS

    @property
    def _fitted_runs(self) -> list[CommandedRun]:
        """Runs that a fit reads."""
        return [commanded_run(self.recordings, run) for run in self.runs if is_commanded(run)]

    def _candidates(self, joint: int, taken: Sequence[LocatedEffect]) -> Iterator[LocatedEffect]:
        """Yield effects at a joint whose torque a formula of an instant gives."""
        constants = self.training.constants
        for entry in self.asked:
            # Every fit has the values of all loops; slopes at none lead to no limit.
            other = entry.limits_drive or entry.of_runs or entry.scope != "joint"
            if loop_parameter(entry) is not None or other:
                continue
            for located in effect_places(entry, constants, ()):
                known = any(located.same_place(other) for other in taken)
                if located.joint == joint and not known and located.possible(constants):
                    yield located

    def _scores(
        self,
        model: ClosedLoopModel,
        whole: Extension,
        candidates: Sequence[LocatedEffect],
        place: int,
    ) -> list[Score | None]:
        """Return the log evidence of each candidate beside all that is fitted; None without one.

        None as well of those with which the simulation diverges. `place`: joint of the robot (from
        0).
        """
        recordings, constants = self.recordings, self.training.constants
        none = [
            EstimatedEffect(located=each, amplitudes=(0.0,) * len(each.effect.amplitudes))
            for each in candidates
        ]
        known = extended_model(recordings, constants, whole)
        robot, physics, _ = robot_in_loop(recordings, known, none)
        loop = CommandedArm(robot.tree, model.loop.law, model.loop.middle, physics)
        count = len(model.loop.physics.amplitudes.names)
        names = physics.amplitudes.names[count:]
        groups = [[k for k, (key, _) in enumerate(names) if key == each.key] for each in candidates]
        assert model.polished is not None
        try:
            scores = score_amplitudes(loop, self._fitted_runs, model.polished, groups, place)
        except FloatingPointError:
            if len(candidates) < 2:
                return [None] * len(candidates)
            middle = len(candidates) // 2
            halves = candidates[:middle], candidates[middle:]
            return [own for half in halves for own in self._scores(model, whole, half, place)]
        found: list[Score | None] = []
        for each, group, score in zip(none, groups, scores, strict=True):
            # Amplitudes that are no torque of an instant, as of friction that is lost, are none.
            amplitudes = np.zeros(len(each.amplitudes))
            if score is not None:
                amplitudes[[names[k][1] for k in group]] = score.amplitudes
                score = replace(score, amplitudes=tuple(amplitudes.tolist()))
            found.append(score)
        return found

    def _limit(self, model: ClosedLoopModel, whole: Extension, place: int) -> Finding | None:
        """Return a limit of the drive of a joint of the robot (from 0), if the runs show one.

        Told from the expected values: a fit without the limit has strained all others.
        """
        recordings, constants = self.recordings, self.training.constants
        joint = int(np.flatnonzero(recordings.order == place)[0])
        taken = [each.located for each in whole.effects]
        limits = [
            located
            for entry in self.asked
            if entry.limits_drive
            for located in effect_places(entry, constants, ())
            if located.joint == joint and not any(located.same_place(own) for own in taken)
        ]
        if not limits or model.expected is None:
            return None
        highest = EstimatedEffect(located=limits[-1], amplitudes=(1.0,))
        known = extended_model(recordings, constants, whole)
        robot, physics, _ = robot_in_loop(recordings, known, [highest])
        loop = CommandedArm(robot.tree, model.loop.law, model.loop.middle, physics)
        values, count = model.expected.values, len(model.loop.physics.amplitudes.names)
        begun = np.concatenate([values[:-1], physics.amplitudes.values[count:], values[-1:]])
        prior = replace(model.expected, values=begun, amplitude_bounds=physics.amplitudes.bounds)
        odds = self._stretch_count * limit_gain(loop, self._fitted_runs, prior, place)
        return self._finding(highest, 1.0) if odds > RIVAL_LOG_ODDS else None

    def _replace_losses(
        self, model: ClosedLoopModel, found: Extension, findings: Sequence[Finding]
    ) -> tuple[ClosedLoopModel, Extension, tuple[Finding, ...]]:
        """Replace friction that vanishes by its cause where the simulation fits better with it."""
        constants, kept = self.training.constants, list(findings)
        for finding in findings:
            entry, joint = finding.effect, finding.located.joint
            parameter = loop_parameter(entry)
            if parameter is None or joint is None or not entry.nominal:
                continue
            place = int(self.recordings.order[joint])
            value = model.fitted.of(parameter.name)[place]
            sd = model.deviations[model.fitted.place(parameter.name)][place]
            if not model.lacks[place] or value > sd:
                continue
            causes = (
                located
                for each in self.asked
                if each.loses == entry.nominal
                for located in effect_places(each, constants, ())
                if located.joint == joint
            )
            if (cause := next(causes, None)) is None:
                continue
            amplitudes = (float(cause.sizes(constants)[0]), 1.0)
            estimated = EstimatedEffect(located=cause, amplitudes=amplitudes)
            new = with_findings(found, [finding], [])
            new = new.plus(Extension(effects=(estimated,)))
            better = self._fit(new)
            if better is not None and better.misfit < model.misfit:
                share = float(expit(self._stretch_count * (model.misfit - better.misfit)))
                rival = Rival(located=finding.located, probability=1.0 - share)
                own = self._finding(estimated, finding.variance_explained, share, (rival,))
                kept[kept.index(finding)] = own
                model, found = better, new
        return model, found, tuple(kept)


def with_findings(
    extension: Extension, before: Sequence[Finding], after: Sequence[Finding]
) -> Extension:
    """Return an extension with findings that have come, and without those that have gone."""
    old, new = ({each.located.key: each.estimated for each in some} for some in (before, after))
    kept = [e for e in extension.effects if e.located.key in new or e.located.key not in old]
    come = (each for key, each in new.items() if key not in old)
    return replace(extension, effects=(*kept, *come))
