"""Reported quantities against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.inference.setup.loop_scales import loop_energy_mJ
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.quantities import loop_quantities, quantities, slip_quantiles
from bayes_iwan.models import Model, Reference, sine_motion
from bayes_iwan.models.paper_parameters import table_1
from bayes_iwan.models.slip_force import Gammas


def test_energy_stiffness_and_loss_of_a_viscoelastic_loop():
    """F = k u + c u̇ at amplitude A: energy π c ω A², stiffness k, loss factor c ω / k."""
    motion = sine_motion(frequency_hz=[10.0, 20.0], amplitude_mm=[0.5, 1.0])
    omega = 2 * np.pi * motion.frequency_hz[:, None]
    force = 7.0 * motion.displacement_mm + 0.01 * 1e3 * motion.velocity_m_s
    energy, stiffness, loss = loop_quantities(motion.displacement_mm, force)
    np.testing.assert_allclose(energy[0], np.pi * 0.01 * omega[:, 0] * np.array([0.25, 1.0]), rtol=1e-12)
    np.testing.assert_allclose(stiffness[0], 7.0, rtol=1e-9)
    np.testing.assert_allclose(loss[0], 0.01 * omega[:, 0] / 7.0, rtol=1e-9)


def test_energy_of_a_friction_rectangle():
    """Coulomb friction of 2 N over ± 0.3 mm dissipates 4 · 2 · 0.3 mJ, whatever the spring beside it."""
    motion = sine_motion(frequency_hz=5.0, amplitude_mm=0.3, samples=4096)
    force = 2.0 * np.sign(motion.velocity_m_s) + 3.0 * motion.displacement_mm
    assert loop_quantities(motion.displacement_mm, force)[0][0, 0] == pytest.approx(2.4, rel=1e-3)


@pytest.mark.parametrize("samples", [128, 129])
def test_energy_at_few_samples_is_that_of_many(samples):
    """Table 1: within 5e-5 at 128 samples, where central differences lose 4e-4."""
    model = Model(Reference(1.0, 0.126))

    def energy(samples):
        motion = sine_motion(frequency_hz=[10.0, 20.0], amplitude_mm=[1.0, 0.3], samples=samples)
        return loop_energy_mJ(motion.displacement_mm, model.force(table_1(model.reference), motion))

    np.testing.assert_allclose(energy(samples), energy(8192), rtol=5e-5)


def test_slip_quantiles_are_scipys():
    """Of narrow and of broad densities, whose upper end is far above what loops of microslip dissipate."""
    t, eta = np.array([0.5, 0.2, 40.0]), np.array([2.0, 5.0, 0.3])
    shares = (0.05, 0.5, 0.75, 0.95)
    got = slip_quantiles(Gammas(1), {"t1_N": t, "eta1": eta, "g1": np.ones(3)}, shares)
    np.testing.assert_allclose(got[:, 1:], stats.gamma.ppf(shares[1:], eta[:, None], scale=t[:, None]), rtol=2e-3)
    np.testing.assert_allclose(got[:2, 0], stats.gamma.ppf(0.05, eta[:2], scale=t[:2]), rtol=2e-3)


def test_slip_quantiles_do_not_end_at_what_the_loops_dissipate(problem, known):
    """Tests of small amplitude dissipate little: the scale of slip forces is small, the slip forces are not."""
    z = known.true_z(problem)
    few = replace(problem, scales=replace(problem.scales, slip_N=0.05 * problem.scales.slip_N))
    for name in ("slip_force_q50_N", "slip_force_q95_N"):
        assert quantities(few, z)[name].values == pytest.approx(quantities(problem, z)[name].values, rel=1e-12)


def test_every_quantity_at_known_numbers(problem, known):
    """Names, and values that follow from the known numbers; the measured loops' energies within their noise."""
    q = quantities(problem, known.true_z(problem))
    n = {name: x.values[0] for name, x in q.items()}
    for name, value in known.parameter_values().items():
        if name in n and name not in (
            "normal_force_slope",
            "normal_force_rate",
        ):  # these hang on the campaign's own scales
            assert n[name] == pytest.approx(float(value[0]), rel=1e-4, abs=1e-4), name
    assert n["ki_N_mm"] == pytest.approx(19.62, rel=1e-4) and n["ku_N_mm"] == pytest.approx(30.37, rel=1e-4)
    assert n["kn_1_mm"] == pytest.approx(0.6, rel=1e-3) and n["lambda_s_m"] == pytest.approx(1.1, rel=1e-3)
    assert n["mean_slip_force_N"] == pytest.approx(0.41 * 0.24 * 0.95 + 0.53 * 0.36 * 5.1 + 0.06 * 0.5 * 4.4, rel=1e-4)
    for loop in problem.loops:
        measured = loop_energy_mJ(loop.displacement_mm, loop.force_N)
        assert n[f"dissipated_energy_mJ[{loop.file}]"] == pytest.approx(measured, rel=0.01)
        ends = {p: n[f"alpha_{p}[{loop.file}]"] for p in ("minus_A", "0_up", "plus_A", "0_down")}
        a, f = loop.amplitude_mm, loop.frequency_hz
        at_rest = 1 + 0.6 * ((2 * a) ** 0.6 - a**0.6)
        assert ends["minus_A"] == pytest.approx(at_rest, rel=2e-3)
        middle = 1 + 1.1 * 0.6 * a**0.6 * 2 * np.pi * f * a * 1e-3
        assert ends["0_up"] == pytest.approx(middle, rel=5e-3) and ends["0_down"] == pytest.approx(middle, rel=5e-3)
        assert ends["plus_A"] < ends["0_up"]
    assert q["kp_N_mm"].unit == "N/mm" and q[f"dissipated_energy_mJ[{problem.loops[0].file}]"].unit == "mJ"


