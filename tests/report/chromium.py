"""One Chromium for many pages, asked over its pipe for tools: a start takes longer than most of what is asked."""

from __future__ import annotations

import base64
import json
import os
import re
import select
import subprocess
from pathlib import Path
from typing import Any

from bayes_iwan.report.browser import OPTIONS, find_browser

BROWSER = find_browser()
PIPES = os.name == "posix"  # its pipe for tools is two more open files, which Windows hands on in another way
NO_BROWSER = "no Chromium here; to run these tests: apt-get update && apt-get install -y chromium"
PATIENCE_S = 180.0


class Chromium:
    """A browser with one tab; `folder` is for its profile and for pages that are made to be shown in it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        # it reads from the third and writes to the fourth of its files
        command = ["sh", "-c", 'exec "$0" "$@" 3<&0 4>&1 </dev/null >/dev/null 2>&1', str(BROWSER), *OPTIONS]
        command += [f"--user-data-dir={folder / 'profile'}", "--remote-debugging-pipe", "about:blank"]
        self._process = subprocess.Popen(command, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._read, self._asked, self._events, self._session = b"", 0, [], {}
        tab = self._call("Target.createTarget", url="about:blank")["targetId"]
        self._session = {"sessionId": self._call("Target.attachToTarget", targetId=tab, flatten=True)["sessionId"]}
        for domain in ("Page", "Runtime", "Log"):
            self._call(f"{domain}.enable")

    def _next(self) -> dict[str, Any]:
        """The next message."""
        while b"\0" not in self._read:
            assert select.select([self._process.stdout], [], [], PATIENCE_S)[0], "Chromium does not answer"
            more = self._process.stdout.read(1 << 20)
            assert more, "Chromium has ended"
            self._read += more
        message, self._read = self._read.split(b"\0", 1)
        return json.loads(message)

    def _call(self, method: str, **parameters: object) -> dict[str, Any]:
        self._asked += 1
        message = {"id": self._asked, "method": method, "params": parameters, **self._session}
        self._process.stdin.write(json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != self._asked:
            self._events.append(answer)
        assert "error" not in answer, f"{method}: {answer['error']}"
        return answer["result"]

    def open(self, page: Path | str, width: int = 800, height: int = 600, dark: bool = False, early: str = "") -> None:
        """Show a local file or an address in a window of this size, on a dark or a light screen; the script `early` is
        run before the page's own."""
        self._call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._call("Emulation.setEmulatedMedia", features=[scheme])
        script = self._call("Page.addScriptToEvaluateOnNewDocument", source=early)["identifier"]
        self._events.clear()
        self._call("Page.navigate", url=page if isinstance(page, str) else page.as_uri())
        while not any(event["method"] == "Page.loadEventFired" for event in self._events):
            self._events.append(self._next())
        self._call("Page.removeScriptToEvaluateOnNewDocument", identifier=script)

    def done(self, script: str) -> Any:
        """The value of an async function with this body, run in the page that is shown; what it throws is raised."""
        asked = {"expression": f"(async function () {{ {script} }})()", "awaitPromise": True, "returnByValue": True}
        found = self._call("Runtime.evaluate", **asked)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    @property
    def said(self) -> list[str]:
        """What the page has said on its console since it was opened, errors among it."""
        console = re.compile(r"Log\.entryAdded|Runtime\.(consoleAPICalled|exceptionThrown)")
        return [json.dumps(event["params"]) for event in self._events if console.fullmatch(event["method"])]

    def printed(self, page: Path, pdf: Path) -> Path:
        """A local file as PDF, as `bayes_iwan.report.browser.print_pdf` has it printed by a browser of its own."""
        self.open(page)
        pdf.write_bytes(
            base64.b64decode(self._call("Page.printToPDF", printBackground=True, preferCSSPageSize=True)["data"])
        )
        return pdf

    def close(self) -> None:
        self._process.stdin.close()  # which ends it
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._process.stdout.close()
