"""Round trips and cross-validation through whichever ArviZ is installed."""

import numpy as np
import pytest

from bayes_iwan.inference import arviz_adapter as adapter


@pytest.fixture
def normal_mean():
    """Posterior of the mean of 40 unit-normal data under a flat prior, drawn exactly."""
    rng = np.random.default_rng(0)
    data = rng.standard_normal(40)
    mean = data.mean() + rng.standard_normal((4, 1000)) / np.sqrt(40)
    pointwise = -0.5 * (data - mean[..., None]) ** 2 - 0.5 * np.log(2 * np.pi)
    return data, mean, pointwise


def test_all_groups_come_back_from_the_file_bit_for_bit(tmp_path, normal_mean):
    data, mean, pointwise = normal_mean
    curve = np.random.default_rng(1).standard_normal((4, 1000, 5))
    tree = adapter.to_arviz(
        {"mean": mean, "curve": curve},
        prior={"mean": mean[:1] * 10},
        posterior_predictive={"force": pointwise},
        log_likelihood={"force": pointwise},
        sample_stats={"lp": pointwise.sum(axis=2)},
        observed_data={"force": data},
        constant_data={"u": np.arange(40.0)},
        dims={"curve": ["grid"]},
        coords={"grid": np.linspace(0, 1, 5)},
        attrs={"seed": 3, "data": "abc"},
    )
    path = tmp_path / "deep" / "posterior.nc"
    adapter.save_netcdf(tree, path)
    assert [p.name for p in path.parent.iterdir()] == ["posterior.nc"]
    back = adapter.load(path)
    path.unlink()  # loaded whole: the file is not needed any more
    assert adapter.groups_of(back) == adapter.groups_of(tree)
    assert len(adapter.groups_of(back)) == 7
    for group in adapter.groups_of(tree):
        for name, values in adapter.arrays(tree, group).items():
            np.testing.assert_array_equal(adapter.arrays(back, group)[name], values)
    np.testing.assert_array_equal(adapter.arrays(back)["curve"], curve)
    assert adapter.attributes(back)["seed"] == 3 and adapter.attributes(back)["data"] == "abc"


def test_leave_one_out_is_the_exact_one_of_a_normal_mean(normal_mean):
    data, mean, pointwise = normal_mean
    found = adapter.loo(adapter.to_arviz({"mean": mean}, log_likelihood={"force": pointwise}))
    rest = (data.sum() - data) / 39
    exact = -0.5 * (data - rest) ** 2 / (1 + 1 / 39) - 0.5 * np.log(2 * np.pi * (1 + 1 / 39))
    np.testing.assert_allclose(found.pointwise, exact, atol=0.02)
    assert found.elpd == pytest.approx(exact.sum(), abs=0.1)
    assert found.se == pytest.approx(np.sqrt(40 * exact.var()), rel=0.05)
    assert found.pareto_k.shape == (40,) and found.n_bad == 0


def test_comparison_puts_the_better_model_first_with_the_error_of_the_difference(normal_mean):
    _, mean, pointwise = normal_mean
    shifted = pointwise - 0.3  # every datum predicted worse by the same: a certain difference
    trees = {
        "worse": adapter.to_arviz({"mean": mean}, log_likelihood={"force": shifted}),
        "better": adapter.to_arviz({"mean": mean}, log_likelihood={"force": pointwise}),
    }
    rows = adapter.compare(trees)
    assert [row["name"] for row in rows] == ["better", "worse"]
    assert rows[1]["elpd_difference"] == pytest.approx(-12.0, abs=1e-6)
    assert rows[1]["se_difference"] == pytest.approx(0.0, abs=1e-6) and rows[1]["se"] > 1


def test_chains_are_ensembles_with_steps_in_order():
    draws = np.arange(2 * 3 * 4).reshape(2, 3, 4)
    chains = adapter.ensembles_as_chains(draws)
    assert chains.shape == (2, 12) and (chains[0] == np.arange(12)).all()


def test_what_cannot_be_is_said(tmp_path):
    with pytest.raises(adapter.ArvizError, match="posterior"):
        adapter.to_arviz({})
    with pytest.raises(adapter.ArvizError, match="chain, draw"):
        adapter.to_arviz({"x": np.zeros(5)})
    with pytest.raises(adapter.ArvizError, match="no such file"):
        adapter.load(tmp_path / "none.nc")
    (tmp_path / "text.nc").write_text("not netcdf")
    with pytest.raises(adapter.ArvizError, match=r"text\.nc"):
        adapter.load(tmp_path / "text.nc")
    with pytest.raises(adapter.ArvizError, match="log-likelihood"):
        adapter.loo(adapter.to_arviz({"x": np.zeros((2, 5))}))
