"""The answer in words: every kind of verdict, and that the text says what the JSON holds."""

import re
from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign.loops.clipping import Limit
from bayes_iwan.campaign.recording.records import Record
from bayes_iwan.diagnosis.answer.diagnosis_json import to_dict
from bayes_iwan.diagnosis.answer.imitation import Edge, Explanation, Imitation, said_in_text
from bayes_iwan.diagnosis.answer.next_test import NextTest
from bayes_iwan.diagnosis.answer.sentences import next_sentence, sentences
from bayes_iwan.diagnosis.answer.wording import few, force, percent, plain, title, value_of
from bayes_iwan.diagnosis.assessment.budget import Gaps, Kind, OneOf, Suspect
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.assessment.sampled_fit import Sampling
from bayes_iwan.diagnosis.assessment.verdict import cycles_differ, verdict_of
from bayes_iwan.diagnosis.constants import PROBABLE, SUREST
from bayes_iwan.files import finite

TIED = Imitation(
    "speed_dependent_normal_force",
    "speed dependence",
    0.12,
    (
        Explanation("viscous_damping", 3.0, 0.02),
        Explanation("speed_dependent_normal_force", 0.0, 0.025),
        Explanation("maxwell_branch", -80.0, 0.11),
    ),
    ("viscous_damping", "speed_dependent_normal_force"),
    NextTest(12.0, 0.4, 20, ("viscous_damping", "speed_dependent_normal_force"), 6.0, ""),
)
EDGE = Edge("normal_force_rate", 1.4, "-", 3.5, "norm(scale=0.4)")


def turned(found, kind, causes=(), probabilities=None, **verdict):
    """A diagnosis as if its verdict had been another."""
    p = dict.fromkeys(found.verdict.probabilities, 0.0) | {"none": 0.0, "unknown": 0.0} | (probabilities or {})
    flagged = kind in (Kind.PARTLY, Kind.UNKNOWN)
    v = replace(found.verdict, kind=kind, causes=tuple(causes), probabilities=p, unknown_cause=flagged, **verdict)
    unexplained = replace(found.budget.unexplained, probability=p["unknown"])
    moved = found.moved if causes else {}
    return replace(
        found, verdict=v, budget=replace(found.budget, causes=tuple(causes), unexplained=unexplained), moved=moved
    )


def clockless(found):
    tests = tuple(replace(r, clock=False) for r in found.campaign.tests)
    following = replace(found.next_test or TIED.next_test, frequency_hz=None)
    return replace(
        found,
        campaign=replace(found.campaign, tests=tests),
        where=replace(found.where, clock=False),
        imitations=(),
        needs_clock=("viscous_damping",),
        next_test=following,
    )


@pytest.fixture(scope="module")
def answers(kit):
    """One diagnosis of every kind of answer."""
    named, nothing = kit.diagnosed("viscous_damping", "held out"), kit.diagnosed(None)
    c = named.verdict.causes[0]
    p = {"viscous_damping": c.probability}
    unknown = {"unknown": 0.97}
    suspects = tuple(Suspect(n, 0.9) for n in ("rig_compliance", "free_play", "end_stop", "moving_mass"))
    groups = (OneOf(("rate_strengthening", "viscous_damping", "channel_delay", "end_stop", "free_play"), 0.9, 0.6),)
    two = (c, replace(c, name="moving_mass", gaps=Gaps(0.2, 0.5, 0.7, 0.01)))
    heavy = replace(named, parameters=dict(named.parameters) | {"moving_mass": named.parameters[c.name]})
    fading = (OneOf(("friction_fade", "spring_softening"), 0.9, 0.02, 1.0),)
    alike = replace(c, tied_with=("rate_strengthening", "maxwell_branch", "channel_delay", "force_lowpass"))
    one_file = named.data.part([0])
    fitted = turned(named, Kind.EXPLAINED, (c,), p)
    return {
        "none": replace(turned(nothing, Kind.NONE, (), {"none": 0.97}), imitations=(), edges=(), next_test=None),
        "none, ties": replace(
            turned(nothing, Kind.NONE, (), {"none": 0.9}), imitations=(TIED,), edges=(EDGE,), next_test=TIED.next_test
        ),
        "none, improbable": turned(
            nothing, Kind.NONE, (), {"none": 0.02, "moving_mass": 0.48, "free_play": 0.4, "unknown": 0.3}
        ),
        "named": fitted,
        "two named": turned(heavy, Kind.EXPLAINED, two, p | {"moving_mass": c.probability}),
        "named, imitated": replace(turned(named, Kind.EXPLAINED, (c,), p), imitations=(TIED,)),
        "fading or softening": turned(named, Kind.UNKNOWN, (), unknown, one_of=fading),
        "named, tied": turned(named, Kind.EXPLAINED, (alike,), p),
        "partly": turned(named, Kind.PARTLY, (c,), p | unknown | {"moving_mass": 0.41}, suspects=suspects),
        "tied groups only": turned(named, Kind.UNKNOWN, (), unknown | {"rate_strengthening": 0.6}, one_of=groups),
        "named and a group": turned(named, Kind.PARTLY, (c,), p | unknown, one_of=fading),
        "unknown": turned(named, Kind.UNKNOWN, (), unknown, suspects=suspects),
        "drive": turned(named, Kind.DRIVE, (), {"drive": 0.9}, cornered=("t0.csv",), corners_gap=0.02),
        "single record": replace(turned(named, Kind.UNKNOWN, (), unknown), data=one_file),
        "no clock": clockless(turned(named, Kind.UNKNOWN, (), unknown)),
        "not converged": replace(turned(named, Kind.EXPLAINED, (c,), p), sampling=Sampling(False, "no time", 9.0, 1.3)),
    }


