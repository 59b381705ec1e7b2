"""The studies in `analyses/` at their smallest: that they run from end to end, and that their own parts are right."""

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.campaign import Record, read_campaign
from bayes_iwan.effects import catalogue
from bayes_iwan.gap.attribution import Table
from bayes_iwan.gap.data import gap_data
from bayes_iwan.gap.evidence import LENGTHS, SHARES, base_problem, fit_model
from bayes_iwan.inference.scales import scales_of
from bayes_iwan.rig import cases as rig_cases
from bayes_iwan.rig.simulate import PlannedTest
from bayes_iwan.validation import known_gap as on_top

ROOT = Path(__file__).parents[2]
VALUES = {"kp_N_mm": 5.0}


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(ROOT / "analyses"))
    yield importlib.import_module
    sys.path.remove(str(ROOT / "analyses"))


def small_design(rng):
    f = float(rng.uniform(8, 12))
    tests = tuple(PlannedTest(round(f * k, 1), a, 6, 4) for k, a in ((1, 0.4), (2, 0.9)))
    return tests, (PlannedTest(round(1.5 * f, 1), 0.7, 6, 4),)


def record(f, n=20_000, cycles=30):
    """A parallel spring of 5 N/mm and a Coulomb-like friction of 1 N."""
    t = np.arange(n) / (n / cycles * f)
    u = 0.5 * np.sin(2 * np.pi * f * t)
    friction = np.tanh(np.cos(2 * np.pi * f * t) / 0.1)
    return Record(f"f{f:g}.csv", f, 0.5, "fit", {}, t, u, 5.0 * u + friction + 0.2)


def test_kept_runs_once_and_shares_work_in_order(study, tmp_path):
    runs = study("runs")
    calls = []

    def work(x):
        calls.append(x)
        return x * x

    jobs = [(tmp_path / "a" / f"{i}.json", work, i) for i in range(3)]
    assert list(runs.each(jobs, 1)) == [0, 1, 4]
    assert list(runs.each(jobs, 1)) == [0, 1, 4]
    assert calls == [0, 1, 2]


@pytest.mark.parametrize(
    "effect", ("channel_delay", "force_highpass", "integration_highpass", "moving_mass", "force_drift", "friction_fade")
)
def test_effects_put_into_records_have_the_size_asked_for(study, effect):
    half_real = study("half_real")
    tests = (record(5.0), record(12.0))
    strength = half_real.strength_for(tests, effect, 0.1, VALUES)
    assert half_real.size(tests, effect, strength, VALUES) == pytest.approx(0.1, rel=1e-3)


