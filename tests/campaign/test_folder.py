"""A campaign folder reads as written, and every fault is refused in one line that names it."""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, read_campaign, write_campaign
from bayes_iwan.campaign.folders import writing


def refused(path, *words):
    with pytest.raises(CampaignError) as caught:
        read_campaign(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message
    return message


def test_a_sound_folder_reads(folder, record):
    campaign = read_campaign(folder())
    assert campaign.name == "specimen"
    (test,) = campaign.tests
    np.testing.assert_allclose(test.displacement_mm, record().displacement_mm, atol=1e-8)
    assert test.warnings == ()
    assert campaign.loops()[0].n_cycles == 11
    assert read_campaign(campaign.path / "campaign.toml").tests[0].file == "test.csv"


def test_units_in_column_names_are_honoured(folder, toml, record, csv):
    r = record()
    scaled = replace(r, time_s=r.time_s * 1e3, displacement_mm=r.displacement_mm * 1e3, force_N=r.force_N / 1e3)
    toml = toml.replace('"displacement_mm"', '"displacement_um"').replace('"force_N"', '"force_kN"')
    toml = toml.replace("[channels]", '[channels]\ntime = "time_ms"')
    path = folder(toml, {"test.csv": csv(scaled, "time_ms,displacement_um,force_kN", digits=12)})
    (test,) = read_campaign(path).tests
    np.testing.assert_allclose(test.displacement_mm, r.displacement_mm, atol=1e-9)
    np.testing.assert_allclose(test.force_N, r.force_N, atol=1e-9)
    np.testing.assert_allclose(test.time_s, r.time_s, atol=1e-9)


def test_time_from_the_sample_rate_where_there_is_no_time_column(folder, toml, record):
    r = record()
    text = "displacement_mm,force_N\n" + "".join(f"{u:.8g},{f:.8g}\n" for u, f in zip(r.displacement_mm, r.force_N))
    refused(folder(toml, {"test.csv": text}), "test.csv", "time_s", "sample_rate_hz")
    (test,) = read_campaign(folder(toml.replace("[[test]]", "sample_rate_hz = 1280\n\n[[test]]", 1))).tests
    np.testing.assert_allclose(test.time_s, r.time_s, atol=1e-9)


def test_extras_and_role(folder, toml):
    path = folder(toml + 'pressure_bar = 3\nrole = "held-out"\n')
    (test,) = read_campaign(path).tests
    assert dict(test.extras) == {"pressure_bar": 3.0} and test.role == "held-out"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("format = 1", "format = 2", ["format is 2", "format = 1"]),
        ("format = 1\n", "", ["format is None"]),
        ("format = 1", "fromat = 1", ["unknown key 'fromat'", "did you mean 'format'?"]),
        ("[specimen]", "[speciment]", ["unknown key 'speciment'"]),
        ('name = "specimen"', 'nmae = "specimen"', ["[specimen]", "'nmae'", "did you mean 'name'?"]),
        ('name = "specimen"', "name = 3", ["name must be text"]),
        ('name = "specimen"', "", ["name is missing"]),
        ('force = "force_N"', "", ["force is missing"]),
        ('force = "force_N"', 'froce = "force_N"', ["'froce'", "did you mean 'force'?"]),
        ('force = "force_N"', 'force = "force"', ["no column 'force'", "did you mean 'force_N'"]),
        ('displacement = "displacement_mm"', "", ["displacement", "acceleration"]),
        ("frequency_hz = 10.0\n", "", ["test.csv", "frequency_hz is missing"]),
        ("frequency_hz = 10.0", "freqency_hz = 10.0", ["frequency_hz is missing", "did you mean 'freqency_hz'"]),
        ("frequency_hz = 10.0", 'frequency_hz = "10"', ["frequency_hz must be a finite number"]),
        ("frequency_hz = 10.0", "frequency_hz = -10.0", ["frequency_hz must be positive"]),
        ("frequency_hz = 10.0", "frequency_hz = nan", ["finite"]),
        ("frequency_hz = 10.0", "frequency_hz = 12.0", ["shows 10 Hz", "frequency_hz = 12"]),
        ("amplitude_mm = 1.0", "amplitude_mm = true", ["amplitude_mm must be a finite number"]),
        ("amplitude_mm = 1.0", "amplitude_mm = 1.2", ["test.csv", "amplitude_mm = 1.2"]),
        ("amplitude_mm = 1.0", "amplitude_mm = 1000.0", ["1e-3", "unit"]),
        (
            "amplitude_mm = 1.0",
            "amplitude_mm = 1.0\nrole = 'spare'",
            ["role 'spare' is not known; there are fit, held-out"],
        ),
        ("amplitude_mm = 1.0", "amplitude_mm = 1.0\nnote = 'x'", ["note must be a finite number"]),
        ('file = "test.csv"', "", ["number 1 has no file"]),
        ('file = "test.csv"', 'file = "tset.csv"', ["tset.csv", "not found"]),
        ('file = "test.csv"', 'file = "../test.csv"', ["inside the campaign folder"]),
        ('file = "test.csv"', 'file = "test.xlsx"', [".csv or .csv.gz"]),
        ('force = "force_N"', 'force = "force_N"\nsample_rate_hz = 1000', ["sample_rate_hz = 1000", "0.00078"]),
        ('force = "force_N"', 'force = "force_N"\nsample_rate_hz = 0', ["sample_rate_hz must be positive"]),
        ("format = 1", "format = ", ["not valid TOML"]),
    ],
)
def test_faults_in_campaign_toml(folder, toml, old, new, words):
    assert old in toml
    refused(folder(toml.replace(old, new)), *words)


