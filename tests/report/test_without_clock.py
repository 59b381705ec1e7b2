"""A campaign without a clock: no page, table or JSON of any command says a frequency or a speed."""

import re

import numpy as np
import pytest

import bayes_iwan as bi
from bayes_iwan.campaign.importing import Recipe, import_tests, write_tests
from bayes_iwan.effects.catalogue import BUILT_IN, UNLISTED
from bayes_iwan.inference.results.predictions import PredictionError

from .layout import visible

CLASSICAL = {"model": {"slip": "gamma1", "stiffness": "constant"}}
SHORT = {
    "search": {"members": 40, "evaluations": 400, "starts": 2, "second_search": False},
    "sampling": {"ensembles": 2, "budget_s": 0.5, "draws": 200},
}
#: what may be said: that nothing is known of it, that a law has none of it, and names
ALLOWED = (
    r"at (every|all) (frequenc(y|ies)|speed)|not with speed|"
    r"The records have no clock[^.]*\.|Without a clock,? [^.]*\.?|Every effect of the catalogue[^.]*\.|\w*_no_speed|"
    r"velocity m/s|\"(frequency_hz|speed_m_s|frequency_power|by_frequency|line_at_half_frequency)\": (null|\[\]|0\.0)|"
    r"\"(speed_dependent_normal_force|velocity)\"[^,]*,"
)
STORED = ("fits.json", "point.json", "run.json")  # the package's own, for going on
SAID = r"\d\s*k?Hz|\bHz\b|[Ff]requenc(y|ies)|[Ss]peeds?\b|\d m/s"


@pytest.fixture(scope="module")
def folder(tmp_path_factory, no_figure_files, no_phones, few_quick_walkers):
    """Three levels of an elastic slider with a stronger upper half, imported without a clock, and all that is made."""
    root = tmp_path_factory.mktemp("clockless")
    rng = np.random.default_rng(3)
    files = []
    for k, (a, rows) in enumerate(((0.3, 90), (0.6, 120), (1.0, 140))):
        u = a * np.sin(2 * np.pi * np.arange(8.3 * rows) / rows)
        force, f, last = np.empty(u.size), np.zeros(6), 0.0
        for i, x in enumerate(u):
            f = np.clip(f + 15.0 * (x - last), -np.linspace(1, 9, 6), np.linspace(1, 9, 6))
            last, force[i] = x, f.sum() + 10 * x
        force = force * (1 + 0.1 * np.tanh(3 * u)) + 0.02 * rng.standard_normal(u.size)
        lines = "".join(f"{x:.6f},{y:.5f}\n" for x, y in zip(u[rows:], force[rows:]))
        files.append(root / f"level{k}.csv")
        files[-1].write_text("Disp (mm),Force (N)\n" + lines)
    write_tests(import_tests(files, Recipe(sample_rate_hz="none")), root / "campaign")
    out = root / "out"
    campaign = bi.read_campaign(root / "campaign")
    posterior = bi.identify(campaign, out / "identify", quick=True, seed=1, config=CLASSICAL)
    posterior.export("c", out / "export")
    bi.diagnose(campaign, out / "diagnose", quick=True, seed=1, config=CLASSICAL)
    bi.compare(
        campaign, out / "compare", families=["uniform", "gamma1"], config=SHORT, by="tests", seed=1, progress=False
    )
    return out, posterior


def test_no_page_nor_table_says_a_frequency_or_a_speed(folder):
    out, _ = folder
    seen = 0
    for path in sorted(out.rglob("*")):
        if path.suffix not in (".html", ".json", ".csv", ".txt") or path.name in STORED:
            continue
        text = path.read_text(encoding="utf-8")
        text = visible(text) if path.suffix == ".html" else text
        text = re.sub(ALLOWED, " ", re.sub(r"\s+", " ", text))
        found = re.search(SAID, text)
        assert not found, f"{path.relative_to(out)}: {text[max(found.start() - 60, 0) : found.end() + 40]}"
        seen += 1
    assert seen >= 6


@pytest.mark.parametrize("effect", [e for e in (*BUILT_IN, *UNLISTED) if not e.needs_clock], ids=lambda e: e.__name__)
def test_no_words_of_an_effect_that_needs_no_clock_say_one(effect):
    texts = [effect.name, effect.physics, effect.remedy, effect.bench, effect.signature, effect.law, *effect.strength]
    said = re.sub(ALLOWED, " ", " ".join(texts))
    assert not re.search(SAID, said), said


def test_a_prediction_without_a_clock_has_no_frequency(folder):
    _, posterior = folder
    found = posterior.predict(None, 0.8, n=20)
    assert found.frequency_hz is None and "Hz" not in repr(found)
    with pytest.raises(PredictionError, match="no clock"):
        posterior.predict(10.0, 0.8)
    with pytest.raises(PredictionError, match="beyond 5 times") as refused:
        posterior.predict(None, 80.0)
    assert "Hz" not in str(refused.value)
