"""The page of `gapsweep explore` in a real browser: a slider is dragged, the figures follow.

Run with ``pytest -m browser``; needs Chromium.
"""

import asyncio
import re

import numpy as np
import pytest
from tests.browser.tab import model, tab
from tests.builders.datasets import datasets, periodic, tables

import gapsweep as gs
from gapsweep.explorer.first_question import of_model
from gapsweep.explorer.page_results import from_rest
from gapsweep.explorer.question import EXACT, asked, numbers
from gapsweep.explorer.widget import explore_path

pytestmark = pytest.mark.browser
EXACT_CURVE = "response 0 from rest"


def source(name):
    """The columns of a data source, in JavaScript."""
    return f"{model(name)}.data"


def numbers_of(name, column):
    return f"Array.from({source(name)}.{column})"


# Where the handle of a slider is, through the shadow roots of its widgets.
HANDLE = """(() => {{
  const slider = [...Bokeh.index.all_views()].find(v => v.model.name === {name!r});
  const box = slider.shadow_el.querySelector('.noUi-handle').getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2];
}})()"""
# Keeps when the curve of the exact law was last drawn anew, and how often.
WATCH = """(() => {{
  window.drawn = []; window.moved = [];
  {slider}.properties.value.change.connect(() => window.moved.push(performance.now()));
  {curve}.properties.data.change.connect(() =>
    requestAnimationFrame(() => window.drawn.push(performance.now())));
}})()"""


def browse(address, page, steps, **how):
    """Run steps in a browser on a page, close the page, and return the steps' result."""

    async def run():
        async with tab(address, page.url, **how) as opened:
            await opened.until(
                f"window.Bokeh?.documents?.[0] && {source(EXACT_CURVE)}.omega.length === 200"
            )
            await opened.until(f"{source('response 0 sweep down')}.omega.length === 200")
            return await steps(opened)

    try:
        return asyncio.run(run())
    finally:
        page.stop()


def test_the_response_follows_a_slider_that_is_dragged(debugger):
    async def drag(opened):
        await opened.ask(WATCH.format(slider=model("forcing"), curve=model(EXACT_CURVE)))
        x, y = await opened.ask(HANDLE.format(name="forcing"))
        await opened.mouse("Pressed", x, y)
        for _ in range(30):
            x += 1.0
            await opened.mouse("Moved", x, y)
            await asyncio.sleep(0.02)
        during = await opened.ask("window.drawn.length")
        await opened.mouse("Released", x, y)
        await opened.until(f"{source('response 0 sweep down')}.omega.length === 200")
        return (
            during,
            await opened.ask(f"{model('forcing')}.value"),
            await opened.ask(numbers_of(EXACT_CURVE, "x_max")),
            await opened.ask("window.drawn.length"),
        )

    during, forcing, x_max, n_drawn = browse(debugger, gs.explore(approximations=()), drag)
    assert forcing > 4.5
    assert during >= 2  # while the button was held
    assert n_drawn <= 31  # no more often than it moved
    question = of_model(approximations=())
    here = asked(question, numbers(question) | {"forcing": forcing})
    np.testing.assert_allclose(x_max, 1e3 * from_rest(here, EXACT).x_max, rtol=1e-12)


def test_the_response_has_the_damping_of_its_slider(debugger):
    damped = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4), damping=20.0)

    async def move(opened):
        await opened.ask(f"window.before = {source(EXACT_CURVE)}.x_max")
        await opened.ask(f"{{ {model('damping')}.value = 80.0 }}")
        await opened.until(f"{source(EXACT_CURVE)}.x_max !== window.before")
        return await opened.ask(numbers_of(EXACT_CURVE, "x_max"))

    x_max = browse(debugger, gs.explore(law=damped, approximations=()), move)
    question = of_model(law=damped, approximations=()).at("damping", 80.0)
    assert question.laws(EXACT)[0].damping == 80.0
    np.testing.assert_allclose(x_max, 1e3 * from_rest(question, EXACT).x_max, rtol=1e-12)


def test_a_click_on_a_response_shows_its_motion(debugger):
    place = """(() => {{
      const source = {curve}, view = [...Bokeh.index.all_views()].find(
        v => v.model.type === 'Figure' && v.model.title.text === 'Frequency response');
      const k = 40, box = view.canvas_view.el.getBoundingClientRect();
      return [box.x + view.frame.x_scale.compute(source.omega[k]),
              box.y + view.frame.y_scale.compute(source.x_max[k]), source.omega[k]];
    }})()"""

    async def click(opened):
        x, y, omega = await opened.ask(place.format(curve=source("response 0 sweep up")))
        for kind in ("Pressed", "Released"):
            await opened.mouse(kind, x, y)
        await opened.until(f"{model('status')}.text.includes('mm/s')")
        await opened.until(f"Math.abs({model('omega')}.value - {omega}) < 1e-9")
        text = await opened.until(f"{model('status')}.text")
        return omega, text, await opened.ask(numbers_of("phase 0", "x"))

    omega, text, x = browse(debugger, gs.explore(approximations=()), click)
    assert f"Motion at {omega:.4g} Hz from x = " in text
    assert max(x) > 0.4  # beyond the wall


