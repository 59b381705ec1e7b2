"""Mutated files against every reader but `check` (that is fuzz_campaigns.py): refused in one line, read, or worse?

    python analyses/fuzz.py --inputs 2000 [--seed N] [--only config ...]

Sound files are made once (an identification, a small diagnosis' files, sealed cases), then their bytes are damaged and
they are read as the commands read them: configurations and effects of a user, checkpoints, posteriors, fits, diagnoses,
commitments, truths and answers, and the records of a batch. The readers run in a forked process with a limit on its
memory, so that a crash of a library counts like a traceback of ours.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import mutations
from bayes_iwan.campaign import read_campaign
from bayes_iwan.effects.user_file import load_effects
from bayes_iwan.files import write_json, write_whole
from bayes_iwan.gap.saved_fits import read_fits
from bayes_iwan.inference import results
from bayes_iwan.inference.config import settings_of
from bayes_iwan.inference.identify import identify_campaign
from bayes_iwan.inference.problem import make_problem
from bayes_iwan.inference.scales import scales_of
from bayes_iwan.report.batch import stored_specimen
from bayes_iwan.sampling.checkpoint import NAME, read_checkpoint
from bayes_iwan.validation import sealed as withheld
from bayes_iwan.validation.answering import read_diagnosis
from fuzz_campaigns import Hang, limited, peak_MB
from kill_runs import CONFIG, made_up

HERE = Path(__file__).parent
#: beyond what the process holds when the readers begin
MEMORY_MB = 600

LONG_CONFIG = (
    CONFIG
    + """
[parameters.kp_N_mm]
prior = {dist = "lognormal", median = 5.0, sigma = 0.5}
upper = 100.0
[parameters.k1_N_mm]
fixed = 14.0
[loops]
n_phase = 64
n_harmonics = 20
"""
)


@dataclass(frozen=True)
class Reader:
    """A file's sound bytes, where it lies, and what reads it."""

    raw: bytes
    path: Path
    read: Callable[[], object]


def sealed_cases(folder: Path, truth: dict) -> None:
    """As `withheld answer` and `withheld score` read the commitments."""
    withheld.case_names(folder)
    withheld.check_seals(folder, {"case_01": truth})


def readers(tmp: Path) -> dict[str, Reader]:
    """Sound files of each kind below `tmp`, and their readers."""
    campaign = made_up(tmp / "campaign", 5.5, 7)
    config = write_whole(tmp / "config.toml", CONFIG)
    out = tmp / "run"
    identify_campaign(campaign, out, config=config, seed=1, progress=False)
    loops = read_campaign(campaign).loops(n_phase=64, n_harmonics=20)
    long = write_whole(tmp / "long.toml", LONG_CONFIG)

    def configured() -> None:
        problem = make_problem(loops, settings_of(long))
        with np.errstate(all="ignore"):
            problem.log_prob(problem.prior.draw(np.random.default_rng(0), 4))

    effect = write_whole(tmp / "effect.py", (HERE / "effects" / "quadratic_drag.py").read_text())
    folder = tmp / "cases"
    made_up(folder / "case_01", 5.0, 1)
    truth = {"salt": "00", "kind": "none", "effects": [], "data": withheld.file_hashes(folder / "case_01")}
    sealed = folder / "commitments.json"
    write_json(sealed, {"rule": withheld.RULE, "cases": {"case_01": withheld.commitment(truth)}})
    truths = tmp / "truth.json"
    write_json(truths, {"schema": 1, "seed": 0, "cases": {"case_01": truth}})
    answer = {"verdict": {"cause": "none", "probability": 0.9}, "probabilities": {"none": 0.9, "unknown": 0.1}}
    write_json(tmp / "answer" / "diagnosis.json", answer)
    fit = {"effects": [], "names": ["kp_N_mm", "k1_N_mm"], "z": [0.1, -0.2], "covariance": [[1e-3, 0.0], [0.0, 2e-3]]}
    effects = [{"class": "MovingMass", "name": "moving_mass", "strength_value": None}]
    fits = {"schema": 1, "scales": asdict(scales_of(loops)), "config": {}, "effects_file": None, "simulator_file": None}
    fits |= {"base": fit | {"share": 0.01, "length": 0.1}, "with": {"moving_mass": fit | {"effects": effects}}}
    write_json(tmp / "fits" / "fits.json", fits)
    specimen = tmp / "specimen" / "specimen.json"
    quantity = {"label": "kp", "unit": "N/mm", "median": 5.0, "low": 4.9, "high": 5.1, "draws": [4.9, 5.0, 5.1]}
    write_json(
        specimen,
        {
            "schema": 1,
            "made_with": {},
            "quantities": {"kp_N_mm": quantity | {"prior": [1.0, 2.0, 9.0]}},
            "converged": True,
            "message": "converged",
            "seconds": 3.0,
        },
    )
    found: dict[str, tuple[Path, Callable[[], object]]] = {
        "config": (long, configured),
        "effects": (effect, lambda: load_effects(effect)),
        "checkpoint": (out / NAME, lambda: read_checkpoint(out / NAME, ("plain", "tempered", "production"))),
        "posterior.nc": (out / "posterior.nc", lambda: results.load(out)),
        "diagnosis.json": (tmp / "answer" / "diagnosis.json", lambda: read_diagnosis(tmp / "answer")),
        "fits.json": (tmp / "fits" / "fits.json", lambda: read_fits(tmp / "fits" / "fits.json")),
        "commitments.json": (sealed, lambda: sealed_cases(folder, truth)),
        "truth.json": (truths, lambda: withheld.check_seals(folder, withheld.read_truths(truths))),
        "specimen.json": (specimen, lambda: stored_specimen(specimen.parent, {})),
    }  # fmt: skip
    return {name: Reader(path.read_bytes(), path, read) for name, (path, read) in found.items()}


