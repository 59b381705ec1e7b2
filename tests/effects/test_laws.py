"""Families of laws: each contains the classic ones of the literature, checked against their closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, optimize, signal, special

from bayes_iwan.effects import catalogue, mounting
from bayes_iwan.effects.base import EffectError, moved_by
from bayes_iwan.effects.law_families import decay_over_block, falling, growing, over_block
from bayes_iwan.models import Model, sine_motion
from bayes_iwan.models.simulator import recorded_force

A_MM, F_HZ = 0.9, 20.0
OMEGA = 2.0 * np.pi * F_HZ


def made(kit, class_name, tests=("a.csv", "b.csv")):
    kinds = (*catalogue.BUILT_IN, *catalogue.FORM)
    return next(k for k in kinds if k.__name__ == class_name)(kit.scales, tests)


def parameter_values_of(effect, draws=1, **given):
    """Medians of an effect's priors, and the given ones by short name."""
    out = {p.name: np.full(draws, float(p.value(np.zeros(1))[0])) for p in effect.parameters}
    unknown = {f"{effect.name}.{n}" for n in given} - set(out)
    assert not unknown
    return out | {f"{effect.name}.{n}": np.broadcast_to(np.asarray(v, float), (draws,)) for n, v in given.items()}


def added(effect, at, **given):
    """What an effect adds to a force of zero, (loops, samples)."""
    return effect.force(np.zeros((1, at.loops, at.samples)), at, parameter_values_of(effect, **given))[0]


def complex_harmonics(x):
    """c_h of Re Σ c_h exp(2πi h phase)."""
    c = np.fft.rfft(x, axis=-1) * 2.0 / x.shape[-1]
    c[..., 0] /= 2.0
    return c


def work(force, at):
    return np.mean(force * at.velocity_m_s[0] * 1e3 / at.frequency_hz[:, None], axis=-1)


def test_values_at_are_those_given_and_medians_of_the_rest(kit):
    effect = made(kit, "CubicStiffness")
    at = effect.values_at(k3_N_mm3=0.4)
    assert at["cubic_stiffness.k3_N_mm3"] == [0.4] and at["cubic_stiffness.exponent"][0] == pytest.approx(3.0)
    with pytest.raises(EffectError, match="cubic_stiffness has no parameter 'k3'"):
        effect.values_at(k3=0.4)


# ---- the functions that span them


def test_falling_is_exponential_hyperbolic_and_logarithmic():
    x = np.geomspace(1e-3, 30.0, 60)
    np.testing.assert_allclose(falling(x, np.zeros(1)), np.exp(-x), rtol=1e-4)
    np.testing.assert_allclose(falling(x, np.ones(1)), 1.0 / (1.0 + x), rtol=1e-12)
    q = 300.0  # large: the share lost grows with the logarithm of x
    np.testing.assert_allclose(q * (1.0 - falling(x, np.array([q]))), np.log1p(q * x), rtol=0.02)


def test_growing_is_logarithmic_proportional_and_close_to_prandtl_and_eyring():
    x = np.geomspace(1e-3, 1e3, 200)
    np.testing.assert_allclose(growing(x, np.zeros(1)), np.log1p(x), rtol=1e-6)
    np.testing.assert_allclose(growing(x, np.ones(1)), x, rtol=1e-12)
    np.testing.assert_allclose(growing(x, np.array([0.5])), 2.0 * (np.sqrt(1.0 + x) - 1.0), rtol=1e-12)
    x = np.geomspace(0.05, 50.0, 200)  # three decades of speed across the knee

    def error(p):
        return np.exp(p[0]) * growing(x * np.exp(p[1]), p[2:]) - np.arcsinh(x)

    found = optimize.least_squares(error, [0.0, 0.0, 0.0])
    assert np.abs(found.fun).max() < 0.025 * np.arcsinh(50.0)


def test_averages_over_a_block_of_cycles():
    at = replace(
        sine_motion(frequency_hz=F_HZ, amplitude_mm=[A_MM, A_MM]),
        cycle=np.array([2.5, 12.0]),
        span_cycles=np.array([5.0, 8.0]),
    )
    n = [np.linspace(0.0, 5.0, 20001), np.linspace(8.0, 16.0, 20001)]
    truth = [np.trapezoid(np.exp(-0.4 * x), x) / np.ptp(x) for x in n]
    np.testing.assert_allclose(decay_over_block(at, np.array(0.4)), truth, rtol=1e-6)
    np.testing.assert_allclose(
        over_block(at, lambda x: np.exp(-0.1 * x)), decay_over_block(at, np.array(0.1)), rtol=1e-4
    )


# ---- inside the specimen


@pytest.mark.parametrize("p", [0.4, 1.0, 1.6])
def test_power_law_damper_dissipates_what_its_integral_says(p, kit):
    at, c = sine_motion(frequency_hz=[F_HZ, 8.0], amplitude_mm=[A_MM, 0.3], samples=4096), 0.003
    effect = made(kit, "ViscousDamping")
    top = 1e3 * kit.scales.speed_m_s  # mm/s
    speed = 2.0 * np.pi * at.frequency_hz * at.amplitude_mm
    per_cycle = 2.0 * np.sqrt(np.pi) * special.gamma(0.5 * p + 1.0) / special.gamma(0.5 * p + 1.5)
    expected = c * top * (speed / top) ** p * at.amplitude_mm * per_cycle
    np.testing.assert_allclose(
        work(added(effect, at, c_N_s_mm=c, exponent=p, thinning_m_s=1e-9), at), expected, rtol=1e-5
    )


