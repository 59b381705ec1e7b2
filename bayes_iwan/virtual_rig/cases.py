"""Random cases for the withheld protocol: specimen, rig, tests, faults and their laws all drawn."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations

import numpy as np

from bayes_iwan.campaign import Record
from bayes_iwan.errors import nearest
from bayes_iwan.virtual_rig.fault import Fault
from bayes_iwan.virtual_rig.faults import CATALOGUE, OUTSIDE, laws_of
from bayes_iwan.virtual_rig.sensors import Sensors
from bayes_iwan.virtual_rig.simulate import PlannedTest, Setup, VirtualRig, records, with_noise
from bayes_iwan.virtual_rig.sizing import Sound, shares_left, size_fault, surroundings, trial_tests
from bayes_iwan.virtual_rig.specimen import RigError, Specimen, draw_specimen

#: how many faults of the catalogue and from outside it a kind of case has, and how often it is drawn
KINDS = {
    "none": (0, 0), "single": (1, 0), "pair": (2, 0), "triple": (3, 0), "outside": (0, 1),
    "known_beside_outside": (1, 1),
}  # fmt: skip
KIND_SHARES = dict(zip(KINDS, (0.12, 0.34, 0.18, 0.08, 0.12, 0.16)))
SIZE_RANGE = (0.02, 0.12)  # of each fault: RMS change of the force over RMS friction force, before any refit
NOISE_RANGE = (0.002, 0.010)  # force noise over RMS friction force

# Pairs that a person would not call two faults: the second hides in, or only exists through, the first.
_NOT_TOGETHER = {frozenset(pair) for pair in (
    ("channel_delay", "force_lowpass"), ("integration_highpass", "force_highpass"), ("free_play", "moving_mass"),
    ("stribeck_weakening", "rate_strengthening"), ("force_highpass", "force_drift"),
    ("force_highpass", "direction_dependent_friction"), ("friction_fade", "spring_softening"),
    ("viscous_damping", "quadratic_drag"), ("moving_mass", "base_resonance"),
)}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One case before it is run: everything that its records follow from.

    `tests` are what the diagnosis is given (fit and held-out roles), `sealed` what it never sees; `friction_rms_N`
    and the faults' sizes were measured on coarse trial runs of `tests`; `noise_share` is the force noise over it.
    """

    kind: str
    specimen: Specimen
    faults: tuple[Fault, ...]
    setup: Setup
    tests: tuple[PlannedTest, ...]
    sealed: tuple[PlannedTest, ...]
    seed: int
    friction_rms_N: float
    noise_share: float

    @property
    def rig(self) -> VirtualRig:
        """The rig that it is run on."""
        return VirtualRig(self.specimen, self.setup, self.faults, self.seed)

    def truth(self, name: str) -> dict[str, object]:
        """The case's truth, ready to be sealed: plain numbers, strings, lists and mappings."""
        return {
            "schema": 2,
            "case": name,
            "kind": self.kind,
            "effects": [
                {
                    "name": f.name,
                    "law": f.law,
                    "size": round(f.size, 6),
                    "visible_share": round(f.visible, 6),
                    "share": round(f.share, 6),
                    "share_of_square": round(f.share_of_square, 6),
                    "parameters": dict(f.parameters),
                }
                for f in self.faults
            ],
            "specimen": self.specimen.summary(),
            "setup": asdict(self.setup),
            "noise": {
                "force_N": self.setup.sensors.force_noise_N,
                "displacement_mm": self.setup.sensors.displacement_noise_mm,
                "share_of_friction": self.noise_share,
            },
            "friction_rms_N": self.friction_rms_N,
            "design": {"tests": [*map(asdict, self.tests)], "sealed": [*map(asdict, self.sealed)]},
            "seed": self.seed,
        }


