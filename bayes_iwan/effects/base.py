"""What an effect is: a physical cause outside the base model, at one stage of the model's line.

An effect brings its own named parameters, and a neutral value of its strength at which it vanishes, so every extended
model contains the base model. Write your own in one file: subclass :class:`Effect`, override one stage, and hand
the file to `bayes-iwan diagnose --effects FILE` (`analyses/own_effect.py` is an example).

Priors of strengths are not in physical units: a strength is given the prior share of the friction force that it moves
(:data:`TYPICAL_SHARE`), and turned into the effect's own unit on the fitted base model
(:mod:`bayes_iwan.diagnosis.search.fitted_sets`). So no effect is favoured because its unit happens to suit the
specimen.

Nature follows no one's formula. So an effect's law is a family: extra parameters, with priors about the classical law,
span what the literature uses and what lies between; where one number cannot, several classes share one `name`. The
verdict names the effect, the report also the law.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from scipy import fft, stats

from bayes_iwan import former_names
from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.errors import InputError, nearest
from bayes_iwan.models import Motion
from bayes_iwan.models.kernels.pointwise import speeds_of_change
from bayes_iwan.models.parameter import Distribution, Parameter, for_distinct
from bayes_iwan.models.scales import Scales
from bayes_iwan.models.simulator import INNER, OUTER, Inner
from bayes_iwan.screen import on_screen

#: prior of an effect's strength: the RMS force it moves over the RMS friction force has this median, ×/÷ e^0.9
TYPICAL_SHARE = 0.08
SHARE_SPREAD = 0.9


class EffectError(InputError):
    """A user's effect that cannot be used; the message names the file and the fix."""


@dataclass(frozen=True)
class ExtraParameter:
    """A parameter beside the strength: symbol, unit, description, prior (frozen scipy.stats), bounds.

    scan : is it tried at several values before a refit (a relaxation time, a gap), or only refined from its prior's
        median, as the parameter that changes a law's form about the classical one?
    """

    symbol: str
    unit: str
    description: str
    prior: Distribution
    lower: float = -np.inf
    upper: float = np.inf
    scan: bool = True


def form(
    symbol: str, description: str, prior: Distribution, lower: float = -np.inf, upper: float = np.inf
) -> ExtraParameter:
    """A dimensionless parameter that changes a law's form about the classical one."""
    return ExtraParameter(symbol, "-", description, prior, lower, upper, scan=False)


class Records(Protocol):
    """What effects ask of a campaign's data: signals on each record's samples, averaged as its force was."""

    @property
    def blocks(self) -> int:
        """Blocks of cycles into which the record of most cycles is divided."""

    @property
    def longest_s(self) -> float:
        """Duration of the longest record."""

    @property
    def durations_s(self) -> Array:
        """(tests,) duration of each record."""

    @property
    def ramps(self) -> np.ndarray:
        """(RAMPS, tests, blocks, H + 1) harmonics of (t/longest_s)^p, p = 0 …, by block of cycles."""

    @property
    def mains_waves(self) -> np.ndarray:
        """(2 mains, 2 harmonics, 2, tests, blocks, H + 1) of cosine and sine at once and at thrice 50 and 60 Hz."""

    @property
    def mains_hz(self) -> Array:
        """(tests, 2)"""

    @property
    def mains_possible(self) -> tuple[bool, ...]:
        """Does a line stand in a record that can show it, or is there no such record?"""


