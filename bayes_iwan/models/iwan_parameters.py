"""The sampled parameters of the Iwan model, their default priors, and the maps to the model's and the paper's.

Sampled are the parameters that loops determine one by one: k(1) and its elasticity instead of k_i and k_u, the mean
slip force and the ratios of ordered component means instead of t_i, stick-breaking shares instead of g_i (Σg = 1:
a common factor of all g is one of all k and t), k̃ₙβ and λk̃ₙ (through the campaign's scales) instead of k̃ₙ and λ.
Priors are weakly informative and relative to the campaign's own scales of force, displacement and speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.models import embedded_error, normal_force, slip_force, stiffness
from bayes_iwan.models.parameter import Distribution, Parameter
from bayes_iwan.models.scales import Scales
from bayes_iwan.models.simulator import force_zero

if TYPE_CHECKING:
    from bayes_iwan.models.iwan import Model

#: prior standard deviations of the embedded model error: of the k-th deviation of the slip forces' density the first
#: number over k + 1, of further elements with larger slip forces, of the exponent in k(α), of the corner in α
SLIP_SD, TAIL_SD, EXPONENT_SD, CORNER_SD = 0.5, 0.03, 0.1, 0.05
#: scale of the t₂ priors of what changes the normal force: its median magnitude is 0.27, that of N(0, 0.4). The paper
#: gives no scale, and by Table 1 the change grows with the amplitude (2.2 at 5 mm), so the tails are heavy
NORMAL_FORCE_SCALE = 0.33
#: of ln kp and ln k(1) about what secants of the loops say: friction that jumps at a reversal has a k(1) far above any
#: secant, and a damper next to no kp (an MR damper: 3 sd out of 1.0 each)
STIFFNESS_SD = 1.5
#: prior of β, 0.004 to 5: Table 1's 0.0062 lies 2.4 sd below the median; loops hardly tell β ≲ 0.05 from its limit
EXPONENT_PRIOR = stats.lognorm(s=2.0, scale=0.7)


def _lognormal(median: float, sd: float) -> Distribution:
    return stats.lognorm(s=sd, scale=median)


def _any_change() -> Distribution:
    return stats.t(df=2, scale=NORMAL_FORCE_SCALE)


def _slip_parameters(family: slip_force.SlipForce, s: Scales) -> list[Parameter]:
    prior = _lognormal(1.2 * s.slip_N, 0.8)
    mean = Parameter("mean_slip_force_N", "E[φ]", "N", "mean slip force of the elements at rest", prior)
    if isinstance(family, slip_force.Gammas):
        n = family.components
        ratios = [
            Parameter(f"slip_ratio_{i + 1}{i}", f"m{i + 1}/m{i}", "-",
                      f"mean slip force of component {i + 1} over that of component {i}",
                      stats.lognorm(s=1.0, loc=1.0, scale=1.5))
            for i in range(1, n)
        ]  # fmt: skip
        # the last component carries the upper end of the slip forces: where it may not end steeply, elements that never
        # slip take a part of kp (with η ≤ 16 kp was off by three times as much on the virtual rig, too small in
        # four of five specimens). Much narrower than a sixth of the mean (η = 40) a component is a single slider, which
        # follows the noise of one loop
        shapes = [
            Parameter(f"eta{i}", f"η{i}", "-", f"gamma shape of component {i}", _lognormal(2.0, 0.9), 0.12, 40.0)
            for i in range(1, n + 1)
        ]
        shares = [
            Parameter(f"share_{i}", f"w{i}", "-", f"weight of component {i} among the components from it on",
                      stats.beta(1, n - i) if n - i > 1 else stats.uniform(0, 1))
            for i in range(1, n)
        ]  # fmt: skip
        return [mean, *ratios, *shapes, *shares]
    if family.name == "uniform":
        what, prior = "half width of the density over its mean", stats.uniform(0, 1)
        return [mean, Parameter("slip_width", "w", "-", what, prior, 1e-3, 1.0)]
    if family.name == "gaussian":
        centre = stats.norm(loc=1.2 * s.slip_N, scale=1.5 * s.slip_N)
        sd = _lognormal(0.6 * s.slip_N, 0.8)
        return [
            Parameter("slip_centre_N", "μ", "N", "centre of the uncut normal density", centre),
            Parameter("slip_sd_N", "σ", "N", "standard deviation of the uncut normal density", sd),
        ]
    return [
        Parameter("slip_max_N", "φmax", "N", "largest slip force", _lognormal(2.5 * s.slip_N, 0.8)),
        Parameter("slip_chi", "χ", "-", "exponent of the density", stats.norm(loc=-0.3, scale=0.5), -0.98, 3.0),
        Parameter("slip_end_share", "s", "-", "share of elements that slip at φmax", stats.uniform(0, 1)),
    ]


def parallel_spring(scales: Scales) -> Parameter:
    """Stiffness of a spring beside the friction."""
    prior = _lognormal(0.7 * scales.soft_N_mm, STIFFNESS_SD)
    return Parameter("kp_N_mm", "kp", "N/mm", "stiffness of the parallel spring", prior)


def slip_force_names(model: Model, s: Scales) -> frozenset[str]:
    """Sampled parameters of the slip forces, but for their deviations."""
    return frozenset(p.name for p in _slip_parameters(slip_force.FAMILIES[model.slip], s))


def default_parameters(model: Model, scales: Scales) -> tuple[Parameter, ...]:
    """The sampled parameters of a base model with default priors (effects bring their own)."""
    contact = _lognormal(scales.stiff_N_mm, STIFFNESS_SD)
    out = [
        parallel_spring(scales),
        force_zero(scales),
        Parameter("k1_N_mm", "k(1)", "N/mm", "stiffness of the elements at α = 1", contact),
    ]
    if model.stiffness == "saturating":
        more = ", to which q is added" if model.embedded else ""
        what = f"d ln k / d ln α at α = 1{more}; 0: k constant, 1: k ∝ α"
        out.append(Parameter("elasticity", "ε", "-", what, stats.uniform(0, 1), 1e-4, 1.0 - 1e-4))
    out += _slip_parameters(slip_force.FAMILIES[model.slip], scales)
    slope, rate = (f"relative change of the normal force with {x}" for x in ("displacement", "speed"))
    known = (
        Parameter("beta", "β", "-", "exponent of the Hunt–Crossley normal force", EXPONENT_PRIOR, 0.004, 5.0),
        Parameter("normal_force_slope", "k̃ₙβℓ^β", "-", slope, _any_change()),
        Parameter("normal_force_rate", "λk̃ₙℓ^βv", "-", rate, _any_change()),
    )
    for name in model.normal_force_law.names:
        term = Parameter(name, name, "-", f"coefficient of (u/ℓ)^{name[1:]} in α", _any_change())
        out.append(next((p for p in known if p.name == name), term))
    return (*out, *embedded_parameters()) if model.embedded else tuple(out)


def embedded_parameters() -> tuple[Parameter, ...]:
    """The embedded model error: how far the model's laws may deviate. Narrow, and centred on zero."""
    slip = (
        Parameter(name, f"c{k}", "-", f"deviation {k} of the slip forces' density", stats.norm(scale=SLIP_SD / (k + 1)))
        for k, name in enumerate(embedded_error.SLIP_NAMES[: embedded_error.SLIP_TERMS], start=1)
    )
    tail = (
        Parameter(name, f"s{s}", "-", f"further elements, slip forces {s} times as large", stats.norm(scale=TAIL_SD))
        for s, name in zip(embedded_error.LARGER, embedded_error.TAIL_NAMES)
    )
    exponent, corner = stats.norm(scale=EXPONENT_SD), stats.norm(scale=CORNER_SD)
    return (
        *slip,
        *tail,
        Parameter(embedded_error.STIFFNESS_NAME, "q", "-", "exponent of α that multiplies k(α)", exponent),
        Parameter(embedded_error.CORNER_NAME, "c0", "-", "deviation of α at its corner, u = A", corner),
    )


