"""The report in a real browser: nothing fails, nothing is asked for outside, all is drawn.

Run with ``pytest -m browser``; needs Chromium.
"""

import asyncio
import csv

import pytest
from matplotlib.figure import Figure
from tests.browser.tab import tab
from tests.builders.datasets import datasets, datasets_by_place, periodic, tables
from tests.unit.test_paper_figures import LIMITS, STRONG, WEAK, responses_of
from tests.unit.test_report_sections import HOSTILE, decided
from workflows.paper.figures import sections

from gapsweep.analysis.agreement.comparison import agreement
from gapsweep.analysis.claims import Run
from gapsweep.analysis.datasets.timing import timing
from gapsweep.report import marks
from gapsweep.report.html import write_report
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Figured, Part, rendered
from gapsweep.report.tables import VERDICTS
from gapsweep.status import Status
from gapsweep.study.study import Study

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    study = tables(("piecewise", "tanh-1e4"), (1.0, 2.0, 3.0))
    study["study"]["title"] = HOSTILE
    responses, attractors = datasets(
        folder, study, lambda label, omega, _: periodic([(1e-3 / omega, 0.0)], omega)
    )
    inputs = Inputs(
        responses,
        timing(responses),
        agreement(responses, attractors),
        attractors,
        claims=decided(),
        sections=rendered(sections(Run({"responses": everything()}))),
    )
    return write_report(folder / "index.html", inputs)


def everything():
    """Responses that all the paper's figures from responses are drawn of, with long notes."""
    hard = [label + end for label in LIMITS for end in ("", "@paper")]
    labels = list(dict.fromkeys([*WEAK, *STRONG, *hard]))
    K_c, gaps = (1.4e3, 1.4e4, 1.4e6), [(1.1, 1.1), (1.5, 1.5), (0.4, 0.4), (0.0, 0.8)]
    responses = responses_of(labels, K_c, gaps)
    status = responses["status"]
    status[..., 2:9, 0], status[..., 9:21, 0] = Status.UNRESOLVED, Status.ERROR
    return responses


def ask(debugger, page, *questions, size=(1000, 800), address=""):
    """Answers of a loaded page to JavaScript expressions, in which nothing fails."""

    async def run():
        async with tab(debugger, f"{page.as_uri()}{address}", size) as opened:
            answers = [await opened.ask(question) for question in questions]
            outside = [u for u in opened.asked_for() if not u.startswith(("file:", "data:"))]
            assert opened.asked_for()
            assert outside == []
            return answers

    return asyncio.run(run())


# Heights of the pictures that are shown, brought in as if one had scrolled to them.
DRAWN = """Promise.all([...document.images].filter(i => i.offsetHeight).map(async (i) => {
  i.loading = "eager";
  await i.decode();
  return i.naturalWidth && i.getBoundingClientRect().height;
}))"""


def test_every_picture_is_drawn_and_has_words(debugger, page):
    sections = sorted((page.parent / "figures").glob("section-*.html"))
    assert len(sections) >= 2
    for size in ((1280, 800), (390, 844)):
        n_pictures = []
        for each in (page, *sections):
            (sizes, words) = ask(
                debugger, each, DRAWN, "[...document.images].map(i => i.alt)", size=size
            )
            assert min(sizes, default=100.0) > 80.0
            assert all(words)
            n_pictures.append(len(sizes))
        assert n_pictures[0] == 1 + sum(n_pictures[1:])  # the first figure and those of sections


CONTENTS = """
(() => {
  document.getElementById("provenance").scrollIntoView();
  const nav = document.querySelector("nav").getBoundingClientRect();
  const main = document.querySelector("main").getBoundingClientRect();
  return [nav.top, nav.right <= main.left, document.documentElement.scrollHeight];
})()
"""


def test_contents_stay_in_sight_beside_the_text_or_above_it(debugger, page):
    for width, is_beside in ((1280, True), (920, True), (860, False), (390, False)):
        ((top, found, height),) = ask(debugger, page, CONTENTS, size=(width, 800))
        assert top == 0.0
        assert found == is_beside
        assert height < 6000 or width < 900


