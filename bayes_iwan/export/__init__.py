"""The identified device where people simulate: one file a target."""

from bayes_iwan.export.device import ExportError
from bayes_iwan.export.run import TARGETS, export

__all__ = ["TARGETS", "ExportError", "export"]
