"""Sound files of every kind that the package reads, small ones, and what reads each: what fuzz.py damages.

All paths are relative to a folder, so that several processes can damage copies of it side by side. A reader goes as far
as the command does with what the file says, beyond parsing: what passes a parser and breaks later is a finding too.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

import mutations
from bayes_iwan.campaign import Record, average, read_campaign, write_campaign
from bayes_iwan.diagnosis.answer import saved_fits
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.fits.evidence import base_model, base_problem
from bayes_iwan.effects.catalogue import load_effects
from bayes_iwan.files import write_json, write_whole
from bayes_iwan.inference.identify import identify_campaign
from bayes_iwan.inference.results import netcdf, run_files
from bayes_iwan.inference.setup.config import diagnose_settings_of, settings_of
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.models.user_file import load_simulator
from bayes_iwan.report.batch.batch_run import stored_specimen
from bayes_iwan.report.batch.specimens import Batch, populations
from bayes_iwan.sampling import checkpoint
from bayes_iwan.sampling import run as sampling_run
from bayes_iwan.sampling.blocks import Density
from bayes_iwan.sampling.plan import Plan
from bayes_iwan.withheld import scoring
from bayes_iwan.withheld import sealed as withheld
from bayes_iwan.withheld.answering import read_diagnosis
from bayes_iwan.withheld.answers import read_answer
from bayes_iwan.withheld.truths import read_truth
from fuzz_recordings import Reader, recording_readers
from kill_runs import CONFIG, made_up

HERE = Path(__file__).parent

LONG_CONFIG = (
    CONFIG
    + """
[parameters.kp_N_mm]
prior = {dist = "lognorm", s = 0.5, scale = 5.0}
upper = 100.0
[parameters.k1_N_mm]
fixed = 14.0
"""
)
DIAGNOSE_CONFIG = """
[model]
slip = "gamma2"
normal_force = "constant"
[parameters.kp_N_mm]
prior = {dist = "lognorm", s = 0.5, scale = 5.0}
lower = 1.0
[parameters.eta1]
tied = "eta2"
"""
CAUSE = {
    "name": "moving_mass", "probability": 0.98, "share": 0.7, "share_interval": [0.6, 0.8], "share_held_out": 0.65,
    "tied_with": ["force_delay"],
}  # fmt: skip
ANSWER = {
    "schema": 2,
    "verdict": {"kind": "explained", "causes": [CAUSE], "unknown_cause": False},
    "probabilities": {"moving_mass": 0.98, "none": 0.01, "unknown_cause": 0.05},
    "rest": {"share": 0.1, "interval": [0.0, 0.2]},
}


def resealed_netcdf(raw: bytes, rng: mutations.Rng) -> bytes:
    """A result whose texts or numbers were changed by somebody who made its checksum anew."""
    sound = raw[: -len(netcdf.SEAL) - 32]
    if rng.random() < 0.7:  # its texts, in place: their lengths stand elsewhere
        changed = bytearray(sound)
        quotes = [i for i in range(len(sound) - 1) if sound[i : i + 1] in b'":,[']
        for _ in range(int(rng.integers(1, 4))):
            at = int(quotes[rng.integers(len(quotes))]) + 1
            piece = mutations.HOSTILE[rng.integers(len(mutations.HOSTILE))][: int(rng.integers(1, 12))]
            changed[at : at + len(piece)] = piece[: len(sound) - at]
        sound = bytes(changed)
    else:
        sound = mutations.damaged(sound, rng)
    return sound + netcdf.SEAL + hashlib.sha256(sound).digest()


def resealed_checkpoint(raw: bytes, rng: mutations.Rng) -> bytes:
    """A checkpoint of which one record's arrays were changed and the chain of checksums was made anew."""
    start, records = len(checkpoint._MAGIC), []
    while start < len(raw):
        length = int.from_bytes(raw[start : start + 8], "big")
        with np.load(io.BytesIO(raw[start + 40 : start + 40 + length]), allow_pickle=False) as stored:
            records.append({k: stored[k] for k in stored.files})
        start += 40 + length
    chosen = records[rng.integers(len(records))]
    key = list(chosen)[rng.integers(len(chosen))]
    chosen[key] = _other_array(chosen[key], rng)
    if rng.random() < 0.1:
        del chosen[key]
    out, digest = checkpoint._MAGIC, b""
    for record in records:
        one, digest = checkpoint._record(record, digest)
        out += one
    return out


