"""Tables: parameters, quantities, loops measured beside predicted, and convergence, as rows for a page, CSV files and
a LaTeX table."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.files import write_whole
from bayes_iwan.inference.results.held_out_frequencies import HeldOutFrequency
from bayes_iwan.inference.results.posterior import ConvergenceRow, Posterior
from bayes_iwan.inference.setup.loop_error import friction_rms_N
from bayes_iwan.inference.setup.quantities import loop_quantities
from bayes_iwan.models.motion import motion_of
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.identification.marginals import contraction, paper_symbol, reported
from bayes_iwan.report.identification.predictive import Predictive
from bayes_iwan.report.page import Cell, Rows, Table


@dataclass(frozen=True)
class Compared:
    """One quantity of a test: measured, predicted (value and interval of summary.csv), and the 90 % range in which
    a repeated measurement is expected."""

    measured: float
    q50: float
    q05: float
    q95: float
    repeat_q05: float
    repeat_q95: float


@dataclass(frozen=True)
class LoopRow:
    """One test, measured and predicted.

    residual_share : the RMS residual over the RMS friction force. energy_mJ, stiffness_N_mm, loss_factor : as in
    :class:`bayes_iwan.inference.setup.quantities.LoopQuantities`.
    """

    file: str
    test: str
    role: str
    rms_residual_N: float
    residual_share: float
    energy_mJ: Compared
    stiffness_N_mm: Compared
    loss_factor: Compared

    @property
    def held_out(self) -> bool:
        return self.role == "held-out"


def compared_loops(posterior: Posterior, p: Predictive) -> tuple[LoopRow, ...]:
    """Every test of a prediction, measured beside predicted."""
    measured, again = loop_quantities(p.displacement_mm, p.measured_N), loop_quantities(p.displacement_mm, p.loop_N)
    rms = np.std(p.residual_N(), axis=1)
    problem = posterior.problem
    friction = problem.friction_force(problem.parameter_values(posterior.flat_z(400)), motion_of(p.loops))
    share = rms / friction_rms_N(np.median(friction, axis=0), p.loops)

    def compared(name: str, seen: Array, repeated: Array, t: int) -> Compared:
        at = f"{name}[{p.loops[t].file}]"
        repeat = (float(q) for q in np.quantile(repeated[:, t], [0.05, 0.95]))
        return Compared(float(seen[t]), posterior.median(at), *posterior.interval(at), *repeat)

    rows = []
    for t, x in enumerate(p.loops):
        energy = compared("dissipated_energy_mJ", measured.energy_mJ, again.energy_mJ, t)
        stiffness = compared("equivalent_stiffness_N_mm", measured.stiffness_N_mm, again.stiffness_N_mm, t)
        loss = compared("loss_factor", measured.loss_factor, again.loss_factor, t)
        name = test_name(x, role=False)
        rows.append(LoopRow(x.file, name, x.role, float(rms[t]), float(share[t]), energy, stiffness, loss))
    return tuple(rows)


LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)


def spread(draws: Array) -> tuple[float, ...]:
    """Mean, sd and the quantiles LEVELS of the finite draws."""
    draws = draws[np.isfinite(draws)]
    if not len(draws):
        return (float("nan"),) * (2 + len(LEVELS))
    return (float(draws.mean()), float(draws.std()), *(float(q) for q in np.quantile(draws, LEVELS)))


_STATISTICS = ("mean", "sd", "q05", "q25", "q50", "q75", "q95")


def parameters_table(posterior: Posterior) -> Table:
    """Every sampled parameter: statistics of the posterior's draws; the paper's own point estimate, the
    minimum of Eq. (8); prior; contraction."""
    prior = posterior.problem.prior
    z = posterior.flat_z()
    values, shrunk, eq8 = prior.values(z), contraction(z), prior.values(posterior.point.goal_z[None])
    rows: list[tuple[Cell, ...]] = []
    for p, c in zip(prior.free, shrunk):
        last = (float(eq8[p.name][0]), p.prior_text(), float(c))
        rows.append((p.name, p.symbol, p.unit, p.description, *spread(values[p.name]), *last))
    columns = ("name", "symbol", "unit", "description", *_STATISTICS, "eq8_minimum", "prior", "contraction")
    return Table("parameters", columns, tuple(rows))


def paper_table(posterior: Posterior) -> Table:
    """What the simulator derives from its sampled parameters: the paper's (Table 1) for the Iwan model."""
    rows: Rows = tuple((n, paper_symbol(n), q.unit, *spread(q.values)) for n, q in posterior.derived().items())
    return Table("paper_parameters", ("name", "symbol", "unit", *_STATISTICS), rows)


def quantities_table(posterior: Posterior) -> Table:
    """Everything the posterior reports, the paper's parameters too."""
    rows: Rows = tuple(
        (name, q.unit, *spread(np.asarray(q.values, dtype=float)), posterior.extrapolated.get(name, ""))
        for name, q in posterior.quantities().items()
    )
    columns = ("name", "unit", *_STATISTICS, "reach")
    return Table("quantities", columns, rows)


