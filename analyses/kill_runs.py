"""Runs killed, signalled, starved of disk and handed damaged files at random: what is lost, and is the answer the same?

    python analyses/kill_runs.py --kills 300 --out kills.json

Small made-up campaigns, so that a kill costs half a second. Each trial runs a command in a forked process that is
ended at a random moment, checks what lies in its folder, starts it again, and so on until it finishes by itself; then
every result must be that of a run that nobody disturbed, bit for bit, with nothing else left in the folder. Kills come
so early or late that some run in three to six gets through, since only those are compared. To spend
the time on what is on trial, few walkers are led to a posterior, pages have one figure, and a diagnosis, which has no
state to go on from, finds what it is told: the kills strike while its files are written.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

import bayes_iwan
import stand_in
from bayes_iwan import cli
from bayes_iwan.campaign import Record, read_campaign, write_campaign
from bayes_iwan.files import write_json
from bayes_iwan.inference.results.run_files import load
from bayes_iwan.models import Model, Reference, sine_motion
from bayes_iwan.report.diagnosis import diagnosis_files as diagnosis_folder
from bayes_iwan.report.identification import identification_page
from bayes_iwan.report.page import Page
from bayes_iwan.report.style import subplots
from bayes_iwan.sampling import run as sampling_run
from bayes_iwan.sampling.checkpoint import NAME as CHECKPOINT
from bayes_iwan.withheld import answering
from bayes_iwan.withheld import sealed as withheld

CONFIG = """
[model]
slip = "gamma1"
normal_force = "constant"
stiffness = "constant"
embedded = false
[loops]
n_phase = 64
n_harmonics = 20
[likelihood]
kind = "gaussian"
[search]
members = 40
evaluations = 600
starts = 3
second_search = false
[sampling]
ensembles = 2
walkers = 16
r_hat = 1.1
ess = 60
taus = 8
draws = 500
budget_s = 100000
"""
#: files of which every byte must be the same after an interruption as without
SAME = ("summary.csv", "diagnosis.json", "fits.json", "answers.json", "batch.csv", "draws")


@dataclass
class Tally:
    """What happened to one kind of run."""

    kills: int = 0  # by SIGKILL; of the other kinds, whatever ended a run early
    stops: int = 0  # by SIGTERM and SIGINT
    finished: int = 0
    equal: int = 0
    half_files: int = 0
    leftovers: int = 0
    tracebacks: int = 0
    seconds: float = 0.0
    notes: list[str] = field(default_factory=list)


def made_up(folder: Path, kp: float, seed: int) -> Path:
    """Two tests of a classical Iwan specimen, 8 cycles each."""
    model = Model(Reference(1.0, 0.1), slip="gamma1", normal_force="constant", stiffness="constant")
    true = {"kp_N_mm": kp, "force_zero_N": 0.0, "k1_N_mm": 14.0, "t1_N": 0.6, "eta1": 2.0, "g1": 1.0}
    records = []
    for amplitude in (0.3, 1.0):
        loop = model.force(
            {k: np.array([v]) for k, v in true.items()}, sine_motion(frequency_hz=10.0, amplitude_mm=amplitude)
        )[0, 0]
        time_s = np.arange(8 * 128) / 1280.0
        noise = 0.02 * np.random.default_rng([seed, int(10 * amplitude)]).standard_normal(time_s.size)
        displacement = amplitude * np.sin(20.0 * np.pi * time_s)
        file = f"f10_a{amplitude:g}.csv"
        records.append(Record(file, 10.0, amplitude, "fit", {}, time_s, displacement, np.tile(loop, 8) + noise))
    write_campaign(folder, name="made up", description="", tests=records, compress=False)
    return folder


def as_found() -> dict[str, object]:
    """What a search would have found."""
    return {"verdict": {"cause": "none", "probability": 0.9}, "sentences": ["none"], "numbers": list(range(3000))}


def write_told(found: object, out: Path, *files: object) -> dict[str, object]:
    """Both files of a diagnosis, as large as real ones."""
    write_json(out / "fits.json", {"z": list(range(3000))})
    write_json(out / "diagnosis.json", as_found())
    return as_found()


def small_figure() -> Figure:
    figure, axes = subplots(1, 1, 2, 2)
    axes[0, 0].plot([0, 1], [0, 1])
    return figure


def small_page(*rest: object) -> Path:
    """A page of one figure, written as all pages are; the last argument that is a path says where."""
    at = next(Path(x) for x in rest if isinstance(x, Path))
    page = Page("small")
    page.section("one").figure(small_figure(), "a line", "a line")
    return page.write(at if at.suffix else at / "report.html")


def lighten() -> None:
    """Few walkers, pages of one figure, a diagnosis that is told: in this process and its children alone."""
    sampling_run.POPULATION = 64
    identification_page.identification_report = small_page
    fit = SimpleNamespace(problem=SimpleNamespace(prior=SimpleNamespace(free=())))
    diagnosis_folder.diagnose_campaign = lambda campaign, **options: SimpleNamespace(
        campaign=read_campaign(campaign), seed=0, fit=fit, verdict=SimpleNamespace(causes=()),
        sentences=lambda: as_found()["sentences"],
    )  # fmt: skip
    diagnosis_folder.write_answer = write_told
    diagnosis_folder.figures_of_diagnosis = lambda found: dict.fromkeys(("gap", "where", "shares"), small_figure)
    diagnosis_folder.write_diagnosis_page = lambda found, figures, path, *about: small_page(path)


def in_child(work: Callable[[], int], said: Path, limit: int | None = None) -> int:
    """Start `work` in a forked process whose words go to a file; returns its process id."""
    pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        words = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(words, 1)
        os.dup2(words, 2)
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        code = work()
    except KeyboardInterrupt:  # before the command was there to catch it
        code = 130
    except BaseException as error:
        print(f"Traceback: {type(error).__name__}: {error}", flush=True)
    finally:
        os._exit(code)


def used_s(pid: int) -> float:
    """Processor seconds so far of a process that we started, and of all that it started."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        below = [int(x) for t in Path(f"/proc/{pid}/task").iterdir() for x in (t / "children").read_text().split()]
    except OSError:  # it ended meanwhile
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK") + sum(map(used_s, below))


