"""The forward model: from motion to force."""

from bayes_iwan.physics.interface.motion import Motion, record_motion, sine_motion
from bayes_iwan.physics.interface.parameter import Parameter
from bayes_iwan.physics.interface.scales import Reference, Scales
from bayes_iwan.physics.interface.simulator import ModelError, Simulator
from bayes_iwan.physics.models.model import Model

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
