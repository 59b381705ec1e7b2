"""The posterior with what the force is linear in integrated out in closed form, and this drawn given the others.

The force is linear in the deviations of the slip forces' density (:mod:`bayes_iwan.models.embedded_error`), in the
parallel spring's stiffness and in the force channel's zero; the likelihood is normal given its noise parameters. It is
so in further elements, too, if stiffness and mean slip force of the family's own elements are given: walkers move in
these, and of the stiffness in that of the elements which hold beyond a small slip force. That is what loops tell, where
k(1) has a long tail: elements that slip at once make no difference. Let c be what is linear in units of the priors'
standard deviations, with normal priors at first, r the whitened residual at c = 0, and H its slope by c. With
A = I + HᵀH,

    ∫ p(r − Hc) N(c) dc = p(r) · exp(½ bᵀA⁻¹b) / √|A|,      b = Hᵀr,      c | the others ~ N(A⁻¹b, A⁻¹).

Where a prior π(c) is not normal, the integral is multiplied by π(c) / N(c) at the c that was drawn. Its mean is the
integral with π, and a walker that keeps the c it was accepted with samples the exact posterior (Andrieu & Roberts, Ann.
Stat. 37, 2009, 697). So it is for k(1) and the mean slip force, whose priors are those of all elements. A c that the
prior forbids, a stiffness below zero, is not drawn: the integral counts by the share of the normal density in which c
is possible. Some records tell nothing of the force channel's zero. Then its prior decides, a t distribution with tails
so heavy that its ratio to a normal density has no finite variance, and walkers would stand still. So it is integrated
with a mixture of normal densities in N's place that is nearly that t. Their integrals differ in one number, the root's
last; from which of them c is drawn is drawn first.

What remains is a broad posterior of few numbers, where the joint one is a thin curved sheet of many: the walkers of an
ensemble sampler find their way in it by themselves.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

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
#: precisions by which normal densities, weighted by their exponential distribution's mass, are a t distribution of two
#: degrees of freedom
_PRECISION = np.logspace(-6.0, 1.2, 25)
_HALFWAY = np.sqrt(_PRECISION[1:] * _PRECISION[:-1])
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
        if not {*_ADDED_TO} <= {*free} or not {*TAIL_NAMES} <= {*names}:  # or the family has no mean slip force
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
        factors = {n: of(values) for n, of in _ADDED_TO.items()}
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
        each, y, root = self._integrated(z)
        chosen = np.argmax(each + random.gumbel(size=each.shape), axis=1)
        with np.errstate(invalid="ignore"):  # of places from which nothing possible can be drawn
            c, share = self._given(chosen, y, root, random.standard_normal(y.shape))
            z[:, self.drawn], ratio = self._scores(c)
            log_prob = np.logaddexp.reduce(each, axis=1) + share + ratio + self._prior_ratio(z)
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

    @cached_property
    def _last(self) -> tuple[Array, Array]:
        """Precisions (k,) of the normal densities that stand for the prior of what is drawn last, and ln of their
        weights."""
        last = self._parameters[-1]
        if last.name != FORCE_ZERO or last.normal:
            return np.ones(1), np.zeros(1)
        mass = np.diff(-np.exp(-np.r_[0.0, _HALFWAY, np.inf]))
        # by how many of a standard t's units one standard score changes it
        return _PRECISION * special.stdtrit(2.0, special.ndtr(1.0)) ** 2, np.log(mass)

    def _given(self, chosen: NDArray[np.int64], y: Array, root: Array, unit: Array) -> tuple[Array, Array]:
        """c (n, drawn) by the normal density of what is drawn last that was chosen (n,), from :meth:`_integrated` and
        standard normal numbers unit (n, drawn); and ln of the share (n,) of that density in which c is possible, to
        which it is drawn."""
        root, y, before = root.copy(), y.copy(), root[:, -1, -1]
        root[:, -1, -1] = np.sqrt(before**2 - 1.0 + self._last[0][chosen])
        y[:, -1] *= before / root[:, -1, -1]
        right, share, upper = y + unit, np.zeros(len(y)), root.transpose(0, 2, 1)
        for j in np.flatnonzero(np.isfinite(self._least))[::-1]:  # each is given those after it
            after = np.linalg.solve(upper[:, j + 1 :, j + 1 :], right[:, j + 1 :, None])
            least = self._least[j] * root[:, j, j] - y[:, j] + (upper[:, j, None, j + 1 :] @ after)[:, 0, 0]
            right[:, j] = y[:, j] - special.ndtri(special.ndtr(-unit[:, j]) * special.ndtr(-least))
            share += special.log_ndtr(-least)
        return np.asarray(np.linalg.solve(upper, right[:, :, None])[:, :, 0]), share

    @cached_property
    def _least(self) -> Array:
        """(drawn,): c of the lower end of each prior that is no normal one, −∞ of the others."""
        some = [
            -np.inf if q.normal else max(q.lower, q.prior.support()[0]) - q.value(np.zeros(1))[0]
            for q in self._parameters
        ]
        return np.array(some) / self._scale

    def _scores(self, c: Array) -> tuple[Array, Array]:
        """z (n, drawn) of c (n, drawn), and ln of π(c) over the density it was integrated with (n,)."""
        z, ratio = c.copy(), np.zeros(len(c))
        precision, log_weight = self._last
        for j, (q, scale) in enumerate(zip(self._parameters, self._scale)):
            if not q.normal:
                value, power = q.value(np.zeros(1)) + scale * c[:, j], 0.5 * c[:, j] ** 2
                z[:, j] = q.score(value)
                ratio += q.log_density(value) + np.log(scale)
                if j < c.shape[1] - 1:
                    ratio += power
                else:
                    each = log_weight + 0.5 * np.log(precision) - power[:, None] * precision
                    ratio -= np.logaddexp.reduce(each, axis=1)
        return z, ratio

    def _integrated(self, z: Array) -> tuple[Array, Array, Array]:
        """At z (n, ndim) with what is drawn at 0: ln of the integral (n, k) with each of the normal densities of what
        is drawn last, weighted; L⁻¹b (n, drawn); and L (n, drawn, drawn), the lower triangular root of A. The latter
        two are with N for what is drawn last, too."""
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
        y, diagonal = y[:, :, 0], np.diagonal(root, axis1=1, axis2=2)
        level += 0.5 * np.sum(y[:, :-1] ** 2, axis=1) - np.sum(np.log(diagonal[:, :-1]), axis=1)
        precision, log_weight = self._last
        both = diagonal[:, -1:] ** 2 - 1.0 + precision
        last = 0.5 * ((y[:, -1:] * diagonal[:, -1:]) ** 2 / both + np.log(precision / both)) + log_weight
        return np.where(sound[:, None], level[:, None] + last, -np.inf), y, np.asarray(root)
