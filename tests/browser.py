"""A real browser that opens a page, over the DevTools protocol: Debian's chromium, headless."""

import asyncio
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from tornado.websocket import WebSocketClientConnection, websocket_connect

_PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
_TIMEOUT_S = 60.0
_FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--remote-debugging-port=0")


@dataclass
class Tab:
    """An open page.

    Attributes:
        complaints: Errors and warnings on its console, and exceptions.
        requests: Addresses that it asked for.
    """

    socket: WebSocketClientConnection
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    _count: int = 0
    _loaded: str = ""  # which document has come to its load event last

    async def call(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol and return its result."""
        self._count += 1
        await self.socket.write_message(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while (message := await self._next()).get("id") != self._count:
            pass
        assert "error" not in message, message
        return message["result"]

    async def open(self, page: Path) -> None:
        """Load a page and wait until it and its pictures are there."""
        for domain in ("Page", "Runtime", "Log", "Network"):
            await self.call(f"{domain}.enable")
        await self.call("Page.setLifecycleEventsEnabled", enabled=True)
        opened = await self.call("Page.navigate", url=page.as_uri())
        assert "errorText" not in opened, opened
        while self._loaded != opened["loaderId"]:
            await self._next()

    async def evaluate(self, expression: str) -> Any:
        """Return what an expression is in the page."""
        found = await self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    async def press(self, key: str, code: int, text: str) -> None:
        """Press a key."""
        for kind in ("keyDown", "keyUp"):
            what = {"type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code}
            await self.call("Input.dispatchKeyEvent", **what, **({"text": text} if kind == "keyDown" else {}))

    async def _next(self) -> dict[str, Any]:
        received = await asyncio.wait_for(self.socket.read_message(), _TIMEOUT_S)
        assert received is not None, "the browser has gone"
        message: dict[str, Any] = json.loads(received)
        match message.get("method"), message.get("params"):
            case "Page.lifecycleEvent", what if what["name"] == "load":
                self._loaded = what["loaderId"]
            case "Network.requestWillBeSent", what:
                self.requests.append(what["request"]["url"])
            case "Runtime.exceptionThrown", what:
                self.complaints.append(str(what["exceptionDetails"]))
            case "Runtime.consoleAPICalled", what if what["type"] in ("error", "warning", "assert"):
                self.complaints.append(str(what["args"]))
            case "Log.entryAdded", what if what["entry"]["level"] in ("error", "warning"):
                self.complaints.append(what["entry"]["text"])
        return message


@contextmanager
def chromium(folder: Path) -> Iterator[str]:
    """Run a browser with its profile in a folder; give the address of its first page; skip where there is none."""
    program = next(filter(None, map(shutil.which, _PROGRAMS)), None)
    if program is None:
        pytest.skip(f"none of {', '.join(_PROGRAMS)} is installed: apt-get install chromium")
    command = [program, *_FLAGS, f"--user-data-dir={folder}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield _address(process, folder / "DevToolsActivePort")
    finally:
        process.kill()
        process.wait()


def _address(process: "subprocess.Popen[bytes]", file: Path) -> str:
    deadline = time.monotonic() + _TIMEOUT_S
    while not (file.exists() and len(lines := file.read_text().split("\n")) > 1):
        assert process.poll() is None and time.monotonic() < deadline, "chromium does not start"
        time.sleep(0.1)
    return f"127.0.0.1:{lines[0]}"


async def first_tab(address: str) -> Tab:
    """Return the page that a browser started with."""
    from tornado.httpclient import AsyncHTTPClient

    listed = await AsyncHTTPClient().fetch(f"http://{address}/json/list")
    (page,) = [target for target in json.loads(listed.body) if target["type"] == "page"]
    return Tab(await websocket_connect(page["webSocketDebuggerUrl"], max_message_size=100_000_000))
