"""Identification and diagnosis mean the same by a gap."""

import numpy as np
import pytest

from bayes_iwan.diagnosis.fits.gap_size import gap_power_N2
from bayes_iwan.diagnosis.fits.residuals import LOOP, residual_of
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