def test_effects_put_into_records_do_what_they_say(study):
    half_real = study("half_real")
    x = record(5.0)
    inner = slice(2000, -2000)
    late = half_real.changed(x, "channel_delay", 2e-3, VALUES)
    assert late.force_N[inner] == pytest.approx(np.interp(x.time_s - 2e-3, x.time_s, x.force_N)[inner])
    heavy = half_real.changed(x, "moving_mass", 0.01, VALUES)
    true = -0.01 * (2 * np.pi * 5.0) ** 2 * x.displacement_mm * 1e-3
    assert (heavy.force_N - x.force_N)[inner] == pytest.approx(true[inner], abs=0.01 * np.abs(true).max())
    ac = half_real.changed(x, "force_highpass", 0.5, VALUES)
    assert abs(np.mean(ac.force_N[len(ac.force_N) // 2 :])) < 0.02  # 0.2 N before
    lead = half_real.changed(x, "integration_highpass", 0.5, VALUES)
    late_half = slice(len(x.time_s) // 2, None)
    turn = np.exp(-2j * np.pi * 5.0 * x.time_s[late_half])
    phase = np.angle((turn @ lead.displacement_mm[late_half]) / (turn @ x.displacement_mm[late_half]))
    assert phase == pytest.approx(np.arctan(0.5 / 5.0), rel=0.03)
    faded = half_real.changed(x, "friction_fade", 0.3, VALUES)
    friction = faded.force_N - 0.2 - 5.0 * x.displacement_mm
    assert np.abs(friction[-700:]).max() == pytest.approx(1.0 - 0.3 * (1.0 - np.exp(-4.0)), abs=0.02)
    with pytest.raises(ValueError, match="no effect 'magic'"):
        half_real.changed(x, "magic", 1.0, VALUES)


def test_plan_puts_masses_only_where_frequencies_differ(study):
    half_real = study("half_real")
    cases = half_real.plan(48, 0, list(half_real.SOURCES))
    assert len(cases) == 48
    assert half_real.plan(20, 0, list(half_real.SOURCES)) == cases[:20]
    assert all(c.startswith("damper") for c, e, *_ in cases if e == "moving_mass")
    assert all(half_real.SIZES[0] <= size <= half_real.SIZES[1] for *_, size, _ in cases)
    assert {sign for _, e, _, sign in cases if e == "channel_delay"} <= {-1.0, 1.0}


def test_an_effect_is_found_on_top_of_a_gap_that_was_known():
    """A misfit of the fifth harmonic, known before, hides neither a mass nor makes one up."""
    campaign = read_campaign(ROOT / "data" / "rope_spring")
    campaign = replace(campaign, tests=tuple(campaign.tests[i] for i in (0, 4, 8)))

    def crooked(x, mass=0.0):
        turn = 2 * np.pi * x.frequency_hz * x.time_s
        own = 0.15 * np.cos(5 * turn)
        moved = -mass * (2 * np.pi * x.frequency_hz) ** 2 * 1e-3 * (x.displacement_mm - x.displacement_mm.mean())
        return replace(x, force_N=x.force_N + own + moved)

    before = [crooked(x) for x in campaign.tests]
    loops = replace(campaign, tests=tuple(before)).loops(n_phase=80, n_harmonics=24)
    data, scales = gap_data(loops), scales_of(loops)
    problem = base_problem(data, {}, scales)
    fit = fit_model(data, problem, np.zeros((1, problem.ndim)))
    values = {n: float(v[0]) for n, v in problem.prior.values(fit.z[None]).items()}
    then = on_top.Known(
        scales,
        {},
        (),
        values,
        Table({(): fit.log_z}).gap_share,
        on_top.missed_by(data, fit),
        on_top.turned_by(data, fit),
    )
    kinds = {n: catalogue.variants()[n] for n in ("moving_mass", "direction_dependent_friction", "channel_delay")}
    for mass, delay_s, cause in ((0.0, 0.0, "none"), (0.05, 0.0, "moving_mass"), (0.0, 1e-3, "channel_delay")):
        # a late channel delays the misfit that was known with all the rest
        put_in = (crooked(x, mass) for x in campaign.tests)
        new = replace(
            campaign,
            tests=tuple(replace(x, force_N=np.interp(x.time_s - delay_s, x.time_s, x.force_N)) for x in put_in),
        )
        rest = on_top.data_on_top(new.loops(n_phase=80, n_harmonics=24), then)
        answer = on_top.attribute_on_top(on_top.search_on_top(rest, then, kinds), then)
        assert answer.cause == cause
    with pytest.raises(ValueError, match="give the same tests"):
        on_top.data_on_top(loops[:2], then)


def test_calibration_is_fitted_to_tables(study, tmp_path):
    """Constants that were fitted score better than any, on tables whose truth is plain."""
    calibrate = study("calibrate_diagnosis")
    rng = np.random.default_rng(0)
    grid = np.ones((len(SHARES), len(LENGTHS)))
    small = -0.5 * (np.log(SHARES / 0.002) / 0.6)[:, None] ** 2 * np.ones(len(LENGTHS))
    large = -0.5 * (np.log(SHARES / 0.05) / 0.6)[:, None] ** 2 * np.ones(len(LENGTHS))
    cases = []
    for i in range(24):
        kind = ("none", "single", "outside")[i % 3]
        table = {
            (): small if kind == "none" else large - 40.0,
            ("a",): large - 45.0 + rng.normal() * grid,
            ("b",): small if kind == "single" else large - 45.0,
        }
        true = {"none": (), "single": ("b",), "outside": ("unknown",)}[kind]
        cases.append(calibrate.Case(f"c{i}", kind, true, Table(table)))
    fitted = calibrate.fit(cases, 2, 0, "test", list(calibrate.BOX))
    middle = calibrate.constants(np.mean(list(calibrate.BOX.values()), axis=1))
    assert calibrate.log_score(cases, fitted) < min(calibrate.log_score(cases, middle), 0.5)
    some = calibrate.fit(cases, 1, 0, "test", ["temper"])
    shipped = calibrate.constants(calibrate.numbers_of(calibrate.calibration()))
    assert replace(some, temper=shipped.temper) == shipped and some.temper != shipped.temper
    s = calibrate.scores(cases, fitted)
    assert s["single: first answer right"].count == 8
    assert s["pairs: both named"].n == 0
    path = tmp_path / "c.json"
    fitted.save(path)
    assert json.loads(path.read_text())["apart"] == calibrate.APART
    assert len(calibrate.figure({"all": calibrate.verdicts(cases, fitted)}).axes) == 1
    assert calibrate.true_hypothesis({"kind": "pair", "effects": [{"name": "b"}, {"name": "a"}]}) == ("a", "b")


def test_uniform_ranks_pass_and_bent_ones_do_not(study):
    sbc = study("sbc")
    rng = np.random.default_rng(1)
    flat = sbc.uniformity(rng.integers(0, sbc.RANKED + 1, 400))
    bent = sbc.uniformity((sbc.RANKED * rng.beta(2, 2, 400)).astype(int))
    assert min(flat.values()) > 0.01
    assert max(bent.values()) < 0.01


def test_simulation_based_calibration_runs(study, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(
        sys,
        "argv",
        [
            "sbc.py",
            "--draws",
            "1",
            "--likelihoods",
            "gaussian",
            "--slip",
            "uniform",
            "--tests",
            "0",
            "8",
            "--budget",
            "2",
            "--out",
            str(tmp_path),
        ],
    )
    study("sbc").main()
    result = json.loads((tmp_path / "sbc.json").read_text())["likelihoods"]["gaussian"]
    assert set(result["ranks"]) >= {"kp_N_mm", "k1_N_mm", "mean_slip_force_N", "noise_N", "energy[f10_a0.3]"}
    assert all(0 <= r <= 63 for ranks in result["ranks"].values() for r in ranks)
    assert (tmp_path / "sbc.png").stat().st_size > 5000


def test_coverage_on_the_rig_runs(study, tmp_path, monkeypatch):
    monkeypatch.setattr(rig_cases, "draw_design", small_design)
    monkeypatch.setattr(sys, "argv", ["coverage_rig.py", "--cases", "1", "--laplace", "--out", str(tmp_path)])
    study("coverage_rig").main()
    result = json.loads((tmp_path / "coverage.json").read_text())
    assert result["table"]["energy"]["reported"]["coverage"]["0.9"]["n"] == 2
    numbers = result["cases"][0]["numbers"]
    energies = [r for n, r in numbers.items() if n.startswith("dissipated_energy")]
    assert len(energies) == 2 and all(abs(r["error"]) < 0.1 for r in energies)
    assert all(r["width_reported"] >= 0.99 * r["width_alone"] > 0.0 for r in numbers.values())
    assert (tmp_path / "coverage.png").stat().st_size > 5000


def test_sealed_scoring_runs_from_one_command(study, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(rig_cases, "draw_design", small_design)
    monkeypatch.setattr(sys, "argv", ["score_withheld.py", "--cases", "1", "--seed", "3", "--out", str(tmp_path)])
    study("score_withheld").main()
    result = json.loads((tmp_path / "score.json").read_text())
    assert set(result["baselines"]) == {"uniform guess", "correlation", "BIC"}
    assert result["failed"] == {}
    assert "uniform guess" in capsys.readouterr().out
    for stem in ("confusion", "reliability", "accuracy", "shares"):
        assert (tmp_path / f"{stem}.png").is_file()