@dataclass(frozen=True)
@on_screen
class Effect:
    """A physical cause outside the model, for one campaign; subclass it to add one of your own.

    A subclass sets `name`, `strength`, `physics`, `reference` and `signature`, gives `first_guess`, and overrides one
    stage (or more): `motion`, `normal_force`, `stiffness`, `slip`, `asymmetry`, `slip_table`, `force`, `around`, or
    `recorded` and `lines` for what does not repeat with the cycle. At strength 0 it must change nothing.

    Parameters
    ----------
    scales
        the campaign's own, in mm, m/s, N and N/mm.
    tests
        files of the fitted tests, for effects with a parameter of their own in each.
    strength_value
        median size of the strength, in its unit, for a typical share of the friction force; None until
        :func:`bayes_iwan.diagnosis.search.fitted_sets.calibrated` has found it on a fitted base model.

    Attributes
    ----------
    name
        one word, by which parameters and files call it.
    law
        the formula in words, for the report.
    statement
        what the base's form lacks, where the effect stands for that.
    strength
        name, symbol, unit and description of the main parameter.
    signed, limit
        whether the strength may be negative, and its largest size.
    evolving
        whether it changes from cycle to cycle.
    needs_clock
        whether it shows only in real times: speeds, delays, frequencies.
    spread
        sd of the strength's logarithm in its prior.
    law_error
        relative error of a strength: nature's law is not quite ours.
    sudden
        whether a first step tells little of it: nothing is seen below a threshold, or the base has adapted to it.
    flexible
        whether it absorbs part of most gaps: then it is sought last and named by its share.
    order
        its place along the signal: specimen 0, rig 1, force channel 2; −1 for the displacement's channel.
    physics, reference, signature, bench, remedy
        texts for the report: the cause, its source, what to expect in the loops, what on the bench would tell it from
        its `look_alikes`, and what an engineer can do about it.

    Raises
    ------
    EffectError
        from :meth:`values_at`, for a parameter that it does not have; a user's file that cannot be used is refused
        where it is loaded.

    References
    ----------
    Modifiers with a neutral value on a nominal prediction: Cranmer, Lewis, Moneta, Shibata & Verkerke, HistFactory,
    CERN-OPEN-2012-016 (2012).

    Examples
    --------
    >>> import numpy as np, bayes_iwan as bi
    >>> class AirDrag(bi.Effect):
    ...     name = "air_drag"
    ...     strength = ("c_N_s2_m2", "c", "N·s²/m²", "force over speed squared")
    ...     physics = "Air is pushed aside."
    ...     reference = "Batchelor, An Introduction to Fluid Dynamics"
    ...     signature = "dissipation that grows with the cube of the speed"
    ...     def first_guess(self):
    ...         return 0.1 * self.scales.slip_N / self.scales.speed_m_s**2
    ...     def force(self, force_N, motion, parameter_values):
    ...         v = motion.velocity_m_s
    ...         return force_N + self.get(parameter_values, "c_N_s2_m2") * v * np.abs(v)
    >>> drag = AirDrag(bi.Scales(1.0, 0.1, 5.0, 1.2, 6.0, 20.0))
    >>> motion = bi.sine_motion(frequency_hz=10.0, amplitude_mm=1.0)
    >>> added = drag.force(np.zeros((1, 1, 128)), motion, drag.values_at(c_N_s2_m2=20.0))
    >>> added.shape, round(float(added.max()), 4)
    ((1, 1, 128), 0.079)
    """

    scales: Scales
    tests: tuple[str, ...] = ()
    strength_value: float | None = None

    name: ClassVar[str]
    law: ClassVar[str] = ""  # the formula, in words, for the report
    statement: ClassVar[str] = ""  # what the base's form lacks, where the effect stands for that
    strength: ClassVar[tuple[str, str, str, str]]  # name, symbol, unit, description of the strength
    signed: ClassVar[bool] = False  # may the strength be negative?
    limit: ClassVar[float] = np.inf  # largest |strength|
    evolving: ClassVar[bool] = False  # does it change from cycle to cycle?
    needs_clock: ClassVar[bool] = False  # does it show only in real times: speeds, delays, frequencies?
    spread: ClassVar[float] = SHARE_SPREAD  # sd of the strength's logarithm in its prior
    law_error: ClassVar[float] = 0.035  # relative error of a strength: nature's law is not quite ours
    sudden: ClassVar[bool] = False
    flexible: ClassVar[bool] = False  # does it absorb part of most gaps? Then it is sought last and named by its share
    order: ClassVar[int] = 0  # specimen 0, rig 1, force channel 2, in the order of the signal
    physics: ClassVar[str]  # one paragraph
    reference: ClassVar[str]
    signature: ClassVar[str]  # what to expect in the loops
    look_alikes: ClassVar[tuple[str, ...]] = ()
    bench: ClassVar[str] = ""  # what on the bench would tell it from its look-alikes
    remedy: ClassVar[str] = ""  # what an engineer can do about it, in one sentence; "" where there is nothing

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        for name in former_names.EFFECT_MEMBERS:
            if name in vars(cls):
                raise EffectError(f"{cls.__name__}.{name} {former_names.renamed(name, former_names.EFFECT_MEMBERS)}")

    def first_guess(self) -> float:
        """A strength of the right order, from the campaign's scales: where calibration starts."""
        raise NotImplementedError

    def possible(self, data: Records) -> bool:
        """Do the records allow it at all? What changes from cycle to cycle needs a record of several blocks of cycles.

        data : the campaign's :class:`bayes_iwan.diagnosis.fits.data.GapData`.
        """
        return not self.evolving or data.blocks > 1

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        """The other parameters by name."""
        return {}

    @property
    def strength_name(self) -> str:
        """Full name of the strength among all parameters."""
        return f"{self.name}.{self.strength[0]}"

    @property
    def typical(self) -> float:
        """Median size of the strength, in its unit, in its prior."""
        return self.first_guess() if self.strength_value is None else self.strength_value

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Strength first, then extra parameters, named `<effect>.<parameter>`."""
        return tuple(replace(p, owner=self.name) for p in (self._strength_parameter(), *self._extra()))

    def _strength_parameter(self) -> Parameter:
        if self.signed:  # a symmetric prior of much the same reach
            return Parameter(
                self.strength_name, *self.strength[1:], stats.norm(scale=1.6 * self.typical), -self.limit, self.limit
            )
        prior = stats.lognorm(s=self.spread, scale=self.typical)
        return Parameter(self.strength_name, *self.strength[1:], prior, 0.0, self.limit)

    def _extra(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{self.name}.{n}", e.symbol, e.unit, e.description, e.prior, e.lower, e.upper)
            for n, e in self.extra_parameters().items()
        )

    @property
    def stages(self) -> frozenset[str]:
        """The stages at which it acts: those that its class overrides."""
        return stages_of(type(self))

    @property
    def strength_names(self) -> tuple[str, ...]:
        """Full names of the parameters that vanish together with the effect: mostly the strength alone."""
        extra = {f"{self.name}.{n}" for n in self.extra_parameters()}
        return tuple(p.name for p in self.parameters if p.name not in extra)

    @property
    def scanned(self) -> tuple[str, ...]:
        """Full names of the extra parameters that are tried at several values before a refit."""
        return tuple(f"{self.name}.{n}" for n, e in self.extra_parameters().items() if e.scan)

    def values_at(self, **given: float) -> dict[str, Array]:
        """Every parameter by full name, (1,): the given ones by short name, the others at their priors' medians.

        Raises EffectError for a name that the effect does not have.
        """
        out = {p.name: p.value(np.zeros(1)) for p in self.parameters}
        for name, value in given.items():
            if f"{self.name}.{name}" not in out:
                raise EffectError(f"{self.name} has no parameter {name!r}{nearest(name, self.extra_parameters())}")
            out[f"{self.name}.{name}"] = np.array([float(value)])
        return out

    @property
    def off(self) -> dict[str, float]:
        """Values by full name at which the effect vanishes; what else it has stands at its prior's median."""
        gone = set(self.strength_names)
        return {p.name: 0.0 if p.name in gone else float(p.value(np.zeros(1))[0]) for p in self.parameters}

    def get(self, parameter_values: ParameterValues, name: str) -> Array:
        """A parameter as (draws, 1, 1)."""
        return parameter_values[f"{self.name}.{name}"][:, None, None]

    def own(self, law: Callable[[ParameterValues], Array], motion: Motion, parameter_values: ParameterValues) -> Array:
        """law(parameter_values), (draws, loops, samples), of the effect's own parameters and the motion alone, computed
        once for draws that have both in common."""
        if motion.draws > 1:
            return law(parameter_values)
        return for_distinct(law, [p.name for p in self.parameters], parameter_values)

    # the stages: each returns what it was given unless overridden
    def motion(self, motion: Motion, parameter_values: ParameterValues) -> Motion:
        """What the specimen does, from what was measured."""
        return motion

    def normal_force(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        """The relative normal force α (the stiffness k(α) follows it)."""
        return alpha

    def stiffness(self, k: Array, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        """The elements' stiffness k(α), N/mm."""
        return k

    def slip(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        """What the elements can carry, relative to rest, at that normal force (the stiffness does not follow it)."""
        return alpha

    def asymmetry(self, parameter_values: ParameterValues) -> Array | float:
        """What the elements carry more where u rises and less where it falls, as a share, (draws,)."""
        return 0.0

    def slip_table(self, tables: Array, top: Array, parameter_values: ParameterValues) -> Array:
        """The slip forces at rest: coefficients (draws, cells, 4) of E[min(Φ, φ)] up to φ = top (draws,), N, as
        :mod:`bayes_iwan.models.series` changes them."""
        return tables

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        """The force that the cell records, from the specimen's."""
        return force_N

    def around(self, inner: Inner, motion: Motion, parameter_values: ParameterValues) -> Array:
        """Anything in series, which needs the force back: inner(motion) is the specimen's force, inner(motion, some)
        that of the draws with these indices alone."""
        return inner(motion)

    def recorded(self, data: Records, parameter_values: ParameterValues) -> Array | None:
        """What the effect adds along whole records, as block harmonics (draws, tests, blocks, H + 1), or None.

        For what does not repeat with the cycle (`evolving`): a drift, a line of the mains.
        data : :class:`bayes_iwan.diagnosis.fits.data.GapData`.
        """
        return None

    def lines(self, data: Records, parameter_values: ParameterValues) -> Array | None:
        """What it adds at 50 and 60 Hz, c + i s of c·cos + s·sin, (draws, tests, 2), or None."""
        return None

    def reported(self, values: Mapping[str, Array]) -> dict[str, tuple[Array, str]]:
        """What is reported: name -> (draws, unit). values: all sampled values."""
        return {p.name.split(".", 1)[1]: (values[p.name], p.unit) for p in self.parameters}

    def within(self, values: ParameterValues, blocks: Motion) -> dict[str, tuple[Array, str]]:
        """What it does within the records, reported before all else where its strength is an end that no record
        reaches: name -> (draws, unit). blocks : every block of cycles of every test."""
        return {}


def stages_of(kind: type[Effect]) -> frozenset[str]:
    """The stages at which effects of a class act."""
    return frozenset(s for s in (*OUTER, *INNER) if getattr(kind, s) is not getattr(Effect, s))


def require_loops(motion: Motion) -> None:
    """Raises EffectError for a record: a law that is solved for its steady loop says nothing of one."""
    if not motion.periodic:
        raise EffectError(
            "filters, lags and what is in series with the specimen are computed for steady loops only, not for a "
            "record from rest; give a periodic motion, leave these effects out, or run the exported C code, which goes "
            "step by step"
        )


def filtered(signal: Array, motion: Motion, response: Callable[[Array], np.ndarray]) -> Array:
    """Steady loops of a motion through a linear filter: signal (…, loops, samples), response(f in Hz (loops, H)) gives
    its complex response (…, loops, H). Raises EffectError for a record."""
    require_loops(motion)
    n = signal.shape[-1]
    f = motion.frequency_hz[:, None] * np.arange(n // 2 + 1)
    gain = response(f)
    out = fft.irfft(fft.rfft(signal, axis=-1) * gain, n=n, axis=-1)
    passes = np.all(gain == 1.0, axis=-1, keepdims=True)  # a filter that does nothing does not even round
    return np.where(passes, signal, out) if passes.any() else out


def moved_by(motion: Motion, displacement_mm: Array) -> Motion:
    """The motion with another displacement (draws, loops, samples); how it changes the speeds is taken by central
    differences over the period, so that no change of displacement is no change of speed. Raises EffectError for a
    record."""
    require_loops(motion)
    velocity, acceleration = np.empty_like(displacement_mm), np.empty_like(displacement_mm)
    u, v, a = map(np.ascontiguousarray, (motion.displacement_mm, motion.velocity_m_s, motion.acceleration_m_s2))
    speeds_of_change(displacement_mm, u, v, a, 0.5 * motion.frequency_hz * motion.samples, velocity, acceleration)
    return motion.moved(displacement_mm, velocity, acceleration)
