"""A periodic motion gives the force of the same motion repeated: its own sixth repetition, from rest."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.campaign import read_campaign
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.models import Model, Motion, Scales
from bayes_iwan.models.kernels.sliders import friction
from bayes_iwan.models.motion import motion_of
from bayes_iwan.models.slip_force import FAMILIES

SCALES = Scales(1.0, 0.063, 10.0, 1.2, 6.0, 14.0)
REPEATS = 6
PHASES = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 7)
#: order, amplitude and phase of the harmonics
MOTIONS = {
    "sine": [(1, 1.0, 0.0)],
    "seven harmonics": [(k, 1.0, q) for k, q in zip((1, 2, 3, 5, 7, 9, 11), PHASES)],
    "third harmonic of 60 %": [(1, 1.0, 0.0), (3, 0.6, 1.0)],
    "ripple of 2 %": [(1, 1.0, 0.3), (25, 0.02, 0.5)],
    "dwell between reversals": [(1, 1.0, 0.0), (2, 0.5, 0.0), (40, 0.02, 0.5)],
}


def motion(parts, samples=128, frequency_hz=10.0):
    phase, omega = 2.0 * np.pi * np.arange(samples) / samples, 2.0 * np.pi * frequency_hz
    u = sum(g * np.sin(k * phase + q) for k, g, q in parts)
    v = sum(g * k * np.cos(k * phase + q) for k, g, q in parts)
    a = -sum(g * k * k * np.sin(k * phase + q) for k, g, q in parts)
    scale = 1.0 / np.abs(u).max()
    return Motion(
        displacement_mm=(scale * u)[None, None],
        velocity_m_s=(1e-3 * omega * scale * v)[None, None],
        acceleration_m_s2=(1e-3 * omega**2 * scale * a)[None, None],
        frequency_hz=np.array([frequency_hz]),
        amplitude_mm=np.ones(1),
        cycle=np.zeros(1),
        test=np.zeros(1, int),
    )


def largest_difference(scales, draws, motion, embedded):
    """(draws, loops) over the force's standard deviation, parameters from the prior."""
    model = Model(scales.reference, embedded=embedded)
    z = np.random.default_rng(1).standard_normal((draws, len(model.parameters(scales))))
    values = {p.name: p.value(z[:, i]) for i, p in enumerate(model.parameters(scales))}
    numbers = model.parameter_values(values)
    series = ("displacement_mm", "velocity_m_s", "acceleration_m_s2")
    step_s = 1.0 / (motion.frequency_hz * motion.samples)
    record = replace(
        motion, periodic=False, step_s=step_s, **{n: np.tile(getattr(motion, n), (1, 1, REPEATS)) for n in series}
    )
    sixth = model.friction_force(numbers, record)[..., -motion.samples :]
    once = model.friction_force(numbers, motion)
    # the very last sample of a record may be a turning point, which no sample after it shows
    return np.abs(once - sixth)[..., :-1].max(axis=-1) / sixth.std(axis=-1)


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("embedded", [False, True])
def test_any_motion_over_the_prior(name, embedded):
    assert np.max(largest_difference(SCALES, 300, motion(MOTIONS[name]), embedded)) < 1e-9


def test_the_motions_of_the_rope_spring():
    loops = read_campaign(Path(__file__).parents[2] / "data" / "rope_spring").loops()
    assert np.max(largest_difference(scales_of(loops), 100, motion_of(loops), False)) < 1e-9


def test_motions_and_factors_that_no_test_would_impose(truth):
    """α and k walk, jump and wave each on its own; friction may depend on the direction."""
    rng = np.random.default_rng(5)
    table, top = FAMILIES["uniform"].table(truth.columns(slip_mean_N=1.0, slip_width=1.0))
    for case in range(72):
        u = truth.wild_motion(rng, 64, case % 6)
        alpha, k = (truth.wild_factor(rng, 64, rng.integers(6)) for _ in range(2))
        forces = []
        for repeats, closed in ((1, True), (3, False)):
            out, zero = np.empty((1, 1, 1, 64 * repeats)), np.zeros(1)
            slope = 0.5 * (np.roll(u, -1) - np.roll(u, 1)) if case % 2 else np.full(64, np.nan)
            series = (np.tile(x, repeats)[None, None] for x in (u, slope, alpha, 3.0 * k))
            friction(*series, zero + (0.0, 0.3, -0.7)[case % 3], closed, table[:, None], top, zero, out)
            forces.append(out[0, 0, 0])
        np.testing.assert_allclose(forces[0][:-1], forces[1][64:127], atol=1e-9)
