"""Floors of the normal force's law are counted where they act, and contact that is lost is the model's own physics."""

import numpy as np
import pytest

from bayes_iwan.campaign import average
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search.base_fit import fit_base
from bayes_iwan.inference.results import floors as module
from bayes_iwan.inference.results.floors import Floors, floors_at, floors_said
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.settings import DiagnoseSettings, ModelSettings
from bayes_iwan.models.bouc_wen import BoucWen
from bayes_iwan.models.normal_force import ALPHA_FLOOR

#: α = 1 − 1.6 u/ℓ + …: lost beyond u = 0.625 mm and more, so in the tests of 1 mm alone
LOSING = {"normal_force_slope": np.array([1.6]), "normal_force_rate": np.array([0.3]), "beta": np.array([1.0])}


def elements(u, alpha, k, phi):
    """Two cycles of Jenkins elements that carry nothing while α is 0; the second is returned."""
    e, last, force = np.zeros(phi.size), 0.0, []
    for now, a, stiffness in zip(np.tile(u, 2), np.tile(alpha, 2), np.tile(k, 2)):
        limit = phi * (a / stiffness if a > 0.0 else 1.0 / 19.62)
        e = np.clip(e + now - last, -limit, limit)
        last = now
        force.append(stiffness * e.mean() if a > 0.0 else 0.0)
    return np.array(force[len(u) :])


@pytest.fixture(scope="module")
def losing(known):
    """Loops of a specimen that loses contact over a third of its cycle at 1 mm, and its mean slip force."""
    phi = 0.4 * np.random.default_rng(0).gamma(3.0, size=3000)
    loops, n = [], 1024
    for f, a in ((10.0, 0.3), (20.0, 0.3), (15.0, 0.6), (10.0, 1.0), (20.0, 1.0)):
        p = 2.0 * np.pi * np.arange(n) / n
        u, speed = a * np.sin(p), 2e-3 * np.pi * f * a * np.abs(np.cos(p))
        alpha = np.maximum(1.0 - 1.6 * u + 0.3 * np.maximum(a - u, 0.01 * a) * speed / 0.1257, 0.0)
        k = 30.37 * (1.0 - np.exp(-19.62 * alpha / 30.37))
        loops.append(average(known.record(f, a, elements(u, alpha, k, phi) + 5.5 * u, noise_N=0.005)))
    return loops, float(phi.mean())


def test_slip_forces_of_a_specimen_that_loses_contact_are_recovered(losing):
    loops, mean = losing
    settings = DiagnoseSettings(ModelSettings(slip="gamma1"))
    fit = fit_base(gap_data(loops), settings, scales_of(loops), np.random.default_rng(0))
    assert fit.problem.prior.values(fit.z[None])["mean_slip_force_N"][0] == pytest.approx(mean, rel=0.01)
    floors = floors_at(fit.problem, fit.z)
    assert set(floors.lost) == {"f10_a1.csv", "f20_a1.csv"}
    assert all(0.2 < share < 0.35 for share in floors.lost.values())
    assert (
        "Contact is lost" in floors_said(fit.problem, fit.z)[0] and "f10_a1.csv" in floors_said(fit.problem, fit.z)[0]
    )


def test_elements_carry_nothing_where_contact_is_lost(losing):
    problem = make_problem(losing[0], {"model": {"slip": "gamma1", "embedded": False}})
    values = problem.parameter_values(np.zeros((1, problem.ndim))) | LOSING
    lost = problem.model.alpha(values, problem.motion)[0] <= ALPHA_FLOOR
    assert lost.any() and not lost.all()
    friction = problem.model.friction_force(values, problem.motion)[0]
    assert np.max(np.abs(friction[lost])) < 1e-4 * np.max(np.abs(friction))


def test_the_end_of_the_stroke_is_said_where_it_matters(problem, known):
    z = known.true_z(problem)[0]
    assert floors_at(problem, z).lost == {}
    printed = 1.0 - 0.6 * 1.0**0.6  # k̃ₙ A^β at 1 mm
    floors = floors_at(problem, z)
    assert floors.printed_at_end == pytest.approx(printed, rel=1e-2)
    assert floors.alpha_at_end == pytest.approx(printed + 0.6 * 0.01**0.6, rel=1e-2)
    assert floors.at_end == pytest.approx(2.0 * np.arccos(0.99) / (2.0 * np.pi), abs=0.01)
    assert floors_said(problem, z) == ()  # 0.04 is not worth a sentence
    values = problem.prior.values(z[None]) | {"beta": np.array([0.0062]), "normal_force_slope": np.array([0.0111])}
    (said,) = floors_said(problem, problem.prior.scores(values)[0])
    assert "A - u kept at or above 0.01 A" in said and "-0.79 as printed" in said


def test_the_end_of_the_stroke_is_that_of_the_test_where_it_matters_most(known):
    """Tests of 0.5 and 3 mm: α at u = A as printed is 1 − k̃ₙ A^β, A in mm, whatever the campaign's own length."""
    problem = make_problem(known.loops(tests=((10.0, 0.5), (10.0, 3.0))))
    floors = floors_at(problem, known.true_z(problem)[0])
    assert floors.printed_at_end == pytest.approx(1.0 - 0.6 * 3.0**0.6, rel=1e-2)


@pytest.mark.parametrize(("slip", "advice"), [("gamma1", "Try gamma3."), ("gamma3", "show.")])
def test_a_form_of_more_components_is_advised_where_there_is_one(known, monkeypatch, slip, advice):
    monkeypatch.setattr(module, "floors_at", lambda *_: Floors({}, negative=0.05))
    (said,) = floors_said(make_problem(known.loops(), {"model": {"slip": slip}}), np.zeros(1))
    assert f"({slip}) is far from what the loops show." in said and said.endswith(advice)


def test_a_simulator_without_a_normal_force_has_no_floors(known):
    problem = make_problem(known.loops(), {}, simulator=BoucWen())
    assert floors_said(problem, np.zeros(problem.ndim)) == ()