def test_the_filter_shows_what_fits(debugger, page):
    choose = (
        "(() => {{ const form = document.getElementById('claims-filter');"
        "form.elements.{name}.value = {value!r};"
        "form.dispatchEvent(new Event('input', {{bubbles: true}}));"
        "return [...document.querySelectorAll('ol.claims > li')]"
        ".filter(c => c.offsetHeight > 0).length; }})()"
    )
    counts = ask(
        debugger,
        page,
        choose.format(name="verdict", value=VERDICTS[0]),
        choose.format(name="text", value="no such words"),
        choose.format(name="verdict", value=""),
        choose.format(name="text", value="fig. 2"),
    )
    assert counts == [1, 0, 0, 1]


def test_nothing_is_wider_than_a_phone(debugger, page):
    for each in (page, *(page.parent / "figures").glob("section-*.html")):
        (width,) = ask(debugger, each, "document.documentElement.scrollWidth", size=(380, 800))
        assert width <= 380


def test_the_answer_and_a_figure_are_on_the_first_screen(debugger, page):
    for size in ((1280, 800), (390, 844)):
        (row, width, hero) = ask(
            debugger,
            page,
            "document.querySelector('#answer tbody tr:last-child').getBoundingClientRect().bottom",
            "document.querySelector('#answer .scroll table').getBoundingClientRect().right",
            "document.querySelector('#figure-answer a').getBoundingClientRect().top",
            size=size,
        )
        assert row < hero < size[1] - 100
        assert width <= size[0]


def test_the_address_keeps_what_is_filtered(debugger, page):
    count = (
        "[...document.querySelectorAll('ol.claims > li')].filter(c => c.offsetHeight > 0).length"
    )
    write = (
        "(() => { const form = document.getElementById('claims-filter');"
        "form.elements.verdict.value = '';"
        "form.dispatchEvent(new Event('input', {bubbles: true})); return location.hash; })()"
    )
    shown, top, address = ask(
        debugger,
        page,
        count,
        "document.getElementById('claims').getBoundingClientRect().top",
        write,
        address=f"#claims?verdict={VERDICTS[1]}&text=fig",
    )
    assert shown == 1
    assert top < 100
    assert address == "#claims?verdict=&text=fig"


BOXES = """
(() => {
  const faults = [];
  for (const image of document.images) {
    const shown = 1000;
    const text = decodeURIComponent(image.src.slice(image.src.indexOf(",") + 1));
    const svg = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
    svg.setAttribute("width", shown);
    svg.removeAttribute("height");
    document.body.append(svg);
    const frame = svg.getBoundingClientRect();
    const said = [...svg.querySelectorAll("text")].filter((t) => t.textContent.trim());
    const boxes = said.map((t) => [t, t.getBoundingClientRect()]);
    boxes.forEach(([t, a], i) => {
      const parts = [t, ...t.querySelectorAll("tspan")];
      const size = Math.max(...parts.map((p) => parseFloat(getComputedStyle(p).fontSize)));
      const pixels = size * frame.width / svg.viewBox.baseVal.width;
      if (pixels < 10.5) faults.push(`${image.alt}: ${t.textContent} has ${pixels} px`);
      const outside = Math.max(frame.left - a.left, a.right - frame.right, frame.top - a.top,
        a.bottom - frame.bottom);
      if (outside > 2) faults.push(`${image.alt}: ${t.textContent} is cut`);
      for (const [u, b] of boxes.slice(0, i)) {
        const x = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const y = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        // Boxes hold the room of a line, which is higher than its letters.
        if (x > 1 && y > 3) faults.push(`${image.alt}: ${t.textContent} on ${u.textContent}`);
      }
    });
    svg.remove();
  }
  return faults;
})()
"""


def test_no_text_of_a_figure_lies_on_another_or_is_too_small(debugger, page):
    (faults,) = ask(debugger, page, BOXES)
    assert faults == []


