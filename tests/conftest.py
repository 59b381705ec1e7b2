"""Specimens, campaigns and loops with known answers, for the tests of every room."""

from __future__ import annotations

import json
import os
import pickle
import re
import sys
from contextlib import suppress
from dataclasses import asdict, is_dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from markupsafe import Markup
from numba.core.registry import CPUDispatcher as Dispatcher
from numba.core.types import Array, unliteral
from scipy import special

from bayes_iwan.campaign import Campaign, Record, average, read_campaign, write_campaign
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.settings import DiagnoseSettings, ModelSettings
from bayes_iwan.models import Model, Reference, embedded_error, paper_parameters, sine_motion
from bayes_iwan.models.normal_force import from_paper_hunt_crossley
from bayes_iwan.models.stiffness import from_paper_stiffness
from bayes_iwan.report import page, rendering, style

SHARED = Path(__file__).parents[2] / "shared" / "data"


def pytest_collection_modifyitems(items):
    """Whole commands first, the many quick files of campaign/ and the examples last: with --no-loadscope-reorder the
    processes that take file by file end together."""
    items.sort(key=lambda item: item.path, reverse=True)


@pytest.fixture(scope="session", autouse=True)
def one_signature():
    """A cached kernel is called with arrays of one layout only. Processes that compile two at a time may write both
    under one name in numba's cache, and the next one then reads a transposed array without a word."""
    yield
    modules = [m for name, m in sys.modules.items() if name.startswith("bayes_iwan.") and m is not None]
    kernels = {k for m in modules for k in vars(m).values() if isinstance(k, Dispatcher)}

    def layout(given):  # whether an array may be written to changes no code
        return str(given.copy(readonly=False) if isinstance(given, Array) else unliteral(given))

    called = {k.py_func.__qualname__: {tuple(map(layout, s)) for s in k.signatures} for k in kernels}
    assert not (several := {name: s for name, s in called.items() if len(s) > 1}), several


@pytest.fixture
def reference(request):
    """reference(numbers): what dictionaries and lists hold is what it was, to half a per cent, as reference.json beside
    the test has it under the test's name. No truths, other tests have these: what moves a number must be meant. Then

        BAYES_IWAN_REFERENCE=write python -m pytest -n 0 tests/diagnosis/test_reference.py

    writes them anew. With OPENBLAS_CORETYPE=Nehalem NUMBA_CPU_NAME=generic, a processor without AVX, they hold, too.
    """
    file = Path(request.path).with_name("reference.json")
    everything = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}

    def compared(numbers):
        found = dict(_leaves(numbers))
        if os.environ.get("BAYES_IWAN_REFERENCE") == "write":
            everything[request.node.name] = found
            file.write_text(json.dumps(everything, indent=0, sort_keys=True) + "\n", encoding="utf-8")
        was = everything[request.node.name]
        assert found.keys() == was.keys()
        near = {n: pytest.approx(x, rel=5e-3, abs=1e-6) if isinstance(x, float) else x for n, x in was.items()}
        moved = {n: (was[n], x) for n, x in found.items() if x != near[n]}
        assert not moved, moved

    return compared


def _leaves(x, path=""):
    """Path and value of all numbers, names and missing values of nested results, lists and arrays, and their sentences
    with # for each number."""
    x = asdict(x) if is_dataclass(x) else x.tolist() if isinstance(x, np.ndarray | np.generic) else x
    if isinstance(x, dict | list | tuple):
        for name, inner in x.items() if isinstance(x, dict) else enumerate(x):
            yield from _leaves(inner, f"{path}/{name}")
    elif isinstance(x, float):
        yield path, float(f"{x:.6g}")
    else:
        yield path, re.sub(r"\d[\d.]*", "#", x) if isinstance(x, str) and " " in x else x


@pytest.fixture(scope="session")
def measured():
    """Campaigns from public sources by name; what needs one is skipped where it is missing."""

    @cache
    def read(name):
        if not (SHARED / name).is_dir():
            pytest.skip(f"{SHARED / name} is not here: the measured campaigns are kept outside this repository")
        return read_campaign(SHARED / name)

    return read


@pytest.fixture(scope="session")
def density_ratio():
    """By how much exp(Σ c_k π_k(p)) / Z, π_k the orthonormal Legendre polynomials on [0, 1], makes a density grow at
    its quantile p: (draws, …) for coefficients (draws, order)."""

    def ratio(coefficients, p):
        def grown(at):
            terms = (
                np.multiply.outer(c, np.sqrt(2 * k + 1) * special.eval_legendre(k, 2.0 * at - 1.0))
                for k, c in enumerate(coefficients.T, start=1)
            )
            return np.exp(sum(terms))

        x, weight = np.polynomial.legendre.leggauss(64)
        return grown(np.asarray(p)) / (0.5 * grown(0.5 + 0.5 * x) @ weight).reshape(-1, *([1] * np.ndim(p)))

    return ratio


