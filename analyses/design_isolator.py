"""What an isolator's designer is after: transmissibility and peak displacement of a mass on the identified isolator.

    python analyses/design_isolator.py RUN --mass 1.0 --base-mm 0.2 --shock-g 2 --shock-ms 6 --out design.png

RUN is a folder that `bayes-iwan identify` wrote. Every curve is computed for many posterior draws by integrating
m·ü = −F(u, u̇) − m·a_base in time, u the isolator's stretch, F from Jenkins elements updated step by step, so the
bands are what the tests leave open. Change the numbers on the command line, or the excitation below.

Eq. (11) needs the amplitude A of the motion, which a transient does not have. Here A is the largest |u| of the last
cycle in the sweep, and the largest |u| so far in the shock. Displacements beyond the tests' are marked.
"""

from __future__ import annotations

import argparse
import math

import numba as nb
import numpy as np

import bayes_iwan as bi
from bayes_iwan.models.embedded_error import CORNER_NAME, CORNER_WIDTH, STIFFNESS_NAME
from bayes_iwan.models.motion import Y_FLOOR
from bayes_iwan.models.normal_force import ALPHA_FLOOR
from bayes_iwan.report.axes import band
from bayes_iwan.report.style import BLUE, ORANGE, save, styled, subplots
from jenkins_elements import equal_probability_sliders

SLIDERS = 64
STEP_S = 2e-4


@nb.njit(error_model="numpy")
def force(u, v, amplitude, x, phi, p):
    """Isolator force in N at stretch u (mm), speed v (mm/s); slider positions x (mm) are moved along.

    p : kp, k1, stiffness ratio (0: constant stiffness), slope, rate, beta, reference length (mm), reference speed
    (mm/s), and the embedded model error's corner and exponent (0 without it).
    """
    y = max(amplitude - u, Y_FLOOR * amplitude) / p[6]
    grown = y ** p[5]
    alpha = 1.0 + p[3] * (grown - (amplitude / p[6]) ** p[5]) / p[5] + p[4] * grown * abs(v) / p[7]
    alpha = max(alpha, ALPHA_FLOOR) * math.exp(p[8] / (1.0 + ((amplitude - u) / (CORNER_WIDTH * amplitude)) ** 2))
    k = p[1] if p[2] == 0.0 else p[1] * math.expm1(-p[2] * alpha) / math.expm1(-p[2])
    k *= alpha ** p[9]
    total = 0.0
    for j in range(phi.size):
        reach = alpha * phi[j] / k
        stretch = min(max(u - x[j], -reach), reach)
        x[j] = u - stretch
        total += stretch
    return p[0] * u + k * total / phi.size


@nb.njit(error_model="numpy", parallel=True)
def sweep(hz, cycles, base_mm, mass_kg, phi, p):
    """Stepped sine from low to high: transmissibility and peak stretch (mm), both (draws, len(hz)).

    At each frequency `cycles` cycles are run on from the last state; the last five are evaluated.
    """
    draws = phi.shape[0]
    ratio, peak = np.empty((draws, hz.size)), np.empty((draws, hz.size))
    for d in nb.prange(draws):
        x = np.zeros(phi.shape[1])
        u, v = 0.0, 0.0
        amplitude = base_mm
        for i in range(hz.size):
            w = 2.0 * math.pi * hz[i]
            steps = max(math.ceil(1.0 / (hz[i] * STEP_S)), 100)
            dt = 1.0 / (hz[i] * steps)
            top, squares, count = 0.0, 0.0, 0
            for cycle in range(cycles):
                high = 0.0
                for s in range(steps):
                    base = -w * w * base_mm * math.sin(w * dt * s)  # mm/s²
                    f = force(u, v, amplitude, x, phi[d], p[d])
                    v += dt * (-1e3 * f / mass_kg - base)  # N/kg → mm/s²; semi-implicit Euler
                    u += dt * v
                    high = max(high, abs(u))
                    if cycle >= cycles - 5:
                        squares += (1e3 * f / mass_kg) ** 2
                        count += 1
                        top = max(top, abs(u))
                amplitude = max(high, 0.01 * base_mm)
            ratio[d, i] = math.sqrt(2.0 * squares / count) / (w * w * base_mm)
            peak[d, i] = top
    return ratio, peak


@nb.njit(error_model="numpy", parallel=True)
def shock(base_mm_s2, dt, mass_kg, phi, p):
    """Stretch (mm) and the mass's acceleration (m/s²) from rest, (draws, steps), for a base acceleration (steps,)."""
    draws = phi.shape[0]
    stretch, acceleration = np.empty((draws, base_mm_s2.size)), np.empty((draws, base_mm_s2.size))
    for d in nb.prange(draws):
        x = np.zeros(phi.shape[1])
        u, v, amplitude = 0.0, 0.0, 1e-3
        for s in range(base_mm_s2.size):
            amplitude = max(amplitude, abs(u))
            f = force(u, v, amplitude, x, phi[d], p[d])
            v += dt * (-1e3 * f / mass_kg - base_mm_s2[s])
            u += dt * v
            stretch[d, s], acceleration[d, s] = u, -f / mass_kg
    return stretch, acceleration


