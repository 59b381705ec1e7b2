"""Runs cut short from outside: a signal, a full disk. More of them at random: analyses/kill_runs.py."""

import signal
import subprocess
import sys
import time

import pytest

SHORT = """
[model]
slip = "gamma1"
grip = "constant"
stiffness = "constant"
embedded = false
[likelihood]
kind = "gaussian"
[search]
members = 40
evaluations = 400
starts = 4
second_opinion = false
[sampling]
method = "ensembles"
ensembles = 2
walkers = 24
r_hat = 1.2
ess = 40
taus = 5
draws = 200
"""


def test_a_signal_ends_a_run_and_resume_gives_the_same_answer(tmp_path, made_up_campaign):
    config = tmp_path / "c.toml"
    config.write_text(SHORT)

    def start(out, *more):
        words = ["identify", str(made_up_campaign), "--out", str(out), "--config", str(config), "--seed", "1", *more]
        code = "import sys; from bayes_iwan.cli import main; sys.exit(main())"
        return subprocess.Popen([sys.executable, "-c", code, *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE)

    run = start(tmp_path / "cut", "--keep-chains")
    end = time.monotonic() + 120
    while not (tmp_path / "cut" / "chains.ckpt").exists() and time.monotonic() < end:
        time.sleep(0.02)
    run.send_signal(signal.SIGTERM)
    said = run.communicate()[1].decode()
    assert run.returncode == 130 and "Traceback" not in said
    for out, more in ((tmp_path / "cut", ["--resume"]), (tmp_path / "whole", [])):
        run = start(out, *more)
        said = run.communicate()[1].decode()
        assert run.returncode == 0, said
    assert (tmp_path / "cut" / "summary.csv").read_bytes() == (tmp_path / "whole" / "summary.csv").read_bytes()


@pytest.mark.parametrize("more", [[], ["--quick"]], ids=["over the checkpoint", "over posterior.nc"])
def test_a_full_disk_is_one_line(tmp_path, made_up_campaign, more):
    """HDF5 itself would end the process with a segmentation fault."""
    config = tmp_path / "c.toml"
    config.write_text(SHORT)
    words = ["identify", str(made_up_campaign), "--out", str(tmp_path / "out"), "--config", str(config), *more]
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000)); "
        "from bayes_iwan.cli import main; sys.exit(main())"
    )
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert run.returncode == 2 and run.stderr.count("bayes-iwan:") == 1 and "Traceback" not in run.stderr
    assert "File too large" in run.stderr and run.stderr.count("\n") == 1
    assert not [p for p in (tmp_path / "out").rglob("*") if p.name == "posterior.nc" or p.name.startswith(".")]