# Every point of a grid over the first panel is pointed at, and what is said of it kept.
POINTED = """
(async () => {
  const canvas = document.querySelector("canvas"), box = canvas.getBoundingClientRect();
  do await new Promise(requestAnimationFrame); while (!canvas.dataset.y);
  const said = new Set();
  for (let x = 2; x < box.width; x += 4) for (let y = 2; y < box.height; y += 4) {
    const place = { clientX: box.left + x, clientY: box.top + y };
    canvas.dispatchEvent(new PointerEvent("pointermove", place));
    if (!document.getElementById("tooltip").hidden) said.add(tooltip.textContent);
  }
  return [...said];
})()
"""
HALVED = """
(async () => {
  const canvas = document.querySelector("canvas"), box = canvas.getBoundingClientRect();
  const frame = () => new Promise(requestAnimationFrame);
  const drawn = async () => { do await frame(); while (!canvas.dataset.x); await frame(); };
  const seen = () => canvas.dataset.x.replaceAll("\u2212", "-").split(" ").map(Number);
  await drawn();
  const views = [seen()];
  const middle = { clientX: (box.left + 62 + box.right - 12) / 2, clientY: box.top + 100 };
  const deltaY = Math.log(0.5) / Math.log(1.002);
  canvas.dispatchEvent(new WheelEvent("wheel", { deltaY, cancelable: true, ...middle }));
  await drawn(); views.push(seen());
  canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
  await drawn(); views.push(seen());
  canvas.dispatchEvent(new MouseEvent("dblclick"));
  await drawn(); views.push(seen());
  return views;
})()
"""
INK = """
(async () => {
  const isDrawn = (canvas) => canvas.dataset.y;
  while (![...document.querySelectorAll("canvas")].every(isDrawn)) {
    await new Promise(requestAnimationFrame);
  }
  return [...document.querySelectorAll("canvas")].map((canvas) => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let n = 0;
    for (let i = 3; i < data.length; i += 4) n += data[i] > 0;
    return n;
  });
})()
"""
OFF = """
[...document.querySelectorAll("#laws label")].find((l) => l.textContent === "tanh-1e4")
  .querySelector("input").click()
"""


@pytest.fixture(scope="module")
def hero(page):
    return page.parent / "figures" / "figure-answer.html"


def rows_of(hero):
    lines = hero.with_suffix(".csv").read_text().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    return [row for row in rows if row["panel"] == "1" and row["mark"] == "point"]


def named(said):
    """Series, x and y of every point that was told; those over one place are told together."""
    for text in said:
        x, y, *values = text.split("\n")
        assert y == "peak [mm]:"
        for value in values:
            series, _, height = value.rpartition(": ")
            yield series, x.removeprefix("forcing frequency [Hz]: "), height


def test_pointing_at_a_figure_names_every_point(debugger, hero):
    (said, _, without) = ask(debugger, hero, POINTED, OFF, POINTED)
    points = {(row["series"], row["x"], row["y"]) for row in rows_of(hero)}
    assert len(points) == 6
    assert set(named(said)) == points
    assert set(named(without)) == {each for each in points if each[0].startswith("piecewise")}


def test_the_wheel_zooms_arrows_move_and_a_double_click_resets(debugger, hero):
    ((whole, halved, moved, again),) = ask(debugger, hero, HALVED)
    middle = sum(whole) / 2
    quarter = (whole[1] - whole[0]) / 4
    assert halved == pytest.approx([middle - quarter, middle + quarter], rel=0.02)
    assert moved[0] > halved[0]
    assert moved[1] - moved[0] == pytest.approx(halved[1] - halved[0], rel=1e-3)
    assert again == whole


def test_every_figure_draws_its_data(debugger, page):
    pages = sorted((page.parent / "figures").glob("figure-*.html"))
    assert len(pages) > 10
    for each in pages:
        (inks,) = ask(debugger, each, INK)
        assert min(inks) > 500, each.name