def test_carreau_damper_is_a_dashpot_at_low_and_a_power_at_high_speed(kit):
    at, effect = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=64), made(kit, "ViscousDamping")
    top, bend = kit.scales.speed_m_s, 0.2 * kit.scales.speed_m_s
    force = added(effect, at, c_N_s_mm=0.003, exponent=0.5, thinning_m_s=bend)[0]
    v = at.velocity_m_s[0, 0]
    zero_shear = 3.0 * (1.0 + (top / bend) ** 2) ** 0.25  # N s/m, so that the secant at the largest speed is 3
    np.testing.assert_allclose(force.ravel(), zero_shear * v * (1.0 + (v / bend) ** 2) ** -0.25, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("a", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("x", [0.1, 1.0, 10.0])
def test_fractional_maxwell_branch_has_cole_and_coles_storage_and_loss(a, x, kit):
    at, k = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM), 0.7
    c = complex_harmonics(added(made(kit, "MaxwellBranch"), at, k_N_mm=k, tau_s=x / OMEGA, spread=a))[0, 1] / (
        -1j * A_MM
    )
    xa, turn = x**a, 0.5 * np.pi * a
    below = 1.0 + 2.0 * xa * np.cos(turn) + xa**2
    assert c.real == pytest.approx(k * xa * (xa + np.cos(turn)) / below, rel=1e-9)
    assert c.imag == pytest.approx(k * xa * np.sin(turn) / below, rel=1e-9)


@pytest.mark.parametrize("n", [1.5, 2.0, 2.6])
def test_power_of_an_even_spring_by_its_mean_force(n, kit):
    at, k2 = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=4096), 0.4
    force = added(made(kit, "QuadraticStiffness"), at, k2_N_mm2=k2, exponent=n)
    length = kit.scales.length_mm
    mean = special.gamma(0.5 * n + 0.5) / special.gamma(0.5 * n + 1.0) / np.sqrt(np.pi)
    assert force.mean() == pytest.approx(k2 * length**2 * (A_MM / length) ** n * mean, rel=1e-6)
    assert abs(work(force, at)[0]) < 1e-6


@pytest.mark.parametrize("n", [1.6, 3.0, 4.4])
def test_power_of_an_odd_spring_by_its_first_harmonic(n, kit):
    at, k3 = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=4096), -0.5
    force = added(made(kit, "CubicStiffness"), at, k3_N_mm3=k3, exponent=n)
    length = kit.scales.length_mm
    first = 2.0 / np.sqrt(np.pi) * special.gamma(0.5 * n + 1.0) / special.gamma(0.5 * n + 1.5)
    expected = k3 * length**3 * (A_MM / length) ** n * first
    assert complex_harmonics(force)[0, 1] == pytest.approx(-1j * expected, rel=1e-5)


def test_a_bent_spring_is_trilinear_where_its_bends_are_sharp_and_linear_below_them(kit):
    at, length = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=512), kit.scales.length_mm
    x = at.displacement_mm[0] / length
    sharp = added(made(kit, "TrilinearStiffness"), at, k3_N_mm3=2.0, knee=0.3, width=0.01)
    expected = 2.0 * length**3 * np.sign(x) * np.maximum(np.abs(x) - 0.3, 0.0) / 0.7
    np.testing.assert_allclose(sharp, expected, atol=0.01 * 2.0 * length**3)
    round_ = added(made(kit, "TrilinearStiffness"), at, k3_N_mm3=2.0, knee=0.3, width=0.3)
    assert abs(work(round_, at)[0]) < 1e-6
    tiny = sine_motion(frequency_hz=F_HZ, amplitude_mm=1e-4 * length, samples=64)
    assert (
        np.abs(added(made(kit, "TrilinearStiffness"), tiny, k3_N_mm3=2.0, knee=0.3, width=0.3)).max() < 1e-6
    )  # no slope
    full = sine_motion(frequency_hz=F_HZ, amplitude_mm=length, samples=64)
    assert added(made(kit, "TrilinearStiffness"), full, k3_N_mm3=2.0, knee=0.6, width=0.2).max() == pytest.approx(
        2.0 * length**3
    )


@pytest.mark.parametrize("e", [1.0, 1.5])
def test_contacts_are_linear_or_hertzian_on_one_side_or_both(e, kit):
    at = sine_motion(frequency_hz=F_HZ, amplitude_mm=[A_MM, 0.3], samples=256)
    deep = np.maximum(np.abs(at.displacement_mm[0]) - 0.5, 0.0)
    scale = 0.1 * kit.scales.length_mm
    hertz = 6.0 * scale * (deep / scale) ** e
    both = added(made(kit, "EndStops"), at, k_N_mm=6.0, clearance_mm=0.5, exponent=e, loss_s_m=0.0)
    np.testing.assert_allclose(both, np.sign(at.displacement_mm[0]) * hertz, rtol=1e-9, atol=1e-12)
    low = added(made(kit, "EndStop"), at, k_N_mm=-6.0, clearance_mm=0.5, exponent=e, loss_s_m=0.0)
    np.testing.assert_allclose(low, np.where(at.displacement_mm[0] < 0.0, -hertz, 0.0), rtol=1e-9, atol=1e-12)
    assert np.abs(both[1]).max() < 1e-200  # 0.3 mm reaches neither