def _other_array(x: np.ndarray, rng: mutations.Rng) -> np.ndarray:
    if x.dtype.kind == "U":
        return np.array(mutations.damaged(str(x).encode(), rng).decode(errors="replace"))
    kinds: tuple[Callable[[], np.ndarray], ...] = (
        lambda: x[..., :-1] if x.ndim and x.size else np.array("text"),
        lambda: x.reshape(-1),
        lambda: x[None],
        lambda: x.astype(complex),
        lambda: np.full_like(np.asarray(x, float), np.nan),
        lambda: np.asarray(x, float) * 10 ** rng.normal(0, 20),
        lambda: -np.asarray(x, float),
        lambda: np.zeros((0,)),
        lambda: np.array([mutations.HOSTILE[0].decode()] * max(x.size, 1)),
        lambda: rng.permutation(x.reshape(-1)).reshape(x.shape),
    )
    with np.errstate(all="ignore"):
        return kinds[rng.integers(len(kinds))]()


def _campaign(folder: Path, cycles: int = 8) -> Path:
    """Two short tests as plain text: a packed file's checksum refuses nearly all."""
    made_up(folder.with_name("long"), 5.5, 7)
    tests = [_thinned(r, cycles) for r in read_campaign(folder.with_name("long")).tests]
    write_campaign(folder, name="fuzz", description="two tests", tests=tests, compress=False)
    return folder


def _thinned(r: Record, cycles: int) -> Record:
    n = round(cycles / (r.frequency_hz * (r.time_s[1] - r.time_s[0])))
    keep = slice(0, n, 2)
    return replace(r, time_s=r.time_s[keep], displacement_mm=r.displacement_mm[keep], force_N=r.force_N[keep])


def _gauss(z: np.ndarray, random: np.random.RandomState) -> np.ndarray:
    return -0.5 * (z**2).sum(axis=1, keepdims=True)


def _sampled(path: Path, resume: bool) -> object:
    """A short run of a normal distribution in two numbers, or what going on from its checkpoint gives."""
    both = np.arange(2)
    density = Density(_gauss, both, both[:0], (both,))
    plan = Plan(("a", "b"), 1, checkpoint=path, resume=resume, max_steps=40, progress=False)
    return sampling_run.sample(density, np.zeros((1, 2)), np.eye(2), plan, n_ensembles=2, n_walkers=8)