KINDS = (
    "none", "none, ties", "none, improbable", "named", "two named", "named, imitated",
    "fading or softening", "named, tied", "partly", "tied groups only", "named and a group", "unknown", "drive",
    "single record", "no clock", "not converged",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_said_is_what_it_was(answers, reference, kind):
    """The words, too, which say a part of the rest."""
    reference({k: x for k, x in finite(to_dict(answers[kind])).items() if k in ("sentences", "verdict")})


@pytest.mark.parametrize("bench, said", [
    ("", "Next: run 12 Hz at 0.4 mm for 20 cycles. It tells whether there is friction fade (it would change"),
    ("a pause", "Next: a pause. No one test that this rig can run would tell whether there is friction fade well."),
])  # fmt: skip
def test_an_effect_is_not_separated_from_no_effect(answers, bench, said):
    following = replace(TIED.next_test, separates=("friction_fade", "none"), bench=bench)
    assert next_sentence(replace(answers["unknown"], next_test=following)).startswith(said)


def test_where_each_amplitude_has_one_frequency_time_is_not_told_from_amplitude(answers):
    """A constant speed, as most cyclic protocols have: a lag of 34 s was named on a joint that slackened."""
    found, said = answers["named"], "Each amplitude was run at one frequency: a dependence on time could be one on"
    assert said not in " ".join(sentences(found))
    loops = tuple(replace(x, frequency_hz=1.0 / x.amplitude_mm) for x in found.data.loops)
    assert said in " ".join(sentences(replace(found, data=replace(found.data, loops=loops))))


@pytest.mark.parametrize("kind", KINDS)
def test_text_and_json_agree(answers, kind):
    found = answers[kind]
    d = to_dict(found)
    said = d["sentences"]
    text = " ".join(said)
    assert len(said) <= 12 and len(text) < 2600, "one screen"
    assert all(s[:1].isupper() and s.endswith(".") for s in said)
    assert not re.search(r"\b(nan|None|inf)\b|\de[+-]\d|\b0 Hz\b", text), text
    # every effect that is more probable than not is in the text
    for name, p in d["probabilities"].items():
        if p >= 0.5 and name not in ("none", "unknown_cause", "drive"):
            assert title(name).lower() in text.lower(), name
    for c in d["verdict"]["causes"]:
        assert f"probability {c['probability']:.2f}" in text and percent(c["share"]) in text
        assert f"{percent(c['share_held_out'])} on held-out tests" in text
    # what is unexplained is always said, as the JSON has it
    (unexplained,) = (s for s in said if s.startswith("Unexplained: "))
    resolved = d["gap"]["after_interval_N"][0] > 0.0 or d["verdict"]["unknown_cause"]
    assert (percent(d["gap"]["after_share"]) if resolved else "nothing beyond noise") in unexplained
    if resolved:
        assert percent(d["unexplained"]["share"] if d["verdict"]["causes"] else 1.0) + " of the gap" in unexplained
    # the gap shrinks by what is explained, by nothing where nothing is named
    share, (low, high) = d["unexplained"]["share"], d["unexplained"]["interval"]
    left = (share, high, low) if d["verdict"]["causes"] else (1.0, 1.0, 1.0)
    assert [d["gap"]["shrink"], *d["gap"]["shrink_interval"]] == [1.0 - x for x in left]
    # lists are short
    assert max(s.count(",") for s in re.findall(r"(?:One of|tell it from|Speed dependence:)[^.]*", text) or [""]) <= 2
    # the next test is none that was run
    following = d["next_test"]
    if following is not None and d["verdict"]["kind"] != "drive" and not following["bench"]:
        assert plain(following["amplitude_mm"]) + " mm" in said[-1]
    # a colour that nothing in the text contradicts
    warned = re.search(r"unknown|clipped|not converged|that it has a cause|cannot be found", text)
    assert (d["verdict"]["colour"] == "warning") == bool(warned or d["verdict"]["causes"])
    if re.search(r"do not tell|cannot tell|Far from plausible|no clock|held-out tests\. Record", text):
        assert d["verdict"]["colour"] != "good"


def test_the_kinds_read_as_they_should(answers):
    text = {k: to_dict(v)["sentences"] for k, v in answers.items()}
    assert text["none"][1].startswith("No effect outside the model is needed (probability 0.97).")
    assert text["none, improbable"][1] == (
        "No effect is named, though something probably contributes (probability 0.98): moving mass (0.48), free play "
        "(0.40), a cause without a name (0.30). These tests do not tell what."
    )
    assert text["named"][1].startswith("Viscous damping of ") and "Give the model a dashpot" in text["named"][1]
    assert "rate strengthening, a Maxwell branch, a delay between the channels or 1 other" in text["named, tied"][1]
    assert any(s.startswith("One of rate strengthening, viscous damping") for s in text["tied groups only"])
    assert any("0.97 that it has a cause: one of these or another)" in s for s in text["tied groups only"])
    grouped = " ".join(text["named and a group"])
    assert "(probability 0.97 that it has a cause: one of these or another)" in grouped
    assert "nothing is named" not in grouped
    assert text["unknown"][1] == (
        "Cause unknown (probability 0.97). The gap is real, but no known effect explains it in all tests."
    )
    assert "The gap is real, but one test does not show its cause." in " ".join(text["single record"])
    assert "There is one test, so nothing of this was checked on held-out tests." in text["single record"]
    three = "20 % with all named effects, 50 % without this one, 70 % with this one alone."
    assert f"Gap left on held-out tests: {three}" in " ".join(text["two named"])
    assert any(s.startswith("Speed") and "The evidence is for viscous damping" in s for s in text["named, imitated"])
    fading = " ".join(text["fading or softening"])
    assert "the best of them would remove 2 % of the gap and 100 % of what changes along the records" in fading
    assert "Unexplained: 100 % of the gap" in fading and "since nothing is named" in fading
    assert text["drive"][-1].startswith("Next: run these tests again with sines; if they were sines, check the")
    assert "cannot be found: the displacement of 1 test has corners (t0.csv)" in text["drive"][1]


@pytest.mark.parametrize(("probability", "colour"), [(0.49, "note"), (PROBABLE, "good")])
def test_that_nothing_is_needed_is_said_from_one_half_on_and_the_box_is_as_sure(answers, probability, colour):
    none = answers["none"]
    d = replace(none, verdict=replace(none.verdict, probabilities=none.verdict.probabilities | {"none": probability}))
    assert to_dict(d)["verdict"]["colour"] == colour
    needed = colour == "note"
    assert sentences(d)[1].startswith("No effect is named, though" if needed else "No effect outside the model is")
    assert (sentences(d)[-1] == "Next: no further test is needed.") != needed


def test_what_the_base_can_imitate_is_said_under_none(answers):
    said = to_dict(answers["none, ties"])
    (speed,) = (s for s in said["sentences"] if s.startswith("Speed dependence"))
    own = "a normal force that grows with speed (the model's own)"
    assert speed.startswith(f"Speed dependence: viscous damping or {own}. These tests do not tell which.")
    assert "With one of them alone the model would miss 2 % to 2.5 %" in speed and "with none 12 %" in speed
    assert said["verdict"]["colour"] == "note" and said["imitations"][0]["tied"] == TIED.tied
    assert any("with speed (normal_force_rate = 1.4, +3.5 prior sd)" in s for s in said["sentences"])
    assert said["sentences"][-1].startswith("Next: run 12 Hz at 0.4 mm for 20 cycles. It separates viscous damping and")


def test_a_dependence_that_one_effect_explains_is_left_to_the_verdict(answers):
    """Its probability says what there is to say: a line of its own would read as a name."""
    alone = replace(TIED, tied=("viscous_damping",))
    said = " ".join(sentences(replace(answers["none, ties"], imitations=(alone,))))
    assert "Speed dependence" not in said
    two = replace(TIED, tied=("viscous_damping", "maxwell_branch"))
    said = " ".join(sentences(replace(answers["none, ties"], imitations=(two,))))
    instead = "with a normal force that grows with speed instead 2.5 %, with none 12 %."
    assert f"With one of them alone the model would miss 2 % to 11 % of the friction force, {instead}" in said


def test_a_share_that_may_be_nothing_is_one_that_is_not_missed(answers):
    """Two that only help together: either alone makes the gap larger, and without either most of it is back."""
    d = answers["two named"]
    c = d.verdict.causes[0]
    wide = replace(c, share=replace(c.share, low=-0.05), vague=replace(c.vague, data=0.3))
    for gaps, may_be_nothing in ((Gaps(0.04, 0.69, 1.16, 0.18), False), (Gaps(0.5, 0.69, 0.7, 0.18), True)):
        causes = (replace(wide, gaps=gaps), d.verdict.causes[1])
        said = " ".join(sentences(replace(d, verdict=replace(d.verdict, causes=causes))))
        assert ("Its share may be nothing." in said) == may_be_nothing


def test_the_text_holds_speed_and_what_is_most_at_stake():
    """Of these the first has the next test, else it separates what no sentence says."""
    asymmetry, after, rounding = (
        replace(TIED, what=w, without=x) for w, x in (("asymmetry", 0.2), ("stiffness", 0.3), ("rounding", 0.4))
    )
    single = replace(TIED, without=0.9, tied=("viscous_damping",))
    assert said_in_text([asymmetry, after, single, rounding]) == [rounding, after]
    assert said_in_text([asymmetry, rounding, TIED]) == [TIED, rounding]


def test_what_is_no_more_than_noise_is_said_so(answers):
    found = answers["named"]
    after = replace(found.budget.after, rms_N=3e-12, share=1e-12, low_N=0.0, high_N=0.04, share_high=0.011)
    clean = replace(found, budget=replace(found.budget, after=after))
    (said,) = (s for s in sentences(clean) if s.startswith("Unexplained"))
    assert said == "Unexplained: nothing beyond noise: at most 40 mN RMS, 1.1 % of the friction force."
    none = answers["none"]
    clean = replace(none.budget.before, rms_N=0.0, share=0.0, low_N=0.0, high_N=0.0, share_high=0.0)
    said = sentences(replace(none, budget=replace(none.budget, before=clean, after=clean)))
    assert said[0].startswith("The model misses nothing beyond noise (noise ")
    assert "Unexplained: nothing beyond noise." in said


@pytest.mark.parametrize(
    "shown, said",
    [
        ({"subharmonic": np.array([1.0, 257.0])}, "half the test frequency, which averaged loops hide"),
        ({"not_repeating": 0.045}, "Cycles differ by 4.5 % of the friction force"),
    ],
)
def test_cycles_that_differ_are_a_cause_without_a_name_whatever_the_loops_show(answers, shown, said):
    none = answers["none"]
    data = replace(none.data)
    vars(data).update(shown)
    search = replace(none.found.search, data=data)
    found = replace(none.found, search=search)
    verdict = verdict_of(found, calibration())
    assert verdict.kind is Kind.UNKNOWN and verdict.probabilities["unknown"] == SUREST
    mains = frozenset({"mains_interference"})
    assert cycles_differ(data, ()) and not cycles_differ(data, mains) and not cycles_differ(none.data, ())
    d = to_dict(replace(none, data=data, found=found, verdict=verdict))
    assert d["sentences"][-1] == "Next: look at the cycles one by one (bayes-iwan inspect)."
    assert any(said in s for s in d["sentences"]) and any("makes cycles differ" in s for s in d["sentences"])
    assert d["verdict"]["colour"] == "warning"


def test_how_much_of_the_gap_a_pattern_makes_is_said(answers):
    d = answers["unknown"]
    unexplained = replace(d.budget.unexplained, resembles="lagging_reading", resembling=0.123)
    d = replace(d, budget=replace(d.budget, unexplained=unexplained))
    assert "12 % of the gap resembles this: a displacement reading that lags after every reversal" in " ".join(
        sentences(d)
    )


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "drive"])
def test_where_no_test_is_left_the_answer_says_why(answers, kind):
    d = replace(answers[kind], next_test=None)
    said = sentences(d)[-1]
    if d.verdict.kind is Kind.NONE and d.verdict.probabilities["none"] >= 0.5:
        assert said == "Next: no further test is needed."
    elif kind == "single record":
        assert said == "Next: record other amplitudes and frequencies."
    else:
        assert "these effects" in said if d.verdict.causes or d.verdict.one_of else "no known effect is left" in said


