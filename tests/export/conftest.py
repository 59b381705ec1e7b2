"""A problem with its draws, and what an export makes of them, without identifying anything."""

from __future__ import annotations

import shutil
from functools import cache

import numpy as np
import pytest

import bayes_iwan as bi
from bayes_iwan.export import exporting
from bayes_iwan.files import write_whole


@pytest.fixture(scope="session")
def compiler():
    """Skips what needs a C compiler where there is none."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: apt-get install gcc")


@pytest.fixture(scope="session")
def problem_of(tmp_path_factory):
    """A problem on four tests of the virtual rig by the parts of its model."""
    folder = tmp_path_factory.mktemp("campaign")
    plan = [bi.PlannedTest(f, a, cycles=6) for f in (8.0, 20.0) for a in (0.4, 1.0)]
    bi.simulate_campaign(plan, seed=1).write(folder)
    campaign = bi.read_campaign(folder)
    loops = campaign.loops()

    @cache
    def make(slip="gamma3", normal_force="hunt_crossley", stiffness="saturating", embedded=False):
        parts = {"slip": slip, "normal_force": normal_force, "stiffness": stiffness, "embedded": embedded}
        return bi.make_problem(loops, {"model": parts})

    return make


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """Files of a target from a problem and coordinates, in a folder of their own."""

    def make(problem, z, to="c", **options):
        source = exporting.Source(
            problem=problem, z=z, campaign=None, method="drawn from the prior", seed=0, unexplained=(0.0, 0.0)
        )
        files, _ = exporting.files_of(source, to, options.get("approximate", False), options.get("error", 1e-3))
        folder = tmp_path_factory.mktemp(to)
        for name, content in files.items():
            write_whole(folder / name, content)
        return folder

    return make


@pytest.fixture(scope="session")
def draws():
    """Coordinates some way into the prior."""

    def make(problem, count, seed=0, size=0.3):
        return size * problem.prior.draw(np.random.default_rng(seed), count)

    return make
