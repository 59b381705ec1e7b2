"""Eq. (3) against the sliders stage where it holds; Masing's rule; the uniform distribution's loop in closed form.

At the turning point (u₀, α₀, k₀) every element that slipped last carries s·α₀φ, s the sign of the motion before.
On the branch that follows, elements with φ < φ* = k k₀|u − u₀| / (k α₀ + k₀ α) slip the other way, so with
C(φ) = ∫₀^φ φ̃ and M(φ) = ∫₀^φ f φ̃ df

    F = (k/k₀) F(u₀) − s (α + k α₀/k₀) M(φ*) − s k |u − u₀| (1 − C(φ*)).

With r = α/k and r₀ = α₀/k₀, φ* = |u − u₀| / (r₀ + r). It asks that

(a) φ* grows along the branch, else elements stick again;
(b) every element below φ* was slipping at the turning point;
(c) no element slips on the old way: one that carries s·α₀φ does where r falls so fast that (r₀ − r) φ > |u − u₀|.

F(u₀) it does not give: that is for the sliders stage or the element model (paper-notes).
"""

import numpy as np
import pytest

from bayes_iwan.models import Model, record_motion, sine_motion
from bayes_iwan.models.kernels.sliders import friction
from bayes_iwan.models.slip_force import FAMILIES
from jenkins_elements import element_force, equal_probability_sliders

K, LARGEST = 10.0, 2.0  # N/mm; uniform slip forces up to 2 N


def slip_front(displacement_mm, alpha, k_N_mm):
    """φ* in N along a monotone branch whose first sample is the turning point; all arrays (samples,)."""
    u, a, k = (np.asarray(x, dtype=float) for x in (displacement_mm, alpha, k_N_mm))
    return k * k[0] * np.abs(u - u[0]) / (k * a[0] + k[0] * a)


def branch_holds(displacement_mm, alpha, k_N_mm, slipped_to_N, largest_N=np.inf):
    """Where Eq. (3) holds along the branch, (samples,) bool: up to the first breach of (a), (b) or (c).

    slipped_to_N : the largest φ that was slipping at the turning point (np.inf: all were). Elements beyond it are
        taken to be no nearer to slipping on than those at it, as after a first loading.
    largest_N : the largest φ there is.
    """
    u, a, k = (np.asarray(x, dtype=float) for x in (displacement_mm, alpha, k_N_mm))
    step, ratio, front = np.diff(u), a / k, slip_front(u, a, k)
    good = np.r_[True, (np.diff(front) >= 0.0) & (step * np.sign(step[0]) > 0.0)]
    good &= (front <= slipped_to_N) | (slipped_to_N >= largest_N)
    loaded = min(slipped_to_N, largest_N)  # elements up to here carry all they can
    good &= (ratio >= ratio[0]) | ((ratio[0] - ratio) * loaded <= np.abs(u - u[0]))
    return np.logical_and.accumulate(good)


def branch_force(
    displacement_mm,
    alpha,
    k_N_mm,
    force_0_N,
    cumulative,
    first_moment,
):
    """Friction force (samples,) in N by Eq. (3) on a branch whose first sample is the turning point with force_0_N.

    cumulative, first_moment : C(φ) and M(φ) of the slip-force distribution. Check :func:`branch_holds` first.
    """
    u, a, k = (np.asarray(x, dtype=float) for x in (displacement_mm, alpha, k_N_mm))
    front = slip_front(u, a, k)
    s = -np.sign(u[-1] - u[0])  # the motion before the turning point
    return (
        k / k[0] * force_0_N
        - s * (a + k / k[0] * a[0]) * first_moment(front)
        - s * k * np.abs(u - u[0]) * (1.0 - cumulative(front))
    )


def slider_force(truth, u, alpha, k):
    table, top = FAMILIES["uniform"].table(truth.columns(slip_mean_N=LARGEST / 2, slip_width=1.0))
    out, zero = np.empty((1, 1, 1, len(u))), np.zeros(1)
    slope = np.full((1, 1, len(u)), np.nan)
    friction(u[None, None], slope, alpha[None, None], k[None, None], zero, False, table[:, None], top, zero, out)
    return out[0, 0, 0]