def test_an_interval_whose_ends_read_alike_is_left_out(answers):
    found = answers["unknown"]
    gap = replace(found.budget.before, rms_N=24.004, low_N=23.99, high_N=24.01)
    (size, *_) = sentences(replace(found, budget=replace(found.budget, before=gap)))
    assert size.startswith("The model misses 24 N RMS, ")


def test_without_a_clock_no_frequency_is_said(answers):
    d = to_dict(answers["no clock"])
    assert not re.search(r"\d\s?Hz|\d m?s\b", " ".join([*d["sentences"], *d["where"]["sentences"]]))
    assert any("no clock" in s for s in d["sentences"])
    assert all(t["frequency_hz"] is None for t in d["where"]["tests"]) and d["where"]["by_frequency"] == []
    assert d["clock"] is False and d["verdict"]["needs_clock"] == ["viscous_damping"]


def test_numbers_read_as_numbers():
    assert [force(x) for x in (0.0, 12345.0, 783e-3, 61.38, -1719.0, 1e-5)] == [
        "0 N", "12.3 kN", "0.783 N", "61.4 N", "-1.72 kN", "0.01 mN",
    ]  # fmt: skip
    assert [percent(x) for x in (0.5, 0.0951, 0.004, 0.00004, -0.0002)] == ["50 %", "9.5 %", "0.4 %", "0 %", "-0.02 %"]
    assert few(["a", "b"]) == "a or b" and few(list("abcde")) == "a, b, c or 2 others"
    assert value_of("c_N_s_mm", 1.357, 0.09, "N·s/mm") == " of 1.36 ± 0.09 N·s/mm"


