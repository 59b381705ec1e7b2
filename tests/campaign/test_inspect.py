"""What a campaign shows before any model, against records whose numbers are known."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import average
from bayes_iwan.campaign.folders.inspect import inspect_loop


def test_energy_stiffness_and_loss_of_a_known_loop(record, force_harmonics):
    amplitude = 0.8
    test = inspect_loop(average(record(amplitude_mm=amplitude, n_cycles=30.3, noise_N=0.02, noise_mm=1e-4)))
    # u = A sin: the energy is pi A times the part of the force that goes with cos, the stiffness the part with sin
    first = force_harmonics[1]
    cos, sin = first.real, -first.imag
    for found, true in (
        (test.energy_mJ, np.pi * amplitude * cos),
        (test.stiffness_N_mm, sin / amplitude),
        (test.loss_factor, cos / sin),
    ):
        assert found.value == pytest.approx(true, rel=2e-3)
        assert found.low < found.value < found.high and found.high - found.low < 0.02 * abs(true)
    assert test.noise_N == pytest.approx(0.02, rel=0.15)
    # white noise of one-sided density 2 sigma^2 / rate
    density = float(np.median(test.spectrum_N2_Hz[test.spectrum_hz > 100]))
    assert density == pytest.approx(2 * 0.02**2 / 1280, rel=0.3)
    assert test.distortion < 1e-3 and test.notes == ()


def test_intervals_cover_the_truth_as_often_as_they_say(record, force_harmonics):
    inside = 0
    for seed in range(60):
        energy = inspect_loop(average(record(n_cycles=12.3, noise_N=0.3, seed=seed))).energy_mJ
        inside += energy.low < np.pi * force_harmonics[1].real < energy.high
    assert 46 <= inside <= 60  # 54 expected


@pytest.mark.parametrize("mains", [50.0, 60.0])
def test_mains_is_named_and_what_it_does(record, mains):
    r = record(frequency_hz=9.3, n_cycles=40.3, noise_N=0.01)
    hum = 0.05 * np.sin(2 * np.pi * (mains + 0.03) * r.time_s)
    test = inspect_loop(average(replace(r, force_N=r.force_N + hum)))
    (line,) = test.lines
    assert line.frequency_hz == pytest.approx(mains, abs=0.15) and line.amplitude_N == pytest.approx(0.05, rel=0.2)
    assert line.order == 0 and any("mains in the force" in n and "ground" in n for n in test.notes)
    assert inspect_loop(average(r)).lines == ()


def test_mains_on_a_harmonic_of_the_drive(record):
    r = record(frequency_hz=10.0, n_cycles=80.3, noise_N=0.01)
    hum = 0.05 * np.sin(2 * np.pi * 50.08 * r.time_s)
    test = inspect_loop(average(replace(r, force_N=r.force_N + hum)))
    assert [line.order for line in test.lines] == [5]
    assert any("harmonic 5 of the drive" in n and "does not divide" in n for n in test.notes)


def test_samples_in_a_reversal(record):
    test = inspect_loop(average(record(rate_hz=128.0, n_cycles=30.3)))
    # a sine spends acos(0.8) / 2 pi of its cycle in the first tenth of its stroke after a turn
    assert test.reversal_samples == pytest.approx(12.8 * np.arccos(0.8) / (2 * np.pi), rel=0.02)
    assert any("sample faster" in n for n in test.notes)


def test_a_distorted_drive_is_said_to_be_one(record):
    r = record(n_cycles=20.3, noise_N=0.01)
    u = r.displacement_mm + 0.1 * np.sin(6 * np.pi * (10 * r.time_s + 0.37))
    test = inspect_loop(average(replace(r, displacement_mm=u)))
    assert test.drive_harmonics[2] == pytest.approx(0.1, rel=1e-3) and test.distortion == pytest.approx(0.1, rel=1e-2)
    assert any("no sine" in n and "harmonic 3" in n for n in test.notes)


def test_noise_that_rivals_the_force(record):
    test = inspect_loop(average(record(n_cycles=20.3, noise_N=0.5)))
    assert any("noise of" in n and "more cycles" in n for n in test.notes)


def test_the_energy_of_a_multisine_is_that_of_all_its_harmonics(record):
    cycles = 10.0 * np.arange(1600) / 1280.0
    terms = [(order, 0.5, order * 0.7) for order in (2, 3, 9)]  # no fundamental
    u = sum(a * np.sin(2 * np.pi * h * cycles + turn) for h, a, turn in terms)
    force = sum(a * (5 * np.sin(x := 2 * np.pi * h * cycles + turn) + np.cos(x)) for h, a, turn in terms)
    plain = record(time_s=cycles / 10.0)
    test = inspect_loop(average(replace(plain, displacement_mm=u + 0.001 * plain.displacement_mm, force_N=force)))
    assert test.energy_mJ.value == pytest.approx(sum(np.pi * h * a**2 for h, a, _ in terms), rel=0.01)
    # of its strongest harmonics: the missing fundamental would be a division by nothing
    assert test.stiffness_N_mm.value == pytest.approx(5.0, rel=0.01)
    assert test.loss_factor.value == pytest.approx(0.2, rel=0.01) and 1.3 < test.distortion < 1.5
