"""Scores of answers whose worth is known."""

import json

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from bayes_iwan.report import score_figures as scoring_figures
from bayes_iwan.rig.faults import CATALOGUE, MAIN_PARAMETER
from bayes_iwan.validation import scoring
from bayes_iwan.validation.estimates import bootstrap, findable, share
from bayes_iwan.validation.sealed import WithheldError

RIGHT = "first answer right (none, single and outside cases)"


def truth(kind, *names, size=0.1, noise=0.005, frequencies=(10, 20)):
    return {
        "kind": kind,
        "effects": [{"name": n, "size": size, "parameters": {MAIN_PARAMETER[n]: 2.0}} for n in names],
        "noise": {"share_of_friction": noise},
        "design": {"tests": [{"frequency_hz": f, "role": "fit"} for f in frequencies]},
    }


def answer(cause, probabilities=None, second=None, alike=(), effects=()):
    return {
        "verdict": {"cause": cause, "second_cause": second, "cannot_tell_apart": list(alike)},
        "probabilities": probabilities or {cause: 1.0},
        "effects": [
            {"name": n, "parameters": {MAIN_PARAMETER[n]: {"mean": m, "sd": s, "unit": ""}}, "shrink_expected": 0.5}
            for n, m, s in effects
        ],
    }


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


def test_known_answers_get_known_scores():
    truths = {
        "a": truth("none"),
        "b": truth("single", "moving_mass"),
        "c": truth("single", "free_play", frequencies=(10,)),
        "d": truth("outside"),
        "e": truth("pair", "moving_mass", "mains_hum"),
        "f": truth("none"),
    }
    answers = {
        "a": answer("none", {"none": 0.8, "unknown": 0.2}),
        "b": answer("moving_mass", {"moving_mass": 0.5, "rig_compliance": 0.5}, effects=[("moving_mass", 2.3, 0.1)]),
        "c": answer("channel_delay", {"channel_delay": 0.7, "free_play": 0.3}, alike=["free_play"]),
        "d": answer("unknown", {"unknown": 1.0}),
        "e": answer("mains_hum", second="moving_mass"),
        "f": answer("end_stop", {"end_stop": 0.6, "none": 0.4}),
    }
    s = scoring.score_answers(truths, answers, shrink_found={"b": 0.4, "f": 0.1})
    t = s.summary
    assert (t[RIGHT].count, t[RIGHT].n) == (3, 5)
    assert t["truth among the three most probable"].count == 5
    assert t["single effects: first answer right"].count == 1
    assert t["single effects, one frequency: first answer right"].n == 1
    assert t["single effects: truth in the set that cannot be told apart"].count == 2
    assert t["single effects: causes in that set"].value == 1.5
    alarm = t["no effect: a cause is named (false alarm)"]
    assert (alarm.count, alarm.n) == (1, 2)
    assert t["outside the catalogue: called unknown"].value == 1
    assert t["pairs: both causes named"].count == 1
    assert t["not pairs: a second cause named"].count == 0
    assert t["log score, nats"].value == pytest.approx(-np.mean(np.log([0.8, 0.5, 0.3, 1.0, 0.4])))
    briers = [2 * 0.2**2, 2 * 0.5**2, 2 * 0.7**2, 0.0, 2 * 0.6**2]
    assert t["Brier score"].value == pytest.approx(np.mean(briers))
    assert [c.size_error for c in s.cases if c.name == "b"] == pytest.approx([3.0])
    assert t["effect's size within 2 sd, whatever was named"].count == 0
    shrunk = t["shrink: median predicted − found"]  # f names end_stop without an entry
    assert shrunk.n == 1 and abs(shrunk.value) == pytest.approx(0.1)
    assert t["expected calibration error (ten bins)"].value == pytest.approx((0.2 + 0.5 + 0.7 + 0.0 + 0.6) / 5)
    rows, columns, counts = scoring.confusion(s.cases)
    assert counts.sum() == 5
    assert counts[rows.index("free_play"), columns.index("channel_delay")] == 1
    assert counts[rows.index("none"), columns.index("end_stop")] == 1


