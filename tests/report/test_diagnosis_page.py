"""Pages of diagnoses with every verdict, compared with the diagnosis."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from page_reader import Page
from scipy import special

from stiffopt.discovery import answer
from stiffopt.discovery.answer import changed_values, fill, format_probability, statements
from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.conclusions import _null_share
from stiffopt.discovery.diagnosis import Parameter, Rival
from stiffopt.discovery.extended.value_changes import ValueChange
from stiffopt.discovery.judging.explained_shares import ExtensionPart, MismatchShare
from stiffopt.discovery.judging.unexplained import HeldOutExcess, Unexplained
from stiffopt.recording.run import Fault
from stiffopt.report.common.text import pm, significant
from stiffopt.report.diagnosis import sections
from stiffopt.report.diagnosis.figures import trace, worst_windows
from stiffopt.report.diagnosis.mismatch import mismatches
from stiffopt.report.diagnosis.page import write_diagnosis_report
from stiffopt.report.diagnosis.regimes import (
    binned_means,
    channel_residuals,
    finding_contribution,
    motion_direction,
    regimes,
)
from stiffopt.report.diagnosis.sections import print_diagnosis
from stiffopt.report.diagnosis.words import (
    channels_in_words,
    headline,
    paragraph,
    proof_sentence,
    saturation_sentences,
)
from stiffopt.units import joint_unit
from tests.discovery.simulated_sets import COULOMB, diagnosed


@pytest.fixture(scope="module")
def friction():
    return diagnosed(COULOMB)


def page_of(diagnosis, folder, png=False):
    page = Page(write_diagnosis_report(diagnosis, folder, png=png).read_text(encoding="utf-8"))
    assert not [each for each in page.outside if not each.startswith("data:")]
    assert "nan" not in page.text.split()
    return page


def unexplained_in(diagnosis, **changes):
    unexplained = Unexplained(
        channels=("torque_2", "link_position_1"),
        regressors=("time",),
        period=0.5,
        gain=0.4,
        ratio=9.0,
    )
    return replace(
        diagnosis,
        verdict="outside_catalogue",
        findings=(),
        unexplained=replace(unexplained, **changes),
    )


def test_page_lists_the_findings(friction, tmp_path):
    text = page_of(friction, tmp_path, png=True).text
    (finding,) = friction.findings
    parameter = finding.parameters[0]
    value = pm(parameter.value, parameter.sd, parameter.unit)
    assert headline(friction) == f"Joint 2: {value} more dry friction than the model"
    assert headline(friction) in text
    assert f"dFc = {value}" in text
    # The value to enter is the nominal one with the change.
    entered = 1.0 * friction.recordings.robot.coulomb[1] + parameter.value
    assert f"Enter Coulomb friction {significant(entered, 3)} N m for joint 2" in text
    for role in ("test", "extrapolate"):
        before, after = (significant(v, 3) for v in friction.nrmse(role))
        assert f"from {before} to {after} in" in text
    assert friction.next_experiment in text
    names = {path.stem for path in tmp_path.glob("*.svg")}
    assert {"diagnosis_balances", "diagnosis_regimes_1", "diagnosis_extrapolate"} <= names
    assert {path.stem for path in tmp_path.glob("*.png")} == names


def test_size_of_what_a_finding_adds_is_told(friction, tmp_path):
    """Dry friction adds its torque to either direction; where no value is told, its size is."""
    (finding,) = friction.findings
    (first,) = finding.parameters
    assert finding.size is not None
    assert finding.size.value == pytest.approx(first.value, rel=0.15)
    assert finding.size.sd / finding.size.value == pytest.approx(first.sd / first.value, rel=0.5)
    size = pm(finding.size.value, finding.size.sd, "N m")
    assert f"adds {size} rms" in page_of(friction, tmp_path).text
    untold = replace(finding, parameters=(replace(first, sd=2.0 * first.value),))
    told = headline(replace(friction, findings=(untold,)))
    assert told == f"Joint 2: {size} more dry friction than the model"


def test_changed_values_are_ordered_by_what_they_explain(friction, monkeypatch):
    """The value of the finding is first, however small; changes that read alike are left out."""
    first, *rest = changed_values(friction)
    assert (first.change.joint, first.change.quantity) == (2, "Coulomb friction")
    assert first.cause.startswith("Coulomb friction")
    assert {each.cause for each in rest} <= {"fitted within its tolerance"}
    changes = [
        ValueChange(1, "a", f"mass {new}", 35.8, new, "kg") for new in (35.8004, 35.81, 36.0)
    ]
    monkeypatch.setattr(answer, "value_changes", lambda *_: changes)
    assert [each.change.new for each in changed_values(friction)] == [35.81, 36.0]


@pytest.mark.parametrize(
    ("probability", "certainty", "words"),
    [(0.97, "found", "Joint 2"), (0.6, "likely", "Likely (60 %): joint 2"),
     (0.3, "one of these", "One of these: joint 2")],
)  # fmt: skip
def test_sentence_fits_the_probability(friction, probability, certainty, words):
    (finding,) = friction.findings
    other = Rival(located=replace(finding.located, joint=0), probability=0.95 - probability)
    rivals = (other,) if probability < 0.9 else ()
    shared = replace(finding, probability=probability, rivals=rivals)
    assert shared.certainty == certainty
    assert headline(replace(friction, findings=(shared,))).startswith(words)


def test_improbable_findings_are_neither_named_nor_listed(friction, tmp_path, capsys):
    (finding,) = friction.findings
    doubtful = replace(finding, probability=0.4)
    assert doubtful.certainty == "possible"
    none = replace(friction, findings=(replace(finding, probability=0.004),))
    assert statements(none) == []
    print_diagnosis(none, tmp_path)
    assert "dFc =" not in capsys.readouterr().out


def test_values_of_sliding_and_turning_joints_have_their_own_units(friction, monkeypatch):
    (finding,) = friction.findings
    other = replace(
        finding, estimated=replace(finding.estimated, located=replace(finding.located, joint=0))
    )
    monkeypatch.setattr(sections, "is_prismatic", lambda _, located: located.joint == 0)
    values = sections._unstated_row(friction, [other, finding])[2].splitlines()
    assert values[0].endswith(" N")
    assert values[1].endswith(" N m")


def test_value_that_is_zero_within_its_deviation_is_not_named():
    assert _null_share(2.0 * special.ndtr(-0.9)) > 0.5
    assert _null_share(2.0 * special.ndtr(-2.0)) == pytest.approx(0.275, abs=0.005)
    assert _null_share(1.0) == 1.0


def test_placeholders_of_phrases_and_remedies_are_reported_values():
    class Values(dict):
        def __missing__(self, key):
            raise AssertionError(f"{entry.name} reports no {key}")

    for entry in CATALOGUE:
        known = [a.name for a in (*entry.amplitudes, *entry.shapes)] + list(entry.units)
        named = Values({k: Parameter(name=k, value=2.0, sd=0.1, unit="") for k in known})
        named |= {f"c{axis}": Parameter(name="c", value=0.002, sd=0.1, unit="m") for axis in "xyz"}
        phrases = (entry.phrase,) if isinstance(entry.phrase, str) else entry.phrase
        remedies = () if callable(entry.remedy) else (entry.remedy,)
        for text in (*phrases, *remedies):
            assert "{" not in fill(text, named, {"where": "joint 1", "new": "3 N m"})


def test_values_of_a_place_share_a_unit():
    named = {
        f"c{axis}": Parameter(name=axis, value=value, sd=0.001, unit="m")
        for axis, value in zip("xyz", (-0.0001, 0.0022, 0.0817), strict=True)
    }
    named["dm"] = Parameter(name="dm", value=-1.484, sd=0.088, unit="kg")
    text = fill("{dm} lighter, at {cx/cy/cz}", named, signed=False)
    assert text == "1.48 ± 0.09 kg lighter, at 0/2/82 mm"


def test_remedies_with_undetermined_values_are_whole_sentences() -> None:
    """A clause whose value is undetermined is left out, the rest stays a sentence."""
    told = {}
    for entry in CATALOGUE:
        if isinstance(entry.remedy, str):
            keys = {key.split(":")[0] for key in re.findall(r"\{([^{}]+)\}", entry.remedy)}
            named = {
                name: Parameter(name=name, value=1.0, sd=9.0, unit="m", prior_sd=1.0)
                for key in keys
                for name in key.split("/")
            }
            told[entry.name] = fill(entry.remedy, named, {"where": "joint 1", "new": "3 N m"})
    assert all(text.endswith(".") for text in told.values())
    assert told["stroke_friction"] == "Look for a cable, seal or guard that rubs at joint 1."
    assert told["load_friction"] == "Look at the gear mesh and bearings of joint 1."
    assert "covers." in told["inertial_error"]


def test_large_unexplained_residual_is_reported_with_findings(friction, tmp_path, capsys):
    """Case of a torque constant that is wrong by a factor of two."""
    left = unexplained_in(friction, ratio=42.0, left=0.4).unexplained
    found = replace(friction, unexplained=left)
    text = page_of(found, tmp_path).text
    assert "42 times the noise remains unexplained in the torque of joint 2" in text
    assert "cause found, large unexplained residual" in text
    assert "check unit, torque constant and masses first" in text
    print_diagnosis(found, tmp_path)
    assert "42 times the noise remains unexplained" in " ".join(capsys.readouterr().out.split())
    near = replace(friction, unexplained=replace(left, ratio=3.0))
    assert headline(near) == headline(friction)


def test_page_of_an_effect_outside_the_catalogue(friction, tmp_path):
    found = replace(unexplained_in(friction), held_out=friction.proofs("test"), faults=())
    text = page_of(found, tmp_path).text
    assert "effect outside the catalogue acts on the torque of joint 2" in text
    assert "has a period of 0.5 s" in text
    assert "extrapolation, before" not in text
    assert (tmp_path / "diagnosis_spectrum.svg").exists()


def test_page_of_a_held_out_run_beyond_the_training_runs(friction, tmp_path):
    beyond = HeldOutExcess(run="test_1", begin=0.82, end=1.28, ratio=300.0)
    changed = unexplained_in(friction, regressors=(), period=None, gain=0.0, held_out=beyond)
    assert headline(changed).startswith("test_1 differs from all training runs in the torque of")
    told = " ".join(page_of(changed, tmp_path).text.split())
    assert "reaches 300 times the noise between 0.82 and 1.28 s" in told


def test_png_figures_are_written_on_request_only(friction, tmp_path):
    write_diagnosis_report(friction, tmp_path)
    assert {path.suffix for path in tmp_path.iterdir()} == {".html", ".svg"}


def test_channel_residuals_are_those_of_the_search(friction):
    for name, number in (("torque_2", 1), ("link_position_1", 2)):
        rows = channel_residuals(friction, name)
        for residual, ratios in ((rows.before, friction.search.before), (rows.after, None)):
            expected = (friction.search.after if ratios is None else ratios)[number]
            found = np.sqrt(np.mean((residual / rows.noise) ** 2))
            assert found == pytest.approx(expected, rel=1e-9)


def test_finding_contribution_is_the_fitted_friction(friction):
    (finding,) = friction.findings
    rows = channel_residuals(friction, "torque_2")
    added = finding_contribution(friction, finding, rows)
    speed = next(r.values for r in regimes(friction, rows) if r.name == "speed")

    def by_hand(run):
        # Links swing: a sign is the mean of its sample's time.
        side = run.signals.motor_direction[:, 1]
        assert np.mean(np.abs(side - np.tanh(run.signals.motor_velocity[:, 1] / 0.01))) < 1e-3
        return run.low_pass(side)

    filtered = friction.search.comparison.rows.sample_signal(by_hand)[rows.chosen]
    assert added == pytest.approx(finding.parameters[0].value * filtered, rel=1e-6, abs=1e-9)
    assert np.array_equal(motion_direction(friction, rows), np.sign(speed))
    # Friction of one joint is no business of another's.
    assert not finding_contribution(
        friction, finding, channel_residuals(friction, "torque_1")
    ).any()


def test_trace_squares_equal_those_of_the_proof(friction):
    for proof in friction.held_out:
        for error in proof.channels:
            shown = trace(friction, proof, error.name)
            for name in ("before", "after"):
                left = (shown.measured - getattr(shown, name))[shown.used]
                assert shown.used.sum() == pytest.approx(error.samples, rel=0.01)
                assert np.sum(left**2) == pytest.approx(getattr(error, name), rel=0.03)


def test_worst_windows_have_the_largest_residuals(friction):
    quiet = replace(
        friction,
        held_out=tuple(replace(p, after=p.before) for p in friction.held_out),
    )
    windows = worst_windows(quiet)
    assert windows
    assert windows[0].error.name == "torque_2"
    ratios = [w.ratio for w in windows]
    assert ratios == sorted(ratios, reverse=True)
    assert min(ratios) > 2.0
    assert all(0.0 < w.end - w.begin <= 0.5 + 1e-9 for w in windows)


def test_binned_means():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 3, 200), rng.normal(size=200)
    edges = np.array([0.0, 1.0, 1.02, 3.0])
    centre, mean, sd = binned_means(x, y, edges, least=10)
    first, last = y[x < 1.0], y[x >= 1.02]
    assert mean == pytest.approx([first.mean(), last.mean()])
    assert sd == pytest.approx([first.std() / np.sqrt(len(first)), last.std() / len(last) ** 0.5])
    assert 0.0 < centre[0] < 1.0 < centre[1] < 3.0


def test_page_with_nothing_missing(friction, tmp_path):
    none = replace(friction, verdict="nothing_missing", findings=())
    assert headline(none) == "Nothing is missing within the tolerances"
    assert "No effect of the catalogue is needed" in paragraph(none)
    page = page_of(none, tmp_path)
    assert page.table("channel", "noise")[0][0] == "torque of joint 1"
    limits = page.table("effect", "parameter", "J1", "J2")
    assert len({tuple(row[:2]) for row in limits}) == len(limits)
    assert "Channel with the largest residual" in page.text


def test_unexplained_residual_names_its_signals(friction):
    followed = unexplained_in(
        friction, period=None, regressors=("q_1 x sign(qd_2)", "session_time")
    )
    text = paragraph(followed)
    assert "the position of joint 1 and the direction of motion" in text
    assert "the session time, which predicts 40 % of it" in text
    assert "no recorded signal" in paragraph(unexplained_in(friction, period=None, regressors=()))


def test_rivals_are_sorted_by_probability(friction, tmp_path):
    (finding,) = friction.findings
    other = replace(finding.located, joint=0)
    shared = replace(finding, probability=0.4, rivals=(Rival(located=other, probability=0.6),))
    page = page_of(replace(friction, findings=(shared,)), tmp_path)
    rivals = page.table("", "effect", "place", "probability")
    assert [row[2:4] for row in rivals] == [["joint 1", "60 %"], ["joint 2", "40 %"]]
    assert "Coulomb friction of joint 1 (60 %)" in page.text


def test_mismatch_shares_are_per_kind_of_channel(friction, tmp_path, capsys):
    part = next(each.part for each in friction.shares if each.part is not None)
    shares = tuple(
        MismatchShare(part=own, measured=measured, share=share)
        for measured, own, share in (
            ("torque", part, 0.992),
            ("torque", None, 0.008),
            ("link_position", part, -0.25),
            ("link_position", None, 1.25),
        )
    )
    mixed = replace(friction, shares=shares)
    torques, encoders = [each.sentence for each in mismatches(mixed)]
    assert torques == (
        "Mismatch of the torques on held-out runs: 99 % Coulomb friction (joint 2), "
        "0.8 % unexplained."
    )
    assert encoders == (
        "Mismatch of the link encoders on held-out runs: 125 % unexplained. Increased by Coulomb"
        " friction (joint 2) (25 %)."
    )
    print_diagnosis(mixed, tmp_path)
    shown, page = " ".join(capsys.readouterr().out.split()), page_of(mixed, tmp_path).text
    for sentence in (torques, encoders):
        assert sentence in shown
        assert sentence in page
    # Encoders within twice their noise have no shares: the sentence is about torques only.
    (only,) = mismatches(replace(friction, shares=shares[:2]))
    assert only.sentence == torques


def test_headline_of_values_without_nominal_value(friction):
    (finding,) = friction.findings
    calibrated = replace(finding.located, calibrated=True)
    own = replace(finding, estimated=replace(finding.estimated, located=calibrated))
    silent = replace(friction, findings=(own,))
    values = "dentified values without nominal value: dry friction of joint 2"
    assert headline(silent) == f"I{values}"
    # A new effect that nothing speaks for, refuted by a simulation, leads no headline.
    refuted = replace(finding, probability=0.0, misfit=1.0, rivals=())
    assert headline(replace(silent, findings=(own, refuted))) == f"I{values}"
    assert answer.action(silent).startswith("Enter dry friction 0.")
    left = Unexplained(("torque_1",), ("q_1",), None, 0.5, 6.8)
    assert headline(replace(silent, unexplained=left)) == (
        f"6.8 times the noise remains unexplained in the torque of joint 1; i{values}"
    )
    assert "Enter" not in answer.action(replace(silent, unexplained=left))


@pytest.mark.parametrize(
    ("share", "unexplained", "leads"),
    [(0.005, 0.2, False), (0.05, 0.2, True), (0.005, 0.001, True)],
)
def test_finding_that_explains_next_to_nothing_leads_no_headline(
    friction, share, unexplained, leads
):
    """Beside values that the nominal model does not state."""
    (finding,) = friction.findings
    calibrated = replace(finding.located, calibrated=True)
    value = replace(finding, estimated=replace(finding.estimated, located=calibrated))
    there = replace(finding.located, joint=0)
    small = replace(finding, estimated=replace(finding.estimated, located=there))
    shares = (
        MismatchShare(
            part=ExtensionPart(kind="finding", effects=(there,)), measured="torque", share=share
        ),
        MismatchShare(part=None, measured="torque", share=unexplained),
    )
    text = headline(replace(friction, findings=(small, value), shares=shares))
    assert text.startswith("Joint 1") == leads
    assert "small beside them: joint 1" in text or leads


def test_every_sure_finding_is_something_to_do(friction):
    """The first two in words, the others by their number."""
    (finding,) = friction.findings
    each = [
        replace(
            finding,
            estimated=replace(finding.estimated, located=replace(finding.located, joint=joint)),
        )
        for joint in (0, 1)
    ]
    (one, two), both = (
        [answer.action(replace(friction, findings=(own,))) for own in each],
        answer.action(replace(friction, findings=tuple(each))),
    )
    assert one != two
    assert both in (f"{one} {two}", f"{two} {one}")


def test_value_to_enter_includes_what_the_joint_has_beside_the_change(friction):
    """Friction that no nominal model states was found in both states, and more in one."""
    (change,) = friction.findings
    calibrated = replace(change.located, calibrated=True)
    value = replace(change, estimated=replace(change.estimated, located=calibrated))
    alone = answer.action(friction)
    together = answer.action(replace(friction, findings=(change, value)))
    (one,), (both,) = (
        re.findall(r"Enter Coulomb friction ([\d.]+) N m", text) for text in (alone, together)
    )
    added = change.parameters[0].value
    assert float(both) - float(one) == pytest.approx(added, abs=0.01)


def test_possible_finding_does_not_lead_beside_an_open_residual(friction):
    left = Unexplained(("torque_1",), ("q_1",), None, 0.5, 6.8)
    (finding,) = friction.findings
    for probability, leads in ((0.3, False), (0.9, True)):
        own = replace(finding, probability=probability, rivals=())
        text = headline(replace(friction, findings=(own,), unexplained=left))
        assert text.startswith("6.8 times the noise") == (not leads), text


def test_large_held_out_residual_is_reported(friction):
    assert "largest residual" not in proof_sentence(friction)
    worse = [
        replace(p, channels=tuple(replace(c, after=50.0 * c.before) for c in p.channels))
        for p in friction.held_out
    ]
    assert "largest residual" in proof_sentence(replace(friction, held_out=tuple(worse)))


@pytest.mark.parametrize(
    ("value", "sd", "unit", "text"),
    [
        (6.2134, 0.1312, "N m", "6.21 ± 0.13 N m"),
        (3.2e-4, 2e-6, "rad", "320 ± 2 µrad"),
        (-0.012, 0.04, "m", "-10 ± 40 mm"),
        (-0.0001, 0.03, "", "0.00 ± 0.03"),
        (2.5e-5, float("nan"), "rad/(N m)", "25 µrad/(N m)"),
    ],
)
def test_pm_formats_value_and_standard_deviation(value, sd, unit, text):
    assert pm(value, sd, unit) == text


def test_formats_of_channels_units_and_probability():
    assert channels_in_words(["torque_3", "link_position_12"]) == (
        "the torque of joint 3 and the link encoder of joint 12"
    )
    assert joint_unit("N m s/rad", prismatic=True) == "N s/m"
    assert joint_unit("N m s/rad", prismatic=False) == "N m s/rad"
    assert format_probability(1.0) == "above 99 %"
    assert format_probability(0.97) == "97 %"


def test_saturated_torque_is_reported():
    """With 35 % saturated samples a position-dependent friction was identified."""
    told = [
        ("run1", _saturated(2, 0.35)),
        ("run2", _saturated(2, 0.40)),
        ("run2", _saturated(3, 0.01)),
    ]
    (line,) = saturation_sentences(SimpleNamespace(faults=told))
    assert line.startswith("The torque of joint 2 is saturated in 40 % of run2")


def _saturated(joint, share):
    return Fault(signal="torque", joint=joint, kind="saturated", detail="", left_out=False,
                 share=share)  # fmt: skip
