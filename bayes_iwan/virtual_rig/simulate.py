"""A virtual rig: specimen, shaker, fixture and sensors, simulated independently of the model that is fitted.

It is for two things: to plan a campaign (`planning.simulate_campaign`: would these tests show that effect?),
and to make cases with a sealed truth (`withheld.sealed`). It shares no code with `bayes_iwan.models`:
individual Jenkins elements are integrated in time (`kernel`), under a shaker that yields and distorts, through run-in
from rest, and are seen through sensors of their own (`sensors`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import signal

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Record
from bayes_iwan.screen import on_screen
from bayes_iwan.virtual_rig.fault import Acting, Fault
from bayes_iwan.virtual_rig.faults import acting, check_faults, scatter
from bayes_iwan.virtual_rig.kernel import FaultValues, SpecimenValues, march
from bayes_iwan.virtual_rig.sensors import Sensors, measure
from bayes_iwan.virtual_rig.specimen import RigError, Specimen


@dataclass(frozen=True)
@on_screen
class PlannedTest:
    """One test to be run on the virtual rig.

    Parameters
    ----------
    frequency_hz, amplitude_mm
        nominal, 0.1 to 200 Hz and 0.001 to 50 mm.
    cycles
        recorded.
    run_in
        cycles before the record starts.
    role
        "fit" or "held-out".

    Raises
    ------
    RigError
        a test beyond the rig.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> bi.PlannedTest(10.0, 0.5, cycles=20).role
    'fit'
    >>> bi.PlannedTest(10.0, 500.0)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    bayes_iwan...RigError: a test at 10 Hz and 500 mm is beyond the rig: use 0.1 to 200 Hz and 0.001 to 50 mm
    """

    frequency_hz: float
    amplitude_mm: float
    cycles: int = 40
    run_in: int = 8
    role: str = "fit"

    def __post_init__(self) -> None:
        if not (0.1 <= self.frequency_hz <= 200 and 1e-3 <= self.amplitude_mm <= 50):
            raise RigError(
                f"a test at {self.frequency_hz:g} Hz and {self.amplitude_mm:g} mm is beyond the rig: "
                "use 0.1 to 200 Hz and 0.001 to 50 mm"
            )
        if self.cycles < 1 or self.run_in < 3:
            raise RigError("a test needs at least 1 recorded cycle and 3 cycles of run-in")


@dataclass(frozen=True)
class Setup:
    """Shaker, fixture and sensors.

    Attributes: compliance of the shaker (upstream of the displacement sensor: it distorts the motion), its loss factor
    at the test's frequency, and the compliance of the sound fixture (between the sensor and the specimen); the drive's
    second and third harmonics as shares of the amplitude; the largest relative error of the frequency, the RMS error of
    the amplitude, the RMS of its slow wander; sensors; sampling rate.

    The loss is what makes the motion well-posed: just after a reversal the stuck elements' force grows with the speed
    (k follows α, and α the speed) and drives the end on. Where nothing but a spring held it, the end would jump, by as
    much as the time step allows.
    """

    shaker_compliance_mm_N: float = 2e-3
    shaker_loss: float = 0.1
    fixture_compliance_mm_N: float = 5e-5
    second_harmonic: float = 0.01
    third_harmonic: float = 0.005
    frequency_error: float = 0.003
    amplitude_error: float = 0.003
    wander: float = 5e-4
    sensors: Sensors = field(default_factory=Sensors)
    sample_rate_hz: float = 1280.0


@dataclass(frozen=True)
class RigRun:
    """One simulated test: samples as recorded, what was planned, and the frequency that was really run."""

    test: PlannedTest
    true_frequency_hz: float
    time_s: Array
    displacement_mm: Array
    force_N: Array

    def record(self, file: str) -> Record:
        """The run as a campaign's record."""
        test, seen = self.test, (self.time_s, self.displacement_mm, self.force_N)
        return Record(file, test.frequency_hz, test.amplitude_mm, test.role, {}, *seen)


@dataclass(frozen=True)
class RigMotion:
    """One test as the rig moved, before any channel has seen it: fine steps (n,), and where samples will be taken."""

    test: PlannedTest
    true_frequency_hz: float
    time_s: Array
    displacement_mm: Array
    force_N: Array
    sample_times_s: Array


@dataclass(frozen=True)
class Fidelity:
    """Steps a cycle and the number of sliders."""

    steps: int = 1500
    sliders: int = 10_000


# sliders that remember their slip speed cost several times as much, and need fewer: they blur one another
FULL, RATED, COARSE = Fidelity(), Fidelity(sliders=90), Fidelity(steps=400, sliders=60)
_TABLE = 2000  # points of a table of a law, to either side


