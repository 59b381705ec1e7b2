"""Jumps: some numbers drawn from a mixture, the others solved for; on a bent sheet whose moments quadrature gives."""

import numpy as np
import pytest

from bayes_iwan.sampling.common.held import Held
from bayes_iwan.sampling.manifold import on_manifold
from bayes_iwan.sampling.manifold.nested import Nested, bending, jumped
from bayes_iwan.sampling.manifold.sheet import Sheet

NONE = np.empty(0, dtype=np.int64)
AXIS = np.linspace(-4.0, 4.0, 80_001)


def rows(z):
    """z1 = z0² and z2 = exp(−z1) sin 2z0, to within 0.025 and 0.03 exp(−z1)"""
    return np.stack([40.0 * (z[:, 1] - z[:, 0] ** 2), 33.0 * (z[:, 2] * np.exp(z[:, 1]) - np.sin(2.0 * z[:, 0]))], 1)


def log_prob(z, held=None):
    return (-0.5 * np.sum(rows(z) ** 2, axis=1) - 0.5 * np.sum(z * z, axis=1))[:, None]


def on_sheet(z0):
    return np.stack([z0, z0**2, np.exp(-(z0**2)) * np.sin(2.0 * z0)], axis=-1)


def density_of_z0():
    """Of the thin sheet: where it is steep in z2 there is the less of it."""
    z = on_sheet(AXIS)
    p = np.exp(-0.5 * np.sum(z * z, axis=1) - z[:, 1])
    return p / p.sum()


def whole():
    return Sheet(rows, log_prob, Held(NONE, np.empty(0), np.empty((0, 0)), 1), 3, 8.0)


@pytest.fixture(scope="module")
def nested():
    """Fitted to draws that are not the posterior's: too wide, and off its middle."""
    z0 = np.random.default_rng(0).normal(0.2, 0.8, 600)
    return Nested.fitted(whole(), np.array([0]), on_sheet(z0), np.random.default_rng(1))


def test_what_bends_a_sheet_is_found():
    z = on_sheet(np.array([-0.3, 0.05, 0.6]))
    assert set(bending(whole(), z)) == {0, 1}  # z2, which is drawn out alone, does not
    flat = Sheet(lambda z: z @ np.diag([1.0, 50.0, 3.0]), log_prob, whole().held, 3, 8.0)
    assert len(bending(flat, z)) == 0


def test_weights_are_those_of_the_posterior(nested):
    new = nested.propose(6000, np.random.default_rng(2))
    weight = np.exp(new.log_weight - new.log_weight.max())
    weight /= weight.sum()
    p = density_of_z0()
    assert 1.0 / np.sum(weight**2) > 2000.0
    for k in (1, 2, 4):
        assert weight @ new.z[:, 0] ** k == pytest.approx(np.sum(p * AXIS**k), abs=0.04)
    assert np.sqrt(weight @ (new.z[:, 1] - new.z[:, 0] ** 2) ** 2) == pytest.approx(0.025, rel=0.06)
    there = np.isfinite(new.log_weight)
    np.testing.assert_allclose(new.log_total[there], log_prob(new.z[there])[:, 0], rtol=1e-12)


def test_a_place_weighs_the_same_whether_proposed_or_come_upon(nested):
    new = nested.propose(300, np.random.default_rng(3))
    there = np.isfinite(new.log_weight)
    again = nested.log_weight(new.z[there], new.log_total[there])
    led = np.isfinite(again)
    assert there.mean() > 0.9 and led.mean() > 0.99
    np.testing.assert_allclose(again[led], new.log_weight[there][led], atol=1e-2)


def test_where_no_proposal_leads_a_chain_does_not_jump_from(nested):
    """Far from the sheet the middle is found, but its tangents do not lead to such a place."""
    off = on_sheet(np.array([0.3])) + np.array([0.0, 0.0, 9.0])
    beyond = on_sheet(np.array([0.3])) + np.array([20.0, 0.0, 0.0])  # not even the middle is found, of none of them
    assert nested.log_weight(off, np.zeros(1)) == nested.log_weight(beyond, np.zeros(1)) == np.inf
    taken = jumped(np.array([np.inf, 1.0]), np.zeros((3, 2)), np.full((3, 2), -0.9))
    np.testing.assert_array_equal(taken, [[-1, -1]] * 3)
    taken = jumped(np.array([-5.0, 0.0]), np.array([[0.0, -np.inf], [-1.0, 0.5]]), np.full((2, 2), -0.5))
    np.testing.assert_array_equal(taken, [[0, -1], [0, 1]])


def stationary(nested, walkers=3000):
    """How much more |z0| > 0.6 there is among chains that begin where they should and jump twelve times."""
    p, rng = density_of_z0(), np.random.default_rng(4)
    z = on_sheet(np.interp((np.arange(walkers) + 0.5) / walkers, np.cumsum(p), AXIS))
    z[:, 1] += 0.025 * rng.standard_normal(walkers)
    z[:, 2] = np.exp(-z[:, 1]) * (np.sin(2.0 * z[:, 0]) + 0.03 * rng.standard_normal(walkers))
    own = whole().begin(z, rng)
    after, level, went = on_manifold.jump(whole(), nested, own, 12, rng)
    assert went > 0.4
    np.testing.assert_allclose(level[-1], log_prob(own.z)[:, 0], rtol=1e-12)
    np.testing.assert_array_equal(after[-1], own.z)
    return np.mean(np.abs(after[6:, :, 0]) > 0.6) - np.sum(p[np.abs(AXIS) > 0.6])


def test_chains_that_jump_stay_where_they_should(nested):
    assert stationary(nested) == pytest.approx(0.0, abs=0.015)


def test_without_the_determinant_they_do_not(nested, monkeypatch):
    """So the test above would see it."""
    whole_density = Nested._log_density

    def wrong(self, middle, place):
        return whole_density(self, middle, place) - place.log_det

    monkeypatch.setattr(Nested, "_log_density", wrong)
    assert abs(stationary(nested)) > 0.06
