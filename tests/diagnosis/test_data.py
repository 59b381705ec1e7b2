"""What a diagnosis uses, against records whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign.loops.averaging import TRUSTED_BAND
from bayes_iwan.diagnosis.fits.data import MAINS_HZ, TREND_HARMONICS, gap_data, predicted
from bayes_iwan.diagnosis.fits.discrepancy_size import BETWEEN, DiscrepancySize
from bayes_iwan.diagnosis.fits.evidence import base_problem
from bayes_iwan.diagnosis.fits.residual_rows import Rows
from bayes_iwan.effects.along_record import ForceDrift, ForceDriftByTest, MainsInterference
from bayes_iwan.inference.setup.loop_scales import scales_of

TESTS = [(8.0, 0.4), (8.0, 0.9), (20.0, 0.4), (20.0, 0.9)]


@pytest.fixture(scope="module")
def data_of(kit):
    def make(**options):
        return gap_data(kit.made_up(kit.specimen_force, TESTS, **options).loops(**kit.small))

    return make


@pytest.fixture(scope="module")
def noisy(data_of):
    return data_of(noise_N=0.02, cycles=40)


def finite(x):
    return np.all(np.isfinite(x))


def test_contrasts_are_orthonormal_and_blind_to_what_is_steady(noisy):
    for c in noisy.contrast:
        np.testing.assert_allclose(c @ c.T, np.eye(len(c)), atol=1e-12)
        np.testing.assert_allclose(c.sum(axis=1), 0.0, atol=1e-12)


def test_steady_records_have_no_trend(data_of):
    clean = data_of()
    there = np.isfinite(clean.trend_noise_N)
    assert np.abs(clean.trend_N[there]).max() < 0.1 * clean.trend_noise_N[there].min()


def test_first_contrast_sees_a_linear_trend(data_of):
    rising = data_of(extra=lambda time, test: 0.1 * time)
    assert np.all(np.abs(rising.trend_N[:, 0, 0]) > 50 * np.abs(rising.trend_N[:, 1:, 0]).max())


def test_trends_of_white_noise_scatter_as_their_standard_errors_say(data_of):
    whitened = []
    for seed in range(2):
        data = data_of(noise_N=0.3, cycles=40, seed=seed)
        ratio = (data.trend_N / data.trend_noise_N)[np.isfinite(data.trend_noise_N)]
        whitened += [*ratio.real, *ratio.imag[np.abs(ratio.imag) > 0]]
    # the standard errors are estimates themselves, from few blocks: a t distribution's spread
    assert 0.8 < np.sqrt(np.mean(np.square(whitened))) < 1.5
    assert abs(np.mean(whitened)) < 0.15


def test_nothing_is_nan(noisy, data_of):
    for data in (noisy, data_of(cycles=5)):
        for x in (data.harmonics_N, data.trend_N, data.contrast, data.mains_N, data.level_N):
            assert finite(x)
        for sd in (data.trend_noise_N, data.mains_noise_N):
            assert not np.isnan(sd).any() and np.all(sd > 0)
        assert data.trend_N.shape[2] == TREND_HARMONICS + 1


def test_harmonics_beyond_the_trusted_band_do_not_count(kit):
    loops = kit.made_up(kit.specimen_force, TESTS, noise_N=0.02).loops(**kit.small)
    for loop in gap_data(loops).loops:
        order = np.arange(len(loop.noise_N))
        beyond = (order * loop.frequency_hz > TRUSTED_BAND * 1280.0) & (order > 5)
        assert np.all(np.isinf(loop.noise_N[beyond])) and beyond.any() == (loop.frequency_hz > 15)
        assert np.all(np.isfinite(loop.noise_N[~beyond]))


def hum(hz, amplitude, phase):
    return lambda time, test: amplitude * np.cos(2.0 * np.pi * hz * time - phase - test)


@pytest.mark.parametrize("hz", [49.83, 50.0, 50.07, 59.9])
def test_mains_frequency_and_line_are_found(hz, data_of):
    data = data_of(noise_N=0.02, cycles=40, extra=hum(hz, 0.05, 0.4))
    which = int(hz > 55)
    np.testing.assert_allclose(data.mains_hz[:, which], hz, atol=0.02)
    np.testing.assert_array_equal(data.mains_hz[:, 1 - which], MAINS_HZ[1 - which])
    for t in range(len(TESTS)):
        error = data.mains_N[t, which] - 0.05 * np.exp(1j * (0.4 + t))  # c + i s of c·cos + s·sin
        assert abs(error) < max(4.5 * data.mains_noise_N[t, which], 0.005)
        assert abs(data.mains_N[t, 1 - which]) < 6.0 * data.mains_noise_N[t, 1 - which]


def test_a_line_at_half_the_frequency_counts_by_its_power_over_the_noise(data_of):
    """A cosine of amplitude A in white noise of sd s over N samples: A² N / (4 s²)."""
    size_N, sd_N, cycles = 0.02, 0.05, 40
    data = data_of(noise_N=sd_N, cycles=cycles, extra=lambda time, test: size_N * np.cos(np.pi * TESTS[test][0] * time))
    samples = np.array([cycles * 1280.0 / f for f, _ in TESTS])
    ratio = data.subharmonic / (size_N**2 * samples / (4.0 * sd_N**2))
    assert 0.5 < np.exp(np.mean(np.log(ratio))) < 2.0 and np.all((ratio > 0.2) & (ratio < 5.0))
    assert np.all(data_of(noise_N=sd_N, cycles=cycles).subharmonic < 6.0)


def test_what_differs_from_cycle_to_cycle_counts_by_its_rms_and_white_noise_and_trends_do_not(data_of):
    """Amplitudes of a cosine that are drawn anew for each cycle, sd s: RMS s/√2 of each test."""
    size_N, cycles = 0.2, 40
    drawn = np.random.default_rng(1).normal(0.0, size_N, (len(TESTS), cycles + 1))

    def debris(time, test):
        turn = TESTS[test][0] * time
        return drawn[test][np.clip(turn.astype(int), 0, cycles)] * np.cos(2.0 * np.pi * turn)

    data = data_of(noise_N=0.05, cycles=cycles, extra=debris)
    expected = size_N / np.sqrt(2.0) * np.sqrt(np.mean(data.level_N**-2.0))
    assert data.not_repeating == pytest.approx(expected, rel=0.25)
    white = data_of(noise_N=0.05, cycles=cycles)
    assert white.not_repeating < 0.1 * data.not_repeating
    trend = data_of(
        cycles=cycles, extra=lambda time, test: 0.5 * time / time[-1] * np.cos(2.0 * np.pi * TESTS[test][0] * time)
    )
    assert trend.not_repeating < 0.02 * data.not_repeating
    assert data.part([0]).not_repeating == pytest.approx(expected, rel=0.5)
    few = data_of(cycles=8, extra=debris)
    assert few.not_repeating == 0.0  # too short to tell it from a trend


def test_mains_that_wander_from_record_to_record_are_followed(data_of):
    def wandering(time, test):
        return 0.05 * np.cos(2.0 * np.pi * (49.9 + 0.07 * test) * time)

    data = data_of(noise_N=0.02, cycles=40, extra=wandering)
    np.testing.assert_allclose(data.mains_hz[:, 0], 49.9 + 0.07 * np.arange(len(TESTS)), atol=0.01)
    np.testing.assert_allclose(np.abs(data.mains_N[:, 0]), 0.05, rtol=0.06)


def test_no_hum_leaves_the_nominal_frequencies(noisy):
    assert (noisy.mains_hz == MAINS_HZ).all()
    assert np.all(np.abs(noisy.mains_N) < 6.0 * noisy.mains_noise_N)


def test_line_at_a_harmonic_says_nothing(kit):
    made = kit.made_up(kit.specimen_force, [(10.0, 0.4), (8.0, 0.9), (10.02, 0.4)], noise_N=0.02, cycles=40)
    data = gap_data(made.loops(**kit.small))
    assert data.mains_possible == (False, False)  # the test at 8 Hz would show it
    hidden = gap_data(kit.made_up(kit.specimen_force, [(10.0, 0.4), (10.0, 0.9)]).loops(**kit.small))
    assert hidden.mains_possible == (True, True)
    assert np.isinf(data.mains_noise_N[0]).all() and np.isfinite(data.mains_noise_N[1]).all()
    # beside a harmonic the loops' own slow change leaks into the line
    assert np.isinf(data.mains_noise_N[2]).all()


def test_of_few_cycles_mains_are_found_beside_a_harmonic_unless_the_loops_leak_as_much(kit):
    """Ten cycles: no frequency is five cycles over the record from every harmonic."""
    tests = [(1280 / 175, 0.4), (1280 / 157, 0.9)]  # 1.6 and 1.3 cycles from the seventh and the sixth harmonic

    def line_of(**options):
        data = gap_data(kit.made_up(kit.specimen_force, tests, noise_N=0.01, cycles=10, **options).loops(**kit.small))
        return np.abs(data.mains_N[:, 0]), data.mains_noise_N[:, 0]

    line_N, noise_N = line_of(extra=hum(50.0, 0.05, 0.4))
    np.testing.assert_allclose(line_N, 0.05, rtol=0.25)
    assert np.all(line_N > 4.0 * noise_N)

    def fading(time, test):
        return np.exp(-time) * np.cos(2.0 * np.pi * (7, 6)[test] * tests[test][0] * time)

    assert np.isinf(line_of(extra=fading)[1]).all()


def test_mains_beside_a_harmonic_are_found_as_a_harmonic_that_turns(kit):
    """Tests at 10 Hz, whose fifth harmonic is nearer to the mains than a record resolves."""
    mains = (49.93, 50.01, 50.08, 50.04)
    tests = [(8.0, 0.4), (8.0, 0.9), (1280 / 128, 0.4), (1280 / 128, 0.9)]

    def humming(time, test):
        return 0.05 * np.cos(2.0 * np.pi * mains[test] * time - test)

    data = gap_data(kit.made_up(kit.specimen_force, tests, noise_N=0.005, cycles=40, extra=humming).loops(**kit.small))
    assert np.isinf(data.mains_noise_N[2:]).all()  # not as a line
    np.testing.assert_allclose(data.mains_hz[:, 0], mains, atol=0.015)


def test_part_of_the_data_is_what_those_records_alone_give(noisy):
    some, few = noisy.part([1, 3]), gap_data([noisy.loops[1], noisy.loops[3]])
    for name in ("harmonics_N", "trend_N", "trend_noise_N", "contrast", "level_N", "mains_N", "mains_hz"):
        np.testing.assert_allclose(getattr(some, name), getattr(few, name), rtol=1e-9, atol=1e-12)
    assert [x.file for x in some.loops] == ["t1.csv", "t3.csv"] and some.block_motion.test.max() == 1


def test_predicted_drift_is_what_a_drift_does_to_the_data(data_of, kit):
    rate = 0.07
    still, drifting = data_of(), data_of(extra=lambda time, test: rate * (time - time[0]))
    mean, trend, _ = difference(ForceDrift(kit.scales, files(still)), {"force_drift.rate_N_s": rate}, still, kit)
    np.testing.assert_allclose(mean, drifting.harmonics_N - still.harmonics_N, atol=1e-4)
    np.testing.assert_allclose(trend, drifting.trend_N - still.trend_N, atol=1e-4)


def test_predicted_hum_is_what_a_hum_does_to_the_data(data_of, kit):
    still, humming = data_of(), data_of(extra=hum(50.1, 0.05, 0.4))
    # the estimate comes near, no more
    humming = replace(humming, mains_hz=np.tile([50.1, 60.0], (len(TESTS), 1)))
    parameter_values = {}
    for t, file in enumerate(files(humming)):
        parameter_values |= {
            f"mains_interference.{part}[{file}]": 0.05 * wave(0.4 + t)
            for part, wave in (("cosine", np.cos), ("sine", np.sin))
        }
    mean, trend, lines = difference(MainsInterference(kit.scales, files(humming)), parameter_values, humming, kit)
    # a sample at the very end of a record may count in the whole loop and not in a block: a thousandth of the hum
    np.testing.assert_allclose(mean, humming.harmonics_N - still.harmonics_N, atol=5e-5)
    np.testing.assert_allclose(trend, humming.trend_N - still.trend_N, atol=5e-5)
    assert np.abs(trend).max() > 5e-3
    np.testing.assert_allclose(lines[:, 0], 0.05 * np.exp(1j * (0.4 + np.arange(len(TESTS)))), atol=1e-9)
    np.testing.assert_array_equal(lines[:, 1], 0.0)


@pytest.mark.parametrize("b", [0.0, 2.0])
def test_predicted_drift_that_levels_off(b, data_of, kit):
    """r·T·(1 − e^(−b t/T))/b from each record's start, T the longest record."""
    still, rate = data_of(), 0.07
    longest = max(np.ptp(x.record.time_s) for x in still.loops)

    def drifting(time, test):
        t = time - time[0]
        return rate * (t if b == 0.0 else longest * -np.expm1(-b * t / longest) / b)

    drifts = data_of(extra=drifting)
    parameter_values = {"force_drift.rate_N_s": rate, "force_drift.levelling": b}
    mean, trend, _ = difference(ForceDrift(kit.scales, files(still)), parameter_values, still, kit)
    # which samples make whole cycles hangs on crossings between them
    np.testing.assert_allclose(mean, drifts.harmonics_N - still.harmonics_N, atol=1e-4)
    np.testing.assert_allclose(trend, drifts.trend_N - still.trend_N, atol=1e-4)


