"""The withheld protocol: sealing, answering with the truth closed, opening the seals."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields

import answerers
import numpy as np
import pytest

from bayes_iwan.campaign import read_campaign
from bayes_iwan.diagnosis.answer.saved_fits import SCHEMA, find_shares
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.report import withheld_scores
from bayes_iwan.virtual_rig import cases as rig_cases
from bayes_iwan.withheld import confinement, scoring, sealed
from bayes_iwan.withheld.answering import answer, case_seed, refuse_open_truth
from bayes_iwan.withheld.sealed import WithheldError

KINDS = ["none", "single", "outside"]


@pytest.fixture(scope="module")
def made(small_design, tmp_path_factory):
    folder = tmp_path_factory.mktemp("withheld") / "set"
    return folder, sealed.make(3, folder, kinds=KINDS)


@pytest.fixture
def copy(made, tmp_path):
    """The set and its truths, free to be spoilt."""
    shutil.copytree(made[0], tmp_path / "set")
    shutil.copytree(made[1].parent, tmp_path / "set-truth")
    return tmp_path / "set", tmp_path / "set-truth" / "truth.json"


# ---- make


def test_layout_and_seals(made):
    folder, truth = made
    names = ["case_01", "case_02", "case_03"]
    assert sorted(p.name for p in folder.iterdir()) == [*names, "commitments.json"]
    assert truth == folder.parent / "set-truth" / "truth.json"
    truths = sealed.read_truths(truth)
    assert [truths[n]["kind"] for n in names] == ["none", "single", "outside"]
    sealed.check_seals(folder, truths)
    public = json.loads((folder / "commitments.json").read_text())
    assert set(public) == {"rule", "sealed", "entropy", "cases"} and public["sealed"] is True
    assert all(len(v) == 64 for v in public["cases"].values())
    for n in names:
        assert len(read_campaign(folder / n).tests) == 2
        assert len(read_campaign(truth.parent / "sealed" / n).tests) == 1
        single = truths[n]["effects"]
        assert all({"name", "law", "size", "visible_share", "share", "parameters"} <= set(e) for e in single)
        assert len(truths[n]["salt"]) == 64
    assert truths["case_01"]["true_gap_N"] == truths["case_01"]["true_share"] == {}
    for n in names[1:]:
        (fault,), gap_N = truths[n]["effects"], truths[n]["true_gap_N"]
        assert set(gap_N) == {"", fault["name"]} and min(gap_N.values()) >= 0.0
        before = gap_N[fault["name"]]  # cases are drawn anew each time: one in many leaves no gap
        share = 1.0 - gap_N[""] / before if before > 0.0 else 0.0
        assert truths[n]["true_share"][fault["name"]] == pytest.approx(share)


def test_nothing_in_the_given_folder_speaks_of_the_truth(made):
    folder, truth = made
    truths = sealed.read_truths(truth)
    for name, t in truths.items():
        text = (folder / name / "campaign.toml").read_text()
        for word in (t["kind"], t["salt"], str(t["seed"]), *(e["name"] for e in t["effects"])):
            assert word not in text
    refuse_open_truth(folder)


def test_entropy_is_the_systems_kept_with_the_truths_and_committed_to(made):
    folder, truth = made
    kept = json.loads(truth.read_text())
    assert len(kept["entropy"]) == 64 and "seed" not in kept
    public = json.loads((folder / "commitments.json").read_text())
    assert public["entropy"] == sealed.hashlib.sha256(kept["entropy"].encode()).hexdigest()
    assert kept["entropy"] not in (folder / "commitments.json").read_text()


def test_a_case_follows_from_the_published_entropy(made):
    """Whoever opens the seals can draw the case again, and run it again."""
    folder, truth = made
    entropy = json.loads(truth.read_text())["entropy"]
    bits = sealed.hashlib.sha256(f"{entropy}/case_02".encode()).digest()
    case = rig_cases.draw_case(np.random.default_rng(int.from_bytes(bits, "big")), "single")
    given = read_campaign(folder / "case_02").tests
    again = case.rig.run(case.tests[1], index=1)
    np.testing.assert_allclose(given[1].force_N, again.force_N, atol=1e-6)
    told = sealed.read_truths(truth)["case_02"]["effects"][0]
    assert told["parameters"] == dict(case.faults[0].parameters) and told["law"] == case.faults[0].law


@pytest.mark.usefixtures("small_design")
def test_development_cases_follow_from_their_seed_and_are_marked(tmp_path):
    with ThreadPoolExecutor(1) as executor:
        paths = [
            sealed.make(1, tmp_path / name, seed=5, kinds=["single"], laws="other", workers=run)
            for name, run in (("a", executor), ("b", None))
        ]
    a, b = (sealed.read_truths(path)["case_01"] for path in paths)
    assert a["data"] == b["data"] and a["effects"] == b["effects"] and a["sealed_data"] == b["sealed_data"]
    assert a["salt"] != b["salt"]
    public = json.loads((tmp_path / "a" / "commitments.json").read_text())
    assert public["sealed"] is False and "entropy" not in public
    first = sealed.make(1, tmp_path / "c", kinds=["single"])
    assert sealed.read_truths(first)["case_01"]["data"] != a["data"]


def test_make_refuses_to_write_over_something(made):
    with pytest.raises(WithheldError, match="not empty"):
        sealed.make(1, made[0])
    with pytest.raises(WithheldError, match="at least one"):
        sealed.make(0, made[0] / "none")
    with pytest.raises(WithheldError, match=r"case_01 could not be made.*no kind of case"):
        sealed.make(1, made[0].parent / "odd", kinds=["odd"])


# ---- seals


def test_changed_truth_is_found(copy):
    folder, path = copy
    content = json.loads(path.read_text())
    content["cases"]["case_02"]["effects"][0]["size"] += 1e-6
    path.write_text(json.dumps(content))
    with pytest.raises(WithheldError, match=r"not the one that was sealed: case_02$"):
        sealed.check_seals(folder, sealed.read_truths(path))


def test_changed_data_are_found(copy):
    folder, path = copy
    record = sorted((folder / "case_03").glob("*.csv.gz"))[0]
    record.write_bytes(record.read_bytes()[:-1])
    with pytest.raises(WithheldError, match=r"changed after it was sealed: case_03$"):
        sealed.check_seals(folder, sealed.read_truths(path))


def test_missing_case_is_found(copy):
    folder, path = copy
    truths = sealed.read_truths(path)
    del truths["case_01"]
    with pytest.raises(WithheldError, match="case_01 in one of them only"):
        sealed.check_seals(folder, truths)


def test_seals_in_other_spellings_and_without_salt():
    truth = {"case": "a", "kind": "none", "salt": "é1", "x": [1.5, 2]}
    for spelling in ({}, {"separators": (",", ":")}, {"ensure_ascii": False}, {"indent": 2}):
        text = json.dumps(truth, sort_keys=True, **spelling)
        assert sealed.matches(truth, sealed.hashlib.sha256(text.encode()).hexdigest())
    assert not sealed.matches({**truth, "kind": "pair"}, sealed.commitment(truth))
    with pytest.raises(WithheldError, match="salt"):
        sealed.commitment({"case": "a"})


def test_truth_files_of_other_forms(tmp_path):
    truth = {"case": "a", "kind": "none", "salt": "1"}
    for content in ({"cases": {"a": truth}}, {"a": truth}, [truth], {"cases": [truth]}):
        (tmp_path / "t.json").write_text(json.dumps(content))
        assert sealed.read_truths(tmp_path / "t.json") == {"a": truth}
    (tmp_path / "t.json").write_text("[1]")
    with pytest.raises(WithheldError, match="no truths"):
        sealed.read_truths(tmp_path / "t.json")


def test_changed_sealed_tests_are_found(copy):
    _, path = copy
    case, truth = path.parent / "sealed" / "case_02", sealed.read_truths(path)["case_02"]
    sealed.check_sealed("case_02", case, truth)
    record = sorted(case.glob("*.csv.gz"))[0]
    record.write_bytes(record.read_bytes() + b"0")
    with pytest.raises(WithheldError, match=r"sealed tests were changed after they were sealed: case_02$"):
        sealed.check_sealed("case_02", case, truth)


# ---- answer


def test_answers_are_resumed_and_failures_tried_again(made, tmp_path):
    path = answer(made[0], answerers.fails_once, out=tmp_path, seed=4)
    first = json.loads(path.read_text())
    assert sorted(first["answers"]) == ["case_01", "case_03"]
    assert list(first["failed"]) == ["case_02"] and "RuntimeError: no convergence" in first["failed"]["case_02"]
    made_at = (tmp_path / "case_01" / "diagnosis.json").stat().st_mtime_ns
    answer(made[0], answerers.fails_once, out=tmp_path, seed=4)
    second = json.loads(path.read_text())
    assert sorted(second["answers"]) == ["case_01", "case_02", "case_03"] and not second["failed"]
    assert (tmp_path / "case_01" / "diagnosis.json").stat().st_mtime_ns == made_at
    assert second["answers"]["case_02"]["seed"] == case_seed(4, "case_02") != case_seed(4, "case_01")
    with pytest.raises(WithheldError, match="seed 4"):
        answer(made[0], answerers.fails_once, out=tmp_path, seed=5)


def test_answers_to_another_set_are_not_gone_on_with(made, tmp_path):
    """Both sets have a case_01: the second must not be given the first one's answer."""
    answer(made[0], answerers.fails_once, out=tmp_path / "answers", seed=4, only=["case_01"])
    other = shutil.copytree(made[0], tmp_path / "other")
    sealed = json.loads((other / "commitments.json").read_text())
    sealed["cases"]["case_01"] = sealed["cases"]["case_01"][::-1]
    (other / "commitments.json").write_text(json.dumps(sealed))
    with pytest.raises(WithheldError, match=r"answers other cases .* choose another --out"):
        answer(other, answerers.fails_once, out=tmp_path / "answers", seed=4, only=["case_01"])


