"""A stated condition from records to the fitted law, by the functions of analyses/stated_condition.py."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search.base_fit import fit_base
from bayes_iwan.diagnosis.search.fitted_sets import calibrated
from bayes_iwan.effects.conditions import conditions_of, following
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings, ModelSettings
from bayes_iwan.models import Model, sine_motion

PRESSURES = (1.0, 2.0, 3.5, 6.0)


def script():
    path = Path(__file__).parents[2] / "analyses" / "stated_condition.py"
    spec = importlib.util.spec_from_file_location("stated_condition", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_exponent_of_the_pressure_is_found(kit, capsys):
    """Slip forces ∝ pressure^0.6, put into the specimen's numbers themselves; stiffness and spring stay."""
    model, turn = Model(kit.reference, normal_force="constant", stiffness="constant"), iter(PRESSURES)

    def pressed(frequency, amplitude, samples):
        own = kit.parameter_values(model)
        scale = (next(turn) / 2.0) ** 0.6
        own |= {f"t{i}_N": scale * own[f"t{i}_N"] for i in (1, 2, 3)}
        return model.force(own, sine_motion(frequency_hz=frequency, amplitude_mm=amplitude, samples=samples))[0, 0]

    campaign = kit.made_up(pressed, [(8.0, 0.4), (8.0, 0.9), (20.0, 0.4), (20.0, 0.9)], noise_N=0.01)
    tests = tuple(replace(r, extras={"pressure_bar": p}) for r, p in zip(campaign.tests, PRESSURES))
    loops = replace(campaign, tests=tests).loops(**kit.small)
    scales, data = scales_of(loops), gap_data(loops)
    classical = DiagnoseSettings(ModelSettings(slip="gamma2", normal_force="constant", stiffness="constant"))
    base = fit_base(data, classical, scales, np.random.default_rng(0))
    (maker,) = following(conditions_of([x.extras for x in loops]))["slip_forces_follows_pressure_bar"]
    effect = calibrated(maker, scales, data, base.problem, base.z)
    told = script()
    fit = told.with_effect(base, effect, data)
    values = fit.problem.prior.values(fit.z[None])
    assert fit.log_z.max() > base.log_z.max() + 20.0
    assert values[effect.strength_name][0] == pytest.approx(0.6, abs=0.05)
    assert values[f"{effect.name}.of_stiffness"][0] == pytest.approx(0.0, abs=0.15)
    told.tell("with it", fit, data)
    said = capsys.readouterr().out
    assert float(said.rsplit(":", 1)[1]) > 0.97
