"""Causes in the model's form: each frees one function of the base."""

import numpy as np
import pytest
from scipy import optimize

from bayes_iwan.effects.model_form import EFFECTS, NormalForceFree, SlipForcesFree, SlipLimit, StiffnessLawFree
from bayes_iwan.models import Model, sine_motion
from bayes_iwan.models.simulator import recorded_force

AT = sine_motion(frequency_hz=10.0, amplitude_mm=[0.15, 0.35, 0.9], samples=64)


def coefficients(effect, values):
    return {p.name: np.array([v]) for p, v in zip(effect.parameters, values)}


@pytest.mark.parametrize("kind", EFFECTS)
def test_each_says_in_one_line_what_the_base_lacks(kind, kit):
    effect = kind(kit.scales)
    assert effect.statement and "\n" not in effect.statement and len(effect.statement) < 100
    assert len(effect.strength_names) == len(effect.parameters) and effect.scanned == ()
    assert all(v == 0.0 for v in effect.off.values())
    size = effect.reported(coefficients(effect, [0.1] * len(effect.parameters)))[effect.strength[0]][0]
    assert size > 0.1 if len(effect.parameters) > 1 else size == 0.1


def test_tilt_of_one_gamma_takes_up_slip_forces_with_a_limit(kit):
    """A specimen whose slip forces are Segalman's power law with a tenth of them at the limit, fitted by one gamma with
    its own stiffness and spring: freeing the density takes most of the gap away."""
    truth = Model(kit.reference, slip="power_law", normal_force="constant", stiffness="constant")
    own = {"kp_N_mm": 3.0, "k1_N_mm": 12.0, "slip_max_N": 4.0, "slip_chi": -0.4, "slip_end_share": 0.1}
    measured = recorded_force(truth, (), {n: np.array([v]) for n, v in own.items()}, AT)[0]
    base, effect = (
        Model(kit.reference, slip="gamma1", normal_force="constant", stiffness="constant"),
        SlipForcesFree(kit.scales),
    )

    def error(x):
        base_values = dict(zip(("kp_N_mm", "k1_N_mm", "t1_N", "eta1"), np.exp(x[:4, None]))) | {"g1": np.ones(1)}
        deviating = np.concatenate([x[4:], np.zeros(9 - len(x))])
        return (
            recorded_force(base, (effect,), base_values | coefficients(effect, deviating), AT)[0] - measured
        ).ravel()

    start = np.log([3.0, 12.0, 1.0, 1.5])
    alone = optimize.least_squares(error, start)
    freed = optimize.least_squares(error, np.concatenate([alone.x, np.zeros(5)]), max_nfev=40)
    assert freed.cost < 0.17**2 * alone.cost and alone.cost > 0.0
    assert np.abs(freed.x[4:]).max() < 3.0


def test_a_limit_of_a_power_law_is_segalmans_model(kit):
    """Segalman's four-parameter Iwan model is a power law without an end of its own, cut at the limit."""
    law = Model(kit.reference, slip="power_law", normal_force="constant", stiffness="constant")
    share, chi, limit_N, effect = 0.25, -0.4, 4.0, SlipLimit(kit.scales)
    own = {"kp_N_mm": 3.0, "k1_N_mm": 12.0, "slip_max_N": limit_N, "slip_chi": chi, "slip_end_share": share}
    longer = own | {"slip_max_N": limit_N * (1.0 - share) ** (-1.0 / (chi + 1.0)), "slip_end_share": 0.0}
    truth, uncut = ({n: np.array([v]) for n, v in some.items()} for some in (own, longer))
    forces = [
        recorded_force(law, (), truth, AT),
        recorded_force(law, (effect,), uncut | effect.values_at(limited_share=share), AT),
        recorded_force(law, (), uncut, AT),
    ]
    differs = [np.abs(f - forces[0]).max() / limit_N for f in forces]
    assert differs[1] < 2e-3 and differs[2] > 0.05


def test_reported_size_is_the_share_by_which_the_density_differs(kit, density_ratio):
    effect = SlipForcesFree(kit.scales)
    c = np.array([0.05, -0.04, 0.02, 0.0, 0.03])
    told = effect.reported(coefficients(effect, c))
    x, w = np.polynomial.legendre.leggauss(60)
    differs = np.sqrt(0.5 * w @ (density_ratio(c[None], 0.5 + 0.5 * x)[0] - 1.0) ** 2)
    assert told["deviation"][0][0] == pytest.approx(differs, rel=0.1)


def test_a_power_of_the_normal_force_in_place_of_a_constant_stiffness(kit):
    """Elements that stick: their force is the stiffness at that moment times the deflection, and k ∝ α^a."""
    effect = StiffnessLawFree(kit.scales)
    rng = np.random.default_rng(0)
    alpha = rng.uniform(0.3, 2.0, (1, 3, 64))
    k = effect.stiffness(np.full((1, 3, 64), 7.0), alpha, AT, coefficients(effect, [1.0 / 3.0, 0.0]))
    np.testing.assert_allclose(k, 7.0 * np.cbrt(alpha), rtol=1e-12)


def test_normal_force_is_bent_by_displacement_and_speed(kit):
    effect = NormalForceFree(kit.scales)
    alpha = np.ones((1, 3, 64))
    u, v = AT.displacement_mm / kit.scales.length_mm, AT.velocity_m_s / kit.scales.speed_m_s
    c = [0.1, -0.2, 0.3, 0.05, -0.15, 0.25]
    series = sum(a * b for a, b in zip(c, (u, u**2, abs(v), u * abs(v), v, u * v)))
    np.testing.assert_allclose(effect.normal_force(alpha, AT, coefficients(effect, c)), np.exp(series), rtol=1e-12)