def branch(truth, amplitude, alpha_of_u, k_of_alpha, samples=400):
    """Load to `amplitude`, then walk back: (u, α, k) of the branch and the sliders' force there."""
    u = np.r_[np.linspace(0.0, amplitude, 200), np.linspace(amplitude, -amplitude, samples)[1:]]
    alpha = alpha_of_u(u)
    alpha[:200] = alpha[199]  # loaded at constant α, so that everything below k u is slipping
    k = k_of_alpha(alpha)
    force = slider_force(truth, u, alpha, k)
    return u[199:], alpha[199:], k[199:], force[199:]


def by_equation_3(u, alpha, k, force_0):
    return branch_force(
        u,
        alpha,
        k,
        force_0,
        lambda f: np.minimum(f, LARGEST) / LARGEST,
        lambda f: np.minimum(f, LARGEST) ** 2 / (2.0 * LARGEST),
    )


def test_equation_3_where_its_predicate_holds(truth):
    """Random smooth α(u) and k(α): wherever the predicate says so, closed form and sliders agree to 1e-6."""
    rng = np.random.default_rng(0)
    held = broke = wrong = 0
    for _ in range(200):
        a, b, c = rng.uniform(-1.0, 1.0, 3)
        amplitude, waves = rng.uniform(0.02, 0.5), rng.uniform(5.0, 60.0)
        u, alpha, k, force = branch(
            truth,
            amplitude,
            lambda u: np.exp(a * u / 0.5 + b * c * np.sin(waves * u)),  # noqa: B023
            lambda alpha: 12.0 * (1.0 - np.exp(-1.5 * alpha)),
        )
        slipped_to = min(amplitude * k[0] / alpha[0], LARGEST)
        holds = branch_holds(u, alpha, k, slipped_to, LARGEST)
        error = np.abs(by_equation_3(u, alpha, k, force[0]) - force)
        assert np.all(error[holds] < 1e-6)
        held, broke = held + holds.sum(), broke + (~holds).sum()
        wrong += np.sum(error[~holds] > 1e-4)
    assert held > 20_000 and broke > 2_000 and wrong > 0.5 * broke  # and where it does not, it matters


@pytest.mark.parametrize(
    ("cause", "alpha_of_u"),
    [
        ("elements stick again", lambda u: 1.0 + 6.0 / (1.0 + np.exp((u - 0.15) / 0.01))),
        ("elements slip on", lambda u: 1.0 - 0.7 / (1.0 + np.exp((u - 0.28) / 0.003))),
    ],
)
def test_predicate_says_no(cause, alpha_of_u, truth):
    """α rising fast makes elements stick again; falling fast it lets them slip on as they did before."""
    u, alpha, k, force = branch(truth, 0.3, alpha_of_u, lambda alpha: np.full_like(alpha, K))
    holds = branch_holds(u, alpha, k, np.inf, LARGEST)
    assert holds[0] and not holds[-1], cause
    error = np.abs(by_equation_3(u, alpha, k, force[0]) - force)
    assert np.all(error[holds] < 1e-6)
    first = np.argmin(holds)
    assert np.max(error[first:]) > 0.01, cause


def test_predicate_wants_a_monotone_branch_of_slipped_elements(truth):
    u = np.r_[np.linspace(0.1, 0.0, 20), 0.05]
    one, k = np.ones(21), np.full(21, K)
    holds = branch_holds(u, one, k, 0.3)
    front = slip_front(u, one, k)
    np.testing.assert_array_equal(holds[:20], front[:20] <= 0.3)
    assert not holds[20]


def test_front_of_equation_3(truth):
    """φ* as printed in Eq. (3), k k₀|u − u₀| / (k α₀ + k₀ α)."""
    assert slip_front(np.array([1.0, 0.5]), np.array([1.0, 2.0]), np.array([10.0, 16.0]))[1] == pytest.approx(
        16.0 * 10.0 * 0.5 / (16.0 * 1.0 + 10.0 * 2.0)
    )


