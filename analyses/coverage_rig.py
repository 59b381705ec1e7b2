"""Coverage of the intervals: sound specimens on the virtual rig, and specimens that follow the paper's model exactly.

    python analyses/coverage_rig.py --cases 24 --kind rig exact --forms embedded plain --draws sampled --out coverage

The rig shares no code with the model: its sliders differ from each other, its slip forces follow other laws, its
normal force and contact stiffness have slightly other shapes, and its sensors are filtered and noisy. The truth of
kp, k(1) and the slip forces is that of the specimen in series with its sound fixture, which no loop tells apart; that
of each test's dissipated energy comes from a run without noise and sensors. A specimen has 2000 elements, since the
model's are infinitely many: with 150 (`--sliders 150`), whose stiffnesses differ by up to 15 %, the share of stiffness
that slips below a force is a jagged curve, whose quartiles stray from those of the smooth curve that loops show.
`exact` specimens are the paper's model itself at what such a specimen's loops are fitted by, with the measured noise
drawn anew. `remount_scatter` and `room_climate` specimens differ from test to test, in stiffness or friction: the truth
of kp, k(1) and the slip forces is what they scatter about.

An interval that is right holds the truth as often as it says. What is counted are quantiles of draws: `sampled` until
they have converged, `quick` as `--quick` draws. Asked for fewer effective draws (`--ess 100 --r-hat 1.03 --taus 5`)
more specimens are done in a day. Several seeds, with as many counts of cases, are pooled. Counted pooled, by the
number of tests, for one frequency and several, and for weak and strong variation of the normal force. The figure has
one curve a quantity (P-P) with simultaneous 95 % bands of the empirical distribution (Dvoretzky, Kiefer & Wolfowitz
1956; Massart 1990).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.loops.averaging import average
from bayes_iwan.files import write_json
from bayes_iwan.inference.setup.loop_scales import loop_energy_mJ
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.quantities import quantities
from bayes_iwan.inference.setup.settings import SamplingSettings
from bayes_iwan.inference.solving.jackknife import stretched
from bayes_iwan.inference.solving.posterior_draws import QUICK
from bayes_iwan.virtual_rig import cases as rig_cases
from bayes_iwan.virtual_rig import simulate as rig
from bayes_iwan.virtual_rig.specimen import Specimen
from runs import each
from sbc import found_point, short_posterior

LEVELS = (0.5, 0.9, 0.95)
GRID = {"n_phase": 64, "n_harmonics": 24}
QUARTILES = (25, 50, 75)
#: what differs from test to test
SCATTERED = ("remount_scatter", "room_climate")
NAMES = ("kp_N_mm", "k1_N_mm", "mean_slip_force_N", *(f"slip_force_q{q}_N" for q in QUARTILES), "energy")
#: share of the amplitude-wide change of α above which the normal force varies strongly
STRONG = 0.5


def on_fixture(s: Specimen, compliance_mm_N: float) -> dict[str, float]:
    """A specimen's stiffnesses (N/mm), and mean and quartiles of its slip forces (N), in series with a spring: they are
    those of other elements beside another spring."""
    order = np.argsort(s.slip_share_N / s.stiffness_share)
    share, slip = s.stiffness_share[order], s.slip_share_N[order]
    yields = slip / share / s.contact_N_mm
    held = np.append(1.0, 1.0 - np.cumsum(share))  # before the first yields, and after each
    force = s.parallel_N_mm * yields + np.cumsum(slip) + s.contact_N_mm * yields * held[1:]
    tangent = s.parallel_N_mm + s.contact_N_mm * held
    tangent /= 1.0 + compliance_mm_N * tangent
    kp, k1 = float(tangent[-1]), float(tangent[0] - tangent[-1])
    still = (tangent - kp) / k1
    phi = k1 * (yields + compliance_mm_N * force)
    slipped = 1.0 - 0.5 * (still[1:] + still[:-1])
    truth = {"kp_N_mm": kp, "k1_N_mm": k1, "mean_slip_force_N": float(-np.diff(still) @ phi)}
    return truth | {f"slip_force_q{q}_N": float(np.interp(q / 100, slipped, phi)) for q in QUARTILES}


def simulated(kind: str, seed: int, index: int, n_sliders: int) -> dict[str, Any]:
    """A case of the rig, sound or one of SCATTERED: its averaged loops as recorded, and the truths."""
    drawn = ("outside", [kind]) if kind in SCATTERED else ("none",)
    case = rig_cases.draw_case(np.random.default_rng([seed, index]), *drawn, n_sliders=n_sliders)
    tests = tuple(t for t in case.tests if t.role == "fit")
    loops = [average(r, **GRID) for r in rig.records(case.rig.run_all(tests))]
    clean = [average(r, **GRID) for r in rig.records(case.rig.run_all(tests, clean=True))]
    truth = on_fixture(case.specimen, case.setup.fixture_compliance_mm_N)
    truth |= {
        f"dissipated_energy_mJ[{x.file}]": float(loop_energy_mJ(c.displacement_mm, c.force_N))
        for x, c in zip(loops, clean)
    }
    return {"loops": loops, "truth": truth}


def exact(seed: int, index: int, n_sliders: int) -> dict[str, Any]:
    """The same tests of a specimen that is the paper's model, at the optimum of the rig's loops."""
    loops = simulated("rig", seed, index, n_sliders)["loops"]
    problem = make_problem(loops, {"model": {"embedded": False}})
    z = found_point(problem, index).z[None]
    rng = np.random.default_rng([seed, index, 2])
    force = problem.predict(z)[0]
    harmonics = np.where(np.isfinite([x.noise_N for x in loops]), [x.noise_N for x in loops], 0.0)
    noise = (harmonics * (rng.standard_normal(harmonics.shape) + 1j * rng.standard_normal(harmonics.shape)))[:, 1:]
    phase = 2.0 * np.pi * np.outer(np.arange(1, harmonics.shape[1]), np.arange(force.shape[1])) / force.shape[1]
    force = force + (noise @ np.exp(1j * phase)).real
    made = problem.with_force(force)
    found = quantities(problem, z)
    names = [*NAMES[:-1], *(f"dissipated_energy_mJ[{x.file}]" for x in loops)]
    return {"loops": list(made.loops), "truth": {n: float(found[n].values[0]) for n in names}}


def placed(problem: Problem, z: Array, truth: dict[str, float]) -> dict[str, dict[str, float]]:
    """Where truths stand among draws z (n, ndim), and how wide the 90 % intervals are."""
    found = quantities(problem, np.clip(z, -8.0, 8.0))
    rows = {}
    for name, true in truth.items():
        x = found[name].values
        low, high = np.quantile(x, [0.05, 0.95])
        rows[name] = {"rank": float(np.mean(x < true)), "width": float((high - low) / abs(true))}
    return rows


def one_case(
    kind: str, seed: int, index: int, forms: list[str], ways: list[str], settings: SamplingSettings, n_sliders: int
) -> dict[str, Any]:
    """By form and way of drawing: where the truths stand among the draws, and how wide the 90 % intervals are."""
    made = exact(seed, index, n_sliders) if kind == "exact" else simulated(kind, seed, index, n_sliders)
    loops: list[Loop] = made["loops"]
    out: dict[str, Any] = {"kind": kind, "tests": len(loops)}
    out["frequencies"] = len({round(float(np.log(x.frequency_hz) / 0.05)) for x in loops})
    for form in forms:
        problem = make_problem(loops, {"model": {"embedded": form == "embedded"}})
        point = found_point(problem, index)
        values = problem.parameter_values(point.z[None])
        alpha = problem.model.alpha(values, problem.motion)  # type: ignore[attr-defined]
        out["variation"] = float(np.ptp(alpha))
        for way in ways:
            asked = settings if way == "sampled" else replace(settings, **QUICK)
            z, told = short_posterior(problem, point, index, asked)
            wide, stretch = stretched(problem, z, index)
            some = np.linspace(0, len(z) - 1, 2000).round().astype(int)
            out[f"{form} {way}"] = told | {"rows": placed(problem, wide[some], made["truth"]), "stretch": stretch}
            out[f"{form} {way}, as drawn"] = told | {"rows": placed(problem, z[some], made["truth"])}
    return out


def rows_of(cases: list[dict[str, Any]], key: str, name: str) -> list[dict[str, float]]:
    """Case by case; energies test by test."""
    wanted = "dissipated_energy" if name == "energy" else name
    return [r for c in cases for n, r in c[key]["rows"].items() if n.startswith(wanted)]


def held(cases: list[dict[str, Any]], key: str, name: str, level: float) -> float:
    """Share of central intervals that hold the truth."""
    ranks = np.array([r["rank"] for r in rows_of(cases, key, name)])
    return float(np.mean(np.abs(ranks - 0.5) <= 0.5 * level)) if len(ranks) else float("nan")


REGIONS = {
    "all": lambda c: True,
    "2 to 4 tests": lambda c: c["tests"] <= 4,
    "5 to 7 tests": lambda c: 5 <= c["tests"] <= 7,
    "8 tests and more": lambda c: c["tests"] >= 8,
    "one frequency": lambda c: c["frequencies"] == 1,
    "several frequencies": lambda c: c["frequencies"] > 1,
    "normal force varies weakly": lambda c: c["variation"] <= STRONG,
    "normal force varies strongly": lambda c: c["variation"] > STRONG,
}


def table_of(cases: list[dict[str, Any]], key: str) -> dict[str, Any]:
    """Coverage by region and quantity in per cent at LEVELS, printed as a table."""
    late = sum(not c[key].get("converged", True) for c in cases)
    seconds = np.median([c[key]["cpu_s"] for c in cases])
    print(f"\n{cases[0]['kind']}, {key}: {len(cases)} specimens, {late} short of convergence, median processor time "
          f"{seconds:.0f} s; % held of 50 / 90 / 95")  # fmt: skip
    table: dict[str, Any] = {"short_of_convergence": late}
    for region, inside in REGIONS.items():
        some = [c for c in cases if inside(c)]
        if not some:
            continue
        found = {n: [round(100 * held(some, key, n, level)) for level in LEVELS] for n in NAMES}
        table[region] = {"specimens": len(some), "held": found}
        cells = "  ".join(
            f"{n.removesuffix('_N_mm').removesuffix('_N')} {'/'.join(map(str, v))}" for n, v in found.items()
        )
        print(f"{region:30s} {len(some):4d}  {cells}")
    table["median_width"] = {n: float(np.median([r["width"] for r in rows_of(cases, key, n)])) for n in NAMES}
    print("median 90 % width, % of the truth: "
          + ", ".join(f"{n} {100 * w:.2f}" for n, w in table["median_width"].items()))  # fmt: skip
    return table


def figure(cases: list[dict[str, Any]], key: str) -> Figure:
    """P-P curves of the truths' places among the draws, with simultaneous bands."""
    fig = Figure(figsize=(5, 4.6), layout="constrained")
    ax = fig.add_subplot()
    at = np.linspace(0.0, 1.0, 101)
    band = np.sqrt(np.log(2.0 / 0.05) / (2.0 * len(cases)))
    ax.fill_between(at, at - band, at + band, color="#dddddd", linewidth=0, label="95 % band, one truth a specimen")
    ax.plot(at, at, color="#888888", linewidth=1)
    for name, colour in zip(NAMES, ("#2266aa", "#cc6611", "#559955", "#884499", "#aa4466", "#777722", "#333333")):
        ranks = np.sort([r["rank"] for r in rows_of(cases, key, name)])
        ax.plot(at, np.searchsorted(ranks, at, side="right") / len(ranks), color=colour, linewidth=1.2, label=name)
    ax.set(xlabel="quantile of the draws", ylabel="share of truths below it", xlim=(0, 1), ylim=(0, 1))
    ax.legend(fontsize=7, frameon=False, loc="upper left")
    ax.set_title(f"{len(cases)} specimens ({cases[0]['kind']}), {key}", fontsize=9)
    return fig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, nargs="+", default=[24], help="specimens of each seed")
    parser.add_argument("--kind", nargs="+", choices=("rig", "exact", *SCATTERED), default=["rig"])
    parser.add_argument("--forms", nargs="+", choices=("embedded", "plain"), default=["embedded"])
    parser.add_argument("--draws", nargs="+", choices=("sampled", "quick"), default=["sampled"])
    parser.add_argument("--budget", type=float, default=240.0, help="seconds of sampling for each posterior, at most")
    parser.add_argument("--ess", type=float, default=400.0, help="effective draws of each posterior, at least")
    parser.add_argument("--r-hat", type=float, default=1.01, help="R-hat of each posterior, at most")
    parser.add_argument("--taus", type=float, default=10.0, help="steps over the autocorrelation time, at least")
    parser.add_argument("--sliders", type=int, default=2000, help="elements of a specimen on the rig")
    parser.add_argument("--seed", type=int, nargs="+", default=[11])
    parser.add_argument("--out", type=Path, default=Path("coverage"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    args = parser.parse_args()
    settings = SamplingSettings(budget_s=args.budget, ess=args.ess, r_hat=args.r_hat, taus=args.taus)
    tables: dict[str, Any] = {}
    for kind in args.kind:
        name = f"{kind}_{'_'.join((*args.forms, *args.draws))}_{args.sliders}"
        jobs = [
            (
                args.out / "cases" / f"{name}_{seed}_{i:03d}.json",
                one_case,
                kind,
                seed,
                i,
                args.forms,
                args.draws,
                settings,
                args.sliders,
            )
            for seed, count in zip(args.seed, args.cases, strict=True)
            for i in range(count)
        ]
        cases = list(each(jobs, args.workers, "cases"))
        for key in (k for k in cases[0] if " " in k):
            tables[f"{kind}, {key}"] = table_of(cases, key)
            figure(cases, key).savefig(
                args.out / f"coverage_{kind}_{key.replace(',', '').replace(' ', '_')}.png", dpi=130
            )
    write_json(args.out / "coverage.json", {"seed": args.seed, "cases": args.cases, "tables": tables})
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
