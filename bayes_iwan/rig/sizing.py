"""How large an effect is on the virtual rig, and the strength at which it has a wanted size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_iwan.rig import faults as fx
from bayes_iwan.rig.faults import Effect, Surroundings
from bayes_iwan.rig.simulate import COARSE, PlannedTest, Run, Setup, simulate_tests
from bayes_iwan.rig.specimen import RigError, Specimen

Floats = np.ndarray[Any, np.dtype[np.float64]]
_EVOLVING = {"friction_fade", "force_drift", "heating", "mains_hum"}


def friction_rms_N(runs: Sequence[Run], parallel_N_mm: float) -> float:
    """RMS over the tests of the force less the parallel spring's."""
    return float(np.sqrt(np.mean([np.mean((r.force_N - parallel_N_mm * r.displacement_mm) ** 2) for r in runs])))


def _changes(changed: Sequence[Run], sound: Sequence[Run]) -> list[Floats]:
    """Change of the force in each test, both records brought to the same phase of the measured displacement."""
    changes = []
    for a, b in zip(changed, sound):
        wave = np.exp(-2j * np.pi * b.true_frequency_hz * b.time_s)
        turn = np.angle(np.sum(a.displacement_mm * wave)) - np.angle(np.sum(b.displacement_mm * wave))
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        shift = turn / (2 * np.pi * b.true_frequency_hz)
        change = np.interp(b.time_s - shift, a.time_s, a.force_N) - b.force_N
        change[(b.time_s - shift < b.time_s[0]) | (b.time_s - shift > b.time_s[-1])] = 0.0
        changes.append(change)
    return changes


def force_change_N(changed: Sequence[Run], sound: Sequence[Run], about_mean: bool = False) -> float:
    """RMS over the tests of the change of the force at equal measured displacement.

    Both records are brought to the same phase of the measured displacement's fundamental first, so that a fault
    of the displacement channel counts by what it does to the loop. `about_mean` leaves the change of each test's
    mean out.
    """
    squares = [np.mean((c - c.mean() if about_mean else c) ** 2) for c in _changes(changed, sound)]
    return float(np.sqrt(np.mean(squares)))


def surroundings(
    specimen: Specimen, tests: Sequence[PlannedTest], *, setup: Setup | None = None, seed: int = 0
) -> tuple[Surroundings, tuple[Run, ...]]:
    """Trial runs without any effect: what effects are compared with. Coarse and clean."""
    runs = simulate_tests(specimen, tests, setup=setup, seed=seed, fidelity=COARSE, clean=True)
    around = Surroundings(
        specimen=specimen,
        frequencies_hz=tuple(t.frequency_hz for t in tests),
        amplitudes_mm=tuple(t.amplitude_mm for t in tests),
        record_s=float(np.mean([t.cycles / t.frequency_hz for t in tests])),
        friction_rms_N=friction_rms_N(runs, specimen.parallel_N_mm),
        force_peak_N=max(float(np.max(np.abs(r.force_N))) for r in runs),
    )
    return around, runs


def effect_size(
    specimen: Specimen,
    tests: Sequence[PlannedTest],
    effect: Effect,
    *,
    setup: Setup | None = None,
    seed: int = 0,
    sound: tuple[Surroundings, tuple[Run, ...]] | None = None,
) -> float:
    """RMS change of the force with the effect, before any refit, over the RMS friction force without it.

    A force high-pass takes the mean force away at any corner: its size is that of the alternating part.
    """
    around, runs = sound or surroundings(specimen, tests, setup=setup, seed=seed)
    changed = simulate_tests(specimen, tests, setup=setup, effects=(effect,), seed=seed, fidelity=COARSE, clean=True)
    about_mean = effect.name == "force_highpass"
    return force_change_N(changed, runs, about_mean) / around.friction_rms_N