@pytest.fixture(scope="session")
def made_up_campaign(tmp_path_factory):
    """Two tests of a classical Iwan specimen with one gamma of slip forces, 8 cycles, noise of 0.02 N."""
    model = Model(Reference(1.0, 0.1), slip="gamma1", normal_force="constant", stiffness="constant")
    true = {"kp_N_mm": 5.5, "force_zero_N": 0.0, "k1_N_mm": 14.0, "t1_N": 0.6, "eta1": 2.0, "g1": 1.0}
    records = []
    for amplitude in (0.3, 1.0):
        loop = model.force(
            {k: np.array([v]) for k, v in true.items()}, sine_motion(frequency_hz=10.0, amplitude_mm=amplitude)
        )[0, 0]
        time = np.arange(8 * 128) / 1280.0
        noise = 0.02 * np.random.default_rng([7, int(10 * amplitude)]).standard_normal(time.size)
        seen = (time, amplitude * np.sin(20.0 * np.pi * time), np.tile(loop, 8) + noise)
        records.append(Record(f"f10_a{amplitude:g}.csv", 10.0, amplitude, "fit", {}, *seen))
    folder = tmp_path_factory.mktemp("made_up")
    write_campaign(folder, name="made up", description="", tests=records, compress=False)
    return folder


#: an identification by the command line in seconds: enough draws to pass its own (loose) test of convergence
SHORT = """
[model]
slip = "gamma1"
normal_force = "constant"
stiffness = "constant"
embedded = false
[likelihood]
kind = "gaussian"
[search]
members = 40
evaluations = 400
starts = 4
second_search = false
[sampling]
ensembles = 2
walkers = 24
r_hat = 1.2
ess = 40
taus = 5
draws = 200
"""


@pytest.fixture
def short_config(tmp_path):
    """SHORT as a file."""
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return path


@pytest.fixture(scope="module")
def few_walkers():
    """Few walkers are led to a posterior, in this process: else they are most of a run on these small problems. Gives
    the line that makes them few in a child."""
    from bayes_iwan.sampling import run

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "POPULATION", 64)
        yield "from bayes_iwan.sampling import run; run.POPULATION = 64"


@pytest.fixture(scope="module")
def few_quick_walkers(few_walkers):
    """Quick runs have as few, in a third of the time, for tests of words and files. Gives the line for a child."""
    from bayes_iwan.inference.solving import posterior_draws

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(posterior_draws.QUICK, "walkers", 16)
        yield f"{few_walkers}; from bayes_iwan.inference.solving import posterior_draws as p; p.QUICK['walkers'] = 16"


# the analyses' scripts give their workers one thread through the environment; run inside this process they must not
# change the number that numba has started with
os.environ["NUMBA_NUM_THREADS"] = str(numba.config.NUMBA_NUM_THREADS)


