"""The report in a real browser: nothing fails, nothing is asked for outside, all is drawn.

Run with ``pytest -m browser``; needs Chromium.
"""

import asyncio
import json
import re
import shutil
import subprocess

import pytest
from tests.made import datasets, periodic, tables
from tests.unit.test_report import HOSTILE, decided
from tornado.websocket import websocket_connect

from gapsweep.analysis.agreement import agreement
from gapsweep.analysis.timing import timing
from gapsweep.report.html import write_report
from gapsweep.report.tables import VERDICTS

pytestmark = pytest.mark.browser
OPTIONS = (
    "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --remote-debugging-port=0"
)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    study = tables(("piecewise", "tanh-1e4"), (1.0, 2.0, 3.0))
    study["study"]["title"] = HOSTILE
    responses, attractors = datasets(
        folder, study, lambda label, omega, _: periodic([(1e-3 / omega, 0.0)], omega)
    )
    return write_report(
        folder / "index.html",
        responses,
        agreement(responses, attractors),
        timing(responses),
        attractors=attractors,
        claims=decided(),
    )


@pytest.fixture(scope="module")
def debugger(tmp_path_factory):
    """Address of a page of a running Chromium, for its debugging protocol."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    assert program, "no Chromium found; Debian: apt install chromium"
    profile = tmp_path_factory.mktemp("profile")
    command = [program, *OPTIONS.split(), f"--user-data-dir={profile}", "about:blank"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stderr:
            if found := re.search(r"ws://(\S+?)/devtools/browser", line):
                break
        yield found[1]
        process.kill()


async def looked_at(address, url, questions, size=(1000, 800)):
    """Load a page, ask it JavaScript expressions; the answers, and every event on the way."""
    from tornado.httpclient import AsyncHTTPClient, HTTPRequest

    new = HTTPRequest(f"http://{address}/json/new?about:blank", method="PUT", body=b"")
    target = json.loads((await AsyncHTTPClient().fetch(new)).body)
    socket = await websocket_connect(target["webSocketDebuggerUrl"], max_message_size=2**28)
    events, number = [], 0

    async def call(method, **parameters):
        nonlocal number
        number += 1
        await socket.write_message(
            json.dumps({"id": number, "method": method, "params": parameters})
        )
        while True:
            message = json.loads(await asyncio.wait_for(socket.read_message(), 60))
            if message.get("id") == number:
                return message.get("result", message)
            events.append(message)

    for domain in ("Page", "Runtime", "Log", "Network"):
        await call(f"{domain}.enable")
    width, height = size
    await call(
        "Emulation.setDeviceMetricsOverride",
        width=width, height=height, deviceScaleFactor=1, mobile=False,
    )  # fmt: skip
    await call("Page.navigate", url=url)
    while not any(event.get("method") == "Page.loadEventFired" for event in events):
        await call("Runtime.evaluate", expression="1")
    answers = []
    for question in questions:
        found = await call("Runtime.evaluate", expression=question, returnByValue=True)
        answers.append(found["result"].get("value", found))
    socket.close()
    return answers, events


def ask(debugger, page, *questions, **how):
    return asyncio.run(looked_at(debugger, page.as_uri(), questions, **how))


def test_nothing_fails_and_nothing_outside_is_asked_for(debugger, page):
    _, events = ask(debugger, page, "1")
    kinds = {event["method"] for event in events}
    assert "Network.requestWillBeSent" in kinds
    assert not kinds & {"Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded"}
    asked = [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []


def test_every_figure_is_drawn_and_has_words(debugger, page):
    (sizes, words), _ = ask(
        debugger,
        page,
        "[...document.images].map(i => i.naturalWidth && i.getBoundingClientRect().height)",
        "[...document.images].map(i => i.alt)",
    )
    assert len(sizes) >= 2
    assert min(sizes) > 100.0
    assert all(words)


def test_the_filter_shows_what_fits(debugger, page):
    choose = (
        "(() => {{ const form = document.getElementById('claims-filter');"
        "form.elements.{name}.value = {value!r};"
        "form.dispatchEvent(new Event('input', {{bubbles: true}}));"
        "return [...document.querySelectorAll('ol.claims > li')]"
        ".filter(c => c.offsetHeight > 0).length; }})()"
    )
    counts, _ = ask(
        debugger,
        page,
        choose.format(name="verdict", value=VERDICTS[0]),
        choose.format(name="text", value="no such words"),
        choose.format(name="verdict", value=""),
        choose.format(name="text", value="fig. 2"),
    )
    assert counts == [1, 0, 0, 1]


def test_nothing_is_wider_than_a_phone(debugger, page):
    (width,), _ = ask(debugger, page, "document.documentElement.scrollWidth", size=(380, 800))
    assert width <= 380


def test_the_answer_and_a_figure_are_on_the_first_screen(debugger, page):
    for size in ((1280, 800), (390, 844)):
        (row, width, hero), _ = ask(
            debugger,
            page,
            "document.querySelector('#answer tbody tr:last-child').getBoundingClientRect().bottom",
            "document.querySelector('#answer .scroll table').getBoundingClientRect().right",
            "document.querySelector('#figure-hero img').getBoundingClientRect().top",
            size=size,
        )
        assert row < hero < size[1] - 100
        assert width <= size[0]


def test_the_address_keeps_what_is_filtered(debugger, page):
    asked = f"{page.as_uri()}#claims?verdict={VERDICTS[1]}&text=fig"
    count = (
        "[...document.querySelectorAll('ol.claims > li')].filter(c => c.offsetHeight > 0).length"
    )
    write = (
        "(() => { const form = document.getElementById('claims-filter');"
        "form.elements.verdict.value = '';"
        "form.dispatchEvent(new Event('input', {bubbles: true})); return location.hash; })()"
    )
    (shown, top, address), _ = asyncio.run(
        looked_at(
            debugger,
            asked,
            (count, "document.getElementById('claims').getBoundingClientRect().top", write),
        )
    )
    assert shown == 1
    assert top < 100
    assert address == "#claims?verdict=&text=fig"
