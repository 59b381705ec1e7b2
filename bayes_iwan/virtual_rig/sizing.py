"""How large a fault is on the virtual rig, the strength at which it has a wanted size, and its share of a gap."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from math import factorial

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.errors import nearest
from bayes_iwan.virtual_rig.fault import Fault, Surroundings
from bayes_iwan.virtual_rig.faults import KINDS, acting, complete, drawn, laws_of
from bayes_iwan.virtual_rig.simulate import COARSE, PlannedTest, RigMotion, RigRun, VirtualRig
from bayes_iwan.virtual_rig.specimen import RigError

#: a specimen's tests without any fault: what faults are compared with, the records, and the motion behind them
Sound = tuple[Surroundings, tuple[RigRun, ...], tuple[RigMotion, ...]]
#: recorded cycles and cycles of run-in of a trial run of a fault that does not evolve
_TRIAL = (4, 4)


def friction_of_runs_N(runs: Sequence[RigRun], parallel_N_mm: float) -> float:
    """RMS over the tests of the force less the parallel spring's."""
    return float(np.sqrt(np.mean([np.mean((r.force_N - parallel_N_mm * r.displacement_mm) ** 2) for r in runs])))


def _changes(changed: Sequence[RigRun], sound: Sequence[RigRun]) -> list[Array]:
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


def force_change_N(changed: Sequence[RigRun], sound: Sequence[RigRun], about_mean: bool = False) -> float:
    """RMS over the tests of the change of the force at equal measured displacement.

    Both records are brought to the same phase of the measured displacement's fundamental first, so that a fault
    of the displacement channel counts by what it does to the loop. `about_mean` leaves the change of each test's
    mean out.
    """
    squares = [np.mean((c - c.mean() if about_mean else c) ** 2) for c in _changes(changed, sound)]
    return float(np.sqrt(np.mean(squares)))


def surroundings(rig: VirtualRig, tests: Sequence[PlannedTest]) -> Sound:
    """Trial runs without any fault: what faults are compared with. Coarse and clean."""
    motions = tuple(rig.move(t, i, COARSE) for i, t in enumerate(tests))
    runs = _observed(rig, motions)
    around = Surroundings(
        frequencies_hz=tuple(t.frequency_hz for t in tests),
        amplitudes_mm=tuple(t.amplitude_mm for t in tests),
        record_s=float(np.mean([t.cycles / t.frequency_hz for t in tests])),
        friction_rms_N=friction_of_runs_N(runs, rig.specimen.parallel_N_mm),
        force_peak_N=max(float(np.max(np.abs(r.force_N))) for r in runs),
    )
    return around, runs, motions


def _observed(rig: VirtualRig, motions: Sequence[RigMotion]) -> tuple[RigRun, ...]:
    return tuple(rig.observe(m, i, clean=True) for i, m in enumerate(motions))


def _changed(rig: VirtualRig, sound: Sound, faults: tuple[Fault, ...]) -> tuple[RigRun, ...]:
    """The tests of `sound` again with faults in them; the motion is that of the sound rig where it may be."""
    rig = replace(rig, faults=faults)
    if acting(faults).only_measured:
        return _observed(rig, sound[2])
    return rig.run_all([m.test for m in sound[2]], fidelity=COARSE, clean=True)


def trial_tests(tests: Sequence[PlannedTest], laws: Sequence[tuple[str, str]]) -> tuple[PlannedTest, ...]:
    """The tests as they are tried: a few cycles of each; all cycles where a fault (name, law) evolves with them."""
    if any(KINDS[name].law(law).evolves for name, law in laws):
        return tuple(tests)
    return tuple(replace(t, cycles=min(t.cycles, _TRIAL[0]), run_in=min(t.run_in, _TRIAL[1])) for t in tests)


def _about_mean(faults: Sequence[Fault]) -> bool:
    """A force high-pass takes the mean force away at any corner: only the alternating part counts then."""
    return any(f.name == "force_highpass" for f in faults)


def fault_size(rig: VirtualRig, tests: Sequence[PlannedTest], fault: Fault, *, sound: Sound | None = None) -> float:
    """RMS change of the force with the fault, before any refit, over the RMS friction force without it.

    A force high-pass takes the mean force away at any corner: its size is that of the alternating part.
    `sound`: the surroundings and runs of these very tests, if there are any.
    """
    sound = sound or surroundings(rig, tests)
    changed = _changed(rig, sound, (fault,))
    return force_change_N(changed, sound[1], _about_mean((fault,))) / sound[0].friction_rms_N


def size_fault(
    name: str, size: float, rig: VirtualRig, tests: Sequence[PlannedTest], rng: np.random.Generator,
    *, law: str = "", sound: Sound | None = None, tolerance: float = 0.02,
) -> Fault:  # fmt: skip
    """The fault `name`, by `law` (the catalogue's for none), at the strength that changes the force by `size` of the
    RMS friction force.

    Its other parameters come from `rng`. `sound` as for `fault_size`. Raises `RigError` if even the strongest sensible
    fault is smaller.
    """
    if name not in KINDS:
        raise RigError(f"no fault {name!r}{nearest(name, KINDS)}")
    law = law or laws_of(name)[0]
    sound = sound or surroundings(rig, tests)
    others = drawn(name, law, sound[0], rng)

    def trial(strength: float) -> Fault:
        fault = complete(name, law, others, sound[0], strength)
        return replace(fault, size=fault_size(rig, tests, fault, sound=sound))

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
    raise RigError(f"no strength of {name} ({law}) changes the force by {100 * size:.2g} % of the friction force")


