"""Identify the generalized Iwan model of a friction vibration isolator from measured loops, with what is known of it.

In a notebook (each command line's answer is an object here):

    import bayes_iwan as bi
    posterior = bi.identify("data/rope_spring", out="results", seed=1)
    posterior                                               # values, intervals and gap on one screen
    posterior.predict(frequency_hz=12.0, amplitude_mm=0.5)  # loops with bands
    bi.diagnose("data/rope_spring", quick=True)             # what the model misses, and why
    bi.plot.loops(posterior, width="column")                # figures; bi.demo() gives data to try all this on
"""

import difflib
import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayes_iwan.api import Check as Check
    from bayes_iwan.api import check as check
    from bayes_iwan.api import compare as compare
    from bayes_iwan.api import demo as demo
    from bayes_iwan.api import diagnose as diagnose
    from bayes_iwan.api import identify as identify
    from bayes_iwan.api import load as load
    from bayes_iwan.api import write as write
    from bayes_iwan.campaign import Campaign as Campaign
    from bayes_iwan.campaign import CampaignError as CampaignError
    from bayes_iwan.campaign import Loop as Loop
    from bayes_iwan.campaign import Record as Record
    from bayes_iwan.campaign import read_campaign as read_campaign
    from bayes_iwan.campaign import write_campaign as write_campaign
    from bayes_iwan.comparison.families import Comparison as Comparison
    from bayes_iwan.diagnosis.answer.result import Diagnosis as Diagnosis
    from bayes_iwan.diagnosis.diagnosis import diagnose_loops as diagnose_loops
    from bayes_iwan.effects.base import Effect as Effect
    from bayes_iwan.inference.identify import NotConverged as NotConverged
    from bayes_iwan.inference.identify import identify_loops as identify_loops
    from bayes_iwan.inference.identify import identify_problem as identify_problem
    from bayes_iwan.inference.results.posterior import Posterior as Posterior
    from bayes_iwan.inference.setup.config import ConfigError as ConfigError
    from bayes_iwan.inference.setup.config import settings_of as settings_of
    from bayes_iwan.inference.setup.problem import Problem as Problem
    from bayes_iwan.inference.setup.problem import make_problem as make_problem
    from bayes_iwan.inference.setup.settings import DiagnoseSettings as DiagnoseSettings
    from bayes_iwan.inference.setup.settings import IdentifySettings as IdentifySettings
    from bayes_iwan.models import Model as Model
    from bayes_iwan.models import Motion as Motion
    from bayes_iwan.models import Parameter as Parameter
    from bayes_iwan.models import Scales as Scales
    from bayes_iwan.models import Simulator as Simulator
    from bayes_iwan.models import sine_motion as sine_motion
    from bayes_iwan.report import plot as plot
    from bayes_iwan.report.batch.batch_run import batch as batch
    from bayes_iwan.report.cite import cite as cite
    from bayes_iwan.virtual_rig.planning import VirtualCampaign as VirtualCampaign
    from bayes_iwan.virtual_rig.planning import simulate_campaign as simulate_campaign
    from bayes_iwan.virtual_rig.simulate import PlannedTest as PlannedTest

__version__ = "0.1.0"

#: public names by module; each is imported when it is first asked for
_FROM = {
    "campaign": ("Campaign", "CampaignError", "Loop", "Record", "read_campaign", "write_campaign"),
    "comparison.families": ("Comparison",),
    "effects.base": ("Effect",),
    "diagnosis.answer.result": ("Diagnosis",),
    "diagnosis.diagnosis": ("diagnose_loops",),
    "inference.setup.config": ("ConfigError", "settings_of"),
    "inference.identify": ("NotConverged", "identify_loops", "identify_problem"),
    "inference.results.posterior": ("Posterior",),
    "inference.setup.problem": ("Problem", "make_problem"),
    "inference.setup.settings": ("DiagnoseSettings", "IdentifySettings"),
    "models": ("Model", "Motion", "Parameter", "Scales", "Simulator", "sine_motion"),
    "api": ("Check", "check", "compare", "demo", "diagnose", "identify", "load", "write"),
    "report.batch.batch_run": ("batch",),
    "report.cite": ("cite",),
    "virtual_rig.planning": ("VirtualCampaign", "simulate_campaign"),
    "virtual_rig.simulate": ("PlannedTest",),
}
_WHERE = {name: module for module, names in _FROM.items() for name in names}
__all__ = sorted([*_WHERE, "__version__", "plot"])


def __getattr__(name: str) -> Any:
    if name == "plot" or _WHERE.get(name, "").startswith(("inference.", "diagnosis.")):
        importlib.import_module("bayes_iwan.api")  # gives results their plots and exports
    if name == "plot":  # a module of functions of a result
        return importlib.import_module("bayes_iwan.report.plot")
    if name not in _WHERE:
        near = difflib.get_close_matches(name, __all__, 1)
        raise AttributeError(
            f"module {__name__!r} has no attribute {name!r}" + (f"; did you mean {near[0]!r}?" if near else "")
        )
    return getattr(importlib.import_module(f".{_WHERE[name]}", __name__), name)


def __dir__() -> list[str]:
    return __all__
