"""Scores of answers whose worth is known."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from bayes_iwan.report import withheld_scores
from bayes_iwan.virtual_rig.faults import CATALOGUE, KINDS, OUTSIDE
from bayes_iwan.withheld import scoring
from bayes_iwan.withheld.answers import read_answer
from bayes_iwan.withheld.case_score import score_case
from bayes_iwan.withheld.estimates import bootstrap, findable, share
from bayes_iwan.withheld.metrics import by_law, by_outside, confusion, reliability
from bayes_iwan.withheld.sealed import WithheldError
from bayes_iwan.withheld.truths import read_truth


def truth(kind, *names, size=0.1, visible=0.5, noise=0.005, frequencies=(10, 20), shares=None, law=1):
    laws = {n: KINDS[n].laws[min(law, len(KINDS[n].laws) - 1)].name for n in names}
    return {
        "kind": kind,
        "effects": [
            {"name": n, "law": laws[n], "size": size, "visible_share": visible, "share": s, "parameters": {}}
            for n, s in zip(names, shares or [1 / max(len(names), 1)] * len(names))
        ],
        "noise": {"share_of_friction": noise},
        "design": {"tests": [{"frequency_hz": f, "role": "fit"} for f in frequencies]},
        "specimen": {"family": "weibull"},
    }


def cause(name, probability=0.9, share=0.5, interval=(0.4, 0.6), held_out=0.45, alike=()):
    return {
        "name": name, "probability": probability, "share": share, "share_interval": list(interval),
        "share_held_out": held_out, "tied_with": list(alike),
    }  # fmt: skip


def answer(*causes, rest=False, none=0.0, unknown=0.1, **more):
    kind = ("partly_explained" if rest else "explained") if causes else ("unknown" if rest else "none")
    p = {c["name"]: c["probability"] for c in causes}
    return {
        "schema": 2,
        "verdict": {"kind": kind, "causes": list(causes), "unknown_cause": rest},
        "unexplained": {"share": 0.2, "interval": [0.1, 0.3], "where": ""},
        "probabilities": {"none": none, "unknown_cause": 0.9 if rest else unknown, **p, **more},
    }


def test_effects_that_are_only_named_together_are_in_the_set():
    said = answer(rest=True)
    said["verdict"]["one_of"] = [{"names": ["free_play", "end_stop"], "probability": 0.9, "share": 0.4}]
    found = score_case("x", read_truth("x", truth("single", "free_play")), said)
    assert found.in_set and not found.found and not found.false_names
    assert not score_case("x", read_truth("x", truth("single", "free_play")), answer(rest=True)).in_set


def test_clopper_pearson_interval():
    """Values from the tables: 0 of 40 is below 7.2 % one-sided (8.8 % two-sided); 7 of 10 is 35 to 93 %."""
    none = share([False] * 40)
    assert none.low == 0 and none.high == pytest.approx(0.0881, abs=1e-4)
    some = share([True] * 7 + [False] * 3)
    assert (some.low, some.high) == pytest.approx((0.3475, 0.9333), abs=1e-4)
    assert share([]).n == 0 and share([]).text() == "no such case"


def test_clopper_pearson_covers_the_truth():
    rng = np.random.default_rng(0)
    inside = [s.low <= 0.2 <= s.high for s in (share((rng.random(30) < 0.2).tolist()) for _ in range(500))]
    assert np.mean(inside) >= 0.95


def test_bootstrap_interval_of_a_mean():
    x = np.random.default_rng(1).standard_normal(400)
    found = bootstrap(x.tolist(), np.random.default_rng(2))
    assert found.value == pytest.approx(x.mean())
    assert found.high - found.low == pytest.approx(2 * 1.96 * x.std() / 20, rel=0.1)


@pytest.fixture(scope="module")
def known():
    """Ten cases whose figures can be counted by hand."""
    truths = {
        "sound": truth("none"),
        "alarm": truth("none"),
        "right": truth("single", "moving_mass"),
        "alike": truth("single", "free_play", frequencies=(10,)),
        "hidden": truth("single", "rig_compliance", visible=0.02),
        "pair": truth("pair", "moving_mass", "mains_interference", shares=(0.3, 0.7)),
        "triple": truth("triple", "end_stop", "force_drift", "free_play", shares=(0.2, 0.3, 0.5)),
        "beside": truth("known_beside_outside", "end_stop", "rocking", shares=(0.6, 0.4)),
        "missed": truth("known_beside_outside", "end_stop", "wear_groove"),
        "unlisted": truth("outside", "rocking"),
    }
    answers = {
        "sound": answer(none=0.8),
        "alarm": answer(cause("end_stop", 0.6)),
        "right": answer(cause("moving_mass", 0.95, share=0.95, interval=(0.9, 1.05))),
        "alike": answer(cause("channel_delay", 0.7, alike=["free_play"])),
        "hidden": answer(none=0.9),
        "pair": answer(cause("mains_interference", share=0.65, interval=(0.6, 0.72)), cause("moving_mass", share=0.1)),
        "triple": answer(cause("end_stop", share=0.25, held_out=0.9), rest=True),
        "beside": answer(cause("end_stop", share=0.55), rest=True),
        "missed": answer(rest=True),
        "unlisted": answer(cause("friction_fade", 0.55)),
    }
    return scoring.score_answers(truths, answers, excluded=["rocking"])


def count(score, key):
    figure = score.summary[key]
    return figure.count, figure.n


def test_names_and_rests_are_counted(known):
    assert count(known, "single, gap visible: named") == (1, 2)
    assert count(known, "single, gap visible: named or in the set") == (2, 2)
    assert count(known, "single, gap visible, one frequency: named or in the set") == (1, 1)
    assert count(known, "single, all: named") == (1, 3)
    assert count(known, "pairs and triples: effects named") == (3, 5)
    assert count(known, "pairs and triples: all of a case's effects named") == (1, 2)
    assert count(known, "known beside unknown: known one named") == (1, 2)
    assert count(known, "known beside unknown: unknown cause flagged") == (2, 2)
    assert count(known, "known beside unknown: both") == (1, 2)
    assert count(known, "outside alone: called unknown") == (0, 1)
    assert count(known, "no fault: a cause named or a unknown cause flagged (false alarm)") == (1, 2)
    assert count(known, "all cases: a false name") == (3, 10)
    assert count(known, "all cases: a false name, none of the set true") == (2, 10)
    assert count(known, "listed causes alone: a unknown cause flagged") == (1, 5)


def test_shares_are_compared_with_the_true_ones(known):
    # right 0.95 of 1, mains 0.65 of 0.7, mass 0.1 of 0.3, stop 0.25 of 0.2, stop 0.55 of 0.6
    assert count(known, "share of the gap: within 10 points") == (4, 5)
    assert count(known, "share of the gap: in its 90 % interval") == (3, 5)
    held_out = known.summary["share on held-out tests: in its 90 % interval"]
    assert (held_out.count, held_out.n) == (5, 8)


def test_shares_are_what_the_gap_loses_with_the_named_faults_out_of_the_rig():
    told = truth("pair", "moving_mass", "mains_interference", shares=(0.3, 0.7))
    told["true_gap_N"] = {"": 0.1, "moving_mass": 0.5, "mains_interference": 0.9, "mains_interference+moving_mass": 1.0}
    one = score_case("x", read_truth("x", told), answer(cause("mains_interference", share=0.45)))
    assert one.shares[0][1] == pytest.approx(0.5), "beside the mass, that stays"
    both = score_case("x", read_truth("x", told), answer(cause("mains_interference"), cause("moving_mass")))
    assert {n.name: t for n, t in both.shares} == pytest.approx({"mains_interference": 0.65, "moving_mass": 0.25})
    alone = truth("single", "moving_mass") | {"true_gap_N": {"": 0.2, "moving_mass": 1.0}}
    assert score_case("x", read_truth("x", alone), answer(cause("moving_mass"))).shares[0][1] == pytest.approx(0.8)
    del told["true_gap_N"]["moving_mass"]
    assert score_case("x", read_truth("x", told), answer(cause("mains_interference"))).shares[0][1] == 0.7, "not known"


def test_probability_scores_are_sums_over_labels(known):
    by_name = {c.name: c for c in known.cases}
    # 20 effects, none and rest: the rest's 0.1 and what none leaves are what a sound case costs
    assert by_name["sound"].log_score == pytest.approx(-np.log(0.8) - np.log(0.9))
    assert by_name["sound"].brier == pytest.approx(0.2**2 + 0.1**2)
    assert by_name["alarm"].log_score == pytest.approx(-np.log(0.4) - np.log(1e-3) - np.log(0.9))
    # a compliance too small to be seen is not asked for, but that none was said is
    assert by_name["hidden"].log_score == pytest.approx(-np.log(0.1) - np.log(0.9))


def test_cases_of_kinds_left_out_have_a_table_of_their_own(known):
    assert known.held_back["known beside unknown: both"].n == 1
    assert known.held_back["outside alone: called unknown"].n == 1
    assert "excluded from calibration" in known.table()


def test_results_by_law_and_by_outside_kind(known):
    laws = by_law(known.cases)
    assert laws["end_stop:hertz"][0].n == 3 and laws["end_stop:hertz"][0].count == 2
    assert "rig_compliance:stiffening" not in laws  # not visible
    flagged, false = by_outside(known.cases)["rocking"]
    assert (flagged.count, flagged.n, false.count) == (1, 2, 1)


def test_confusion_counts_cases_of_at_most_one_cause(known):
    rows, columns, counts = confusion(known.cases)
    assert counts.sum() == 6
    assert counts[rows.index("free_play"), columns.index("channel_delay")] == 1
    assert counts[rows.index("none"), columns.index("end_stop")] == 1
    assert counts[rows.index("unknown"), columns.index("friction_fade")] == 1


def test_calibrated_answers_lie_on_the_diagonal():
    rng = np.random.default_rng(3)
    truths, answers = {}, {}
    for i in range(800):
        p = float(rng.uniform(0.2, 1.0))
        truths[str(i)] = truth("single", "moving_mass" if rng.random() < p else "free_play")
        answers[str(i)] = answer(cause("moving_mass", p), free_play=1 - p)
    s = scoring.score_answers(truths, answers)
    for stated, found in reliability(s.cases):
        assert found.low - 0.02 < stated < found.high + 0.02
    assert abs(s.summary["probability of causes named: less frequency"].value) < 0.045
    assert s.summary["probability of causes named: calibration error"].value < 0.08
    sure = {k: answer(cause("moving_mass", 1.0)) for k in truths}
    wrong = scoring.score_answers(truths, sure).summary["probability of causes named: calibration error"]
    assert wrong.value == pytest.approx(0.4, abs=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"probabilities": {"none": 0.1, "unknown_cause": 0.1, "end_stop": 9.0}}, "end_stop is 9, not in 0 to 1"),
        ({"probabilities": {"none": float("nan"), "unknown_cause": 0.1}}, "not in 0 to 1"),
        ({"probabilities": {"none": 0.6, "unknown_cause": 0.1, "end_stop": 0.7}}, "sum to more than 1"),
        ({"probabilities": {"end_stop": 0.7}}, "no probability of none"),
        ({"verdict": {"kind": "explained", "causes": [], "unknown_cause": False}}, "explained and it names 0"),
        (
            {"verdict": {"kind": "explained", "causes": [cause("end_stop")], "unknown_cause": True}},
            "unknown_cause is true",
        ),
        ({"verdict": {"kind": "perhaps", "causes": [], "unknown_cause": False}}, "no verdict 'perhaps'"),
        ({"verdict": {"cause": "end_stop"}, "probabilities": {"end_stop": 0.9, "none": 0.9}}, "sum to 1.8"),
        ({"verdict": {}}, "no known form"),
    ],
)
def test_answers_that_contradict_themselves_are_refused(change, message):
    with pytest.raises(WithheldError, match=message) as caught:
        read_answer("case_7", answer(cause("end_stop")) | change)
    assert "case_7" in str(caught.value)


def test_answers_of_the_first_version_are_read():
    old = {
        "verdict": {"cause": "end_stop", "second_cause": "free_play", "tied_with": ["cubic_stiffness"]},
        "probabilities": {"end_stop": 0.7, "unknown": 0.2, "none": 0.1},
    }
    read = read_answer("a", old)
    assert read.kind == "explained" and read.names == {"end_stop", "free_play"}
    assert read.in_sets == {"end_stop", "free_play", "cubic_stiffness"}
    assert read.probabilities["unknown_cause"] == 0.2 and not read.unknown_cause
    assert read_answer("a", old | {"verdict": {"cause": "unknown"}}).unknown_cause


def test_missing_answer_is_scored_and_named_and_strange_answer_refused():
    truths = {"a": truth("single", "moving_mass"), "b": truth("none")}
    s = scoring.score_answers(truths, {"b": answer(none=1.0, unknown=0.0)})
    assert count(s, "single, all: named") == (0, 1)
    assert s.summary["log score, nats a case"].value == pytest.approx(0.5 * (len(CATALOGUE) + 2) * np.log(2))
    assert "not answered" in s.table()
    with pytest.raises(WithheldError, match="no truth: z"):
        scoring.score_answers(truths, {"z": answer()})


def test_truths_of_the_first_set_are_read_and_its_impossible_laws_told_apart():
    first = {
        "sound": {"kind": "none", "effect": {}, "noise": 0.01, "raw_share": 0.0, "tests": [[8.0, 0.3], [16.0, 0.3]]},
        "one": {"kind": "end_stop", "effect": {"stop_k": 2.0}, "noise": 0.01, "raw_share": 0.1, "tests": [[8.0, 0.3]]},
        "two": {
            "kind": "force_drift",
            "second": "mains_interference",
            "effect": {},
            "noise": 0.01,
            "tests": [[8.0, 0.3]],
        },
        "else": {"kind": "whirl", "effect": {}, "noise": 0.01, "raw_share": 0.05, "tests": [[8.0, 0.3]]},
        "impossible": {"kind": "force_highpass", "second": "direction_dependent_friction", "effect": {}, "tests": []},
    }
    read = {name: read_truth(name, t) for name, t in first.items()}
    assert [t.kind for t in read.values()] == ["none", "single", "pair", "outside", "pair"]
    assert [t.faulty for t in read.values()] == [False] * 4 + [True]
    assert read["sound"].frequencies == 2 and read["one"].causes[0].size == 0.1
    s = scoring.score_answers(first, {"impossible": answer(cause("force_highpass"))})
    assert len(s.cases) == 4 and [c.name for c in s.faulty] == ["impossible"]
    assert "impossible: force_highpass, direction_dependent_friction: explained" in s.table()
    with pytest.raises(WithheldError, match="odd is of no known form"):
        read_truth("odd", {"effects": [{}], "kind": "single"})


def test_the_first_sealed_set_is_scored_from_its_files():
    """Whatever the answers are: the seals hold, and three of its thirty cases are told apart."""
    here = Path(__file__).parents[2]
    cases, truths = here / "data" / "withheld", here.parent / "shared" / "data" / "withheld" / "truths.json"
    if not truths.is_file():
        pytest.skip("the opened truths are not part of the repository")
    s = scoring.score(cases, truths, answers=cases / "answers.json")
    assert (len(s.cases), len(s.faulty)) == (27, 3)
    assert sum(c.kind == "none" for c in s.cases) == 4


def test_size_that_can_be_found():
    rng = np.random.default_rng(4)
    sizes = np.exp(rng.uniform(np.log(0.02), np.log(0.3), 400))
    hits = rng.random(400) < 1 / (1 + (0.07 / sizes) ** 3)
    found = findable(sizes.tolist(), hits.tolist())
    assert found[0.5].low < 0.07 < found[0.5].high
    assert found[0.8].low < 0.07 * 4 ** (1 / 3) < found[0.8].high
    assert np.isnan(findable(sizes.tolist(), [True] * 400)[0.5].value)


@pytest.fixture(scope="module")
def varied():
    rng = np.random.default_rng(5)
    truths, answers = {}, {}
    for i in range(60):
        kind = str(rng.choice(["single", "single", "none", "outside", "pair"]))
        names = {"single": 1, "pair": 2}.get(kind, 0)
        true = [str(n) for n in rng.choice(CATALOGUE, names, replace=False)]
        true += [str(rng.choice(OUTSIDE))] if kind == "outside" else []
        truths[str(i)] = truth(kind, *true, size=float(rng.uniform(0.02, 0.12)), visible=float(rng.uniform(0.05, 1)))
        said = [n for n in true if n in CATALOGUE and rng.random() < 0.7]
        answers[str(i)] = answer(
            *(cause(n, 0.6, share=float(rng.uniform(0.2, 1))) for n in said), rest=rng.random() < 0.2
        )
    return scoring.score_answers(truths, answers)


def test_table_and_json_say_the_same(varied):
    content = json.loads(json.dumps(varied.as_dict(), allow_nan=False))
    named = content["summary"]["single, all: named"]
    assert f"{named['count']} of {named['n']}" in varied.table()
    assert len(varied.case_table().splitlines()) == 60


def test_figures_are_drawn_in_full_and_without_cases(varied):
    empty = scoring.score_answers({"a": truth("none")}, {"a": answer(none=0.9)})
    for score in (varied, empty):
        for figure in withheld_scores.figures(score).values():
            FigureCanvasAgg(figure).draw()
    left, _ = withheld_scores.accuracy_figure(varied).axes
    assert [len(c[0].get_xdata()) for c in left.containers] == [5, 5]  # bins: named, and in a set
