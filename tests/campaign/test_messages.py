"""What a user is told of the mistakes that users make, read as one line that names the mend."""

import gzip

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, read_campaign


@pytest.fixture
def refusal(folder):
    """refusal(toml, text or bytes of test.csv): the one line that read_campaign answers with."""

    def read(toml, content):
        path = folder(toml, {})
        (path / "test.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(CampaignError) as caught:
            read_campaign(path)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    return read


def columns(record, **changed):
    """The record as CSV text, with columns changed."""
    values = {"time_s": record.time_s, "displacement_mm": record.displacement_mm, "force_N": record.force_N} | changed
    rows = zip(*values.values())
    return ",".join(values) + "\n" + "".join(",".join(f"{x:.13g}" for x in row) + "\n" for row in rows)


@pytest.mark.parametrize(
    "key", ["frequncy_hz", "Frequency_Hz", "frequency_hz2", "amplitud_mm", "amplitude_um", "roles"]
)
def test_a_key_beside_its_typo(refusal, toml, record, csv, key):
    said = refusal(toml + f"{key} = 12.0\n", csv(record()))
    assert "test.csv" in said and key in said and ("did you mean" in said or "stands beside" in said)


def test_other_numbers_are_no_typos(folder, toml):
    extras = "normal_force_N = 5\npressure_bar = 1\ntemperature_C = 20\nstart_hz = 5\npreload_mm = 0.1\n"
    assert set(read_campaign(folder(toml + extras)).tests[0].extras) == {
        "normal_force_N", "pressure_bar", "temperature_C", "start_hz", "preload_mm",
    }  # fmt: skip


def test_inches_named_mm(refusal, toml, record):
    r = record()
    assert "25.4 × too small: inches named mm?" in refusal(toml, columns(r, displacement_mm=r.displacement_mm / 25.4))


def test_epoch_time_in_milliseconds(refusal, folder, toml, record):
    r = record()
    epoch = columns(r, time_s=1.79e12 + 1e3 * r.time_s)
    said = refusal(toml, epoch)
    assert "milliseconds since 1970" in said and "time_ms" in said
    mended = toml.replace("[channels]", '[channels]\ntime = "time_ms"')
    in_ms = epoch.replace("time_s", "time_ms", 1)  # whole milliseconds: too coarse for 1,280 samples a second
    assert "rounded too far: state sample_rate_hz" in refusal(mended, in_ms)
    mended = mended.replace("[channels]", "[channels]\nsample_rate_hz = 1280")
    (test,) = read_campaign(folder(mended, {"test.csv": in_ms})).tests
    assert test.time_s.size == r.time_s.size and test.warnings == ()


def test_dropped_samples_are_said(folder, toml, record, csv):
    rows = csv(record()).splitlines(keepends=True)
    (test,) = read_campaign(folder(toml, {"test.csv": "".join(rows[:400] + rows[412:])})).tests
    assert any("gap" in w and "dropped samples?" in w for w in test.warnings)


def test_umlauts_in_another_encoding(refusal, toml, record, csv):
    text = (
        csv(record(), "time_s,displacement_mm,force_N,Prüfstand")
        .replace("\n", ",1\n")
        .replace("Prüfstand,1", "Prüfstand")
    )
    said = refusal(toml, text.encode("cp1252"))
    assert "line 1: not UTF-8; encoding cp1252?" in said and "bayes-iwan import" in said
    assert "UTF-16" in refusal(toml, text.encode("utf-16"))


def test_a_row_of_units(refusal, toml, record, csv):
    header, body = csv(record()).split("\n", 1)
    said = refusal(toml, f"{header}\ns,mm,N\n{body}")
    assert "line 2: a row of units ('s, mm, N')?" in said and "bayes-iwan import" in said


def test_two_headers(refusal, toml, record, csv):
    text = csv(record())
    n = text.count("\n")
    assert f"line {n + 1}: the header again" in refusal(toml, text + text)
    assert "line 2: the header again" in refusal(toml, text.split("\n", 1)[0] + "\n" + text)


def test_zero_bytes_and_zeros(refusal, toml, record, csv):
    text = csv(record()).encode()
    assert "line 101: zero bytes: the file was not written to its end" in refusal(
        toml, b"".join(text.splitlines(keepends=True)[:100]) + bytes(5000)
    )
    r = record()
    zero = np.zeros(r.time_s.size)
    assert "displacement does not move" in refusal(toml, columns(r, displacement_mm=zero, force_N=zero))
    assert "not a text file" in refusal(toml, bytes(9000))
    assert "no samples" in refusal(toml, "time_s,displacement_mm,force_N\n")
    assert "no header" in refusal(toml, b"")


def test_a_constant_channel(refusal, toml, record):
    r = record()
    assert "the force stays at 2.5: a dead channel" in refusal(toml, columns(r, force_N=np.full(r.time_s.size, 2.5)))


def test_swapped_channels(refusal, toml, record):
    r = record()
    assert "swapped" in refusal(toml, columns(r, displacement_mm=r.force_N, force_N=r.displacement_mm))


def test_a_truncated_file(refusal, folder, toml, record, csv):
    """Cut anywhere, a record is read as far as it goes, with a word, or refused in one line."""
    text = csv(record())
    for share in (0.02, 0.2, 0.5, 0.9):
        cut = text[: int(share * len(text))]
        try:
            (test,) = read_campaign(folder(toml, {"test.csv": cut})).tests
        except CampaignError as error:
            assert "test.csv" in str(error) and "\n" not in str(error)
        else:
            assert test.warnings and test.time_s.size == cut.count("\n") - 1
    path = folder(toml.replace("test.csv", "test.csv.gz"), {})
    (path / "test.csv.gz").write_bytes(gzip.compress(text.encode())[:900])
    with pytest.raises(CampaignError, match="copy or export it again"):
        read_campaign(path)


@pytest.mark.parametrize("cell", ["nan", "NaN", "", "-", "1.#IND", "inf"])
def test_gaps_written_as_no_number(refusal, toml, record, csv, cell):
    rows = csv(record()).splitlines()
    rows[50] = rows[50].rsplit(",", 1)[0] + "," + cell
    assert "test.csv line 51" in refusal(toml, "\n".join(rows) + "\n")


def test_names_with_spaces_and_accents(tmp_path, toml, record, csv):
    path = tmp_path / "Prüfung Nº 1 (été)"
    path.mkdir()
    text = toml.replace("test.csv", "Versuch è 10 Hz.csv").replace('"force_N"', '"Kraft oben_N"')
    (path / "campaign.toml").write_text(text, encoding="utf-8")
    (path / "Versuch è 10 Hz.csv").write_text(csv(record(), "time_s,displacement_mm,Kraft oben_N"), encoding="utf-8")
    assert read_campaign(path).loops()[0].n_cycles == 11


@pytest.mark.parametrize("fault", ["0.5,nan", "0.5", "0.5,1e31"])
def test_a_line_is_deleted_only_where_times_say_so(refusal, toml, record, fault):
    """Without times the rows after it would be taken for earlier ones, without a word."""
    r = record()
    with_time = columns(r).split("\n")
    without = [row.partition(",")[2] for row in with_time]
    with_time[5], without[5] = f"0.0039,{fault}", fault
    said = refusal(toml, "\n".join(with_time))
    assert "delete the line (a short gap is bridged)" in said and "time_s" not in said
    said = refusal(toml.replace("[[test]]", "sample_rate_hz = 1280\n\n[[test]]", 1), "\n".join(without))
    assert "add a column time_s with the time of each row" in said and "`bayes-iwan import`" in said


def test_a_time_column_that_is_not_named_in_channels(refusal, toml, record, csv):
    said = refusal(toml, csv(record(), "time_ms,displacement_mm,force_N"))
    assert 'Write time = "time_ms" in [channels]' in said


def test_a_campaign_file_in_another_encoding(folder, toml):
    path = folder(toml)
    (path / "campaign.toml").write_bytes(b"# a\n# gr\xf6\xdfer\n" + toml.encode())
    with pytest.raises(CampaignError, match=r"campaign.toml line 2: not UTF-8; encoding cp1252\? Save it as UTF-8"):
        read_campaign(path)
