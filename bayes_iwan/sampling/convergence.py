"""Whether walkers have converged, and how good their draws are.

Draws are shaped (ensembles, steps, walkers) or (ensembles, steps, walkers, quantities) throughout. No walker knows of
another one, so each is a chain of its own. So

- R-hat compares ensembles: each half of an ensemble's run, all its walkers together, is one chain of the
  rank-normalised split R-hat (Vehtari et al. 2021, arXiv 1903.08008), as it is of "superchains" where chains are many
  and short (Margossian et al. 2024, arXiv 2110.13017).
- effective sample sizes, bulk and tail, are ArviZ's of every walker's halves.
- tau, in steps, is emcee's integrated autocorrelation time, of ranks, since a heavy-tailed quantity has none of its
  own: the walkers' autocorrelation functions averaged over all walkers and ensembles, with Sokal's window.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

from bayes_iwan.arrays import Array
from bayes_iwan.screen import on_screen
from bayes_iwan.threads import alongside


@dataclass(frozen=True)
@on_screen
class Convergence:
    """The diagnostics of each quantity, arrays of shape (quantities,) in the order of `names`.

    by_r_hat : names of which R-hat alone is assessed
    """

    names: tuple[str, ...]
    r_hat: Array
    ess_bulk: Array
    ess_tail: Array
    tau_steps: Array
    n_steps: int
    by_r_hat: frozenset[str] = frozenset()

    @property
    def _assessed(self) -> list[int]:
        """Places of the quantities that are assessed by all diagnostics."""
        return [i for i, name in enumerate(self.names) if name not in self.by_r_hat]

    @property
    def worst_r_hat(self) -> float:
        return float(np.max(self.r_hat))

    @property
    def least_ess(self) -> float:
        return float(min(self.ess_bulk[self._assessed].min(), self.ess_tail[self._assessed].min()))

    @property
    def worst_tau(self) -> float:
        return float(np.max(self.tau_steps[self._assessed]))

    def shortfall(self, r_hat: float, ess: float, taus: float) -> str:
        """What does not reach the targets, in words with the worst number's name; empty if all do."""
        parts, names = [], [self.names[i] for i in self._assessed]
        if not self.worst_r_hat <= r_hat:
            parts.append(f"R-hat of {self.names[int(np.argmax(self.r_hat))]} is {self.worst_r_hat:.5g} > {r_hat:g}")
        for kind, every in (("bulk", self.ess_bulk), ("tail", self.ess_tail)):
            values = every[self._assessed]
            if not values.min() >= ess:
                name = names[int(np.argmin(values))]
                parts.append(f"{kind} ESS of {name} is {values.min():.4g} < {ess:g}")
        if not self.n_steps >= taus * self.worst_tau:
            name = names[int(np.argmax(self.tau_steps[self._assessed]))]
            length = self.n_steps / self.worst_tau
            parts.append(f"{self.n_steps} steps are {length:.4g} autocorrelation times of {name} < {taus:g}")
        return "; ".join(parts)


def convergence_of(
    draws: Array, names: tuple[str, ...], thin: int = 1, by_r_hat: frozenset[str] = frozenset()
) -> Convergence:
    """All diagnostics of draws (ensembles, stored steps, walkers, quantities), stored every `thin` steps."""
    x = np.asarray(draws, dtype=float)
    if x.ndim != 4 or x.shape[3] != len(names):
        raise ValueError(f"draws of shape {x.shape} are not (ensembles, steps, walkers, {len(names)})")

    def assessed(column: Array) -> tuple[float, float, float, float]:
        ranks = rank_normalise(column) if _usable(column) else column
        return *r_hat_and_ess(column), ess_tail(column), autocorrelation_time(ranks)

    rows = np.array([*alongside(assessed, [x[..., j] for j in range(x.shape[3])])]).reshape(len(names), 4)
    return Convergence(
        names=tuple(names),
        r_hat=rows[:, 0],
        ess_bulk=rows[:, 1],
        ess_tail=rows[:, 2],
        tau_steps=thin * rows[:, 3],
        n_steps=thin * x.shape[1],
        by_r_hat=by_r_hat,
    )


def _apart(x: Array) -> Array:
    """(ensembles·walkers, steps, 1) of x (ensembles, steps, walkers): every walker a chain of its own."""
    return np.moveaxis(x, 2, 1).reshape(-1, x.shape[1], 1)


