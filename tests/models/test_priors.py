"""Default priors: how far they reach, and that the model stands wherever they lead."""

import numpy as np
import pytest

from bayes_iwan.models import Model, Scales, sine_motion
from bayes_iwan.models.paper_parameters import table_1
from bayes_iwan.models.parameter import Z_LIMIT

SCALES = Scales(5.0, 0.785, 20.0, 3.25, 5.7, 9.2)  # of Table 1 at 2 and 5 mm, 10 to 25 Hz
CHANGES = ("normal_force_slope", "normal_force_rate")


def test_table_1_at_large_amplitudes_lies_within_three_prior_standard_deviations() -> None:
    model = Model(SCALES.reference)
    written = table_1(SCALES.reference)
    values = model.values(written)
    assert {n for n in values if n.startswith("slip_ratio")} == {"slip_ratio_21", "slip_ratio_32"}
    again = model.parameter_values(values)
    for name, number in written.items():  # what is sampled is what the paper's three components are made of
        np.testing.assert_allclose(again[name], number, rtol=1e-12, err_msg=name)
    for parameter in model.parameters(SCALES):
        if parameter.name in values:
            assert abs(float(parameter.score(values[parameter.name])[0])) < 3.0, parameter.name


@pytest.mark.parametrize("normal_force", ["hunt_crossley", "polynomial3"])
def test_what_changes_the_normal_force_may_be_any_number_and_the_force_stays_finite(normal_force: str) -> None:
    model = Model(SCALES.reference, normal_force=normal_force)
    parameters = model.parameters(SCALES)
    z = np.random.default_rng(0).standard_normal((500, len(parameters)))
    heavy = [i for i, p in enumerate(parameters) if p.name in model.normal_force_law.names and p.name != "beta"]
    assert heavy
    z[:, heavy] = np.random.default_rng(1).choice([-Z_LIMIT, -5.0, 0.0, 5.0, Z_LIMIT], (500, len(heavy)))
    values = {p.name: p.value(z[:, i]) for i, p in enumerate(parameters)}
    motion = sine_motion(frequency_hz=[10.0, 25.0], amplitude_mm=[2.0, 5.0])
    assert np.isfinite(model.force(model.parameter_values(values), motion)).all()


def test_heavy_tails_are_monotone_and_invertible_up_to_the_limit() -> None:
    z = np.linspace(-Z_LIMIT, Z_LIMIT, 1601)
    for parameter in Model(SCALES.reference).parameters(SCALES):
        if parameter.name in CHANGES:
            value = parameter.value(z)
            assert np.isfinite(value).all() and (np.diff(value) > 0.0).all()
            np.testing.assert_allclose(parameter.score(value), z, atol=1e-12)
            middle = np.abs(parameter.value(np.array([-0.6745, 0.6745])))
            np.testing.assert_allclose(middle, 0.6745 * 0.4, rtol=0.02)  # the median magnitude of N(0, 0.4)


@pytest.mark.parametrize("slip", ["gamma1", "gamma3", "uniform", "gaussian", "power_law"])
def test_bounds_cut_priors_and_reach_nowhere_beyond_them(slip: str) -> None:
    """A bound beyond a prior's support would say that values are possible which the prior excludes."""
    names = []
    for p in Model(SCALES.reference, slip=slip, embedded=True).parameters(SCALES):
        low, high = p.prior.support()
        assert p.lower == -np.inf or low <= p.lower, p.name
        assert p.upper == np.inf or p.upper <= high, p.name
        bounds = np.array([x for x in (p.lower, p.upper) if np.isfinite(x)])
        assert np.isfinite(p.log_density(bounds)).all(), "bounds themselves are possible"
        assert (p.log_density(np.array([p.lower - 0.01, p.upper + 0.01])) == -np.inf).all() or not len(bounds)
        cut = float(p.prior.cdf(p.lower) + p.prior.sf(p.upper))
        defined = ("beta", "slip_chi")  # whose laws are defined within their bounds alone
        assert cut < 0.01 or p.name in defined, f"{p.name}: bounds keep nonsense out, they do not say what is likely"
        names.append(p.name)
    if slip == "gamma3":
        assert {f"slip_ratio_{i + 1}{i}" for i in (1, 2)} | {f"share_{i}" for i in (1, 2)} <= set(names)
        assert {f"eta{i}" for i in (1, 2, 3)} <= set(names)
    assert len(names) == len(set(names))