@pytest.mark.parametrize("s", [-1.0, 0.3])
def test_a_one_way_damper_damps_as_much_in_all(s, kit):
    at, c = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=4096), 0.003
    force = added(made(kit, "ViscousDamping"), at, c_N_s_mm=c, exponent=1.0, one_way=s)[0]
    rising = at.velocity_m_s[0, 0] > 0.0
    np.testing.assert_allclose(force[rising], c * 1e3 * at.velocity_m_s[0, 0, rising] * (1.0 + s), rtol=1e-9)
    np.testing.assert_allclose(force[~rising], c * 1e3 * at.velocity_m_s[0, 0, ~rising] * (1.0 - s), rtol=1e-9)
    assert work(force[None], at)[0] == pytest.approx(np.pi * c * OMEGA * A_MM**2, rel=1e-6)


@pytest.mark.parametrize("f_m, zeta", [(37.0, 0.05), (70.0, 0.3), (400.0, 0.1)])
def test_a_mass_on_a_mount_pushes_as_the_mounts_equation_says(f_m, zeta, kit):
    """m(ÿ + ü) = −k y − c ẏ for the mass's way y on a base that moves by u; the spring of the mount pushes by k y."""
    at, m = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM), 0.02
    force = added(made(kit, "MovingMass"), at, m_kg=m, period_s=1.0 / f_m, damping=zeta)
    w0, a0 = 2.0 * np.pi * f_m, -(OMEGA**2) * (-1j * A_MM * 1e-3)  # u = A sin, so u ~ −iA
    y = -a0 / (w0**2 - OMEGA**2 + 2j * zeta * w0 * OMEGA)
    assert complex_harmonics(force)[0, 1] == pytest.approx(-m * w0**2 * y, rel=1e-9)


def test_a_rigidly_held_mass_is_the_limit(kit):
    at, m = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM), 0.02
    force = added(made(kit, "MovingMass"), at, m_kg=m, period_s=1e-6)
    np.testing.assert_allclose(force[0], m * at.acceleration_m_s2[0, 0], rtol=1e-4, atol=1e-4)


def test_a_spring_that_acts_on_one_side(kit):
    at, k2 = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=256), 0.4
    u = at.displacement_mm[0, 0]
    force = added(made(kit, "QuadraticStiffness"), at, k2_N_mm2=k2, exponent=2.0, one_sided=-1.0)[0]
    np.testing.assert_allclose(force, np.where(u < 0.0, 2.0 * k2 * u**2, 0.0), rtol=1e-9, atol=1e-12)


def test_a_contact_that_loses_energy_is_hunt_and_crossleys(kit):
    at = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=4096)
    k, gap, loss = 6.0, 0.5, 2.0
    force = added(made(kit, "EndStop"), at, k_N_mm=k, clearance_mm=gap, exponent=1.0, loss_s_m=loss)
    u, v = at.displacement_mm[0, 0], at.velocity_m_s[0, 0]
    np.testing.assert_allclose(force[0], k * np.maximum(u - gap, 0.0) * (1.0 + loss * v), rtol=1e-9, atol=1e-12)
    # ∮ k λ d v du over the way in and out: 2 k λ ∫ (u − g) v du, v = ω √(A² − u²)
    lost = integrate.quad(lambda x: (x - gap) * OMEGA * 1e-3 * np.sqrt(A_MM**2 - x**2), gap, A_MM)[0]
    assert work(force, at)[0] == pytest.approx(2.0 * k * loss * lost, rel=1e-5)
    hard = added(made(kit, "EndStop"), at, k_N_mm=k, clearance_mm=gap, exponent=1.0, loss_s_m=200.0)
    assert hard.min() == 0.0  # a contact does not pull


def test_contacts_on_both_sides_lose_energy_alike(kit):
    at = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=4096)
    force = added(made(kit, "EndStops"), at, k_N_mm=6.0, clearance_mm=0.5, exponent=1.0, loss_s_m=2.0)[0]
    u, v = at.displacement_mm[0, 0], at.velocity_m_s[0, 0]
    upper, lower = np.maximum(u - 0.5, 0.0) * (1.0 + 2.0 * v), np.maximum(-u - 0.5, 0.0) * (1.0 - 2.0 * v)
    np.testing.assert_allclose(force, 6.0 * (upper - lower), rtol=1e-9, atol=1e-12)


def test_the_corner_of_a_low_pass_is_where_a_first_order_turns_by_45_degrees(kit):
    effect = made(kit, "ForceLowpass")
    at = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM)
    given = parameter_values_of(effect, tau_s=1.0 / OMEGA, second=0.0)
    corner, unit = effect.reported(given)["corner_hz"]
    assert unit == "Hz" and corner == pytest.approx(F_HZ)
    c = complex_harmonics(effect.force(np.cos(2.0 * np.pi * np.arange(128) / 128)[None, None], at, given)[0, 0])[1]
    assert np.angle(c) == pytest.approx(-np.pi / 4.0) and abs(c) == pytest.approx(np.sqrt(0.5))


