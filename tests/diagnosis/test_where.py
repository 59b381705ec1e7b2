"""The gap's size and place, on records made by the model itself plus one force of known law: the answers are known."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import special

from bayes_iwan.campaign import Record, average
from bayes_iwan.diagnosis.answer.gap_findings import where_json, where_sentences
from bayes_iwan.diagnosis.answer.localisation import sticking_share, where
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.fits.evidence import fit_model
from bayes_iwan.diagnosis.fits.gap_size import gap_size, shrink
from bayes_iwan.diagnosis.fits.residuals import residual_of
from bayes_iwan.diagnosis.search.base_fit import fit_base
from bayes_iwan.effects.specimen_forces import ViscousDamping
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings, ModelSettings
from bayes_iwan.models import Model, Reference, sine_motion

SETTINGS = DiagnoseSettings(ModelSettings(slip="gamma1", normal_force="constant", stiffness="constant"))
TRUTH = {"kp_N_mm": 5.5, "force_zero_N": 0.0, "k1_N_mm": 14.0, "t1_N": 0.6, "eta1": 2.0, "g1": 1.0}
TESTS = [(f, a) for f in (5.0, 30.0) for a in (0.3, 0.6, 1.0)]
SAMPLES, CYCLES = 192, 18


def made_loops(added=None, seed=0, tests=TESTS, noise=0.01):
    """Averaged loops of a classical Iwan specimen; added(u mm, v m/s, a m/s², cycle number) is one force more, N."""
    rng = np.random.default_rng(seed)
    model = Model(Reference(1.0, 0.1), slip="gamma1", normal_force="constant", stiffness="constant")
    parameter_values = {k: np.array([v]) for k, v in TRUTH.items()}
    out = []
    for f, a in tests:
        motion = sine_motion(frequency_hz=f, amplitude_mm=a, samples=SAMPLES)
        force = np.tile(model.force(parameter_values, motion)[0, 0], CYCLES)
        u, v, acceleration = (
            np.tile(x[0, 0], CYCLES) for x in (motion.displacement_mm, motion.velocity_m_s, motion.acceleration_m_s2)
        )
        time = np.arange(force.size) / (SAMPLES * f)
        if added is not None:
            force = force + added(u, v, acceleration, f * time)
        force = force + np.sqrt(SAMPLES / 64) * noise * rng.standard_normal(force.size)
        out.append(average(Record(f"f{f:g}_a{a:g}.csv", f, a, "fit", {}, time, u, force), n_phase=64, n_harmonics=20))
    return out


def fitted(loops):
    data = gap_data(loops)
    return data, fit_base(data, SETTINGS, scales_of(loops), np.random.default_rng(0))


@pytest.fixture(scope="module")
def plain():
    return fitted(made_loops())


@pytest.fixture(scope="module")
def viscous():
    return fitted(made_loops(lambda u, v, a, n: 1.5 * v))


def looked(added, **kwargs):
    loops = made_loops(added, **kwargs)
    data, fit = fitted(loops)
    residual = residual_of(data, fit)
    return where(residual, simulations=400), gap_size(residual)


def test_a_perfect_model_reads_zero_within_its_interval(plain):
    zero, zero_unseen, unbiased = 0, 0, []
    for seed in range(12):
        loops = made_loops(seed=100 + seed)
        data = gap_data(loops)
        problem = fit_base_like(plain[1], data)
        fit = fit_model(data, problem, plain[1].z[None], iterations=15)
        size = gap_size(residual_of(data, fit), seed=seed, draws=200)
        zero += size.all.low_N == 0.0
        assert size.all.high_N < size.all.noise_N
        unbiased.append((size.all.residual_N**2 - size.all.noise_N**2) / size.all.noise_N**2)
        held_out = gap_data(made_loops(seed=500 + seed, tests=[(15.0, 0.45), (50.0, 1.0)]))
        zero_unseen += gap_size(residual_of(held_out, fit, refitted=False), seed=seed, draws=200).all.low_N == 0.0
    assert zero >= 10  # 95 % each; below 10 of 12 once in 50 such tests
    assert zero_unseen >= 9  # fewer numbers: the noise's own standard error is uncertain too
    assert abs(np.mean(unbiased)) < 0.1


def fit_base_like(fit, data):
    from bayes_iwan.diagnosis.fits.evidence import base_problem

    return base_problem(data, SETTINGS, fit.problem.scales)


def test_a_known_gap_is_found_with_an_interval_that_covers_it(plain):
    # a second harmonic, which a symmetric model cannot imitate
    size_N, covered, inside = 0.05, 0, []
    for seed in range(8):
        loops = made_loops(lambda u, v, a, n: size_N * np.cos(4.0 * np.pi * n), seed=200 + seed)
        data = gap_data(loops)
        fit = fit_model(data, fit_base_like(plain[1], data), plain[1].z[None], iterations=15)
        found = gap_size(residual_of(data, fit), seed=seed, draws=200)
        covered += found.all.low_N <= size_N / np.sqrt(2.0) <= found.all.high_N
        inside += [g.rms_N for g in found.tests]
    assert covered >= 6  # 90 % each; below 6 of 8 once in 200 such tests
    np.testing.assert_allclose(inside, size_N / np.sqrt(2.0), rtol=0.1)


def test_viscous_force_shows_in_the_velocity_and_grows_with_frequency_and_amplitude(viscous):
    residual = residual_of(*viscous)
    found, size = where(residual, simulations=400), gap_size(residual)
    law = found.laws[0]
    assert (law.order, law.part) == (1, "quadrature")
    assert law.force_N > 0.0
    assert law.frequency_power[1] <= 1.0 <= law.frequency_power[2]
    assert law.amplitude_power[1] <= 1.0 <= law.amplitude_power[2]
    assert law.frequency_power[2] - law.frequency_power[1] < 0.5
    # the largest: ωA at 30 Hz and 1 mm
    assert law.force_N == pytest.approx(1.5 * 2e-3 * np.pi * 30.0, rel=0.15)
    by_part = {kind: np.array([x.gap_N for x in found.of(kind)]) for kind in ("in phase", "quadrature")}
    assert by_part["quadrature"][0] > 3.0 * by_part["in phase"][0]
    assert found.of("frequency")[1].gap_N > found.of("frequency")[0].gap_N
    text = " ".join(where_sentences(found))
    assert "more dissipative" in text and "in proportion to frequency" in text
    assert size.all.low_N > 0.0


def test_cubic_stiffness_shows_a_third_harmonic_in_phase_whatever_the_frequency():
    found, _ = looked(lambda u, v, a, n: 0.5 * u**3)
    law = next(x for x in found.laws if x.order == 3)
    assert law.part == "in phase"
    assert law.force_N == pytest.approx(0.5 / 4.0, rel=0.2)  # cos³ = ¾ cos θ + ¼ cos 3θ
    assert law.amplitude_power[1] <= 3.0 <= law.amplitude_power[2]
    assert abs(law.frequency_power[0]) < 0.2
    third = {kind: found.of(kind)[2] for kind in ("in phase", "quadrature")}
    assert third["in phase"].significant and third["quadrature"].gap_N < 0.1 * third["in phase"].gap_N


def test_mass_pulls_in_phase_with_frequency_squared():
    # three frequencies: with two the parallel spring leaves every power possible
    found, _ = looked(lambda u, v, a, n: 0.01 * a, tests=[(f, x) for f in (5.0, 15.0, 30.0) for x in (0.3, 1.0)])
    law = found.laws[0]
    assert (law.order, law.part) == (1, "in phase") and law.force_N < 0.0
    assert law.frequency_power[0] == pytest.approx(2.0, abs=0.25)
    assert law.amplitude_power[0] == pytest.approx(1.0, abs=0.2)


def test_asymmetric_stiffness_shows_in_even_harmonics_near_the_ends_and_middle_alike():
    found, _ = looked(lambda u, v, a, n: 0.4 * u**2)
    odd, even = found.of("parity")
    assert even.significant and even.share > 0.9 and odd.share < 0.1
    assert found.of("in phase")[1].significant and not found.of("quadrature")[1].significant
    assert found.of("mean")[0].significant


def test_a_kink_after_one_reversal_is_found_there():
    # 0.1 N more just after the upper reversal: falling and still above 80 % of the stroke
    found, _ = looked(lambda u, v, a, n: 0.1 * ((v < 0.0) & (u > 0.6 * np.abs(u).max())))
    by_name = {x.name: x for x in found.of("region")}
    there, opposite = by_name["just after the upper reversal"], by_name["just after the lower reversal"]
    assert there.significant and there.gap_N > 1.5 * opposite.gap_N
    assert there.share > 1.5 * there.time


def test_fading_friction_shows_along_the_record():
    found, size = looked(lambda u, v, a, n: 0.15 * np.exp(-n / 5.0) * np.sign(v))
    assert all(x.significant for x in found.of("trend"))
    assert next(x for x in found.of("record") if x.name == "quadrature").significant
    assert not next(x for x in found.of("record") if x.name == "mean").significant
    assert np.all(found.change_N[:, 2] < -0.05)  # less dissipation at the end
    assert size.along.low_N > 0.9 * size.loop.rms_N > 0.0
    trends = found.of("trend")  # a gap of its own in each test: all of them together are their mean square
    assert np.sqrt(np.mean([x.gap_N**2 for x in trends])) == pytest.approx(size.along.rms_N, rel=0.05)
    assert sum(x.share for x in trends) == pytest.approx(1.0, abs=0.01)
    assert all(rms[0] > rms[2] for rms in size.along_N)
    assert "change along the record" in " ".join(where_sentences(found))


def test_a_drifting_force_changes_the_mean_alone_from_the_first_block_to_the_last():
    found, size = looked(lambda u, v, a, n: 0.01 * n)
    drift = [0.01 * (cycle[-1] - cycle[0]) for cycle in size.cycle]
    np.testing.assert_allclose(found.change_N, np.transpose([drift, np.zeros(6), np.zeros(6)]), atol=0.01)
    assert min(drift) > 0.1 and next(x for x in found.of("record") if x.name == "mean").significant
    assert not next(x for x in found.of("record") if x.name == "quadrature").significant


def test_nothing_stands_out_without_a_cause(plain):
    quiet = 0
    for seed in range(4):
        loops = made_loops(seed=300 + seed)
        data = gap_data(loops)
        fit = fit_model(data, fit_base_like(plain[1], data), plain[1].z[None], iterations=15)
        found = where(residual_of(data, fit), seed=seed, simulations=300)
        stands_out = [x for x in found.statistics if x.significant]
        quiet += not stands_out and not found.laws
        assert len(stands_out) <= 2
    assert quiet >= 3
    assert found.count > 60 and "Nothing stands out" in where_sentences(found)[0]


def test_small_misfits_of_the_typical_size_are_false_alarms_in_one_of_twenty_at_most(plain):
    """Data drawn as the statistics suppose: the largest of all must exceed its bound in about 5 % of them."""
    from dataclasses import replace

    from bayes_iwan.diagnosis.answer.localisation import simulated
    from bayes_iwan.diagnosis.assessment.calibration import calibration

    residual = residual_of(*plain)
    draws = simulated(residual, 20, np.random.default_rng(9), calibration().usual[0])
    alarms = 0
    for seed, value in enumerate(draws):
        found = where(replace(residual, value=value), seed=seed, simulations=150)
        alarms += any(x.significant for x in found.statistics) or bool(found.laws)
    assert alarms <= 4  # 5 % each: more than 4 of 20 once in 400


def test_a_named_cause_shrinks_the_gap_and_another_set_of_tests_is_refused(viscous):
    data, base = viscous
    effect = ViscousDamping(base.problem.scales)
    problem = base.problem.with_effects((effect,))
    start = np.zeros((1, problem.ndim))
    start[0, [problem.names.index(n) for n in base.problem.names]] = base.z
    fit = fit_model(data, problem, start)
    before, after = gap_size(residual_of(data, base)), gap_size(residual_of(data, fit))
    found = shrink(before, after)
    assert found.value > 0.9 and found.low > 0.7 and found.high <= 1.0
    further = gap_data(made_loops(lambda u, v, a, n: 1.5 * v, seed=7, tests=[(50.0, 1.0)]))
    held_out = shrink(
        gap_size(residual_of(further, base, refitted=False)), gap_size(residual_of(further, fit, refitted=False))
    )
    assert held_out.value > 0.9
    with pytest.raises(ValueError, match="different tests"):
        shrink(before, gap_size(residual_of(further, fit, refitted=False)))


def test_one_frequency_tells_no_power_of_frequency():
    found, _ = looked(lambda u, v, a, n: 0.5 * u**3, tests=[(10.0, a) for a in (0.3, 0.6, 1.0)])
    assert found.laws and all(x.frequency_power is None for x in found.laws)
    assert not any("frequency (power" in s or "frequency to the power" in s for s in where_sentences(found))


def test_tests_whose_frequencies_a_drive_did_not_hold_are_of_one():
    """Else single tests are compared, and what grows with amplitude is said to be at one frequency."""
    uneven = [(f * (1.0 + 0.01 * i), a) for f in (5.0, 30.0) for i, a in enumerate((0.3, 0.6, 1.0))]
    found, _ = looked(lambda u, v, a, n: 0.5 * u**3, tests=uneven)
    assert [x.name for x in found.of("frequency")] == ["5.05 Hz", "30.3 Hz"]
    assert [x.time for x in found.of("frequency")] == pytest.approx([0.5, 0.5])
    assert [x.name for x in found.of("amplitude")] == ["0.3 mm", "0.6 mm", "1 mm"]
    assert sum(x.share for x in found.of("frequency")) == pytest.approx(1.0, abs=0.02)
    assert any(s.startswith("The gap does not depend on frequency") for s in where_sentences(found))


def test_two_frequencies_leave_the_power_of_an_elastic_force_open():
    found, _ = looked(lambda u, v, a, n: 0.01 * a)
    law = found.laws[0]
    assert (law.order, law.part) == (1, "in phase")
    assert law.frequency_power is None  # the parallel spring takes up the difference
    assert law.amplitude_power[1] <= 1.0 <= law.amplitude_power[2]
    assert "stiffer" not in " ".join(where_sentences(found)) and "softer" not in " ".join(where_sentences(found))


def test_json_is_plain(viscous):
    residual = residual_of(*viscous)
    found, size = where(residual, simulations=100), gap_size(residual)
    told = json.loads(json.dumps(where_json(found, size)))
    assert [t["file"] for t in told["tests"]] == list(found.files)
    assert {"region", "gap_rms_N", "share_of_gap", "significant"} <= set(told["regions"][0])
    assert {"order", "in_phase_N", "quadrature_N", "significant"} <= set(told["harmonics"][0])
    branches = {r["region"]: r["share_of_gap"] for r in told["regions"]}
    assert branches["rising displacement"] + branches["falling displacement"] == pytest.approx(1.0, abs=0.02)
    assert branches["microslip"] + branches["gross slip"] == pytest.approx(1.0, abs=0.02)
    assert found.phase_N.shape == found.expected_N.shape == (len(TESTS), 64)
    assert where(residual, simulations=100).statistics == found.statistics  # the same seed, the same answer


def test_the_share_that_sticks_is_that_of_the_slip_forces_not_yet_reached(plain):
    """Masing: Δ after a reversal the elements slip whose slip force is below kΔ/2, so Q(η, kΔ/2t) of them stick."""
    data, fit = plain
    values = {name: float(x[0]) for name, x in fit.problem.parameter_values(fit.z[None]).items()}
    motion = data.steady_motion
    u, amplitude = motion.displacement_mm[0], motion.amplitude_mm[:, None]
    rising = np.roll(u, -1, axis=1) > np.roll(u, 1, axis=1)
    stroke = np.where(rising, u + amplitude, amplitude - u)
    expected = special.gammaincc(values["eta1"], 0.5 * values["k1_N_mm"] * stroke / values["t1_N"])
    found = sticking_share(residual_of(data, fit))
    inside = (stroke > 0.1 * amplitude) & (stroke < 1.9 * amplitude)
    assert np.ptp(expected[inside]) > 0.5
    np.testing.assert_allclose(found[inside], expected[inside], atol=0.02)
    assert np.all(found[stroke < 1e-3 * amplitude] == 1.0)