@pytest.fixture(scope="module")
def no_figure_files():
    """Pages without the files of their figures, which cost more than most tests of what else is on a page."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "FILES", False)
        yield


@pytest.fixture(scope="module")
def no_pictures(no_figure_files):
    """Pages with their words and tables, figures made but not drawn nor made for phones: half a page's time and less,
    for tests of other things. Gives the line that does it in a child."""
    with pytest.MonkeyPatch.context() as patch:
        nothing = rendering.Rendered(Markup("<svg></svg>"))
        patch.setattr(rendering.Renderer, "rendered", lambda self, order: nothing)
        patch.setattr(rendering, "_start", lambda: None)  # no second process for nothing
        patch.setattr(style, "_on_phone", lambda drawn: style.blank(1.0))
        yield (
            "from bayes_iwan.report import rendering as r; r._start = lambda: None; "
            "r.Renderer.rendered = lambda *_: r.Rendered(r.Markup('<svg></svg>')); "
            "from bayes_iwan.report import style as s; s._on_phone = lambda _: s.blank(1.0)"
        )


@pytest.fixture
def figure_files(monkeypatch):
    """Pages write their figures as they do for a user."""
    monkeypatch.setattr(page, "FILES", True)


# ---- campaigns and diagnoses of the gap ----

SCALES = Scales(length_mm=0.9, speed_m_s=0.113, force_N=4.0, slip_N=1.2, soft_N_mm=5.5, stiff_N_mm=15.0)


def scaled(force: float = 1.0, length: float = 1.0, time: float = 1.0) -> Scales:
    """The scales of a specimen so many times as strong, long and slow."""
    return Scales(
        length_mm=SCALES.length_mm * length,
        speed_m_s=SCALES.speed_m_s * length / time,
        force_N=SCALES.force_N * force,
        slip_N=SCALES.slip_N * force,
        soft_N_mm=SCALES.soft_N_mm * force / length,
        stiff_N_mm=SCALES.stiff_N_mm * force / length,
    )


#: harmonics and phases of the campaigns below: enough for gaps of a few per cent, and quick
SMALL = {"n_phase": 48, "n_harmonics": 16}
#: slip forces of two gammas: a third adds nothing that these campaigns could show
TWO_GAMMAS = DiagnoseSettings(ModelSettings(slip="gamma2"))


def parameter_values_of(model: Model, draws: int = 1, **others) -> dict:
    """Table 1 (with what the model reads of it), (draws,) each, and other numbers of (draws,) or one for all."""
    out = {n: np.repeat(v, draws) for n, v in paper_parameters.table_1(model.reference).items() if n in model.names}
    return out | {n: np.broadcast_to(np.asarray(v, float), (draws,)).copy() for n, v in others.items()}


def elastic(reference) -> tuple[Model, dict]:
    """A spring of 10 N/mm: parallel 4 N/mm and elements of 6 N/mm, none of which slips below 30 N."""
    model = Model(reference, slip="uniform", normal_force="constant", stiffness="constant")
    return model, {
        "kp_N_mm": np.array([4.0]),
        "force_zero_N": np.zeros(1),
        "k1_N_mm": np.array([6.0]),
        "slip_mean_N": np.array([50.0]),
        "slip_width": np.array([0.4]),
    }


def made_up(force, tests, cycles=12, rate=1280.0, noise_N=0.0, extra=None, seed=0, roles=None):
    """A campaign of sines: force(frequency, amplitude, samples) gives one cycle (n,) of the specimen's force on
    phases from the upward crossing; extra(time, test) is added along the record. Frequencies divide the sampling
    rate."""
    records = []
    for i, (f, a) in enumerate(tests):
        per = round(rate / f)
        time = np.arange(cycles * per) / rate
        values = np.tile(force(f, a, per), cycles)
        values = values + noise_N * np.random.default_rng([seed, i]).standard_normal(time.size)
        if extra is not None:
            values = values + extra(time, i)
        records.append(
            Record(f"t{i}.csv", f, a, (roles or {}).get(i, "fit"), {}, time, a * np.sin(2.0 * np.pi * f * time), values)
        )
    return Campaign("made up", "", "", "", Path("made_up"), tuple(records))


def force_of(model, parameter_values):
    """One cycle of a model's force, by frequency, amplitude and samples: what `made_up` takes."""

    def force(frequency, amplitude, samples):
        motion = sine_motion(frequency_hz=frequency, amplitude_mm=amplitude, samples=samples)
        return model.force(parameter_values, motion)[0, 0]

    return force


def specimen_force(frequency, amplitude, samples):
    """One cycle of Table 1's force."""
    model = Model(SCALES.reference)
    return force_of(model, parameter_values_of(model))(frequency, amplitude, samples)


#: tests by plan: frequency, amplitude, role
PLANS = {
    "grid": [(f, a, "fit") for f in (8.0, 20.0) for a in (0.4, 0.9)],
    "single": [(10.0, a, "fit") for a in (0.3, 0.5, 0.9)],
}
PLANS["held out"] = [*PLANS["grid"], (13.0, 0.6, "held-out")]
PLANS["no clock"] = PLANS["grid"]


@cache
def rig_records(effect: str | None, plan: str = "grid"):
    """Tests on the virtual rig, the effect at an eighth of the friction force."""
    from bayes_iwan.virtual_rig.planning import simulate_campaign
    from bayes_iwan.virtual_rig.simulate import PlannedTest

    tests = [PlannedTest(f, a, cycles=12, role=role) for f, a, role in PLANS[plan]]
    return simulate_campaign(tests, fault=effect, size=0.12, seed=3)


def campaign_of(virtual) -> Campaign:
    return Campaign("virtual rig", "", "", "", Path("virtual_rig"), virtual.records)


def diagnosed(effect: str | None, plan: str = "grid"):
    """Quick diagnosis of a rig campaign."""
    from bayes_iwan.diagnosis.diagnosis import diagnose_loops

    campaign = campaign_of(rig_records(effect, plan))
    campaign = replace(campaign, tests=tuple(replace(x, clock=plan != "no clock") for x in campaign.tests))
    return diagnose_loops(campaign, campaign.loops(**SMALL), seed=1, quick=True, settings=TWO_GAMMAS)


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """once(name, make): a folder that make(folder) fills, once for all processes of a run; two that begin together both
    make it."""
    top = tmp_path_factory.getbasetemp()
    top = top.parent if "PYTEST_XDIST_WORKER" in os.environ else top

    def folder_of(name, make):
        if not (folder := top / name).exists():
            make(made := tmp_path_factory.mktemp(name))
            with suppress(OSError):  # the other was quicker
                made.rename(folder)
        return folder

    return folder_of


