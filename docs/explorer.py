"""The picture of the explorer, and how long its redraws take; needs Chromium.

python -m docs.explorer
"""

import asyncio
import base64
import re
import shutil
import statistics
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from PIL import Image
from tests.browser.conftest import OPTIONS
from tests.browser.tab import Tab, model, tab

import gapsweep as gs

PICTURE = Path(__file__).parent / "images" / "explore.png"
APPROXIMATIONS = ("tanh-1e4", "poly-13", "ratpoly-5/3")
N_MOVES = 15
CHAOTIC = 12.8  # Hz, from rest
# Milliseconds from a slider's move to the frame after the responses of each law are there.
MOVE = """new Promise(done => {{
  const begun = performance.now(), times = {{}}, laws = [{laws}];
  laws.forEach((law, k) => law.properties.data.change.connect(() => {{
    if (k in times) return;
    times[k] = 0;
    requestAnimationFrame(() => setTimeout(() => {{
      times[k] = performance.now() - begun;
      if (k === laws.length - 1) done([times[0], times[k]]);
    }}));
  }}));
  {slider}.value += 0.05;
}})"""
SHOWN = "globalThis.Bokeh?.documents[0] !== undefined"
SETTLED = f"{model('response 0 sweep down')}.data.omega.length === 200"
WHOLE = f"{model('map 1 peaks')}.data.image[0]?.shape[0] === 40"


@contextmanager
def chromium() -> Iterator[str]:
    """Address of a running Chromium, for its debugging protocol."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    assert program, "no Chromium found; Debian: apt install chromium"
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [program, *OPTIONS.split(), f"--user-data-dir={profile}", "about:blank"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            found = next(
                filter(None, (re.search(r"ws://(\S+?)/devtools", line) for line in process.stderr))
            )
            try:
                yield found[1]
            finally:
                process.kill()


async def moved(opened: Tab) -> list[float]:
    """Times [ms] of one move: the exact law's, and the last approximation's."""
    laws = ", ".join(model(f"response {k} from rest") for k in range(len(APPROXIMATIONS) + 1))
    answer = await opened.call(
        "Runtime.evaluate",
        expression=MOVE.format(laws=laws, slider=model("forcing")),
        returnByValue=True,
        awaitPromise=True,
    )
    await opened.until(SETTLED)
    return list(answer["result"]["value"])


async def timed(address: str, url: str) -> list[list[float]]:
    async with tab(address, url) as opened:
        await opened.until(SHOWN)
        await opened.until(SETTLED)
        return [await moved(opened) for _ in range(N_MOVES)]


async def pictured(address: str, url: str) -> None:
    async with tab(address, url, size=(1280, 1680)) as opened:
        await opened.until(SHOWN)
        await opened.until(SETTLED)
        await opened.ask(f"{model('omega')}.value = {CHAOTIC}")
        await opened.until(f"{model('status')}.text.includes('{CHAOTIC} Hz')")
        await opened.until(WHOLE)
        picture = await opened.call("Page.captureScreenshot", format="png")
        with Image.open(BytesIO(base64.b64decode(picture["data"]))) as shown:
            shown.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE).save(
                PICTURE, optimize=True
            )


if __name__ == "__main__":
    with chromium() as address:
        soft = gs.Piecewise(K_c=1.4e4, gap=gs.Gap(0.0, 0.8e-3))
        page = gs.explore(law=soft)
        asyncio.run(pictured(address, page.url))
        page.stop()
        print(f"{PICTURE}: {PICTURE.stat().st_size} bytes")
        for K_c in (1.4e4, 1.4e6):
            law = gs.Piecewise(K_c=K_c, gap=gs.Gap(0.4e-3, 0.4e-3))
            page = gs.explore(law=law, approximations=APPROXIMATIONS)
            exact, last = zip(*asyncio.run(timed(address, page.url)), strict=True)
            page.stop()
            for law_of, times in (("exact law", exact), ("three approximations", last)):
                middle, most = statistics.median(times), max(times)
                print(f"K_c = {K_c:g} N/m, {law_of}: {middle:.0f} ms, at most {most:.0f} ms")
