"""What a data-acquisition system would have written of the shipped rope spring: a TDMS file and a German CSV file.

python analyses/sample_recordings.py --out recordings

rope_spring.tdms holds the nine tests, a group each, as volts of the paper's rig: an accelerometer of 105 mV/g and a
force transducer of 9.55 mV/N at 1,280 samples a second. Versuch 10 Hz.csv is one test as a German logger exports it:
cp1252, semicolons, decimal commas, lines above the table and a row of units. `bayes-iwan import` reads both:

bayes-iwan import recordings/rope_spring.tdms --sensitivity "acceleration=105 mV/g" --sensitivity "force=9.55 mV/N" \
    --out campaign
bayes-iwan identify campaign --out runs/campaign
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bayes_iwan.campaign import read_campaign
from bayes_iwan.campaign.recording.table import read_table

DATA = Path(__file__).parents[1] / "data"
RATE_HZ = 1280.0
G_M_S2, V_PER_G, V_PER_N = 9.80665, 0.105, 9.55e-3


def write_tdms(path: Path) -> None:
    """The runs of rope_spring_accelerometer as volts, a group of two channels for each test."""
    from nptdms import ChannelObject, TdmsWriter

    campaign = read_campaign(DATA / "rope_spring_accelerometer")
    with TdmsWriter(path) as writer:
        for test in campaign.tests:
            names, table, _ = read_table(campaign.path / test.file, test.file)
            acceleration, force = (table[:, names.index(name)] for name in ("acceleration_m_s2", "force_N"))
            group = test.file.removesuffix(".gz").removesuffix(".csv")
            said = {"unit_string": "V", "wf_increment": 1 / RATE_HZ}
            writer.write_segment(
                [
                    ChannelObject(group, "Accelerometer", acceleration / G_M_S2 * V_PER_G, said),
                    ChannelObject(group, "Force", force * V_PER_N, said),
                ]
            )


def write_german(path: Path) -> None:
    """One test of rope_spring as text that took five edits by hand before it could be read."""
    test = read_campaign(DATA / "rope_spring").tests[1]
    lines = ["Prüfstand 3, Messung 17", "Datum;21.11.2026", "", "Zeit;Weg über Grund;Kraft", "s;mm;kN"]
    for t, u, f in zip(test.time_s, test.displacement_mm, test.force_N):
        lines.append(f"{t:.6f};{u:.6f};{f / 1e3:.8f}".replace(".", ","))
    path.write_bytes("\r\n".join([*lines, ""]).encode("cp1252"))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("recordings"), help="folder to write (default: recordings)")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    write_tdms(out / "rope_spring.tdms")
    write_german(out / "Versuch 10 Hz.csv")
    print(f"two recordings are in {out}; `bayes-iwan import` makes a campaign of each")


if __name__ == "__main__":
    main()
