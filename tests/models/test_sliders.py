"""The sliders stage against Jenkins elements updated one by one in plain numpy, on motions no test would impose."""

import numpy as np
import pytest

from bayes_iwan.models.kernels import sliders
from bayes_iwan.models.slip_force import FAMILIES


def friction(table, top, u, alpha, k, closed=False, asymmetry=0.0):
    out = np.empty((1, 1, 1, len(u)))
    zero = np.zeros(1)
    slope = np.full((1, 1, len(u)), np.nan)
    sliders.friction(
        u[None, None], slope, alpha[None, None], k[None, None], zero + asymmetry, closed, table[:, None], top, zero, out
    )
    return out[0, 0, 0]


def nodes(top, start=1e-7, count=3000):
    return np.r_[0.0, np.geomspace(start, 1.0, count), 1.002] * top


@pytest.mark.parametrize("family", FAMILIES)
def test_any_motion_of_every_family(family, truth):
    """Random walks, jumps and repeated values, with α and k walking, jumping and waving each on its own."""
    parameter_values, survival = truth.family_cases[family]
    table, top = FAMILIES[family].table(parameter_values)
    phi = nodes(top[0])
    limited = truth.limited_by_sum(survival, phi)
    rng = np.random.default_rng(len(family))
    for case in range(36):
        u = truth.wild_motion(rng, 160, case % 6)
        alpha = truth.wild_factor(rng, 160, case // 6)
        k = truth.wild_factor(rng, 160, rng.integers(6)) * np.exp(rng.uniform(0.0, 3.0))
        error = friction(table, top, u, alpha, k) - truth.jenkins(u, alpha, k, phi, limited)
        # forces are bounded by α E[Φ], except where k jumps up under an element at rest
        scale = limited[-1] * alpha.max() * max(1.0, np.max(k[1:] / k[:-1]))
        assert np.max(np.abs(error)) < 3e-5 * scale, case


def test_random_gammas_and_directions_on_random_motions(truth):
    rng = np.random.default_rng(7)
    for case in range(60):
        t, eta = np.exp(rng.uniform(-2.0, 1.0, 2)), np.exp(rng.uniform(-2.0, 3.5, 2))
        g = rng.dirichlet([1.0, 1.0])
        table, top = FAMILIES["gamma2"].table(truth.gamma_values([t], [eta], [g]))
        phi = nodes(top[0])
        u = truth.wild_motion(rng, 200, case % 6)
        alpha, k = (truth.wild_factor(rng, 200, rng.integers(6)) for _ in range(2))
        asymmetry = (0.0, 0.3, -0.7)[case % 3]  # friction that depends on the direction
        expected = truth.jenkins(u, alpha, k, phi, truth.gamma_limited(t, eta, g, phi), asymmetry=asymmetry)
        error = friction(table, top, u, alpha, k, asymmetry=asymmetry) - expected
        assert np.max(np.abs(error)) < 1e-4 * np.sum(g * t * eta) * alpha.max() * max(1.0, np.max(k[1:] / k[:-1]))


@pytest.mark.parametrize("degree", [2, 3])
def test_turning_points_between_samples_are_those_of_the_cubic(degree):
    """Displacements and slopes that one cubic gives at all samples: it is known between them, too."""
    rng = np.random.default_rng(degree)
    for _ in range(50):
        turns = [rng.uniform(2.0, 6.0), rng.uniform(9.0, 13.0)][: degree - 1]
        slope = rng.choice([-1.0, 1.0]) * np.polynomial.Polynomial.fromroots(turns)
        u, samples = slope.integ(k=rng.standard_normal()), np.arange(16.0)
        at, where, off = sliders.way(u(samples), slope(samples), closed=False)
        np.testing.assert_allclose((where + off)[off != 0.0], turns, rtol=1e-9)
        np.testing.assert_allclose(at, u(where + off), rtol=1e-9, atol=1e-12)


def test_a_turning_point_halfway_between_two_equal_samples_is_seen():
    samples = np.arange(12.0)
    at, where, off = sliders.way((samples - 5.5) ** 2, 2.0 * (samples - 5.5), closed=False)
    np.testing.assert_array_equal([(where + off)[off != 0.0], at[off != 0.0]], [[5.5], [0.0]])
    phase = 2.0 * np.pi * (np.arange(16) + 0.5) / 16  # crests where the period begins, too
    at, where, off = sliders.way(np.round(np.cos(phase), 12), -np.sin(phase) * np.pi / 8, closed=True)
    np.testing.assert_array_equal((where + off)[off != 0.0], [7.5, 15.5])
    np.testing.assert_allclose(at[off != 0.0], [-1.0, 1.0], atol=1e-3)


def plain(truth):
    """The unit uniform distribution on (0, 2): mean 1, L(φ) = φ − φ²/4 exactly."""
    table, top = FAMILIES["uniform"].table(truth.columns(slip_mean_N=1.0, slip_width=1.0))
    return table, top, lambda phi: phi - 0.25 * phi**2


def test_at_rest_a_falling_normal_force_lets_elements_slip(truth):
    """u stands still while α falls and rises: the force falls with α and does not come back."""
    table, top, _ = plain(truth)
    u = np.r_[np.linspace(0.0, 1.0, 20), np.ones(20)]
    alpha = np.r_[np.ones(20), np.linspace(1.0, 0.3, 10), np.linspace(0.3, 2.0, 10)]
    force = friction(table, top, u, alpha, np.full(40, 5.0))
    assert force[19] == pytest.approx(1.0, abs=1e-6)  # k u = 5 is beyond every slip force
    np.testing.assert_allclose(force[20:30], alpha[20:30], rtol=1e-6)
    np.testing.assert_allclose(force[30:], 0.3, rtol=1e-6)


def test_a_middle_piece_slips_first(truth):
    """After u = 1 → 0.6 with α falling at rest, elements in the middle are cut while those near zero stay put."""
    table, top, limited = plain(truth)
    phi = nodes(top[0], count=20000)
    u = np.array([1.0, 0.6, 0.6, 0.6, 0.7, 0.5])
    alpha = np.array([1.0, 1.0, 0.9, 0.4, 1.5, 0.2])
    k = np.full(6, 3.0)
    np.testing.assert_allclose(
        friction(table, top, u, alpha, k), truth.jenkins(u, alpha, k, phi, limited(np.minimum(phi, 2.0))), atol=2e-6
    )


def test_forgotten_reversals_are_forgotten_exactly(truth):
    """Return-point memory: after a detour the branch goes on as if it had never been left."""
    table, top, _ = plain(truth)
    there = np.linspace(0.0, 0.5, 50)
    detour = np.r_[there[:30], np.linspace(there[29], -0.1, 15), np.linspace(-0.1, there[29], 15), there[30:]]
    straight = friction(table, top, there, np.ones(50), np.full(50, 4.0))
    led_astray = friction(table, top, detour, np.ones(80), np.full(80, 4.0))
    np.testing.assert_allclose(led_astray[-20:], straight[-20:], atol=1e-12)


def test_odd_symmetry(truth):
    rng = np.random.default_rng(3)
    table, top, _ = plain(truth)
    u, alpha = 0.3 * np.cumsum(rng.standard_normal(300)), np.exp(0.5 * rng.standard_normal(300))
    there, back = (friction(table, top, s * u, alpha, np.full(300, 4.0), asymmetry=0.4 * s) for s in (1.0, -1.0))
    np.testing.assert_allclose(there, -back, atol=1e-13)


def test_one_pass_reaches_the_periodic_state(truth):
    """A composition of clips is a clip, and so idempotent: the second cycle equals the third, whatever α and k do."""
    rng = np.random.default_rng(5)
    table, top, _ = plain(truth)
    for kind in range(6):
        u = truth.wild_motion(rng, 64, kind)
        alpha, k = (truth.wild_factor(rng, 64, rng.integers(6)) for _ in range(2))
        force = friction(table, top, np.tile(u, 5), np.tile(alpha, 5), np.tile(k, 5)).reshape(5, 64)
        np.testing.assert_allclose(force[1:4], np.broadcast_to(force[1], (3, 64)), atol=1e-11)


def off_by(swings, truth):
    """Largest error of the force over swings there and back."""
    u = np.r_[swings, swings[::-1]]
    parameter_values, _ = truth.family_cases["gamma1"]
    table, top = FAMILIES["gamma1"].table(parameter_values)
    phi = nodes(top[0], count=6000)
    alpha, k = np.ones(len(u)), np.full(len(u), 14.45)
    limited = truth.gamma_limited([0.6], [2.0], [1.0], phi)
    return np.max(np.abs(friction(table, top, u, alpha, k) - truth.jenkins(u, alpha, k, phi, limited)))


@pytest.mark.parametrize("reversals", [60, 100, 200, 1000])
def test_more_pieces_than_are_kept(reversals, truth):
    """Ever smaller swings make a piece each. Beyond MAX_PIECES the least vertex goes; down and up again, the error
    stays below 0.4 % of the mean slip force (measured: 0.31 % at 1000 reversals), and is nil below the limit."""
    shrinking = (1.0 - np.arange(reversals) / reversals) * (-1.0) ** np.arange(reversals)
    assert off_by(shrinking, truth) < (2e-5 if reversals < sliders.MAX_PIECES else 4e-3) * 1.2


def test_the_vertex_that_is_dropped_is_the_one_that_matters_least(truth):
    """Swings that shrink by 1.5 % each: 0.17 % of the mean slip force are measured; to drop the vertex next to the tail
    costs 0.30 %, triangles with a wrong side 0.25 % and more."""
    shrinking = 0.985 ** np.arange(400) * (-1.0) ** np.arange(400)
    assert off_by(shrinking, truth) < 2e-3 * 1.2


def test_dropped_vertices_where_a_cut_overflows(truth):
    """The same with α jumping at every sample, so that the whole polyline is cut over and over."""
    rng = np.random.default_rng(11)
    shrinking = (1.0 - np.arange(300) / 300) * (-1.0) ** np.arange(300)
    parameter_values, _ = truth.family_cases["gamma1"]
    table, top = FAMILIES["gamma1"].table(parameter_values)
    phi = nodes(top[0], count=6000)
    alpha = np.r_[np.ones(150), np.exp(0.02 * rng.standard_normal(150))]
    k = np.full(300, 14.45)
    limited = truth.gamma_limited([0.6], [2.0], [1.0], phi)
    error = friction(table, top, shrinking, alpha, k) - truth.jenkins(shrinking, alpha, k, phi, limited)
    assert np.max(np.abs(error)) < 4e-3 * 1.2


@pytest.mark.parametrize("broken", ["u", "alpha", "k", "all"])
def test_nan_goes_in_and_comes_out(broken, truth):
    """A sample that is not a number gives a force that is not one, and none before it is touched."""
    table, top, _ = plain(truth)
    series = {"u": np.sin(np.arange(100) * 0.3), "alpha": np.ones(100), "k": np.full(100, 4.0)}
    sound = friction(table, top, **series)
    for name in ("u", "alpha", "k"):
        if broken in (name, "all"):
            series[name] = series[name].copy()
            series[name][40] = np.nan
    force = friction(table, top, **series)
    np.testing.assert_array_equal(force[:40], sound[:40])
    assert np.isnan(force[40])
