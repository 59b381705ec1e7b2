"""The forward model: from motion to force."""

from .model import Model, ModelError
from .motion import Motion, record_motion, sine_motion
from .normal_force import Reference

__all__ = ["Model", "ModelError", "Motion", "Reference", "record_motion", "sine_motion"]
