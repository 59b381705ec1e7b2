"""A campaign of torque over angle, or of pressure over stroke, in its own units from column name to text."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, read_campaign, write_campaign
from bayes_iwan.campaign.recording.units import ACCELERATIONS, DISPLACEMENTS, FORCES, Units

TORSION = Units("mrad", "N·m")
HYDRAULIC = Units("mm", "kPa")


def stated(toml, displacement, force, amplitude):
    toml = toml.replace('"displacement_mm"', f'"{displacement}"').replace('"force_N"', f'"{force}"')
    return toml.replace("amplitude_mm = 1.0", amplitude)


def test_torque_over_angle_in_degrees(folder, toml, record, csv):
    r = record()  # 1 degree, N·m
    path = folder(
        stated(toml, "angle_deg", "torque_N_m", "amplitude_deg = 1.0"),
        {"test.csv": csv(r, "time_s,angle_deg,torque_N_m")},
    )
    campaign = read_campaign(path)
    assert campaign.units == TORSION and campaign.tests[0].units == TORSION
    np.testing.assert_allclose(campaign.tests[0].displacement_mm, 1e3 * np.deg2rad(r.displacement_mm), rtol=1e-7)
    np.testing.assert_allclose(campaign.tests[0].force_N, r.force_N, rtol=1e-7, atol=1e-9)
    (loop,) = campaign.loops()
    assert loop.amplitude_mm == pytest.approx(1e3 * np.pi / 180, rel=1e-4)
    # velocity in rad/s: a thousandth of mrad/s, as m/s is of mm/s
    assert np.abs(loop.velocity_m_s).max() == pytest.approx(2 * np.pi * 10 * np.pi / 180, rel=1e-4)


def test_pressure_over_stroke(folder, toml, record, csv):
    r = record()
    path = folder(
        stated(toml, "stroke_mm", "pressure_bar", "amplitude_mm = 1.0"),
        {"test.csv": csv(r, "time_s,stroke_mm,pressure_bar")},
    )
    campaign = read_campaign(path)
    assert campaign.units == HYDRAULIC
    np.testing.assert_allclose(campaign.tests[0].force_N, 100 * r.force_N, rtol=1e-7, atol=1e-6)


def test_angular_acceleration(folder, toml, record, csv):
    r = record()
    acceleration = -((2 * np.pi * 10) ** 2) * r.displacement_mm  # deg/s²
    toml = stated(toml, "x", "torque_N_m", "amplitude_deg = 1.0").replace(
        'displacement = "x"', 'acceleration = "a_deg_s2"'
    )
    path = folder(toml, {"test.csv": csv(replace(r, displacement_mm=acceleration), "time_s,a_deg_s2,torque_N_m")})
    assert read_campaign(path).loops()[0].amplitude_mm == pytest.approx(1e3 * np.pi / 180, rel=1e-3)


def test_written_campaigns_keep_their_units(tmp_path, record):
    for units, columns in ((TORSION, "angle_mrad,torque_N_m"), (HYDRAULIC, "displacement_mm,pressure_kPa")):
        test = replace(record(), units=units)
        path = tmp_path / units.displacement
        write_campaign(path, name="n", description="", tests=[test], compress=False)
        assert (path / "test.csv").read_text().splitlines()[0] == "time_s," + columns
        back = read_campaign(path)
        assert back.units == units
        np.testing.assert_allclose(back.tests[0].force_N, test.force_N, rtol=1e-7)
    with pytest.raises(CampaignError, match="one unit of displacement"):
        write_campaign(
            tmp_path / "x", name="n", description="", tests=[record(file="a"), replace(record(), units=TORSION)]
        )


def test_amplitude_in_a_wrong_unit_is_refused_by_name(folder, toml, record, csv):
    path = folder(
        stated(toml, "angle_deg", "torque_N_m", "amplitude_mrad = 1.0"),
        {"test.csv": csv(record(), "time_s,angle_deg,torque_N_m")},
    )
    with pytest.raises(CampaignError, match=r"shows 17\.45 mrad, campaign\.toml states amplitude_mrad = 1"):
        read_campaign(path)
    path = folder(
        stated(toml, "angle_deg", "torque_N_m", "amplitude_mm = 1.0"),
        {"test.csv": csv(record(), "time_s,angle_deg,torque_N_m")},
    )
    with pytest.raises(CampaignError, match="amplitude_mrad is missing"):
        read_campaign(path)


def test_sizes_of_units_against_pint():
    """The factors written out here against an independent table of units."""
    pint = pytest.importorskip("pint")
    unit = pint.UnitRegistry()
    powers = {"m_s2": "m/s**2", "mm_s2": "mm/s**2", "g": "g_0", "rad_s2": "rad/s**2", "deg_s2": "deg/s**2"}
    for table, targets in (
        (DISPLACEMENTS, {"mm": "mm", "mrad": "mrad"}),
        (ACCELERATIONS, {"mm": "m/s**2", "mrad": "rad/s**2"}),
        (FORCES, {"N": "N", "N·m": "N*m", "kPa": "kPa"}),
    ):
        for working, sizes in table.items():
            for name, size in sizes.items():
                text = powers.get(name, name.replace("_", "*").replace("lbf*in", "lbf*inch"))
                assert unit.Quantity(1.0, text).to(targets[working]).magnitude == pytest.approx(size, rel=1e-12), name


def test_texts():
    for text in ("N/mm", "force (N)", "mJ", "m1/m2", "2.5 N at 0.3 mm"):
        assert Units().text(text) == text
    for text, torsion, hydraulic in (
        ("N", "N·m", "kPa"),
        ("kN", "kN·m", "MPa"),
        ("mN", "mN·m", "Pa"),
        ("mm", "mrad", "mm"),
        ("mJ", "mJ", "J/m²"),
        ("N/mm", "N·m/mrad", "kPa/mm"),
        ("N·s/mm", "N·m·s/mrad", "kPa·s/mm"),
        ("N/mm²", "N·m/mrad²", "kPa/mm²"),
        ("N·s²/m²", "N·m·s²/rad²", "kPa·s²/m²"),
        ("N²/mm", "(N·m)²/mrad", "kPa²/mm"),
        ("N^(1−n)/mm", "(N·m)^(1−n)/mrad", "kPa^(1−n)/mm"),
        ("s/m", "s/rad", "s/m"),
        ("m/s", "rad/s", "m/s"),
        ("mm^−β", "mrad^−β", "mm^−β"),
        ("-", "-", "-"),
        ("s", "s", "s"),
        ("Hz", "Hz", "Hz"),
        ("force (N)", "force (N·m)", "force (kPa)"),
        ("2.5 N RMS at 0.3 mm", "2.5 N·m RMS at 0.3 mrad", "2.5 kPa RMS at 0.3 mm"),
        ("m₂/m₁", "m₂/m₁", "m₂/m₁"),
    ):
        assert TORSION.text(text) == torsion and HYDRAULIC.text(text) == hydraulic, text
        assert TORSION.text(torsion) == torsion and HYDRAULIC.text(hydraulic) == hydraulic  # twice does no harm
    assert TORSION.energy == "mJ" and TORSION.stiffness == "N·m/mrad" and TORSION.velocity == "rad/s"


def test_names():
    for name, torsion in (
        ("kp_N_mm", "kp_Nm_mrad"),
        ("mean_slip_force_N", "mean_slip_force_Nm"),
        ("dissipated_energy_mJ[f10_N.csv]", "dissipated_energy_mJ[f10_N.csv]"),
        ("k3_N_mm3", "k3_Nm_mrad3"),
        ("eta1", "eta1"),
    ):
        assert Units().name(name) == name and TORSION.name(name) == torsion and TORSION.name(torsion) == torsion
    assert HYDRAULIC.name("dissipated_energy_mJ[f10.csv]") == "dissipated_energy_J_m2[f10.csv]"