def test_limits_of_an_offset_range_are_unequal(kit):
    at = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM)
    force_N = 10.0 * at.displacement_mm[None] / A_MM
    given = parameter_values_of(
        made(kit, "ForceClipping"), inverse_limit_1_N=1.0 / 5.0, softness=2e-3, unequal=np.log(1.4)
    )
    seen = made(kit, "ForceClipping").force(force_N, at, given)
    assert seen.max() == pytest.approx(7.0, rel=1e-2) and seen.min() == pytest.approx(-5.0 / 1.4, rel=1e-2)


# ---- on the friction


@pytest.mark.parametrize(
    ("exponent", "tail", "classic"),
    [
        (1.0, 0.0, lambda x: np.exp(-x)),  # Tustin
        (2.0, 0.0, lambda x: np.exp(-x * x)),  # Gaussian
        (0.5, 0.0, lambda x: np.exp(-np.sqrt(x))),  # Bo and Pavelescu
        (2.0, 1.0, lambda x: 1.0 / (1.0 + x * x)),  # Hess and Soom
    ],
)
def test_stribeck_curves_of_the_literature(exponent, tail, classic, kit):
    effect, at = made(kit, "StribeckWeakening"), sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=64)
    given = {"drop": 0.3, "v_s_m_s": 0.05, "memory_s": 0.0, "exponent": exponent, "tail": tail}
    got = effect.slip(np.ones((1, 1, 64)), at, parameter_values_of(effect, **given))
    expected = 1.0 - 0.3 * (1.0 - classic(at.speed_m_s / 0.05))
    np.testing.assert_allclose(got, expected, rtol=1e-5)


def test_rate_strengthening_is_a_logarithm_or_a_power(kit):
    effect, at = made(kit, "RateStrengthening"), sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=64)
    for power, law in ((0.0, np.log1p), (0.5, lambda x: 2.0 * (np.sqrt(1.0 + x) - 1.0))):
        parameter_values = parameter_values_of(effect, c=0.1, v0_m_s=0.01, memory_s=0.0, power=power)
        got = effect.slip(np.ones((1, 1, 64)), at, parameter_values)
        np.testing.assert_allclose(got, 1.0 + 0.1 * law(at.speed_m_s / 0.01), rtol=1e-6)


def test_lag_from_a_start_against_the_integrated_relaxation(kit):
    effect, f, tau = made(kit, "NormalForceLagFromStart"), 5.0, 0.3

    def steady(t):
        return 1.0 + 0.3 * np.sin(2.0 * np.pi * f * t)

    def slope(t, a):
        return (steady(t) - a) / tau

    t = np.linspace(0.0, 4.0, 20 * 256 + 1)
    solved = integrate.solve_ivp(slope, (0.0, 4.0), [1.0], t_eval=t, rtol=1e-9, atol=1e-11).y[0][:-1].reshape(20, 256)
    blocks = solved.reshape(5, 4, 256).mean(axis=1)
    at = replace(
        sine_motion(frequency_hz=f, amplitude_mm=np.full(5, A_MM), samples=256),
        cycle=4.0 * np.arange(5) + 2.0,
        span_cycles=np.full(5, 4.0),
    )
    turned = 0.3 / (1.0 + 2j * np.pi * f * tau)
    start = 1.0 - (1.0 + turned.imag)  # α(0) less the steady loop's value there
    alpha = steady(np.arange(256) / 256.0 / f) * np.ones((1, 5, 1))
    # all of it slow, and nothing fast: the share and the ratio say the same in two ways
    for given in ({"slow_share": 0.0, "slow_ratio": 1.0}, {"slow_share": 1.0, "slow_ratio": 1.0}):
        got = effect.normal_force(alpha, at, parameter_values_of(effect, tau_s=tau, start=start, **given))[0]
        np.testing.assert_allclose(got.mean(axis=1), blocks.mean(axis=1), atol=3e-5)
        np.testing.assert_allclose(got[-1], blocks[-1], atol=2e-3)
    assert abs(blocks[0].mean() - blocks[-1].mean()) > 0.01


@pytest.mark.parametrize(("tau", "release"), [(0.02, 0.0), (0.02, 1.0), (0.2, 1.5), (2.0, -1.0), (1e-4, 0.7)])
def test_a_normal_force_that_is_let_go_later_than_taken_up(tau, release, kit):
    effect, f = made(kit, "NormalForceLag"), 5.0
    up, down = tau * np.exp(-0.5 * release), tau * np.exp(0.5 * release)

    def wanted(t):
        return 1.0 + 0.3 * np.sin(2.0 * np.pi * f * t)

    def slope(t, a):
        return (wanted(t) - a) / (up if wanted(t) > a else down)

    at = sine_motion(frequency_hz=f, amplitude_mm=A_MM, samples=256)
    late = effect.normal_force(
        wanted(np.arange(256) / 256.0 / f)[None, None], at, parameter_values_of(effect, tau_s=tau, release=release)
    )[0, 0]
    # the loop that was found goes on as the equation says, and ends where it began
    t = np.arange(257) / 256.0 / f
    solved = integrate.solve_ivp(slope, (0.0, t[-1]), [late[0]], t_eval=t, rtol=1e-9, atol=1e-11, max_step=1e-3).y[0]
    np.testing.assert_allclose(solved, np.append(late, late[0]), atol=1e-3 * np.ptp(late) + 1e-5)
    assert (late.mean() > 1.005) == (release > 0.0 and tau > 1e-3)  # it stays up longer


