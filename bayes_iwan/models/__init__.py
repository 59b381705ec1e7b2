"""The forward model: from motion to force."""

from bayes_iwan.models.iwan import Model
from bayes_iwan.models.motion import Motion, record_motion, sine_motion
from bayes_iwan.models.parameter import Parameter
from bayes_iwan.models.scales import Reference, Scales
from bayes_iwan.models.simulator import ModelError, Simulator

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