@pytest.mark.skipif(not confinement.available(), reason="this machine cannot confine a process")
def test_neither_truth_nor_other_cases_can_be_read_while_answering(made, tmp_path):
    folder, truth = made
    with ThreadPoolExecutor(1) as executor:
        path = answer(folder, answerers.spies, out=tmp_path, only=["case_02"], workers=executor)
    content = json.loads(path.read_text())
    assert content["confined"] is True and not content["failed"]
    assert content["answers"]["case_02"]["got"] == []
    assert content["answers"]["case_02"]["tests"] == 2
    assert json.loads(truth.read_text())  # this process is as free as before


def test_what_is_not_confined_is_said(made, tmp_path, monkeypatch):
    """The spy gets what it wants where there is no confinement, and the answers say so."""
    monkeypatch.setattr(confinement, "available", lambda: False)
    path = answer(made[0], answerers.none, out=tmp_path, only=["case_01"])
    assert json.loads(path.read_text())["confined"] is False


def test_a_closed_folder_is_left_out_of_what_is_granted_around_it(tmp_path):
    for name in ("open", "shut"):
        (tmp_path / "a" / name).mkdir(parents=True)
    around = confinement._around(tmp_path, [tmp_path / "a" / "shut"])
    assert around == [tmp_path / "a" / "open"]
    assert confinement._around(tmp_path / "a" / "shut", [tmp_path / "a"]) == []


