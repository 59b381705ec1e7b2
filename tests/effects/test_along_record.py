"""What runs along whole records and does not repeat with the cycle: drifts and the mains against their laws in time."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.effects.along_record import RAMPS, ForceDrift, ForceDriftByTest, MainsInterference, MainsInterference60

TESTS = ("a.csv", "b.csv")
#: two records, the first of which is the longest; four places of each, as shares of it
DURATIONS_S = np.array([12.0, 8.0])
PLACES = np.array([0.1, 0.35, 0.6, 0.95])


def records(**more):
    """Records whose blocks of cycles are single instants, so that a law in time can be read off directly."""
    time = PLACES * DURATIONS_S[:, None]  # (tests, blocks)
    ramps = np.stack([(time / DURATIONS_S.max()) ** p for p in range(RAMPS)])[..., None]
    return SimpleNamespace(longest_s=12.0, durations_s=DURATIONS_S, ramps=ramps, time_s=time, **more)


def values_of(effect, **given):
    """All parameters by full name at zero, (1,), but for those given."""
    out = {p.name: np.zeros(1) for p in effect.parameters}
    for name, value in given.items():
        assert f"{effect.name}.{name}" in out
        out[f"{effect.name}.{name}"] = np.array([value])
    return out


@pytest.mark.parametrize("b", [0.0, 4.0, -4.0])
def test_a_drift_levels_off_as_its_law_says(b, kit):
    data, effect = records(), ForceDrift(kit.scales, TESTS)
    got = effect.recorded(data, values_of(effect, rate_N_s=0.3, levelling=b))
    x = data.time_s / 12.0
    expected = 0.3 * 12.0 * (x if b == 0.0 else (1.0 - np.exp(-b * x)) / b)
    assert got.shape == (1, 2, 4, 1)
    np.testing.assert_allclose(got[0, :, :, 0], expected, rtol=0, atol=1e-4 * expected.max())


def test_a_drift_of_each_test_is_a_line_and_two_bows(kit):
    data, effect = records(), ForceDriftByTest(kit.scales, TESTS)
    r, b, s = np.array([0.2, -0.1]), np.array([0.05, 0.3]), np.array([-0.4, 0.07])
    values = values_of(effect)
    for part, numbers in (("rate_N_s", r), ("bow_N_s", b), ("sway_N_s", s)):
        for test, number in zip(TESTS, numbers):
            values[f"force_drift.{part}[{test}]"] = np.array([number])
    got = effect.recorded(data, values)[0, :, :, 0]
    x = PLACES
    for i, d in enumerate(DURATIONS_S):
        law = r[i] * x + 2.0 * b[i] * x * (1.0 - x) + 3.0 * s[i] * x * (1.0 - x) * (1.0 - 2.0 * x)
        np.testing.assert_allclose(got[i], d * law, atol=1e-12)
    reported, unit = effect.reported(values)["rate_N_s"]
    assert unit == "N/s" and reported == pytest.approx(np.sqrt(np.mean(r**2)))


def test_a_newton_of_drift_takes_ten_cycles(kit):
    effect = ForceDriftByTest(kit.scales, TESTS)
    largest_hz = 1e3 * kit.scales.speed_m_s / (2.0 * np.pi * kit.scales.length_mm)
    assert effect.per_N() * 10.0 / largest_hz == pytest.approx(1.0)


@pytest.mark.parametrize("kind, hz", [(MainsInterference, 50.0), (MainsInterference60, 60.0)])
def test_mains_and_their_third_harmonic_keep_their_shape_at_every_phase(kind, hz, kit):
    """A cos(θ − φ) + A (c₃ cos 3(θ − φ) + s₃ sin 3(θ − φ)), whatever φ: the wave is shifted, not bent."""
    effect = kind(kit.scales, TESTS)
    theta = np.linspace(0.0, 6.0, 7)  # not at multiples of 60 degrees, where sin 3θ is zero
    first, third = (np.stack([np.cos(h * theta), np.sin(h * theta)])[:, None, :, None] for h in (1, 3))
    wave = np.stack([np.broadcast_to(w, (2, 2, 7, 1)) for w in (first, third)])
    other = np.full_like(wave, np.nan)
    waves = np.stack([wave, other] if effect.which == 0 else [other, wave])
    data = records(mains_waves=waves, mains_hz=np.array([[50.0, 60.0]] * 2), mains_possible=(True, False))
    size, shift, c3, s3 = np.array([0.4, 1.3]), np.array([0.7, -2.1]), 0.2, -0.3
    values = values_of(effect, third_cosine=c3, third_sine=s3)
    for i, test in enumerate(TESTS):
        values[f"mains_interference.cosine[{test}]"] = np.array([size[i] * np.cos(shift[i])])
        values[f"mains_interference.sine[{test}]"] = np.array([size[i] * np.sin(shift[i])])
    got = effect.recorded(data, values)[0, :, :, 0]
    at = theta - shift[:, None]
    expected = size[:, None] * (np.cos(at) + c3 * np.cos(3.0 * at) + s3 * np.sin(3.0 * at))
    np.testing.assert_allclose(got, expected, atol=1e-12)
    lines = effect.lines(data, values)[0]
    np.testing.assert_allclose(lines[:, effect.which], size * np.exp(1j * shift))
    np.testing.assert_array_equal(lines[:, 1 - effect.which], 0.0)
    reported = effect.reported(values)
    assert reported["frequency_hz"][0] == pytest.approx([hz])
    assert reported["amplitude_N"][0] == pytest.approx([np.sqrt(np.mean(size**2))])
    assert reported["third_share"][0] == pytest.approx([np.hypot(c3, s3)])
    assert effect.possible(data) is (effect.which == 0)
