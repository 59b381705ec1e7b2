"""Files whole at every moment, folders of one run at a time, and a terminal that names cannot steer."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import bayes_iwan
from bayes_iwan.files import FINISHED, OutputError, clear, owned, replacing, results_folder, write_whole
from bayes_iwan.terminal import plain, terminate_as_interrupt

ENV = {**os.environ, "PYTHONPATH": str(Path(bayes_iwan.__file__).parents[1])}

HOLD = """
import sys, time
from bayes_iwan.files import owned, replacing
with owned(sys.argv[1]) as folder:
    with replacing(folder / "figures" / "gap.svg") as part:
        part.write_text("half")
        print("in", flush=True)
        time.sleep(600)
"""


def test_a_reader_finds_the_old_file_or_the_new_one(tmp_path):
    path = write_whole(tmp_path / "a" / "x.json", "old")
    with pytest.raises(RuntimeError), replacing(path) as part:
        part.write_text("half of the n")
        assert path.read_text() == "old"
        raise RuntimeError
    assert [p.name for p in path.parent.iterdir()] == ["x.json"] and path.read_text() == "old"


def test_two_runs_in_one_folder_are_refused_and_a_killed_one_leaves_nothing(tmp_path):
    (tmp_path / "out" / "figures").mkdir(parents=True)
    out = tmp_path / "out"
    other = subprocess.Popen([sys.executable, "-c", HOLD, str(out)], env=ENV, stdout=subprocess.PIPE)
    assert other.stdout.readline() == b"in\n"
    with pytest.raises(OutputError, match=rf"out: another run \(process {other.pid}\) is working in it"):
        with owned(out):
            pass
    other.send_signal(signal.SIGKILL)
    other.wait()
    assert len(list(out.rglob(".part.*"))) == 1
    with owned(out):
        assert not list(out.rglob(".part.*")), "what the killed run left is swept up"
        with pytest.raises(OutputError, match="another run"), owned(out):
            pass
    assert not [p for p in out.rglob("*") if p.is_file()]


def test_many_at_the_same_time_never_share_a_folder(tmp_path):
    inside, most, failures = [], [], []

    def enter():
        for _ in range(60):
            try:
                with owned(tmp_path):
                    inside.append(1)
                    most.append(len(inside))
                    time.sleep(0.0005)
                    inside.pop()
            except OutputError:
                pass
            except Exception as error:
                failures.append(error)

    threads = [threading.Thread(target=enter) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures and set(most) == {1} and len(most) > 3


def test_what_is_no_folder_is_refused_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    for bad in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(OutputError, match="there is a file of this name"), owned(bad):
            pass
    with pytest.raises(OutputError, match=r"cannot be (made|written to)"), owned("/proc/results"):
        pass


def test_clear_removes_files_folders_and_links_but_nothing_behind_them(tmp_path):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "x").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "kept")
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "t.csv").write_text("")
    clear(tmp_path, "link", "tables", "absent")
    assert [p.name for p in tmp_path.iterdir()] == ["kept"] and (tmp_path / "kept" / "x").exists()


def test_names_cannot_steer_a_terminal():
    assert plain("a\x1b[31mred\x07\x9b2J\u202egnp.exe\x00é µ\n") == "a?[31mred??2J?gnp.exe?é µ\n"


def test_sigterm_is_ctrl_c():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), terminate_as_interrupt():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_an_interrupted_library_raises_is_an_interruption(number):
    with pytest.raises(KeyboardInterrupt), terminate_as_interrupt():
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), number)
            time.sleep(1)
        raise RuntimeError("half compiled")
    with pytest.raises(RuntimeError, match="by itself"), terminate_as_interrupt():
        raise RuntimeError("by itself")


def test_results_are_known_by_their_campaign_wherever_it_lies(tmp_path, made_up_campaign):
    """What is of other data, or of unknown data, is written over only where that is asked for."""
    out, moved, other = tmp_path / "out", tmp_path / "moved", tmp_path / "other"
    for copy in (moved, other):
        shutil.copytree(made_up_campaign, copy)
    toml = other / "campaign.toml"
    toml.write_text(toml.read_text().replace("made up", "another"))

    def write(source, **options):
        with results_folder(out, "identify", source, **options) as folder:
            (folder / FINISHED["identify"]).write_text(str(source))

    write(made_up_campaign)
    write(moved)
    for source in (other, None):
        with pytest.raises(OutputError, match=f"holds finished results of {moved}"):
            write(source)
    assert (out / FINISHED["identify"]).read_text() == str(moved)
    with pytest.raises(KeyboardInterrupt), results_folder(out, "identify", other, overwrite=True):
        raise KeyboardInterrupt  # nothing was written: they are still of the first
    write(moved)
    write(other, overwrite=True)
    (out / "run.json").unlink()
    with pytest.raises(OutputError, match="of another campaign"):
        write(other)


def test_a_folder_of_specimens_is_known_wherever_it_lies_and_takes_no_other_results(tmp_path, made_up_campaign):
    for name in ("a", "moved", "b"):
        shutil.copytree(made_up_campaign, tmp_path / name / "s1")
    toml = tmp_path / "b" / "s1" / "campaign.toml"
    toml.write_text(toml.read_text().replace("made up", "another"))
    for name in ("a", "a", "moved"):
        with results_folder(tmp_path / "out", "batch", tmp_path / name) as folder:
            (folder / FINISHED["batch"]).write_text(name)
    for command, name, words in (("batch", "b", "finished results of"), ("identify", "a/s1", "the results of batch")):
        with pytest.raises(OutputError, match=words), results_folder(tmp_path / "out", command, tmp_path / name):
            pass
