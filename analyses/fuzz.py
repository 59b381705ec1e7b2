"""Damaged and hostile files against every reader: refused in one line, read, or worse?

    python analyses/fuzz.py --inputs 20000 [--seed N] [--only config ...] [--workers 2] [--out fuzz.json]

Small sound files are made once (fuzz_readers.py), then their bytes are damaged and they are read as the commands read
them. `--inputs` are shared out so that cheap readers get more. The readers run in forked processes whose memory may
grow by ten times the file and 300 MB; an input has 10 s of processor time, a minute outside Python. Beside the mutated
bytes two readers get files whose checksums were made anew, as somebody would who wants to do harm.

Counted: *refused* (an InputError, one line), *read*, and what must not be: *plain* (a bare
ValueError), *lines* (a message of several lines), *traceback* (anything else), *memory*, *hang*, *crash* (the process
died). Records that are changed as recorders, cables and people do are in fuzz_campaigns.py.
"""

from __future__ import annotations

import argparse
import gc
import mmap
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from bayes_iwan.errors import InputError
from bayes_iwan.files import write_json
from fuzz_recordings import Reader, made_up_record, recording_readers

WORDS = ("not run", "refused", "read", "plain", "lines", "traceback", "memory", "hang", "crash")
NOT_RUN, REFUSED, READ, PLAIN, LINES, TRACEBACK, MEMORY, HANG, CRASH = range(len(WORDS))
MEMORY_MB, TIMES_FILE = 300, 10
#: what is stuck outside Python sees no signal; a busy machine is no hang, so the clock on the wall has long patience
PROCESSOR_S, STUCK_S, WALL_S = 10, 60, 1200
#: inputs that one forked process reads
BATCH = 4000
#: seconds given to measuring a reader's speed, from which its share of the inputs follows
TRIED = 40


class Hang(BaseException):
    """A reader that took longer than PROCESSOR_S."""


@dataclass
class Tally:
    """Outcomes of a reader's inputs, the peak memory (MB) that reading added, and processor seconds."""

    counts: Counter[str] = field(default_factory=Counter)
    peak_MB: float = 0.0
    seconds: float = 0.0

    @property
    def bad(self) -> int:
        return sum(n for word, n in self.counts.items() if word not in ("refused", "read"))


def damaged(reader: Reader, raws: list[bytes], rng: np.random.Generator) -> tuple[int, bytes]:
    """Which of a reader's files is damaged, and its bytes then; of several the first in half of the inputs."""
    k = 0 if len(raws) == 1 or rng.random() < 0.5 else int(rng.integers(1, len(raws)))
    while (changed := reader.damage(raws[k], rng)) == raws[k]:
        pass
    return k, changed


def outcome(reader: Reader, where: str) -> int:
    """What the reader makes of the files as they stand."""
    signal.setitimer(signal.ITIMER_PROF, PROCESSOR_S)
    try:
        found = reader.read()
        return REFUSED if found is None else READ
    except ValueError as error:
        if isinstance(error, InputError) and "\n" not in str(error):
            return REFUSED
        print(f"--- {where}: {str(error)[:200]}", file=sys.stderr)
        traceback.print_exc(limit=-4)
        return LINES if isinstance(error, InputError) else PLAIN
    except Hang:
        return HANG
    except MemoryError:
        return MEMORY
    except BaseException as error:
        print(f"--- {where}: {type(error).__name__}", file=sys.stderr)
        traceback.print_exc(limit=-4)
        return TRACEBACK
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _stop(*_: object) -> None:
    raise Hang


