"""Laws in time, as C: what each effect of the catalogue does at a stage of the step, for any motion.

C sees u (mm), v (m/s) and a (m/s²) at the end of the step, h (s) its length, A (mm) of Eq. (11), alpha, k (N/mm), slip
(what the elements carry, relative to rest) and force (N). `$name` is a parameter of the effect, `@name` a state; the
parameters `p->length_mm` and `p->speed_m_s` are the campaign's scales. Each law is the effect's own formula
(:mod:`bayes_iwan.effects`), with what is a filter over a closed loop there as a state here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import nnls

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects import (
    along_record,
    conditions,
    friction,
    lag,
    measuring_chain,
    model_form,
    mounting,
    paper_stages,
    specimen_forces,
)
from bayes_iwan.effects.base import Effect
from bayes_iwan.models import stiffness
from bayes_iwan.models.motion import Y_FLOOR

#: relaxing branches that stand for a spread of relaxation times
BRANCHES = 12
#: smallest stroke, over the campaign's largest amplitude, that counts as half a cycle
LEAST_STROKE = 0.05
#: a tested frequency range, Hz
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Law:
    """An effect's law at each stage where it acts: "before", "alpha", "stiffness", "slip", "force", "asymmetry",
    "specimen" (in the place of the call of it).

    states : length and value at rest by name. numbers : own parameters from the effect and what the simulator reads,
    (sets,) or (sets, n) each; without it the effect's parameters. note : what differs from the effect's own law.
    """

    stages: Mapping[str, str] = field(default_factory=dict)
    states: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    numbers: Callable[[Effect, ParameterValues, Range], dict[str, Array]] | None = None
    note: str = ""


def law(
    *,
    states: Mapping[str, tuple[int, float]] | None = None,
    numbers: Callable[[Effect, ParameterValues, Range], dict[str, Array]] | None = None,
    note: str = "",
    **stages: str,
) -> Law:
    """A law by its C at each stage."""
    return Law(stages=stages, states=states or {}, numbers=numbers, note=note)


#: the states of `half_cycle`
CYCLE_STATES = {f"cycle_{n}": (1, 0.0) for n in ("way", "far_mm", "far_s", "turn_mm", "turn_s", "amplitude_mm", "hz")}


def branches(effect: Effect, values: ParameterValues, tested: Range) -> dict[str, Array]:
    """Stiffness and time of relaxing branches, (sets, BRANCHES), that follow a fractional Maxwell branch from a
    hundredth of the lowest tested frequency to thirty times the highest; exact for one relaxation time."""
    k, tau, order = (np.atleast_1d(values[f"{effect.name}.{n}"]) for n in ("k_N_mm", "tau_s", "spread"))
    f = np.geomspace(tested[0] / 100.0, tested[1] * 30.0, 160)
    time = np.geomspace(1.0 / (2 * np.pi * f[-1]), 1.0 / (2 * np.pi * f[0]), BRANCHES)
    at = 2j * np.pi * f[:, None] * time
    parts = at / (1.0 + at)
    stacked = np.concatenate([parts.real, parts.imag])
    out_k, out_tau = np.zeros((len(k), BRANCHES)), np.tile(time, (len(k), 1))
    for d in range(len(k)):
        if order[d] == 1.0:
            out_k[d, 0], out_tau[d, 0] = k[d], tau[d]
            continue
        s = (2j * np.pi * f * tau[d]) ** order[d]
        wanted = s / (1.0 + s)
        out_k[d] = k[d] * nnls(stacked, np.concatenate([wanted.real, wanted.imag]))[0]
    return {"k_N_mm": out_k, "tau_s": out_tau}


def _of_speed_term(effect: Effect, values: ParameterValues, tested: Range) -> dict[str, Array]:
    assert isinstance(effect, paper_stages.SpeedDependentNormalForce)
    return {"rate": values[effect.strength_name], "beta": effect.exponent(values)}


def _ratio(effect: Effect, values: ParameterValues, tested: Range) -> dict[str, Array]:
    value = np.atleast_1d(values[effect.strength_name])
    ratio = stiffness.ratio_of_elasticity(
        np.clip(value, paper_stages.LEAST_ELASTICITY, paper_stages.StiffnessOfNormalForce.limit)
    )
    return {"ratio": np.where(value < paper_stages.LEAST_ELASTICITY, 0.0, ratio)}


_LATE = """{
    const double tau = $tau_s * exp((alpha > @late ? -0.5 : 0.5) * $release);
    @late = relaxed(alpha, @before, @late, h, tau);
"""
_LATE_STATES = {"late": (1, 1.0), "before": (1, 1.0)}
_SLOW_SPEED = "    @speed_m_s = relaxed(fabs(v), @before_m_s, @speed_m_s, h, $memory_s);\n    @before_m_s = fabs(v);\n"
_SPEED_STATES = {"speed_m_s": (1, 0.0), "before_m_s": (1, 0.0)}
_PER_MM = "2e-3 * 3.14159265358979323846 * s->cycle_hz / p->speed_m_s"
_COUNTED = (
    f"cycles and their amplitudes are counted by half cycles between reversals, strokes below {LEAST_STROKE:g} of the "
    "largest tested amplitude aside"
)

LAWS: dict[type[Effect], Law] = {
    specimen_forces.ViscousDamping: law(
        force="""{
    const double slow = $thinning_m_s * $thinning_m_s, thinned = (slow + v * v) / (slow + p->speed_m_s * p->speed_m_s);
    const double way = (v > 0.0 ? 1.0 : (v < 0.0 ? -1.0 : 0.0)) + $one_way;
    force += $c_N_s_mm * 1e3 * fabs(v) * power_of(thinned, 0.5 * ($exponent - 1.0)) * way;
}"""
    ),
    specimen_forces.MaxwellBranch: law(
        force=f"""{{
    int i;
    for (i = 0; i < {BRANCHES}; i++) {{
        @q_N[i] = relaxed(0.0, 0.0, @q_N[i], h, $tau_s[i])
                  + $k_N_mm[i] * (u - s->u_mm) * (1.0 - relaxed(1.0, 0.0, 0.0, h, $tau_s[i]));
        force += @q_N[i];
    }}
}}""",
        states={"q_N": (BRANCHES, 0.0)},
        numbers=branches,
        note=f"a spread of relaxation times is {BRANCHES} branches, fitted from 1/100 of the lowest to 30 times the "
        "highest tested frequency",
    ),
    specimen_forces.MovingMass: law(
        force="""{
    if ($period_s > 1e-9) {
        resonance(2.0 * 3.14159265358979323846 / $period_s, $damping, h, s->a_m_s2, a, &@y, &@speed);
    } else {
        @y = a;
    }
    force += $m_kg * @y;
}""",
        states={"y": (1, 0.0), "speed": (1, 0.0)},
    ),
    specimen_forces.QuadraticStiffness: law(
        force="force += $k2_N_mm2 * p->length_mm * p->length_mm * power_of(u / p->length_mm, $exponent)\n"
        "         * (1.0 + $one_sided * (u > 0.0 ? 1.0 : (u < 0.0 ? -1.0 : 0.0)));"
    ),
    specimen_forces.CubicStiffness: law(
        force="force += $k3_N_mm3 * p->length_mm * p->length_mm * p->length_mm * (u < 0.0 ? -1.0 : 1.0)\n"
        "         * power_of(u / p->length_mm, $exponent);"
    ),
    specimen_forces.TrilinearStiffness: law(
        force="force += $k3_N_mm3 * p->length_mm * p->length_mm * p->length_mm * (u < 0.0 ? -1.0 : 1.0)\n"
        "         * beyond(fabs(u) / p->length_mm, $knee, $width) / beyond(1.0, $knee, $width);"
    ),
    specimen_forces.EndStop: law(
        force="""{
    const double side = $k_N_mm < 0.0 ? -1.0 : 1.0;
    force += $k_N_mm * contact(side * u - $clearance_mm, side * v, 0.1 * p->length_mm, $exponent, $loss_s_m);
}"""
    ),
    specimen_forces.EndStops: law(
        force="""{
    const double side = u < 0.0 ? -1.0 : 1.0;
    force += $k_N_mm * side * contact(fabs(u) - $clearance_mm, side * v, 0.1 * p->length_mm, $exponent, $loss_s_m);
}"""
    ),
    friction.StribeckWeakening: law(
        slip=_SLOW_SPEED + "    slip *= 1.0 - $drop\n"
        "        * (1.0 - falling(power_of(fmax(@speed_m_s, 0.0) / $v_s_m_s, $exponent), $tail));",
        states=_SPEED_STATES,
    ),
    friction.RateStrengthening: law(
        slip=_SLOW_SPEED + "    slip *= 1.0 + $c * growing(fmax(@speed_m_s, 0.0) / $v0_m_s, $power);",
        states=_SPEED_STATES,
    ),
    friction.FrictionFade: law(
        before=f"""if (turned) {{
    const double per_mm = {_PER_MM};
    @x += 0.5 * pow(s->cycle_amplitude_mm / p->length_mm, $by_stroke) / $cycles
          / pow(per_mm * p->length_mm, $by_time);
    @level = pow(per_mm * s->cycle_amplitude_mm, $by_power);
    @left = fmax(1.0 - $drop * @level * (1.0 - falling(@x, $tail)) * exp(-$recovery * @x), 0.05);
}}""",
        stiffness="k *= pow(@left, $of_stiffness);",
        slip="slip *= @left;",
        states={"x": (1, 0.0), "level": (1, 1.0), "left": (1, 1.0)},
        note=_COUNTED,
    ),
    friction.SpringSoftening: law(
        before=f"""if (turned) {{
    const double per_mm = {_PER_MM};
    @x += 0.5 * pow(per_mm * p->length_mm, $by_cycles) / (s->cycle_hz * $tau_s);
    @level = pow(per_mm * s->cycle_amplitude_mm, $by_power)
             * pow(s->cycle_amplitude_mm / p->length_mm, $by_amplitude);
    @left = fmax(1.0 - $drop * @level * (1.0 - falling(@x, $tail)), 0.05);
}}""",
        stiffness="k *= @left;",
        force="force -= (1.0 - @left) * p->kp_N_mm * u;",
        states={"x": (1, 0.0), "level": (1, 1.0), "left": (1, 1.0)},
        note=_COUNTED,
    ),
    friction.DirectionDependentFriction: law(asymmetry="$asymmetry"),
    friction.DirectionDependentNormalForce: law(alpha="alpha *= 1.0 + $asymmetry * tanh(v / $v0_m_s);"),
    friction.DirectionDependentSlip: law(slip="slip *= 1.0 + $asymmetry * tanh(v / $v0_m_s);"),
    lag.NormalForceLag: law(
        alpha=_LATE + f"    @before = alpha;\n    alpha = fmax(@late, {lag.LEAST!r});\n}}", states=_LATE_STATES
    ),
    lag.NormalForceLagFromStart: law(
        alpha=_LATE
        + """    @slow = relaxed(alpha, @before, @slow, h, $tau_s * $slow_ratio);
    @before = alpha;
    @start_left *= exp(-h / fmax($tau_s * $slow_ratio, 1e-15));
    alpha = fmax(@late + $slow_share * (@slow - @late) + $start * @start_left, """
        + f"{lag.LEAST!r});\n}}",
        states={**_LATE_STATES, "slow": (1, 1.0), "start_left": (1, 1.0)},
        note="the simulation's start is a record's start",
    ),
    mounting.FreePlay: law(
        specimen="""if ($play_mm > 0.0) {
    force = through_play(p, s, h, u, v, 0.5 * $play_mm, 0.5 * $play_mm * $softness);
} else {
    force = specimen(p, s, h, u, v);
}""",
        states={n: (1, 0.0) for n in ("mid_mm", "at_mm", "N")},
        note="a closed cycle that turns while soft ends close can gain up to 1e-2 of force times stroke (play as wide "
        "as the stroke), 5e-4 otherwise",
    ),
    model_form.SlipForcesFree: law(),
    model_form.SlipLimit: law(),
    model_form.StiffnessLawFree: law(stiffness="k *= exp(log(alpha) * ($exponent + 0.5 * $growth * log(alpha)));"),
    model_form.NormalForceFree: law(
        alpha="""{
    const double x = u / p->length_mm, y = v / p->speed_m_s, w = fabs(y);
    alpha *= exp($u * x + $u2 * x * x + $speed * w + $u_speed * x * w + $direction * y + $u_direction * x * y);
}"""
    ),
    paper_stages.VaryingNormalForce: law(
        alpha=f"""{{
    const double y = log(fmax(A - u, {Y_FLOOR} * A) / p->length_mm), top = log(A / p->length_mm);
    alpha += $slope * (expm1($beta * y) - expm1($beta * top)) / $beta;
}}"""
    ),
    paper_stages.SpeedDependentNormalForce: law(
        alpha=f"alpha += $rate * pow(fmax(A - u, {Y_FLOOR} * A) / p->length_mm, $beta) * fabs(v) / p->speed_m_s;",
        numbers=_of_speed_term,
    ),
    paper_stages.StiffnessOfNormalForce: law(
        stiffness="k *= $ratio > 0.0 ? expm1(-$ratio * alpha) / expm1(-$ratio) : 1.0;", numbers=_ratio
    ),
    conditions.SlipFollowsCondition: law(note="at the mean of the condition over the tests"),
    conditions.StiffnessFollowsCondition: law(note="at the mean of the condition over the tests"),
}

_OF_CHANNELS = (*measuring_chain.EFFECTS, *along_record.EFFECTS)
#: what belongs to the rig and its channels, not to the device: excluded, and the model card says so
OF_THE_RIG: tuple[type[Effect], ...] = (*_OF_CHANNELS, mounting.RigCompliance, conditions.ZeroFollowsCondition)
