"""`posterior.export`, `diagnosis.export`: put there by the folder that exports, as plots are by the one that draws."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from bayes_iwan.inference.results.posterior import Posterior


def register(kind: type) -> None:
    """Give results of this kind their method."""

    def export(self: Any, to: str, out: str | os.PathLike[str], **options: Any) -> Path:
        """The device as files that run elsewhere, with a model card; see :func:`bayes_iwan.export.export`."""
        from bayes_iwan.export.run import export as exported  # not before something is exported

        return exported(self, to, out, **options)

    setattr(kind, "export", export)  # noqa: B010  (a type checker would not know the attribute)


register(Posterior)
