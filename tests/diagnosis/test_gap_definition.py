"""Identification and diagnosis mean the same by a gap."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.diagnosis.answer.localisation import of_blocks
from bayes_iwan.diagnosis.fits.gap_size import _along, gap_power_N2
from bayes_iwan.diagnosis.fits.residuals import ALONG, LOOP, MEAN, residual_of
from bayes_iwan.inference.results.predictions import residual_size


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