def model_values(model: Model, values: Mapping[str, Array]) -> ParameterValues:
    """What the physics reads, (draws,) each, from sampled values; effects' own pass through."""
    v = values
    out = {name: v[name] for name in v if name not in ("elasticity",)}
    if model.stiffness == "saturating":
        out["stiffness_ratio"] = stiffness.ratio_of_elasticity(v["elasticity"])
    family = slip_force.FAMILIES[model.slip]
    if "mean_slip_force_N" in v:  # of the family's own elements
        mean = v["mean_slip_force_N"] / _mean_ratio(v)
    if isinstance(family, slip_force.Gammas):
        n = family.components
        remaining = np.ones_like(mean)
        ratio = np.ones_like(remaining)
        weights, ratios = [], []
        for i in range(1, n + 1):
            weight = remaining * v[f"share_{i}"] if i < n else remaining
            remaining = remaining - weight
            ratio = ratio * v[f"slip_ratio_{i}{i - 1}"] if i > 1 else ratio
            weights.append(weight)
            ratios.append(ratio)
        first = mean / sum(w * r for w, r in zip(weights, ratios))
        for i, (w, r) in enumerate(zip(weights, ratios), start=1):
            out[f"g{i}"] = w
            out[f"t{i}_N"] = first * r / v[f"eta{i}"]
    elif family.name == "uniform":
        out["slip_mean_N"] = mean
    return out


