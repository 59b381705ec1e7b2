"""The identified device as a step in time: `isolator.c` beside this file, compiled on first use.

    device = Isolator()                     # draw=0 is the point estimate, 1 ... SETS - 1 are draws of the posterior
    force_N = device.step(0.001, u_m=2e-4, v_m_s=0.02)
    saved = device.save(); ...; device.restore(saved)

Displacements are the stretch of the device in m (rad for a torsional one), forces those that resist it in N (N m).
A C compiler is needed once (Debian: apt-get install gcc).
"""

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))
SETS = @SETS@
_library = None


def library():
    """The compiled step; built beside the source, or in a temporary folder where that cannot be written."""
    global _library
    if _library is not None:
        return _library
    source = os.path.join(HERE, "isolator.c")
    with open(source, "rb") as file:  # named after its source: a library that is loaded once cannot be replaced
        name = f"isolator_{hashlib.sha256(file.read()).hexdigest()[:16]}.so"
    built = os.path.join(HERE if os.access(HERE, os.W_OK) else tempfile.mkdtemp(), name)
    if not os.path.exists(built):
        compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
        if compiler is None:
            raise OSError("isolator.py: no C compiler found; install one (Debian: apt-get install gcc), or set CC")
        part = f"{built}.{os.getpid()}"
        subprocess.run([compiler, "-std=c99", "-O2", "-shared", "-fPIC", "-o", part, source, "-lm"], check=True)
        os.replace(part, built)
    _library = ctypes.CDLL(built)
    number, numbers = ctypes.c_double, ctypes.POINTER(ctypes.c_double)
    _library.isolator_state_start.argtypes = [ctypes.c_int, numbers, number]
    for name in ("isolator_state_step", "isolator_track_at"):
        getattr(_library, name).argtypes = [ctypes.c_int, number, numbers, number, number, number, number, numbers]
    _library.isolator_run.argtypes = [ctypes.c_int, number, numbers, ctypes.c_int, number] + [numbers] * 4
    return _library


class Isolator:
    """One device: a parameter set, the amplitude of Eq. (11) (None: the largest tested), and a state."""

    def __init__(self, draw=0, amplitude_m=None, time_s=0.0):
        if not 0 <= draw < SETS:
            raise ValueError(f"draw must be 0 (the point estimate) to {SETS - 1}, not {draw}")
        self.draw, self.amplitude_m = draw, float("nan") if amplitude_m is None else float(amplitude_m)
        self._c, self._force = library(), ctypes.c_double(0.0)
        self.size = self._c.isolator_state_size()
        self._track = (ctypes.c_double * self._c.isolator_track_size())()
        self.start(time_s)

    def start(self, time_s=0.0):
        """At rest at u = 0."""
        self._c.isolator_state_start(self.draw, self._track, time_s)
        ctypes.memmove(ctypes.byref(self._track, 8 * self.size), self._track, 8 * self.size)

    @property
    def accepted_s(self):
        """The time of the last accepted step."""
        return self._track[0]

    def step(self, h_s, u_m, v_m_s, a_m_s2=0.0):
        """The force in N after a step of h_s seconds that ends at u_m, v_m_s."""
        if not self._c.isolator_state_step(
            self.draw, self.amplitude_m, self._track, h_s, u_m, v_m_s, a_m_s2, ctypes.byref(self._force)
        ):
            raise ValueError(f"not a step: h = {h_s} s, u = {u_m} m, v = {v_m_s} m/s, a = {a_m_s2} m/s2")
        return self._force.value

    def at(self, time_s, u_m, v_m_s, a_m_s2=0.0):
        """The force in N at a time: a later one accepts what was asked last, the same or an earlier one replaces it."""
        if not self._c.isolator_track_at(
            self.draw, self.amplitude_m, self._track, time_s, u_m, v_m_s, a_m_s2, ctypes.byref(self._force)
        ):
            raise ValueError(f"t = {time_s} s lies before the last accepted step, {self.accepted_s} s, or is not finite")
        return self._force.value

    def run(self, h_s, u_m, v_m_s, a_m_s2=None):
        """The forces in N after each of many steps of h_s seconds, a list; the state goes on from where it is."""
        n = len(u_m)
        columns = [(ctypes.c_double * n)(*x) for x in (u_m, v_m_s, [0.0] * n if a_m_s2 is None else a_m_s2)]
        force = (ctypes.c_double * n)()
        done = self._c.isolator_run(self.draw, self.amplitude_m, self._track, n, h_s, *columns, force)
        if done < n:
            raise ValueError(f"not a step: number {done} of {n}, h = {h_s} s, u = {u_m[done]} m, v = {v_m_s[done]} m/s")
        return list(force)

    def save(self):
        """The whole state as bytes."""
        return bytes(self._track)

    def restore(self, saved):
        """Back to a saved state."""
        ctypes.memmove(self._track, saved, len(saved))
