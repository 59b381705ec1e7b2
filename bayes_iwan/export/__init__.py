"""The identified device where people simulate: one file a target. Posteriors have `export` as a method from here on."""

from bayes_iwan.export.device import ExportError
from bayes_iwan.export.exporting import TARGETS, export
from bayes_iwan.inference.results.posterior import Posterior

__all__ = ["TARGETS", "ExportError", "export"]

setattr(Posterior, "export", export)  # noqa: B010  (a type checker would not know the attribute)
