"""A process that cannot read some folder, by the kernel's own means: Landlock (Linux 5.13 and later), as any user.

What is granted is granted by place: the folders named, beneath which the closed one is omitted. Everything else on the
machine can neither be read nor listed nor changed by this process, nor by what it starts, by no path, link, library or
subprocess, and the process cannot take it back. What it does not guard against: a copy of the truths within a granted
folder (a hard link made beforehand is one), what a process had open before, the network, and whoever runs the parent.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Iterable
from pathlib import Path

_CREATE, _ADD, _RESTRICT = 444, 445, 446  # system calls: one number on every architecture
_NO_NEW_PRIVILEGES, _PARENT_DEATH_SIGNAL = 38, 1
#: file rights of the first version of Landlock: execute, write, read, list, then ten that change something
_READ = 1 | 4 | 8
_ALL = (1 << 13) - 1
_FILE = 1 | 2 | 4


class _Ruleset(ctypes.Structure):
    _fields_ = (("handled", ctypes.c_uint64),)


class _Beneath(ctypes.Structure):
    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (("allowed", ctypes.c_uint64), ("folder", ctypes.c_int32))


def available() -> bool:
    """Whether this machine can confine a process."""
    if not sys.platform.startswith("linux"):
        return False
    return ctypes.CDLL(None, use_errno=True).syscall(_CREATE, None, 0, 1) >= 1


def confine(read: Iterable[Path], write: Iterable[Path], closed: Iterable[Path]) -> None:
    """From now on this process reads beneath `read` and `write`, writes beneath `write`, and never enters `closed`.

    Raises OSError if the kernel refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    shut = [Path(os.path.realpath(p)) for p in closed]
    ruleset = _Ruleset(_ALL)
    rules = _done(libc.syscall(_CREATE, ctypes.byref(ruleset), ctypes.sizeof(ruleset), 0))
    for folders, rights in ((read, _READ), (write, _ALL)):
        for folder in folders:
            for place in _around(Path(os.path.realpath(folder)), shut):
                _grant(libc, rules, place, rights if place.is_dir() else rights & _FILE)
    _done(libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0))
    _done(libc.syscall(_RESTRICT, rules, 0))
    os.close(rules)


def end_with_parent() -> None:
    """Let the kernel kill this process when the one that started it dies, however it dies."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL, 0, 0, 0)


def _done(result: int) -> int:
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def _grant(libc: ctypes.CDLL, rules: int, place: Path, rights: int) -> None:
    try:
        folder = os.open(place, os.O_PATH | os.O_CLOEXEC)
    except OSError:  # gone meanwhile, or not ours: it stays closed
        return
    try:
        rule = _Beneath(rights, folder)
        _done(libc.syscall(_ADD, rules, 1, ctypes.byref(rule), 0))
    finally:
        os.close(folder)


def _around(place: Path, shut: list[Path]) -> list[Path]:
    """The place, or what of it is left when the closed folders are removed."""
    if any(place == s or s in place.parents for s in shut) or not place.exists():
        return []
    if not any(place in s.parents for s in shut):
        return [place]
    return [inner for child in place.iterdir() if not child.is_symlink() for inner in _around(child, shut)]


def program_folders() -> list[Path]:
    """What Python and its libraries need to read: the installation, the modules' folders, the system's."""
    system = [Path(p) for p in ("/usr", "/lib", "/lib64", "/bin", "/etc", "/proc", "/sys", "/dev", "/opt")]
    own = [Path(p) for p in {sys.prefix, sys.base_prefix, *sys.path} if p and Path(p).exists()]
    return [*system, *own]
