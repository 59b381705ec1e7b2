"""Mutations of files and of records: what accident and malice do to input. Everything random comes from one generator.

`damaged` changes the bytes of any file (TOML, JSON, CSV, HDF5 alike). `RECORD_FAULTS` change a record as recorders,
cables, drives and people do; `SEEN` names those that can be seen in the record.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayes_iwan.campaign import Record

Rng = np.random.Generator

#: pieces that readers stumble over
HOSTILE = (
    b"nan", b"inf", b"-inf", b"1e999", b"1e308", b"-1e300", b"5e-324", b"0", b"-0.0", b"true", b"null", b"[]", b"{}",
    b'""', b"9" * 400, b"9" * 5000, b"[" * 3000, b"{" * 3000, b"1979-05-27T07:32:00Z", b"\x00", b"\xff\xfe", b"\r\r\n",
    b"\x1b[2J", b"../../etc/passwd", b"<script>", b"${x}", b"$x^{$", b"0x7fffffffffffffff", b"1_000", b"1,5", b";",
    b"9**9**9**9", b"m^9^9^9", b"a" * 5000, b"'",
    b'"', b"\n\n\n",
)  # fmt: skip
NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


def _place(raw: bytes, rng: Rng) -> tuple[int, int]:
    a = int(rng.integers(0, max(len(raw), 1)))
    return a, min(len(raw), a + int(np.exp(rng.uniform(0, np.log(max(len(raw), 2))))))


def _flip(raw: bytes, rng: Rng) -> bytes:
    out = bytearray(raw)
    for k in rng.integers(0, max(len(out), 1), int(rng.integers(1, 9))):
        if out:
            out[k] ^= 1 << int(rng.integers(0, 8))
    return bytes(out)


def _cut(raw: bytes, rng: Rng) -> bytes:
    return raw[: _place(raw, rng)[0]]


def _delete(raw: bytes, rng: Rng) -> bytes:
    a, b = _place(raw, rng)
    return raw[:a] + raw[b:]


def _repeat(raw: bytes, rng: Rng) -> bytes:
    a, b = _place(raw, rng)
    return raw[:b] + raw[a:b] * int(rng.integers(1, 4)) + raw[b:]


def _zero(raw: bytes, rng: Rng) -> bytes:
    a, b = _place(raw, rng)
    return raw[:a] + bytes(b - a) + raw[b:]


def _insert(raw: bytes, rng: Rng) -> bytes:
    a = _place(raw, rng)[0]
    return raw[:a] + HOSTILE[rng.integers(len(HOSTILE))] + raw[a:]


def _number(raw: bytes, rng: Rng) -> bytes:
    """One number becomes another, or none: text formats alone have them."""
    found = list(NUMBER.finditer(raw[:200_000]))
    if not found:
        return _insert(raw, rng)
    m = found[rng.integers(len(found))]
    value = HOSTILE[rng.integers(len(HOSTILE))]
    if rng.random() < 0.5:
        try:
            value = f"{float(m.group()) * 10 ** rng.normal(0, 2) * rng.choice([-1, 1]):.6g}".encode()
        except (OverflowError, ValueError):
            pass
    return raw[: m.start()] + value + raw[m.end() :]


def _swap_lines(raw: bytes, rng: Rng) -> bytes:
    lines = raw.split(b"\n")
    i, j = rng.integers(0, len(lines), 2)
    lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def _letter(raw: bytes, rng: Rng) -> bytes:
    """A typing error in a word."""
    words = list(re.finditer(rb"[A-Za-z_]{3,}", raw[:200_000]))
    if not words:
        return _flip(raw, rng)
    m = words[rng.integers(len(words))]
    k = int(rng.integers(m.start(), m.end()))
    other = bytes([int(rng.integers(97, 123))])
    return raw[:k] + rng.choice([b"", other, raw[k : k + 1] + other]) + raw[k + 1 :]


def _lose_lines(raw: bytes, rng: Rng) -> bytes:
    lines = raw.split(b"\n")
    a = int(rng.integers(0, len(lines)))
    del lines[a : a + 1 + int(rng.exponential(len(lines) / 50))]
    return b"\n".join(lines)


def _retype(raw: bytes, rng: Rng) -> bytes:
    """A few numbers become others of the same kind."""
    for _ in range(int(rng.integers(1, 6))):
        found = list(NUMBER.finditer(raw[:200_000]))
        if not found:
            break
        m = found[rng.integers(len(found))]
        try:
            value = float(m.group()) * (1 + rng.normal(0, 0.5)) + rng.choice([0, 0, 1e-3, 1.0])
        except (OverflowError, ValueError):
            continue
        raw = raw[: m.start()] + f"{value:.6g}".encode() + raw[m.end() :]
    return raw


#: what breaks a file, and what leaves a text file readable mostly
ROUGH = (_flip, _cut, _delete, _repeat, _zero, _insert, _number, _letter)
GENTLE = (_lose_lines, _retype, _swap_lines)
BYTES: tuple[Callable[[bytes, Rng], bytes], ...] = (*ROUGH, *GENTLE)


def damaged(raw: bytes, rng: Rng) -> bytes:
    """The bytes of a file after one to three mutations, half of them gentle ones."""
    for _ in range(int(rng.integers(1, 4))):
        kinds = GENTLE if rng.random() < 0.5 else ROUGH
        raw = kinds[rng.integers(len(kinds))](raw, rng)
    return raw


# ---- records ----------------------------------------------------------------------------------------------------


def _rows(record: Record, keep: np.ndarray, renumbered: bool = True) -> Record:
    time = record.time_s[: int(keep.sum())] if renumbered else record.time_s[keep]
    return replace(record, time_s=time, displacement_mm=record.displacement_mm[keep], force_N=record.force_N[keep])


def _channels(record: Record, change: Callable[[np.ndarray], np.ndarray], rng: Rng, which: int | None = None) -> Record:
    """One channel, the other, or both, changed alike."""
    which = int(rng.integers(0, 3)) if which is None else which
    u, f = record.displacement_mm, record.force_N
    return replace(record, displacement_mm=change(u) if which != 1 else u, force_N=change(f) if which != 0 else f)


def _stretch(n: int, share: tuple[float, float], rng: Rng) -> slice:
    length = max(8, int(n * rng.uniform(*share)))
    start = int(rng.integers(n // 10, max(n - length - n // 10, n // 10 + 1)))
    return slice(start, start + length)


def _lose(record: Record, rows: int, rng: Rng) -> Record:
    n = record.time_s.size
    start = int(rng.integers(n // 5, 4 * n // 5))
    keep = np.ones(n, dtype=bool)
    keep[start : start + rows] = False
    return _rows(record, keep)


def _per_cycle(record: Record) -> float:
    return float(1 / (record.frequency_hz * np.median(np.diff(record.time_s))))


def phase_jump(record: Record, rng: Rng) -> Record:
    return _lose(record, max(1, int(_per_cycle(record) * rng.uniform(0.05, 0.95))), rng)


def lost_rows(record: Record, rng: Rng) -> Record:
    """Twenty rows lost, the time numbered on."""
    return _lose(record, 20, rng)


def hidden_gap(record: Record, rng: Rng) -> Record:
    return _lose(record, max(1, int(_per_cycle(record) * rng.uniform(1.1, 6.9))), rng)


def single_rows_lost(record: Record, rng: Rng) -> Record:
    keep = np.ones(record.time_s.size, dtype=bool)
    keep[rng.choice(keep.size, int(keep.size * rng.uniform(0.002, 0.02)) + 2, replace=False)] = False
    return _rows(record, keep)


def dropouts(record: Record, rng: Rng) -> Record:
    def change(y: np.ndarray) -> np.ndarray:
        y = y.copy()
        for _ in range(int(rng.integers(1, 6))):
            y[_stretch(y.size, (0.002, 0.02), rng)] = 0.0
        return y

    return _channels(record, change, rng)


def frozen(record: Record, rng: Rng) -> Record:
    def change(y: np.ndarray) -> np.ndarray:
        y, part = y.copy(), _stretch(y.size, (0.01, 0.1), rng)
        y[part] = y[part.start]
        return y

    return _channels(record, change, rng)


def dead_force(record: Record, rng: Rng) -> Record:
    def change(y: np.ndarray) -> np.ndarray:
        y = y.copy()
        y[_stretch(y.size, (0.08, 0.12), rng)] = 0.0
        return y

    return _channels(record, change, rng, which=1)


def modulated(record: Record, rng: Rng) -> Record:
    beats, depth, phase = rng.uniform(0.3, 8), rng.uniform(0.03, 0.4), rng.uniform(0, 2 * np.pi)
    x = np.linspace(0, 1, record.time_s.size)
    return _channels(record, lambda y: y * (1 + depth * np.sin(2 * np.pi * beats * x + phase)), rng)


def drifting_clock(record: Record, rng: Rng) -> Record:
    x = np.linspace(0, 1, record.time_s.size)
    change = rng.choice([-1, 1]) * rng.uniform(0.003, 0.08)
    return replace(record, time_s=record.time_s * (1 + change * (x - 0.5)))


def doubled_period(record: Record, rng: Rng) -> Record:
    turn = np.pi * record.frequency_hz * record.time_s + rng.uniform(0, 2 * np.pi)
    share = rng.uniform(0.03, 0.3)
    return _channels(record, lambda y: y + share * np.std(y) * np.sin(turn), rng)


def stepped(record: Record, rng: Rng) -> Record:
    at = int(record.time_s.size * rng.uniform(0.15, 0.85))
    share = rng.choice([-1, 1]) * rng.uniform(0.05, 1.0)
    return _channels(record, lambda y: y + share * np.std(y) * (np.arange(y.size) >= at), rng, int(rng.integers(0, 2)))


def both_reversed(record: Record, rng: Rng) -> Record:
    return _channels(record, lambda y: -y, rng, which=2)


def one_reversed(record: Record, rng: Rng) -> Record:
    return _channels(record, lambda y: -y, rng, int(rng.integers(0, 2)))


def offset_force(record: Record, rng: Rng) -> Record:
    by = rng.choice([-1, 1]) * 10 ** rng.uniform(1, 5)
    return _channels(record, lambda y: y + by * np.std(y), rng, which=1)


def leading_force(record: Record, rng: Rng) -> Record:
    """The force early by an eighth to three eighths of a cycle."""
    k = int(_per_cycle(record) * rng.uniform(0.125, 0.375))
    n = record.time_s.size - k
    return replace(
        record, time_s=record.time_s[:n], displacement_mm=record.displacement_mm[:n], force_N=record.force_N[k:]
    )


def lagging_force(record: Record, rng: Rng) -> Record:
    k = int(_per_cycle(record) * rng.uniform(0.125, 0.375))
    n = record.time_s.size - k
    return replace(
        record, time_s=record.time_s[:n], displacement_mm=record.displacement_mm[k:], force_N=record.force_N[:n]
    )


def spikes(record: Record, rng: Rng) -> Record:
    def change(y: np.ndarray) -> np.ndarray:
        y = y.copy()
        at = rng.choice(y.size, int(rng.integers(1, 20)), replace=False)
        y[at] += rng.choice([-1, 1], at.size) * np.ptp(y) * rng.uniform(2, 100)
        return y

    return _channels(record, change, rng)


def clipped(record: Record, rng: Rng) -> Record:
    share = rng.uniform(0.3, 0.9)
    noise = rng.choice([0.0, 0.003]) * rng.standard_normal(record.time_s.size)
    return _channels(
        record, lambda y: np.clip(y, -share * np.abs(y).max(), share * np.abs(y).max()) + noise * np.std(y), rng, 1
    )


def switched_gain(record: Record, rng: Rng) -> Record:
    at = int(record.time_s.size * rng.uniform(0.2, 0.8))
    factor = rng.choice([0.5, 0.8, 1.25, 2.0, 10.0])
    return _channels(record, lambda y: y * np.where(np.arange(y.size) < at, 1.0, factor), rng, int(rng.integers(0, 2)))


def force_scaled(record: Record, rng: Rng) -> Record:
    return _channels(record, lambda y: y * 10 ** rng.uniform(-3, 3), rng, which=1)


#: every fault can be seen in its record, or, for the last three, in the record beside the campaign's others
SEEN: tuple[Callable[[Record, Rng], Record], ...] = (
    phase_jump, lost_rows, hidden_gap, single_rows_lost, dropouts, frozen, dead_force, modulated, drifting_clock,
    doubled_period, stepped, one_reversed, offset_force, lagging_force, spikes, clipped, switched_gain,
    both_reversed, leading_force, force_scaled,
)  # fmt: skip


def one_fault(records: Sequence[Record], rng: Rng) -> tuple[str, int, Record]:
    """A fault at random in one of the records: its name, which record, and the record with it."""
    fault = SEEN[rng.integers(len(SEEN))]
    k = int(rng.integers(len(records)))
    return fault.__name__, k, fault(records[k], rng)
