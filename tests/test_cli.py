"""The command line: what it prints, its exit codes, and bad input in one line."""

import argparse
import contextlib
import os
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import bayes_iwan as bi
from bayes_iwan import cli
from bayes_iwan.campaign import read_campaign
from bayes_iwan.cli.command import CAMPAIGN, OUT, OVERWRITE, SEED
from bayes_iwan.files import FINISHED, OutputError


def test_every_command_has_help(capsys):
    for command in cli.COMMANDS:
        with pytest.raises(SystemExit) as end:
            cli.main([*command.name.split(), "--help"])
        assert end.value.code == 0 and command.help.split()[0] in capsys.readouterr().out


def test_what_runs_a_user_s_code_says_so():
    said = {}
    for command in cli.COMMANDS:
        for argument in command.arguments:
            if {"--effects", "--simulator", "--allow-effects-file"} & set(argument.flags):
                said[command.name, argument.flags[0]] = argument.options["help"]
    assert {flag for _, flag in said} == {"--effects", "--simulator", "--allow-effects-file"} and len(said) >= 5
    for where, text in said.items():
        assert "code" in text and "run" in text, where


def test_no_command_and_unknown_command(capsys):
    for arguments in ([], ["identfy"]):
        with pytest.raises(SystemExit) as end:
            cli.main(arguments)
        assert end.value.code == 2 and "usage" in capsys.readouterr().err


def test_what_was_probably_meant_is_said(capsys):
    for arguments, meant in ((["identfy", "x"], "identify"), (["withheld", "scor"], "score")):
        with pytest.raises(SystemExit):
            cli.main(arguments)
        assert f"did you mean '{meant}'?" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        cli.main(["identify", "campaign", "--ovrwrite"])
    assert "did you mean '--overwrite'?" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        cli.main(["compare", "c", "--by", "looo"])
    assert "did you mean 'loo'?" in capsys.readouterr().err


def test_the_tab_key_offers_the_names_that_an_option_takes(tmp_path):
    from bayes_iwan.comparison.families import FAMILIES
    from bayes_iwan.diagnosis.diagnosis import BASES

    rows = "".join(f"{k / 100},{k % 9},{k % 7}\n" for k in range(50))
    (tmp_path / "run1.csv").write_text(f"Time [s],Weg [mm],Kraft [N]\n{rows}")
    (tmp_path / "specimens.csv").write_text("specimen,lot,oven\n")
    typed = argparse.Namespace(files=[str(tmp_path / "run1.csv")], folder=str(tmp_path))
    (commands,) = (a.choices for a in cli.parser()._actions if a.choices)
    offered = {
        (name, flag): list(action.completer(prefix="", parsed_args=typed))
        for name, one in commands.items()
        for action in one._actions
        for flag in action.option_strings
        if getattr(action, "completer", None)
    }
    assert offered["compare", "--families"] == list(FAMILIES) and offered["diagnose", "--base"] == list(BASES)
    assert offered["import", "--unit"] == offered["import", "--gain"] == [f"{x}=" for x in cli.campaigns.ROLES]
    assert "fmu" in offered["export", "--to"] and "cp1252" in offered["import", "--encoding"]
    assert {*offered["import", "--force"]} == {*offered["import", "--time"]} == {"Time", "Weg", "Kraft"}
    assert offered["import", "--held-out"] == ["run1"] and {*offered["batch", "--group"]} == {"lot", "oven"}
    assert offered["import", "--reverse"] == ["displacement", "acceleration", "force"]


def test_an_export_is_named_after_its_run_and_target(tmp_path, monkeypatch):
    named = []
    export = next(x for x in cli.COMMANDS if x.name == "export")
    monkeypatch.setattr(cli, "COMMANDS", [replace(export, run=lambda args: named.append(args.out))])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "moved").mkdir()
    assert cli.main(["export", "results", "--to", "c", "--campaign", "moved"]) == 0
    assert cli.main(["export", "results", "--to", "json", "--out", "here"]) == 0
    assert named == ["results-c", "here"]