def test_quantiles_of_slip_forces_that_reach_far_beyond_the_loops_friction(known):
    """An exponential of slip forces: its quantile p is −mean ln(1 − p), also where that is seven times the friction."""
    tests = ((10.0, 0.3), (10.0, 1.0))
    p = make_problem(known.loops(tests=tests), {"model": {"slip": "gamma1", "normal_force": "constant"}})
    mean = 2.2 * p.scales.slip_N
    values = p.prior.values(np.zeros((1, p.ndim))) | {"mean_slip_force_N": np.array([mean]), "eta1": np.array([1.0])}
    found = quantities(p, p.prior.scores(values))
    for share in (5, 25, 50, 75, 95):
        expected = -mean * np.log(1.0 - share / 100.0)
        assert found[f"slip_force_q{share:02d}_N"].values[0] == pytest.approx(expected, rel=0.02)


def test_quantities_in_chunks_and_for_other_tests(problem, monkeypatch):
    z = problem.prior.draw(np.random.default_rng(0), 50)
    whole = quantities(problem, z)
    monkeypatch.setattr("bayes_iwan.inference.setup.quantities.CHUNK", 7)
    pieces = quantities(problem, z, loops=problem.loops[:1])
    assert set(pieces) < set(whole)
    for name, x in pieces.items():
        np.testing.assert_allclose(x.values, whole[name].values, rtol=1e-12, err_msg=name)


def test_families_without_a_sampled_mean_report_it(known):
    for slip in ("gaussian", "power_law", "uniform", "gamma1"):
        p = make_problem(known.loops(tests=((10.0, 1.0),)), {"model": {"slip": slip, "normal_force": "polynomial2"}})
        z = p.prior.draw(np.random.default_rng(1), 20)
        got = quantities(p, z)["mean_slip_force_N"]
        np.testing.assert_allclose(got.values, p.model.slip_family.mean(p.parameter_values(z)))
        assert got.unit == "N"
