"""What Table 1 of the paper gives, as printed and as corrected, in the manner of its Figs. 8 to 12.

    python analyses/reproduce_paper.py [--out runs/reproduce_paper] [--budget-s 40]

The paper's measured loops are not published, so this reproduces the model, not the fit: the distribution of slip
forces, stiffness and normal force, the three friction loops at A = 1 mm, and where the printed numbers break. Then
loops of Table 1 at the paper's frequencies are given noise and identified (for --budget-s seconds; 0: not at all), to
see how much of the normal force's three numbers such loops can tell.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import bayes_iwan as bi
from bayes_iwan.campaign import Record, average
from bayes_iwan.comparison.families import SHORT
from bayes_iwan.inference.setup.loop_scales import loop_energy_mJ
from bayes_iwan.models import Model, Reference, motion, sine_motion
from bayes_iwan.models.paper_parameters import TABLE_1, table_1
from jenkins_elements import element_force, equal_probability_sliders

AMPLITUDE_MM = 1.0
FREQUENCIES_HZ = np.array([10.0, 15.0, 20.0])
COLOURS = ("tab:blue", "goldenrod", "black")  # as in the paper's Figs. 4 and 12
REFERENCE = Reference(AMPLITUDE_MM, 2e-3 * np.pi * AMPLITUDE_MM * FREQUENCIES_HZ[-1])


def printed_alpha(u, speed_m_s, amplitude):
    """Eq. (11) with nothing corrected."""
    kn, lam, beta = (TABLE_1[name] for name in ("kn_1_mm", "lambda_s_m", "beta"))
    y = np.abs(amplitude - u) ** beta
    return kn * (y - amplitude**beta) + lam * kn * y * speed_m_s * np.sign(amplitude - u) + 1.0


def printed_stiffness(alpha):
    """Eq. (12)."""
    return TABLE_1["ku_N_mm"] * (1.0 - np.exp(-TABLE_1["ki_N_mm"] * alpha / TABLE_1["ku_N_mm"]))


def save(figure, folder: Path, name: str) -> None:
    for kind in ("png", "pdf"):
        figure.savefig(folder / f"{name}.{kind}", dpi=160, bbox_inches="tight")
    plt.close(figure)


def figure_8(model: Model, parameter_values, folder: Path) -> None:
    phi = np.linspace(1e-3, 5.0, 1000)
    figure, axes = plt.subplots(figsize=(5.0, 3.4), layout="constrained")
    axes.plot(phi, model.slip_family.density(phi, parameter_values)[0], color="black", label="sum")
    for i, style in enumerate((":", "--", "-."), start=1):
        alone = {
            name: np.zeros(1) if name in ("g1", "g2", "g3") and name != f"g{i}" else value
            for name, value in parameter_values.items()
        }
        axes.plot(phi, model.slip_family.density(phi, alone)[0], style, color="grey", label=f"component {i}")
    mean = float(model.slip_family.mean(parameter_values)[0])
    axes.axvline(mean, color="tab:red", linewidth=0.8, label=f"mean, {mean:.3f} N")
    axes.set(
        xlabel="slip force φ at rest / N",
        ylabel="density / N⁻¹",
        xlim=(0, 5),
        ylim=(0, 1.2),
        title="Slip forces (the paper's Fig. 8)",
    )
    axes.legend(frameon=False)
    save(figure, folder, "fig08_slip_forces")


def figure_9(folder: Path) -> None:
    alpha = np.linspace(0.0, 3.0, 400)
    figure, axes = plt.subplots(figsize=(5.0, 3.4), layout="constrained")
    axes.plot(alpha, printed_stiffness(alpha), color="black")
    one = float(printed_stiffness(1.0))
    axes.plot(1.0, one, "o", color="tab:red", label=f"k(1) = {one:.2f} N/mm")
    axes.axhline(TABLE_1["ku_N_mm"], color="grey", linestyle=":", label=f"final, {TABLE_1['ku_N_mm']} N/mm")
    axes.set(
        xlabel="relative normal force α",
        ylabel="stiffness k / (N/mm)",
        xlim=(0, 3),
        ylim=(0, 33),
        title="Stiffness, Eq. (12) (the paper's Fig. 9)",
    )
    axes.legend(frameon=False, loc="lower right")
    save(figure, folder, "fig09_stiffness")


def figure_10(model: Model, parameter_values, folder: Path) -> None:
    loops = sine_motion(frequency_hz=FREQUENCIES_HZ, amplitude_mm=AMPLITUDE_MM, samples=1024)
    alpha = model.alpha(parameter_values, loops)[0]
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.4, 3.4), layout="constrained")
    for j, (f, colour) in enumerate(zip(FREQUENCIES_HZ, COLOURS)):
        u, speed = loops.displacement_mm[0, j], loops.speed_m_s[0, j]
        order = np.append(np.arange(u.size), 0)
        left.plot(u[order], alpha[j][order], color=colour, label=f"{f:g} Hz")
        right.plot(u[order], printed_alpha(u, speed, AMPLITUDE_MM)[order], color=colour)
    still = np.linspace(-1.0, 1.0 - 1e-9, 2000)
    for axes in (left, right):
        axes.plot(still, printed_alpha(still, 0.0, AMPLITUDE_MM), color="tab:red", linestyle=":", label="at rest")
        axes.set(xlabel="displacement u / mm", ylabel="relative normal force α")
    left.set(title="Normal force with y ≥ 0.01 A (Fig. 10)", ylim=(0.8, 1.4))
    left.legend(frameon=False, loc="lower center", ncols=2)
    right.set(title="Eq. (11) as printed: α(A) = −0.79")
    right.axhline(0.0, color="grey", linewidth=0.6)
    save(figure, folder, "fig10_normal_force")


def as_printed(parameter_values, model: Model, frequency_hz: float):
    """Friction loop of 4,000 elements with Eq. (11) as it stands, and the sine it belongs to."""
    loop = sine_motion(frequency_hz=frequency_hz, amplitude_mm=AMPLITUDE_MM)
    u, speed = loop.displacement_mm[0, 0], loop.speed_m_s[0, 0]
    alpha = printed_alpha(u, speed, AMPLITUDE_MM)
    phi = equal_probability_sliders(lambda f: model.slip_family.survival(f, parameter_values)[0], 4000, 12.0)
    # a limit cannot be negative; the printed law takes α and k below zero at u = A together, so α/k is not
    force = element_force(u, np.abs(alpha), np.abs(printed_stiffness(alpha)), phi, np.full(4000, 1 / 4000), passes=2)
    return u, np.sign(printed_stiffness(alpha)) * force


def figure_12(model: Model, parameter_values, folder: Path) -> None:
    loops = sine_motion(frequency_hz=FREQUENCIES_HZ, amplitude_mm=AMPLITUDE_MM)
    friction = model.friction_force(parameter_values, loops)
    total = model.force(parameter_values, loops)
    area = loop_energy_mJ(loops.displacement_mm, friction)[0]
    order = np.append(np.arange(loops.samples), 0)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 4.0), layout="constrained")
    for j, (f, colour) in enumerate(zip(FREQUENCIES_HZ, COLOURS)):
        u = loops.displacement_mm[0, j][order]
        left.plot(u, friction[0, j][order], color=colour, label=f"{f:g} Hz, {area[j]:.2f} N·mm")
        right.plot(u, total[0, j][order], color=colour, label=f"{f:g} Hz")
    u, force = as_printed(parameter_values, model, 15.0)
    left.plot(u[order], force[order], ":", color="tab:red", linewidth=1.0, label="15 Hz as printed")
    left.set(xlabel="displacement u / mm", ylabel="friction force / N", title="Friction loops (the paper's Fig. 12)")
    right.set(xlabel="displacement u / mm", ylabel="force / N", title="With the parallel spring (Fig. 11)")
    for axes in (left, right):
        axes.legend(frameon=False)
    save(figure, folder, "fig12_loops")


def text(model: Model, parameter_values) -> str:
    """What Table 1 gives in figures, what breaks, and what the correction costs."""
    loops = sine_motion(frequency_hz=FREQUENCIES_HZ, amplitude_mm=AMPLITUDE_MM, samples=512)
    area = loop_energy_mJ(loops.displacement_mm, model.friction_force(parameter_values, loops))[0]
    alpha = model.alpha(parameter_values, loops)[0]
    at_end = float(printed_alpha(AMPLITUDE_MM, 0.0, AMPLITUDE_MM))
    fastest = 2e-3 * np.pi * AMPLITUDE_MM * FREQUENCIES_HZ[-1]
    lines = [
        "Table 1 gives",
        f"  k(1) = {parameter_values['k1_N_mm'][0]:.2f} N/mm; "
        f"mean slip force {model.slip_family.mean(parameter_values)[0]:.3f} N; "
        f"sum of weights {sum(TABLE_1['g']):.2f}",
        "  friction loop at A = 1 mm: " + ", ".join(f"{a:.2f} N·mm at {f:g} Hz" for a, f in zip(area, FREQUENCIES_HZ)),
        "  α on that loop: "
        + ", ".join(f"{a.min():.2f} to {a.max():.2f} at {f:g} Hz" for a, f in zip(alpha, FREQUENCIES_HZ)),
        "As printed it breaks",
        f"  at u = A, where |A − u|^β is 0 while it is nearly 1 all around: α = {at_end:.2f}, "
        f"k = {printed_stiffness(at_end):.1f} N/mm; at 0.99 A α is {printed_alpha(0.99, 0.0, 1.0):.2f}",
        f"  with u̇ in mm/s: α would reach {printed_alpha(0.0, 500.0 * fastest, 1.0):.0f} at 10 Hz "
        f"(in m/s {printed_alpha(0.0, 0.5 * fastest, 1.0):.2f})",
        f"  β = {TABLE_1['beta']}: only k̃ₙβ = {TABLE_1['kn_1_mm'] * TABLE_1['beta']:.4f} and "
        f"λk̃ₙ = {TABLE_1['lambda_s_m'] * TABLE_1['kn_1_mm']:.3f} s/m matter; β ten times smaller and k̃ₙ ten times "
        "larger, λ ten times smaller",
    ]
    ten = dict(parameter_values) | {"beta": parameter_values["beta"] / 10.0}
    change = np.max(np.abs(model.force(ten, loops) - model.force(parameter_values, loops)))
    lines.append(f"  change the force by {change:.4f} N at most")
    lines.append("The correction, y ≥ floor·A, hardly depends on the floor: area at 15 Hz")
    kept = motion.Y_FLOOR
    for floor in (1e-4, 1e-3, 1e-2, 3e-2, 1e-1):
        motion.Y_FLOOR = floor
        fresh = sine_motion(frequency_hz=15.0, amplitude_mm=AMPLITUDE_MM, samples=512)
        friction = model.friction_force(parameter_values, fresh)
        lines.append(f"  floor {floor:7.4f}: {loop_energy_mJ(fresh.displacement_mm, friction)[0, 0]:.3f} N·mm")
    motion.Y_FLOOR = kept
    return "\n".join(lines)


def identified(
    model: Model, parameter_values, budget_s: float, noise_N: float = 0.015, cycles: int = 30, seed: int = 1
):
    """The posterior of Table 1's three loops, recorded at 1,280 samples/s with white noise of 1 % of the friction."""
    rng = np.random.default_rng(seed)
    force = model.force(
        parameter_values, sine_motion(frequency_hz=FREQUENCIES_HZ, amplitude_mm=AMPLITUDE_MM, samples=1024)
    )[0]
    loops = []
    for f, one in zip(FREQUENCIES_HZ, force):
        t = np.arange(int(cycles * 1280 / f)) / 1280
        at = np.interp((f * t) % 1.0, np.arange(1025) / 1024, np.append(one, one[0]))
        u, measured = AMPLITUDE_MM * np.sin(2 * np.pi * f * t), at + noise_N * rng.standard_normal(t.size)
        loops.append(average(Record(f"f{f:g}.csv", f, AMPLITUDE_MM, "fit", {}, t, u, measured)))
    settings = replace(SHORT, sampling=replace(SHORT.sampling, budget_s=budget_s))
    return bi.identify_problem(bi.make_problem(loops, settings), seed, config=settings, loops=loops, progress=False)


