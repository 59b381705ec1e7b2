"""Least squares with harmonics of a phase that need not be evenly sampled.

The real unknowns of a fit with H harmonics are ordered [c_0, Re c_1 ... Re c_H, Im c_1 ... Im c_H], m = 2 H + 1,
for the signal Re sum_h c_h exp(2 pi i h phase).

Sums over samples run harmonic by harmonic in plain numpy and matrices are inverted in small steps: threaded
BLAS calls of this size take up to a hundred times as long as they should when the machine is busy.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from bayes_iwan.arrays import Array

CHUNK = 8192  # samples at a time: their waves stay in cache
GROUPS = 256  # whose matrices are in memory at a time
STEP = 6  # 101 * 101 * 6 multiplications stay below OpenBLAS's threshold for threads


def white_noise(values: Array) -> float:
    """Standard deviation of white noise on (n,) samples of what is smooth, by their second differences."""
    return 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / np.sqrt(6)


def project(phase: Array, signals: Sequence[Array], starts: np.ndarray, n_harmonics: int) -> Array:
    """Right-hand sides of the normal equations, (n_groups, m, k).

    phase : (n,) in cycles; signals : k of (n,); starts : (n_groups,) first sample of each group.
    """
    sums = _sums(phase, signals, starts, n_harmonics)
    return np.concatenate([sums.real, -sums.imag[:, 1:]], axis=1)


def _sums(phase: Array, signals: Sequence[Array], starts: np.ndarray, n_harmonics: int) -> np.ndarray:
    """(n_groups, H + 1, k) sums of signal * exp(2 pi i h phase) over each group, a cacheful at a time."""
    out = np.zeros((starts.size, n_harmonics + 1, len(signals)), dtype=complex)
    for a in range(0, phase.size, CHUNK):
        b = min(a + CHUNK, phase.size)
        first, last = np.searchsorted(starts, [a, b - 1], side="right")
        groups = np.arange(first - 1, last)
        local = np.maximum(starts[groups] - a, 0)
        turn = np.exp(2j * np.pi * phase[a:b])
        wave = np.stack([x[a:b] for x in signals]).astype(complex)
        for h in range(n_harmonics + 1):
            out[groups, h] += np.add.reduceat(wave, local, axis=1).T
            wave *= turn
    return out


def grams(phase: Array, starts: np.ndarray, n_harmonics: int) -> Array:
    """(n_groups, m, m) normal matrices for groups of samples beginning at `starts`.

    A product of two harmonics is their sum and their difference, so 2 H + 1 sums a group are enough. A ridge of
    1e-9 of the diagonal is added: it matters only where gaps leave a combination undetermined.
    """
    return _matrices(_ones(phase, starts, n_harmonics), n_harmonics)


def inverse_grams(phase: Array, starts: np.ndarray, n_harmonics: int) -> Iterator[tuple[slice, Array]]:
    """The inverses of `grams`, so many groups at a time that a long record's many cycles do not fill the memory."""
    sums = _ones(phase, starts, n_harmonics)
    for a in range(0, len(sums), GROUPS):
        some = slice(a, a + GROUPS)
        yield some, inverse(_matrices(sums[some], n_harmonics))


def _ones(phase: Array, starts: np.ndarray, n_harmonics: int) -> np.ndarray:
    """(n_groups, 2 H + 1) sums of the harmonics alone."""
    return _sums(phase, [np.broadcast_to(1.0, phase.shape)], starts, 2 * n_harmonics)[..., 0]


def _matrices(sums: np.ndarray, n_harmonics: int) -> Array:
    h = np.arange(n_harmonics + 1)
    plus = sums[:, h[:, None] + h]
    minus = sums[:, np.abs(h[:, None] - h)]
    minus.imag[:, h[:, None] < h] *= -1
    m, k = 2 * n_harmonics + 1, n_harmonics + 1
    out = np.empty((len(sums), m, m))
    out[:, :k, :k] = (minus.real + plus.real) / 2
    out[:, k:, k:] = (minus.real - plus.real)[:, 1:, 1:] / 2
    out[:, k:, :k] = -(plus.imag + minus.imag)[:, 1:] / 2
    out[:, :k, k:] = np.swapaxes(out[:, k:, :k], 1, 2)
    diagonal = np.arange(m)
    out[:, diagonal, diagonal] += 1e-9 * sums[:, :1].real
    return out


def inverse(matrices: Array) -> Array:
    """(..., m, m) inverses of positive definite matrices, by Gauss-Jordan in blocks of STEP columns."""
    a = matrices.copy()
    for k in range(0, a.shape[-1], STEP):
        p = slice(k, k + STEP)
        pivot = np.linalg.inv(a[..., p, p])
        row = pivot @ a[..., p, :]
        column = a[..., :, p].copy()
        column[..., p, :] = 0
        a -= column @ row
        a[..., p, :] = row
        a[..., :, p] = -column @ pivot
        a[..., p, p] = pivot
    return a


def fit(phase: Array, signal: Array, n_harmonics: int) -> np.ndarray:
    """(H + 1,) complex harmonics of one (n,) signal by least squares."""
    one = np.zeros(1, dtype=int)
    right = project(phase, [signal], one, n_harmonics)[0]
    return to_complex((inverse(grams(phase, one, n_harmonics)[0]) @ right)[:, 0])


def to_complex(unknowns: Array) -> np.ndarray:
    """(..., H + 1) complex harmonics from (..., m) real unknowns."""
    h = (unknowns.shape[-1] - 1) // 2
    out = unknowns[..., : h + 1].astype(complex)
    out[..., 1:] += 1j * unknowns[..., h + 1 :]
    return out


def evaluate(harmonics: np.ndarray, phase: Array) -> Array:
    """(n,) Re sum_h c_h exp(2 pi i h phase), by Horner's rule."""
    out = np.empty(phase.shape)
    for a in range(0, phase.size, CHUNK):
        turn = np.exp(2j * np.pi * phase[a : a + CHUNK])
        wave = np.full(turn.shape, harmonics[-1], dtype=complex)
        for c in harmonics[-2::-1]:
            wave *= turn
            wave += c
        out[a : a + CHUNK] = wave.real
    return out


def on_grid(harmonics: np.ndarray, n_phase: int) -> Array:
    """The same on `n_phase` uniform phases, (n_phase,)."""
    finer = 1 + 2 * harmonics.size // n_phase  # so that every harmonic is below the transform's Nyquist
    spectrum = np.zeros(finer * n_phase // 2 + 1, dtype=complex)
    spectrum[: harmonics.size] = harmonics / 2
    spectrum[0] = harmonics[0].real
    return np.fft.irfft(spectrum, finer * n_phase)[::finer] * (finer * n_phase)