def test_missing_folder_and_no_tests(folder, toml, tmp_path):
    refused(tmp_path / "nowhere", "nowhere", "not found")
    refused(folder(toml[: toml.index("[[test]]")]), "no tests")


def test_one_file_listed_twice(folder, toml):
    refused(folder(toml + toml[toml.index("[[test]]") :]), "test.csv", "twice")


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (lambda rows: [*rows[:5], "0.0039,abc,1.0", *rows[6:]], ["test.csv line 6", "'abc'", "displacement_mm"]),
        (lambda rows: [*rows[:5], "0.0039,,1.0", *rows[6:]], ["line 6", "''"]),
        (lambda rows: [*rows[:5], "0.0039,nan,1.0", *rows[6:]], ["line 6", "displacement_mm is nan"]),
        (lambda rows: [*rows[:5], "0.0039,1.0,inf", *rows[6:]], ["line 6", "force_N is inf"]),
        (lambda rows: [*rows[:5], "0.0039,1.0", *rows[6:]], ["line 6", "2 columns where the header has 3"]),
        (lambda rows: [*rows[:5], "0.0039,1.0,1.0,1.0", *rows[6:]], ["line 6", "4 columns"]),
        (lambda rows: [*rows[:-1], rows[-1].rsplit(",", 1)[0]], ["the last line", "cut off"]),
        (lambda rows: [*rows[:9], rows[8], *rows[9:]], ["line 10", "time does not increase"]),
        (lambda rows: [*rows[:9], rows[10], rows[9], *rows[11:]], ["time does not increase"]),
        (lambda rows: rows[:1], ["no samples"]),
        (lambda rows: ["time_s,displacement_mm", *[r.rsplit(",", 1)[0] for r in rows[1:]]], ["no column 'force_N'"]),
        (lambda rows: ["time_s,force_N,force_N", *rows[1:]], ["line 1", "two columns"]),
        (lambda rows: [r.replace(",", ";") for r in rows], ["line 1", "commas"]),
        (lambda rows: rows[:200], ["at least two are needed"]),
        (lambda rows: rows[:10], ["samples", "two whole cycles"]),
        (lambda rows: rows[:1] + [f"{k / 1280},0.5,1.0" for k in range(1000)], ["does not move"]),
    ],
)
def test_faults_in_a_record(folder, toml, record, csv, fault, words):
    rows = csv(record()).splitlines()
    refused(folder(toml, {"test.csv": "\n".join(fault(rows)) + "\n"}), *words)


def test_line_numbers_count_blank_lines(folder, toml, record, csv):
    rows = csv(record()).splitlines()
    rows[3] = ""
    assert read_campaign(folder(toml, {"test.csv": "\n".join(rows) + "\n"})).tests[0].time_s.size == len(rows) - 2
    rows[7] = "x,1,1"
    refused(folder(toml, {"test.csv": "\n".join(rows) + "\n"}), "line 8", "'x'")