def r_hat_and_ess(x: Array) -> tuple[float, float]:
    """Rank-normalised split R-hat across ensembles of x (ensembles, steps, walkers), the larger of bulk and folded, and
    bulk effective sample size: ranking is most of the work of both.

    NaN for draws that are all equal or not finite; R-hat needs at least two ensembles to mean much.
    """
    halves = _halves(x)
    if not _usable(halves):
        return np.nan, np.nan
    bulk, folded = rank_normalise(halves), rank_normalise(np.abs(halves - np.median(halves)))
    return max(_r_hat(bulk), _r_hat(folded)), _ess(_apart(bulk))


def ess_tail(x: Array) -> float:
    """The lesser effective sample size of the 5 % and 95 % quantiles of x (ensembles, steps, walkers)."""
    halves = _apart(_halves(x))
    if not _usable(halves):
        return np.nan
    return min(_ess((halves <= q).astype(float)) for q in np.quantile(halves, [0.05, 0.95]))


def autocorrelation_time(x: Array, window: float = 5.0) -> float:
    """Integrated autocorrelation time of x (ensembles, steps, walkers) in stored steps, at least 1.

    The mean of the ensemble's run is taken off for all its walkers together (a walker that stands still is then
    seen, unlike with its own mean taken off), and the sum ends at the first lag beyond window·tau (Sokal 1989).
    """
    e, n, w = x.shape
    if n < 2:
        return np.nan
    centred = x - x.mean(axis=(1, 2), keepdims=True)
    acf = _autocovariance(np.moveaxis(centred, 1, -1).reshape(e * w, n)).mean(axis=0)
    if not acf[0] > 0:
        return np.nan
    taus = 2.0 * np.cumsum(acf / acf[0]) - 1.0
    beyond = np.arange(n) >= window * taus
    return float(max(1.0, taus[np.argmax(beyond) if beyond.any() else n - 1]))


def rank_normalise(x: Array) -> Array:
    """Normal scores of the ranks of all values of x (Blom's formula), shaped like x."""
    ranks = rankdata(x, method="average").reshape(x.shape)
    return ndtri((ranks - 0.375) / (x.size + 0.25))


def _halves(x: Array) -> Array:
    """(2·ensembles, steps // 2, walkers): each ensemble's run cut in two, an odd middle step omitted."""
    x = np.asarray(x, dtype=float)
    half = x.shape[1] // 2
    return np.concatenate([x[:, :half], x[:, x.shape[1] - half :]])


def _usable(x: Array) -> bool:
    return x.shape[1] >= 4 and bool(np.isfinite(x).all()) and bool(np.ptp(x) > 0)


def _r_hat(z: Array) -> float:
    flat = z.reshape(len(z), -1)
    n = flat.shape[1]
    within = flat.var(axis=1, ddof=1).mean()
    between = flat.mean(axis=1).var(ddof=1)
    if within == 0:
        return np.inf
    return float(np.sqrt(((n - 1) / n * within + between) / within))


def _ess(z: Array) -> float:
    """Var(draws) / Var(grand mean) of z (chains, steps, walkers)."""
    chains, n = z.shape[:2]
    flat = z.reshape(chains, -1)
    size = flat.shape[1]
    spread = flat.mean(axis=1).var(ddof=1) if chains > 1 else 0.0
    variance = (size - 1) / size * flat.var(axis=1, ddof=1).mean() + spread

    means = z.mean(axis=2)  # the series that the estimate of the mean is the average of
    acov = _autocovariance(means - means.mean(axis=1, keepdims=True)).mean(axis=0)
    plus = acov[0] + spread
    if not plus > 0:
        return np.nan
    rho = 1.0 - (acov[0] * n / (n - 1) - acov * n / (n - 1)) / plus
    rho[0] = 1.0
    # Geyer's initial monotone positive sequence, as in Stan and ArviZ.
    even = rho[: n - n % 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(even < 0)
    last = negative[0] if negative.size else len(even)
    pairs = np.minimum.accumulate(even[:last])
    tau = -1.0 + 2.0 * pairs.sum()
    if last < len(even):
        tau += max(rho[2 * last], 0.0)
    tau = max(tau, 1.0 / np.log10(chains * n))
    return float(variance / (plus * tau / (chains * n)))


def _autocovariance(x: Array) -> Array:
    """(rows, n) biased autocovariance of rows of x (rows, n) whose mean has been taken off."""
    n = x.shape[1]
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(x, size, axis=1)
    return np.fft.irfft(spectrum.real**2 + spectrum.imag**2, size, axis=1)[:, :n] / n
