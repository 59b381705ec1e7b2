"""One identification problem: loops, model, prior and likelihood, as batch functions of the coordinates z."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.loops.averaging import fitted_loops
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.effects.base import Effect
from bayes_iwan.inference.setup.config import Config, settings_of
from bayes_iwan.inference.setup.likelihood import Likelihood, make_likelihood
from bayes_iwan.inference.setup.loop_error import goal_function, harmonics_of
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.priors import ParameterError, Prior, configured
from bayes_iwan.inference.setup.settings import ModelSettings
from bayes_iwan.models import Model, ModelError, Motion, Scales, Simulator
from bayes_iwan.models.motion import motion_of
from bayes_iwan.models.simulator import FORCE_ZERO, OUTER, force_zero, inner_effects, offered, recorded_force
from bayes_iwan.screen import Named, on_screen


@dataclass(frozen=True)
@on_screen
class Problem:
    """Everything that a posterior depends on; made by :func:`make_problem`.

    Its functions take many draws at a time: z arrays are (draws, ndim), ndim = len(names); a z is the standard normal
    score of its parameter's prior.

    Parameters
    ----------
    loops
        the fitted tests.
    scales
        the campaign's own, which priors refer to: mm, m/s, N and N/mm.
    model
        the simulator.
    prior
        all parameters with their priors: the simulator's, the effects', the noise's.
    likelihood
        how measured loops differ from predicted ones.
    effects
        what acts on the simulator and on the channels, in the order in which they act.

    Raises
    ------
    ParameterError, ModelError
        from :func:`make_problem` and :meth:`with_effects`, where these do not go together.

    References
    ----------
    Coordinates in which the prior is white: Murray & Adams, Slice sampling covariance hyperparameters of latent
    Gaussian models, Advances in Neural Information Processing Systems 23 (2010).

    Examples
    --------
    >>> import tempfile, numpy as np, bayes_iwan as bi
    >>> plan = [bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)]
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign(plan, seed=1).write(folder)
    >>> problem = bi.make_problem(bi.check(folder).loops, {"model": {"slip": "gamma1", "normal_force": "constant"}})
    >>> z = problem.prior.draw(np.random.default_rng(0), 5)
    >>> z.shape == (5, problem.ndim), problem.predict(z).shape, problem.log_prob(z).shape
    (True, (5, 2, 128), (5,))
    """

    loops: tuple[Loop, ...]
    scales: Scales
    model: Simulator
    prior: Prior
    likelihood: Likelihood
    effects: tuple[Effect, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, in z's order."""
        return self.prior.names

    @cached_property
    def noise_names(self) -> frozenset[str]:
        """Parameters of the likelihood, free or not."""
        return frozenset(p.name for p in self.likelihood.parameters)

    @property
    def units(self) -> Units:
        """What displacement and force are measured in."""
        return self.loops[0].record.units

    @property
    def ndim(self) -> int:
        """Free parameters."""
        return len(self.names)

    @cached_property
    def motion(self) -> Motion:
        """What the fitted tests did, (1, tests, samples) each."""
        return motion_of(self.loops)

    @cached_property
    def measured_N(self) -> Array:
        """Averaged force of each fitted test, (tests, samples), N."""
        return np.stack([x.force_N for x in self.loops])

    def parameter_values(self, z: Array) -> ParameterValues:
        """What simulator, effects and likelihood read, by name, (draws,) each."""
        return self.parameter_values_of(self.prior.values(z))

    def parameter_values_of(self, values: ParameterValues) -> ParameterValues:
        """The same from sampled values by name."""
        return {**values, **self.model.parameter_values(values)}

    def force(self, parameter_values: ParameterValues, motion: Motion | None = None) -> Array:
        """Predicted force (draws, loops, samples), N, effects and force zero included, for the campaign's motion or
        another."""
        return recorded_force(self.model, self.effects, parameter_values, self.motion if motion is None else motion)

    def friction_force(self, parameter_values: ParameterValues, motion: Motion | None = None) -> Array:
        """Its friction (draws, loops, samples), N, of a specimen moved exactly so."""
        at = self.motion if motion is None else motion
        return self.model.friction_force(parameter_values, at, inner_effects(self.effects))

    def predict(self, z: Array, motion: Motion | None = None) -> Array:
        """Predicted force (draws, loops, samples), N, for the campaign's motion or another."""
        return self.force(self.parameter_values(z), motion)

    def residual(self, z: Array) -> Array:
        """Measured − predicted, (draws, tests, samples), N."""
        return self.measured_N - self.predict(z)

    def residual_and_slopes(self, parameter_values: ParameterValues) -> Array:
        """Measured − predicted, and the prediction's derivatives by the slip forces' deviations, (draws,
        1 + deviations, tests, samples), N, of the Iwan model without effects."""
        out: Array = self.model.force_and_slopes(parameter_values, self.motion)  # type: ignore[attr-defined]
        out[:, 0] = self.measured_N - out[:, 0] - parameter_values[FORCE_ZERO][:, None, None]
        return out

    def log_likelihood(self, z: Array) -> Array:
        """Log-likelihood of each draw, (draws,); −∞ where the prediction is not finite."""
        parameter_values = self.parameter_values(z)
        with np.errstate(all="ignore"):
            value = self.likelihood.log_likelihood(self.measured_N - self.force(parameter_values), parameter_values)
        return np.where(np.isfinite(value), value, -np.inf)

    def log_prob(self, z: Array) -> Array:
        """Log posterior density over z, up to the evidence, (draws,)."""
        prior = self.prior.log_density(z)
        out = np.full(len(prior), -np.inf)
        inside = np.isfinite(prior)
        if inside.any():
            out[inside] = prior[inside] + self.log_likelihood(np.atleast_2d(z)[inside])
        return out

    def pointwise(self, z: Array) -> Array:
        """Log-likelihood by datum, (draws, points)."""
        parameter_values = self.parameter_values(z)
        return self.likelihood.pointwise(self.measured_N - self.force(parameter_values), parameter_values)

    def rows(self, z: Array) -> Array:
        """Whitened residuals and the prior's rows, (draws, m + ndim): half their squares is −log posterior + const
        while the noise parameters stay put."""
        parameter_values = self.parameter_values(z)
        whitened = self.likelihood.rows(self.measured_N - self.force(parameter_values), parameter_values)
        return np.concatenate([whitened, np.atleast_2d(z)], axis=1)

    def goal(self, z: Array) -> Array:
        """The paper's objective, Eq. (8), (draws,); +∞ where the prediction is not finite."""
        value = goal_function(self.residual(z), self.motion.displacement_mm[0], self.motion.amplitude_mm)
        return np.where(np.isfinite(value), value, np.inf)

    def with_force(self, force_N: Array) -> Problem:
        """The same problem with other measured forces (tests, samples) in N: drawn loops, to be identified in turn.

        Priors, scales and what the likelihood takes from the measured loops (noise, friction level, weights) stay.
        """
        c = harmonics_of(np.asarray(force_N, float), self.loops[0].harmonics_N.size)
        loops = tuple(replace(x, force_N=f, harmonics_N=h) for x, f, h in zip(self.loops, force_N, c))
        return replace(self, loops=loops, likelihood=self.likelihood.of_loops(loops))

    def with_effects(self, effects: Sequence[Effect]) -> Problem:
        """The same problem with these effects and no others, in the order in which they act.

        Raises ModelError for an effect at a stage that the simulator does not offer.
        """
        for effect in effects:
            if not offered(effect.stages, self.model):
                missing = sorted(effect.stages - self.model.stages - {*OUTER})
                raise ModelError(
                    f"the effect {effect.name} acts on {missing[0]}, which the simulator {self.model.name} does not "
                    f"offer; add {missing[0]!r} to its stages and honour it in force, or leave the effect out"
                )
        own = tuple(p for p in self.prior.parameters if not p.owner)
        theirs = tuple(p if p.owner == e.name else replace(p, owner=e.name) for e in effects for p in e.parameters)
        return replace(self, effects=tuple(effects), prior=Prior((*own, *theirs)))

    def fingerprint(self) -> dict[str, str]:
        """Hashes of what a stored posterior depends on, part by part."""
        data = hashlib.sha256()
        for loop in self.loops:
            for array in (loop.displacement_mm, loop.velocity_m_s, loop.force_N, loop.noise_N):
                data.update(np.ascontiguousarray(array).tobytes())
        effects = "+".join(e.name for e in self.effects)
        return Named(
            {
                "data": data.hexdigest(),
                "model": f"{self.model.name}/{effects}",
                "likelihood": self.likelihood.name,
                "prior": "; ".join(f"{p.name} ~ {p.prior_text()}" for p in self.prior.parameters),
                "names": ",".join(self.names),
            }
        )