@pytest.fixture(scope="session")
def kit(once):
    @cache
    def diagnosed_once(effect, plan="grid"):
        def make(folder):
            (folder / "diagnosis.pickle").write_bytes(pickle.dumps(diagnosed(effect, plan)))

        return pickle.loads((once(f"{effect}_{plan}".replace(" ", "_"), make) / "diagnosis.pickle").read_bytes())

    some = (scaled, elastic, made_up, force_of, specimen_force, rig_records, campaign_of)
    numbers = {"scales": SCALES, "small": SMALL, "settings": TWO_GAMMAS, "reference": Reference(0.9, 0.113)}
    named = {f.__name__: f for f in some} | {"parameter_values": parameter_values_of, "diagnosed": diagnosed_once}
    return SimpleNamespace(**numbers, **named)


# ---- loops of known numbers, without a campaign folder ----

TESTS = ((10.0, 0.3), (10.0, 1.0), (15.0, 0.6), (20.0, 1.0))
REFERENCE = Reference(1.0, 0.12566)

#: Table 1 of the paper, with a softer normal force than its corner at β → 0
TABLE_1 = {"kp_N_mm": 5.49, "force_zero_N": 0.0}
for _k, _t, _eta, _g in ((1, 0.24, 0.95, 0.41), (2, 0.36, 5.1, 0.53), (3, 0.5, 4.4, 0.06)):
    TABLE_1 |= {f"t{_k}_N": _t, f"eta{_k}": _eta, f"g{_k}": _g}


def parameter_values() -> dict[str, np.ndarray]:
    out = {k: np.array([v]) for k, v in TABLE_1.items()}
    return out | from_paper_stiffness(19.62, 30.37) | from_paper_hunt_crossley(0.6, 1.1, 0.6, REFERENCE)


def record(frequency_hz, amplitude_mm, force_N, noise_N=0.0, seed=0, cycles=8, name=None):
    """A record whose every cycle is the loop force_N (samples,), with white noise."""
    n = len(force_N) * cycles
    time = np.arange(n) / (len(force_N) * frequency_hz)
    noise = np.random.default_rng([seed, int(1000 * frequency_hz * amplitude_mm)]).standard_normal(n)
    seen = (time, amplitude_mm * np.sin(2 * np.pi * frequency_hz * time), np.tile(force_N, cycles) + noise_N * noise)
    name = name or f"f{frequency_hz:g}_a{amplitude_mm:g}.csv"
    return Record(name, frequency_hz, amplitude_mm, "fit", {}, *seen)


def loops(noise_N=0.02, seed=0, n_phase=128, tests=TESTS, model=None, values=None):
    model = Model(REFERENCE) if model is None else model
    # four times the usual 128 samples a cycle, so that all 50 harmonics are within the trusted band
    motion = sine_motion(frequency_hz=[f for f, _ in tests], amplitude_mm=[a for _, a in tests], samples=512)
    force = model.force(parameter_values() if values is None else values, motion)[0]
    return tuple(average(record(f, a, row, 2.0 * noise_N, seed), n_phase=n_phase) for (f, a), row in zip(tests, force))


def true_z(problem, values=None, **noise):
    """Coordinates of the known numbers in a problem made from their loops (whose reference scales differ a little)."""
    n = dict(parameter_values() if values is None else values)
    if "beta" in n:
        s = problem.model.reference
        length = s.length_mm / REFERENCE.length_mm
        n["normal_force_slope"] = n["normal_force_slope"] * length ** n["beta"]
        n["normal_force_rate"] = n["normal_force_rate"] * length ** n["beta"] * s.speed_m_s / REFERENCE.speed_m_s
    default = {"noise_scale": 1.0, "discrepancy_share": 1e-4, "discrepancy_length": 0.06, "noise_N": 0.02}
    default |= {"discrepancy_odd": 1e-4, "discrepancy_even": 1e-4, "discrepancy_slope": 2.0}
    default |= dict.fromkeys(embedded_error.NAMES, 0.0)
    return problem.prior.scores(problem.model.values(n) | default | noise)


@pytest.fixture(scope="session")
def known():
    """Functions and numbers of this file, for the tests."""

    made = {"loops": loops, "record": record, "parameter_values": parameter_values, "true_z": true_z}
    return SimpleNamespace(**made, reference=REFERENCE, tests=TESTS)


@pytest.fixture(scope="session")
def problem():
    return make_problem(loops())
