"""Random cases for the withheld protocol: specimen, rig, tests and effects all drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from bayes_iwan.campaign import Record
from bayes_iwan.rig import simulate as rig
from bayes_iwan.rig import sizing as rig_sizing
from bayes_iwan.rig.faults import CATALOGUE, OUTSIDE, Effect
from bayes_iwan.rig.sensors import Sensors
from bayes_iwan.rig.specimen import RigError, Specimen, draw_specimen

KIND_SHARES = {"none": 0.22, "single": 0.48, "pair": 0.12, "outside": 0.18}
SIZE_RANGE = (0.04, 0.20)  # RMS change of the force over RMS friction force, before any refit
NOISE_RANGE = (0.002, 0.010)  # force noise over RMS friction force

# Pairs that a person would not call two effects: the second hides in, or only exists through, the first.
_NOT_TOGETHER = {
    frozenset(pair)
    for pair in (
        ("channel_delay", "force_lowpass"),
        ("integration_highpass", "force_highpass"),
        ("free_play", "moving_mass"),
        ("stribeck_weakening", "rate_strengthening"),
        ("force_highpass", "force_drift"),
        ("force_highpass", "direction_dependent_friction"),
    )
}


@dataclass(frozen=True)
class Case:
    """One case before it is run: everything that its records follow from.

    `tests` are what the diagnosis is given (fit and held-out roles), `unseen` what it never sees; `friction_rms_N`
    and the effects' sizes were measured on coarse trial runs of `tests`; `noise_share` is the force noise over it.
    """

    kind: str
    specimen: Specimen
    effects: tuple[Effect, ...]
    setup: rig.Setup
    tests: tuple[rig.PlannedTest, ...]
    unseen: tuple[rig.PlannedTest, ...]
    seed: int
    friction_rms_N: float
    noise_share: float

    def truth(self, name: str) -> dict[str, Any]:
        """The case's truth, ready to be sealed: plain numbers, strings, lists and mappings."""

        def plan(tests: Sequence[rig.PlannedTest]) -> list[dict[str, Any]]:
            return [asdict(t) for t in tests]

        return {
            "schema": 1,
            "case": name,
            "kind": self.kind,
            "effects": [
                {
                    "name": e.name,
                    "size": round(e.size, 6),
                    "visible_share": round(e.visible, 6),
                    "parameters": dict(e.parameters),
                }
                for e in self.effects
            ],
            "specimen": self.specimen.summary(),
            "setup": asdict(self.setup),
            "noise": {
                "force_N": self.setup.sensors.force_noise_N,
                "displacement_mm": self.setup.sensors.displacement_noise_mm,
                "share_of_friction": self.noise_share,
            },
            "friction_rms_N": self.friction_rms_N,
            "design": {"tests": plan(self.tests), "unseen": plan(self.unseen)},
            "seed": self.seed,
        }


def draw_design(rng: np.random.Generator) -> tuple[tuple[rig.PlannedTest, ...], tuple[rig.PlannedTest, ...]]:
    """Tests at random, and tests that the diagnosis is not to see.

    Mostly 2 to 4 frequencies by 2 or 3 amplitudes, one in seven at a single frequency (3 to 4 amplitudes); in
    three cases of ten one or two of them are held out. Unseen: a new frequency within the range and a new
    amplitude, sometimes beyond the range.
    """
    single = rng.random() < 1 / 7
    n_f = 1 if single else int(rng.integers(2, 5))
    n_a = int(rng.integers(3, 5)) if single else int(rng.integers(2, 4))
    low = float(rng.uniform(5.0, 12.0))
    high = min(30.0, low * float(rng.uniform(1.6, 3.5)))
    frequencies = np.unique(np.round(np.geomspace(low, high, n_f) * np.exp(0.04 * rng.standard_normal(n_f)) * 2) / 2)
    smallest = float(rng.uniform(0.2, 0.4))
    largest = float(rng.uniform(2.0, 3.6)) * smallest
    amplitudes = np.unique(np.round(np.linspace(smallest, min(largest, 1.2), n_a), 2))
    cycles, run_in = int(rng.integers(20, 61)), int(rng.integers(6, 13))

    def test(f: float, a: float, role: str = "fit") -> rig.PlannedTest:
        return rig.PlannedTest(float(f), float(a), cycles, run_in, role)

    grid = [(float(f), float(a)) for f in np.clip(frequencies, 5, 30) for a in amplitudes]
    held: set[int] = set()
    if len(grid) >= 6 and rng.random() < 0.3:
        held = set(rng.choice(len(grid), size=int(rng.integers(1, 3)), replace=False).tolist())
    tests = tuple(test(f, a, "held-out" if i in held else "fit") for i, (f, a) in enumerate(grid))
    inside = float(np.round(rng.uniform(low, max(high, low * 1.2)), 1))
    middle = float(np.round(rng.uniform(amplitudes[0], amplitudes[-1]), 2))
    beyond_f = float(np.round(np.clip(frequencies[-1] * rng.uniform(1.1, 1.35), 5, 35), 1))
    beyond_a = float(np.round(amplitudes[-1] * rng.uniform(1.02, 1.15), 2))
    unseen = [test(inside, middle), test(beyond_f, float(amplitudes[-1])), test(float(frequencies[0]), beyond_a)]
    return tests, tuple(unseen)


