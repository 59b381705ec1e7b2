"""The identified device as a Drake system with discrete state. Needs `pip install drake`.

    device = IsolatorSystem(step_s=1e-3)
    input "motion": stretch (m), velocity (m/s), acceleration (m/s2); output "force": the force that resists it (N)

The memory is the discrete state, so contexts can be cloned and simulations repeated. The force between two updates is
that at the time it is asked for: a step from the last update, without changing the state.
"""

import ctypes

from isolator import SETS, library
from pydrake.systems.framework import LeafSystem


class IsolatorSystem(LeafSystem):
    """draw: 0 the point estimate, 1 ... draws; amplitude_m: A of Eq. (11), None for the largest tested."""

    def __init__(self, step_s=1e-3, draw=0, amplitude_m=None):
        LeafSystem.__init__(self)
        if not 0 <= draw < SETS:
            raise ValueError(f"draw must be 0 (the point estimate) to {SETS - 1}, not {draw}")
        self._c, self._draw = library(), draw
        self._amplitude = float("nan") if amplitude_m is None else float(amplitude_m)
        self._state = (ctypes.c_double * self._c.isolator_state_size())()
        self._force = ctypes.c_double(0.0)
        self._c.isolator_state_start(draw, self._state, 0.0)
        self.DeclareVectorInputPort("motion", 3)
        self.DeclareDiscreteState(list(self._state))
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=step_s, offset_sec=0.0, update=self._update)
        self.DeclareVectorOutputPort("force", 1, self._output)

    def _step(self, context):
        """The state and the force at the context's time."""
        value = context.get_discrete_state_vector().value()
        self._state[:] = value.tolist()
        u, v, a = self.get_input_port().Eval(context)
        h = max(context.get_time() - self._state[0], 0.0)
        if not self._c.isolator_state_step(
            self._draw, self._amplitude, self._state, h, u, v, a, ctypes.byref(self._force)
        ):
            raise ValueError(f"not a step: h = {h} s, u = {u} m, v = {v} m/s, a = {a} m/s2")
        return self._force.value

    def _update(self, context, discrete_state):
        self._step(context)
        discrete_state.set_value(list(self._state))

    def _output(self, context, output):
        output.SetAtIndex(0, self._step(context))
