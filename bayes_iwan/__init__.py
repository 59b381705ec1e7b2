"""Identify the generalized Iwan model of a friction vibration isolator from measured loops, with what is known of it.

import bayes_iwan as bi
run = bi.identify("data/rope_spring", out="results", seed=1)
for row in run.summary():
    print(row.name, row.unit, row.low_90, row.q50, row.high_90)
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayes_iwan.campaign import Campaign
    from bayes_iwan.inference.posterior import Posterior
    from bayes_iwan.physics import Simulator

__version__ = "0.1.0"

#: public names and the modules they live in; each is imported when it is first asked for
_WHERE = {
    "CampaignError": "campaign",
    "Campaign": "campaign",
    "Loop": "campaign",
    "Record": "campaign",
    "read_campaign": "campaign",
    "write_campaign": "campaign",
    "Model": "physics",
    "Motion": "physics",
    "Parameter": "physics",
    "Scales": "physics",
    "Simulator": "physics",
    "sine_motion": "physics",
    "Posterior": "inference.posterior",
    "Problem": "inference.problem",
    "make_problem": "inference.problem",
    "identify_problem": "inference.identify",
    "batch": "report.batch",
    "load": "inference.results",
    "read_config": "inference.config",
    "ConfigError": "inference.config",
}
__all__ = sorted([*_WHERE, "__version__", "identify"])


def identify(
    campaign: Campaign | str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    config: Mapping[str, Any] | str | os.PathLike[str] | None = None,
    seed: int = 0,
    per_test: bool = False,
    resume: bool = False,
    keep_chains: bool = False,
    progress: bool = True,
    simulator: Simulator | str | os.PathLike[str] | None = None,
) -> Posterior:
    """The joint posterior of a campaign's tests, with all its files, report.html among them, in `out` if given.

    keep_chains : keep the checkpoint, which holds every draw, of a run that has converged.
    See :func:`bayes_iwan.inference.identify.identify` for what is taken, written and raised.
    """
    from bayes_iwan.inference.config import ConfigError
    from bayes_iwan.inference.identify import identify as run
    from bayes_iwan.inference.identify import identify_frequencies

    if per_test and out is None:
        raise ConfigError("per_test writes files: name a folder for them (out)")
    if out is None:
        return run(campaign, None, config=config, seed=seed, progress=progress, simulator=simulator)
    from bayes_iwan.files import clear, owned
    from bayes_iwan.report import identification_report
    from bayes_iwan.sampling.checkpoint import NAME

    with owned(out) as folder:
        posterior = run(
            campaign, folder, config=config, seed=seed, resume=resume, progress=progress, simulator=simulator
        )
        if posterior.interrupted:
            return posterior
        identification_report(posterior, folder)  # stands should the runs of single frequencies be cut short
        if per_test:
            identify_frequencies(posterior, folder, resume=resume, progress=progress)
            identification_report(posterior, folder)
        if posterior.converged and not keep_chains:
            clear(folder, NAME, *(f"per_test/{p.parent.name}/{NAME}" for p in folder.glob(f"per_test/*/{NAME}")))
    return posterior


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_WHERE[name]}", __name__), name)


def __dir__() -> list[str]:
    return __all__