def size_effect(
    name: str,
    size: float,
    specimen: Specimen,
    tests: Sequence[PlannedTest],
    rng: np.random.Generator,
    *,
    setup: Setup | None = None,
    seed: int = 0,
    sound: tuple[Surroundings, tuple[Run, ...]] | None = None,
    tolerance: float = 0.02,
) -> Effect:
    """The effect `name` at the strength that changes the force by `size` of the RMS friction force.

    Its other numbers come from `rng`. Raises `RigError` if even the strongest sensible effect is smaller.
    """
    if name not in fx.KINDS:
        raise RigError(f"no effect {name!r}; the rig has: {', '.join(fx.KINDS)}")
    sound = sound or surroundings(specimen, tests, setup=setup, seed=seed)
    others = fx.KINDS[name].others(rng, sound[0])

    def trial(strength: float) -> Effect:
        effect = fx.complete(name, others, sound[0], strength)
        found = effect_size(specimen, tests, effect, setup=setup, seed=seed, sound=sound)
        return replace(effect, size=found)

    low, low_size, high, best = 0.0, 0.0, 1.0, trial(1.0)
    if best.size < size:
        raise RigError(
            f"{name} changes the force of these tests by {100 * best.size:.2g} % of the friction force at most, "
            f"less than the {100 * size:.2g} % asked for; use a smaller size or other tests"
        )
    high_size = best.size
    for step in range(30):
        if abs(best.size / size - 1) < tolerance:
            return best
        # false position, halved now and then: sizes grow nearly, not quite, in proportion
        middle = low + (high - low) * (size - low_size) / (high_size - low_size)
        if step % 3 == 2:
            middle = 0.5 * (low + high)
        best = trial(middle)
        if best.size < size:
            low, low_size = middle, best.size
        else:
            high, high_size = middle, best.size
    return best


def visible_shares(
    specimen: Specimen,
    tests: Sequence[PlannedTest],
    effects: Sequence[Effect],
    *,
    setup: Setup | None = None,
    seed: int = 0,
    cycles: int = 10,
) -> tuple[float, ...]:
    """Which share of each effect's change of the force no change of the specimen's own numbers can imitate.

    Linear: what is left, in RMS, of the change after the best combination of small changes of both springs, of
    the stiffness law, of the normal force's numbers and of the slip forces (eight groups) is taken out. A rig's
    compliance leaves some 0.02 (it looks like other slip forces), mains hum leaves 1. Effects that do not evolve
    over the cycles are seen on the first `cycles` of each test, which saves most of the work.
    """
    if not effects:
        return ()
    if not any(e.name in _EVOLVING for e in effects):
        tests = [replace(t, cycles=min(t.cycles, cycles)) for t in tests]
    runs = simulate_tests(specimen, tests, setup=setup, seed=seed, fidelity=COARSE, clean=True)
    coarse = specimen.coarse(COARSE.sliders)

    def changes(body: Specimen, *acting: Effect) -> list[Floats]:
        changed = simulate_tests(body, tests, setup=setup, effects=acting, seed=seed, fidelity=COARSE, clean=True)
        return _changes(changed, runs)

    own = [
        changes(replace(coarse, **{name: getattr(coarse, name) * factor}))
        for name, factor in (
            ("parallel_N_mm", 1.01), ("contact_N_mm", 1.01), ("curve", 1.05), ("curve_power", 1.05),
            ("kn_1_mm", 1.05), ("lambda_s_m", 1.05), ("beta", 1.1),
        )
    ]  # fmt: skip
    for group in np.array_split(np.arange(coarse.slip_share_N.size), 8):
        slip = coarse.slip_share_N.copy()
        slip[group] *= 1.03
        own.append(changes(replace(coarse, slip_share_N=slip)))

    def share(effect: Effect) -> float:
        about_mean = effect.name == "force_highpass"

        def column(parts: list[Floats]) -> Floats:
            return np.concatenate([(c - c.mean() if about_mean else c) / np.sqrt(c.size) for c in parts])

        columns = [column(c) for c in own]
        matrix = np.array([c / np.linalg.norm(c) for c in columns if np.linalg.norm(c) > 0]).T
        change = column(changes(specimen, effect))
        left = change - matrix @ np.linalg.lstsq(matrix, change, rcond=1e-6)[0]
        return float(np.linalg.norm(left) / np.linalg.norm(change))

    return tuple(share(e) for e in effects)
