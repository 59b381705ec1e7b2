"""The averaged loop against its definition, and its standard errors against repetition."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from bayes_iwan.campaign import CampaignError, average
from bayes_iwan.campaign.loops import noise as noise_of


def design(cycles, n):
    h = 2 * np.pi * np.outer(cycles, np.arange(1, n + 1))
    return np.hstack([np.ones((cycles.size, 1)), np.cos(h), -np.sin(h)])


@pytest.mark.parametrize("frequency", [10.0, 15.0, 20.0])
def test_harmonics_are_recovered_whatever_the_samples_a_cycle(record, frequency, force_harmonics):
    loop = average(record(frequency_hz=frequency, n_cycles=20.3))
    # the displacement is sin = cos(. - pi/2), so phase 0 of the loop is phase 0 of the force's series
    np.testing.assert_allclose(loop.harmonics_N[:6], force_harmonics, atol=1e-7)
    np.testing.assert_allclose(loop.harmonics_N[6:], 0, atol=1e-7)
    expected = sum((c * np.exp(2j * np.pi * h * loop.phase)).real for h, c in enumerate(force_harmonics))
    np.testing.assert_allclose(loop.force_N, expected, atol=1e-6)
    np.testing.assert_allclose(loop.displacement_mm, np.sin(2 * np.pi * loop.phase), atol=1e-7)


def test_shapes_and_padding(record):
    loop = average(record(frequency_hz=20, n_cycles=20.3, noise_N=0.01), n_phase=96, n_harmonics=40, n_blocks=5)
    assert loop.harmonics_N.shape == loop.noise_N.shape == (41,)
    assert loop.block_harmonics_N.shape == loop.block_noise_N.shape == (5, 41)
    assert loop.force_scatter_N.shape == loop.velocity_m_s.shape == (96,)
    resolved, trusted = int(0.45 * 64), int(0.13 * 64)
    assert np.isfinite(loop.noise_N[: trusted + 1]).all() and np.isinf(loop.noise_N[trusted + 1 :]).all()
    assert np.isfinite(loop.block_noise_N[:, : resolved + 1]).all()
    assert np.isinf(loop.block_noise_N[:, resolved + 1 :]).all()
    assert (loop.harmonics_N[resolved + 1 :] == 0).all() and (loop.block_harmonics_N[:, resolved + 1 :] == 0).all()
    assert loop.harmonics_N[0].imag == 0
    assert (np.diff(loop.block_cycle) > 0).all() and loop.block_cycle @ [4, 4, 4, 4, 3] == pytest.approx(19 * 9.5)


@pytest.mark.parametrize("sizes", [{"n_phase": 4}, {"n_harmonics": 0}, {"n_blocks": 0}])
def test_sizes_that_make_no_sense(record, sizes):
    with pytest.raises(CampaignError, match="must be at least"):
        average(record(), **sizes)


def test_against_plain_least_squares(record):
    r = record(frequency_hz=15.0, n_cycles=9.4, noise_N=0.3)
    loop = average(r, n_harmonics=12, n_blocks=2)
    x = design(loop.averager.phase - loop.averager.shift, 12)
    index = loop.averager.index
    found = np.linalg.lstsq(x, r.force_N[index], rcond=None)[0]
    np.testing.assert_allclose(loop.harmonics_N[1:].real, found[1:13], atol=1e-8)
    np.testing.assert_allclose(loop.harmonics_N[1:].imag, found[13:], atol=1e-8)
    for block, a, b in zip(loop.block_harmonics_N, loop.averager.starts[:-1], loop.averager.starts[1:]):
        found = np.linalg.lstsq(x[a:b], r.force_N[index[a:b]], rcond=None)[0]
        np.testing.assert_allclose(block[1:].real, found[1:13], atol=1e-8)
        np.testing.assert_allclose(block[0].real, found[0], atol=1e-8)


def fold(loop, signal):
    """Harmonics of any signal on the record's samples, averaged as the force was."""
    return loop.averager.solve([signal])[0, :-1]


