"""Figures of quantities: prior against posterior with contraction, corner plots."""

import warnings
from collections.abc import Mapping, Sequence

import corner
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_iwan.arrays import Array
from bayes_iwan.comparison.frequencies import determined_names
from bayes_iwan.errors import InputError
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.report.style import MODEL, PRIOR, RED, blank, narrow, on_phone, refuse_given_axes, styled, subplots

#: quantities of a corner plot on a phone, where more would be too small to read
ON_PHONE = 4
#: below this contraction the data have hardly said anything of a number
OPEN = 0.5


def contraction(z: Array) -> Array:
    """1 − posterior variance / prior variance of each coordinate; over z the prior's variance is one. z (…, ndim)."""
    return 1.0 - np.var(z.reshape(-1, z.shape[-1]), axis=0)


def number(x: float, spread: float | None = None) -> str:
    """A number as a person would write it: digits down to a tenth of its spread (else four digits)."""
    if not np.isfinite(x):
        return "–"
    if spread is None or not np.isfinite(spread) or spread <= 0:
        return f"{x:.4g}".replace("-", "−")
    places = int(1 - np.floor(np.log10(spread)))
    text = f"{x:.{min(max(places, 0), 8)}f}" if 1e-4 < max(abs(x), spread) < 1e6 else f"{x:.3g}"
    if not float(text):  # no "−0.000"
        text = text.lstrip("-")
    return text.replace("-", "−")


def interval(draws: Array, level: float = 0.9) -> tuple[str, str, str]:
    """Median and central interval of draws as text with the digits that the spread deserves."""
    draws = draws[np.isfinite(draws)]
    if not len(draws):
        return "–", "–", "–"
    low, middle, high = np.quantile(draws, [0.5 - level / 2, 0.5, 0.5 + level / 2])
    return in_interval(middle, low, high)


def in_interval(middle: float, low: float, high: float) -> tuple[str, str, str]:
    """A median and its interval as text: digits down to a tenth of twice its shorter side, at most one more than the
    whole interval deserves."""
    deserved = max(2.0 * min(middle - low, high - middle), 0.1 * (high - low))
    return number(middle, deserved), number(low, deserved), number(high, deserved)


def reported(posterior: Posterior, name: str) -> tuple[str, str, str]:
    """The reported value and 90 % interval of a quantity, as in summary.csv, with the digits that it deserves."""
    low, high = posterior.interval(name)
    return in_interval(posterior.median(name), low, high)


@styled
def prior_posterior_figure(posterior: Posterior) -> Figure:
    """Each sampled parameter's prior (grey) and posterior (blue) on the prior's own scale, with the contraction.

    What the data left open stands in red with an open circle: its interval is as wide as the prior's.
    """
    prior = posterior.problem.prior
    z = posterior.flat_z()
    shrunk = contraction(z)
    n = len(prior.free)
    small = narrow()  # a column of contractions does not fit
    ratios = (1, 1.35) if small else (1.35, 1)
    figure, axes = subplots(1, 2, 7.6, 0.245 * n + 1.0, width_ratios=ratios, sharey=True)
    ax, side = axes[0]
    ax.axvspan(-1.645, 1.645, color=PRIOR, alpha=0.18, linewidth=0)
    ax.axvspan(-0.674, 0.674, color=PRIOR, alpha=0.25, linewidth=0)
    for i, p in enumerate(prior.free):
        low, first, middle, third, high = np.quantile(z[:, i], [0.05, 0.25, 0.5, 0.75, 0.95])
        open_ = shrunk[i] < OPEN
        color = RED if open_ else MODEL
        ax.plot([low, high], [i, i], color=color, linewidth=1.4, solid_capstyle="butt")
        ax.plot([first, third], [i, i], color=color, linewidth=4.5, solid_capstyle="butt")
        ax.plot(middle, i, "o", color=color, markersize=5, markerfacecolor="white" if open_ else color)
        text = "{} [{}, {}] {}".format(*reported(posterior, p.name), p.unit if p.unit != "-" else "")
        side.text(0.0, i, text, va="center", size="small")
        if not small:
            side.text(1.0, i, contraction_text(shrunk[i]), va="center", ha="right", size="small")
    head = "value [90 % interval]" if small else "value [90 % interval], as reported"
    side.text(0.0, -1.0, head, va="center", size="small", weight="bold")
    if not small:
        side.text(1.0, -1.0, "contraction", va="center", ha="right", size="small", weight="bold")
    side.set_xlim(0, 1)
    side.axis("off")
    ax.set_yticks(range(n), [p.symbol for p in prior.free])
    ax.set_ylim(n - 0.4, -1.5)
    reach = max(3.0, float(np.quantile(np.abs(z), 0.999)) + 0.3)
    ax.set_xlim(-reach, reach)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("prior's standard scores" + ("" if small else " (grey: its 50 and 90 % intervals)"))
    return figure


def contraction_text(value: float) -> str:
    """0.42, or 0.9996 for what is all but settled; a posterior wider than its prior shows as 0."""
    return f"{max(value, 0.0):.2f}" if value < 0.995 else (f"{value:.4f}" if value < 0.9999 else "> 0.9999")


