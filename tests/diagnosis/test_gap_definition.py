"""Identification and diagnosis mean the same by a gap."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.diagnosis.answer.localisation import of_blocks
from bayes_iwan.diagnosis.fits.discrepancy_size import DiscrepancySize
from bayes_iwan.diagnosis.fits.gap_size import _along, ceiling_N, gap_power_N2, moved_shares
from bayes_iwan.diagnosis.fits.residuals import ALONG, LOOP, MEAN, residual_of
from bayes_iwan.inference.results.predictions import residual_size
from bayes_iwan.inference.setup.spectrum import discrepancy_spectrum


@pytest.mark.parametrize("effect", ["viscous_damping", None])
def test_identification_and_diagnosis_find_one_gap_of_the_averaged_loops(effect, kit):
    """Of one model at one place; the residual's RMS, which has the noise in it, is never less."""
    search = kit.diagnosed(effect).search
    fit = search.base
    loops_N = np.sqrt(max(float(gap_power_N2(residual_of(search.data, fit), (LOOP,)).mean()), 0.0))
    found = residual_size(fit.problem, fit.z[None])
    assert found.gap_N == pytest.approx(loops_N, rel=0.02, abs=1e-6)
    assert found.gap_N <= found.rms_N and found.gap_share <= found.share
    assert f"{100 * found.gap_share:.2g} % of the friction force" in str(found)


def test_the_gap_of_each_block_is_the_loops_and_what_the_block_differs_by(kit):
    """A first harmonic of 3 − 4i N, 3 cos + 4 sin, is 5/√2 N RMS in every block; the loops' own mean does not count,
    what a block's mean departs from it by does."""
    search = kit.diagnosed(None).search
    residual = residual_of(search.data, search.base)
    value = np.zeros_like(residual.value)
    value[:, (residual.kind == MEAN)] = 9.0
    value[:, (residual.kind == LOOP) & (residual.order == 1)] = 3.0 - 4.0j
    value[:, (residual.kind == ALONG) & (residual.order == 0) & (residual.contrast == 0)] = 2.0
    residual = replace(residual, value=value)
    _, rms, low, high = _along(residual, np.zeros((3, *value.shape), dtype=complex))
    for t, found in enumerate(rms):
        shift = 2.0 * search.data.contrast[t, 0, : len(found)]
        assert len(found) > 2 and found == pytest.approx(np.sqrt(12.5 + shift**2))
        force_N = of_blocks(residual, value, t)
        assert np.sqrt(np.mean(force_N**2, axis=1)) == pytest.approx(found)
        phase = 2.0 * np.pi * np.arange(force_N.shape[1]) / force_N.shape[1]
        wave = 3.0 * np.cos(phase) + 4.0 * np.sin(phase)
        np.testing.assert_allclose(force_N, wave + shift[:, None], atol=1e-9)
    np.testing.assert_allclose(low, rms)
    np.testing.assert_allclose(high, rms)


def test_what_an_effect_moves_is_its_own_force_over_the_friction_level(kit):
    """A dashpot's: c times the RMS velocity of all tests."""
    search = kit.diagnosed("viscous_damping").search
    fit, data = search.fit(search.chosen), search.data
    values = fit.problem.parameter_values(fit.z[None])
    c = float(values[next(e for e in fit.effects if e.name == "viscous_damping").strength_name][0])
    force_N = c * 1e3 * data.steady_motion.velocity_m_s[0]  # N s/mm
    expected = np.sqrt(np.mean(force_N**2) / np.mean(data.level_N**2))
    assert expected > 0.02 and moved_shares(fit, data)["viscous_damping"] == pytest.approx(expected, rel=0.01)


def test_no_effect_can_explain_what_is_as_smooth_as_the_discrepancy_that_was_found(kit):
    """Without a discrepancy all of a residual of 3 N in the third harmonic is left beside noise, with a large one none;
    a change along the record is as large as itself says, so that one of many times its noise is not left."""
    search = kit.diagnosed(None).search
    residual = residual_of(search.data, search.base)
    value = np.zeros_like(residual.value)
    value[:, (residual.kind == LOOP) & (residual.order == 3)] = 3.0
    value[:, (residual.kind == ALONG) & (residual.order == 2) & (residual.contrast == 0)] = 50.0 * residual.noise.max()

    def left_N(share):
        fit = replace(search.base, size=DiscrepancySize(share, 0.05, 0.0))
        return ceiling_N(replace(residual, value=value, fit=fit))

    assert left_N(0.0) == pytest.approx(3.0 / np.sqrt(2.0), rel=1e-3)
    assert left_N(100.0) < 0.01
    # beside a discrepancy about as large as the noise about half: noise over both, in variance
    at = (residual.kind == LOOP) & (residual.order == 3)
    noise_N2 = residual.noise[:, at][:, 0] ** 2
    third = discrepancy_spectrum(np.ones(1), np.array([0.05]), int(np.sum(residual.kind <= MEAN)))[0, 3]
    share = float(np.sqrt(np.mean(noise_N2 / (search.data.level_N**2 * third))))
    kept = noise_N2 / (noise_N2 + search.data.level_N**2 * share**2 * third)
    assert np.all((kept > 0.2) & (kept < 0.8)) and np.all(np.abs(search.data.level_N - 1.0) > 0.05)
    assert left_N(share) == pytest.approx(3.0 * np.sqrt(0.5 * np.mean(kept**2)), rel=1e-3)