def sampled_values(model: Model, parameter_values: Mapping[str, Array]) -> ParameterValues:
    """The inverse of :func:`model_values`; gamma components are put in order of their means."""
    out = dict(parameter_values)
    if model.stiffness == "saturating":
        out["elasticity"] = stiffness.elasticity(parameter_values["stiffness_ratio"])
    family = slip_force.FAMILIES[model.slip]
    if isinstance(family, slip_force.Gammas):
        each = range(1, family.components + 1)
        t, eta, g = (
            np.stack([np.atleast_1d(parameter_values[f"{p}{i}{u}"]) for i in each], axis=1)
            for p, u in (("t", "_N"), ("eta", ""), ("g", ""))
        )
        order = np.argsort(t * eta, axis=1)
        t, eta, g = (np.take_along_axis(a, order, axis=1) for a in (t, eta, g))
        means, remaining = t * eta, np.ones(len(t))
        for i in each:
            out[f"eta{i}"] = eta[:, i - 1]
            if i > 1:
                out[f"slip_ratio_{i}{i - 1}"] = means[:, i - 1] / means[:, i - 2]
            if i < family.components:
                out[f"share_{i}"] = g[:, i - 1] / remaining
                remaining = remaining - g[:, i - 1]
    if isinstance(family, slip_force.Gammas) or family.name == "uniform":
        out["mean_slip_force_N"] = family.mean(parameter_values) * _mean_ratio(parameter_values)
    return out


def _mean_ratio(values: Mapping[str, Array]) -> Array | float:
    """Mean slip force of all elements over that of the family's own; 1 where no value names further ones."""
    if embedded_error.TAIL_NAMES[0] not in values:
        return 1.0
    return embedded_error.friction(values) / embedded_error.elements(values)


def paper_values(model: Model, parameter_values: Mapping[str, Array]) -> ParameterValues:
    """The paper's parameters (Table 1 for the full model) from the model's: kp, ki, ku, t, η, g, k̃ₙ, λ, β."""
    out = {"kp_N_mm": parameter_values["kp_N_mm"]}
    out |= stiffness.paper_stiffness(parameter_values) if model.stiffness == "saturating" else {}
    out |= {name: parameter_values[name] for name in model.slip_family.names}
    if "beta" in model.normal_force_law.names:
        out |= normal_force.paper_hunt_crossley(parameter_values, model.reference)
    else:
        out |= {name: parameter_values[name] for name in model.normal_force_law.names}
    return out


PAPER_UNITS = dict.fromkeys(("kp_N_mm", "ki_N_mm", "ku_N_mm"), "N/mm") | dict.fromkeys(("t1_N", "t2_N", "t3_N"), "N")
PAPER_UNITS |= {"kn_1_mm": "1/mm^β", "lambda_s_m": "s/m"}
