"""The forward model: from motion to force."""

from bayes_iwan.physics.model import Model, ModelError
from bayes_iwan.physics.motion import Motion, record_motion, sine_motion
from bayes_iwan.physics.normal_force import Reference

__all__ = ["Model", "ModelError", "Motion", "Reference", "record_motion", "sine_motion"]
