"""How long a browser takes to show a report: `python benchmarks/report.py RUN [WIDTH ...]`.

Headless Chromium opens ``RUN/report/index.html`` at each width (1280 and 390 pixels if none is
given), five times; medians of its own timing in ms from navigation: first contentful paint, the
page interactive, loaded, and idle (no task of 50 ms after it). Beside them where the first figure
begins, in pixels from the top, and the page's size.
"""

import asyncio
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from tornado.websocket import websocket_connect

ROUNDS, HEIGHT = 5, {1280: 800, 390: 844}
OPTIONS = "--headless --no-sandbox --disable-gpu --no-first-run --remote-debugging-port=0"
# Long tasks are watched from the start; the page is idle when none has come for half a second.
WATCH = """
window.busy = 0;
new PerformanceObserver((list) => {
  for (const task of list.getEntries()) window.busy = task.startTime + task.duration;
}).observe({ type: "longtask", buffered: true });
"""
READ = """(() => {
  const [page] = performance.getEntriesByType("navigation");
  const paint = performance.getEntriesByName("first-contentful-paint")[0];
  const figure = document.querySelector("figure");
  return JSON.stringify({
    paint: paint.startTime, interactive: page.domInteractive, loaded: page.loadEventEnd,
    idle: Math.max(window.busy, page.loadEventEnd),
    figure: figure.getBoundingClientRect().top + scrollY,
  });
})()"""


async def measured(address: str, page: Path, width: int) -> dict[str, float]:
    """One opening of the page, in ms and pixels."""
    socket = await websocket_connect(address, max_message_size=2**26)
    number = 0

    async def call(method, **parameters):
        nonlocal number
        number += 1
        await socket.write_message(
            json.dumps({"id": number, "method": method, "params": parameters})
        )
        while (answer := json.loads(await socket.read_message())).get("id") != number:
            pass
        return answer["result"]

    size = {"width": width, "height": HEIGHT.get(width, 900), "deviceScaleFactor": 1}
    await call("Emulation.setDeviceMetricsOverride", **size, mobile=width < 600)
    await call("Page.enable")
    await call("Page.addScriptToEvaluateOnNewDocument", source=WATCH)
    await call("Page.navigate", url=page.as_uri())
    await asyncio.sleep(4.0)
    found = await call("Runtime.evaluate", expression=READ)
    await call("Page.navigate", url="about:blank")
    socket.close()
    return json.loads(found["result"]["value"])


async def main(run: Path, widths: list[int]) -> None:
    page = (run / "report" / "index.html").resolve()
    print(f"{page.stat().st_size / 1e6:.2f} MB")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        sys.exit("no Chromium found; Debian: apt install chromium")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [program, *OPTIONS.split(), f"--user-data-dir={profile}", "about:blank"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as browser:
            line = next(line for line in browser.stderr if "DevTools listening on" in line)
            port = line.split("://")[1].split("/")[0]
            for width in widths:
                rounds = []
                for _ in range(ROUNDS):
                    rounds.append(await measured(await opened(port), page, width))
                medians = {
                    name: statistics.median(one[name] for one in rounds) for name in rounds[0]
                }
                print(width, ", ".join(f"{name} {value:.0f}" for name, value in medians.items()))
            browser.terminate()


async def opened(port: str) -> str:
    """Address of the debugger of a tab."""
    from tornado.httpclient import AsyncHTTPClient

    answer = await AsyncHTTPClient().fetch(f"http://{port}/json")
    tabs = json.loads(answer.body)
    return next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), [int(each) for each in sys.argv[2:]] or list(HEIGHT)))