# Where a place in a figure is, in pixels.
PLACE = """(() => {{
  const view = [...Bokeh.index.all_views()].find(v => v.model.title?.text === {title!r});
  const box = view.canvas_view.el.getBoundingClientRect();
  return [box.x + view.frame.x_scale.compute({x}), box.y + view.frame.y_scale.compute({y})];
}})()"""


def test_clicks_on_basins_and_map_show_the_motion_from_there(debugger):
    async def click(opened, title, x, y):
        for kind in ("Pressed", "Released"):
            await opened.mouse(kind, *await opened.ask(PLACE.format(title=title, x=x, y=y)))

    async def steps(opened):
        await opened.until(f"{source('map 0 peaks')}.image?.[0]?.shape[0] === 40")
        shape = await opened.ask(f"{source('basins 0 peaks')}.image[0].shape")
        await click(opened, "Peak by initial condition, 9 Hz: piecewise", 0.5, 20.0)
        said = await opened.until(
            f"{model('status')}.text.includes('mm/s') && {model('status')}.text"
        )
        await opened.until(f"{source('map 0 peaks')}.image[0].shape[0] === 40")
        await click(opened, "Peak from rest over ω and K_c: piecewise", 6.0, 5.0)
        await opened.until(f"{model('status')}.text.includes('from rest')")
        return shape, said, [await opened.ask(f"{model(name)}.value") for name in ("omega", "K_c")]

    page = gs.explore(approximations=())
    shape, said, (omega, K_c) = browse(debugger, page, steps, size=(1280, 1700))
    assert shape == [48, 48]
    assert float(re.search("x = ([0-9.]+) mm", said)[1]) == pytest.approx(0.5, abs=0.05)
    assert omega == pytest.approx(6.0, abs=0.1)
    assert K_c == pytest.approx(5.0, abs=0.05)  # the slider moves along the logarithm


def test_a_law_that_is_unknown_is_a_word_not_a_traceback(debugger):
    async def type_in(opened):
        await opened.ask(f"{model('approximations')}.value = 'tangent'")
        await opened.until(f"{model('status')}.text.includes('unknown representation')")
        await opened.ask(f"{model('approximations')}.value = 'poly-13, tanh-1e5'")
        await opened.until(f"{source('response 2 from rest')}.omega.length === 200")
        return await opened.ask(f"{model('legend')}.text")

    assert "tanh-1e5" in browse(debugger, gs.explore(approximations=()), type_in)


def test_a_click_on_a_stored_point_opens_it(debugger, tmp_path):
    study = tables(("piecewise", "tanh-1e4"), (5.0, 6.0, 7.0))
    for made in datasets(tmp_path, study, lambda _, omega, __: periodic([(5e-3, 0.0)], omega)):
        made.close()

    async def click(opened):
        stored = source("stored")
        assert await opened.ask(f"{stored}.omega.length") == 6
        shown = """(() => {
          const view = [...Bokeh.index.all_views()].find(
            v => v.model.type === 'Figure' && v.model.title.text === 'Frequency response');
          const box = view.canvas_view.el.getBoundingClientRect();
          return [box.x + view.frame.x_scale.compute(6.0), box.y + view.frame.y_scale.compute(5.0)];
        })()"""
        x, y = await opened.ask(shown)
        for kind in ("Pressed", "Released"):
            await opened.mouse(kind, x, y)
        return await opened.until(
            f"{model('status')}.text.includes('x = ') && {model('status')}.text"
        )

    page = explore_path(tmp_path, 0)
    assert "Motion at 6 Hz from x = 5 mm, v = 0 mm/s" in browse(debugger, page, click)


@pytest.mark.parametrize("width", [390, 900, 1280])
def test_nothing_is_wider_than_the_window(debugger, width):
    async def measure(opened):
        return await opened.ask("[innerWidth, document.documentElement.scrollWidth]")

    how = {"size": (width, 900), "is_phone": width < 500}
    window, page = browse(debugger, gs.explore(), measure, **how)
    assert window == width  # a phone shows a page that names no width of its own on 980 pixels
    assert page <= width


def test_on_a_phone_sliders_stay_above_the_figures(debugger):
    async def scroll(opened):
        await opened.ask("scrollTo(0, 800)")
        return await opened.ask("""(() => {
          const views = [...Bokeh.index.all_views()];
          const side = views.find(v => v.model.name === "side").el.getBoundingClientRect();
          return [side.top, side.bottom, side.width];
        })()""")

    top, bottom, width = browse(debugger, gs.explore(), scroll, size=(390, 844), is_phone=True)
    assert top == 0.0
    assert bottom < 0.5 * 844
    assert width > 350


def test_a_map_over_another_number_is_not_shown_under_its_name(debugger):
    async def change(opened):
        await opened.until(f"{source('map 0 peaks')}.image?.[0]?.shape[0] === 40")
        await opened.ask(f"{model('over')}.value = 'alpha'")
        title = """[...Bokeh.index.all_views()].map(v => v.model.title?.text)
          .find(text => text?.startsWith('Peak from rest'))"""
        await opened.until(f"({title}).includes('α')")
        begun = await opened.ask(f"[{title}, {source('map 0 peaks')}.image.length]")
        await opened.until(f"{source('map 0 peaks')}.image?.[0]?.shape[0] === 40")
        return begun, await opened.ask(title)

    (title, n_shown), done = browse(debugger, gs.explore(approximations=()), change)
    assert ("computing" in title) == (n_shown == 0)
    assert done == "Peak from rest over ω and α: piecewise"