def test_truth_within_the_folder_is_refused(copy):
    folder, path = copy
    shutil.copy(path, folder / "case_01" / "notes.json")
    with pytest.raises(WithheldError, match=r"notes.json holds a truth"):
        answer(folder, answerers.none)


def test_what_a_killed_answering_left_is_no_answer(made, tmp_path):
    (tmp_path / "case_01").mkdir()
    answerers.write(tmp_path / "case_01", {"kind": "none", "causes": [], "unknown_cause": False}, {"none": 1.0})
    path = answer(made[0], answerers.silent, out=tmp_path, only=["case_01"])
    found = json.loads(path.read_text())
    assert found["answers"] == {} and "diagnosis.json: no such file" in found["failed"]["case_01"]
    assert not (tmp_path / ".numba_cache").exists()


def test_unknown_case_is_refused(made, tmp_path):
    with pytest.raises(WithheldError, match="no case 'case_09'"):
        answer(made[0], answerers.none, out=tmp_path, only=["case_09"])


# ---- from answers to a score


def test_shares_on_sealed_tests_are_found_and_foreign_code_is_not_run_unasked(made, tmp_path):
    folder, truth = made
    answers = answer(folder, answerers.end_stop, out=tmp_path)
    asked = []

    def shares(diagnosis, sealed):
        asked.append((diagnosis.name, len(read_campaign(sealed).tests)))
        return {"end_stop": 0.7}

    refused = scoring.score(folder, truth, answers=answers, find_shares=shares)
    assert asked == [] and "--allow-effects-file): case_02" in refused.table()
    fits = tmp_path / "case_02" / "fits.json"
    fits.write_text(json.dumps({"effects_file": None, "simulator_file": "mine.py"}))
    assert "--allow-effects-file): case_02" in withheld_scores.write_score(folder, truth, answers=answers)
    with pytest.raises(ValueError, match="not fits of this version"):  # it is asked to run them, and gets so far
        withheld_scores.write_score(folder, truth, answers=answers, allow_effects_file=True)
    fit = {"effects": [], "names": ["kp_N_mm"], "z": [0.1], "covariance": [[1.0]]}
    fit |= {"share": 0.0, "length": 0.1, "along": 0.1, "spectrum": [1.0], "along_spectrum": [1.0]}
    fit |= {"between": [0.8, 0.5, 0.3]}
    scales = dict.fromkeys((f.name for f in fields(Scales)), 1.0)
    stored = {"schema": SCHEMA, "effects_file": "mine.py", "simulator_file": None, "config": {}, "scales": scales}
    fits.write_text(json.dumps(stored | {"fits": {"base": fit}}))
    with pytest.raises(ValueError, match=r"mine\.py: no such file"):
        withheld_scores.write_score(folder, truth, answers=answers, allow_effects_file=True)
    with pytest.raises(ValueError, match="not run unasked"):
        find_shares(fits.parent, truth.parent / "sealed" / "case_02")
    score = scoring.score(folder, truth, answers=answers, find_shares=shares, allow_effects_file=True)
    assert asked == [("case_02", 1)]
    inside = score.summary["share found on sealed tests: in its 90 % interval"]
    assert (inside.count, inside.n) == (1, 1)
    assert score.summary["no fault: a cause named or a unknown cause flagged (false alarm)"].count == 0


