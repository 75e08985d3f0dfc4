"""Headless Chromium, driven by the DevTools protocol over a pair of pipes."""

import base64
import itertools
import json
import os
import select
import shutil
import subprocess
import time

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
SWITCHES = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-gpu-sandbox",
    "--enable-unsafe-swiftshader",
    "--use-angle=swiftshader",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)


class Browser:
    """One page; `console` has its errors, warnings and exceptions."""

    def __init__(self, profile, switches=SWITCHES):
        down, self._commands = os.pipe()
        self._answers, up = os.pipe()

        def pipes():
            # The browser reads commands from 3 and answers to 4; the ends may be these numbers.
            ends = os.dup(down), os.dup(up)
            os.dup2(ends[0], 3)
            os.dup2(ends[1], 4)

        self._process = subprocess.Popen(
            [CHROMIUM, *switches, f"--user-data-dir={profile}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            close_fds=False,
            preexec_fn=pipes,
        )
        os.close(down)
        os.close(up)
        self._rest, self._number, self.console = b"", itertools.count(1), []
        self._session = None
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(target for target in targets if target["type"] == "page")
        self._session = self.call(
            "Target.attachToTarget", targetId=page["targetId"], flatten=True
        )["sessionId"]  # fmt: skip
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._process.terminate()
        self._process.wait(20)
        os.close(self._commands)
        os.close(self._answers)

    def call(self, method, timeout=60.0, **parameters):
        number = next(self._number)
        message = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + timeout
        while True:
            answer = self._read_message(end)
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def _read_message(self, end):
        while b"\0" not in self._rest:
            left = end - time.monotonic()
            assert left > 0
            assert select.select([self._answers], [], [], left)[0], "no answer"
            self._rest += os.read(self._answers, 1 << 20)
        text, self._rest = self._rest.split(b"\0", 1)
        event = json.loads(text)
        method, given = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.console.append(given["exceptionDetails"])
        if method == "Runtime.consoleAPICalled" and given["type"] in ("error", "warning", "assert"):
            self.console.append(given["args"])
        if method == "Log.entryAdded" and given["entry"]["level"] in ("error", "warning"):
            self.console.append(given["entry"])
        return event

    def size(self, width, height, dark=False):
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=width < 600)  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def open(self, path, state=""):
        # Another state of the same page is no new page.
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=f"file://{path}{state}")
        self.until("document.readyState === 'complete'")

    def until(self, expression, seconds=30.0):
        end = time.monotonic() + seconds
        while not self.value(expression):
            assert time.monotonic() < end, f"never: {expression}"
            time.sleep(0.05)

    def value(self, expression):
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True,
                          awaitPromise=True)  # fmt: skip
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def picture(self, selector=None, whole=False):
        """PNG of the window, of an element, or of the whole page."""
        options = {}
        if selector:
            box = self.value(
                f"(() => {{ const e = document.querySelector({json.dumps(selector)}); "
                "e.scrollIntoView({block: 'center'}); const b = e.getBoundingClientRect(); "
                "return [b.x + scrollX, b.y + scrollY, b.width, b.height]; })()"
            )
            sides = ("x", "y", "width", "height")
            options["clip"] = {**dict(zip(sides, box, strict=True)), "scale": 1}
        if whole:
            size = self.call("Page.getLayoutMetrics")["cssContentSize"]
            options["clip"] = {**size, "scale": 1}
        shot = self.call("Page.captureScreenshot", captureBeyondViewport=True, **options)
        return base64.b64decode(shot["data"])
