"""The forward model: from motion to force."""

from bayes_iwan.physics.model import Model
from bayes_iwan.physics.motion import Motion, record_motion, sine_motion
from bayes_iwan.physics.parameter import Parameter
from bayes_iwan.physics.scales import Reference, Scales
from bayes_iwan.physics.simulator import ModelError, Simulator

__all__ = [
    "Model",
    "ModelError",
    "Motion",
    "Parameter",
    "Reference",
    "Scales",
    "Simulator",
    "record_motion",
    "sine_motion",
]
