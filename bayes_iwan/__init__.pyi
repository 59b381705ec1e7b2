__version__: str
__all__ = [
    "Campaign", "CampaignError", "Check", "Comparison", "ConfigError", "DiagnoseSettings", "Diagnosis", "Effect",
    "IdentifySettings", "InputError", "Loop", "Model", "Motion", "NotConverged", "Parameter", "PlannedTest",
    "Posterior", "Problem", "Record", "Scales", "Simulator", "VirtualCampaign", "__version__", "batch", "check",
    "cite", "compare", "demo", "diagnose", "diagnose_loops", "identify", "identify_loops", "identify_problem", "load",
    "make_problem", "plot", "read_campaign", "settings_of", "simulate_campaign", "sine_motion", "write",
    "write_campaign",
]  # fmt: skip

from .api import Check, check, compare, diagnose, identify, load, write
from .campaign import Campaign, CampaignError, Loop, Record, read_campaign, write_campaign
from .comparison.families import Comparison
from .diagnosis.answer.result import Diagnosis
from .diagnosis.diagnosis import diagnose_loops
from .effects.base import Effect
from .errors import InputError
from .inference.identify import NotConverged, identify_loops, identify_problem
from .inference.results.posterior import Posterior
from .inference.setup.config import ConfigError, settings_of
from .inference.setup.problem import Problem, make_problem
from .inference.setup.settings import DiagnoseSettings, IdentifySettings
from .models import Model, Motion, Parameter, Scales, Simulator, sine_motion
from .report import plot
from .report.batch.batch_run import batch
from .report.cite import cite
from .virtual_rig.planning import VirtualCampaign, demo, simulate_campaign
from .virtual_rig.simulate import PlannedTest
