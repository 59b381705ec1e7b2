"""From a few figures to probabilities: does an effect contribute, which of its alternatives is it, has the unexplained
part a cause?

Two logistic laws and a power, fitted to cases of the virtual rig whose families of foreign causes were held out in turn
(`analyses/calibrate_diagnosis.py`). Every weight but the intercepts is of one sign by construction: more evidence and
more of the gap removed on held_out tests never make an effect less probable.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.assessment.indicators import Figures
from bayes_iwan.diagnosis.constants import LEAST_TESTS, LINEAR_NATS, SUREST, USUAL_GAP
from bayes_iwan.files import write_whole

CALIBRATION = Path(__file__).with_name("calibration.json")
#: figures behind the probability that an effect contributes, and that the unexplained part has a cause, in the order of
#: the weights
EFFECT_FIGURES = ("gain", "fitted", "held_out")
UNEXPLAINED_FIGURES = ("left", "subharmonic")


@dataclass(frozen=True)
class Calibration:
    """Weights of the logistic laws.

    effect : of EFFECT_FIGURES, effect_bias their intercept; unexplained, unexplained_bias : the same of
    UNEXPLAINED_FIGURES
    within : power of the score among effects for one place; apart : nats within which effects are tied
    usual : median and sd of ln share of a sound specimen's difference from the model
    """

    effect: tuple[float, ...]
    effect_bias: float
    unexplained: tuple[float, ...]
    unexplained_bias: float
    within: float
    apart: float
    usual: tuple[float, float]

    def contributes(self, f: Figures) -> float:
        """Probability that something of this effect's kind contributes to the gap."""
        return logistic(float(np.dot(self.effect, effect_figures(f))) + self.effect_bias)

    def among(self, f: Figures) -> dict[str, float]:
        """Probability of each effect for one place, given that something contributes there."""
        weight = {n: np.exp(self.within * min(v, 0.0)) for n, v in f.alternatives.items()}
        total = sum(weight.values())
        return {n: float(w / total) for n, w in weight.items()}

    def unknown_cause(self, figures: Array) -> float:
        """Probability that the unexplained part has a cause without a name; figures (2,) in the order of
        UNEXPLAINED_FIGURES."""
        return logistic(float(np.dot(self.unexplained, figures)) + self.unexplained_bias)

    def save(self, path: Path = CALIBRATION) -> None:
        """Write the constants as JSON."""
        write_whole(path, json.dumps(asdict(self), indent=1) + "\n")


def effect_figures(f: Figures) -> Array:
    """(3,) figures of an effect as they enter the logistic law, in the order of EFFECT_FIGURES.

    Its evidence counts by test, and the more the larger the gap is beside a sound specimen's: what absorbs finds the
    same to take in every test, but little more than such a specimen's difference from the model. Then the share of the
    gap that it removes as the last effect, on the fitted tests and on held-out tests (the former where none can be).
    """
    gain = np.log1p(max(f.gain, 0.0) / (LINEAR_NATS * max(f.tests, LEAST_TESTS))) * np.log1p(f.gap / USUAL_GAP)
    fitted = float(np.clip(f.fitted, -1.0, 1.0))
    return np.array([gain, fitted, f.held_out if f.has_held_out else fitted])


def unexplained_figures(left: float, subharmonic: float) -> Array:
    """(2,) figures of the unexplained part: the gap left beside all named causes as a share of the friction force, and
    the power of a line at half the test frequency over its background."""
    return np.array([np.log(max(left, 1e-5) / USUAL_GAP), np.log1p(max(subharmonic - 5.0, 0.0))])


def logistic(x: float) -> float:
    """1/(1 + e^−x), kept within 1 − SUREST … SUREST."""
    return float(np.clip(1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0))), 1.0 - SUREST, SUREST))


def from_json(stored: Mapping[str, object]) -> Calibration:
    """Constants from what :meth:`Calibration.save` wrote."""
    values = {k: tuple(v) if isinstance(v, list) else v for k, v in stored.items()}
    return Calibration(**values)  # type: ignore[arg-type]


@cache
def calibration() -> Calibration:
    """The constants shipped with the package."""
    return from_json(json.loads(CALIBRATION.read_text()))
