"""The loop viewer: a small script in the page that draws one chosen test, and the data it draws from."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.identification.predictive import Predictive, measured_cycles
from bayes_iwan.report.page import Page, Section, asset, template

DRAWS, CYCLES = 16, 8


def _rounded(x: Array, digits: int) -> list[float]:
    return [float(v) for v in np.round(x, digits)]


def viewer_data(p: Predictive) -> dict[str, Any]:
    """What the viewer needs of each test, rounded to what a screen can show."""
    tests = []
    for t, loop in enumerate(p.loops):
        places = max(0, int(3 - np.floor(np.log10(max(float(np.ptp(p.measured_N[t] - p.spring_N[t])), 1e-9)))))
        far = max(0, int(4 - np.floor(np.log10(max(loop.amplitude_mm, 1e-9)))))
        slope, zero = np.polyfit(p.displacement_mm[t], p.spring_N[t], 1)
        picked = np.linspace(0, len(p.force_N) - 1, min(DRAWS, len(p.force_N))).astype(int)
        low = np.quantile(p.force_N[:, t], [0.05, 0.25], axis=0)
        cycles = []
        for u, force in measured_cycles(loop, CYCLES):
            step = max(1, len(u) // 160)
            cycles.append([_rounded(u[::step], far), _rounded(force[::step] - p.zero_N[t], places)])
        tests.append(
            {
                "name": loop.record.units.said(test_name(loop)),
                "file": loop.file,
                "u": _rounded(p.displacement_mm[t], far),
                "slope": float(slope),
                "zero": float(zero),
                "measured": _rounded(p.measured_N[t], places),
                "model": [
                    _rounded(q, places)
                    for q in (low[0], low[1], p.median_N[t], *np.quantile(p.force_N[:, t], [0.75, 0.95], axis=0))
                ],
                "cycle": [_rounded(q, places) for q in np.quantile(p.cycle_N[:, t], [0.05, 0.25, 0.75, 0.95], axis=0)],
                "loop": [_rounded(q, places) for q in np.quantile(p.loop_N[:, t], [0.05, 0.25, 0.75, 0.95], axis=0)],
                "draws": [_rounded(x, places) for x in p.force_N[picked, t]],
                "cycles": cycles,
            }
        )
    units = p.loops[0].record.units
    return {"tests": tests, "displacement": units.displacement, "force": units.force}


def add_viewer(page: Page, section: Section, p: Predictive) -> None:
    """Put the viewer into a section of a page. One viewer a page."""
    section.html(template("viewer.html", tests=[page.units.said(test_name(x)) for x in p.loops]))
    page.script(asset("viewer.js"), "viewer-data", json.dumps(viewer_data(p), separators=(",", ":"), allow_nan=False))