def test_a_record_has_a_clock_unless_it_says_so(kit):
    assert all(isinstance(r, Record) and r.clock for r in kit.diagnosed(None).campaign.tests)


def test_a_limit_of_the_force_is_the_channel_s_only_where_a_record_shows_its_level(answers):
    found = answers["named"]
    (c,) = found.verdict.causes
    parameters = dict(found.parameters) | {"force_clipping": found.parameters[c.name]}
    limited = replace(turned(found, Kind.EXPLAINED, (replace(c, name="force_clipping"),)), parameters=parameters)
    (said,) = (s for s in sentences(limited) if s.startswith("A limit of the force"))
    assert "Raise the force range" not in said and "a specimen that yields or slides there does the same" in said
    files = [x.file for x in found.data.loops]
    clipped = replace(limited, clipped=tuple(Limit(f, "force", 1, 3.2, True, True, 0.1) for f in files))
    text = " ".join(sentences(clipped))
    assert "may be clipped in 4 of 4 tests" in text and "Raise the force range and repeat" in text


@pytest.mark.parametrize(("more", "said"), [(0.11, True), (0.09, False), (-0.2, False)])
def test_what_changes_along_the_record_is_said_where_a_cause_removes_clearly_more_of_it(kit, more, said):
    found = kit.diagnosed("viscous_damping")
    (first, *_) = found.verdict.causes
    cause = replace(first, along=first.share.value + more)
    text = " ".join(sentences(turned(found, Kind.EXPLAINED, [cause], {cause.name: 0.95})))
    assert (f"and {percent(cause.along)} of what changes along the records" in text) == said