def test_a_slow_part_of_the_normal_force_has_a_time_of_its_own(kit):
    effect, at = made(kit, "NormalForceLagFromStart"), sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=256)
    alpha = 1.0 + 0.3 * at.displacement_mm[0, 0] / A_MM
    given = parameter_values_of(effect, tau_s=0.5 / OMEGA, release=0.0, start=0.0, slow_share=0.3, slow_ratio=8.0)
    got = complex_harmonics(effect.normal_force(alpha[None, None], at, given)[0])[0, 1]
    expected = 0.7 / (1.0 + 0.5j) + 0.3 / (1.0 + 4.0j)
    assert got / complex_harmonics(alpha[None])[0, 1] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("second", [0.0, 0.1, 0.25, 0.5])
def test_a_mean_force_that_leaks_away_against_the_filter_run_in_time(second, kit):
    f, corner, stood, mean = 5.0, 0.3, 2, 2.0
    effect, w = made(kit, "ForceHighpassFromStart"), 2.0 * np.pi * corner
    t = np.arange((stood + 20) * 256) / 256.0 / f
    wave = mean + np.sin(2.0 * np.pi * f * t)
    _, seen, _ = signal.lsim(([1.0, 0.0, 0.0], [1.0, w, second * w * w]), wave, t, interp=True)
    seen = seen[stood * 256 :].reshape(5, 4, 256).mean(axis=1)
    at = replace(
        sine_motion(frequency_hz=f, amplitude_mm=np.full(5, A_MM), samples=256),
        cycle=4.0 * np.arange(5) + 2.0,
        span_cycles=np.full(5, 4.0),
    )
    given = parameter_values_of(
        effect, corner_hz=corner, second=second, kept=0.0, held_cycles=float(stood), held_share=1.0
    )
    got = effect.force(wave[:256] * np.ones((1, 5, 1)), at, given)[0]
    np.testing.assert_allclose(got[1:], seen[1:], atol=0.03)
    assert np.ptp(seen.mean(axis=1)) > 0.08  # the transient was there
    off = parameter_values_of(effect, corner_hz=0.0)
    np.testing.assert_array_equal(
        effect.force(wave[:256] * np.ones((1, 5, 1)), at, off)[0], wave[:256] * np.ones((5, 1))
    )


def faded(kit, at, **given):
    effect = made(kit, "FrictionFade")
    parameter_values = parameter_values_of(
        effect, **{"drop": 0.4, "cycles": 10.0, "tail": 0.0, "recovery": 0.0} | given
    )
    alpha = np.ones((1, at.loops, at.samples))
    return effect.slip(alpha, at, parameter_values)[0, :, 0], effect.stiffness(
        5.0 * alpha, alpha, at, parameter_values
    )[0, :, 0]


def test_fade_by_cycles_by_sliding_distance_and_with_stiffness(kit):
    length = kit.scales.length_mm
    at = replace(
        sine_motion(frequency_hz=F_HZ, amplitude_mm=[length, 0.5 * length], samples=8),
        cycle=np.array([15.0, 30.0]),
        span_cycles=np.zeros(2),
    )
    n = at.cycle
    friction, stiffness = faded(kit, at)
    np.testing.assert_allclose(friction, 1.0 - 0.4 * (1.0 - np.exp(-n / 10.0)), rtol=1e-6)
    np.testing.assert_array_equal(stiffness, 5.0)
    hyperbolic, _ = faded(kit, at, tail=1.0)
    np.testing.assert_allclose(hyperbolic, 1.0 - 0.4 * (1.0 - 1.0 / (1.0 + n / 10.0)), rtol=1e-9)
    # as much sliding, as much fade: 30 cycles of half the amplitude are 15 of the whole
    slid, _ = faded(kit, at, by_stroke=1.0)
    assert slid[0] == pytest.approx(slid[1], rel=1e-12)
    friction, stiffness = faded(kit, at, of_stiffness=1.0)
    np.testing.assert_allclose(stiffness / 5.0, friction, rtol=1e-12)
    recovered, _ = faded(kit, at, recovery=0.5)
    np.testing.assert_allclose(recovered, 1.0 - 0.4 * (1.0 - np.exp(-n / 10.0)) * np.exp(-n / 20.0), rtol=1e-6)