def test_any_signal_is_averaged_as_the_force_was(record):
    r = record(frequency_hz=15.0, n_cycles=20.3, noise_N=0.1)
    loop = average(r)
    np.testing.assert_allclose(loop.averager.solve([r.force_N])[0, :-1], loop.block_harmonics_N, atol=1e-12)
    hum = np.cos(2 * np.pi * 50 * r.time_s)
    drift = r.time_s / r.time_s[-1]
    both = loop.block_harmonics_N + 2 * fold(loop, hum) - 3 * fold(loop, drift)
    np.testing.assert_allclose(fold(loop, r.force_N + 2 * hum - 3 * drift), both, atol=1e-9)
    polluted = average(replace(r, force_N=r.force_N + 0.02 * hum))
    np.testing.assert_allclose(polluted.block_harmonics_N, loop.block_harmonics_N + 0.02 * fold(loop, hum), atol=1e-9)
    # 50 Hz is the fifth harmonic of 10 Hz, and there the fold must show it whole
    tenth = average(record(n_cycles=20.3, start=0.0))
    folded = fold(tenth, np.cos(2 * np.pi * 50 * tenth.record.time_s))
    np.testing.assert_allclose(np.abs(folded[:, 5]), 1, atol=1e-6)


def coloured(rng, n, memory):
    e = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.normal(size=n + 400))
    return e[400:]


@pytest.mark.parametrize("memory", [0.0, 0.9])
@pytest.mark.parametrize(("n_cycles", "frequency"), [(39.3, 20.0), (9.3, 15.0), (4.3, 15.0), (3.1, 15.0)])
def test_standard_errors_match_repetition(record, memory, n_cycles, frequency):
    rng = np.random.default_rng(int(10 * n_cycles) + int(10 * memory))
    clean = record(frequency_hz=frequency, n_cycles=n_cycles, start=0.2)
    n = clean.time_s.size
    loops = [
        average(
            replace(
                clean,
                force_N=clean.force_N + 0.05 * coloured(rng, n, memory),
                displacement_mm=clean.displacement_mm + 5e-4 * rng.normal(size=n),
            ),
            n_phase=64, n_harmonics=16, n_blocks=2,
        )
        for _ in range(120)
    ]  # fmt: skip
    for found, stated in (
        (np.array([p.harmonics_N for p in loops]), np.array([p.noise_N for p in loops])),
        (
            np.array([p.block_harmonics_N[-1] for p in loops]),
            np.array([p.block_noise_N[-1] for p in loops]),
        ),
    ):
        used = np.isfinite(stated[0])
        found, stated = found[:, used], stated[:, used]
        true = np.sqrt((found.real.var(axis=0) + found.imag.var(axis=0)) / 2)[1:]
        true_mean = found[:, 0].real.std()
        ratio = stated[:, 1:].mean(axis=0) / true
        assert 0.85 < ratio.mean() < 1.15
        assert 0.75 < ratio.min() and ratio.max() < 1.35  # 120 repetitions alone scatter by 4.6 % (one sigma)
        assert 0.75 < stated[:, 0].mean() / true_mean < 1.3
        z = ((found - found.mean(axis=0))[:, 1:] / stated[:, 1:]).ravel()
        within = np.mean(np.abs(np.concatenate([z.real, z.imag])) < 1)
        assert within == pytest.approx(0.683, abs=0.06)


@pytest.mark.parametrize("n_cycles", [39.3, 9.3])
def test_slow_change_of_the_loop_is_not_taken_for_noise(record, n_cycles):
    r = record(n_cycles=n_cycles, noise_N=0.02)
    steady = average(r).noise_N[1:6]
    fading = average(replace(r, force_N=r.force_N * (1 - 0.08 * r.time_s / r.time_s[-1]))).noise_N[1:6]
    np.testing.assert_allclose(fading, steady, rtol=0.5)  # its sidebands alone would be 20 times the noise (9: 10)


@pytest.mark.parametrize("n_cycles", [39.3, 9.3])
def test_a_drift_of_the_mean_is_not_taken_for_noise_and_what_wanders_is(record, n_cycles):
    r = record(n_cycles=n_cycles, noise_N=0.02)
    along = r.time_s / r.time_s[-1]
    steady, drifting, wandering = (
        average(replace(r, force_N=r.force_N + x)).noise_N[0]
        for x in (0.0, 0.5 * along, 0.5 * np.sin(4.0 * np.pi * along))
    )
    assert 0.7 * steady < drifting < 2.5 * steady and wandering > 20.0 * steady


def test_a_stray_line_is_not_taken_for_noise(record):
    r = record(frequency_hz=11.0, n_cycles=39.3, noise_N=0.02)
    steady = average(r).noise_N[1:8]
    line = np.cos(2 * np.pi * 11 * (4 + 17 / 38) * r.time_s)  # whole periods in the 38 cycles kept: no leakage
    hum = average(replace(r, force_N=r.force_N + 0.1 * line)).noise_N[1:8]
    np.testing.assert_allclose(hum, steady, rtol=0.8)  # a mean of powers would be 30 times as large at h = 4