def ended(pid: int, processor_s: float | None, number: int) -> int:
    """Wait for a process, for so many processor seconds at most, then signal it; its exit code, negative for a signal.

    Processor time, since a busy machine stretches a run, and a kill would come at another place of it.
    """
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if processor_s is not None and used_s(pid) > processor_s:
            os.kill(pid, number)
            if number != signal.SIGKILL:
                processor_s = None  # it ends in its own time
                continue
            _, status = os.waitpid(pid, 0)
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)


def whole(out: Path) -> list[str]:
    """What in a folder is half written, or new beside old."""
    bad = []
    for path in out.rglob("*.json"):
        try:
            json.loads(path.read_text())
        except ValueError:
            bad.append(path.name)
    bad += [p.name for p in out.rglob("*.html") if not p.read_text().rstrip().endswith("</html>")]
    for path in out.rglob("posterior.nc"):
        try:
            load(path.parent)
        except ValueError as error:
            bad.append(str(error))
    for path in out.rglob("diagnosis.json"):  # written last: where it stands, page and fits do
        for other in (path.with_name("diagnosis.html"), path.with_name("fits.json")):
            if not other.exists() or other.stat().st_mtime_ns > path.stat().st_mtime_ns:
                bad.append(f"an answer without its {other.name}")
    return bad


def results(out: Path) -> dict[str, bytes]:
    """What must be the same: the bytes of the results, and the draws of each posterior."""
    found = {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.name in SAME}
    for path in out.rglob("posterior.nc"):
        found[str(path.relative_to(out)) + " draws"] = load(path.parent).z.tobytes()
    if (out / "batch.csv").exists():  # seconds differ
        lines = [line.split(",") for line in (out / "batch.csv").read_text().splitlines()]
        found["batch.csv"] = json.dumps([[*x[:3], *x[4:]] for x in lines]).encode()
    return found


