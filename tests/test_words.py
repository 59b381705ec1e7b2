"""Words that the project has retired: how often they still stand, which may only become less.

`tests/retired_words.json` has the counts that are still allowed, by part of the project and word. A word that stands
more often fails. After words have been replaced, write the lower counts, which this does and raises none:

    python tests/test_words.py
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ALLOWED = Path(__file__).with_name("retired_words.json")
#: what is searched: names, texts, comments
PARTS = {
    "package": ["bayes_iwan/**/*.py", "bayes_iwan/**/*.html", "bayes_iwan/**/*.json", "bayes_iwan/**/*viewer*.js"],
    "README": ["README.md", ".github/CONTRIBUTING.md"],
    "guide": ["analyses/guide/*.md", "analyses/guide/notebooks/*.ipynb"],
}
#: retired word: (pattern, what to say). Letters may not touch it, "_" may: identifiers count. Capitals count alike
RETIRED = {
    "rest": (r"(?<!at[ _])(?<!from )(?<!relative to )rest(?! positions?\b)", "unexplained, discrepancy"),
    "misfit": (r"misfits?", "gap"),
    "missed": (r"missed", "gap, residual"),
    "looks": (r"looks", "residual, or what it is about"),
    "bent": (r"bent|bends?|bending", "embedded model error"),
    "tilted": (r"tilt(s|ed)?", "embedded model error"),
    "warp": (r"warp(s|ed)?", "embedded model error"),
    "own form": (r"own[_ ]form", "embedded model error"),
    "company": (r"company", "tied effects"),
    "rival": (r"rivals?", "tied effects, other models"),
    "grip": (r"grips?", "normal force"),
    "station": (r"stations?", "stage"),
    "held numbers": (r"held[_ ]numbers", "nuisance parameters"),
    "valley": (r"valleys?", "local optimum"),
    "exploring": (r"explor(e|ed|es|ing)", "model search"),
    "worth": (r"worth", "score"),
    "left out": (r"left[_ ]out|leave[_ ]out", "held-out tests"),
    "unseen": (r"unseen", "held-out tests"),
    "judge": (r"judg(e|es|ed|ing)", "assess, held-out tests"),
    "widening": (r"widen(ing|ings|ed)", "none: an interval is a quantile of draws"),
    "plainest": (r"plainest", "most parsimonious"),
    "commits itself": (r"commits? itself", "most parsimonious"),
    "outdone": (r"outdone", "redundant"),
    "stood in": (r"stood[_ ]in|stands?[_ ]in for|stand_in", "redundant"),
    "told": (r"told", "reported, said, inferred"),
    "taken out": (r"taken[_ ]out", "data subtraction"),
    "hum": (r"hum|mains line", "mains interference"),
    "watcher": (r"watch(er|ers)", "progress listener"),
    "latitude": (r"latitude", "say it in ordinary words"),
    "borne out": (r"borne out", "confirmed"),
    "hang together": (r"hangs? together", "say it in ordinary words"),
    "door": (r"doors?", "say it in ordinary words"),
    "room": (r"rooms?", "folder"),
    "street": (r"streets?", "order of folders"),
    "mend": (r"mend(s|ed|ing)?", "fix"),
}
#: names in sealed truths and files written before, which stay readable
KEPT = re.compile(r"\bbend_share\b|\"bends\"|\broom_climate\b|\brest_s\b")
#: the one place that knows the names of before
FORMER = ROOT / "bayes_iwan" / "former_names.py"
PATTERNS = {word: re.compile(rf"(?<![a-z])(?:{pattern})(?![a-z])", re.I) for word, (pattern, _) in RETIRED.items()}


def files_of(part: str) -> list[Path]:
    return sorted({path for pattern in PARTS[part] for path in ROOT.glob(pattern)} - {FORMER})


def counts_of(part: str) -> dict[str, int]:
    """How often each word stands in a part of the project."""
    text = KEPT.sub("", "\n".join(path.read_text(encoding="utf-8") for path in files_of(part)))
    found = {word: len(pattern.findall(text)) for word, pattern in PATTERNS.items()}
    return {word: n for word, n in found.items() if n}


def places_of(part: str, word: str, most: int = 5) -> list[str]:
    out = []
    for path in files_of(part):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if PATTERNS[word].search(KEPT.sub("", line)):
                out.append(f"{path.relative_to(ROOT)}:{number}")
    return out[-most:]


@pytest.mark.parametrize("part", PARTS)
def test_no_retired_word_is_added(part):
    allowed = json.loads(ALLOWED.read_text(encoding="utf-8"))[part]
    more = {word: n for word, n in counts_of(part).items() if n > allowed.get(word, 0)}
    said = [
        f'"{word}" stands {n} times, {allowed.get(word, 0)} are allowed; say: {RETIRED[word][1]} '
        f"(last places: {', '.join(places_of(part, word))})"
        for word, n in more.items()
    ]
    assert not said, "\n".join(said)


def test_words_are_found_in_names_and_not_inside_others():
    assert PATTERNS["grip"].search("grip_rate") and PATTERNS["grip"].search("the grip's")
    assert not PATTERNS["rest"].search("restart the interest at rest")
    assert PATTERNS["rest"].search("_the_rest_") and PATTERNS["mend"].search("Mended")
    assert not PATTERNS["mend"].search("recommend amendment")


if __name__ == "__main__":
    before = json.loads(ALLOWED.read_text(encoding="utf-8")) if ALLOWED.exists() else {}
    after = {}
    for part in PARTS:
        now = counts_of(part)
        kept = before.get(part)
        after[part] = now if kept is None else {w: min(n, now.get(w, 0)) for w, n in kept.items() if now.get(w, 0)}
    ALLOWED.write_text(json.dumps(after, indent=1) + "\n", encoding="utf-8")
    print({part: sum(counts.values()) for part, counts in after.items()})