def test_fade_by_time_and_with_the_power_that_heats(kit):
    length, speed = kit.scales.length_mm, kit.scales.speed_m_s
    at = replace(
        sine_motion(frequency_hz=[F_HZ, 0.5 * F_HZ], amplitude_mm=[length, 0.5 * length], samples=8),
        cycle=np.array([40.0, 20.0]),  # as long in time
        span_cycles=np.zeros(2),
    )
    reference_hz = 1e3 * speed / (2.0 * np.pi * length)
    friction, _ = faded(kit, at, by_time=1.0)
    np.testing.assert_allclose(
        friction, 1.0 - 0.4 * (1.0 - np.exp(-40.0 / F_HZ * reference_hz / 10.0)), rtol=1e-6
    )  # both alike
    friction, _ = faded(kit, at, by_time=1.0, by_power=1.0, drop=0.1)
    assert (1.0 - friction[0]) / (1.0 - friction[1]) == pytest.approx(4.0, rel=1e-9)
    friction, _ = faded(kit, at, by_power=-2.5, drop=0.9)
    lost = 0.9 * (1.0 - np.exp(-at.cycle / 10.0)) * (at.frequency_hz / reference_hz * at.amplitude_mm / length) ** -2.5
    np.testing.assert_allclose(friction, np.maximum(1.0 - lost, 0.05), rtol=1e-6)  # a twentieth is left whatever it is
    assert friction[0] > 0.1 and friction[1] == 0.05


def test_springs_soften_by_time_by_cycles_and_with_power(kit):
    effect = made(kit, "SpringSoftening")
    length, speed = kit.scales.length_mm, kit.scales.speed_m_s
    at = replace(
        sine_motion(frequency_hz=[F_HZ, 0.5 * F_HZ], amplitude_mm=[length, 0.5 * length], samples=8),
        cycle=np.array([40.0, 20.0]),  # as long in time
        span_cycles=np.zeros(2),
    )

    def left(**given):
        own = {"drop": 0.3, "tau_s": 1.5, "tail": 0.0, "by_cycles": 0.0, "by_power": 0.0} | given
        return effect.left(at, parameter_values_of(effect, **own))[0, :, 0]

    np.testing.assert_allclose(left(), 1.0 - 0.3 * (1.0 - np.exp(-40.0 / F_HZ / 1.5)), rtol=1e-6)
    reference_hz = 1e3 * speed / (2.0 * np.pi * length)
    cycles = left(by_cycles=1.0)
    np.testing.assert_allclose(cycles, 1.0 - 0.3 * (1.0 - np.exp(-at.cycle / (1.5 * reference_hz))), rtol=1e-6)
    lost = 1.0 - left(by_power=1.0)
    assert lost[0] / lost[1] == pytest.approx(4.0, rel=1e-9)  # twice the frequency at twice the amplitude
    lost = 1.0 - left(drop=1.2, by_power=-1.0)  # a twentieth is left, however much the power would take
    np.testing.assert_allclose(lost, [1.2 * (1.0 - np.exp(-40.0 / F_HZ / 1.5)) * reference_hz / F_HZ, 0.95], rtol=1e-6)
    lost = 1.0 - left(by_amplitude=1.0)
    assert lost[0] / lost[1] == pytest.approx(2.0, rel=1e-9)  # loops that widen with the amplitude

    # all springs: a specimen that is a spring loses as much of its force
    model, parameter_values = kit.elastic(kit.reference)
    own = parameter_values_of(effect, drop=0.3, tau_s=1.5, tail=0.0, by_cycles=0.0, by_power=0.0)
    plain = recorded_force(model, (), parameter_values, at)[0]
    soft = recorded_force(model, (effect,), parameter_values | own, at)[0]
    np.testing.assert_allclose(soft, left()[:, None] * plain, atol=1e-9)


def test_self_tightening_moves_normal_force_and_so_the_stiffness(kit):
    effect, at = (
        made(kit, "DirectionDependentNormalForce"),
        sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=64),
    )
    parameter_values = parameter_values_of(effect, asymmetry=0.2, v0_m_s=1e-6)
    alpha = effect.normal_force(np.ones((1, 1, 64)), at, parameter_values)[0, 0]
    assert alpha[0] == pytest.approx(1.2) and alpha[32] == pytest.approx(0.8)
    model = Model(kit.reference)
    base = kit.parameter_values(model)
    small = sine_motion(
        frequency_hz=F_HZ, amplitude_mm=0.02, samples=64
    )  # all elements stick: the force's size is the stiffness's
    force = recorded_force(model, (effect,), base | parameter_values, small)[0, 0]
    plain = recorded_force(model, (), base, small)[0, 0]
    assert np.ptp(force) != pytest.approx(np.ptp(plain), rel=1e-3)


def test_slip_forces_that_lean_with_the_speed_leave_the_stiffness(kit):
    effect, at = made(kit, "DirectionDependentSlip"), sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=64)
    v0 = 0.3 * 1e-3 * A_MM * OMEGA
    own = parameter_values_of(effect, asymmetry=0.2, v0_m_s=v0)
    slip = effect.slip(np.ones((1, 1, 64)), at, own)[0, 0]
    np.testing.assert_allclose(slip, 1.0 + 0.2 * np.tanh(np.ravel(at.velocity_m_s) / v0), rtol=1e-12)
    np.testing.assert_array_equal(effect.normal_force(np.ones((1, 1, 64)), at, own), 1.0)
    model = Model(kit.reference)
    base = kit.parameter_values(model)
    small = sine_motion(frequency_hz=F_HZ, amplitude_mm=1e-6, samples=64)  # hardly an element slips
    force, plain = (recorded_force(model, some, base | own, small)[0, 0] for some in ((effect,), ()))
    assert np.ptp(force) == pytest.approx(np.ptp(plain), rel=1e-3)
    force, plain = (recorded_force(model, some, base | own, at)[0, 0] for some in ((effect,), ()))
    assert abs(np.mean(force - plain)) > 0.01 * np.std(plain)  # where they slip the force leans