def _with_tables(act: Acting, amplitude_mm: float, speed_mm_s: float, compliance_mm_N: float) -> FaultValues:
    """The kernel's values of what acts, its functions as tables over a range that the motion hardly leaves."""
    q = act.motion

    def to_both_sides(reach: float) -> Array:
        return np.linspace(-reach, reach, 2 * _TABLE + 1)

    for name, law, grid, least in (
        ("displacement_force", act.displacement_force, to_both_sides(1.5 * amplitude_mm), -np.inf),
        ("position", act.position_factor, to_both_sides(1.5 * amplitude_mm), 0.05),
        ("speed_force", act.speed_force, to_both_sides(2.0 * speed_mm_s), -np.inf),
        ("rate", act.rate_factor, np.linspace(0.0, 4.0 * speed_mm_s, 4 * _TABLE), -np.inf),
        ("fade", act.fade_factor, np.linspace(0.0, 400.0, 4 * _TABLE), 0.05),
    ):
        if law is not None:
            step = f"{name.removesuffix('_force')}_step"
            q = q._replace(**{name: np.maximum(law(grid), least), step: grid[1] - grid[0]})
    if act.joint_stretch is not None:  # force over stretch, from stretch over force
        force = np.concatenate([np.linspace(0.0, 1.0, 400)[:-1] ** 2, np.linspace(1.0, 100.0, 4000)])
        stretch = compliance_mm_N * force + act.joint_stretch(force)
        grid = np.linspace(0.0, stretch[-1], 20 * _TABLE)
        q = q._replace(joint=np.interp(grid, stretch, force), joint_step=grid[1] - grid[0])
    return q


def kernel_values(
    specimen: Specimen, setup: Setup, act: Acting, frequency_hz: float, amplitude_mm: float, step_s: float
) -> tuple[SpecimenValues, FaultValues]:
    memory_s = setup.shaker_loss / (2 * np.pi * frequency_hz)
    shaker = setup.shaker_compliance_mm_N * step_s / (memory_s + step_s)
    compliance = shaker + setup.fixture_compliance_mm_N + act.extra_compliance_mm_N
    s = specimen
    body = SpecimenValues(
        amplitude_mm, s.parallel_N_mm, s.contact_N_mm, s.curve, s.curve_power, s.kn_1_mm, s.beta, s.lambda_s_m, s.tip,
        compliance, shaker, memory_s / (memory_s + step_s),
    )  # fmt: skip
    return body, _with_tables(act, amplitude_mm, 2 * np.pi * frequency_hz * amplitude_mm, compliance)


def shaker_stretch(force: Array, body: SpecimenValues) -> Array:
    """By how much the shaker gives way (mm), at each step of a force (n,)."""
    return np.asarray(signal.lfilter([body.shaker_compliance], [1.0, -body.shaker_memory], force))