def element_values(posterior, n):
    """Slip forces (draws, SLIDERS) and the law's numbers (draws, 10) of n posterior draws."""
    problem = posterior.problem
    model, scales = problem.model, problem.scales
    if model.normal_force not in ("hunt_crossley", "hunt_crossley_no_speed", "constant"):
        raise ValueError(f"this analysis integrates Eq. (11); the run's normal force is {model.normal_force!r}")
    parameter_values = problem.parameter_values(posterior.flat_z(n))
    zero = np.zeros(len(parameter_values["kp_N_mm"]))
    p = np.stack(
        [
            parameter_values["kp_N_mm"],
            parameter_values["k1_N_mm"],
            parameter_values.get("stiffness_ratio", zero),
            parameter_values.get("normal_force_slope", zero),
            parameter_values.get("normal_force_rate", zero),
            parameter_values.get("beta", zero + 1.0),
            zero + scales.length_mm,
            zero + 1e3 * scales.speed_m_s,
            parameter_values.get(CORNER_NAME, zero),
            parameter_values.get(STIFFNESS_NAME, zero),
        ],
        axis=1,
    )
    family = model.slip_family
    phi = np.empty((len(p), SLIDERS))
    for d in range(len(p)):
        one = {k: v[d : d + 1] for k, v in parameter_values.items()}
        phi[d] = equal_probability_sliders(
            lambda at, one=one: family.survival(at, one)[0], SLIDERS, 20.0 * scales.slip_N
        )
    return phi, p


@styled
def figure(posterior, mass_kg=1.0, base_mm=0.2, shock_g=2.0, shock_ms=6.0, draws=40, hz=None, cycles=40):
    """Four panels: transmissibility and peak stretch against frequency; stretch and acceleration after the shock."""
    phi, p = element_values(posterior, draws)
    hz = np.geomspace(5.0, 40.0, 100) if hz is None else hz
    ratio, peak = sweep(hz, cycles, base_mm, mass_kg, phi, p)
    dt = 0.25 * STEP_S
    t = dt * np.arange(int(0.35 / dt))
    pulse = np.where(t < 1e-3 * shock_ms, 9806.65 * shock_g * np.sin(np.pi * t / (1e-3 * shock_ms)), 0.0)
    stretch, acceleration = shock(pulse, dt, mass_kg, phi, p)
    tested = posterior.problem.scales.length_mm

    made, axes = subplots(2, 2, 8.0, 6.0)
    a, b, c, d = axes.ravel()
    low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95], axis=0)
    thin = np.median((high - low) / middle) < 0.01
    band(a, hz, ratio, label="median" + (" (90 % band: hardly wider than the line)" if thin else ", 50 and 90 % bands"))
    a.axhline(1.0, color="#777777", linewidth=0.7)
    a.legend(loc="lower left", fontsize=7.5)
    a.set_title(f"a. transmissibility: {mass_kg:g} kg, base sine {base_mm:g} mm, swept upward", loc="left")
    a.set_ylabel("RMS acceleration, mass over base (-)")
    a.set_yscale("log")
    levels = [x for x in (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20) if 0.9 * ratio.min() <= x <= 1.1 * ratio.max()]
    a.set_yticks(levels, [f"{x:g}" for x in levels])
    band(b, hz, peak)
    b.set_title("b. peak stretch of the isolator", loc="left")
    b.set_ylabel("peak stretch (mm)")
    ticks = [f for f in (1, 2, 5, 10, 20, 50, 100) if hz[0] <= f <= hz[-1]]
    for ax in (a, b):
        ax.set_xscale("log")
        ax.set_xticks(ticks, [str(f) for f in ticks])
        ax.minorticks_off()
        ax.set_xlabel("frequency (Hz)")
    show = slice(None, None, 20)
    band(c, 1e3 * t[show], stretch[:, show])
    c.set_title(f"c. half-sine shock, {shock_g:g} g, {shock_ms:g} ms", loc="left")
    c.set_ylabel("stretch (mm)")
    band(d, 1e3 * t[show], acceleration[:, show] / 9.80665)
    d.plot(1e3 * t[show], pulse[show] / 9806.65, color=ORANGE, linestyle=(0, (4, 2)), label="base")
    d.set_title("d. acceleration in that shock", loc="left")
    d.set_ylabel("acceleration (g)")
    d.plot([], [], color=BLUE, label="mass")
    d.legend(loc="upper right")
    for ax in (c, d):
        ax.set_xlabel("time (ms)")
    for ax, most in ((b, peak.max()), (c, np.abs(stretch).max())):
        if most > 0.7 * tested:
            ax.axhline(tested, color="#777777", linestyle=(0, (2, 2)), linewidth=0.9)
            ax.text(
                0.99,
                tested,
                "largest amplitude tested ",
                transform=ax.get_yaxis_transform(),
                ha="right",
                va="bottom",
                fontsize=7.5,
                color="#555555",
            )
    top = np.max(np.abs(stretch), axis=1)
    resonance = hz[np.argmax(ratio, axis=1)]
    print(
        f"resonance {np.median(resonance):.3g} Hz, transmissibility there "
        + "{:.3g} [{:.3g}, {:.3g}]".format(*np.quantile(ratio.max(axis=1), [0.5, 0.05, 0.95]))
    )
    print("peak stretch after the shock {:.4g} [{:.4g}, {:.4g}] mm".format(*np.quantile(top, [0.5, 0.05, 0.95])))
    return made


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", metavar="RUN")
    parser.add_argument("--mass", type=float, default=1.0, help="kg")
    parser.add_argument("--base-mm", type=float, default=0.2)
    parser.add_argument("--shock-g", type=float, default=2.0)
    parser.add_argument("--shock-ms", type=float, default=6.0)
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--out", default="design.png")
    args = parser.parse_args()
    save(figure(bi.load(args.run), args.mass, args.base_mm, args.shock_g, args.shock_ms, args.draws), args.out)
    print(args.out)