# ---- in series


def test_a_moved_specimen_has_the_speeds_of_its_own_displacement():
    """Central differences of what moves it: x = 0.2·cos 2ωt beside the recorded sine, to the square of a step."""
    at = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=512)
    phase, step = 4.0 * np.pi * np.arange(512) / 512, 4.0 * np.pi / 512
    moved = moved_by(at, at.displacement_mm + 0.2 * np.cos(phase))
    size = 0.2e-3 * 2.0 * OMEGA  # m/s
    velocity, acceleration = at.velocity_m_s - size * np.sin(phase), -size * 2.0 * OMEGA * np.cos(phase)
    np.testing.assert_allclose(moved.velocity_m_s, velocity, atol=size * step**2)
    np.testing.assert_allclose(
        moved.acceleration_m_s2, at.acceleration_m_s2 + acceleration, atol=size * 2.0 * OMEGA * step**2
    )
    np.testing.assert_array_equal(moved_by(at, at.displacement_mm).velocity_m_s, at.velocity_m_s)


def test_soft_first_part_of_a_compliance_by_root_finding(kit):
    model, parameter_values = kit.elastic(kit.reference)  # 10 N/mm
    effect, at = made(kit, "RigCompliance"), sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=64)
    compliance, ratio, first = 0.004, 4.0, 1.5
    own = parameter_values_of(effect, compliance_mm_N=compliance, soft_ratio=ratio, soft_N=first)
    force = recorded_force(model, (effect,), parameter_values | own, at)[0, 0]

    def moved(f):
        return f / 10.0 + compliance * (f + (ratio - 1.0) * first * (1.0 - np.exp(-abs(f) / first)) * np.sign(f))

    truth = [optimize.brentq(lambda f, u=u: moved(f) - u, -20.0, 20.0) for u in at.displacement_mm[0, 0]]
    np.testing.assert_allclose(force, truth, atol=1e-6)
    assert np.abs(force - at.displacement_mm[0, 0] / (0.1 + compliance)).max() > 0.1


@pytest.mark.parametrize("soft", [1e-9, 0.2, 0.5])
def test_play_with_soft_ends_on_a_spring(soft, kit):
    model, parameter_values = kit.elastic(kit.reference)
    effect, at = made(kit, "FreePlay"), sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=512)
    own = parameter_values_of(effect, play_mm=0.2, softness=soft)
    force, u = recorded_force(model, (effect,), parameter_values | own, at)[0, 0], at.displacement_mm[0, 0]
    order = np.argsort(u)
    rises = np.diff(force[order]) > -mounting.TOLERANCE * force.max()
    assert np.all(rises) and abs(work(force[None], at)[0]) < 1e-6  # elastic
    w = soft * 0.1
    expected = 10.0 * integrate.cumulative_trapezoid(
        special.expit((np.linspace(0, A_MM, 200001) - 0.1) / w)
        + special.expit((-np.linspace(0, A_MM, 200001) - 0.1) / w),
        np.linspace(0, A_MM, 200001),
        initial=0.0,
    )
    np.testing.assert_allclose(force[u >= 0], np.interp(u[u >= 0], np.linspace(0, A_MM, 200001), expected), atol=2e-4)


# ---- measuring channels


def transfer(kit, class_name, hz=F_HZ, **given):
    """Response of a force effect at harmonics 1 … 12."""
    effect, at = made(kit, class_name), sine_motion(frequency_hz=hz, amplitude_mm=A_MM, samples=64)
    rng = np.random.default_rng(4)
    force = np.fft.irfft(np.r_[0.3, rng.normal(size=12) + 1j * rng.normal(size=12), np.zeros(20)], n=64)
    out = effect.force(force[None, None], at, parameter_values_of(effect, **given))[0, 0]
    return (np.fft.rfft(out) / np.fft.rfft(force))[1:13], hz * np.arange(1, 13)


@pytest.mark.parametrize("hz", [F_HZ, 1e-3 * F_HZ])
def test_filters_are_of_first_order_or_butterworths_of_second(hz, kit):
    corner = 3.5 * hz
    for kind, class_name, name, value in (
        ("low", "ForceLowpass", "tau_s", np.sqrt(2.0) / (2.0 * np.pi * corner)),
        ("high", "ForceHighpass", "corner_hz", np.sqrt(2.0) * corner),
    ):
        got, f = transfer(kit, class_name, hz, **{name: value, "second": 0.5})
        b, a = signal.butter(2, 2.0 * np.pi * corner, kind, analog=True)
        np.testing.assert_allclose(got, signal.freqs(b, a, 2.0 * np.pi * f)[1], rtol=1e-9)
        one = value / np.sqrt(2.0)
        got, f = transfer(kit, class_name, hz, **{name: one, "second": 0.0})
        b, a = signal.butter(1, 2.0 * np.pi * corner, kind, analog=True)
        np.testing.assert_allclose(got, signal.freqs(b, a, 2.0 * np.pi * f)[1], rtol=1e-9)


