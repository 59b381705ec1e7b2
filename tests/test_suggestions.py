"""Wherever a user gives a name of a known set, a misspelt one is refused in one line with what was probably meant."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import bayes_iwan as bi
from bayes_iwan import cli
from bayes_iwan.comparison.families import compare_families
from bayes_iwan.diagnosis.diagnosis import settings_for
from bayes_iwan.errors import nearest
from bayes_iwan.export import export
from bayes_iwan.models import Model
from bayes_iwan.report.style import subplots
from bayes_iwan.screen import Named
from bayes_iwan.virtual_rig.cases import draw_case
from bayes_iwan.virtual_rig.fault import Fault

PLAN = [bi.PlannedTest(10.0, 0.5, cycles=6)]
ROWS = "".join(f"{k / 500},{np.sin(0.1257 * k):.6f},{5 * np.sin(0.1257 * k + 0.3):.6f}\n" for k in range(500))


def prior(**spec):
    return {"parameters": {"kp_N_mm": {"prior": spec}}}


@pytest.mark.parametrize(
    ("misspelt", "meant"),
    [
        (lambda loops: bi.make_problem(loops, prior(dist="lognrm", s=0.5, scale=5.0)), "lognorm"),
        (lambda loops: bi.make_problem(loops, prior(dist="lognorm", s=0.5, scal=5.0)), "scale"),
        (lambda loops: bi.make_problem(loops, {"parameters": {"kp_Nmm": {"fixed": 5.0}}}), "kp_N_mm"),
        (lambda loops: bi.make_problem(loops, {"parameters": {"kp_N_mm": {"tied": "k1_Nmm"}}}), "k1_N_mm"),
        (lambda loops: bi.make_problem(loops, {"parameters": {"kp_N_mm": {"lowr": 1.0}}}), "lower"),
        (lambda loops: bi.make_problem(loops, {"modl": {}}), "model"),
        (lambda loops: bi.make_problem(loops, {"model": {"slip": "gama1"}}), "gamma1"),
        (lambda loops: bi.make_problem(loops, {"likelihood": {"kind": "gausian"}}), "gaussian"),
        (lambda loops: Model(bi.Scales(1, 1, 1, 1, 1, 1), stiffness="constnt"), "constant"),
        (lambda loops: settings_for("clasical", None, False), "classical"),
        (lambda loops: compare_families(loops, ["uniform", "gama1"]), "gamma1"),
        (lambda loops: compare_families(loops, ["uniform", "gamma1"], by="test"), "tests"),
        (lambda loops: bi.simulate_campaign(PLAN, fault="viscous_dampng"), "viscous_damping"),
        (lambda loops: bi.simulate_campaign(PLAN, fault=Fault("end_stop", {}, "hertzz")), "hertz"),
        (lambda loops: draw_case(np.random.default_rng(1), kind="tripple"), "triple"),
        (lambda loops: bi.plot.lops, "loops"),
        (lambda loops: bi.identfy, "identify"),
        (lambda loops: subplots(1, 1, 2, 2) and bi.plot.loops(None, width="colum"), "column"),
        (lambda loops: export("nowhere", "fmuu", "out"), "fmu"),
        (lambda loops: bi.Record("a.csv", 1.0, 1.0, "held_out", {}, *([[0.0, 1.0]] * 3)), "held-out"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_what_was_probably_meant_is_said(made_up_campaign, misspelt, meant):
    with pytest.raises((ValueError, AttributeError), match=f"did you mean '{meant}'") as caught:
        misspelt(bi.check(made_up_campaign).loops)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["import", "stair2.csv", "--held-out", "stai2"], "stair2"),
        (["import", "stair2.csv", "--unit", "frce=kN"], "force"),
        (["import", "stair2.csv", "--reverse", "forc"], "force"),
        (["import", "stair2.csv", "--force", "Kraf"], "Kraft"),
        (["import", "stair2.csv", "--separator", "comm"], "comma"),
        (["import", "stair2.csv", "--encoding", "cp12522"], "cp1252"),
        (["diagnose", "CAMPAIGN", "--base", "clasical"], "classical"),
        (["compare", "CAMPAIGN", "--families", "uniform", "gama1"], "gamma1"),
        (["batch", "PARENT", "--group", "lott"], "lot"),
        (["identfy", "CAMPAIGN"], "identify"),
        (["identify", "CAMPAIGN", "--ovrwrite"], "--overwrite"),
        (["withheld", "make", "1", "--out", "cases", "--seed", "1", "--exclude-outside", "magnetic_drg"], ""),
    ],
    ids=lambda x: " ".join(x[::3]) if isinstance(x, list) else "",
)
def test_the_command_line_says_it_too(tmp_path, monkeypatch, capsys, made_up_campaign, words, meant):
    monkeypatch.chdir(tmp_path)
    Path("stair2.csv").write_text(f"Time [s],Weg [mm],Kraft [N]\n{ROWS}")
    (made_up_campaign.parent / "specimens.csv").write_text("specimen,lot\na,1\n")
    places = {"CAMPAIGN": str(made_up_campaign), "PARENT": str(made_up_campaign.parent)}
    try:
        code = cli.main([places.get(word, word) for word in words])
    except SystemExit as end:
        code = end.code
    said = capsys.readouterr().err
    assert code == 2 and f"did you mean '{meant}" in said and "Traceback" not in said, said


def test_parts_of_a_result_by_name():
    with pytest.raises(KeyError, match="did you mean 'kp_N_mm'"):
        Named({"kp_N_mm": 5.0, "k1_N_mm": 14.0})["kp_Nmm"]


def test_where_none_is_near_the_known_ones_are_listed():
    assert nearest("xyz", ["one", "two"]) == "; there are one, two"
    assert nearest("xyz", map(str, range(99))).endswith("11 … (99)")
    assert nearest("xyz", []) == "" and nearest("xyz", ["one"], "; say one") == "; say one"


def test_a_key_that_is_missing_is_said_with_the_one_that_was_meant_to_be_it(made_up_campaign, tmp_path):
    folder = shutil.copytree(made_up_campaign, tmp_path / "typo")
    stated = folder / "campaign.toml"
    stated.write_text(stated.read_text().replace("amplitude_mm", "amplitud_mm"))
    with pytest.raises(
        bi.CampaignError, match="amplitude_mm is missing; did you mean 'amplitud_mm' to be amplitude_mm"
    ):
        bi.read_campaign(folder)
