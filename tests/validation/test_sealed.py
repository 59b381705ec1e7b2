"""The withheld protocol: sealing, answering with the truth closed, opening the seals."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from bayes_iwan import executors
from bayes_iwan.campaign import read_campaign
from bayes_iwan.rig import cases as rig_cases
from bayes_iwan.rig import simulate as rig
from bayes_iwan.rig.simulate import PlannedTest
from bayes_iwan.validation import scoring
from bayes_iwan.validation import sealed as withheld
from bayes_iwan.validation.sealed import WithheldError


def small_design(rng):
    """Two short tests a case: the protocol is on trial here, not the rig."""
    f = float(rng.uniform(8, 12))
    tests = tuple(PlannedTest(round(f * k, 1), a, 6, 4) for k, a in ((1, 0.4), (2, 0.9)))
    return tests, (PlannedTest(round(1.5 * f, 1), 0.7, 6, 4),)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    patch.setattr(rig_cases, "draw_design", small_design)
    folder = tmp_path_factory.mktemp("withheld") / "set"
    truth = withheld.make(3, 7, folder, kinds=["none", "single", "outside"])
    yield folder, truth
    patch.undo()


@pytest.fixture
def copy(made, tmp_path):
    """The set and its truths, free to be spoilt."""
    shutil.copytree(made[0], tmp_path / "set")
    shutil.copytree(made[1].parent, tmp_path / "set-truth")
    return tmp_path / "set", tmp_path / "set-truth" / "truth.json"


def diagnose_none(campaign, out, seed, quick):
    """A diagnosis that reads its campaign and always finds nothing."""
    read_campaign(campaign)
    withheld.write_json(
        out / "diagnosis.json",
        {"verdict": {"cause": "none", "probability": 0.9}, "probabilities": {"none": 0.9, "unknown": 0.1},
         "seed": seed, "quick": quick, "effects": []},
    )  # fmt: skip


# ---- make


def test_layout_and_seals(made):
    folder, truth = made
    names = ["case_01", "case_02", "case_03"]
    assert sorted(p.name for p in folder.iterdir()) == [*names, "commitments.json"]
    assert truth == folder.parent / "set-truth" / "truth.json"
    truths = withheld.read_truths(truth)
    assert [truths[n]["kind"] for n in names] == ["none", "single", "outside"]
    withheld.check_seals(folder, truths)
    sealed = json.loads((folder / "commitments.json").read_text())
    assert set(sealed) == {"rule", "cases"} and all(len(v) == 64 for v in sealed["cases"].values())
    for n in names:
        assert len(read_campaign(folder / n).tests) == 2
        assert len(read_campaign(truth.parent / "unseen" / n).tests) == 1
        single = truths[n]["effects"]
        assert all({"name", "size", "parameters"} <= set(e) for e in single)
        assert len(truths[n]["salt"]) == 64


def test_nothing_in_the_given_folder_speaks_of_the_truth(made):
    folder, truth = made
    truths = withheld.read_truths(truth)
    for name, t in truths.items():
        text = (folder / name / "campaign.toml").read_text()
        for word in (t["kind"], t["salt"], str(t["seed"]), *(e["name"] for e in t["effects"])):
            assert word not in text
    withheld.refuse_open_truth(folder)


def test_data_follow_from_the_seed_and_seals_do_not(made, tmp_path, monkeypatch):
    monkeypatch.setattr(rig_cases, "draw_design", small_design)
    with ThreadPoolExecutor(1) as executor:
        again = withheld.make(3, 7, tmp_path / "set", kinds=["none", "single", "outside"], executor=executor)
    a, b = withheld.read_truths(made[1]), withheld.read_truths(again)
    for name in a:
        assert a[name]["data"] == b[name]["data"] and a[name]["effects"] == b[name]["effects"]
        assert a[name]["salt"] != b[name]["salt"]
    assert (made[0] / "commitments.json").read_text() != (tmp_path / "set" / "commitments.json").read_text()


def test_make_refuses_to_write_over_something(made):
    with pytest.raises(WithheldError, match="not empty"):
        withheld.make(1, 0, made[0])
    with pytest.raises(WithheldError, match="at least one"):
        withheld.make(0, 0, made[0] / "none")


# ---- seals


def test_changed_truth_is_found(copy):
    folder, path = copy
    content = json.loads(path.read_text())
    content["cases"]["case_02"]["effects"][0]["size"] += 1e-6
    path.write_text(json.dumps(content))
    with pytest.raises(WithheldError, match=r"not the one that was sealed: case_02$"):
        withheld.check_seals(folder, withheld.read_truths(path))


def test_changed_data_are_found(copy):
    folder, path = copy
    record = sorted((folder / "case_03").glob("*.csv.gz"))[0]
    record.write_bytes(record.read_bytes()[:-1])
    with pytest.raises(WithheldError, match=r"changed after it was sealed: case_03$"):
        withheld.check_seals(folder, withheld.read_truths(path))


def test_missing_case_is_found(copy):
    folder, path = copy
    truths = withheld.read_truths(path)
    del truths["case_01"]
    with pytest.raises(WithheldError, match="case_01 in one of them only"):
        withheld.check_seals(folder, truths)


def test_seals_in_other_spellings_and_without_salt():
    truth = {"case": "a", "kind": "none", "salt": "é1", "x": [1.5, 2]}
    for spelling in ({}, {"separators": (",", ":")}, {"ensure_ascii": False}, {"indent": 2}):
        text = json.dumps(truth, sort_keys=True, **spelling)
        assert withheld.matches(truth, withheld.hashlib.sha256(text.encode()).hexdigest())
    assert not withheld.matches({**truth, "kind": "pair"}, withheld.commitment(truth))
    with pytest.raises(WithheldError, match="salt"):
        withheld.commitment({"case": "a"})


def test_truth_files_of_other_forms(tmp_path):
    truth = {"case": "a", "kind": "none", "salt": "1"}
    for content in ({"cases": {"a": truth}}, {"a": truth}, [truth], {"cases": [truth]}):
        (tmp_path / "t.json").write_text(json.dumps(content))
        assert withheld.read_truths(tmp_path / "t.json") == {"a": truth}
    (tmp_path / "t.json").write_text("[1]")
    with pytest.raises(WithheldError, match="no truths"):
        withheld.read_truths(tmp_path / "t.json")


# ---- answer


def test_answers_are_resumed_and_failures_tried_again(made, tmp_path):
    asked = []

    def fails_once(campaign, out, seed, quick):
        asked.append((campaign.name, seed))
        if campaign.name == "case_02" and len(asked) < 4:
            raise RuntimeError("no convergence")
        diagnose_none(campaign, out, seed, quick)

    path = withheld.answer(made[0], fails_once, out=tmp_path, seed=4)
    first = json.loads(path.read_text())
    assert sorted(first["answers"]) == ["case_01", "case_03"]
    assert first["failed"] == {"case_02": "RuntimeError: no convergence"}
    withheld.answer(made[0], fails_once, out=tmp_path, seed=4)
    second = json.loads(path.read_text())
    assert [a[0] for a in asked] == ["case_01", "case_02", "case_03", "case_02"]
    assert sorted(second["answers"]) == ["case_01", "case_02", "case_03"] and not second["failed"]
    assert asked[1][1] == asked[3][1] == withheld.case_seed(4, "case_02") != withheld.case_seed(4, "case_01")
    with pytest.raises(WithheldError, match="seed 4"):
        withheld.answer(made[0], fails_once, out=tmp_path, seed=5)


def test_truth_cannot_be_read_while_answering(made, tmp_path):
    folder, truth = made
    tried = []

    def cheat(campaign, out, seed, quick):
        for path in (truth, truth.parent / "unseen" / campaign.name / "campaign.toml", campaign / "campaign.toml"):
            try:
                path.read_text()
                tried.append("read")
            except PermissionError:
                tried.append("closed")
        diagnose_none(campaign, out, seed, quick)

    withheld.answer(folder, cheat, out=tmp_path, only=["case_02"])
    assert tried == ["closed", "closed", "read"]
    assert json.loads(truth.read_text())  # open again afterwards


def test_truth_within_the_folder_is_refused(copy):
    folder, path = copy
    shutil.copy(path, folder / "case_01" / "notes.json")
    with pytest.raises(WithheldError, match=r"notes.json holds a truth"):
        withheld.answer(folder, diagnose_none)


def test_spawned_workers_answer_with_the_truth_closed(made, tmp_path, monkeypatch):
    module = tmp_path / "cheating_diagnosis.py"
    module.write_text(
        "import json, pathlib\n"
        "def diagnose(campaign, out, seed, quick):\n"
        "    truth = campaign.parent.with_name(campaign.parent.name + '-truth') / 'truth.json'\n"
        "    try:\n"
        "        found = json.loads(truth.read_text())['cases'][campaign.name]['kind']\n"
        "    except PermissionError:\n"
        "        found = 'closed'\n"
        "    out.mkdir(parents=True, exist_ok=True)\n"
        "    (out / 'diagnosis.json').write_text(json.dumps({'verdict': {'cause': found}, 'probabilities': {}}))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    import cheating_diagnosis

    with executors.opened(2) as executor:
        path = withheld.answer(made[0], cheating_diagnosis.diagnose, out=tmp_path / "out", executor=executor)
    content = json.loads(path.read_text())
    assert not content["failed"]
    assert {a["verdict"]["cause"] for a in content["answers"].values()} == {"closed"}


def test_unknown_case_is_refused(made, tmp_path):
    with pytest.raises(WithheldError, match="no case case_09"):
        withheld.answer(made[0], diagnose_none, out=tmp_path, only=["case_09"])


# ---- from answers to a score


def test_scored_from_files_with_the_shrink_found_on_unseen_tests(made, tmp_path):
    folder, truth = made
    single = withheld.read_truths(truth)["case_02"]["effects"][0]

    def oracle(campaign, out, seed, quick):
        cause = {"case_01": "none", "case_02": single["name"], "case_03": "unknown"}[campaign.name]
        withheld.write_json(
            out / "diagnosis.json",
            {"verdict": {"cause": cause}, "probabilities": {cause: 1.0},
             "effects": [{"name": single["name"], "shrink_expected": 0.8, "parameters": {}}]},
        )  # fmt: skip

    def find_shrink(diagnosis, unseen, cause):
        assert (diagnosis / "diagnosis.json").is_file() and len(read_campaign(unseen).tests) == 1
        return 0.7

    answers = withheld.answer(folder, oracle, out=tmp_path)
    score = scoring.score(folder, truth, answers=answers, find_shrink=find_shrink)
    assert score.summary["first answer right (none, single and outside cases)"].count == 3
    assert score.summary["log score, nats"].value == 0
    shrunk = score.summary["shrink: median predicted − found"]
    assert shrunk.n == 1 and shrunk.value == pytest.approx(0.1)


def test_score_checks_the_seals_first(copy):
    folder, path = copy
    answers = withheld.answer(folder, diagnose_none, out=folder.parent / "answers")
    path.write_text(path.read_text().replace('"outside"', '"none"'))
    with pytest.raises(WithheldError, match="sealed"):
        scoring.score(folder, path, answers=answers)


def test_sealed_sizes_are_those_of_the_written_records(made):
    """The effect in the truth, put into the rig again, gives the campaign that was written."""
    folder, truth = made
    rng = np.random.default_rng([7, 1])
    case = rig_cases.draw_case(rng, "single")
    given = read_campaign(folder / "case_02").tests
    again = rig.simulate_test(
        case.specimen, case.tests[1], setup=case.setup, faults=case.faults, seed=case.seed, index=1
    )
    np.testing.assert_allclose(given[1].force_N, again.force_N, atol=1e-6)
    sealed = withheld.read_truths(truth)["case_02"]["effects"][0]
    assert sealed["parameters"] == dict(case.faults[0].parameters)