@dataclass(frozen=True)
class VirtualRig:
    """A specimen on the rig, with some faults. `seed`, and a test's place in the campaign, `index`, settle everything
    random. Raises `RigError` for unknown faults."""

    specimen: Specimen
    setup: Setup = field(default_factory=Setup)
    faults: tuple[Fault, ...] = ()
    seed: int = 0

    def run(self, test: PlannedTest, index: int = 0, fidelity: Fidelity = FULL, clean: bool = False) -> RigRun:
        """Run one test from rest and record it; `clean` leaves noise and digitiser's steps out."""
        return self.observe(self.move(test, index, fidelity), index, clean)

    def run_all(
        self, tests: Sequence[PlannedTest], first_index: int = 0, fidelity: Fidelity = FULL, clean: bool = False
    ) -> tuple[RigRun, ...]:
        """Run several tests of one campaign."""
        return tuple(self.run(test, i, fidelity, clean) for i, test in enumerate(tests, start=first_index))

    def observe(self, motion: RigMotion, index: int = 0, clean: bool = False) -> RigRun:
        """Record a motion; of the faults, those of the measuring chain act here."""
        act = acting(self.faults)
        chain = act.chain
        if act.gain_scatter is not None:
            chain = replace(chain, gain=scatter(act.gain_scatter, index))
        if act.amplitude_gain is not None:
            chain = replace(chain, gain=chain.gain * float(act.amplitude_gain(np.array(motion.test.amplitude_mm))))
        u, f = measure(
            motion.time_s, motion.displacement_mm, motion.force_N, motion.sample_times_s, self.setup.sensors, chain,
            np.random.default_rng([self.seed, index, 1]), clean, motion.true_frequency_hz,
        )  # fmt: skip
        return RigRun(motion.test, motion.true_frequency_hz, motion.sample_times_s, u, f)

    def move(self, test: PlannedTest, index: int = 0, fidelity: Fidelity = FULL) -> RigMotion:
        """Move through one test from rest. The controller first makes two short trial runs and sets drive and offset so
        that the displacement at the sensor has the wanted amplitude and no offset."""
        check_faults(self.faults)
        act, setup = acting(self.faults), self.setup
        if fidelity == FULL and act.remembers:
            fidelity = RATED
        rng = np.random.default_rng([self.seed, index, 0])
        frequency = test.frequency_hz * (1 + setup.frequency_error * rng.uniform(-1, 1))
        amplitude = test.amplitude_mm * (1 + setup.amplitude_error * rng.standard_normal())
        start, phase2, phase3 = rng.uniform(0, 2 * np.pi, 3)
        second, third = setup.second_harmonic * rng.uniform(0.3, 1), setup.third_harmonic * rng.uniform(0.3, 1)
        beats = setup.wander * rng.standard_normal(6)
        body = self.specimen.coarse(fidelity.sliders)
        if act.stiffness_scatter is not None:
            body = body.scaled(scatter(act.stiffness_scatter, index))
        if act.friction_scatter is not None:
            body = replace(body, slip_share_N=body.slip_share_N * scatter(act.friction_scatter, index))

        def shape(t: Array, run_in: float) -> Array:
            turn = 2 * np.pi * frequency * t + start
            wave = np.sin(turn) + second * np.sin(2 * turn + phase2) + third * np.sin(3 * turn + phase3)
            rise = np.clip((t * frequency + run_in) / min(3.0, run_in), 0.0, 1.0)
            slow = 1.0 + sum(
                b * np.sin(2 * np.pi * (0.13 + 0.11 * i) * t + i) for i, b in enumerate(beats / np.sqrt(3))
            )
            return np.asarray(np.sin(0.5 * np.pi * rise) ** 2 * slow * wave)

        def march_through(
            rate: float, begin: float, stop: float, run_in: float, size: float, offset: float,
            own_amplitude: float, sliders: Specimen,
        ) -> tuple[Array, Array, Array, Array]:  # fmt: skip
            t = begin + np.arange(int(np.ceil((stop - begin) * rate)) + 1) / rate
            drive = size * shape(t, run_in) + offset * np.clip((t - begin) * frequency, 0.0, 1.0)
            values = kernel_values(sliders, setup, act, frequency, own_amplitude, 1 / rate)
            force, deformation, _ = march(
                drive, t * frequency, 1 / rate, sliders.stiffness_share, sliders.slip_share_N, *values
            )
            return t, drive - shaker_stretch(force, values[0]), force, deformation

        # the controller's trial runs: five cycles, coarse, looking at the last
        size, offset, own = amplitude, 0.0, amplitude
        for _ in range(2):
            rate = 300 * frequency
            t, seen, _, deformation = march_through(
                rate, -5 / frequency, 0.0, 5.0, size, offset, own, body.coarse(COARSE.sliders)
            )
            last = t >= -1 / frequency - 1e-12
            correction = amplitude / (0.5 * np.ptp(seen[last]))
            size *= correction
            own = max(float(deformation[last].max()) * correction, 1e-3 * amplitude)
            offset -= seen[last][1:].mean()  # one whole cycle: its first sample is its last
        # the analogue filters want a rate well above theirs, whatever the motion needs
        slowest = 8 if fidelity.steps >= 1000 else 2
        multiple = max(slowest, int(np.ceil(fidelity.steps * frequency / setup.sample_rate_hz)))
        margin = 0.01
        t, seen, force, _ = march_through(
            multiple * setup.sample_rate_hz, -test.run_in / frequency, test.cycles / frequency + margin,
            float(test.run_in), size, offset, own, body,
        )  # fmt: skip
        n = round(test.cycles / test.frequency_hz * setup.sample_rate_hz)
        samples = np.arange(n) / setup.sample_rate_hz
        return RigMotion(test, frequency, t, seen, force, samples)


def with_noise(setup: Setup, share: float, friction_N: float, largest_mm: float) -> Setup:
    """The setup with force noise of `share` of the friction force, and the displacement's in proportion."""
    sensors = replace(setup.sensors, force_noise_N=share * friction_N, displacement_noise_mm=0.02 * share * largest_mm)
    return replace(setup, sensors=sensors)


def file_name(test: PlannedTest, taken: set[str]) -> str:
    """A file name that says frequency and amplitude, as `f10_a0.3.csv`; numbered when repeated."""
    stem = f"f{test.frequency_hz:g}_a{test.amplitude_mm:g}"
    name, number = f"{stem}.csv", 2
    while name in taken:
        name, number = f"{stem}_{number}.csv", number + 1
    taken.add(name)
    return name


def records(runs: Sequence[RigRun]) -> list[Record]:
    """The runs as a campaign's records, with file names."""
    taken: set[str] = set()
    return [r.record(file_name(r.test, taken)) for r in runs]