def test_what_is_predicted_worse_with_a_cause_is_said_without_a_negative_share(kit):
    found = kit.diagnosed("viscous_damping")
    (first, *_) = found.verdict.causes
    worse = replace(first, held_out=replace(first.held_out, value=-0.4))
    text = " ".join(sentences(turned(found, Kind.EXPLAINED, [worse], {first.name: 0.95})))
    assert "but nothing on held-out tests, where its numbers do not hold" in text and percent(-0.4) not in text


@pytest.mark.parametrize("mean, side", [(-3.0, " on the side of negative displacement"), (3.0, "")])
def test_a_stop_has_a_stiffness_above_zero_on_its_side(kit, mean, side):
    found = kit.diagnosed("viscous_damping", "held out")
    c = found.verdict.causes[0]
    (number, *_) = found.parameters[c.name].values()
    stop = {"stiffness_N_mm": replace(number, mean=mean, sd=0.1, unit="N/mm")}
    asked = replace(found, parameters=dict(found.parameters) | {"end_stop": stop})
    text = " ".join(sentences(turned(asked, Kind.EXPLAINED, (replace(c, name="end_stop"),), {"end_stop": 0.9})))
    assert re.search(rf"End stop[^(]* 3[.0]* ± 0\.1 N/mm{side} \(probability", text), text
