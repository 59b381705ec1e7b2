"""The model card: what was identified, where it was tested, what is in it and what is not."""

import hashlib
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

import numpy as np

from bayes_iwan import __version__
from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.export.c_code import substeps
from bayes_iwan.export.device import Device, Source, effects_text, fixed_amplitude
from bayes_iwan.models import Model
from bayes_iwan.models.kernels.sliders import MAX_PIECES
from bayes_iwan.models.motion import Y_FLOOR
from bayes_iwan.models.normal_force import ALPHA_FLOOR

OF_MODEL = "Rajaei, Ahmadian and Tavakoli, generalized Iwan model of a friction vibration isolator (the model); "
CITATION = f"bayes_iwan {__version__} (the identification)"


@dataclass(frozen=True, kw_only=True)
class Card:
    """The card as its JSON holds it; ranges are (least, largest), those of frequency and speed None without a clock.

    amplitude, discretisation, step : "" where there are none.
    """

    specimen: str
    description: str
    fingerprint: str
    date: str
    version: str
    seed: int
    model: str
    method: str
    draws: int
    units: dict[str, str]
    tests: int
    amplitude_mm: tuple[float, float]
    frequency_hz: tuple[float, float] | None
    speed_m_s: tuple[float, float] | None
    mean_displacement_mm: tuple[float, float]
    beyond: tuple[str, ...]
    amplitude: str
    effects: dict[str, str]
    omitted: dict[str, str]
    unexplained_N: float
    unexplained_share: float
    discretisation: str
    step: str
    cite: str
    target: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, object]:
        """What model_card.json holds."""
        return {"schema": 1} | asdict(self)

    def text(self) -> str:
        """What model_card.txt holds, and the head of each file."""

        def between(pair: tuple[float, float], unit: str) -> str:
            return f"{pair[0]:.4g} to {pair[1]:.4g} {unit}"

        displacement, force, velocity = (self.units[x] for x in ("displacement", "force", "velocity"))
        draws = f", 1 to {self.draws} are draws" if self.draws else ""
        rows = [
            ("Specimen", self.specimen + (f": {self.description}" if self.description else "")),
            ("Campaign", f"{self.tests} fitted tests, fingerprint {self.fingerprint}"),
            ("Made", f"{self.date} by bayes_iwan {self.version}, seed {self.seed}"),
            ("Model", f"{self.model}; {self.method}; set 0 is the point estimate{draws}"),
            ("Units", f"force in {force}, stretch in {self.units['stretch']} (velocity {velocity}); parameters in "
             f"{displacement}, {force}"),
            ("Tested", f"amplitude {between(self.amplitude_mm, displacement)}"),
            *([("", f"frequency {between(self.frequency_hz, 'Hz')}")] if self.frequency_hz else []),
            *([("", f"speed {between(self.speed_m_s, velocity)}")] if self.speed_m_s else []),
            ("", f"mean displacement {between(self.mean_displacement_mm, displacement)}, taken off: 0 is the tests' "
             "mean position"),
            *(("Beyond" if i == 0 else "", text) for i, text in enumerate(self.beyond)),
            ("A of Eq. (11)", self.amplitude),
            ("Effects in", effects_text(self.effects)),
            ("Effects out", effects_text(self.omitted)),
            ("Unexplained", f"{self.unexplained_N:.3g} {force} RMS, {100 * self.unexplained_share:.2g} % of friction"),
            ("Error", self.discretisation),
            ("Step", self.step),
            *(("This target" if i == 0 else "", text) for i, text in enumerate(self.target)),
            ("Cite", self.cite),
        ]  # fmt: skip
        return "\n".join(
            textwrap.fill(text, 110, initial_indent=f"{name:14s} ", subsequent_indent=" " * 15)
            for name, text in rows
            if text
        )


def fingerprint(loops: Sequence[Loop]) -> str:
    """16 hexadecimal digits of the fitted records."""
    digest = hashlib.sha256()
    for loop in loops:
        for column in (loop.record.time_s, loop.record.displacement_mm, loop.record.force_N):
            digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()[:16]


def card_of(device: Device, source: Source) -> Card:
    """The card of a device from the fitted tests of its source."""
    problem, campaign = source.problem, source.campaign
    loops, units, clock = problem.loops, problem.units, problem.loops[0].record.clock
    iwan = isinstance(problem.model, Model)

    def span(values: Array) -> tuple[float, float]:
        return float(np.min(values)), float(np.max(values))

    amplitude = span(problem.motion.amplitude_mm)
    length = units.velocity.removesuffix("/s")
    return Card(
        specimen="loops in memory" if campaign is None else campaign.name,
        description="" if campaign is None else campaign.description,
        fingerprint=fingerprint(loops),
        date=f"{datetime.now(UTC):%Y-%m-%d %H:%M UTC}",
        version=__version__,
        seed=source.seed,
        model=problem.model.name,
        method=source.method,
        draws=device.sets - 1,
        units={n: getattr(units, n) for n in ("displacement", "force", "velocity")} | {"stretch": length},
        tests=len(loops),
        amplitude_mm=amplitude,
        frequency_hz=span(problem.motion.frequency_hz) if clock else None,
        speed_m_s=span(problem.motion.speed_m_s.max(axis=-1)) if clock else None,
        mean_displacement_mm=span(np.array([x.offset_mm for x in loops])),
        beyond=(
            "larger strokes, other frequencies and speeds: the laws go on as they are, untested"
            if clock
            else "larger strokes: the laws go on as they are, untested. Without a clock, nothing that depends on "
            "speed was seen",
            *(
                f"slip forces end at {top:.4g} {units.force}: with larger strokes all elements slip"
                for top in device.top_N[:1]
                if np.isfinite(top)
            ),
        ),
        amplitude=_amplitude(device, source) if iwan else "",
        effects=device.named,
        omitted=device.omitted | {"force_zero": "belongs to the rig or its channels, not to the device"},
        unexplained_N=source.unexplained[0],
        unexplained_share=source.unexplained[1],
        discretisation=f"slip forces are continuous, not discretised; at most {MAX_PIECES} pieces of memory. From the "
        "forward model: below 0.1 % of the friction force (RMS) and of the energy at 20 steps a cycle and more "
        "(analyses/export_round_trip.py)",
        step=f"a twentieth of the shortest cycle in the motion, or less; each is divided by {substeps(device)} inside",
        cite=(OF_MODEL if iwan else "") + CITATION,
    )


def _amplitude(device: Device, source: Source) -> str:
    """What is said of A, which an arbitrary motion does not have."""
    problem = source.problem
    if device.constant_normal_force or "A" not in "".join(device.stages["alpha"]).replace("ALPHA", ""):
        return "not used: the normal force of this model does not depend on it"
    largest = float(device.parameters["amplitude_mm"][0])
    change = fixed_amplitude(problem, problem.parameter_values(source.z[:1]), largest)
    own = problem.motion.amplitude_mm
    return (
        f"any motion has none, so it is a parameter: {largest:.4g} {problem.units.displacement}, the largest tested. "
        f"For u > A the normal force stays at its value for A - u = {Y_FLOOR:g} A, and never falls below "
        f"{ALPHA_FLOOR:g} of that at rest. The tests were fitted with their own A; with this one instead the force "
        f"differs by {100 * change.max():.2g} % of friction's RMS in the worst of them ({own[np.argmax(change)]:.4g} "
        f"{problem.units.displacement}). For a steady cycle set A to its amplitude"
    )
