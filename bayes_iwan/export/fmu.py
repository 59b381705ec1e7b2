"""The fmu target: FMI 2.0 and 3.0 co-simulation, a binary for this machine and the sources inside."""

import hashlib
import io
import os
import platform
import shutil
import subprocess
import tempfile
import zipfile
from html import escape
from pathlib import Path

from bayes_iwan.export import c_code
from bayes_iwan.export.c_code import c_source, filled, template
from bayes_iwan.export.card import Card
from bayes_iwan.export.device import Device, ExportError

NAMES: tuple[str, ...] = ("isolator_fmi2.fmu", "isolator_fmi3.fmu")
#: functions of the standards that a co-simulation without events, derivatives and states does not have
FMI2_NOT_HERE = (
    "GetBoolean SetBoolean GetString SetString GetDirectionalDerivative SetRealInputDerivatives "
    "GetRealOutputDerivatives CancelStep GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus"
)
FMI3_NOT_HERE = (
    "EnterEventMode GetFloat32 GetInt8 GetUInt8 GetInt16 GetUInt16 GetUInt32 GetInt64 GetUInt64 GetBoolean GetString "
    "GetBinary GetClock SetFloat32 SetInt8 SetUInt8 SetInt16 SetUInt16 SetUInt32 SetInt64 SetUInt64 SetBoolean "
    "SetString SetBinary SetClock GetNumberOfVariableDependencies GetVariableDependencies GetDirectionalDerivative "
    "GetAdjointDerivative EnterConfigurationMode ExitConfigurationMode GetIntervalDecimal GetIntervalFraction "
    "GetShiftDecimal GetShiftFraction SetIntervalDecimal SetIntervalFraction SetShiftDecimal SetShiftFraction "
    "EvaluateDiscreteStates UpdateDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime "
    "SetContinuousStates GetContinuousStateDerivatives GetEventIndicators GetContinuousStates "
    "GetNominalsOfContinuousStates GetNumberOfEventIndicators GetNumberOfContinuousStates EnterStepMode "
    "GetOutputDerivatives ActivateModelPartition"
)
_SYSTEMS = {"Linux": ("linux64", "linux", ".so"), "Darwin": ("darwin64", "darwin", ".dylib")}


def compiler() -> str:
    """The C compiler. Raises ExportError where there is none."""
    found = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if found is None:
        raise ExportError(
            "an FMU holds a binary, and there is no C compiler; install one (Debian: apt-get install gcc)"
        )
    return found


def files(device: Device, card: Card) -> tuple[dict[str, str | bytes], tuple[str, ...]]:
    """Both FMUs, and what the card says of them."""
    if platform.system() not in _SYSTEMS:
        raise ExportError(f"FMUs are built on Linux and macOS, not on {platform.system()}; export to c and wrap that")
    notes = (
        "inputs displacement, velocity, acceleration; output force, a function of the inputs at the same time; "
        "parameters draw (0 the point, then draws) and amplitude",
        f"isolator_fmi2.fmu: FMI 2.0, isolator_fmi3.fmu: FMI 3.0, co-simulation, built on {platform.machine()} "
        f"{platform.system()}; steps may vary, be rejected and restored",
    )
    card_text = "\n".join([card.text(), *notes])
    core = c_source(device, card.text())
    guid = "{" + hashlib.sha256(core.encode()).hexdigest()[:32] + "}"
    places = {"GUID": guid} | {
        f"FMI{n}_NOT_HERE": "\n".join(f"NOT_HERE(fmi{n}{name})" for name in names.split())
        for n, names in ((2, FMI2_NOT_HERE), (3, FMI3_NOT_HERE))
    }
    sources = {"fmu.c": filled(template("fmu.c"), places), c_code.NAME: core}
    old, new, suffix = _SYSTEMS[platform.system()]
    binary = _built(sources, suffix)
    machine = {"x86_64": "x86_64", "AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    page = f"<!doctype html><meta charset='utf-8'><title>isolator</title><pre>{escape(card_text)}</pre>\n"
    amplitude = float(device.parameters["amplitude_mm"][0]) * 1e-3
    made: dict[str, str | bytes] = {}
    for name, version, place in zip(NAMES, (2, 3), (old, f"{machine}-{new}")):
        inside: dict[str, str | bytes] = {
            "modelDescription.xml": _description(version, guid, card, device.sets, amplitude),
            f"binaries/{place}/isolator{suffix}": binary,
            "documentation/index.html": page,
            **{f"sources/{n}": text for n, text in sources.items()},
        }
        if version == 3:
            inside["sources/buildDescription.xml"] = _BUILD
        made[name] = _zipped(inside)
    return made, notes


def _built(sources: dict[str, str], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        out = f"isolator{suffix}"
        command = [*compiler().split(), "-std=c99", "-O2", "-shared", "-fPIC", "-o", out, "fmu.c", "-lm"]
        try:
            subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            said = (getattr(error, "stderr", "").strip() or str(error)).splitlines()[0]
            said = f"the C compiler {command[0]} failed on the FMU ({said[:160]}); set CC to another"
            raise ExportError(said) from None
        return (Path(folder) / out).read_bytes()


def _zipped(inside: dict[str, str | bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in inside.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return out.getvalue()


_BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="isolator">
    <SourceFileSet language="C99"><SourceFile name="fmu.c"/></SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""


def _description(version: int, guid: str, card: Card, sets: int, amplitude: float) -> str:
    """modelDescription.xml of FMI 2.0 or 3.0."""
    places = {"GUID": guid, "TOOL": f"bayes_iwan {card.version}", "AMPLITUDE": repr(amplitude), "LAST": str(sets - 1)}
    places |= {"LENGTH": card.units["stretch"], "FORCE": card.units["force"]}
    about = escape(f"friction isolator {card.specimen}: {card.model}", quote=True)
    return filled(template(f"fmi{version}.xml"), places | {"ABOUT": about})