def draw_design(rng: np.random.Generator) -> tuple[tuple[PlannedTest, ...], tuple[PlannedTest, ...]]:
    """Tests at random, and tests that the diagnosis is not to see.

    Mostly 2 to 4 frequencies by 2 or 3 amplitudes, one in seven at a single frequency (3 to 4 amplitudes); in
    three cases of ten one or two of them are held out. Sealed: a new frequency within the range and a new
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

    def test(f: float, a: float, role: str = "fit") -> PlannedTest:
        return PlannedTest(float(f), float(a), cycles, run_in, role)

    grid = [(float(f), float(a)) for f in np.clip(frequencies, 5, 30) for a in amplitudes]
    held: set[int] = set()
    if len(grid) >= 6 and rng.random() < 0.3:
        held = set(rng.choice(len(grid), size=int(rng.integers(1, 3)), replace=False).tolist())
    tests = tuple(test(f, a, "held-out" if i in held else "fit") for i, (f, a) in enumerate(grid))
    inside = float(np.round(rng.uniform(low, max(high, low * 1.2)), 1))
    middle = float(np.round(rng.uniform(amplitudes[0], amplitudes[-1]), 2))
    beyond_f = float(np.round(np.clip(frequencies[-1] * rng.uniform(1.1, 1.35), 5, 35), 1))
    beyond_a = float(np.round(amplitudes[-1] * rng.uniform(1.02, 1.15), 2))
    sealed = [test(inside, middle), test(beyond_f, float(amplitudes[-1])), test(float(frequencies[0]), beyond_a)]
    return tests, tuple(sealed)


def draw_setup(rng: np.random.Generator) -> Setup:
    """A shaker, a fixture and sensors at random; noise is set once the friction force is known."""
    corner = float(rng.uniform(1100.0, 2000.0))
    return Setup(
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


def _draw_names(kind: str, rng: np.random.Generator, outside: Sequence[str]) -> tuple[str, ...]:
    """Names for a kind of case, drawn again until no two of them hide in one another."""
    known, unknown = KINDS[kind]
    while True:
        names = [str(n) for n in rng.choice(CATALOGUE, size=known, replace=False)]
        names += [str(n) for n in rng.choice(outside, size=unknown, replace=False)]
        if not any(frozenset(two) in _NOT_TOGETHER for two in combinations(names, 2)):
            return tuple(names)


def draw_case(
    rng: np.random.Generator,
    kind: str | None = None,
    faults: Sequence[str] | None = None,
    *,
    laws: str = "all",
    excluded_laws: Sequence[str] = (),
    excluded_outside: Sequence[str] = (),
    n_sliders: int = 150,
) -> Case:
    """Draw one case.

    Parameters: `kind`, one of `KINDS`, or None for one at random by `KIND_SHARES`; `faults`, names to use instead of
    random ones. `laws`: "catalogue" (the law that the diagnosis' effect of that name has too), "other" or "all";
    `excluded_laws`, entries like "end_stop:hertz", and `excluded_outside`, names of faults from outside, are not
    drawn; `n_sliders` of the specimen. Where a specimen and its tests cannot show a fault of the drawn size (a
    normal-force lag on a specimen with an almost constant normal force), specimen and tests are drawn again, so that
    the mix of faults stays. Raises `RigError` for an unknown kind, law or name, or when 60 draws did not do.
    """
    kind = kind or str(rng.choice(list(KIND_SHARES), p=list(KIND_SHARES.values())))
    if kind not in KINDS:
        raise RigError(f"no kind of case {kind!r}{nearest(kind, KINDS)}")
    strange = sorted(set(excluded_outside) - set(OUTSIDE))
    if strange:
        raise RigError(f"no fault from outside the catalogue is called {strange[0]!r}{nearest(strange[0], OUTSIDE)}")
    names = (
        tuple(faults) if faults is not None else _draw_names(kind, rng, sorted(set(OUTSIDE) - set(excluded_outside)))
    )
    chosen = [str(rng.choice(laws_of(name, laws, excluded_laws))) for name in names]
    sizes = [float(np.exp(rng.uniform(*np.log(SIZE_RANGE)))) for _ in names]
    noise = float(np.exp(rng.uniform(*np.log(NOISE_RANGE))))
    for _ in range(60):
        tests, sealed = draw_design(rng)
        setup = draw_setup(rng)
        seed = int(rng.integers(2**62))
        amplitudes = [t.amplitude_mm for t in tests]
        speed = 2e-3 * np.pi * max(t.frequency_hz for t in tests) * max(amplitudes)
        specimen = draw_specimen(rng, (min(amplitudes), max(amplitudes)), speed, n_sliders)
        rig = VirtualRig(specimen, setup, seed=seed)
        sound: dict[tuple[PlannedTest, ...], Sound] = {}  # trial runs without faults, once for the same tests
        found = []
        try:
            for name, law, size in zip(names, chosen, sizes):
                tried = trial_tests(tests, ((name, law),))
                around = sound.get(tried) or sound.setdefault(tried, surroundings(rig, tried))
                # a fault's parameters follow from the campaign as it is recorded, not from the trial's few cycles
                whole = replace(around[0], record_s=float(np.mean([t.cycles / t.frequency_hz for t in tests])))
                found.append(size_fault(name, size, rig, tried, rng, law=law, sound=(whole, *around[1:])))
        except RigError:
            continue
        tried = trial_tests(tests, ())
        friction = (sound.get(tried) or surroundings(rig, tried))[0].friction_rms_N
        noisy = with_noise(setup, noise, friction, max(amplitudes))
        seen = shares_left(rig, tests, found)
        return Case(kind, specimen, seen, noisy, tests, sealed, seed, friction, noise)
    raise RigError(f"60 specimens and designs drawn, none shows {' and '.join(names)} at the size asked for")


def simulate(case: Case) -> tuple[list[Record], list[Record]]:
    """Run a case: the records that a diagnosis is given, and those that it never sees."""
    return records(case.rig.run_all(case.tests)), records(case.rig.run_all(case.sealed, len(case.tests)))
