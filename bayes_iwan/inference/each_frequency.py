"""Each frequency of a campaign identified alone, beside the joint posterior of all."""

from dataclasses import dataclass
from pathlib import Path

from bayes_iwan import executors
from bayes_iwan.campaign import Campaign, Loop
from bayes_iwan.errors import InputError
from bayes_iwan.executors import Workers
from bayes_iwan.inference.identify import identify_problem
from bayes_iwan.inference.results import run_files
from bayes_iwan.inference.results.held_out_frequencies import by_frequency
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.settings import IdentifySettings
from bayes_iwan.models import Scales, Simulator
from bayes_iwan.models.user_file import load_simulator


class FrequencyError(InputError):
    """A frequency alone that could not be identified; the message names it and says why."""


@dataclass(frozen=True)
class _Alone:
    """What the runs of all frequencies share; a simulator from a file is loaded where they run."""

    settings: IdentifySettings
    scales: Scales
    simulator: Simulator | None
    simulator_file: str
    campaign: Campaign | None
    seed: int
    out: Path
    resume: bool
    progress: bool


def identify_frequencies(
    joint: Posterior, out: Path, *, resume: bool = False, progress: bool = True, workers: Workers = None
) -> None:
    """Identify each frequency of a joint posterior's fitted tests alone, on its scales, into out/per_test.

    workers : that identify them side by side (:data:`bayes_iwan.executors.Workers`).
    Raises FrequencyError, and KeyboardInterrupt where Ctrl-C ended a run: what it had drawn is kept, `resume` goes on
    from it.
    """
    simulator = None if joint.simulator_file else joint.problem.model
    here = workers is None or workers == 1
    shared = _Alone(
        joint.settings, joint.problem.scales, simulator, joint.simulator_file, joint.campaign, joint.seed, out, resume,
        progress and here,
    )  # fmt: skip
    pieces = {name: (name, group) for name, group in by_frequency(joint.loops).items()}
    done = executors.run(
        pieces,
        _one_frequency,
        shared,
        workers=workers,
        what="per test",
        unit="frequency",
        progress=progress and not here,
    )
    for name, found in done.items():
        if isinstance(found, executors.Failure):
            raise FrequencyError(f"{name} alone: {found}")


def _one_frequency(shared: _Alone, piece: tuple[str, tuple[Loop, ...]]) -> None:
    name, group = piece
    folder = shared.out / "per_test" / name
    simulator = load_simulator(shared.simulator_file) if shared.simulator_file else shared.simulator
    part = identify_problem(
        make_problem(group, shared.settings, simulator, shared.scales),
        shared.seed,
        config=shared.settings,
        campaign=shared.campaign,
        loops=group,
        out=folder,
        resume=shared.resume,
        progress=shared.progress,
        simulator_file=shared.simulator_file,
    )
    run_files.write(part, folder)
    if part.interrupted:  # or the next frequency would start in the face of Ctrl-C
        raise KeyboardInterrupt
