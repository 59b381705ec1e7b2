"""The posterior with what the force is linear in integrated out in closed form, and this drawn given the others.

The force is linear in the deviations of the slip forces' density (:mod:`bayes_iwan.models.embedded_error`), in the
parallel spring's stiffness and in the force channel's zero; the likelihood is normal given its noise parameters. It is
so in further elements, too, if stiffness and mean slip force of the family's own elements are given: walkers move in
these, and of the stiffness in that of the elements which hold beyond a small slip force. That is what loops tell, where
k(1) has a long tail: elements that slip at once make no difference. Let c be what is linear in units of the priors'
standard deviations, with normal priors at first, r the whitened residual at c = 0, and H its slope by c. With
A = I + HᵀH,

    ∫ p(r − Hc) N(c) dc = p(r) · exp(½ bᵀA⁻¹b) / √|A|,      b = Hᵀr,      c | the others ~ N(A⁻¹b, A⁻¹).

Where a prior π(c) is no normal one, the integral is multiplied by π(c) / N(c) at the c that was drawn. Its mean is the
integral with π, and a walker that keeps the c it was accepted with samples the exact posterior (Andrieu & Roberts, Ann.
Stat. 37, 2009, 697). So it is with the priors of k(1) and of the mean slip force, which are those of all elements.

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
from bayes_iwan.models.embedded_error import SLIP_NAMES, TAIL_NAMES, elements, friction
from bayes_iwan.models.iwan_parameters import slip_force_names
from bayes_iwan.models.parameter import Z_LIMIT, Parameter
from bayes_iwan.models.simulator import FORCE_ZERO
from bayes_iwan.models.slip_force import FAMILIES
from bayes_iwan.sampling.blocks import Density

_SPRING = "kp_N_mm"
#: a slip force over the family's mean. Of `data/rope_spring` the stiffness of the elements that hold beyond it is known
#: to 0.7 %, k(1) to 4 %
_SEEN = np.array([1.0 / 16.0])
#: what further elements add to, and all elements' over the family's own: the mean slip force is the force of all
#: elements, all slipping
_ADDED_TO = {"k1_N_mm": elements, "mean_slip_force_N": friction}


@dataclass(frozen=True)
class Marginal:
    """A problem's posterior over the coordinates that walkers move in, the others integrated out where that is exact:
    with the Iwan model's embedded error, no effects, a normal likelihood and normal priors of the deviations. Else all
    coordinates are walked in.

    also : what is integrated out beside the deviations
    """

    problem: Problem
    also: tuple[str, ...] = (_SPRING, FORCE_ZERO)

    @cached_property
    def drawn(self) -> NDArray[np.int64]:
        """Places in z of what is integrated out."""
        p = self.problem
        exact = isinstance(p.model, Model) and p.model.embedded and not p.effects and p.likelihood.normal
        tied = {q.tied for q in p.prior.parameters}
        free = [n for n in p.names if exact and n not in tied]
        names = [n for n in SLIP_NAMES if n in free and p.prior[n].normal]
        given = [q.name for q in p.prior.parameters if q.name in _ADDED_TO]
        if not {*given, *TAIL_NAMES} <= {*free} or not {*TAIL_NAMES} <= {*names}:
            names = [n for n in names if n not in TAIL_NAMES]
        return np.array([p.names.index(n) for n in (*names, *(n for n in self.also if n in free))], dtype=np.int64)

    @property
    def density(self) -> Density:
        """As it is sampled."""
        return Density(self, self.walked, self.drawn, self.blocks, self.joined)

    def joined(self, z: Array, sign: int) -> Array:
        """z (…, ndim) with k(1) and the mean slip force of all elements for what walkers move in, or (sign −1) back."""
        out = z.reshape(-1, z.shape[-1]).copy()
        for i, q, factor in self._factors(out):
            out[:, i] = q.score(q.value(out[:, i]) * factor**sign)
        return out.reshape(z.shape)

    def _factors(self, z: Array) -> list[tuple[int, Parameter, Array]]:
        """Place in z (n, ndim) of what walkers move in otherwise, the parameter, and its value (n,) over what they move
        in."""
        p = self.problem
        if {*TAIL_NAMES}.isdisjoint(p.names[i] for i in self.drawn) or not isinstance(p.model, Model):
            return []
        values = p.prior.values(z)
        factors = {n: of(values) for n, of in _ADDED_TO.items() if n in p.names}
        if "mean_slip_force_N" in factors:
            own = values | dict.fromkeys(TAIL_NAMES, np.zeros(len(z))) | {"mean_slip_force_N": np.ones(len(z))}
            factors["k1_N_mm"] /= FAMILIES[p.model.slip].survival(_SEEN, p.parameter_values_of(own))[:, 0]
        return [(p.names.index(n), p.prior[n], factor) for n, factor in factors.items()]

    @cached_property
    def walked(self) -> NDArray[np.int64]:
        """Places in z of the others."""
        return np.setdiff1d(np.arange(self.problem.ndim), self.drawn)

    @cached_property
    def blocks(self) -> tuple[NDArray[np.int64], ...]:
        """Places among those walked in: numbers of the slip forces and k(1), which have broad tails and which others
        follow; the others of the simulator and the effects; the likelihood's."""
        p, names = self.problem, [self.problem.names[i] for i in self.walked]
        first = {"k1_N_mm", *slip_force_names(p.model, p.scales)} if isinstance(p.model, Model) else ()
        which = np.array([0 if n in first else 2 if n in p.noise_names else 1 for n in names])
        return tuple(np.flatnonzero(which == k) for k in range(3) if np.any(which == k))

    def __call__(self, x: Array, random: np.random.RandomState) -> Array:
        """ln of the posterior at x (n, walked), and the deviations' z drawn given x: (n, 1 + drawn)."""
        z = np.zeros((len(x), self.problem.ndim))
        z[:, self.walked] = x
        if len(self.drawn) == 0:
            return self.problem.log_prob(z)[:, None]
        log_prob, mean, root = self._integrated(z)
        unit = random.standard_normal(mean.shape)
        c = mean + np.linalg.solve(root.transpose(0, 2, 1), unit[:, :, None])[:, :, 0]
        z[:, self.drawn], ratio = self._scores(c)
        with np.errstate(invalid="ignore"):
            log_prob = log_prob + ratio + self._prior_ratio(z)
        possible = np.isfinite(log_prob) & np.all(np.abs(z[:, self.drawn]) <= Z_LIMIT, axis=1)  # as elsewhere
        return np.concatenate([np.where(possible, log_prob, -np.inf)[:, None], z[:, self.drawn]], axis=1)

    def _prior_ratio(self, z: Array) -> Array:
        """ln of the prior's density over what walkers move in, over the one by which these were the parameters (n,); no
        number or −∞ where there is none."""
        out = np.zeros(len(z))
        for i, q, factor in self._factors(z):
            value = q.value(z[:, i])
            with np.errstate(invalid="ignore"):
                out += q.log_density(value * factor) + np.log(factor) - q.log_density(value)
        return out

    @cached_property
    def _parameters(self) -> tuple[Parameter, ...]:
        return tuple(self.problem.prior[self.problem.names[i]] for i in self.drawn)

    @cached_property
    def _scale(self) -> Array:
        """(drawn,): a parameter per c, half of what one standard score to either side changes it by."""
        return np.array([0.5 * np.ptp(q.value(np.array([-1.0, 1.0]))) for q in self._parameters])

    def _scores(self, c: Array) -> tuple[Array, Array]:
        """z (n, drawn) of c (n, drawn), and ln of π(c) / N(c) (n,)."""
        z, ratio = c.copy(), np.zeros(len(c))
        for j, (q, scale) in enumerate(zip(self._parameters, self._scale)):
            if not q.normal:
                value = q.value(np.zeros(1)) + scale * c[:, j]
                z[:, j] = q.score(value)
                ratio += q.log_density(value) + np.log(scale) + 0.5 * c[:, j] ** 2
        return z, ratio

    def _integrated(self, z: Array) -> tuple[Array, Array, Array]:
        """At z (n, ndim) with what is drawn at 0: ln of the integral (n,) under normal priors; the mean (n, drawn) of
        the conditional density of c, and the lower triangular root (n, drawn, drawn) of its inverse covariance A."""
        p, count = self.problem, len(self.drawn)
        values, names = p.parameter_values(self.joined(z, 1)), [q.name for q in self._parameters]
        with np.errstate(all="ignore"):
            each = p.residual_and_slopes(values)
            level = p.prior.log_density(z) + p.likelihood.log_likelihood(each[:, 0], values)
            chosen = [0, *(1 + SLIP_NAMES.index(n) for n in names if n in SLIP_NAMES)]
            every = [p.likelihood.rows(each if len(chosen) == each.shape[1] else each[:, chosen], values)]
            alike = {_SPRING: p.motion.displacement_mm[:1], FORCE_ZERO: np.ones((1, *each.shape[2:]))}  # for all draws
            every += [p.likelihood.rows(alike[n][:, None], values) for n in names if n in alike]
            rows = np.concatenate(every, axis=1)
        sound = np.isfinite(level) & np.isfinite(rows).all(axis=(1, 2))
        rows[~sound] = 0.0
        h = rows[:, 1:] * self._scale[:, None]
        root = np.linalg.cholesky(np.eye(count) + h @ h.transpose(0, 2, 1))
        y = np.linalg.solve(root, h @ rows[:, 0, :, None])
        level += 0.5 * np.sum(y[:, :, 0] ** 2, axis=1) - np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        mean = np.linalg.solve(root.transpose(0, 2, 1), y)[:, :, 0]
        return np.where(sound, level, -np.inf), mean, np.asarray(root)
