"""The posterior with the slip forces' deviations integrated out in closed form, and these drawn given the others.

The force is linear in the deviations c of the slip forces' density (:mod:`bayes_iwan.models.embedded_error`), their
priors are normal, and so is the likelihood given its noise parameters. With r the whitened residual without
deviations, H its slope by them in units of their prior's standard deviation, and A = I + HᵀH,

    ∫ p(r − Hc) N(c) dc = p(r) · exp(½ bᵀA⁻¹b) / √|A|,      b = Hᵀr,      c | the others ~ N(A⁻¹b, A⁻¹).

What remains is a broad posterior of few numbers, where the joint one is a thin curved sheet of many: the walkers of an
ensemble sampler find their way in it by themselves.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Model
from bayes_iwan.models.embedded_error import SLIP_NAMES
from bayes_iwan.models.iwan_parameters import slip_form_names
from bayes_iwan.models.parameter import Z_LIMIT


@dataclass(frozen=True)
class Marginal:
    """A problem's posterior over the coordinates that walkers move in, the others integrated out where that is exact:
    with the Iwan model's embedded error, no effects, a normal likelihood and normal priors of the deviations. Else all
    coordinates are walked in."""

    problem: Problem

    @cached_property
    def drawn(self) -> NDArray[np.int64]:
        """Places in z of the deviations that are integrated out."""
        p = self.problem
        exact = isinstance(p.model, Model) and p.model.embedded and not p.effects and p.likelihood.normal
        names = [n for n in SLIP_NAMES if exact and n in p.names and p.prior[n].normal]
        tied = {q.tied for q in p.prior.parameters}
        return np.array([p.names.index(n) for n in names if n not in tied], dtype=np.int64)

    @cached_property
    def walked(self) -> NDArray[np.int64]:
        """Places in z of the others."""
        return np.setdiff1d(np.arange(self.problem.ndim), self.drawn)

    @cached_property
    def blocks(self) -> tuple[NDArray[np.int64], ...]:
        """Places among those walked in: numbers of the slip forces' form, which the others follow; the others of
        the simulator and the effects; the likelihood's."""
        p, names = self.problem, [self.problem.names[i] for i in self.walked]
        form = slip_form_names(p.model, p.scales) if isinstance(p.model, Model) else ()
        noise = {q.name for q in p.likelihood.parameters}
        which = np.array([0 if n in form else 2 if n in noise else 1 for n in names])
        return tuple(np.flatnonzero(which == k) for k in range(3) if np.any(which == k))

    def __call__(self, x: Array, random: np.random.RandomState) -> Array:
        """ln of the posterior at x (n, walked), and the deviations' z drawn given x: (n, 1 + drawn)."""
        z = np.zeros((len(x), self.problem.ndim))
        z[:, self.walked] = x
        if len(self.drawn) == 0:
            return self.problem.log_prob(z)[:, None]
        log_prob, mean, root = self._integrated(z)
        unit = random.standard_normal(mean.shape)
        drawn = mean + np.linalg.solve(root.transpose(0, 2, 1), unit[:, :, None])[:, :, 0]
        log_prob = np.where(np.all(np.abs(drawn) <= Z_LIMIT, axis=1), log_prob, -np.inf)  # as elsewhere
        return np.concatenate([log_prob[:, None], drawn], axis=1)

    @cached_property
    def _scale(self) -> tuple[slice | list[int], Array]:
        """Which of the deviations are drawn, and their priors' standard deviations."""
        p = self.problem
        names = [p.names[i] for i in self.drawn]
        chosen = [0, *(1 + SLIP_NAMES.index(n) for n in names)]
        every = chosen == list(range(1 + len(SLIP_NAMES)))
        return slice(None) if every else chosen, np.array([p.prior[n].prior.std() for n in names])

    def _integrated(self, z: Array) -> tuple[Array, Array, Array]:
        """At z (n, ndim) with deviations 0: ln of the integral (n,); the mean (n, drawn) of their conditional density,
        and the lower triangular root (n, drawn, drawn) of its inverse covariance A."""
        p, (chosen, scale) = self.problem, self._scale
        values, count = p.parameter_values(z), len(scale)
        with np.errstate(all="ignore"):
            each = p.residual_and_slopes(values)
            level = p.prior.log_density(z) + p.likelihood.log_likelihood(each[:, 0], values)
            repeated = {q.name: np.repeat(values[q.name], count + 1) for q in p.likelihood.parameters}
            rows = p.likelihood.rows(each[:, chosen].reshape(-1, *each.shape[2:]), repeated)
        rows = rows.reshape(len(z), count + 1, -1)
        sound = np.isfinite(level) & np.isfinite(rows).all(axis=(1, 2))
        rows[~sound] = 0.0
        h = rows[:, 1:] * scale[:, None]
        root = np.linalg.cholesky(np.eye(count) + h @ h.transpose(0, 2, 1))
        y = np.linalg.solve(root, h @ rows[:, 0, :, None])
        level += 0.5 * np.sum(y[:, :, 0] ** 2, axis=1) - np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        mean = np.linalg.solve(root.transpose(0, 2, 1), y)[:, :, 0]
        return np.where(sound, level, -np.inf), mean, np.asarray(root)