def test_score_checks_the_seals_first(copy):
    folder, path = copy
    (folder.parent / "answers").mkdir()
    answers = folder.parent / "answers" / "answers.json"
    answers.write_text("{}")
    path.write_text(path.read_text().replace('"outside"', '"none"'))
    with pytest.raises(WithheldError, match="sealed"):
        scoring.score(folder, path, answers=answers)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("[]", "no cases in it"),
        ('{"cases": {}}', "no cases in it"),
        ('{"cases": {"case_01": 3}}', "no cases in it"),
        ('{"cases": {"../case_01": "00"}}', "no name of a case"),
        ('{"cases": {"..": "00"}}', "no name of a case"),
        ("[" * 100_000, "not readable as JSON"),
    ],
)
def test_commitments_that_are_none_are_refused_in_one_line(tmp_path, content, says):
    (tmp_path / "commitments.json").write_text(content)
    for read in (sealed.case_names, lambda folder: sealed.check_seals(folder, {"case_01": {}})):
        with pytest.raises(WithheldError, match=says):
            read(tmp_path)


def test_a_case_without_its_campaign_is_said(copy):
    folder, path = copy
    shutil.rmtree(folder / "case_02")
    with pytest.raises(WithheldError, match="no campaign for case_02"):
        sealed.check_seals(folder, sealed.read_truths(path))