def _fits(path: Path) -> Callable[[], object]:
    """fits.json of a diagnosis that named a mass, and its reader, with the sealed campaign read once."""
    data = gap_data(read_campaign("campaign").loops(**saved_fits.LOOPS))
    scales = scales_of(data.loops)
    settings = diagnose_settings_of({"model": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant"}})
    names = base_problem(data, settings, scales, base_model(settings, scales)).names

    def fit(more: tuple[str, ...], effects: list[dict]) -> dict[str, object]:
        n = len(names) + len(more)
        sizes = {"share": 0.01, "length": 0.1, "along": 0.3, "spectrum": [1.0, 0.5], "along_spectrum": [0.7]}
        sizes |= {"between": [3.0, 0.25, 0.03]}
        covariance = (1e-3 * np.eye(n)).tolist()
        return {"effects": effects, "names": [*names, *more], "z": [0.1] * n, "covariance": covariance, **sizes}

    effect = {"class": "MovingMass", "name": "moving_mass", "strength_value": 0.1}
    stored = {"schema": saved_fits.SCHEMA, "scales": asdict(scales), "config": settings.as_dict(), "effects_file": None}
    fits = {"base": fit((), []), "moving_mass": fit(("moving_mass_kg",), [effect])}
    write_json(path, stored | {"simulator_file": None, "fits": fits})
    saved_fits.gap_data = lambda loops: data  # the campaign is not on trial here
    return lambda: saved_fits.find_shares(path.parent, Path("campaign"))


def _specimen(folder: Path) -> Callable[[], object]:
    """A batch's record of a specimen, and its reader, which goes on to the table and the population."""
    draws = np.random.default_rng(0).normal(5.0, 0.1, 40).round(4).tolist()
    quantity = {"label": "kp", "unit": "N/mm", "median": 5.0, "low": 4.9, "high": 5.1, "draws": draws, "prior": draws}
    record = {"schema": 1, "made_with": {}, "quantities": {"kp_N_mm": quantity}, "converged": True}
    write_json(folder / "specimen.json", record | {"message": "converged", "seconds": 3.0, "cause": "none"})

    def read() -> object:
        found = stored_specimen(folder, {})
        if found is None:
            return None
        some = tuple(replace(found, name=name) for name in "abc")
        with np.errstate(all="ignore"):
            Batch(some, {}, populations(some)).table().csv()
        return found

    return read


def _withheld(folder: Path, truths: Path) -> None:
    """Two sealed cases, answered."""
    sealed, kept = {}, {}
    for name in ("case_01", "case_02"):
        write_campaign(folder / name, name=name, description="", tests=read_campaign("campaign").tests, compress=False)
        effects = [{"name": "moving_mass", "law": "mass", "size": 0.1, "visible_share": 0.9, "share": 1.0}]
        kept[name] = {
            "schema": 2, "case": name, "kind": "single", "effects": effects, "noise": {"share_of_friction": 0.003},
            "specimen": {"family": "gamma"}, "salt": "00" * 32, "data": withheld.file_hashes(folder / name),
            "design": {"tests": [{"frequency_hz": 10.0, "role": "fit"}]},
        }  # fmt: skip
        sealed[name] = withheld.commitment(kept[name])
    write_json(folder / "commitments.json", {"rule": withheld.RULE, "sealed": True, "cases": sealed})
    write_json(truths, {"schema": 2, "entropy": "00", "cases": kept})
    write_json(folder / "answers" / "answers.json", {"schema": 2, "answers": {name: ANSWER for name in sealed}})


def readers() -> dict[str, Reader]:
    """Sound files below the working directory, and their readers by the kind of file; every sound file is read."""
    campaign = _campaign(Path("campaign"))
    tests = read_campaign(campaign).tests
    loops = tuple(average(r, 64, 20) for r in tests)
    config, other = write_whole("config.toml", LONG_CONFIG), write_whole("diagnose.toml", DIAGNOSE_CONFIG)

    def configured() -> object:
        problem = make_problem(loops, settings_of(config))
        with np.errstate(all="ignore"):
            return problem.log_prob(problem.prior.draw(np.random.default_rng(0), 4))

    def for_a_diagnosis() -> object:
        settings = diagnose_settings_of(other)
        return base_problem(data, settings, scales, base_model(settings, scales))

    # kernels that damaged files may ask for, compiled here: in the forks, on a busy machine, that looked like a hang
    default = make_problem(loops, settings_of(None))
    default.log_prob(default.prior.draw(np.random.default_rng(0), 4))
    data, scales = gap_data(loops), scales_of(loops)
    found = identify_campaign(
        campaign, config={**settings_of(write_whole("short.toml", CONFIG)).as_dict()}, seed=1, quick=True
    )
    Path("run").mkdir()
    netcdf.write_netcdf(replace(found, z=found.z[:, :30], log_prob=found.log_prob[:, :30]), Path("run/posterior.nc"))
    ckpt = Path("run") / checkpoint.NAME
    _sampled(ckpt, False)
    fits, specimen = _fits(Path("fits/fits.json")), _specimen(Path("specimen"))
    cases, truths = Path("cases"), Path("cases-truth/truth.json")
    _withheld(cases, truths)
    write_json("answer/diagnosis.json", ANSWER)
    effects = write_whole("effects.py", (HERE / "effects" / "quadratic_drag.py").read_text())
    simulator = write_whole("simulator.py", (HERE / "simulators" / "damped_spring.py").read_text())
    answers, folder = cases / "answers" / "answers.json", (campaign / "campaign.toml", *sorted(campaign.glob("*.csv")))

    def sealed() -> object:
        withheld.check_seals(cases, {**withheld.read_truths(truths)})
        return withheld.case_names(cases)

    def scored() -> object:
        return scoring.score_answers(withheld.read_truths(truths), scoring.read_answers(answers)).table()

    out = {
        "campaign": Reader(folder, lambda: read_campaign(campaign)),
        "config": Reader((config,), configured),
        "diagnose config": Reader((other,), for_a_diagnosis),
        "effects": Reader((effects,), lambda: load_effects(effects)),
        "simulator": Reader((simulator,), lambda: load_simulator(simulator)),
        "posterior.nc": Reader((Path("run/posterior.nc"),), lambda: run_files.load("run", campaign)),
        "posterior.nc, resealed": Reader(
            (Path("run/posterior.nc"),), lambda: run_files.load("run", campaign), resealed_netcdf
        ),
        "chains.ckpt": Reader((ckpt,), lambda: checkpoint.read_checkpoint(ckpt)),
        "chains.ckpt, resealed": Reader((ckpt,), lambda: _sampled(ckpt, True), resealed_checkpoint),
        "diagnosis.json": Reader(
            (Path("answer/diagnosis.json"),), lambda: read_answer("case", read_diagnosis(Path("answer")))
        ),
        "fits.json": Reader((Path("fits/fits.json"),), fits),
        "commitments.json": Reader((cases / "commitments.json",), sealed),
        "truth.json": Reader((truths,), sealed),
        "truth.json, unsealed": Reader(
            (truths,), lambda: [read_truth(n, t) for n, t in withheld.read_truths(truths).items()]
        ),
        "answers.json": Reader((answers,), scored),
        "specimen.json": Reader((Path("specimen/specimen.json"),), specimen),
    }  # fmt: skip
    out |= recording_readers(tests[1])
    for name, reader in out.items():
        if reader.read() is None:
            raise RuntimeError(f"{name}: the sound file is not read")
    return out
