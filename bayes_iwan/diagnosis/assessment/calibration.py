"""From scores of sets, and from what is left unexplained, to probabilities.

A set's score counts by the power α/(α + n), n tests and α = COARSENED: no law is nature's, and what it misses it misses
in every test, so evidence says less than its nats (a coarsened posterior; Miller & Dunson, J. Am. Stat. Assoc. 114
(2019) 1113). The constants of the unexplained part are fitted by `analyses/calibrate_diagnosis.py`.
"""

import json
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from bayes_iwan.diagnosis.constants import COARSENED, SUREST, USUAL_GAP
from bayes_iwan.files import write_whole

CALIBRATION = Path(__file__).with_name("calibration.json")

Names = frozenset[str]
SetProbabilities = Mapping[Names, float]


@dataclass(frozen=True)
class Calibration:
    """Constants that were fitted.

    unexplained, unexplained_bias : slope and intercept of a logistic law of ln size of the unexplained part
    apart : nats within which effects are tied
    usual : median and sd of ln share of a sound specimen's difference from the model
    """

    unexplained: float
    unexplained_bias: float
    apart: float
    usual: tuple[float, float]

    def unknown_cause(self, left: float) -> float:
        """Probability that the unexplained part has a cause without a name; left : its size as a share of the friction
        force."""
        x = self.unexplained * ln_size(left) + self.unexplained_bias
        return float(np.clip(1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0))), 1.0 - SUREST, SUREST))

    def save(self, path: Path = CALIBRATION) -> None:
        """Write the constants as JSON."""
        write_whole(path, json.dumps(asdict(self), indent=1) + "\n")


def coarsening(tests: int) -> float:
    """The power by which scores of so many tests count."""
    return COARSENED / (COARSENED + tests)


def set_probabilities(scores: Mapping[Names, float], tests: int) -> dict[Names, float]:
    """Probability of every fitted set, from its score in nats and the number of fitted tests."""
    weight = coarsening(tests) * np.array(list(scores.values()))
    return dict(zip(scores, np.exp(weight - np.logaddexp.reduce(weight)).tolist()))


def any_of(sets: SetProbabilities, names: Collection[str]) -> float:
    """Probability that any of these effects contributes."""
    some = frozenset(names)
    return float(np.clip(sum(p for k, p in sets.items() if k & some), 0.0, SUREST))


def ln_size(left: float) -> float:
    """ln of an unexplained part, a share of the friction force, over a sound specimen's usual gap."""
    return float(np.log(max(left, 1e-5) / USUAL_GAP))


@cache
def calibration(path: Path = CALIBRATION) -> Calibration:
    """The constants shipped with the package, or others that :meth:`Calibration.save` wrote."""
    stored = json.loads(path.read_text())
    return Calibration(**stored | {"usual": tuple(stored["usual"])})
