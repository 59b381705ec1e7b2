"""Campaign files are data from anywhere: nothing in them ends in a traceback, a hang or a full memory."""

import gzip
import os
import tracemalloc

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, average, read_campaign, write_campaign

NESTED = "x = " + "[" * 5000 + "]" * 5000
BIG = "1" + "0" * 400


def refused(path, *words):
    with pytest.raises(CampaignError) as caught:
        read_campaign(path)
    message = str(caught.value)
    assert message.isprintable() and len(message) < 600, message
    for word in words:
        assert word in message, message


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("format = 1", NESTED, "nested too deep"),
        ("format = 1", "format = " + "9" * 5000, "not valid TOML"),
        ("format = 1", f"format = {BIG}", "format is 1000"),
        ("format = 1", "format = 1979-05-27", "format is"),
        ("frequency_hz = 10.0", f"frequency_hz = {BIG}", "finite"),
        ("frequency_hz = 10.0", "frequency_hz = inf", "finite"),
        ("frequency_hz = 10.0", "frequency_hz = 5e-324", "smaller than any instrument"),
        ("frequency_hz = 10.0", "frequency_hz = 1e300", "finite"),
        ("amplitude_mm = 1.0", f"amplitude_mm = 1.0\nload_N = -{BIG}", "load_N must be a finite number"),
        ("amplitude_mm = 1.0", "amplitude_mm = 1.0\nrole = ['fit']", "is not known"),
        ("amplitude_mm = 1.0", "amplitude_mm = 1.0\nrole = {}", "is not known"),
        ('force = "force_N"', f'force = "force_N"\nsample_rate_hz = {BIG}', "finite"),
        ('force = "force_N"', 'force = "force_N"\nsample_rate_hz = 1e-300', "smaller than any instrument"),
        ('file = "test.csv"', r'file = "\u0000.csv"', "no name of a file"),
        ('file = "test.csv"', r'file = "a\nb.csv"', "no name of a file"),
        ('file = "test.csv"', r'file = "\u001b[31m.csv"', "no name of a file"),
        ('force = "force_N"', 'force = "' + "x" * 9000 + '"', "no column"),
        ("amplitude_mm = 1.0", "amplitude_mm = 1.0\nfrequncy_hz = 9.0", "did you mean 'frequency_hz'?"),
        ("amplitude_mm = 1.0", "amplitude_mm = 1.0\nAmplitude_mm = 9.0", "did you mean 'amplitude_mm'?"),
        ("amplitude_mm = 1.0", "amplitude_mm = 1.0\ngain = 1000", "would not be applied"),
        ("amplitude_mm = 1.0", "amplitude_mm = 1.0\nsensitivity_mV_N = 9.55", "would not be applied"),
    ],
)
def test_hostile_toml(folder, toml, old, new, word):
    assert old in toml
    refused(folder(toml.replace(old, new)), word)


def test_numbers_that_only_look_like_typos_are_kept(folder, toml):
    path = folder(toml + "amplitude_V = 2.5\nscaled_load_N = 3.0\nfrequency_step = 2\n")
    assert set(read_campaign(path).tests[0].extras) == {"amplitude_V", "scaled_load_N", "frequency_step"}


def test_a_toml_of_endless_length(folder, toml):
    refused(folder(toml + "# " + "x" * 1_100_000), "bytes")


@pytest.mark.parametrize("cell", ["1e300", "-1e31", "1e308"])
def test_numbers_beyond_any_instrument(folder, toml, record, csv, cell):
    rows = csv(record()).splitlines()
    rows[50] = rows[50].rsplit(",", 1)[0] + "," + cell
    refused(folder(toml, {"test.csv": "\n".join(rows) + "\n"}), "line 51", "beyond any instrument")


def test_a_header_of_escapes_or_of_endless_length(folder, toml, record, csv):
    body = csv(record()).split("\n", 1)[1]
    refused(folder(toml, {"test.csv": "time_s,\x1b[2J,force_N\n" + body}), "header is no text")
    refused(folder(toml, {"test.csv": "time_s," + ",".join(f"c{k}" for k in range(5000)) + "\n" + body}), "columns")


def test_pipes_folders_and_links_out_of_the_folder(folder, toml, tmp_path_factory, record, csv):
    path = folder(toml, {})
    os.mkfifo(path / "test.csv")
    refused(path, "test.csv", "pipe")
    (path / "test.csv").unlink()
    (path / "test.csv").mkdir()
    refused(path, "test.csv", "folder")
    (path / "test.csv").rmdir()
    outside = tmp_path_factory.mktemp("outside") / "secret.csv"
    outside.write_text(csv(record()))
    (path / "test.csv").symlink_to(outside)
    refused(path, "test.csv", "inside the campaign folder, not behind a link")
    (path / "campaign.toml").unlink()
    os.mkfifo(path / "campaign.toml")
    refused(path, "not a file")


def test_a_gzip_bomb_is_not_unpacked(folder, toml):
    path = folder(toml.replace("test.csv", "test.csv.gz"), {})
    (path / "test.csv.gz").write_bytes(gzip.compress(b"0,0,0\n" * 30_000_000, 6))
    tracemalloc.start()
    refused(path, "test.csv.gz", "times its size")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200e6


def test_memory_to_read_a_long_record(tmp_path, record):
    r = record(n_cycles=2000.3, noise_N=0.01)
    write_campaign(tmp_path, name="n", description="", tests=[r], compress=False)
    size = (tmp_path / "test.csv").stat().st_size
    tracemalloc.start()
    read_campaign(tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * size, peak / size


def test_memory_to_average_a_long_record(record):
    """Beside the record itself no more than five times its size, however many cycles it has."""
    r = record(n_cycles=3000.3, noise_N=0.01)
    average(r, n_blocks=1)
    tracemalloc.start()
    average(r)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * 24 * r.time_s.size, peak / (24 * r.time_s.size)


def test_copies_are_refused(tmp_path, record):
    r = record(noise_N=0.01)
    copy = record(noise_N=0.01, file="copy.csv")
    write_campaign(tmp_path, name="n", description="", tests=[r, copy], compress=False)
    refused(tmp_path, "copy.csv", "same samples as test.csv")
    again = record(noise_N=0.01, file="again.csv", seed=1)
    assert not np.array_equal(again.force_N, r.force_N)
    write_campaign(tmp_path, name="n", description="", tests=[r, again], compress=False)
    assert len(read_campaign(tmp_path).tests) == 2