def test_predicted_drift_of_each_test_in_its_own_way(data_of, kit):
    still, numbers = data_of(), {"rate": (0.03, -0.05, 0.0, 0.02), "bow": (0.0, 0.02, -0.03, 0.01)}
    numbers["sway"] = (0.01, 0.0, 0.02, -0.03)

    def wandering(time, test):
        d = np.ptp(time)
        x, (r, b, s) = (time - time[0]) / d, (n[test] for n in numbers.values())
        return d * (r * x + 2.0 * b * x * (1.0 - x) + 3.0 * s * x * (1.0 - x) * (1.0 - 2.0 * x))

    drifts = data_of(extra=wandering)
    parameter_values = {
        f"force_drift.{part}_N_s[{file}]": n for part, own in numbers.items() for file, n in zip(files(still), own)
    }
    mean, trend, _ = difference(ForceDriftByTest(kit.scales, files(still)), parameter_values, still, kit)
    np.testing.assert_allclose(
        mean, drifts.harmonics_N - still.harmonics_N, atol=1e-4
    )  # blocks are not quite of a length
    np.testing.assert_allclose(trend, drifts.trend_N - still.trend_N, atol=1e-9)


def test_predicted_third_harmonic_of_a_hum_is_locked_to_it(kit):
    """A hum a·cos θ with a·h·cos(3θ + ψ) beside it, in tests whose fifteenth harmonic is at 150 Hz."""
    tests, third, psi = [(10.0, 0.4), (10.0, 0.9)], 0.3, 0.7

    def humming(time, test):
        theta = 2.0 * np.pi * 50.0 * time - 0.4 - test
        return 0.05 * (np.cos(theta) + third * np.cos(3.0 * theta + psi))

    still, hums = (
        gap_data(kit.made_up(kit.specimen_force, tests, extra=extra).loops(**kit.small)) for extra in (None, humming)
    )
    parameter_values = {
        "mains_interference.third_cosine": third * np.cos(psi),
        "mains_interference.third_sine": -third * np.sin(psi),
    }
    for t, file in enumerate(files(still)):
        parameter_values |= {
            f"mains_interference.{part}[{file}]": 0.05 * wave(0.4 + t)
            for part, wave in (("cosine", np.cos), ("sine", np.sin))
        }
    still = replace(still, mains_hz=np.tile([50.0, 60.0], (2, 1)))
    mean, _, _ = difference(MainsInterference(kit.scales, files(still)), parameter_values, still, kit)
    np.testing.assert_allclose(mean, hums.harmonics_N - still.harmonics_N, atol=5e-5)
    assert np.all(np.abs(mean[:, 15]) > 0.014)


