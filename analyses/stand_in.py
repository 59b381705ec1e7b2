"""A diagnosis that takes a moment and always finds the same of the same: for kill_runs.py, where the protocol is on
trial. In a module of its own, since every answer comes from a process that imports it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_iwan.files import write_json, write_whole


def diagnosis(campaign: Path, out: Path, seed: int, quick: bool) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(20):
        np.linalg.svd(rng.standard_normal((120, 120)))
    p = float(rng.uniform())
    write_json(out / "fits.json", {"z": rng.standard_normal(2000).tolist()})
    write_whole(out / "diagnosis.html", "<html></html>\n")
    write_json(out / "diagnosis.json", {"verdict": {"cause": "none", "probability": p}, "probabilities": {"none": 1.0}})