def trial(
    start: Callable[[], int], out: Path, expected: dict[str, bytes], tally: Tally, rng: np.random.Generator,
    mean_s: float, wanted: int,
) -> None:  # fmt: skip
    """One run, ended at random until it finishes or `wanted` kills are spent; then it is left to finish."""
    said = out.with_name("said.txt")
    while True:
        number = rng.choice([signal.SIGKILL] * 8 + [signal.SIGTERM, signal.SIGINT])
        last = tally.kills >= wanted
        began = time.monotonic()
        code = ended(in_child(start, said), None if last else float(rng.uniform(0, 2 * mean_s)), int(number))
        tally.seconds += time.monotonic() - began
        if out.exists() and (bad := whole(out)):
            tally.half_files += 1
            tally.notes += bad
        if code in (0, 3):
            break
        if code == -signal.SIGKILL:
            tally.kills += 1
            continue
        if code in (-signal.SIGTERM, -signal.SIGINT, 130):
            tally.stops += 1
            continue
        tally.notes.append(f"exit code {code}: {said.read_text()[-400:]}")
        break
    tally.finished += 1
    found = results(out)
    tally.equal += found == expected
    if found != expected:
        tally.notes.append(f"differ: {sorted(k for k in expected if found.get(k) != expected[k])}")
    left = [str(p) for p in out.rglob(".*")] + [str(p) for p in out.rglob(CHECKPOINT)]
    tally.leftovers += bool(left)
    tally.notes += left
    tally.tracebacks += "Traceback" in said.read_text()
    shutil.rmtree(out, ignore_errors=True)
    said.unlink()


def killed(
    name: str, start: Callable[[Path], int], kills: int, mean: float, rng: np.random.Generator, tmp: Path
) -> Tally:
    """So many kills of one command, and the comparison with a run left alone.

    mean : processor time from its start to a kill, as a share of what it takes alone; a short one for commands that
    keep finished pieces, so that kills strike all over their length.
    """
    reference, out = tmp / f"{name}-whole", tmp / f"{name}-cut"
    before = sum(os.times()[2:4])
    code = ended(in_child(lambda: start(reference), tmp / "said.txt"), None, 0)
    alone = sum(os.times()[2:4]) - before
    (tmp / f"{name}-alone").write_text(str(alone))
    if code not in (0, 3):
        raise SystemExit(f"{name}: the run that nobody disturbs ends with {code}: {(tmp / 'said.txt').read_text()}")
    (tmp / "said.txt").unlink()
    tally, expected = Tally(), results(reference)
    while tally.kills < kills:
        trial(lambda: start(out), out, expected, tally, rng, mean * alone, kills)
    told(name, tally, f"{alone:.1f} processor s when left alone")
    return tally


def starved(start: Callable[[Path], int], times: int, rng: np.random.Generator, tmp: Path) -> Tally:
    """Files that may not grow beyond a random size: one line, and the answer once there is space."""
    tally, expected = Tally(), results(tmp / "identify-whole")
    out, said = tmp / "starved", tmp / "said.txt"
    for _ in range(times):
        limit = int(10 ** rng.uniform(2.8, 6))  # what is said must fit
        code = ended(in_child(lambda: start(out), said, limit), None, 0)
        text = said.read_text()
        tally.kills += code == 2
        if code not in (0, 2, 3) or "Traceback" in text or (code == 2 and "too large" not in text):
            tally.notes.append(f"limit {limit}: exit code {code}: {text[-300:]}")
            tally.tracebacks += 1
        tally.half_files += bool(out.exists() and whole(out))
        said.unlink()
        trial(lambda: start(out), out, expected, tally, rng, 1e9, 0)
    told("full disk", tally)
    return tally