def draw_setup(rng: np.random.Generator) -> rig.Setup:
    """A shaker, a fixture and sensors at random; noise is set once the friction force is known."""
    corner = float(rng.uniform(1100.0, 2000.0))
    return rig.Setup(
        shaker_compliance_mm_N=float(rng.uniform(0.5e-3, 4e-3)),
        fixture_compliance_mm_N=float(rng.uniform(2e-5, 1e-4)),
        second_harmonic=float(rng.uniform(0.005, 0.02)),
        third_harmonic=float(rng.uniform(0.003, 0.015)),
        sensors=Sensors(
            displacement_corner_hz=corner,
            force_corner_hz=corner * (1 + 0.005 * float(rng.standard_normal())),
            damping_ratio=float(rng.uniform(0.6, 0.75)),
            antialias_hz=float(rng.uniform(440.0, 520.0)),
            noise_correlation=float(rng.uniform(0.1, 0.5)),
            slow_share=float(rng.uniform(0.05, 0.3)),
            displacement_step_mm=float(10 ** rng.uniform(-5.3, -4.3)),
            force_step_N=float(10 ** rng.uniform(-4, -3)),
        ),
    )


def _draw_names(kind: str, rng: np.random.Generator) -> tuple[str, ...]:
    if kind == "none":
        return ()
    if kind == "outside":
        return (str(rng.choice(OUTSIDE)),)
    if kind == "single":
        return (str(rng.choice(CATALOGUE)),)
    while True:
        pair = tuple(str(n) for n in rng.choice(CATALOGUE, size=2, replace=False))
        if frozenset(pair) not in _NOT_TOGETHER:
            return pair


def draw_case(rng: np.random.Generator, kind: str | None = None, effects: Sequence[str] | None = None) -> Case:
    """Draw one case.

    Parameters: `kind`, one of "none", "single", "pair", "outside", or None for one at random by `KIND_SHARES`;
    `effects`, names to use instead of random ones. Where a specimen and its tests cannot show an effect of the
    drawn size (a normal-force lag on a specimen with an almost constant normal force), specimen and tests are
    drawn again, so that the mix of effects is not bent. Raises `RigError` for an unknown kind, or when 60 draws
    did not do.
    """
    kind = kind or str(rng.choice(list(KIND_SHARES), p=list(KIND_SHARES.values())))
    if kind not in KIND_SHARES:
        raise RigError(f"no kind of case {kind!r}; there are: {', '.join(KIND_SHARES)}")
    names = tuple(effects) if effects is not None else _draw_names(kind, rng)
    sizes = [float(np.exp(rng.uniform(*np.log(SIZE_RANGE)))) for _ in names]
    noise = float(np.exp(rng.uniform(*np.log(NOISE_RANGE))))
    for _ in range(60):
        tests, unseen = draw_design(rng)
        setup = draw_setup(rng)
        seed = int(rng.integers(2**31))
        amplitudes = [t.amplitude_mm for t in tests]
        speed = 2e-3 * np.pi * max(t.frequency_hz for t in tests) * max(amplitudes)
        specimen = draw_specimen(rng, (min(amplitudes), max(amplitudes)), speed)
        try:
            sound = rig_sizing.surroundings(specimen, tests, setup=setup, seed=seed)
            found = tuple(
                rig_sizing.size_effect(name, size, specimen, tests, rng, setup=setup, seed=seed, sound=sound)
                for name, size in zip(names, sizes)
            )
        except RigError:
            continue
        friction = sound[0].friction_rms_N
        noisy = rig.with_noise(setup, noise, friction, max(amplitudes))
        shares = rig_sizing.visible_shares(specimen, tests, found, setup=setup, seed=seed)
        seen = tuple(replace(e, visible=share) for e, share in zip(found, shares))
        return Case(kind, specimen, seen, noisy, tests, unseen, seed, friction, noise)
    raise RigError(f"60 specimens and designs drawn, none shows {' and '.join(names)} at the size asked for")


def simulate(case: Case) -> tuple[list[Record], list[Record]]:
    """Run a case: the records that a diagnosis is given, and those that it never sees."""
    seen = rig.simulate_tests(case.specimen, case.tests, setup=case.setup, effects=case.effects, seed=case.seed)
    unseen = rig.simulate_tests(
        case.specimen, case.unseen, setup=case.setup, effects=case.effects, seed=case.seed,
        first_index=len(case.tests),
    )  # fmt: skip
    return rig.records(seen), rig.records(unseen)