def test_scatter_over_cycles(record):
    rng = np.random.default_rng(6)
    for frequency in (15.0, 20.0):
        r = record(frequency_hz=frequency, n_cycles=60.3)
        cycles = frequency * r.time_s + 0.37
        spread = 0.02 * (1.5 + np.sin(2 * np.pi * cycles))
        loop = average(replace(r, force_N=r.force_N + spread * rng.normal(size=r.time_s.size)))
        expected = 0.02 * (1.5 + np.sin(2 * np.pi * loop.phase))
        ratio = loop.force_scatter_N / expected
        assert ratio.mean() == pytest.approx(1, abs=0.03) and ratio.min() > 0.6 and ratio.max() < 1.4


def test_structure_finer_than_the_harmonics_is_not_scatter(record):
    r = record(n_cycles=60.3, start=0.0, rate_hz=1277.0)
    square = np.sign(np.sin(2 * np.pi * 10 * r.time_s + 0.5)) + 1e-3 * np.random.default_rng(8).normal(size=7700)
    loop = average(replace(r, force_N=square), n_harmonics=5)
    # five harmonics miss a square wave by 0.25 RMS, but between its steps it repeats exactly
    assert np.median(loop.force_scatter_N) < 0.05


def test_scatter_sees_whole_cycles_move(record):
    rng = np.random.default_rng(7)
    r = record(n_cycles=60.3, start=0.0)
    level = 0.05 * rng.normal(size=62)[np.floor(10 * r.time_s).astype(int)]
    loop = average(replace(r, force_N=r.force_N + level))
    used = 0.05 * np.std(rng.permutation(level[loop.cut.index]) / 0.05)
    assert np.median(loop.force_scatter_N) == pytest.approx(used, rel=0.05)


def test_harmonics_beyond_the_trusted_band_are_no_data(record):
    """Above 0.13 of the sampling rate an anti-alias filter turns harmonics; the first five are data all the same."""
    for frequency in (4.0, 10.0, 40.0):
        loop = average(record(frequency_hz=frequency, rate_hz=1280.0, n_cycles=20.3, noise_N=0.01))
        resolved = np.arange(51) <= 0.45 * 1280.0 / frequency
        trusted = np.arange(51) <= max(5, 0.13 * 1280.0 / frequency)
        np.testing.assert_array_equal(np.isfinite(loop.noise_N), resolved & trusted)


def test_a_long_record_s_noise_is_found_from_a_length_that_transforms_well(record, monkeypatch):
    r = record(n_cycles=211.3, noise_N=0.05)
    whole = average(r).noise_N
    n = noise_of._transformed(211 * 64 + 1)
    assert n == 211 * 64 + 1  # a short record keeps its length
    monkeypatch.setattr(noise_of, "LONG_RECORD", 1000)
    assert 13_000 < noise_of._transformed(211 * 64 + 1) < 211 * 64 + 1
    shortened, resolved = average(r).noise_N, np.isfinite(whole)
    np.testing.assert_allclose(shortened[resolved][1:], whole[resolved][1:], rtol=0.1)
    assert shortened[0] == pytest.approx(whole[0], rel=0.3)  # five bins alone tell the mean's


@pytest.mark.parametrize("orders", [(1, 9), (2, 3, 11), range(1, 9), range(1, 20, 2)])
def test_a_multisine_keeps_all_its_harmonics_and_has_no_corners(record, orders):
    r = record(n_cycles=10.3, noise_N=0.01)
    rng = np.random.default_rng(3)
    size, turn = rng.uniform(0.5, 1.0, 20), rng.uniform(size=20)

    def motion(cycles):
        return sum(size[h] * np.sin(2 * np.pi * (h * cycles + turn[h])) for h in orders)

    loop = average(replace(r, displacement_mm=motion(10 * r.time_s) + 1e-3 * rng.normal(size=r.time_s.size)))
    shift = np.angle(fold(loop, np.exp(2j * np.pi * 10 * r.time_s).real)[0, 1]) / (2 * np.pi)
    np.testing.assert_allclose(loop.displacement_mm, motion(loop.phase + shift), atol=0.01)
    assert not loop.corners


@pytest.mark.parametrize("rate_hz", [18.0, 21.0, 60.0, 79.0])  # of 10 Hz; below 2.2 a cycle no harmonic is resolved
def test_too_few_samples_a_cycle_are_one_clear_line(record, rate_hz):
    with pytest.raises(
        CampaignError, match=r"test\.csv: \d\.\d samples a cycle; at least 8 are needed .* Sample faster"
    ):
        average(record(rate_hz=rate_hz, n_cycles=30))
