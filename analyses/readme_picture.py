"""The README's picture: a diagnosis of a virtual rig with a damper beside the specimen.

python analyses/readme_picture.py
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import bayes_iwan as bi
from bayes_iwan.virtual_rig.planning import simulate_campaign
from bayes_iwan.virtual_rig.simulate import PlannedTest

PICTURE = Path(__file__).parent / "pictures" / "headline.png"


def main() -> None:
    tests = [PlannedTest(f, a) for f in (8.0, 13.0, 21.0) for a in (0.35, 0.8)]
    with tempfile.TemporaryDirectory() as folder:
        simulate_campaign(tests, fault="viscous_damping", size=0.1, seed=5).write(Path(folder) / "damped")
        answer = bi.diagnose(Path(folder) / "damped", Path(folder) / "out", seed=5, quick=True).to_dict()
        PICTURE.parent.mkdir(exist_ok=True)
        shutil.copy(Path(folder) / "out" / "figures" / "diagnosis_headline.png", PICTURE)
    print("\n".join(answer["sentences"]))
    print({p: v for e in answer["effects"][:1] for p, v in e["parameters"].items()})


if __name__ == "__main__":
    main()