def test_a_steady_model_pays_for_every_change_and_line_by_half_their_squares(data_of):
    """Cosine and sine of each, in units of noise; alone, lines are all that its constant holds."""
    data = data_of(noise_N=0.02, cycles=40, extra=hum(50.1, 0.05, 0.4))
    changes, lines = (
        float(np.sum(np.abs(x / noise) ** 2))
        for x, noise in ((data.trend_N, data.trend_noise_N), (data.mains_N, data.mains_noise_N))
    )
    assert changes > 50.0 and lines > 50.0
    cost = data.layout(BETWEEN[0], False).steady_cost(DiscrepancySize(0.3, 0.1, 0.0))
    assert cost == pytest.approx(0.5 * (changes + lines))
    unchanging = replace(data, trend_noise_N=np.full_like(data.trend_noise_N, np.inf))
    assert unchanging.layout(BETWEEN[0], False).constant == pytest.approx(-0.5 * lines)


def files(data):
    return tuple(x.file for x in data.loops)


def difference(effect, parameter_values, data, kit):
    """What the effect adds to harmonics, trends and lines at these numbers."""
    base = base_problem(data, kit.settings, scales_of(data.loops))
    problem = base.with_effects([effect])
    z = np.zeros((2, problem.ndim))
    for name, value in parameter_values.items():
        at = problem.names.index(name)
        z[0, at] = problem.prior.parameters[[p.name for p in problem.prior.parameters].index(name)].score(value)
    mean, trend, lines = predicted(data, problem, z)
    return mean[0] - mean[1], trend[0] - trend[1], None if lines is None else lines[0]


def test_a_clock_that_nobody_meant_changes_no_residual(kit):
    """The same rows with a clock that is slower by 100: the base, its speed term too, leaves the same."""
    rows = []
    for rate in (1280.0, 12.8):
        tests = [(f * rate / 1280.0, a) for f, a in TESTS]

        def force(f, a, samples, rate=rate):
            return kit.specimen_force(f * 1280.0 / rate, a, samples)

        data = gap_data(kit.made_up(force, tests, noise_N=0.02, cycles=20, rate=rate).loops(**kit.small))
        problem = base_problem(data, kit.settings, scales_of(data.loops))
        z = 0.3 * np.random.default_rng(0).standard_normal((3, problem.ndim))
        rows.append(Rows(data, problem).residual(z))
    np.testing.assert_allclose(*rows, rtol=1e-9, atol=1e-9 * np.abs(rows[0]).max())
