"""Headless Chromium, controlled through a pipe, without a driver or a network."""

import json
import os
import shutil
import subprocess
import time
from contextlib import contextmanager

NAMES = ("chromium", "chromium-browser", "google-chrome")
QUIET = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
QUIET += " --disable-component-update --disable-sync --disable-extensions --hide-scrollbars --remote-debugging-pipe"
OFFLINE = "--host-resolver-rules=MAP * ~NOTFOUND"
PATIENCE = 60.0  # [s]


def find_chromium():
    """Return the path of CHROMIUM or of an installed one, or None."""
    names = (os.environ.get("CHROMIUM") or NAMES[0], *NAMES)
    return next((path for name in names if (path := shutil.which(name))), None)


def pages_are_skipped():
    """Return whether there is no Chromium; never if PAGES_MUST_OPEN is set."""
    return find_chromium() is None and not os.environ.get("PAGES_MUST_OPEN")


class Browser:
    """A browser with one page at a time; `faults` holds errors and warnings as text."""

    def __init__(self, to, said):
        self.to, self.said, self.number, self.faults, self.buffer = to, said, 0, [], b""
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.send(
            "Target.attachToTarget", targetId=target, flatten=True
        )["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def send(self, method, session=None, **given):
        self.number += 1
        message = {"id": self.number, "method": method, "params": given} | (
            {"sessionId": session} if session else {}
        )
        os.write(self.to, json.dumps(message).encode() + b"\0")
        while (answer := self.next_message()).get("id") != self.number:
            self.note(answer)
        assert "error" not in answer, f"{method}: {answer['error']}"
        return answer["result"]

    def call(self, method, **given):
        return self.send(method, self.session, **given)

    def next_message(self):
        """Read the next message of the browser."""
        while b"\0" not in self.buffer:
            more = os.read(self.said, 1 << 20)
            assert more, "the browser ended"
            self.buffer += more
        message, _, self.buffer = self.buffer.partition(b"\0")
        return json.loads(message)

    def note(self, event):
        """Record errors and warnings of scripts, policy and network."""
        kind, given = event.get("method"), event.get("params", {})
        if kind == "Runtime.exceptionThrown":
            self.faults.append(
                given["exceptionDetails"]
                .get("exception", {})
                .get("description", str(given))
            )
        elif kind == "Log.entryAdded" or (
            kind == "Runtime.consoleAPICalled" and given["type"] in ("error", "warning")
        ):
            self.faults.append(json.dumps(given))

    def ask(self, expression):
        """Evaluate an expression in the page."""
        answer = self.call(
            "Runtime.evaluate",
            expression=expression,
            returnByValue=True,
            awaitPromise=True,
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, expression):
        """Wait until an expression is true."""
        end = time.monotonic() + PATIENCE
        while not self.ask(expression):
            assert time.monotonic() < end, f"never: {expression}"
            time.sleep(0.02)

    def open(self, path, width=1060, height=900, dark=False):
        """Open a page in a window of a size [px]."""
        self.faults = []
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Page.navigate", url=f"file://{path}")
        self.wait("document.readyState === 'complete'")

    def mouse(self, kind, x, y, pressed=False):
        self.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x,
            y=y,
            button="left",
            buttons=int(pressed),
            clickCount=1,
        )


@contextmanager
def browser(folder):
    """Run Chromium with its files in a folder."""
    ours, theirs = os.pipe(), os.pipe()
    # Chromium reads its pipe from descriptor 3 and writes to 4
    shell = f'exec "$0" "$@" 3<&{ours[0]} 4>&{theirs[1]}'
    command = [
        "bash",
        "-c",
        shell,
        find_chromium(),
        *QUIET.split(),
        OFFLINE,
        f"--user-data-dir={folder}",
        "about:blank",
    ]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, pass_fds=(ours[0], theirs[1]), **quiet)
    os.close(ours[0])
    os.close(theirs[1])
    try:
        yield Browser(ours[1], theirs[0])
    finally:
        process.terminate()
        process.wait(PATIENCE)
        os.close(ours[1])
        os.close(theirs[0])