def outcome(reader: Reader, rng: np.random.Generator, show: str = "") -> str:
    """What a reader makes of one damaged file."""
    reader.path.write_bytes(mutations.damaged(reader.raw, rng))
    try:
        with limited(), warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            found = reader.read()
        return "read" if found is not None or "specimen" not in reader.path.name else "refused"
    except ValueError as error:
        if type(error) is ValueError or "\n" in str(error):
            said = "other ValueError" if "\n" not in str(error) else "several lines"
            if show:
                print(f"{show}: {said}: {str(error)[:300]}", flush=True)
                traceback.print_exc(limit=-3)
            return said
        return "refused"
    except Hang:
        return "hang"
    except BaseException:
        if show:
            print(f"{show}:", flush=True)
            traceback.print_exc(limit=-3)
        return "traceback"


def in_fork(reader: Reader, name: str, seeds: range, seed: int) -> Counter[str]:
    """Outcomes of some damaged files, in a process of their own with limited memory."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(read)
        with open("/proc/self/statm") as file:
            now = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + (MEMORY_MB << 20),) * 2)
        for i in seeds:
            word = outcome(reader, np.random.default_rng([seed, i]), f"{name}, seed {seed} {i}")
            os.write(write, (word + "\n").encode())
        os.write(write, f"peak {peak_MB():.0f}\n".encode())
        os._exit(0)
    os.close(write)
    with open(read) as file:
        words = file.read().split("\n")[:-1]
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    counts = Counter(w for w in words if not w.startswith("peak"))
    if status != 0:
        counts["crash"] += 1
        print(f"{name}, seed {seed} {seeds[len(words)]}: the process ended with {status}", flush=True)
    counts["peak MB"] = max((int(w.split()[1]) for w in words if w.startswith("peak")), default=0)
    return counts


def fuzz(inputs: int, seed: int, only: list[str] | None = None) -> dict[str, Counter[str]]:
    """Outcomes by kind of file, `inputs` of them in all, shared out evenly."""
    tmp = Path(tempfile.mkdtemp(prefix="fuzz"))
    try:
        every = {n: r for n, r in readers(tmp).items() if not only or n in only}
        out = {}
        for name, reader in every.items():
            counts: Counter[str] = Counter()
            n = -(-inputs // len(every))
            for first in range(0, n, 500):
                some = in_fork(reader, name, range(first, min(n, first + 500)), seed)
                peak = max(counts.pop("peak MB", 0), some.pop("peak MB"))
                counts += some
                counts["peak MB"] = peak
            reader.path.write_bytes(reader.raw)
            out[name] = counts
        return out
    finally:
        shutil.rmtree(tmp)


HEADS = ("refused", "read", "traceback", "other ValueError", "several lines", "hang", "crash", "peak MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", metavar="KIND")
    args = parser.parse_args()
    began = time.monotonic()
    found = fuzz(args.inputs, args.seed, args.only)
    print(f"{'file':18s} " + " ".join(f"{h:>16s}" for h in HEADS))
    for name, counts in found.items():
        print(f"{name:18s} " + " ".join(f"{counts[h]:16d}" for h in HEADS))
    n = sum(c for counts in found.values() for h, c in counts.items() if h != "peak MB")
    print(f"{n} inputs in {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
