"""Runs cut short from outside: a signal, a full disk. More of them at random: analyses/kill_runs.py."""

import signal
import subprocess
import sys
import time

import pytest

from bayes_iwan.cli import main


@pytest.mark.usefixtures("no_pictures")
def test_a_signal_ends_a_run_and_resume_gives_the_same_answer(
    tmp_path, made_up_campaign, short_config, few_walkers, no_pictures
):
    words = ["identify", str(made_up_campaign), "--config", str(short_config), "--seed", "1", "--out"]
    cut, whole = tmp_path / "cut", tmp_path / "whole"
    code = f"import sys; from bayes_iwan.cli import main; {few_walkers}; {no_pictures}; sys.exit(main())"
    run = subprocess.Popen([sys.executable, "-c", code, *words, str(cut)], stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 120
    while not (cut / "chains.ckpt").exists() and time.monotonic() < end:
        time.sleep(0.02)
    run.send_signal(signal.SIGTERM)
    said = run.communicate()[1]
    assert run.returncode == 130 and "Traceback" not in said
    assert (cut / "chains.ckpt").exists()
    # the process that goes on knows of the first by its files alone, and so does this one
    assert main([*words, str(cut), "--resume"]) == 0
    assert main([*words, str(whole)]) == 0
    assert (cut / "summary.csv").read_bytes() == (whole / "summary.csv").read_bytes()


@pytest.mark.parametrize("more", [[], ["--quick"]], ids=["over the checkpoint", "over posterior.nc"])
def test_a_full_disk_is_one_line(tmp_path, made_up_campaign, short_config, few_quick_walkers, no_pictures, more):
    """HDF5 itself would end the process with a segmentation fault."""
    words = ["identify", str(made_up_campaign), "--out", str(tmp_path / "out"), "--config", str(short_config), *more]
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000)); "
        f"{few_quick_walkers}; {no_pictures}; from bayes_iwan.cli import main; sys.exit(main())"
    )
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert run.returncode == 2 and run.stderr.count("bayes-iwan:") == 1 and "Traceback" not in run.stderr
    assert "File too large" in run.stderr and run.stderr.count("\n") == 1
    assert not [p for p in (tmp_path / "out").rglob("*") if p.name == "posterior.nc" or p.name.startswith(".")]