def _column(parts: Sequence[Array], about_mean: bool) -> Array:
    return np.concatenate([(c - c.mean() if about_mean else c) / np.sqrt(c.size) for c in parts])


def shares_left(rig: VirtualRig, tests: Sequence[PlannedTest], faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """The faults with their visible share and their shares of the gap that they leave together.

    *Visible share*: what is left, in RMS, of a fault's change of the force after the best combination of small changes
    of both springs, of the stiffness law, of the normal force's parameters and of the slip forces (eight groups) is
    removed: what no other parameters of the specimen imitate. A rig's compliance leaves some 0.02 (it resembles
    other slip forces), mains interference leaves 1.

    *Share of the gap*: the gap is what all faults together leave so; taking some of them away leaves a smaller gap,
    and 1 − smaller/larger is what they remove. That is shared among the faults by Shapley's value (as LMG does for
    R²), once with gaps in RMS and once in squares. The shares of all faults sum to 1.
    """
    if not faults:
        return ()
    sound = surroundings(rig, trial_tests(tests, [(f.name, f.law) for f in faults]))
    about_mean = _about_mean(faults)
    basis = _imitations(rig, trial_tests(tests, ()), sound[1], about_mean)

    def change(present: tuple[Fault, ...]) -> tuple[float, float]:
        """RMS of the change of the force, and of its visible part."""
        c = _column(_changes(_changed(rig, sound, present), sound[1]), about_mean)
        return float(np.linalg.norm(c)), float(np.linalg.norm(c - basis @ (basis.T @ c)))

    n, out = len(faults), []
    seen = {s: change(tuple(faults[i] for i in s)) for k in range(1, n + 1) for s in combinations(range(n), k)}
    left = {(): 0.0, **{s: both[1] / seen[tuple(range(n))][1] for s, both in seen.items()}}
    for i, fault in enumerate(faults):
        share, square = (_shapley(i, n, {s: g**p for s, g in left.items()}) for p in (1, 2))
        visible = seen[(i,)][1] / seen[(i,)][0]
        out.append(replace(fault, visible=visible, share=share, share_of_square=square))
    return tuple(out)


def _imitations(rig: VirtualRig, tests: Sequence[PlannedTest], runs: Sequence[RigRun], about_mean: bool) -> Array:
    """Orthonormal columns: the changes of the force that small changes of the specimen's parameters make.

    They are run on the few cycles of `tests`, and go on as in their last two over the whole of `runs`.
    """
    short = rig.run_all(tests, fidelity=COARSE, clean=True)
    coarse = rig.specimen.coarse(COARSE.sliders)
    factors = {"parallel_N_mm": 1.01, "contact_N_mm": 1.01, "curve": 1.05, "curve_power": 1.05, "kn_1_mm": 1.05}
    factors |= {"lambda_s_m": 1.05, "beta": 1.1}
    bodies = [replace(coarse, **{name: getattr(coarse, name) * factor}) for name, factor in factors.items()]
    for group in np.array_split(np.arange(coarse.slip_share_N.size), 8):
        slip = coarse.slip_share_N.copy()
        slip[group] *= 1.03
        bodies.append(replace(coarse, slip_share_N=slip))
    columns = []
    for body in bodies:
        changed = replace(rig, specimen=body).run_all(tests, fidelity=COARSE, clean=True)
        going_on = [_goes_on(c, a, b) for c, a, b in zip(_changes(changed, short), short, runs)]
        columns.append(_column(going_on, about_mean))
    matrix = np.array([c / np.linalg.norm(c) for c in columns if np.linalg.norm(c) > 0]).T
    size, turned = np.linalg.eigh(matrix.T @ matrix)
    kept = size > 1e-11 * size[-1]
    return np.asarray(matrix @ (turned[:, kept] / np.sqrt(size[kept])))


def _goes_on(change: Array, short: RigRun, long: RigRun) -> Array:
    if long.time_s.size == short.time_s.size:
        return change
    whole = 2.0 / short.true_frequency_hz
    begin = short.time_s[-1] - whole
    time = np.where(long.time_s > begin, begin + (long.time_s - begin) % whole, long.time_s)
    return np.asarray(np.interp(time, short.time_s, change))


def _shapley(i: int, n: int, left: dict[tuple[int, ...], float]) -> float:
    """Player i's Shapley value of what is removed, from what each set of faults leaves when it alone is there."""
    total = 0.0
    others = [k for k in range(n) if k != i]
    for k in range(n):
        for some in combinations(others, k):  # still there after i has been removed
            weight = factorial(k) * factorial(n - k - 1) / factorial(n)
            total += weight * (left[tuple(sorted((*some, i)))] - left[some])
    return total
