"""The state of a sampling run: its walkers, the proposal it adapts and then freezes, its draws and its checkpoint.

Beside the walkers that draw from the posterior as many draw from its power 0.6, and the two change places (parallel
tempering). A proposal fitted to draws is too thin where the posterior's tails bend away from it, and a walker that gets
there stands still for thousands of steps; the tempered walkers lie on the same bent sheets but farther out, so that the
proposal, which is fitted to both alike, has seen the tails (a defensive mixture: Hesterberg 1995), and a walker
that is stuck all the same gets away by an exchange. Adaptation has `CROWD` times as many walkers as production: what
the proposal learns from are places, and many walkers for a short time have been to more of them than few for long;
production in turn is as long as its autocorrelation time demands, however many walkers it has.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm.auto import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.common.checkpoint import Checkpoint, CheckpointError
from bayes_iwan.sampling.common.convergence import Convergence, longest_autocorrelation_time
from bayes_iwan.sampling.common.plan import Plan
from bayes_iwan.sampling.ensemble.moves import DifferentialEvolutionMove, MixtureMove, SnookerMove, StretchMove
from bayes_iwan.sampling.ensemble.proposal import Proposal, fit_proposal
from bayes_iwan.sampling.ensemble.walkers import Walkers, WeighedMoves, by_block, in_one_row

STAGES = ("tempered", "plain", "production")
POWERS = (1.0, 0.6)
CROWD = 2
_WARMUP_STEPS = 60
_ROUND_STEPS = (60, 160)  # the first and the longest round of adaptation
_ROUNDS = (10, 18)  # the least and the most; with seven, production takes three times as long, with 13 hardly less
_STORE_EVERY = 5  # steps between stored draws before production
_MATERIAL = 24_000  # draws that a proposal is fitted to
_RESTARTS = 3  # times at most that slow production is taken for more adaptation
_TRIAL_STEPS = 1500  # of production before its speed is judged


def _local_moves(ensembles: int) -> WeighedMoves:
    return (
        (DifferentialEvolutionMove(ensembles=ensembles, powers=POWERS), 0.7),
        (SnookerMove(ensembles=ensembles, powers=POWERS), 0.15),
        (StretchMove(ensembles=ensembles, powers=POWERS), 0.15),
    )


def _with_proposal(proposal: Proposal, ensembles: int, share: float, independent: float) -> WeighedMoves:
    global_move = MixtureMove(proposal, independent=independent, ensembles=ensembles, powers=POWERS)
    return ((global_move, share), *((move, (1.0 - share) * w) for move, w in _local_moves(ensembles)))


class Run:
    """One run: its walkers, the stage it is in, what it has drawn, and its checkpoint."""

    def __init__(
        self,
        walkers: Walkers,
        seed: int,
        fingerprint: Mapping[str, str],
        names: tuple[str, ...],
        budget_s: float | None,
    ) -> None:
        self.seed, self.fingerprint, self.names = seed, fingerprint, names
        self.producers = walkers.walkers
        self.walkers = walkers.resized(CROWD * walkers.walkers)  # until production
        self.began = time.monotonic()
        self.deadline = None if budget_s is None else self.began + budget_s
        self.adapt_by = np.inf if budget_s is None else self.began + 0.5 * budget_s  # the rest is for draws that count
        self.bar: tqdm = None  # type: ignore[assignment]
        self.file: Checkpoint | None = None
        self.proposal: Proposal | None = None
        self.rounds: list[tuple[Array, Array]] = []  # plain draws and log_prob of warm-up and each adaptation round
        self.tempered: list[tuple[Array, Array]] = []  # those of the tempered rung
        self.quality: list[float] = []  # acceptance of independence proposals at the start of each round
        self.population = np.empty((0, walkers.ndim))
        self.population_log_prob = np.empty(0)
        self.producing = False
        self.thin = 1
        self.next_check = 0
        self.restarts: list[int] = []  # stored steps of production that each restart left behind, all in all
        self.hurried = False  # the clock, and not the draws, ended adaptation or forbade a restart
        self._kept: list[tuple[Array, Array]] = []
        self._values: list[Array] = []

    # -- draws that count ------------------------------------------------------------------------------------

    @property
    def draws(self) -> Array:
        shape = (self.walkers.ensembles, 0, self.producers, self.walkers.ndim)
        return np.concatenate([np.empty(shape), *(d for d, _ in self._kept)], axis=1)

    @property
    def log_prob(self) -> Array:
        shape = (self.walkers.ensembles, 0, self.producers)
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

    def evaluate(self, plan: Plan) -> Array:
        """(ensembles, stored, walkers, quantities) of the draws; each draw is evaluated once."""
        self._values += [plan.evaluated(draws) for draws, _ in self._kept[len(self._values) :]]
        shape = (self.walkers.ensembles, 0, self.producers, len(plan.quantity_names))
        return np.concatenate([np.empty(shape), *self._values], axis=1)

    # -- stages ----------------------------------------------------------------------------------------------

    def begin(self, population: Array, checkpoint: Path | None, resume: bool) -> None:
        self.population = population
        if checkpoint is not None and Path(checkpoint).exists():
            if not resume:
                raise CheckpointError(f"{checkpoint} exists already: resume from it, or delete it to start anew")
            self.file, snapshot = Checkpoint.resume(checkpoint, self.fingerprint, self.names, STAGES)
            if snapshot.damaged:
                said = f"{checkpoint}: its last {snapshot.damaged} bytes are cut short or damaged; going on from before"
                self.bar.write(said, file=sys.stderr)
            try:
                self._restore(snapshot.state, snapshot.draws, snapshot.log_prob)
            except Exception as error:  # its checksums hold, so that somebody else has written it
                self.close()
                said = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
                raise CheckpointError(
                    f"{checkpoint}: not what a run of this version has written ({said}); delete it to start anew"
                ) from None
            return
        self.population_log_prob = self.walkers.place(population, self.seed)
        if checkpoint is not None:
            producers = self.walkers.ensembles * self.producers
            rows = {stage: producers if stage == "production" else CROWD * producers for stage in STAGES}
            self.file = Checkpoint.create(checkpoint, self.fingerprint, self.names, rows, self._state())

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
            if self._settled() or k >= _ROUNDS[1]:
                break
            if time.monotonic() > self.adapt_by:
                self.hurried = True
                break
            steps = int(min(_ROUND_STEPS[0] * 1.15 ** (k - 1), _ROUND_STEPS[1])) // _STORE_EVERY * _STORE_EVERY
            self._round(_with_proposal(self.proposal, e, 0.8, 0.5), steps)
        if not self.producing:
            draws = self.rounds[-1][0]
            tau = _STORE_EVERY * max(longest_autocorrelation_time(draws[..., j]) for j in range(self.walkers.ndim))
            self.thin = int(np.clip(tau / 5, 5, 50))
            self.walkers = self.walkers.resized(self.producers)
            self.next_check = 5 * self.thin * 10
            self.producing = True
            self._commit()

    def _round(self, moves: WeighedMoves, steps: int) -> None:
        draws, values = self.walkers.advance(moves, steps, _STORE_EVERY, self.bar.update, None)
        self.walkers.rescue(draws, values, [self.seed, 4, len(self.rounds)])
        e = self.walkers.ensembles
        self.rounds.append((draws[:e], values[:e]))
        self.tempered.append((draws[e:], values[e:]))
        self._commit(("tempered", *self.tempered[-1]), ("plain", *self.rounds[-1]))

    def _material(self, rng: np.random.Generator) -> Array:
        """(n, ndim) what the proposal is fitted to: recent draws of both rungs, and those of the population
        that are as probable.

        The population keeps charts in lesser modes alive, where too few walkers are to learn a chart from.
        """
        assert self.walkers.state is not None
        since = self._steady_since()
        material = []
        for rounds in (self.rounds, self.tempered):
            draws = [d for d, _ in rounds[min(since, len(rounds) - 1) :]]  # production has no tempered draws
            if len(draws) == 1:
                draws = [draws[0][:, draws[0].shape[1] // 2 :]]
            z = np.concatenate([d.reshape(-1, self.walkers.ndim) for d in draws])
            different, which = np.unique(z, axis=0, return_inverse=True)
            some = np.isin(which, rng.permutation(len(different))[: _MATERIAL // 2])
            material.append(z[some])
        floor = np.median(self.walkers.state.log_prob[self.walkers.drawing]) - 3.0 * self.walkers.ndim
        return np.concatenate([*material, self.population[self.population_log_prob > floor][:2000]])

    def _steady_since(self) -> int:
        """The first of the latest rounds over which log_prob did not drift."""
        level, spread = self._level(-1)
        first = len(self.rounds) - 1
        while first > 1 and abs(self._level(first - 1)[0] - level) <= 0.5 * spread:
            first -= 1
        return first

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
        at = self.walkers.state.coords[self.walkers.drawing]
        rows = rng.integers(len(at), size=n)
        new, factor = self.proposal.step(self.proposal.at(at[rows]), 1.0, np.ones(1), state)
        log_ratio = self.walkers.log_prob(new.z) - self.walkers.state.log_prob[rows] + factor
        return float(np.mean(np.exp(np.minimum(log_ratio, 0.0))))

    def _settled(self) -> bool:
        """Neither the level of log_prob nor the quality of the proposals has changed over the last rounds."""
        if len(self.rounds) < _ROUNDS[0]:
            return False
        level, spread = self._level(-1)
        still = all(abs(self._level(-k)[0] - level) < 0.25 * spread for k in (2, 3))
        return still and max(self.quality[-2:]) < 1.1 * max(self.quality[-4:-2])

    def chunk(self, least: int) -> int:
        """Steps of production between two checkpoints: whole stored steps, `least` or a few more."""
        return -(-least // self.thin) * self.thin

    def produce(self, steps: int) -> None:
        """Go on for about `steps` steps of production."""
        assert self.proposal is not None
        steps = self.chunk(steps)
        moves = _with_proposal(self.proposal, self.walkers.ensembles, 0.8, 0.8)
        draws, values = self.walkers.advance(moves, steps, self.thin, self.bar.update, self.deadline)
        e = self.walkers.ensembles
        self._kept.append((draws[:e], values[:e]))
        self._commit(("production", *self._kept[-1]))

    def restart_if_slow(self, result: Convergence, chain_taus: float) -> bool:
        """Where production would last more than five times as long as it has: take its draws for adaptation, fit the
        proposal anew, freeze that, and begin production again. It has been to places where walkers stand still."""
        n = self.n_steps
        if n < _TRIAL_STEPS or len(self.restarts) == _RESTARTS or not result.worst_tau * chain_taus > 5.0 * n:
            return False
        if time.monotonic() > self.adapt_by:
            self.hurried = True
            return False
        self.rounds += self._kept
        self.restarts.append((self.restarts or [0])[-1] + sum(d.shape[1] for d, _ in self._kept))
        self._kept, self._values = [], []
        rng = np.random.default_rng([self.seed, 5, len(self.restarts)])
        self.proposal = fit_proposal(self._material(rng), rng)
        self.next_check = _TRIAL_STEPS
        self._commit()
        return True

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
            self.file.append(stage, in_one_row(draws), in_one_row(values))
        self.file.commit(self._state())

    def _state(self) -> dict[str, NDArray]:
        state = self.walkers.to_arrays() | {
            "rounds": np.array([d.shape[1] for d, _ in self.tempered]),  # the plain ones are as long
            "quality": np.array(self.quality),
            "population_log_prob": self.population_log_prob,
            "producing": np.array(self.producing),
            "thin": np.array(self.thin),
            "next_check": np.array(self.next_check),
            "restarts": np.array(self.restarts, dtype=int),
            "hurried": np.array(self.hurried),
        }
        if self.proposal is not None:
            state |= {f"proposal_{k}": v for k, v in self.proposal.to_arrays().items()}
        return state

    def _restore(self, state: Mapping[str, NDArray], draws: Mapping[str, Array], values: Mapping[str, Array]) -> None:
        self.producing, self.thin = bool(state["producing"]), int(state["thin"])
        if self.producing:
            self.walkers = self.walkers.resized(self.producers)
        self.walkers.from_arrays(state)
        self.population_log_prob = state["population_log_prob"]
        e = self.walkers.ensembles
        ends = np.cumsum(state["rounds"], dtype=int)[:-1]
        for stage, rounds in (("plain", self.rounds), ("tempered", self.tempered)):
            if len(state["rounds"]):
                parts = zip(np.split(draws[stage], ends), np.split(values[stage], ends))
                rounds += [(by_block(d, e), by_block(v, e)) for d, v in parts]
        self.quality = [float(q) for q in state["quality"]]
        self.next_check = int(state["next_check"])
        self.restarts = [int(n) for n in state["restarts"]]
        self.hurried = bool(state["hurried"])
        produced, logs = (by_block(x["production"], e) for x in (draws, values))
        for begin, end in zip([0, *self.restarts], self.restarts):
            self.rounds.append((produced[:, begin:end], logs[:, begin:end]))
        last = (self.restarts or [0])[-1]
        if produced.shape[1] > last:
            self._kept = [(produced[:, last:], logs[:, last:])]
        numbers = {k.removeprefix("proposal_"): v for k, v in state.items() if k.startswith("proposal_")}
        self.proposal = Proposal.from_arrays(numbers) if numbers else None
        if self.proposal is not None and not np.isfinite(self.proposal.sample(8, 0)).all():
            raise ValueError("a proposal of no numbers")

    def close(self) -> None:
        if self.file is not None:
            self.file.close()
            self.file = None