def test_examples_in_help_are_commands():
    """Each example parses as the command whose help it stands in."""
    for command in cli.COMMANDS:
        for example in command.examples:
            words = shlex.split(example)
            assert words[0] == "bayes-iwan"
            assert cli.parser().parse_args(words[1:]).command == command.name


def test_python_m_bayes_iwan():
    done = subprocess.run([sys.executable, "-m", "bayes_iwan", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("bayes-iwan ")


def test_results_where_a_campaign_is_wanted(tmp_path, capsys):
    (tmp_path / "run.json").write_text("{}")
    (tmp_path / "summary.csv").write_text("name\n")
    assert cli.main(["diagnose", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "the results of a run, no campaign" in said and "import" not in said


@pytest.mark.parametrize("ending", ["csv", "out", "F00", "ASC"])
def test_recordings_where_a_campaign_is_wanted(tmp_path, capsys, ending):
    (tmp_path / f"run 1.{ending}").write_text("t,x,F\n")
    for path in (tmp_path / f"run 1.{ending}", tmp_path):
        assert cli.main(["check", str(path)]) == 2
        err = capsys.readouterr().err
        assert err.endswith(f'bayes-iwan import "{path}"\n') and err.count("\n") == 1


@pytest.mark.parametrize("command", ["identify", "diagnose", "compare", "batch"])
def test_finished_results_of_other_data_stand(tmp_path, made_up_campaign, command, capsys):
    """The command line and Python refuse alike, before any work."""
    out = tmp_path / "out"
    out.mkdir()
    (out / FINISHED[command]).write_text("an hour's work")
    source = made_up_campaign.parent if command == "batch" else made_up_campaign
    with pytest.raises(OutputError, match="holds finished results"):
        getattr(bi, command)(source, out)
    assert cli.main([command, str(source), "--out", str(out)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "--overwrite" in err
    assert (out / FINISHED[command]).read_text() == "an hour's work"


def test_results_are_named_after_the_campaign_and_have_a_log(tmp_path, made_up_campaign, monkeypatch):
    def run(args):
        (tmp_path / args.out).mkdir()
        cli.say("done")

    monkeypatch.setattr(cli, "COMMANDS", [cli.Command("identify", "x", (CAMPAIGN, OUT, OVERWRITE), run)])
    monkeypatch.chdir(tmp_path)
    assert cli.main(["identify", str(made_up_campaign)]) == 0
    log = (tmp_path / f"{made_up_campaign.name}-identify" / "log.txt").read_text()
    assert "$ bayes-iwan identify" in log and "INFO done" in log


def test_bad_input_is_one_line_and_exit_code_2(tmp_path, capsys):
    config = tmp_path / "c.toml"
    config.write_text("[sampling]\nwalkrs = 3\n")
    for arguments, says in (
        (["check", str(tmp_path / "nowhere")], "campaign.toml: not found"),
        (["identify", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")], "campaign.toml: not found"),
        (["identify", str(tmp_path), "--out", str(tmp_path / "out"), "--config", str(config)], "walkrs"),
    ):
        assert cli.main(arguments) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and says in err and "Traceback" not in err
    assert not (tmp_path / "out").exists()


def test_ctrl_c_is_quiet(monkeypatch, capsys):
    def interrupted(args):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "COMMANDS", [cli.Command("wait", "wait for ever", (), interrupted)])
    assert cli.main(["wait"]) == 130
    assert capsys.readouterr().err.strip().startswith("bayes-iwan: interrupted")


def test_groups_of_commands(monkeypatch, capsys):
    """A command of two words is entered below its first."""
    done = []
    entry = cli.Command("withheld make", "make it", (SEED,), lambda args: done.append(args.seed))
    monkeypatch.setattr(cli, "COMMANDS", [entry])
    assert cli.main(["withheld", "make", "--seed", "4"]) == 0 and done == [4]


def test_check_says_what_was_read(tmp_path, capsys, made_up_campaign):
    assert cli.main(["check", str(made_up_campaign)]) == 0
    out = capsys.readouterr().out
    assert "made up" in out and "f10_a1.csv" in out
    row = next(line.split() for line in out.splitlines() if line.startswith("f10_a1.csv"))
    assert float(row[1]) == pytest.approx(10.0, rel=1e-3) and float(row[2]) == pytest.approx(1.0, rel=1e-2)


@pytest.mark.usefixtures("few_quick_walkers", "no_pictures")
def test_identify_writes_and_reports(tmp_path, capsys, made_up_campaign, short_config):
    out = tmp_path / "out"
    arguments = ["identify", str(made_up_campaign), "--out", str(out), "--config", str(short_config), "--seed", "1"]
    assert cli.main([*arguments, "--keep-chains"]) == 0
    said = capsys.readouterr().out
    assert "kp_N_mm" in said and "converged" in said and str(out) in said
    for name in ("summary.csv", "posterior.nc", "point.json", "report.html", "chains.ckpt"):
        assert (out / name).stat().st_size > 100, name
    for written in (x for x in out.rglob("*") if x.is_file()):  # what goes to a customer says nothing of the machine
        assert str(tmp_path.parent).encode() not in written.read_bytes(), written
    assert cli.main(arguments) == 2 and "resume" in capsys.readouterr().err
    summary = (out / "summary.csv").read_bytes()
    assert cli.main([*arguments, "--resume"]) == 0
    assert (out / "summary.csv").read_bytes() == summary
    assert not (out / "chains.ckpt").exists(), "converged: the draws that are kept are in posterior.nc"
    assert not [p for p in out.rglob(".*")]


def test_what_no_file_can_hold_is_refused_before_the_work(tmp_path, made_up_campaign, capsys):
    words = ["identify", str(made_up_campaign), "--out", str(tmp_path / "out")]
    for bad in (str(2**200), "-1"):
        with pytest.raises(SystemExit):
            cli.main([*words, "--seed", bad])
        assert "is no seed" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert cli.main([*words[:3], str(tmp_path / "file")]) == 2
    assert "name a folder" in capsys.readouterr().err


@pytest.mark.usefixtures("few_quick_walkers", "no_pictures")
def test_the_report_holds_the_frequencies_alone(tmp_path, made_up_campaign, short_config, monkeypatch):
    """After --per-test the page and its table hold the runs of single frequencies, unless these are of another model;
    cut short, the page of the joint run stands."""
    import bayes_iwan.inference.each_frequency as inside
    from bayes_iwan.campaign import write_campaign
    from bayes_iwan.comparison.frequencies import compare_frequencies
    from bayes_iwan.inference.results.run_files import load
    from bayes_iwan.inference.setup.problem import make_problem
    from bayes_iwan.inference.setup.settings import ParameterChange

    slow = [x.record for x in read_campaign(made_up_campaign).loops()]
    # the same loops at twice the speed; a rate-independent specimen, and noise of their own: no copies
    noise = np.random.default_rng(9)
    fast = [replace(x, file=x.file.replace("f10", "f20"), frequency_hz=20.0, time_s=0.5 * x.time_s) for x in slow]
    fast = [replace(x, force_N=x.force_N + 0.002 * noise.standard_normal(x.force_N.size)) for x in fast]
    write_campaign(tmp_path / "campaign", name="made up", description="", tests=[*slow, *fast], compress=False)
    names, one, run = {"f10Hz", "f20Hz"}, "f10Hz", inside.identify_problem
    out = tmp_path / "out"
    arguments = ["identify", str(tmp_path / "campaign"), "--out", str(out), "--seed", "1"]
    arguments += ["--config", str(short_config)]

    def alone() -> set[str]:
        lines = (out / "tables" / "per_frequency.csv").read_text().splitlines()[1:]
        assert ("its frequency alone" in (out / "report.html").read_text()) == any(x[:3] != "all" for x in lines)
        return {line.split(",")[0] for line in lines} - {"all"}

    def cut_short(problem, *args, **options):
        if out / "per_test" / one == options["out"]:
            raise KeyboardInterrupt
        return run(problem, *args, **options)

    monkeypatch.setattr(inside, "identify_problem", cut_short)
    assert cli.main([*arguments, "--per-test"]) == 130 and alone() == set()
    monkeypatch.undo()
    assert cli.main([*arguments, "--per-test", "--resume"]) == 0 and alone() == names

    joint = load(out)
    assert set(compare_frequencies(joint, out, replicates=50).alone) == names
    config = replace(joint.settings, parameters={"kp_N_mm": ParameterChange(lower=1.0)})
    other = replace(joint, settings=config, problem=make_problem(joint.loops, config))
    assert compare_frequencies(other, out, replicates=50).alone == {}  # left from another prior: not this one's


def test_importing_the_package_and_help_are_quick_and_light():
    """Neither loads numba or ArviZ: they come with the command that needs them."""
    code = (
        "import sys, bayes_iwan, bayes_iwan.cli as c; c.parser(); "
        "print([m for m in ('numba', 'arviz') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals of Unix")
def test_ctrl_c_in_a_terminal_says_how_to_go_on(tmp_path, made_up_campaign):
    import fcntl
    import pty
    import termios

    def with_terminal() -> None:  # Ctrl-C reaches the processes of a session whose terminal this is
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a shell's background job inherits that it is ignored

    master, terminal = pty.openpty()
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "bayes_iwan", "identify", str(made_up_campaign), "--out", str(out)],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        preexec_fn=with_terminal,
    )
    os.close(terminal)
    while not (out / ".lock").exists() and process.poll() is None:
        time.sleep(0.05)
    time.sleep(0.5)
    for _ in range(2):  # twice in some fifty runs under load the first was lost; whoever presses it does so again
        os.write(master, b"\x03")
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(30)
            break
    said = b""
    with contextlib.suppress(OSError):  # the end of a terminal nobody holds any more
        while piece := os.read(master, 4096):
            said += piece
    os.close(master)
    assert process.wait(60) == 130
    text = said.decode()
    assert "bayes-iwan: interrupted" in text and 'bayes-iwan identify "' in text and "Traceback" not in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["import", "C:\\data\\run1.csv"], "a path of Windows"),
        (["import", "recordings\\run1.csv"], 'write "recordings/run1.csv"'),
        (["import", "run1.csv", "--out", "C:\\out"], "a path of Windows"),
        (["check", "C:/campaign"], "a path of Windows"),
        (["import", "run1.csv", "^", "--out", "x"], "write the command on one line"),
        (["import", 'run1.csv"'], "a backslash before a closing quote"),
        (["identify", "run*.csv"], 'Make one: bayes-iwan import "run*.csv"'),
    ],
)
@pytest.mark.skipif(os.name == "nt", reason="these are paths of Windows")
def test_what_a_windows_user_types_is_one_clear_line(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run1.csv").write_text("t,x\n")
    assert cli.main(words) == 2
    message = capsys.readouterr().err.strip()
    assert said in message and "\n" not in message and sorted(os.listdir()) == ["run1.csv"]


@pytest.mark.skipif(os.name == "nt", reason="of bash")
def test_a_proposed_command_is_taken_by_bash_as_it_stands():
    words = ["import", "Prüfstand Süd/a$HOME `b`.csv", 'a"b', "c\\d", "--unit", "force=kN"]
    line = cli.command.quoted(words)
    run = subprocess.run(["bash", "-c", f"printf '%s\\n' {line}"], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines() == words