def uniform_model(reference):
    return Model(reference, slip="uniform", normal_force="constant", stiffness="constant")


def uniform_values(truth):
    return truth.columns(kp_N_mm=0.0, force_zero_N=0.0, k1_N_mm=K, slip_mean_N=LARGEST / 2, slip_width=1.0)


def backbone(u):
    """First loading of the uniform distribution (Iwan 1966): E[min(Φ, k u)]."""
    f = np.minimum(K * u, LARGEST)
    return f - f**2 / (2.0 * LARGEST)


@pytest.mark.parametrize("amplitude", [0.05, 0.15, 0.2, 0.5])
def test_masings_rule(amplitude, truth, reference):
    """Constant α: first loading is the backbone, the branches after it are the backbone twice enlarged."""
    u = np.r_[
        np.linspace(0.0, amplitude, 80),
        np.linspace(amplitude, -amplitude, 159)[1:],
        np.linspace(-amplitude, amplitude, 159)[1:],
    ]
    motion = record_motion(np.arange(len(u)), u)
    force = uniform_model(reference).friction_force(uniform_values(truth), motion)[0, 0]
    np.testing.assert_allclose(force[:80], backbone(u[:80]), atol=1e-9)
    end = backbone(amplitude)
    np.testing.assert_allclose(force[80:238], end - 2.0 * backbone((amplitude - u[80:238]) / 2.0), atol=1e-9)
    np.testing.assert_allclose(force[238:], 2.0 * backbone((u[238:] + amplitude) / 2.0) - end, atol=1e-9)


@pytest.mark.parametrize("amplitude", [0.05, 0.2, 1.0])
def test_loop_and_energy_of_the_uniform_distribution(amplitude, truth, reference):
    """Dissipated energy ⅔ k²A³/φ_max while some elements stick, 2 φ_max A − 4/3 φ_max²/k when all slip."""
    motion = sine_motion(frequency_hz=10.0, amplitude_mm=amplitude, samples=4096)
    force = uniform_model(reference).friction_force(uniform_values(truth), motion)[0, 0]
    u = motion.displacement_mm[0, 0]
    down = motion.velocity_m_s[0, 0] < 0
    there = np.where(down, -1.0, 1.0)
    loop = there * (2.0 * backbone((there * u + amplitude) / 2.0) - backbone(amplitude))
    np.testing.assert_allclose(force, loop, atol=2e-6)
    energy = np.sum(0.5 * (force + np.roll(force, -1)) * (np.roll(u, -1) - u))
    if K * amplitude < LARGEST:
        expected = 2.0 / 3.0 * K**2 * amplitude**3 / LARGEST
    else:
        expected = 2.0 * LARGEST * amplitude - 4.0 / 3.0 * LARGEST**2 / K
    assert energy == pytest.approx(expected, rel=1e-5)


def test_element_model_is_the_same_physics(truth):
    """The element model itself: 20,000 compiled elements against the closed form, and against its own shapes."""
    u = np.r_[np.linspace(0.0, 0.15, 100), np.linspace(0.15, -0.15, 200)[1:]]
    phi = (np.arange(20_000) + 0.5) / 20_000 * LARGEST
    force = element_force(u, np.ones(299), np.full(299, K), phi, np.full(20_000, 1 / 20_000))
    np.testing.assert_allclose(force[:100], backbone(u[:100]), atol=1e-7)
    np.testing.assert_allclose(force[100:], backbone(0.15) - 2 * backbone((0.15 - u[100:]) / 2), atol=1e-7)
    np.testing.assert_allclose(
        equal_probability_sliders(lambda f: np.clip(1 - f / LARGEST, 0, 1), 100, LARGEST),
        (np.arange(100) + 0.5) / 100 * LARGEST,
        atol=1e-4,
    )
    with pytest.raises(ValueError, match=r"must be \(samples,\)"):
        element_force(u, np.ones(3), np.full(299, K), phi, phi)
    with pytest.raises(ValueError, match=r"must be \(elements,\)"):
        element_force(u, np.ones(299), np.full(299, K), phi, phi[:5])
