"""A page as PDF, printed by a browser that the machine has: the same words, tables and figures, page by page."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from bayes_iwan.errors import InputError
from bayes_iwan.files import replacing

#: where a browser may be named that is found nowhere else
VARIABLE = "BAYES_IWAN_BROWSER"
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge", "microsoft-edge")
_PLACES = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    *(
        rf"{os.environ.get(root, '')}\{path}"
        for root in ("PROGRAMFILES", "PROGRAMFILES(X86)", "LOCALAPPDATA")
        for path in (r"Google\Chrome\Application\chrome.exe", r"Microsoft\Edge\Application\msedge.exe")
        if sys.platform == "win32"
    ),
)
#: nothing of a user's own browser is touched, and nothing is asked of a network
OPTIONS = (
    *(f"--disable-{x}" for x in ("gpu", "quic", "sync", "extensions", "component-update", "background-networking")),
    *("--headless=new", "--no-first-run"),
    *(("--no-sandbox",) if getattr(os, "geteuid", lambda: 1)() == 0 else ()),  # Chromium's sandbox refuses root
)
PATIENCE_S = 180.0


class BrowserError(InputError):
    """No PDF can be printed; the message says why and what to do."""


def find_browser() -> str | None:
    """The program of Chromium, Chrome or Edge; None where there is none."""
    named = os.environ.get(VARIABLE)
    if named:
        return shutil.which(named)
    found = next(filter(None, map(shutil.which, _NAMES)), None)
    return found or next((place for place in _PLACES if Path(place).is_file()), None)


def require_browser() -> str:
    """The program, asked for before long work begins. Raises BrowserError where there is none."""
    if found := find_browser():
        return found
    raise BrowserError(
        f"a PDF is printed by Chromium, Chrome or Edge, and none was found: install one, or name its program in the "
        f"environment variable {VARIABLE}, or open the HTML page in any browser and print it"
    )


def print_pdf(page: Path, pdf: Path) -> Path:
    """Print an HTML file into a PDF file; whole or not at all. Raises BrowserError where no browser prints it."""
    browser = require_browser()
    with replacing(pdf) as temporary, tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        made = Path(profile) / "page.pdf"
        command = [
            *(browser, *OPTIONS, f"--user-data-dir={Path(profile) / 'profile'}", "--no-pdf-header-footer"),
            *("--virtual-time-budget=20000", f"--print-to-pdf={made}", page.absolute().as_uri()),
        ]
        try:
            run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise BrowserError(f"{browser} did not print {page.name}: {error}") from None
        if not made.is_file():
            last = (run.stderr.strip().splitlines() or ["no message"])[-1]
            raise BrowserError(f"{browser} did not print {page.name}: {last}")
        Path(temporary).write_bytes(made.read_bytes())
    return pdf