def figure_posterior(posterior, folder: Path) -> str:
    """β against k̃ₙ and their product, with what was put in; the same in words."""
    draws = {name: q.values for name, q in posterior.derived().items()}
    beta, kn, lam = draws["beta"], draws["kn_1_mm"], draws["lambda_s_m"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.4, 3.4), layout="constrained")
    left.plot(beta, kn, ".", color="tab:blue", markersize=1.5, alpha=0.4, rasterized=True, label="posterior draws")
    line = np.geomspace(beta.min(), beta.max(), 50)
    product = TABLE_1["kn_1_mm"] * TABLE_1["beta"]
    left.plot(line, product / line, "--", color="grey", label=f"k̃ₙβ = {product:.4f}")
    left.plot(TABLE_1["beta"], TABLE_1["kn_1_mm"], "*", color="tab:red", markersize=11, label="Table 1")
    left.set(xscale="log", yscale="log", xlabel="β", ylabel="k̃ₙ / mm⁻ᵝ", title="One by one hardly determined ...")
    left.legend(frameon=False)
    right.hist(1e3 * kn * beta, bins=60, density=True, color="tab:blue", alpha=0.6)
    right.axvline(1e3 * product, color="tab:red", label="Table 1")
    right.set(xlabel="1000 k̃ₙβ", ylabel="posterior density", title="... their product is")
    right.legend(frameon=False)
    save(figure, folder, "posterior_normal_force")

    def said(x) -> str:
        return "{:.3g} [{:.3g}, {:.3g}]".format(*np.quantile(x, [0.5, 0.05, 0.95]))

    return "\n".join(
        [
            "Loops of Table 1 with noise, identified: median [90 %]"
            + ("" if posterior.converged else f" ({posterior.message})"),
            f"  β {said(beta)}, put in {TABLE_1['beta']} (the prior ends at 0.004); "
            f"k̃ₙ {said(kn)}, put in {TABLE_1['kn_1_mm']}",
            f"  k̃ₙβ {said(kn * beta)}, put in {product:.4f}; "
            f"λk̃ₙ {said(lam * kn)} s/m, put in {TABLE_1['lambda_s_m'] * TABLE_1['kn_1_mm']:.3f}",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/reproduce_paper"))
    parser.add_argument("--budget-s", type=float, default=40.0, help="seconds of sampling; 0: none")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    model, parameter_values = Model(REFERENCE), table_1(REFERENCE)
    figure_8(model, parameter_values, args.out)
    figure_9(args.out)
    figure_10(model, parameter_values, args.out)
    figure_12(model, parameter_values, args.out)
    words = text(model, parameter_values)
    if args.budget_s > 0:
        words += "\n" + figure_posterior(identified(model, parameter_values, args.budget_s), args.out)
    (args.out / "table_1.txt").write_text(words + "\n")
    print(words)


if __name__ == "__main__":
    main()
