"""One page of a running Chromium, asked in JavaScript."""

import asyncio
import json
from contextlib import asynccontextmanager

from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import websocket_connect

SOON = 60.0  # seconds, compilation included


class Tab:
    """A page; `events` are those that Chromium reports."""

    def __init__(self, socket):
        self._socket, self._number, self.events = socket, 0, []

    async def call(self, method, **parameters):
        self._number += 1
        await self._socket.write_message(
            json.dumps({"id": self._number, "method": method, "params": parameters})
        )
        while True:
            message = json.loads(await asyncio.wait_for(self._socket.read_message(), SOON))
            if message.get("id") == self._number:
                return message.get("result", message)
            self.events.append(message)

    @property
    def problems(self):
        """Exceptions, messages of the console and of the log."""
        kinds = {"Runtime.exceptionThrown", "Log.entryAdded"}
        return [
            event for event in self.events
            if event["method"] in kinds or event["params"].get("type") == "error"
        ]  # fmt: skip

    def asked_for(self):
        """Addresses that the page has requested."""
        sent = [e for e in self.events if e["method"] == "Network.requestWillBeSent"]
        return [event["params"]["request"]["url"] for event in sent]

    async def ask(self, expression):
        found = await self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    async def until(self, expression):
        """The first value that is true."""
        async with asyncio.timeout(SOON):
            while not (value := await self.ask(expression)):
                await asyncio.sleep(0.02)
        return value

    async def mouse(self, kind, x, y):
        held = {"button": "left", "buttons": 1, "clickCount": 1}
        await self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **held)


def model(name):
    """The Bokeh model of a name, in JavaScript."""
    return f"Bokeh.documents[0].get_model_by_name({name!r})"


@asynccontextmanager
async def tab(address, url, size=(1280, 900), is_phone=False):
    """A page that is loaded, and closed at the end; nothing may have failed in it."""
    new = HTTPRequest(f"http://{address}/json/new?about:blank", method="PUT", body=b"")
    target = json.loads((await AsyncHTTPClient().fetch(new)).body)
    socket = await websocket_connect(target["webSocketDebuggerUrl"], max_message_size=2**28)
    opened = Tab(socket)
    for domain in ("Page", "Runtime", "Log", "Network"):
        await opened.call(f"{domain}.enable")
    await opened.call("Page.bringToFront")  # a page behind another one is not drawn
    width, height = size
    await opened.call(
        "Emulation.setDeviceMetricsOverride",
        width=width, height=height, deviceScaleFactor=1, mobile=is_phone,
    )  # fmt: skip
    await opened.call("Page.navigate", url=url)
    while not any(event["method"] == "Page.loadEventFired" for event in opened.events):
        await opened.call("Runtime.evaluate", expression="1")
    yield opened
    assert opened.problems == []
    await opened.call("Page.close")
    socket.close()