def in_fork(
    reader: Reader,
    raws: list[bytes],
    name: str,
    codes: np.ndarray,
    peak: np.ndarray,
    first: int,
    seed: int,
    home: Path,
    log: int,
) -> int:
    """A process that reads inputs first to first + len(codes), those that have not been read; its process id.

    peak : where it puts the memory (MB) that they took beyond that of reading the sound file.
    """
    pid = os.fork()
    if pid:
        return pid
    try:
        os.chdir(home)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(log, 2)
        signal.signal(signal.SIGPROF, _stop)
        warnings.simplefilter("ignore")
        for path, raw in zip(reader.files, raws):  # a process before may have died over a damaged one
            path.write_bytes(raw)
        reader.read()
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with open("/proc/self/statm") as file:
            now = int(file.read().split()[0]) * resource.getpagesize()
        space = (MEMORY_MB << 20) + TIMES_FILE * max(map(len, raws))
        resource.setrlimit(resource.RLIMIT_AS, (now + space,) * 2)
        for i in np.flatnonzero(codes == NOT_RUN):
            k, changed = damaged(reader, raws, np.random.default_rng([seed, first + int(i)]))
            reader.files[k].write_bytes(changed)
            codes[i] = CRASH  # unless it comes back
            codes[i] = outcome(reader, f"{name}, seed {seed} {first + i}")
            reader.files[k].write_bytes(raws[k])
        sys.stderr.flush()
        peak[0] = max(peak[0], (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        os._exit(70)


def _processor_s(pid: int) -> float:
    """Processor seconds that a process has used; 0 where it has ended."""
    try:
        user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    except OSError:
        return 0.0
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


class Job:
    """A range of one reader's inputs, read by as many processes as die over it."""

    def __init__(
        self, reader: Reader, raws: list[bytes], name: str, first: int, n: int, seed: int, home: Path, log: int
    ) -> None:
        shared = mmap.mmap(-1, n + 8)
        self.peak = np.frombuffer(shared, dtype=float, count=1)
        self.codes = np.frombuffer(shared, dtype=np.uint8, offset=8)
        self.arguments = (reader, raws, name, self.codes, self.peak, first, seed, home, log)
        self.name, self.seconds = name, 0.0
        self._start()

    def _start(self) -> None:
        self.begun_at = self.done = self._done()
        self.at, self.used = time.monotonic(), 0.0
        self.pid = in_fork(*self.arguments)

    def _done(self) -> int:
        return int(np.count_nonzero(self.codes != NOT_RUN))

    def ended(self) -> bool:
        """Whether all its inputs are read; a process that died over one, or stands still, is begun anew behind it."""
        pid, status, used = os.wait4(self.pid, os.WNOHANG)
        if pid:
            self.seconds += used.ru_utime + used.ru_stime
            if status:
                self._told(f"its process ended with {os.waitstatus_to_exitcode(status)}")
            if not (self.codes == NOT_RUN).any():
                return True
            if self._done() == self.begun_at:
                raise RuntimeError(f"{self.name}: its process ends ({status}) before it reads anything; see the log")
            self._start()
        elif (done := self._done()) != self.done:
            self.done, self.at, self.used = done, time.monotonic(), _processor_s(self.pid)
        elif _processor_s(self.pid) - self.used > STUCK_S or time.monotonic() - self.at > WALL_S:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            self._told(f"no end after {STUCK_S} s of work, or {WALL_S} s of any")
            self.codes[self.codes == CRASH] = HANG
            self._start()
        return False

    def _told(self, what: str) -> None:
        """Name in the log the input that a process was at."""
        *_, first, seed, _, log = self.arguments
        at = [first + int(i) for i in np.flatnonzero(self.codes == CRASH)][-1:]
        os.write(log, f"--- {self.name}, seed {seed} {at}: {what}\n".encode())


def fuzz(
    inputs: int, seed: int, only: list[str] | None = None, workers: int = 1, log: Path | None = None
) -> dict[str, Tally]:
    """Outcomes by kind of file of so many inputs in all."""
    here = os.getcwd()
    scratch = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else None
    tmp = Path(tempfile.mkdtemp(prefix="fuzz", dir=scratch))
    homes = [tmp / f"home{i}" for i in range(workers)]
    words = os.open(log or tmp / "log.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    try:
        homes[0].mkdir()
        os.chdir(homes[0])
        if only and all(name.startswith(("import", "recipe")) for name in only):
            every = recording_readers(made_up_record())
        else:  # campaigns, results and answers, which take a minute to make
            from fuzz_readers import readers

            every = readers()
        kinds = {x for x in only or () if x in every}
        every = {name: r for name, r in every.items() if not kinds or name in kinds}
        raws = {name: [path.read_bytes() for path in r.files] for name, r in every.items()}
        for home in homes[1:]:
            shutil.copytree(homes[0], home)
        gc.freeze()
        tallies = {name: Tally() for name in every}
        shares = {name: TRIED for name in every}
        _run(every, raws, dict.fromkeys(every, 0), shares, tallies, seed, homes, words)
        rest = inputs - TRIED * len(every)
        if rest > 0:
            # shares between even in number and even in time: cheap readers get more, dear ones not nothing
            speed = {n: (TRIED / max(t.seconds, 1e-3)) ** 0.9 for n, t in tallies.items()}
            shares = {n: round(rest * s / sum(speed.values())) for n, s in speed.items()}
            _run(every, raws, dict.fromkeys(every, TRIED), shares, tallies, seed, homes, words)
        return tallies
    finally:
        os.close(words)
        os.chdir(here)
        shutil.rmtree(tmp)


def _run(
    every: dict[str, Reader],
    raws: dict[str, list[bytes]],
    first: dict[str, int],
    shares: dict[str, int],
    tallies: dict[str, Tally],
    seed: int,
    homes: list[Path],
    log: int,
) -> None:
    """Read each reader's share of inputs, one process in each home."""
    waiting = [(name, first[name] + at, min(BATCH, n - at)) for name, n in shares.items() for at in range(0, n, BATCH)]
    running: dict[Path, Job] = {}
    while waiting or running:
        for home in homes:
            if home in running and running[home].ended():
                job = running.pop(home)
                tally = tallies[job.name]
                for code, n in zip(*np.unique(job.codes, return_counts=True)):
                    tally.counts[WORDS[code]] += int(n)
                tally.peak_MB = max(tally.peak_MB, float(job.peak[0]))
                tally.seconds += job.seconds
            if home not in running and waiting:
                name, at, n = waiting.pop(0)
                running[home] = Job(every[name], raws[name], name, at, n, seed, home, log)
        time.sleep(0.01)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", metavar="KIND", help='kinds of file; "import" alone: every recording')
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--log", type=Path, default=Path("fuzz.log"), help="where tracebacks go (default: fuzz.log)")
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    args = parser.parse_args()
    began = time.monotonic()
    found = fuzz(args.inputs, args.seed, args.only, args.workers, args.log.resolve())
    print(f"{'file':22s} " + " ".join(f"{w:>9s}" for w in WORDS[1:]) + "   peak MB  ms each")
    for name, t in found.items():
        each = 1e3 * t.seconds / max(sum(t.counts.values()), 1)
        print(f"{name:22s} " + " ".join(f"{t.counts[w]:9d}" for w in WORDS[1:]) + f" {t.peak_MB:9.0f} {each:8.2f}")
    total = sum((t.counts for t in found.values()), Counter())
    print(f"{'all':22s} " + " ".join(f"{total[w]:9d}" for w in WORDS[1:]))
    print(f"{sum(total.values())} inputs in {time.monotonic() - began:.0f} s")
    if args.out is not None:
        write_json(args.out, {name: vars(t) for name, t in found.items()})
    sys.exit(1 if any(t.bad for t in found.values()) else 0)


if __name__ == "__main__":
    main()
