"""Displacement from acceleration: exact for harmonics, free of offset and drift."""

from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, read_campaign
from bayes_iwan.campaign.timing.accelerometer import displacement_from_acceleration

DATA = Path(__file__).parents[2] / "data"


def motion(frequency, n_cycles=30.3, rate=1280.0):
    """Displacement (mm) and acceleration (m/s^2) of a distorted sine."""
    t = np.arange(int(n_cycles * rate / frequency)) / rate
    x = 2 * np.pi * frequency * t + 0.8
    parts = [(1, 1.0, 0.0), (2, 0.01, 0.4), (3, 0.03, 1.1), (7, 0.002, 0.2)]
    u = sum(a * np.sin(h * x + p) for h, a, p in parts)
    acceleration = -sum(a * (2 * np.pi * frequency * h) ** 2 * np.sin(h * x + p) for h, a, p in parts) * 1e-3
    return t, u, acceleration


@pytest.mark.parametrize("frequency", [10.0, 15.0, 30.0])
def test_exact_where_trapezoids_are_not(frequency):
    t, u, acceleration = motion(frequency)
    found = displacement_from_acceleration("x", t, acceleration + 0.5)
    inner = slice(t.size // 10, -t.size // 10)
    assert np.std((found - u)[inner]) < 2e-5 and np.abs(found - u).max() < 5e-3
    # what summing twice by trapezoids makes of the same record, with its offset and drift fitted away
    v = np.concatenate([[0], np.cumsum((acceleration[1:] + acceleration[:-1]) / 2 * np.diff(t))])
    s = np.concatenate([[0], np.cumsum((v[1:] + v[:-1]) / 2 * np.diff(t))]) * 1e3
    s -= np.polynomial.Polynomial.fit(t, s, 1)(t)
    s -= np.mean(s - u)
    assert np.std((s - u)[inner]) > 10 * np.std((found - u)[inner])
    if frequency == 30.0:
        x = np.exp(-2j * np.pi * 30 * t[: 1280 // 30 * 30])
        gain = abs(np.sum(s[: x.size] * x)) / abs(np.sum(u[: x.size] * x))
        assert gain == pytest.approx(1 - 0.0036, abs=0.0008)  # (ω Δt)²/12 is lost at each integration


def test_slow_change_of_amplitude_survives():
    t, _, _ = motion(10.0)
    omega = 2 * np.pi * 10
    grow = 1 + 0.05 * t / t[-1]
    u = grow * np.sin(omega * t)
    acceleration = (-grow * omega**2 * np.sin(omega * t) + 2 * 0.05 / t[-1] * omega * np.cos(omega * t)) * 1e-3
    found = displacement_from_acceleration("x", t, acceleration)
    inner = slice(t.size // 10, -t.size // 10)
    assert np.std((found - u)[inner]) < 1e-3  # a constant amplitude would miss by 0.01


def test_nothing_to_integrate():
    t = np.arange(2000) / 1280
    with pytest.raises(CampaignError, match=r"x: the acceleration does not move"):
        displacement_from_acceleration("x", t, np.full(t.size, 0.02))


def _against_force(loop):
    """Amplitude of the fundamental in mm, and its phase against the force's, which both campaigns share, in degrees."""
    u = 2 * np.mean(loop.displacement_mm * np.exp(-2j * np.pi * loop.phase))
    return abs(u), np.degrees(np.angle(u / loop.harmonics_N[1]))


def test_rope_spring_by_accelerometer_and_by_displacement():
    """The same nine runs, measured both ways: the averaged motions differ by less than 0.02 % of amplitude.

    Of amplitude and phase 0.5 % and 0.1 degrees were asked for; 0.01 % and 0.01 degrees are stated.
    """
    direct = read_campaign(DATA / "rope_spring").loops()
    derived = read_campaign(DATA / "rope_spring_accelerometer").loops()
    for a, b in zip(direct, derived, strict=True):
        assert a.file == b.file and a.n_cycles == b.n_cycles
        assert b.frequency_hz == pytest.approx(a.frequency_hz, rel=2e-6)
        assert b.amplitude_mm == pytest.approx(a.amplitude_mm, rel=1e-4)
        (amplitude, phase), (found, found_phase) = _against_force(a), _against_force(b)
        assert found == pytest.approx(amplitude, rel=1e-4) and found_phase == pytest.approx(phase, abs=0.01)
        assert np.std(b.displacement_mm - a.displacement_mm) < 2e-4 * a.amplitude_mm
        assert np.std(b.velocity_m_s - a.velocity_m_s) < 4e-4 * np.std(a.velocity_m_s)
        assert np.std(b.acceleration_m_s2 - a.acceleration_m_s2) < 1e-3 * np.std(a.acceleration_m_s2)
        # the force is one and the same channel, so only the phase of the motion can move its harmonics
        assert np.abs(b.harmonics_N - a.harmonics_N).max() < 3e-4 * np.abs(a.harmonics_N[1])


@pytest.mark.parametrize(("ratio", "gain"), [(0.3, 0.0), (0.37, 0.0), (0.66, 1.0), (1.37, 1.0), (2.6, 1.0)])
def test_the_stated_response_between_the_harmonics(ratio, gain):
    """A second tone of `ratio` times the frequency, which no harmonic of the drive describes."""
    t = np.arange(8000) / 1280
    omega = 2 * np.pi * 10.0
    tone = 0.02 * np.cos(ratio * omega * t)
    acceleration = (-(omega**2) * np.sin(omega * t) - (ratio * omega) ** 2 * tone) * 1e-3
    found = displacement_from_acceleration("x", t, acceleration)
    inner = slice(1500, -1500)
    left = (found - np.sin(omega * t))[inner]
    wave = np.exp(1j * ratio * omega * t[inner])
    response = np.vdot(wave, left) / np.vdot(wave, tone[inner])
    assert abs(response) == pytest.approx(gain, abs=0.02)
    if gain:
        assert np.degrees(np.angle(response)) == pytest.approx(0.0, abs=1.0)
