"""The diagnosis' base reaches what lies far out in its priors: nothing is missing where the model is right."""

import numpy as np
import pytest

from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search.base_fit import fit_base, gap_of
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.models import Model, Reference


@pytest.mark.parametrize("slip_forces, noise_N", [(1.0, 0.02), (10.0, 0.1)])
def test_table_1_at_2_and_5_mm_is_fitted_to_its_noise_whatever_its_slip_forces(kit, slip_forces, noise_N):
    model = Model(Reference(5.0, 0.785))
    values = kit.parameter_values(model)
    values |= {name: slip_forces * values[name] for name in ("t1_N", "t2_N", "t3_N")}
    tests = [(f, a) for a in (2.0, 5.0) for f in (10.0, 20.0)]
    loops = kit.made_up(kit.force_of(model, values), tests, noise_N=noise_N).loops()
    data, scales = gap_data(loops), scales_of(loops)
    fit = fit_base(data, DiagnoseSettings(), scales, np.random.default_rng(0))
    rate = fit.problem.prior.values(fit.z[None])["normal_force_rate"][0]
    assert rate == pytest.approx(float(values["normal_force_rate"][0]) * scales.speed_m_s / 0.785, rel=0.05)
    assert float(np.sqrt(np.mean(fit.problem.residual(fit.z[None]) ** 2))) < noise_N
    assert gap_of(data, fit).all.low_N == 0.0