def test_uniform_guess_scores_the_logarithm_of_the_options():
    truths = {str(i): truth("single", n) for i, n in enumerate(CATALOGUE)}
    uniform = dict.fromkeys(scoring.LABELS, 1 / 22)
    s = scoring.score_answers(truths, {k: answer("none", uniform) for k in truths})
    assert s.summary["log score, nats"].value == pytest.approx(np.log(22))
    assert s.summary["Brier score"].value == pytest.approx(1 - 1 / 22)


def test_certain_and_wrong_costs_much_but_not_infinity():
    s = scoring.score_answers({"a": truth("none")}, {"a": answer("end_stop")})
    assert s.summary["log score, nats"].value == pytest.approx(-np.log(1e-3))


def test_missing_answer_is_scored_and_named_and_strange_answer_refused():
    truths = {"a": truth("single", "moving_mass"), "b": truth("none")}
    s = scoring.score_answers(truths, {"b": answer("none")})
    assert s.summary[RIGHT].count == 1
    assert s.summary["log score, nats"].value == pytest.approx(np.log(22) / 2)
    assert "not answered" in s.table() and "guess of none: a" in s.table()
    with pytest.raises(WithheldError, match="no truth: z"):
        scoring.score_answers(truths, {"z": answer("none")})


def test_calibrated_answers_lie_on_the_diagonal():
    rng = np.random.default_rng(3)
    truths, answers = {}, {}
    for i in range(3000):
        p = rng.uniform(0.2, 1.0)
        truths[str(i)] = truth("none") if rng.random() < p else truth("outside")
        answers[str(i)] = answer("none", {"none": p, "unknown": 1 - p})
    s = scoring.score_answers(truths, answers)
    for stated, found in scoring.reliability(s.cases):
        assert found.low - 0.02 < stated < found.high + 0.02
    assert abs(s.summary["stated probability less share right"].value) < 0.03


def test_size_that_can_be_found():
    rng = np.random.default_rng(4)
    sizes = np.exp(rng.uniform(np.log(0.02), np.log(0.3), 400))
    hits = rng.random(400) < 1 / (1 + (0.07 / sizes) ** 3)
    found = findable(sizes.tolist(), hits.tolist())
    assert found[0.5].low < 0.07 < found[0.5].high
    assert found[0.8].low < 0.07 * 4 ** (1 / 3) < found[0.8].high
    assert np.isnan(findable(sizes.tolist(), [True] * 400)[0.5].value)


@pytest.fixture
def varied():
    rng = np.random.default_rng(5)
    truths, answers = {}, {}
    for i in range(60):
        name = str(rng.choice(CATALOGUE))
        kind = str(rng.choice(["single", "single", "none", "outside"]))
        truths[str(i)] = truth(kind, *([name] if kind == "single" else []), size=float(rng.uniform(0.04, 0.2)))
        cause = scoring.labels_of(truths[str(i)])[0] if rng.random() < 0.7 else str(rng.choice(scoring.LABELS))
        effects = [(name, 2 + rng.normal(), 1.0)] if kind == "single" else []
        answers[str(i)] = answer(cause, {cause: 0.6, "none": 0.4} if cause != "none" else None, effects=effects)
    found = {k: float(rng.uniform(0.2, 0.6)) for k in truths}
    return scoring.score_answers(truths, answers, shrink_found=found, baselines={"always none": {}})


def test_table_and_json_say_the_same(varied):
    content = json.loads(json.dumps(varied.as_dict(), allow_nan=False))
    right = content["summary"][RIGHT]
    assert f"{right['count']} of {right['n']}" in varied.table()
    assert np.sum(content["confusion"]["counts"]) == right["n"]
    assert "always none" in varied.table()


def test_figures_are_drawn_in_full_and_without_cases(varied):
    empty = scoring.score_answers({"a": truth("none")}, {"a": answer("none")})
    for score in (varied, empty):
        for figure in scoring_figures.figures(score).values():
            FigureCanvasAgg(figure).draw()
    axis = scoring_figures.accuracy_figure(varied).axes[0]
    assert len(axis.containers) == 10  # five bins, first answer and first three