def damaged(start: Callable[[Path], int], times: int, rng: np.random.Generator, tmp: Path) -> Tally:
    """Checkpoints cut short or with a byte changed, then gone on from."""
    tally, expected = Tally(), results(tmp / "identify-whole")
    out, said, alone = tmp / "damaged", tmp / "said.txt", float((tmp / "identify-alone").read_text())
    for i in range(times):
        path = out / CHECKPOINT
        while not path.exists():
            shutil.rmtree(out, ignore_errors=True)
            ended(in_child(lambda: start(out), said), float(rng.uniform(0.3, 0.9)) * alone, signal.SIGKILL)
        whole_file = path.read_bytes()
        at = int(rng.integers(len(whole_file)))
        changed = whole_file[:at] + (b"" if i % 2 else bytes([whole_file[at] ^ 255]) + whole_file[at + 1 :])
        path.write_bytes(changed)
        code = ended(in_child(lambda: start(out), said), None, 0)
        if code == 2 and said.read_text().count("bayes-iwan:") == 1:  # refused: its start was hit
            tally.kills += 1
            tally.finished += 1
            tally.equal += 1
        else:
            tally.finished += 1
            tally.equal += results(out) == expected
        tally.tracebacks += "Traceback" in said.read_text()
        shutil.rmtree(out)
        said.unlink()
    told("damaged checkpoint", tally, f"{tally.kills} refused in one line")
    return tally


def crowded(start: Callable[[Path], int], times: int, tmp: Path) -> Tally:
    """Two runs in one folder: one finishes, the other is refused in one line."""
    tally, expected = Tally(), results(tmp / "identify-whole")
    out = tmp / "crowded"
    for _ in range(times):
        pids = [in_child(lambda: start(out), tmp / f"said{i}.txt") for i in range(2)]
        codes = sorted(ended(pid, None, 0) for pid in pids)
        tally.finished += 1
        tally.equal += codes == [0, 2] and results(out) == expected
        if codes != [0, 2]:
            tally.notes.append(f"exit codes {codes}")
        shutil.rmtree(out)
        for i in range(2):
            (tmp / f"said{i}.txt").unlink()
    told("two runs in one folder", tally)
    return tally


def jumping(start: Callable[[Path], int], tmp: Path) -> Tally:
    """A wall clock that jumps by a year at every look."""

    def run() -> int:
        clock = iter(range(10**9))
        time.time = lambda: (-1) ** next(clock) * 3.2e7 + 1e9  # type: ignore[assignment]
        return start(tmp / "jump")

    tally = Tally(finished=1)
    ended(in_child(run, tmp / "said.txt"), None, 0)
    tally.equal = int(results(tmp / "jump") == results(tmp / "identify-whole"))
    told("clock that jumps", tally)
    return tally


def unwritable(start: Callable[[Path], int], tmp: Path) -> Tally:
    """A folder that may not be written to, and one that is a file: one line, before any work."""
    tally = Tally()
    closed, file, said = tmp / "closed", tmp / "file", tmp / "said.txt"
    closed.mkdir(mode=0o555)
    file.write_text("a file")
    for out in (closed, closed / "new", file, file / "new"):

        def run(out: Path = out) -> int:
            if os.getuid() == 0:  # root may write everywhere
                os.chmod(tmp, 0o755)
                os.setuid(65534)
            return start(out)

        began = time.monotonic()
        code = ended(in_child(run, said), None, 0)
        lines = said.read_text().splitlines()
        tally.finished += 1
        good = code == 2 and len(lines) == 1 and lines[0].startswith("bayes-iwan:") and time.monotonic() - began < 2.0
        tally.equal += good
        if not good:
            tally.notes.append(f"{out}: exit code {code}: {lines}")
        said.unlink()
    told("unwritable folder", tally, "refused in one line")
    return tally


