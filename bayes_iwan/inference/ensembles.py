"""Sampling a posterior with emcee: several independent ensembles, advanced in one batch call each half-step.

Three phases. *Warm-up* (differential evolution, snooker and stretch moves) brings the walkers from wherever they
started towards the posterior. *Adaptation* fits a proposal (a straightening map and a mixture of t distributions,
see proposal.py) to the latest draws, runs with it, and fits again, until the walkers drift no more and the proposals
get no better. Then the proposal is frozen and *production* starts: its draws are the only ones that count, and
the run ends by itself when they meet the targets.

The proposal is fitted to the draws of all ensembles together. That does not spoil R-hat: once frozen it is a fixed
distribution, and the ensembles are independent chains given it, each going on from where its own warm-up left it.
Pooling lets an ensemble that is stuck in a lesser mode leave it; it cannot hide one that stays, because R-hat compares
where the ensembles are, not how they propose.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from bayes_iwan.inference.checkpoint import Checkpoint, CheckpointError
from bayes_iwan.inference.convergence import Convergence, autocorrelation_time, diagnose
from bayes_iwan.inference.moves import (
    DifferentialEvolutionMove,
    MixtureMove,
    SnookerMove,
    StretchMove,
)
from bayes_iwan.inference.proposal import Proposal, fit_proposal
from bayes_iwan.inference.walkers import SamplingError, Walkers, WeighedMoves

__all__ = ["Chains", "SamplingError", "sample"]

Array = NDArray[np.float64]
BatchFunction = Callable[[Array], Array]

_STAGES = ("warmup", "production")
_WARMUP_STEPS = 200
_ROUND_STEPS = (100, 400)  # the first and the longest round of adaptation
_ROUNDS = (8, 24)  # the least and the most
_STORE_EVERY = 5  # steps between stored draws before production
_MATERIAL = 20_000  # draws that a proposal is fitted to
_CHUNK = 100  # steps of production between two checkpoints


@dataclass(frozen=True)
class Chains:
    """Production draws of independent ensembles, and what they are worth.

    draws[e, i, w] is walker w of ensemble e at step thin·(i + 1) of production. quantities are what the caller's
    function makes of the same draws. convergence covers names + quantity_names (None if production is too short
    to say anything). converged says whether all targets were met; message says why the run ended and, if not
    converged, what is short of its target.
    """

    names: tuple[str, ...]
    quantity_names: tuple[str, ...]
    draws: Array  # (ensembles, stored, walkers, ndim)
    log_prob: Array  # (ensembles, stored, walkers)
    quantities: Array  # (ensembles, stored, walkers, len(quantity_names))
    thin: int
    n_steps: int
    n_evaluations: int
    acceptance: float
    convergence: Convergence | None
    converged: bool
    message: str
    seed: int
    seconds: float
    proposal: Proposal | None

    def flat(self, n: int | None = None) -> Array:
        """(n, ndim) draws spread evenly over all ensembles, steps and walkers; all of them by default."""
        return self.draws.reshape(-1, self.draws.shape[-1])[self._even(n)]

    def flat_quantities(self, n: int | None = None) -> Array:
        """(n, len(quantity_names)) the quantities of the draws that `flat(n)` returns."""
        return self.quantities.reshape(-1, self.quantities.shape[-1])[self._even(n)]

    def _even(self, n: int | None) -> NDArray[np.int64]:
        total = int(np.prod(self.draws.shape[:3]))
        return np.arange(total) if n is None or n >= total else np.linspace(0, total - 1, n).round().astype(int)


def sample(
    log_prob: BatchFunction,
    population: ArrayLike,
    *,
    names: Sequence[str],
    seed: int,
    quantities: BatchFunction | None = None,
    quantity_names: Sequence[str] = (),
    checkpoint: Path | None = None,
    fingerprint: Mapping[str, str] | None = None,
    n_ensembles: int = 4,
    n_walkers: int = 64,
    budget_s: float | None = None,
    max_steps: int = 200_000,
    target_r_hat: float = 1.01,
    target_ess: float = 400.0,
    chain_taus: float = 50.0,
    progress: bool = True,
    resume: bool = False,
) -> Chains:
    """Draw from exp(log_prob) until converged, or until the budget is used up, which the result then says.

    Parameters
    ----------
    log_prob : maps z (n, ndim) to (n,), -inf where impossible; rows must not depend on each other. The numbers
        should be unbounded and of comparable size (the map looks for the directions in which z varies most).
    population : (members, ndim), where the walkers start; widely spread members make R-hat meaningful.
    quantities : maps z (n, ndim) to (n, len(quantity_names)), other numbers that must converge too.
    checkpoint : HDF5 file that is written every few hundred steps; with `resume` a run goes on from it to the
        very same draws. A file that is not there yet is started.
    fingerprint : named hashes of whatever makes this run what it is; a checkpoint with others is refused.
    budget_s : seconds of this call after which it stops; max_steps : steps of production.
    target_r_hat, target_ess, chain_taus : all of R-hat <= , bulk and tail ESS >= , and steps >= chain_taus · tau,
        for every sampled number and every quantity.

    Raises
    ------
    SamplingError : no usable start, or log_prob returns NaN, +inf or a wrong shape.
    CheckpointError : a checkpoint that exists without `resume`, or that belongs to another run.

    The same seed gives the same draws, bit for bit, on the same machine, whether interrupted and resumed or not.
    Ctrl-C ends the run with the draws that are there; the message says so.
    """
    names, quantity_names = tuple(names), tuple(quantity_names)
    if (quantities is None) != (not quantity_names):
        raise SamplingError("quantities and quantity_names go together")
    settings = {"seed": str(seed), "n_ensembles": str(n_ensembles), "n_walkers": str(n_walkers)}
    run = _Run(
        Walkers(log_prob, n_ensembles, n_walkers, len(names)), seed, dict(fingerprint or {}) | settings, names, budget_s
    )
    interrupted = False
    stop, short, result = "", "no draws yet", None
    with tqdm(disable=None if progress else True, unit="step") as bar:
        run.bar = bar
        try:
            run.begin(np.asarray(population, dtype=float), checkpoint, resume)
            run.adapt()
            bar.set_description("sampling")
            while not stop:
                enough = run.n_steps >= run.next_check or run.n_steps >= max_steps or run.late
                if enough and run.draws.shape[1] >= 8:
                    values = run.evaluate(quantities, len(quantity_names))
                    result = diagnose(np.concatenate([run.draws, values], axis=3), names + quantity_names, run.thin)
                    short = result.shortfall(target_r_hat, target_ess, chain_taus)
                    run.plan_check(result, target_ess, chain_taus)
                    bar.set_postfix_str(
                        f"R-hat {result.worst_r_hat:.3f}, ESS {result.least_ess:.0f}, tau {result.worst_tau:.0f}"
                    )
                    if not short:
                        stop = "converged"
                    elif run.n_steps >= max_steps:
                        stop = f"stopped at {max_steps} steps"
                    elif run.late:
                        stop = f"stopped at the time budget of {budget_s:g} s"
                if not stop:
                    run.produce(min(_CHUNK, max_steps - run.n_steps))
        except KeyboardInterrupt:
            interrupted = True
        finally:
            run.close()
        if interrupted:
            stop = "interrupted" if run.n_steps else "interrupted in warm-up, before any draw that counts"
            values = run.evaluate(quantities, len(quantity_names))
            if run.draws.shape[1] >= 8:
                result = diagnose(np.concatenate([run.draws, values], axis=3), names + quantity_names, run.thin)
                short = result.shortfall(target_r_hat, target_ess, chain_taus)
    return Chains(
        names=names,
        quantity_names=quantity_names,
        draws=run.draws,
        log_prob=run.log_prob,
        quantities=values,
        thin=run.thin,
        n_steps=run.n_steps,
        n_evaluations=run.walkers.n_evaluations,
        acceptance=run.acceptance,
        convergence=result,
        converged=not short,
        message=stop if not short else f"not converged: {stop}; {short}",
        seed=seed,
        seconds=time.monotonic() - run.began,
        proposal=run.proposal,
    )


def _local_moves(ensembles: int) -> WeighedMoves:
    return (
        (DifferentialEvolutionMove(ensembles=ensembles), 0.7),
        (SnookerMove(ensembles=ensembles), 0.15),
        (StretchMove(ensembles=ensembles), 0.15),
    )


def _with_proposal(proposal: Proposal, ensembles: int, share: float, independent: float) -> WeighedMoves:
    global_move = MixtureMove(proposal, independent=independent, ensembles=ensembles)
    return ((global_move, share), *((move, (1.0 - share) * w) for move, w in _local_moves(ensembles)))


class _Run:
    """One run: its walkers, the stage it is in, what it has drawn, and its checkpoint."""

    def __init__(
        self,
        walkers: Walkers,
        seed: int,
        fingerprint: Mapping[str, str],
        names: tuple[str, ...],
        budget_s: float | None,
    ) -> None:
        self.walkers, self.seed, self.fingerprint, self.names = walkers, seed, fingerprint, names
        self.began = time.monotonic()
        self.deadline = None if budget_s is None else self.began + budget_s
        self.bar: tqdm = None  # type: ignore[assignment]
        self.file: Checkpoint | None = None
        self.proposal: Proposal | None = None
        self.rounds: list[tuple[Array, Array]] = []  # draws and log_prob of warm-up and each round of adaptation
        self.quality: list[float] = []  # acceptance of independence proposals at the start of each round
        self.population = np.empty((0, walkers.ndim))
        self.population_log_prob = np.empty(0)
        self.producing = False
        self.thin = 1
        self.next_check = 0
        self._kept: list[tuple[Array, Array]] = []
        self._values: list[Array] = []

    # -- draws that count ------------------------------------------------------------------------------------

    @property
    def draws(self) -> Array:
        shape = (self.walkers.ensembles, 0, self.walkers.walkers, self.walkers.ndim)
        return np.concatenate([np.empty(shape), *(d for d, _ in self._kept)], axis=1)

    @property
    def log_prob(self) -> Array:
        shape = (self.walkers.ensembles, 0, self.walkers.walkers)
        return np.concatenate([np.empty(shape), *(v for _, v in self._kept)], axis=1)

    @property
    def n_steps(self) -> int:
        return self.thin * sum(d.shape[1] for d, _ in self._kept)

    @property
    def acceptance(self) -> float:
        """Share of stored draws that differ from the one before of the same walker (per stored step)."""
        draws = self.draws
        return float(np.mean(np.diff(draws[..., 0], axis=1) != 0)) if draws.shape[1] > 1 else float("nan")

    @property
    def late(self) -> bool:
        return self.deadline is not None and time.monotonic() > self.deadline

    def evaluate(self, quantities: BatchFunction | None, n: int) -> Array:
        """(ensembles, stored, walkers, n) quantities of the draws; each draw is evaluated once."""
        for draws, _ in self._kept[len(self._values) :]:
            if quantities is None:
                values = np.empty((*draws.shape[:3], 0))
            else:
                values = np.asarray(quantities(draws.reshape(-1, draws.shape[-1])), dtype=float)
                if values.shape != (draws[..., 0].size, n):
                    raise SamplingError(f"quantities(z) returned shape {values.shape}; it must be (n, {n})")
            self._values.append(values.reshape(*draws.shape[:3], n))
        shape = (self.walkers.ensembles, 0, self.walkers.walkers, n)
        return np.concatenate([np.empty(shape), *self._values], axis=1)

    # -- stages ----------------------------------------------------------------------------------------------

    def begin(self, population: Array, checkpoint: Path | None, resume: bool) -> None:
        self.population = population
        if checkpoint is not None and Path(checkpoint).exists():
            if not resume:
                raise CheckpointError(f"{checkpoint} exists already: resume from it, or delete it to start anew")
            self.file, snapshot = Checkpoint.resume(checkpoint, self.fingerprint, self.names, _STAGES)
            self._restore(snapshot.state, snapshot.draws, snapshot.log_prob)
            return
        self.population_log_prob = self.walkers.place(population, self.seed)
        if checkpoint is not None:
            total = self.walkers.ensembles * self.walkers.walkers
            self.file = Checkpoint.create(checkpoint, self.fingerprint, self.names, total, _STAGES)
            self._commit()

    def adapt(self) -> None:
        """Warm-up and adaptation, from wherever the run is; afterwards the proposal is frozen."""
        e = self.walkers.ensembles
        if not self.rounds:
            self.bar.set_description("warm-up")
            self._round(_local_moves(e), _WARMUP_STEPS)
        self.bar.set_description("adapting")
        while not self.producing:
            k = len(self.rounds)
            rng = np.random.default_rng([self.seed, 3, k])
            fresh = k <= 3  # the first charts are laid out on walkers that are still on their way
            self.proposal = fit_proposal(self._material(rng), rng, start=None if fresh else self.proposal)
            self.quality.append(self._acceptance(rng))
            self.bar.set_postfix_str(f"global proposals accepted {self.quality[-1]:.3f}")
            if self._settled() or k >= _ROUNDS[1] or self.late:
                break
            steps = int(min(_ROUND_STEPS[0] * 1.2 ** (k - 1), _ROUND_STEPS[1])) // _STORE_EVERY * _STORE_EVERY
            self._round(_with_proposal(self.proposal, e, 0.8, 0.5), steps)
        if not self.producing:
            draws = self.rounds[-1][0]
            tau = _STORE_EVERY * max(autocorrelation_time(draws[..., j]) for j in range(self.walkers.ndim))
            self.thin = int(np.clip(tau / 5, 1, 50))
            self.next_check = 5 * self.thin * 10
            self.producing = True
            self._commit()

    def _round(self, moves: WeighedMoves, steps: int) -> None:
        draws, values = self.walkers.advance(moves, steps, _STORE_EVERY, self.bar.update, None)
        self.walkers.rescue(draws, values, [self.seed, 4, len(self.rounds)])
        self.rounds.append((draws, values))
        self._commit(("warmup", draws, values))

    def _material(self, rng: np.random.Generator) -> Array:
        """(n, ndim) what the proposal is fitted to: recent draws, and those of the population that are as probable.

        The population keeps charts in lesser modes alive, where too few walkers are to learn a chart from.
        """
        assert self.walkers.state is not None
        recent = np.unique(self._recent().reshape(-1, self.walkers.ndim), axis=0)
        if len(recent) > _MATERIAL:
            recent = recent[np.sort(rng.choice(len(recent), size=_MATERIAL, replace=False))]
        floor = np.median(self.walkers.state.log_prob) - 3.0 * self.walkers.ndim
        return np.concatenate([recent, self.population[self.population_log_prob > floor][:2000]])

    def _recent(self) -> Array:
        """The draws to fit to: the latest rounds, as far back as log_prob did not yet drift."""
        chosen = [self.rounds[-1][0]]
        level, spread = self._level(-1)
        for k in range(2, min(len(self.rounds), 9)):
            if abs(self._level(-k)[0] - level) > 0.5 * spread:
                break
            chosen.insert(0, self.rounds[-k][0])
        if len(chosen) == 1:
            chosen[0] = chosen[0][:, chosen[0].shape[1] // 2 :]
        return np.concatenate(chosen, axis=1)

    def _level(self, k: int) -> tuple[float, float]:
        """Mean and spread of log_prob in the second half of round k."""
        values = self.rounds[k][1]
        half = values[:, values.shape[1] // 2 :]
        return float(np.median(half)), float(np.std(half))

    def _acceptance(self, rng: np.random.Generator) -> float:
        """Mean acceptance of proposals drawn afresh from the proposal, at the walkers' present places."""
        assert self.proposal is not None and self.walkers.state is not None
        n = 512
        state = np.random.RandomState(int(rng.integers(2**31)))
        at = self.walkers.state.coords
        rows = rng.integers(len(at), size=n)
        z, factor = self.proposal.step(at[rows], 1.0, np.ones(1), state)
        log_ratio = self.walkers.log_prob(z) - self.walkers.state.log_prob[rows] + factor
        return float(np.mean(np.exp(np.minimum(log_ratio, 0.0))))

    def _settled(self) -> bool:
        """Neither the level of log_prob nor the quality of the proposals has changed over the last rounds."""
        if len(self.rounds) < _ROUNDS[0]:
            return False
        level, spread = self._level(-1)
        still = all(abs(self._level(-k)[0] - level) < 0.25 * spread for k in (2, 3))
        return still and max(self.quality[-2:]) < 1.1 * max(self.quality[-4:-2])

    def produce(self, steps: int) -> None:
        """Go on for about `steps` steps of production."""
        assert self.proposal is not None
        steps = -(-steps // self.thin) * self.thin
        moves = _with_proposal(self.proposal, self.walkers.ensembles, 0.85, 0.7)
        draws, values = self.walkers.advance(moves, steps, self.thin, self.bar.update, self.deadline)
        self._kept.append((draws, values))
        self._commit(("production", draws, values))

    def plan_check(self, result: Convergence, target_ess: float, chain_taus: float) -> None:
        """When to look again: where the targets will be met at the present rate, but before twice the length."""
        n = self.n_steps
        ess = result.least_ess if result.least_ess > 0 else 1.0
        guess = 1.03 * max(chain_taus * result.worst_tau, n * target_ess / ess)
        self.next_check = int(np.clip(guess, 1.1 * n, 2.0 * n)) if np.isfinite(guess) else 2 * n

    # -- checkpoints -----------------------------------------------------------------------------------------

    def _commit(self, *appended: tuple[str, Array, Array]) -> None:
        if self.file is None:
            return
        for stage, draws, values in appended:
            self.file.append(stage, self.walkers.in_one_row(draws), self.walkers.in_one_row(values))
        state = self.walkers.to_arrays() | {
            "rounds": np.array([d.shape[1] for d, _ in self.rounds]),
            "quality": np.array(self.quality),
            "population_log_prob": self.population_log_prob,
            "producing": np.array(self.producing),
            "thin": np.array(self.thin),
            "next_check": np.array(self.next_check),
        }
        if self.proposal is not None:
            state |= {f"proposal_{k}": v for k, v in self.proposal.to_arrays().items()}
        self.file.commit(state)

    def _restore(self, state: Mapping[str, NDArray], draws: Mapping[str, Array], values: Mapping[str, Array]) -> None:
        self.walkers.from_arrays(state)
        self.population_log_prob = state["population_log_prob"]
        w = self.walkers
        ends = np.cumsum(state["rounds"], dtype=int)[:-1]
        if len(state["rounds"]):
            parts = zip(np.split(draws["warmup"], ends), np.split(values["warmup"], ends))
            self.rounds = [(w.by_ensemble(d), w.by_ensemble(v)) for d, v in parts]
        self.quality = [float(q) for q in state["quality"]]
        self.producing, self.thin = bool(state["producing"]), int(state["thin"])
        self.next_check = int(state["next_check"])
        if len(draws["production"]):
            self._kept = [(w.by_ensemble(draws["production"]), w.by_ensemble(values["production"]))]
        numbers = {k.removeprefix("proposal_"): v for k, v in state.items() if k.startswith("proposal_")}
        self.proposal = Proposal.from_arrays(numbers) if numbers else None

    def close(self) -> None:
        if self.file is not None:
            self.file.close()
            self.file = None