def test_a_picture_comes_to_life_in_its_place(debugger, page):
    opened = """
    (async () => {
      document.querySelector("#figure-answer a.live").click();
      const frame = document.querySelector("#figure-answer iframe");
      await new Promise((done) => addEventListener("message", done));
      const heights = [frame.getBoundingClientRect().height, parseFloat(frame.style.height)];
      document.querySelector("#figure-answer .explore").click();
      const picture = document.querySelector("#figure-answer img").getBoundingClientRect();
      return [...heights, picture.height];
    })()
    """
    (heights,) = ask(debugger, page, opened)
    assert heights[0] > 300.0
    assert 100.0 < heights[2] < heights[0]  # the picture is back
    assert heights[0] == pytest.approx(heights[1], abs=1.0)


@pytest.fixture(scope="module")
def far_out(page, tmp_path_factory):
    """A figure whose axis is linear below .1 and logarithmic above, with ticks of its own."""
    figure = Figure()
    axes = figure.subplots()
    marks.put(axes, [marks.points(x=OMEGA, y=PEAKS, size=6.0, series="piecewise")])
    axes.set_yscale("symlog", linthresh=0.1)
    axes.set_yticks([0.0, 0.1, 0.3, 1.0, 3.0])
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set(ylim=(0.0, 8.0), xlabel="forcing frequency [Hz]", ylabel="peak [mm]")
    part = Part("far", "Far out", [], (), [Figured(figure, "Far out.", "Far out")])
    folder = tmp_path_factory.mktemp("far")
    study = tables(("piecewise",), (1.0, 2.0))
    responses, _ = datasets(folder, study, lambda *_: periodic([(1e-3, 0.0)], 1.0))
    inputs = Inputs(responses, timing(responses), sections=rendered([part]))
    write_report(folder / "index.html", inputs)
    (found,) = (folder / "figures").glob("figure-far*.html")
    return found


OMEGA, PEAKS = (1.0, 2.0, 3.0, 4.0), (0.05, 0.09, 0.4, 6.0)


def test_numbers_on_an_axis_with_ticks_of_its_own_are_told_as_they_are(debugger, far_out):
    (said, ends) = ask(debugger, far_out, POINTED, "document.querySelector('canvas').dataset.y")
    told = {(float(x), float(y)) for _, x, y in named(said)}
    assert told == set(zip(OMEGA, PEAKS, strict=True))
    assert [float(end) for end in ends.split()] == pytest.approx([0.0, 8.0], abs=0.05)


def test_any_case_of_a_study_can_be_chosen_for_the_first_figure(debugger, tmp_path):
    study = tables(("piecewise", "tanh-1e4"), (1.0, 2.0, 3.0))
    gaps = [0.4e-3, 0.5e-3, 0.6e-3]
    study["sweep"][0]["gap"] = [[gap, gap] for gap in gaps]

    def at(place):
        peak = 1e-3 * (1 + place["gap"] + 0.2 * place["representation"])
        return periodic([(peak, 0.0)], 1.0 + place["omega"])

    responses, attractors = datasets_by_place(tmp_path, Study.from_dict(study), at)
    compared = agreement(responses, attractors)
    inputs = Inputs(responses, timing(responses), compared, attractors)
    write_report(tmp_path / "index.html", inputs)
    page = tmp_path / "figures" / "figure-answer.html"
    choose = """
      const select = document.getElementById("case");
      const drawn = () => document.querySelector("#panels canvas").dataset.y;
      const options = [...select.options].map((one) => one.text);
      const ends = [];
      for (const n of [0, 1, 2]) {
        select.value = n;
        select.dispatchEvent(new Event("change"));
        await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
        ends.push(drawn().split(" ").map(Number));
      }
      return [options, ends];
    """
    ((options, ends),) = ask(debugger, page, f"(async () => {{{choose}}})()")
    assert [text.split(", ")[-1] for text in options[1:]] == [
        f"{1e3 * g:g}/{1e3 * g:g} mm" for g in gaps
    ]
    for n, (low, high) in enumerate(ends):
        assert low < 1.0 + n
        assert 1.2 * n < high <= 2.0 * (1.0 + n)