def told(name: str, t: Tally, more: str = "") -> None:
    print(
        f"{name:22s} {t.kills:4d} ended, {t.stops:3d} stopped, {t.finished:3d} finished, {t.equal:3d} equal, "
        f"{t.half_files} half files, {t.leftovers} leftovers, {t.tracebacks} tracebacks {more}",
        flush=True,
    )
    for note in t.notes[:5]:
        print("    " + note, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=300, help="in all, over the four commands")
    parser.add_argument("--others", type=int, default=10, help="full disks, damaged checkpoints, half as many crowds")
    parser.add_argument("--only", nargs="+", metavar="COMMAND", help="of the four, and then none of the others")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    tmp = Path(tempfile.mkdtemp(prefix="kills"))
    config = tmp / "config.toml"
    config.write_text(CONFIG)
    campaign = made_up(tmp / "campaign", 5.5, 7)
    for i in range(3):
        made_up(tmp / "many" / f"specimen{i}", 5.0 + 0.5 * i, i)
    cases = tmp / "cases"
    for i in range(3):
        made_up(cases / f"case_{i}", 5.0, i)
    write_json(cases / "commitments.json", {"rule": withheld.RULE, "cases": {f"case_{i}": "0" * 64 for i in range(3)}})
    lighten()

    def command(*words: object) -> int:
        return cli.main([str(w) for w in words])

    def identify(out: Path) -> int:
        more = ["--resume"] if (out / CHECKPOINT).exists() else []
        return command("identify", campaign, "--out", out, "--config", config, "--seed", "1", *more)

    def diagnose(out: Path) -> int:
        return command("diagnose", campaign, "--out", out, "--quick")

    def batch(out: Path) -> int:
        return command("batch", tmp / "many", "--out", out, "--config", config, "--seed", "1")

    def answer(out: Path) -> int:
        answering.answer(cases, stand_in.diagnosis, out=out, seed=1)
        return 0

    def answered(out: Path) -> int:  # as `bayes-iwan withheld answer`, with the stand-in for the diagnosis
        from bayes_iwan.files import owned
        from bayes_iwan.terminal import terminate_as_interrupt

        try:
            with terminate_as_interrupt(), owned(out):
                return answer(out)
        except KeyboardInterrupt:
            return 130

    ended(in_child(lambda: identify(tmp / "warm"), tmp / "said.txt"), None, 0)  # compiled code is cached now
    identify(tmp / "warm2")  # and loaded here, for every child to inherit
    (tmp / "said.txt").unlink()
    began = time.monotonic()
    tallies = {}
    commands = (
        ("identify", identify, 0.5, 0.35),
        ("diagnose", diagnose, 0.2, 0.75),
        ("batch", batch, 0.15, 0.3),
        ("withheld answer", answered, 0.15, 0.35),
    )
    for name, start, share, mean in commands:
        if args.only and name not in args.only:
            continue
        at = time.monotonic()
        tallies[name] = killed(name, start, round(share * args.kills), mean, rng, tmp)
        print(f"    {time.monotonic() - at:.0f} s", flush=True)
    if not args.only:
        tallies["full disk"] = starved(identify, args.others, rng, tmp)
        tallies["damaged checkpoint"] = damaged(identify, args.others, rng, tmp)
        tallies["two runs in one folder"] = crowded(identify, max(1, args.others // 2), tmp)
        tallies["unwritable folder"] = unwritable(identify, tmp)
        tallies["clock that jumps"] = jumping(identify, tmp)
    killed_ones = [tallies[name] for name, *_ in commands if name in tallies]
    kills, stops = sum(t.kills for t in killed_ones), sum(t.stops for t in killed_ones)
    good = all(t.equal == t.finished and not (t.half_files or t.leftovers or t.tracebacks) for t in tallies.values())
    lost = "nothing lost" if good else "SOMETHING WAS LOST"
    print(f"{kills} kills and {stops} stops in {time.monotonic() - began:.0f} s: {lost}")
    if args.out is not None:
        write_json(args.out, {k: vars(t) for k, t in tallies.items()} | {"version": bayes_iwan.__version__})
    shutil.rmtree(tmp)
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