@styled
def corner_figure(draws: Mapping[str, Array], labels: Mapping[str, str] | None = None) -> Figure:
    """A corner plot of draws by name, (n,) each: 50 and 90 % contours, marginals on the diagonal.

    Raises InputError where nothing varies, StyleError for axes of yours: it makes its own.
    """
    refuse_given_axes("a corner plot")
    names = [n for n, x in draws.items() if np.all(np.isfinite(x)) and np.ptp(x) > 0]
    if not names:
        raise InputError("corner plot: no number varies among the draws")
    names = names[:ON_PHONE] if on_phone() else names
    n = len(names)
    table = np.stack([draws[k] for k in names])
    shown = [labels.get(k, k) if labels else k for k in names]
    ranges = [_range(x) for x in table]
    letters = "small" if on_phone() else "x-small"
    with (
        mpl.rc_context({"axes.grid": False, "xtick.labelsize": letters, "ytick.labelsize": letters}),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # corner's own notes on sparse contours
        figure = blank(min(0.95 * n + 1.0, 14.0))
        size = figure.get_figwidth()
        sides = {"left": 0.9 / size, "right": 1 - 0.15 / size, "bottom": 0.8 / size, "top": 1 - 0.25 / size}
        grid = figure.add_gridspec(n, n, **sides, wspace=0.06, hspace=0.06)
        for i in range(n):  # the lower triangle alone: empty axes cost as much as full ones
            for j in range(i + 1):
                ax = figure.add_subplot(grid[i, j])
                if i == j:
                    ax.hist(table[i], bins=30, range=ranges[i], color=MODEL, alpha=0.75, density=True)
                    ax.set_yticks([])
                    ax.spines["left"].set_visible(False)
                    if not on_phone():
                        ax.set_title(shown[i], size="small", pad=3)
                else:
                    inside = {"range": [ranges[j], ranges[i]], "bins": 24, "smooth": 1.0, "levels": (0.5, 0.9)}
                    shown_as = {"plot_datapoints": False, "fill_contours": True, "color": MODEL}
                    corner.hist2d(table[j], table[i], ax=ax, **inside, **shown_as)
                    ax.set_ylim(ranges[i])
                ax.set_xlim(ranges[j])
                ax.xaxis.set_major_locator(MaxNLocator(3, prune="both"))
                ax.tick_params(axis="x", rotation=50, pad=1, labelbottom=i == n - 1)
                if i != j:
                    ax.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
                    ax.tick_params(axis="y", pad=1, labelleft=j == 0)
                if i == n - 1:
                    ax.set_xlabel(shown[j])
                if j == 0 and i > 0:
                    ax.set_ylabel(shown[i])
        figure.align_labels()
    return figure


def _range(x: Array) -> tuple[float, float]:
    low, high = np.quantile(x, [0.002, 0.998])
    pad = 0.08 * (high - low) or abs(low) * 1e-3 + 1e-9
    return float(low - pad), float(high + pad)


def with_unit(symbol: str, unit: str) -> str:
    """A label of an axis or a row."""
    return symbol if unit in ("", "-") else f"{symbol} ({unit})"


def symbol_of(posterior: Posterior, name: str) -> str:
    """A short sign for a quantity: the parameter's own, or 'φ 25 %' for a quantile of the slip forces."""
    for p in posterior.problem.prior.parameters:
        if p.name == name:
            return str(p.symbol)
    if name.startswith("slip_force_q"):
        return f"φ {int(name[12:14])} %"
    return paper_symbol(name)


def identifiable(posterior: Posterior) -> tuple[dict[str, Array], dict[str, str]]:
    """Draws and labels of the scalars that loops determine: noise parameters and open shapes are omitted, quantiles
    of the slip force stand for the shapes, which trade off against each other."""
    found = posterior.quantities()
    draws, labels = {}, {}
    for name in determined_names(posterior):
        draws[name] = np.asarray(found[name].values, dtype=float)
        labels[name] = with_unit(symbol_of(posterior, name), found[name].unit)
    return draws, labels


@styled
def identifiable_corner(posterior: Posterior) -> Figure:
    """Corner plot of the identifiable quantities."""
    return corner_figure(*identifiable(posterior))


@styled
def paper_corner(posterior: Posterior, names: Sequence[str] | None = None) -> Figure:
    """Corner plot of the paper's parameters (Table 1); expect ridges: loops do not determine most of them."""
    found = posterior.problem.model.derived(posterior.problem.parameter_values(posterior.flat_z()))
    chosen = {n: found[n].values for n in (found if names is None else names)}
    for n in ("kn_1_mm", "lambda_s_m"):  # heavy tails as β → 0: show what 98 % of draws do
        if n in chosen:
            chosen[n] = np.clip(chosen[n], *np.quantile(chosen[n], [0.01, 0.99]))
    return corner_figure(chosen, {n: with_unit(paper_symbol(n), found[n].unit) for n in chosen})


_SYMBOLS = {"kp_N_mm": "Kp", "ki_N_mm": "ki", "ku_N_mm": "ku", "kn_1_mm": "kₙ", "lambda_s_m": "λ", "beta": "β"}


def paper_symbol(name: str) -> str:
    """The paper's symbol of one of its parameters, e.g. 'η2' for 'eta2'."""
    if name in _SYMBOLS:
        return _SYMBOLS[name]
    return name.removesuffix("_N").replace("eta", "η")