def test_a_last_line_without_its_end(folder, toml, record, csv):
    text = csv(record())
    full = read_campaign(folder(toml, {"test.csv": text})).tests[0]
    # cut inside the last number, the row still reads as numbers: it is left out and said
    cut = read_campaign(folder(toml, {"test.csv": text[:-4]})).tests[0]
    assert cut.time_s.size == full.time_s.size - 1
    assert any("last line" in w for w in cut.warnings)
    refused(folder(toml, {"test.csv": text[: text.rindex(",")]}), f"line {full.time_s.size + 1}", "cut off")


def test_byte_order_mark_and_windows_line_ends(folder, toml, record, csv):
    path = folder(toml, {})
    (path / "test.csv").write_bytes(b"\xef\xbb\xbf" + csv(record()).replace("\n", "\r\n").encode())
    assert read_campaign(path).tests[0].warnings == ()


def test_damaged_gzip_and_binary_files(folder, toml, record, csv):
    path = folder(toml.replace("test.csv", "test.csv.gz"), {})
    whole = gzip.compress(csv(record()).encode())
    (path / "test.csv.gz").write_bytes(whole)
    assert read_campaign(path).tests[0].file == "test.csv.gz"
    (path / "test.csv.gz").write_bytes(whole[:-200])
    refused(path, "test.csv.gz", "cannot be read")
    (path / "test.csv.gz").write_bytes(csv(record()).encode())
    refused(path, "test.csv.gz", "cannot be read")
    path = folder(toml, {})
    (path / "test.csv").write_bytes(bytes(range(256)) * 9)
    refused(path, "test.csv", "not a text file")


def test_written_campaigns_read_back(tmp_path, record):
    tests = [
        record(file="a.csv", noise_N=0.01, extras={"normal_force_N": 5.0, "odd key": 1.5}),
        record(file="b.csv.gz", frequency_hz=15.0, amplitude_mm=0.3, role="held-out"),
    ]
    for compress in (True, False):
        path = tmp_path / str(compress)
        text = 'a "quoted" name\nwith Ω'
        write_campaign(path, name=text, description="d", tests=tests, sample_rate_hz=1280, compress=compress)
        back = read_campaign(path)
        assert back.name == text and back.description == "d"
        assert [t.file for t in back.tests] == (["a.csv.gz", "b.csv.gz"] if compress else ["a.csv", "b.csv"])
        for test, written in zip(back.tests, tests):
            assert (test.role, test.frequency_hz, test.amplitude_mm) == (
                written.role,
                written.frequency_hz,
                written.amplitude_mm,
            )
            assert dict(test.extras) == dict(written.extras)
            np.testing.assert_allclose(test.time_s, written.time_s, atol=1e-9)
            np.testing.assert_allclose(test.displacement_mm, written.displacement_mm, rtol=1e-7, atol=1e-12)
            np.testing.assert_allclose(test.force_N, written.force_N, rtol=1e-7, atol=1e-12)


def test_equal_campaigns_are_written_as_equal_bytes(tmp_path, record):
    for name in ("one", "two"):
        write_campaign(tmp_path / name, name="n", description="", tests=[record(file="a.csv")])
    files = sorted(p.name for p in (tmp_path / "one").iterdir())
    assert files == ["a.csv.gz", "campaign.toml"]  # and no temporary file left behind
    assert (tmp_path / "one" / "a.csv.gz").read_bytes()[4:8] == bytes(4)  # gzip's time stamp
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_what_cannot_be_written(tmp_path, record):
    with pytest.raises(CampaignError, match="at least one test"):
        write_campaign(tmp_path, name="n", description="", tests=[])
    with pytest.raises(CampaignError, match="one file name"):
        write_campaign(tmp_path, name="n", description="", tests=[record(), record(file="test.csv.gz")])
    with pytest.raises(CampaignError, match="plain name"):
        write_campaign(tmp_path, name="n", description="", tests=[record(file="../x.csv")])


def test_an_interrupted_write_does_not_read_as_a_campaign(tmp_path, record, monkeypatch):
    write_campaign(tmp_path, name="n", description="", tests=[record(file="a.csv"), record(file="b.csv")])
    whole = writing.write_whole

    def full_disk(path, content):
        if path.name == "b.csv.gz":
            raise OSError("no space left")
        return whole(path, content)

    monkeypatch.setattr(writing, "write_whole", full_disk)
    with pytest.raises(OSError, match="no space"):
        write_campaign(tmp_path, name="n", description="", tests=[record(file="a.csv"), record(file="b.csv")])
    refused(tmp_path, "campaign.toml", "not found")