def test_a_shelf_keeps_a_share_far_below_its_corner(kit):
    """Against (iω + g w)/(iω + w), a leak that another resistance bounds."""
    corner, kept = 70.0, 0.2
    got, f = transfer(kit, "ForceHighpass", corner_hz=corner, second=0.0, kept=kept)
    np.testing.assert_allclose(got, (1j * f + kept * corner) / (1j * f + corner), rtol=1e-9)
    effect, at = made(kit, "ForceHighpass"), sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=64)
    own = parameter_values_of(effect, corner_hz=corner, second=0.0, kept=kept)
    assert effect.force(np.full((1, 1, 64), 2.0), at, own)[0, 0, 0] == pytest.approx(2.0 * kept)  # the mean comes too


def test_integrators_highpass_of_second_order_is_undone(kit):
    effect, true = made(kit, "IntegrationHighpass"), sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=64)
    corner = 3.0
    b, a = signal.butter(2, 2.0 * np.pi * corner, "high", analog=True)
    gain = signal.freqs(b, a, [OMEGA])[1][0]
    seen = true.moved(
        *(
            np.fft.irfft(np.fft.rfft(x) * gain, n=64)
            for x in (true.displacement_mm, true.velocity_m_s, true.acceleration_m_s2)
        )
    )
    seen = seen.moved(seen.displacement_mm + 0.2, seen.velocity_m_s, seen.acceleration_m_s2)  # the mean is as recorded
    back = effect.motion(seen, parameter_values_of(effect, corner_hz=np.sqrt(2.0) * corner, second=0.5))
    np.testing.assert_allclose(back.displacement_mm, true.displacement_mm + 0.2, atol=1e-12)


def test_dispersive_delay_follows_a_power_and_an_all_pass_lies_between(kit):
    reference = 1e3 * kit.scales.speed_m_s / (2.0 * np.pi * kit.scales.length_mm)
    got, f = transfer(kit, "ChannelDelay", delay_s=4e-4, dispersion=-0.3)
    np.testing.assert_allclose(got, np.exp(-2j * np.pi * f * 4e-4 * (f / reference) ** -0.3), rtol=1e-9)
    f = F_HZ * np.arange(1, 8)
    all_pass = 2.0 * np.arctan(0.5 * 2.0 * np.pi * f * 2e-3)  # first order, 2 ms: 43 % short of a delay at the end

    def error(p):
        return 2.0 * np.pi * f * p[0] * (f / reference) ** p[1] - all_pass

    found = optimize.least_squares(error, [2e-3, 0.0])
    delay_alone = optimize.least_squares(lambda p: error([p[0], 0.0]), [2e-3])
    assert np.abs(found.fun).max() < 0.35 * np.abs(delay_alone.fun).max()


@pytest.mark.parametrize(
    ("soft", "law"), [(0.5, lambda x: x / np.sqrt(1.0 + x * x)), (1.0, lambda x: x / (1.0 + np.abs(x)))]
)
def test_soft_clipping(soft, law, kit):
    effect = made(kit, "ForceClipping")
    force = np.linspace(-6.0, 6.0, 64)[None, None]
    got = effect.force(
        force,
        sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=64),
        parameter_values_of(effect, inverse_limit_1_N=0.5, softness=soft),
    )
    np.testing.assert_allclose(got, 2.0 * law(force / 2.0), rtol=1e-12)


def test_compliance_in_series_with_friction_has_converged(kit):
    """Friction F(x) behind a compliance C: at the positions x that the effect arrives at, u = x + C·F(x)."""
    model, effect, at = (
        Model(kit.reference),
        made(kit, "RigCompliance"),
        sine_motion(frequency_hz=F_HZ, amplitude_mm=[A_MM, 0.4], samples=128),
    )
    base = kit.parameter_values(model)
    for compliance in (0.006, 0.02):
        force = recorded_force(model, (effect,), base | parameter_values_of(effect, compliance_mm_N=compliance), at)
        specimen = moved_by(at, at.displacement_mm - compliance * force)
        again = recorded_force(model, (), base, specimen)
        moved = force - recorded_force(model, (), base, at)
        assert np.sqrt(np.mean((again - force) ** 2)) < 1e-6 * np.sqrt(np.mean(moved**2))


def test_a_fade_by_power_or_by_time_is_that_of_cycles_at_the_campaign_s_own_speed(kit):
    """2π f A over the campaign's speed, and 2π f ℓ over it, are what the powers are taken of."""
    effect = made(kit, "FrictionFade")
    length, speed = kit.scales.length_mm, kit.scales.speed_m_s
    hz = speed / (2e-3 * np.pi * length)
    given = {"drop": 0.3, "cycles": 6.0, "tail": 0.0, "recovery": 0.0}

    def lost(frequency_hz, **powers):
        at = replace(sine_motion(frequency_hz=frequency_hz, amplitude_mm=length), cycle=np.array([9.0]))
        return 1.0 - effect.left(at, parameter_values_of(effect, **given, **powers))[0, 0, 0]

    for name in ("by_power", "by_time"):
        assert lost(hz, **{name: 1.0}) == pytest.approx(lost(hz, **{name: 0.0}), rel=1e-12)
    assert lost(2.0 * hz, by_power=1.0) == pytest.approx(2.0 * lost(2.0 * hz, by_power=0.0), rel=1e-12)
    assert lost(2.0 * hz, by_time=1.0) < 0.9 * lost(2.0 * hz, by_time=0.0)