def make_problem(
    loops: Sequence[Loop], config: Config = None, simulator: Simulator | None = None, scales: Scales | None = None
) -> Problem:
    """A problem from the loops whose role is not "held-out".

    Parameters
    ----------
    loops
        averaged tests.
    config
        a TOML file, its tables (see :mod:`bayes_iwan.inference.setup.config`), or settings; [model], [likelihood] and
        [parameters] are read.
    simulator
        what is fitted (default: the Iwan model of the [model] table).
    scales
        force, length and speed that priors refer to (default: taken from the loops).

    Returns
    -------
    Problem
        prior, simulator and likelihood of these loops, in coordinates z of standard normal prior.

    Raises
    ------
    ConfigError, ParameterError
        a table that makes no sense.
    ValueError
        no test is left to fit.

    Examples
    --------
    >>> import tempfile, numpy as np, bayes_iwan as bi
    >>> plan = [bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)]
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign(plan, seed=1).write(folder)
    >>> problem = bi.make_problem(bi.read_campaign(folder).loops(), {"model": {"slip": "gamma1"}})
    >>> problem.predict(problem.prior.draw(np.random.default_rng(0), 3)).shape  # (draws, tests, samples), N
    (3, 2, 128)
    """
    settings = settings_of(config)
    fitted = fitted_loops(loops)
    scales = scales_of(fitted) if scales is None else scales
    parts = settings.model if fitted[0].record.clock else settings.model.without_speed
    model = iwan_model(scales, parts) if simulator is None else simulator
    likelihood = make_likelihood(settings.likelihood.kind, fitted, scales)
    parameters = list(model.parameters(scales))
    if all(p.name != FORCE_ZERO for p in parameters):
        parameters.append(force_zero(scales))
    parameters += likelihood.parameters
    units = fitted[0].record.units
    parameters = [replace(p, unit=units.text(p.unit), description=units.text(p.description)) for p in parameters]
    problem = Problem(fitted, scales, model, Prior(configured(parameters, settings.parameters)), likelihood)
    if all(name in problem.noise_names for name in problem.names):
        raise ParameterError("every parameter of the model is fixed or tied; leave at least one of them free")
    return problem


def iwan_model(scales: Scales, parts: ModelSettings) -> Model:
    """The Iwan model of the chosen parts on a campaign's scales."""
    return Model(scales.reference, parts.slip, parts.normal_force, parts.stiffness, embedded=parts.embedded)
