"""Diagnoses that tests have answered by, in a module: each answer comes from a process of its own."""

import ctypes
import json
import os
import subprocess
from pathlib import Path

from bayes_iwan.campaign import read_campaign


def write(out: Path, verdict: dict, probabilities: dict, **more) -> None:
    content = {"verdict": verdict, "probabilities": probabilities, **more}
    (out / "diagnosis.json").write_text(json.dumps(content))


def none(campaign: Path, out: Path, seed: int, quick: bool) -> None:
    """Reads its campaign and always finds nothing."""
    tests = len(read_campaign(campaign).tests)
    verdict = {"kind": "none", "causes": [], "unknown_cause": False}
    write(out, verdict, {"none": 0.9, "unknown_cause": 0.05}, seed=seed, quick=quick, tests=tests)


def fails_once(campaign: Path, out: Path, seed: int, quick: bool) -> None:
    """Does not converge the first time that it meets the second case."""
    mark = out / "tried"
    if campaign.name == "case_02" and not mark.exists():
        mark.touch()
        raise RuntimeError("no convergence")
    none(campaign, out, seed, quick)


def silent(campaign: Path, out: Path, seed: int, quick: bool) -> None:
    """Ends without an answer."""


def spies(campaign: Path, out: Path, seed: int, quick: bool) -> None:
    """Tries to get at the truth, at another case, and out of its folder, in every way at hand."""
    apart = campaign.parent.with_name(campaign.parent.name + "-truth")
    truth = apart / "truth.json"
    other = campaign.parent / "case_01" / "campaign.toml"

    def read() -> None:
        truth.read_text()

    def by_another_program() -> None:
        subprocess.run(["cat", str(truth)], check=True, capture_output=True)

    def by_libc() -> None:
        if ctypes.CDLL(None).open(os.fsencode(truth), os.O_RDONLY) < 0:
            raise PermissionError

    def by_a_link() -> None:
        os.link(truth, out / "linked")
        (out / "linked").read_text()

    def by_a_symbolic_link() -> None:
        (out / "pointer").symlink_to(truth)
        (out / "pointer").read_text()

    def by_listing() -> None:
        list(apart.iterdir())

    def another_case() -> None:
        other.read_text()

    def by_leaving_a_note() -> None:
        (campaign / "note.txt").write_text("seen")

    got = []
    for attempt in (
        read, by_another_program, by_libc, by_a_link, by_a_symbolic_link, by_listing, another_case, by_leaving_a_note,
    ):  # fmt: skip
        try:
            attempt()
            got.append(attempt.__name__)
        except (OSError, subprocess.CalledProcessError):
            pass
    verdict = {"kind": "none", "causes": [], "unknown_cause": False}
    write(out, verdict, {"none": 1.0, "unknown_cause": 0.0}, got=got, tests=len(read_campaign(campaign).tests))


def end_stop(campaign: Path, out: Path, seed: int, quick: bool) -> None:
    """Names an end stop in the second case, nothing elsewhere; its fits need code of its own."""
    if campaign.name != "case_02":
        none(campaign, out, seed, quick)
        return
    cause = {"name": "end_stop", "probability": 1.0, "share": 0.8, "share_interval": [0.6, 0.9], "share_held_out": 0.7}
    verdict = {"kind": "explained", "causes": [cause], "unknown_cause": False}
    write(out, verdict, {"none": 0.0, "unknown_cause": 0.0, "end_stop": 1.0})
    (out / "fits.json").write_text(json.dumps({"effects_file": "mine.py"}))