def loops_table(loops: Sequence[LoopRow]) -> Table:
    """Per test: energy, stiffness and loss factor measured, predicted (value and interval of summary.csv) and
    where a repeated measurement is expected; RMS residual."""
    columns = ["file", "test", "role", "rms_residual_N", "residual_share_of_friction"]
    for name in ("energy_mJ", "stiffness_N_mm", "loss_factor"):
        columns += [f"{name}_{f.name}" for f in fields(Compared)]
    rows: list[tuple[Cell, ...]] = []
    for x in loops:
        compared: tuple[Cell, ...] = (*astuple(x.energy_mJ), *astuple(x.stiffness_N_mm), *astuple(x.loss_factor))
        rows.append((x.file, x.test, x.role, x.rms_residual_N, x.residual_share, *compared))
    return Table("loops", tuple(columns), tuple(rows))


def convergence_rows(posterior: Posterior) -> tuple[ConvergenceRow, ...]:
    """R-hat and ESS of every sampled parameter from the draws kept, as in summary.csv; autocorrelation time of the
    run."""
    kept = {r.name: r for r in posterior.summary()}
    return tuple(
        replace(r, r_hat=kept[r.name].r_hat, ess_bulk=kept[r.name].ess_bulk, ess_tail=kept[r.name].ess_tail)
        for r in posterior.convergence
        if r.name in kept
    )


def convergence_table(convergence: Sequence[ConvergenceRow]) -> Table:
    rows = tuple((r.name, r.r_hat, r.ess_bulk, r.ess_tail, float(r.tau)) for r in convergence)
    return Table("convergence", ("name", "r_hat", "ess_bulk", "ess_tail", "tau_steps"), rows)


def held_out_table(held_out: Sequence[HeldOutFrequency]) -> Table:
    rows = tuple((x.frequency_hz, "; ".join(x.tests), x.points_50, x.points_90, x.quantities_90) for x in held_out)
    columns = ("frequency_hz", "tests", "points_in_50", "points_in_90", "energies_and_stiffnesses_in_90")
    return Table("held_out", columns, rows)


_NAMES = (
    "alpha beta gamma delta varepsilon zeta eta theta kappa lambda mu nu xi pi rho sigma tau phi chi psi omega "
    "Gamma Delta Theta Lambda Xi Pi Sigma Phi Psi Omega ell propto geq"
)
_GREEK = dict(zip("αβγδεζηθκλμνξπρστφχψωΓΔΘΛΞΠΣΦΨΩℓ∝≥", _NAMES.split()))
_TEX_SYMBOL: Mapping[str, str] = {
    "kp": "k_p",
    "F₀": "F_0",
    "E[φ]": r"\mathrm{E}[\phi]",
    "φmax": r"\phi_{\max}",
    "k̃ₙβℓ^β": r"\tilde k_n\beta\ell^\beta",
    "λk̃ₙℓ^βv": r"\lambda\tilde k_n\ell^\beta v",
}


def _tex_symbol(symbol: str) -> str:
    numbered = re.sub(r"([^\W\d_])(\d+)", r"\1_{\2}", symbol)
    greek = re.sub(f"([{''.join(_GREEK)}])([A-Za-z]?)", lambda m: f"\\{_GREEK[m[1]]}{m[2] and ' '}{m[2]}", numbered)
    return f"${_TEX_SYMBOL.get(symbol) or greek}$"


def _tex_text(text: str) -> str:
    marks: dict[str, str | int | None] = {c: f"\\{c}" for c in "&%#_"}
    marks |= {"\\": r"\textbackslash{}", "^": r"\^{}", "−": "$-$", "–": "--"}
    return text.translate(str.maketrans(marks | {letter: f"$\\{name}$" for letter, name in _GREEK.items()}))


def latex_table(posterior: Posterior) -> str:
    """A table of the sampled parameters for the booktabs package: symbol, meaning, median, 90 % interval, unit."""
    head = r"Parameter & Meaning & Median & 90\,\% interval & Unit \\"
    lines = [r"\begin{tabular}{llrll}", r"\toprule", head, r"\midrule"]
    for p in posterior.problem.prior.free:
        middle, low, high = (x.replace("−", "-") for x in reported(posterior, p.name))
        unit = "--" if p.unit == "-" else _tex_text(p.unit)
        cells = (_tex_symbol(p.symbol), _tex_text(p.description), f"${middle}$", f"$[{low},\\ {high}]$", unit)
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def write_tables(posterior: Posterior, more: Sequence[Table], out: Path) -> None:
    """The CSV files, `more` among them, and parameters.tex in out/tables."""
    every = [parameters_table(posterior), paper_table(posterior), quantities_table(posterior), *more]
    every += [held_out_table(posterior.held_out)] if posterior.held_out else []
    for table in every:
        table.in_units(posterior.problem.units).write_csv(out / "tables")
    write_whole(out / "tables" / "parameters.tex", latex_table(posterior))
