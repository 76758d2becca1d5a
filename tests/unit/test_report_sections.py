"""The report: its sentences follow from the data, and no text of a user's becomes markup."""

import csv
import json
import re
import subprocess
from dataclasses import fields, replace
from html import unescape
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from tests.builders.datasets import (
    branches,
    chaotic,
    datasets,
    datasets_by_place,
    failed,
    periodic,
    tables,
)
from tests.builders.studies import PAPER, TWO_MASSES, changed

from gapsweep.analysis.agreement.comparison import agreement
from gapsweep.analysis.datasets.timing import timing
from gapsweep.errors import StoreError
from gapsweep.model.labels import Representation, contact_law
from gapsweep.model.laws import LAWS
from gapsweep.model.oscillator import Gap
from gapsweep.report import marks
from gapsweep.report.contents import SECTIONS
from gapsweep.report.figure_data import as_csv
from gapsweep.report.heat import cell, heads, heat, swept_columns
from gapsweep.report.html import write_report
from gapsweep.report.inputs import Inputs
from gapsweep.report.links import Links, for_page
from gapsweep.report.parts import Figured, Part, Table, rendered
from gapsweep.report.pictures import is_picture, pictures
from gapsweep.report.scales import NamedValue
from gapsweep.report.sections import answer, findings, force_errors, provenance
from gapsweep.report.sections import model as model_section
from gapsweep.report.sections.claim_list import claim_rows, outcome
from gapsweep.report.style import MATPLOTLIB
from gapsweep.report.style import colour as colour_of
from gapsweep.report.tables import (
    VERDICTS,
    number,
    percent,
    special_points,
)
from gapsweep.report.verdicts import Contact, Judged, contacts, in_words, telling
from gapsweep.run_folder import is_of_run
from gapsweep.stages import PAGE
from gapsweep.status import Status
from gapsweep.store.artefact import SUMS, sha256
from gapsweep.study.study import Study


def found_in(responses, **files):
    """The findings of some files of a run."""
    (part,) = findings.sections(Inputs(responses, xr.Dataset(), **files))
    return part.sentences


def model(responses):
    (part,) = model_section.sections(Inputs(responses, xr.Dataset()))
    return part.content["pairs"]


def results(inputs):
    """The parts under the heading of results."""
    return [part for section in SECTIONS if section.group for part in section.parts(inputs)]


LABELS = ("piecewise", "piecewise@half", "tanh-1e4", "poly-13")
OMEGA = (1.0, 2.0, 3.0, 4.0)
HALF = {"protocol": {"half": {"rtol": 5e-10}}}
HOSTILE = '"><img src=x onerror=alert(1)><script>alert(2)</script>'


def amplitudes(sizes):
    """An answer: a periodic response whose amplitude [mm] is the label's."""

    def answer(label, omega, start):
        size = sizes[label]
        return failed() if size is None else periodic([(size * 1e-3, 0.0)], omega)

    return answer


def made(folder, sizes, **more):
    responses, attractors = datasets(
        folder, tables(LABELS, OMEGA, **HALF, **more), amplitudes(sizes)
    )
    return responses, agreement(responses, attractors)


def in_own_units(responses):
    """The responses, as of a system with contacts in different units."""
    plain = responses.assign(force_max=responses["force_max"].drop_attrs())
    return plain.assign_attrs(system_json="{}")


EQUAL = {"piecewise": 1.0, "piecewise@half": 1.001, "tanh-1e4": 1.02, "poly-13": 1.3}


def test_a_page_is_made_from_the_fields_of_inputs():
    named = {field.name for field in fields(Inputs)}
    assert named == {file.partition(".")[0] for file in PAGE.inputs}


@pytest.mark.parametrize(
    ("lost", "titles"),
    [
        ({}, {"Answer", "Findings", "Model", "Provenance", "Claims", "Force errors"}),
        ({"claims": None}, {"Claims"}),
        ({"static": None}, {"Force errors"}),
        ({"agreement": None}, {"Answer"}),
    ],
)
def test_a_section_lacks_only_where_its_files_do(run, lost, titles):
    responses, attractors = run
    whole = Inputs(
        responses, timing(responses), agreement(responses, attractors),
        static=static_of([0.0, 1e-4, 0.2]), claims=decided(),
    )  # fmt: skip

    def shown(inputs):
        return {part.title for section in SECTIONS for part in section.parts(inputs)}

    every = shown(whole)
    assert titles <= every
    assert every - shown(replace(whole, **lost)) == (titles if lost else set())


def test_failures_are_counted_once_and_never_ranked(tmp_path):
    responses, compared = made(tmp_path, EQUAL | {"poly-13": None})
    found = contacts(compared)
    sentences = found_in(responses, agreement=compared)
    assert sentences[0] == (
        "16 sweep points: 12 periodic, 0 chaotic, 0 unresolved and 4 without a steady response "
        "(4 diverged)."
    )
    assert {one.law: one.verdict for one in found[0].laws} == {"tanh-1e4": "use", "poly-13": "no"}


def touching(folder, gaps):
    """Datasets of some gaps [m]; the exact law touches walls nearer than 1 mm, at one frequency."""
    study = tables(LABELS, OMEGA, **HALF)
    study["sweep"][0]["gap"] = [[gap, gap] for gap in gaps]

    def at(place):
        size, omega = EQUAL[LABELS[place["representation"]]] * 1e-3, OMEGA[place["omega"]]
        is_touched = gaps[place["gap"]] < 1e-3 and omega == OMEGA[-1]
        return periodic(
            [(size, 0.0)],
            omega,
            contact_share=0.5 * is_touched,
            contacts_per_period=2.0 * is_touched,
        )

    return datasets_by_place(folder, Study.from_dict(study), at)


@pytest.mark.parametrize(
    ("gaps", "n_judged", "said"),
    [
        ((0.1, 0.2), 0, ("The wall is never reached: ", "1 mm, gap 100 mm; gaps are in metres")),
        ((0.4e-3, 0.1), 1, ("The wall is never reached in 1 of 2 cases: ", "1 mm; gaps are in ")),
        ((0.4e-3, 0.5e-3), 2, ()),
    ],
)
def test_no_law_is_judged_by_a_wall_that_the_exact_law_never_touches(
    tmp_path, gaps, n_judged, said
):
    """As where gaps are meant in millimetres; one touch at one frequency is enough."""
    responses, attractors = touching(tmp_path, gaps)
    compared = agreement(responses, attractors)
    (top,) = answer.sections(Inputs(responses, xr.Dataset(), compared))
    sentences = found_in(responses, agreement=compared)
    assert [len(rows) > 1 for _, rows in top.content["numbers"]] == [gap < 1e-3 for gap in gaps]
    for part in said:
        assert part in top.sentences[0]
        assert part in sentences[0]
    texts = " ".join([*sentences, *top.sentences, *top.content["sentences"]])
    assert ("never reached" in texts) == bool(said)
    assert ("cannot be judged" in texts) == bool(said)
    for _, groups in top.content["map"]["rows"]:
        assert sum(map(bool, groups["error"])) == n_judged
    assert "adequate" not in top.sentences[0] or n_judged
    own = in_own_units(responses)
    assert "never reached" not in " ".join(found_in(own))


def test_several_attractors_are_told(tmp_path):
    def answer(label, omega, start):
        return periodic([((1.0 + start * (omega > 2.0)) * 1e-3, 0.0)], omega)

    responses, attractors = datasets(tmp_path, tables(LABELS, OMEGA, starts=2, **HALF), answer)
    said = found_in(responses, attractors=attractors)
    assert re.findall("[0-9]+", said[-1]) == ["2", "4", "2"]


@pytest.mark.parametrize(
    ("starts", "sweeps", "n"),
    [(1, (), "1"), (3, ("sweep_up",), "4"), (0, ("sweep_up", "sweep_down"), "2")],
)
def test_initial_conditions_that_were_tried_are_counted(tmp_path, starts, sweeps, n):
    study = tables(LABELS, OMEGA, starts=max(starts, 1), sweeps=sweeps, **HALF)
    study["sweep"] = study["sweep"][1:] if starts == 0 else study["sweep"]
    responses, _ = datasets(tmp_path, study, lambda label, w, start: periodic([(1e-3, 0.0)], w))
    tried = found_in(responses)[1]
    assert re.findall("[0-9]+", tried.split(";")[0]) == [n]
    assert ("coexisting" in tried) == (starts == 0)


@pytest.mark.parametrize(("starts", "some"), [(1, ""), (2, " from some initial conditions")])
def test_where_a_curve_is_chaotic_is_told(tmp_path, starts, some):
    omega = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.0)
    wild = {0.5, 1.5, 2.0, 3.0, 4.0, 4.5, 5.0, 6.0}

    def answer(label, at, start):
        is_wild = label == "piecewise" and at in wild and start == starts - 1
        return (chaotic if is_wild else periodic)([(1e-3, 0.0)], at)

    def said(omega):
        responses, _ = datasets(
            tmp_path / str(len(omega)), tables(LABELS, omega, starts=starts, **HALF), answer
        )
        return [text for text in found_in(responses) if "is chaotic" in text]

    assert said(omega) == [
        f"piecewise is chaotic{some} at omega [Hz] 0.5, 1.5 to 2, 4 to 5 and 2 more."
    ]
    assert said(omega[1:8]) == []  # too few for a curve


def test_laws_of_systems_are_judged_by_their_worst_coordinate(tmp_path):
    """The verdicts of an oscillator with the errors of the coordinate that has larger ones."""
    _, compared = made(tmp_path, {**EQUAL, "poly-13": 1.3})
    good = compared.load()
    errors = [name for name in good if "error" in str(name)]
    bad = good.assign({name: 5.0 * good[name] for name in errors})
    several = xr.concat([good, bad], "coordinate").assign_attrs(
        compared.attrs, system_json='{"contacts": {}}'
    )
    several["j_1"].attrs["units"] = "rad"
    (one,), (both,), (worse,) = map(contacts, (good, several, bad))
    assert one.place == "14000 N/m, 0.4/0.4 mm"
    assert both.place.startswith("K_c 14000, gap ")
    verdicts = [[law.verdict for law in each.laws] for each in (one, both, worse)]
    assert verdicts == [["use", "no"], ["with care", "no"], ["with care", "no"]]


def test_left_fit_ranges_are_told_from_missing_responses(tmp_path):
    def answer(label, omega, start):
        outside = Status.OUT_OF_FIT_RANGE
        if omega < 2.0:
            return failed(status=outside)
        return periodic([(1e-3, 0.0)], omega, status=outside if omega > 3.0 else Status.OK)

    responses, _ = datasets(tmp_path, tables(["poly-13"], OMEGA), answer)
    assert found_in(responses)[0].endswith(
        "and 1 without a steady response (1 out of fit range); "
        "1 with a steady response beyond the range of their fit."
    )
    both = [responses, responses.assign_coords(representation=["mine:table"])]
    both = xr.concat(both, "representation", coords="minimal", compat="override")
    assert found_in(both)[0].endswith(
        "; 1 with a steady response beyond the range of their fit"
        "; 1 with a steady response beyond the table's ends."
    )


PLACES = ("Fig. 1", "Fig. 2", "Table 3", "Sect. 4")


def decided(sentence="Holds."):
    tests = [
        {
            "says": HOSTILE,
            "value": 1.0,
            "floor": None,
            "op": "<=",
            "threshold": 2.0,
            "holds": holds,
            "n": 3,
        }
        for holds in (True, False, None)
    ]
    claims = [
        {
            "id": i,
            "place": PLACES[i - 1],
            "claim": HOSTILE,
            "verdict": verdict,
            "sentence": sentence,
            "why": HOSTILE,
            "tests": tests,
        }
        for i, verdict in enumerate(VERDICTS, start=1)
    ]
    counts = dict.fromkeys(VERDICTS, 1)
    return {"counts": counts, "otherwise": {HOSTILE: counts}, "claims": claims}


PART = {
    "anchor": "own-hostile",
    "title": HOSTILE,
    "sentences": [HOSTILE],
    "tables": [{"title": HOSTILE, "header": [HOSTILE], "rows": [[HOSTILE]]}],
    "figures": [
        dict.fromkeys(
            ("svg", "caption", "description"), f"<svg><script>alert(3)</script>{HOSTILE}</svg>"
        )
    ],
}


SOUND = '<svg xmlns="http://www.w3.org/2000/svg" width="684pt" height="72pt"></svg>'
NAMED = [
    PART
    | {
        "anchor": f"own-table-{i}",
        "title": f"The paper's Table {i}",
        "figures": [
            dict.fromkeys(("svg", "caption", "description"), SOUND)
            | {"name": name, "json": "no such code", "csv": "AAAA"}
            for name in ("Fig. 1", "Fig. 2b", "Fig. 2a", "Fig. 2a")
            if i == 3
        ],
    }
    for i in (3, 5)
]


def static_of(errors, K_c=(1.4e4,)):
    """A part of ``static.nc``: force errors of `LABELS` without protocols, by stiffness."""
    dims = ("representation", "K_c", "gap")
    attributes = {"visited": "by the exact law's responses"}
    return xr.Dataset(
        {
            "tanh_threshold": (dims[1:], [[72488.0]] * len(K_c)),
            "force_error_ratio": (dims, np.reshape(errors, (3, len(K_c), 1)), attributes),
        },
        {
            "representation": ["piecewise", "tanh-1e4", "poly-13"],
            **{"K_c": ("K_c", [*K_c], {"units": "N m-1"}), "gap": ["0.4/0.4"]},
        },
    )


@pytest.mark.parametrize(
    ("K_c", "errors", "header", "rows"),
    [
        (
            (1.4e3, 1.4e4),
            [0, 0, 1e-3, 1.01e-3, 0.099, 0.1],
            [f"K_c = {K_c} N/m, gap 0.4/0.4 mm" for K_c in (1400, 14000)],
            [["tanh-1e4", "✓ 0.001", "◐ 0.00101"], ["poly-13", "◐ 0.099", "✗ 0.1"]],
        ),
        # A case that was not swept, and a law without a number.
        (
            (1.4e3, 1.4e4),
            [0, np.nan, 0.2, np.nan, np.nan, np.nan],
            ["K_c = 1400 N/m, gap 0.4/0.4 mm"],
            [["tanh-1e4", "✗ 0.2"]],
        ),
        (
            [1e3 * n for n in range(9)],
            [*[0] * 9, *[1e-4] * 4, *[0.01] * 3, 0.5, 0.6, *[np.nan] * 9],
            ["Range", "accurate", "between", "too coarse"],
            [["tanh-1e4", "1e-4 to 0.6", "4", "3", "2"]],
        ),
    ],
)
def test_force_errors_are_judged_by_the_rule(K_c, errors, header, rows):
    """At most 0.001 is accurate, 0.1 and more is too coarse: docs/explanation/rule.md."""
    (part,) = force_errors.sections(
        Inputs(xr.Dataset(), xr.Dataset(), static=static_of(errors, K_c))
    )
    (table,) = part.tables
    assert table.header == ["Representation", *header]
    assert table.rows == rows
    assert "at most 0.001;" in part.sentences[1]
    assert "visited by the exact law" in part.sentences[0]


def test_without_a_forcing_there_are_no_force_errors():
    assert [
        *force_errors.sections(Inputs(xr.Dataset(), xr.Dataset(), static=static_of([np.nan] * 3)))
    ] == []


def written(folder, responses, attractors, sections):
    inputs = Inputs(
        responses,
        timing(responses),
        agreement(responses, attractors),
        static=static_of([0.0, 1e-4, 0.2]),
        claims=decided(),
        sections=sections,
    )
    return write_report(folder / "report" / "index.html", inputs, HOSTILE)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Datasets of a run, with texts that try to become markup."""
    study = tables(LABELS, OMEGA, **HALF)
    study["solver"] = {"engine": "compiled", "rtol": 1e-9}
    study["study"] = {"name": "made", "title": HOSTILE + "\u202eright to left" + "x" * 9000}
    return datasets(tmp_path_factory.mktemp("run"), study, amplitudes(EQUAL))


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    answer = {**PART, "anchor": "own-answer", "sentences": [HOSTILE, "second"]}
    return written(tmp_path_factory.mktemp("report"), *run, [answer, PART, *NAMED])


@pytest.fixture(scope="module")
def long_page(run, tmp_path_factory):
    """A report of many figures, in a folder with files of an earlier report and of the user."""
    folder = tmp_path_factory.mktemp("long")
    figures = folder / "report" / "figures"
    figures.mkdir(parents=True)
    for name in (*EARLIER, "figure-notes.txt", "notes.svg"):
        (figures / name).touch()
    (figures / "figure-folder.svg").mkdir()
    (folder / "mine.svg").touch()
    (figures / "figure-linked.svg").symlink_to(folder / "mine.svg")
    many = NAMED[0] | {"anchor": "own-many", "figures": 3 * NAMED[0]["figures"], "sentences": []}
    return written(folder, *run, [*NAMED, PART, many])


EARLIER = ("figure-2b-9.svg", "figure-old.html", "section-old.html")
NOT_OURS = {"figure-notes.txt", "notes.svg", "figure-folder.svg", "figure-linked.svg"}


def links(path):
    """Files and ids that a page links to; an address without a file is of the page itself."""
    for link in re.findall(r'href="([^"]*)"', path.read_text()):
        place, _, anchor = link.partition("?")[0].partition("#")
        if not place.startswith(("data:", "http")):
            yield (path.parent / place).resolve() if place else path, anchor


def test_every_link_of_a_long_report_leads_to_what_is_there(long_page):
    figures = long_page.parent / "figures"
    pages = [long_page, *figures.glob("section-*.html"), *figures.glob("figure-*.html")]
    assert len(pages) > len(NAMED) + 3
    for path in pages:
        for target, anchor in links(path):
            assert target.is_file(), (path.name, target)
            assert not anchor or f'id="{anchor}"' in target.read_text(), (path.name, anchor)
    reached = {target for path in pages for target, _ in links(path)}
    ours = {path for path in figures.iterdir() if path.name not in NOT_OURS | {SUMS}}
    assert ours <= reached
    own = {path.name for path in figures.glob("figure-2*")}
    assert not own & set(EARLIER)
    assert {line.split()[1] for line in (figures / SUMS).read_text().splitlines()} == {
        path.name for path in ours
    }
    assert {path.name for path in figures.iterdir()} >= NOT_OURS


def test_a_long_report_has_each_section_on_a_page_of_its_own(long_page, page):
    text = long_page.read_text()
    assert len(re.findall("<figcaption>", text)) == 1  # of the first figure
    assert text.count("<img") == 1 + 4 + 12 + 2
    cells = re.findall(r'<td class="error[^>]*><a href="([^"]*)"', text)
    assert cells == ["figures/section-scene-0-0.html"] * 2
    part = (long_page.parent / "figures" / "section-scene-0-0.html").read_text()
    assert len(re.findall("<figcaption>", part)) == 2
    assert "Agreement with the exact law" in part
    assert "Agreement with the exact law" not in text
    assert not list(page.parent.glob("figures/section-*"))


def test_the_studys_own_answer_comes_before_that_of_the_rules(page):
    first = page.read_text().partition('class="answer">')[2]
    assert "<img" not in first.partition("</p>")[0]
    assert first.partition("</p>")[2].strip().startswith("<p>second</p>")
    assert "adequate in the only case" in first.partition("<details>")[2]


def test_the_studys_own_answer_needs_no_exact_law(run):
    table = {"title": "T", "header": ["h"], "rows": [["1"]]}
    own = PART | {"anchor": "own-answer", "sentences": ["Mine."], "tables": [table]}
    (part,) = answer.sections(Inputs(run[0], xr.Dataset(), sections=[own]))
    assert part.sentences == ["Mine."]
    assert [one.title for one in part.tables] == ["T"]
    assert part.content["map"] is None
    assert [*answer.sections(Inputs(run[0], xr.Dataset()))] == []


@pytest.mark.parametrize("law", ["tanh-1e4", "poly-13"])
def test_numbers_on_tanh_are_shown_only_where_it_was_tried(tmp_path, law):
    study = tables(["piecewise", "piecewise@half", law], OMEGA, **HALF)
    responses, attractors = datasets(tmp_path, study, amplitudes(EQUAL))
    inputs = Inputs(responses, timing(responses), agreement(responses, attractors))
    text = write_report(tmp_path / "report" / "index.html", inputs).read_text()
    behind = text.partition("Numbers behind the map")[2].partition("</table>")[0]
    assert law in behind
    assert ("tanh" in behind) == (law == "tanh-1e4")
    assert ("\ntanh: the range" in text) == (law == "tanh-1e4")


@pytest.mark.parametrize("kind", ["tables", "figures"])
def test_the_studys_own_answer_needs_no_sentence(run, tmp_path, kind):
    responses = run[0]
    table = {"title": "Only table", "header": ["h"], "rows": [["1"]], "notes": []}
    nothing = {"title": "A", "sentences": [], "tables": [], "figures": [], "content": {}}
    contents = {"tables": [table], "figures": [NAMED[0]["figures"][0] | {"caption": "Only figure"}]}
    own = nothing | {"anchor": "own-answer", kind: contents[kind]}
    inputs = Inputs(responses, timing(responses), sections=[own])
    text = write_report(tmp_path / "report" / "index.html", inputs).read_text()
    assert f"Only {kind[:-1]}" in text.partition('id="answer"')[2].partition("</section>")[0]


def test_rows_of_laws_have_the_colour_of_the_law_that_they_begin_with(run, tmp_path):
    """Other texts of a study have none."""
    rows = ["tanh-1e4", "tanh-1e4, K_ratio = 0.5", "exact law, other settings", "tanh-soft", "mean"]
    table = Table("T", ["Representation"], [[row] for row in rows])
    page = written(tmp_path, *run, rendered([Part("own-t", "T", [], [table])])).read_text()
    found = dict.fromkeys(rows, "")
    for colour, row in re.findall(
        r'class="swatch" style="background:([^"]*)"></span>([^<]*)', page
    ):
        found[row] = colour
    of_law = [*map(colour_of, ("tanh-1e4", "tanh-1e4", "piecewise"))]
    assert list(found.values())[:5] == [*of_law, "none", "none"]


def test_hostile_texts_stay_texts(page):
    text = page.read_text()
    assert "<img src=x" not in text
    assert "alert(3)" not in text
    assert text.count("<script>") == 3  # of figures, answer and claims
    assert "&lt;script&gt;alert(2)" in text


def test_data_of_a_figure_cannot_end_their_element(run, tmp_path):
    figure = Figure()
    marks.put(figure.subplots(), [marks.points(x=[1.0], y=[1.0], series=HOSTILE)])
    figure.axes[0].set_title("</script>", loc="left")
    own = rendered([Part("part", "Part", [], figures=[Figured(figure, HOSTILE, HOSTILE)])])
    page = written(tmp_path, *run, own)
    text = (page.parent / "figures" / "figure-part.html").read_text()
    assert text.count("</script>") == 2
    assert "<img src=x" not in text
    assert r"\u003c/script>" in text


def test_the_answer_comes_first_in_words_and_as_a_map(page):
    text = page.read_text()
    order = ["<main", 'id="answer"', 'class="heat"', 'id="figure-answer"', 'id="results"']
    places = [text.index(part) for part in (*order, 'id="claims"', 'id="provenance"')]
    assert places == sorted(places)
    first = text[places[1] : text.index("<details>")]
    cells = re.findall(
        r'<td class="error[^>]*><a href="#(.*?)" title="(.*?)"[^>]*>(.*?)</a>', first
    )
    (anchor, said, tanh), (_, _, poly) = cells
    assert anchor == "scene-0-0"
    assert said.startswith("14000 N/m, 0.4/0.4 mm: tanh-1e4 ± is accurate enough: 95 % of")
    assert [re.sub("<[^>]+>", "", cell) for cell in (tanh, poly)] == ["✓2", "✗30"]
    assert "one static equilibrium: ε &gt; 72000" in text
    assert "exact law, other settings" in text[text.index("<details>") :]


def contact(laws, **where):
    """A contact where each law has a verdict, an error, a share found and a cost ratio."""
    judged = [
        Judged(
            Representation(law),
            {"median": np.array([error]), "p95": np.array([error]), "found": np.array([share])},
            9, said, frozenset({said}), cost_ratio, cost_ratio, cost_ratio,
        )
        for law, (said, error, share, cost_ratio) in laws.items()
    ]  # fmt: skip
    return Contact(**{"K_c": 1.4e4, "gap": "0/1", **where}, floors={}, laws=judged, threshold="?")


@pytest.mark.parametrize(("more", "n_cubic"), [({"alpha": 0.0}, 0), ({"alpha": 7e8, "c": 1.0}, 1)])
def test_the_equation_has_the_terms_that_are_not_zero(tmp_path, more, n_cubic):
    study = tables(["piecewise"], (1.0,))
    study["oscillator"] = {**study["oscillator"], "mean_load": 0.0, **more}
    responses, _ = datasets(tmp_path, study, lambda *_: periodic([(1e-3, 0.0)], 1.0))
    told = dict(model(responses))
    assert told["Equation"].count("x³") == n_cubic
    assert told["Equation"].count("c / m") == ("c" in more)
    assert "p₀" not in told["Equation"]
    assert ("α" in told["Numbers"]) == bool(n_cubic)


def test_of_many_cases_those_that_tell_most_are_listed():
    """In turn the largest error, the most lost attractors, the most chaos; in their own order."""
    plain = {"tanh-1e4": ("use", 0.01, 1.0, 2.0)}
    found = [contact(plain, K_c=1e3 * (n + 1)) for n in range(40)]
    found[7] = contact({"tanh-1e4": ("no", 0.9, 1.0, 2.0)}, K_c=8e3)
    found[21] = contact({"tanh-1e4": ("no", 0.02, 0.1, 2.0)}, K_c=22e3)
    found[33] = contact(plain, K_c=34e3, n_chaotic=5)
    assert [case.K_c for case in telling(found, 3)] == [8e3, 22e3, 34e3]
    assert len(telling(found)) == 16
    (headline,) = in_words(found)
    assert "tanh-1e4 for 38 cases; none of those computed for 2 cases" in headline


def test_the_frequencies_at_which_the_machine_touches_are_stated(tmp_path):
    def at(label, omega, start):
        meets = 2.0 <= omega <= 4.0
        return periodic([(1e-3, 0.0)], omega, contact_share=0.1 * meets, force_max=1.0 * meets)

    omega = (1.0, 2.0, 3.0, 4.0, 5.0)
    responses, _ = datasets(tmp_path, tables(LABELS, omega, starts=2, **HALF), at)
    (said,) = (text for text in found_in(responses) if "touches" in text)
    assert "6 of 10" in said
    assert "at omega [Hz] 2 to 4" in said


def test_the_map_is_darker_where_a_law_is_worse():
    near, far = ("use", 0.01, 0.99, 3.0), ("no", 0.4, 0.2, 0.5)
    soft = contact({"poly-13": far, "tanh-1e4": near}, at={"K_c": 0, "gap": 1})
    ((_, (failed_throughout,)),) = heat([contact({"poly-21": ("no", np.nan, 0.0, np.nan)})])
    assert cell(failed_throughout, "error")[1] == 1.0
    hard = contact({"tanh-1e4": ("with care", 0.1, 0.7, 9.0)}, K_c=1.4e6)
    (law, first), (other, second) = heat([soft, hard])
    assert (law, other) == ("tanh-1e4", "poly-13")
    assert [cell(one, "error")[0] for one in first] == ["1", "10"]
    assert [cell(one, "found")[0] for one in first] == ["99", "70"]
    assert [cell(one, "cost")[0] for one in first] == ["3", "–"]  # of equal errors alone
    assert second[1] is None
    assert soft.anchor == "scene-0-1"
    for group in ("error", "found"):
        good, fair, bad = (cell(one, group)[1] for one in (*first, second[0]))
        assert 0.0 < good < fair < bad < 1.0
    assert heads([soft.K_c, soft.K_c, hard.K_c]) == [(1.4e4, 2), (1.4e6, 1)]


def test_what_is_swept_beside_contacts_is_named_once():
    zeta = NamedValue("zeta", "0.1", "")
    both = [contact({}, swept=[NamedValue("forcing", force, "N"), zeta]) for force in ("1", "2.5")]
    assert swept_columns(both) == ("forcing [N], zeta", ["1, 0.1", "2.5, 0.1"])


def test_solvers_are_told_with_what_they_take_from_elsewhere(tmp_path):
    responses, _ = made(tmp_path, EQUAL)
    study = json.loads(responses.attrs["study_json"]) | {
        "solver": {"controller": "ode45", "restart": True, "rtol": 1e-4},
        "protocol": {
            "off": {"restart": False, "start_jitter": 0.0},
            "written": {"contact_force": "as_written"},
            "moved": {"start_jitter": 1e-9},
        },
    }
    responses = responses.assign_attrs(study_json=json.dumps(study))
    (part,) = provenance.sections(Inputs(responses, xr.Dataset()))
    told = dict(part.content["pairs"])
    usual = "engine compiled, rtol 0.0001, atol rtol × static deflection, controller ode45"
    assert told["Solver"] == f"{usual}, restart True, contact_force by_mode"
    assert told["Solver of @off"] == f"{usual}, contact_force by_mode"
    assert told["Solver of @written"] == f"{usual}, restart True, contact_force as_written"
    assert told["Solver of @moved"] == f"{told['Solver']}, start_jitter 1e-9"


def test_the_model_of_a_system_is_what_its_function_made():
    study = Study.from_dict(
        {
            "study": {"name": "gears"},
            "system": {"function": "gear_pair"},
            "parameters": {"mean_load": 0.3},
            "sweep": [
                {"representation": ["piecewise"], "K_c": 1.0, "gap": [1.0, 1.0], "omega": 0.2}
            ],
        }
    )
    coords = {"representation": ["piecewise"], "K_c": [1.0], "gap": ["1/1"]}
    responses = xr.Dataset({"x_max": 0.1}, coords, study.attributes)
    told = model(responses)
    assert ("M at mean_load = 0.3", "[[1]]") in told
    assert ("Load", "[0.3]") in told
    assert ("Load", "[0.004] (4πω)² cos(4πωt)") in told
    assert ("b of mesh", "[1]") in told
    assert dict(told)["F of mesh"].startswith("times 1 + -0.2 cos(2πωt)")
    assert dict(told)["j₁/j₂"] == "1/1"
    assert dict(told)["r"].startswith("1 (stiffness of the lower wall")
    one_sided = responses.assign_coords(K_ratio=[0.0], representation=["tanh-1e4"])
    told = dict(model(one_sided))
    assert told["r"] == "0 (stiffness of the lower wall / K_c); 0: no lower wall"
    assert "ε [1/unit of x] in its name" in told["F of tanh"]


def test_loads_and_matrices_of_a_system_are_written_out():
    loads = [
        {"amplitude": [2.0, -0.0], "k": k, "phase": phase}
        for k, phase in ((0, 0.0), (0, 0.5), (1, 0.0), (3, 0.5))
    ]
    damping = [[0.5, -0.0], [-0.0, 2e-7]]
    study = Study.from_dict(changed(TWO_MASSES, system__forcing=loads, system__damping=damping))
    coords = {"representation": ["piecewise"], "K_c": [10.0], "gap": ["0.1/0.2"]}
    told = model(xr.Dataset({"x_max": 0.1}, coords, study.attributes))
    cosines = ["", " cos(0.5)", " cos(2πωt)", " cos(6πωt + 0.5)"]
    assert [text for name, text in told if name == "Load"] == [f"[2, 0]{each}" for each in cosines]
    assert dict(told)["C"] == "[[0.5, 0], [0, 2e-7]]"


def test_a_contact_of_its_own_numbers_is_told():
    study = Study.from_dict(TWO_MASSES)
    coords = {"representation": ["piecewise"], "K_c": [10.0], "gap": ["0.1/0.2"]}
    responses = xr.Dataset({"x_max": 0.1}, coords, study.attributes)
    told = dict(model(responses))
    assert told["Only between"] == "K_c 50, j₁/j₂ 0.5/0.4, r 2"
    assert "Of stop alone" not in told


def test_the_model_is_told_with_the_numbers_that_a_run_used(tmp_path):
    study = tables(("piecewise", "piecewise@half", "tanh-1e4", "tanh-1e6"), OMEGA, **HALF)
    study["oscillator"] = PAPER | {"zeta": 0.07}
    study["sweep"][0] |= {"forcing": [1.5, 2.5], "K_ratio": [0.5], "K_c": [2e4]}
    responses, _ = datasets(tmp_path, study, lambda *_: periodic([(1e-3, 0.0)], 1.0))
    told = dict(model(responses))
    # Each law once, whatever its settings or parameter.
    assert list(told) == ["Equation", "Numbers", "F of piecewise", "F of tanh"]
    assert told["F of piecewise"].startswith("K_c (x − j₂)")
    for told_of in (
        "ζ 0.07,",
        "p 1.5, 2.5 N",
        "K_c 20000 N/m",
        "r 0.5 (stiffness of the lower",
        "ω 1, 2, 3, 4 Hz",
    ):
        assert told_of in told["Numbers"]
    assert "0.4/0.4 mm" in told["Numbers"]
    users = responses.assign_coords(representation=["piecewise", "mine:spring", *"ab"])
    assert dict(model(users.isel(representation=[0, 1])))["F of mine:spring"] == "user-defined"
    tables_json = json.dumps({"mine:spring": {"points": 7, "low": -1e-3, "high": 2.5e-3}})
    measured = users.isel(representation=[0, 1]).assign_attrs(tables_json=tables_json)
    assert dict(model(measured))["F of mine:spring"].startswith(
        "a table of 7 points from −1 to 2.5 mm,"
    )
    del study["sweep"][0]["gap"]
    study["sweep"][0] |= {"j_1": 0.4e-3, "j_2": [0.4e-3, 0.8e-3]}
    responses, _ = datasets(tmp_path / "j", study, lambda *_: periodic([(1e-3, 0.0)], 1.0))
    assert "j₁ 0.4 mm, j₂ 0.4, 0.8 mm" in dict(model(responses))["Numbers"]


def test_the_first_figure_shows_a_law_of_each_verdict_or_the_best_and_the_worst():
    use, better, no = ("use", 0.02, 1.0, 1.0), ("use", 0.01, 1.0, 2.0), ("no", 0.3, 0.5, 1.0)
    both = answer.panels_of(contact({"tanh-1e4": use, "tanh-1e6": better, "poly-13": no}))
    assert [one.verdict for one in both] == ["use", "no"]
    alike = answer.panels_of(contact({"tanh-1e4": use, "tanh-1e6": better}))
    assert [one.law for one in alike] == ["tanh-1e6", "tanh-1e4"]


def numbers_of(part):
    """Rows of all figures of a section."""
    for figured in part.figures:
        lines = as_csv(figured.figure).splitlines()
        yield from csv.DictReader(line for line in lines if line[0] != "#")


def test_numbers_of_the_map_fit_a_phone():
    for error in (0.0, 1e-9, 3.14159e-4, 0.0123, 0.0996, 1.23, 99.0, np.nan):
        (one,) = contact({"tanh-1e4": ("no", error, 0.5, 1.0)}).laws
        assert len(cell(one, "error")[0]) <= 4


def test_tables_of_a_section_of_the_studys_own_are_before_its_figures(page):
    text = page.read_text()
    section = re.search(r'<section id="own-table-3">.*?</section>', text, re.S)[0]
    assert section.index("<table") < section.index("<figure")
    scene = re.search(r'<section id="scene-0-0">.*?</section>', text, re.S)[0]
    assert scene.index("<figure") < scene.index("<table")
    assert text.count("The paper&#39;s Table 3</h3>") == 1


def test_claims_lead_to_what_they_are_about(page, long_page):
    leads = [("figure-1", "Fig. 1"), ("figure-2a", "Fig. 2"), ("own-table-3", "Table 3")]
    found = re.findall(r'<a href="#([^"]+)">See (.*?)</a>', page.read_text())
    assert found == leads
    folder = "figures/section-own-table-3.html"
    places = [f"{folder}#figure-1", f"{folder}#figure-2a", folder]
    found = re.findall(r'<a href="([^"]+)">See .*?</a>', long_page.read_text())
    assert found == places


def test_every_id_is_there_once_and_no_link_leads_nowhere(page):
    text = page.read_text()
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    links = {link.partition("?")[0] for link in re.findall(r'href="#([^"]*)"', text)}
    assert links - set(ids) == set()


def test_forces_are_told_as_they_are():
    """What the report says of tanh, arctan and log-arctan, by another hand; walls differ."""
    K_c, r, gap, epsilon = 1.4e4, 0.5, Gap(0.3e-3, 0.5e-3), 2e3
    x = np.linspace(-2e-3, 2e-3, 401)
    told = {law.family: law.words for law in LAWS}
    assert all(told.values())
    for family, word, s in (
        ("tanh", "tanh", np.tanh),
        ("arctan", "(2/π) arctan", lambda z: 2.0 / np.pi * np.arctan(z)),
    ):
        s_1, s_2 = s(epsilon * (x + gap.j_1)), s(epsilon * (x - gap.j_2))
        assert f"s₁ = {word} ε(x + j₁), s₂ = {word} ε(x − j₂)" in told[family]
        assert told[family].startswith("½ K_c [r (1 − s₁) (x + j₁) + (1 + s₂) (x − j₂)]")
        force = 0.5 * K_c * (r * (1.0 - s_1) * (x + gap.j_1) + (1.0 + s_2) * (x - gap.j_2))
        law = contact_law(f"{family}-2e3", K_c, gap, K_ratio=r)
        np.testing.assert_allclose(law.force(x), force, rtol=1e-12, atol=1e-12)
    law = contact_law("logarctan-2e3", K_c, gap, K_ratio=r)
    assert told["logarctan"].startswith("0 at x = 0, of slope ½ K_c [r (1 − s₁) + 1 + s₂]")
    assert law.force(0.0) == 0.0
    slope = 0.5 * K_c * (r * (1.0 - s_1) + 1.0 + s_2)  # of arctan
    np.testing.assert_allclose(law.derivative(x), slope, rtol=1e-12)


@pytest.mark.parametrize(
    ("place", "leads_to"),
    [("Fig. 1", "1a"), ("Fig. 10", "10"), ("Fig. 11ab", "11"), ("Fig. 2", "")],
)
def test_a_claim_leads_to_the_figure_of_its_own_number(place, leads_to):
    names = {"Fig. 10": "10", "Fig. 1a": "1a", "Fig. 11, their solver": "11"}
    figures = [{"name": name, "href": href} for name, href in names.items()]
    links = Links([ONE_PART | {"figures": figures}])
    assert links.place(place) == leads_to


ONE_PART = {"anchor": "own", "title": "Own", "href": "#own", "group": "Results", "figures": []}


def test_a_case_without_a_section_leads_to_the_results():
    """As in an overview, where no parameter set has its own section."""
    links = Links([ONE_PART | {"anchor": "model", "href": "#model", "group": ""}, ONE_PART])
    assert links.part("own") == "#own"
    assert links.part("scene-0-0") == "#results"


def test_every_figure_lies_beside_the_page_as_files(page):
    folder, text = page.parent / "figures", page.read_text()
    files = {link.removeprefix("figures/") for link in re.findall(r'href="(figures/[^"]*)"', text)}
    assert files == {path.name for path in folder.iterdir()} - {SUMS}
    assert {f"figure-scene-0-0.{kind}" for kind in ("svg", "csv")} <= files
    assert is_picture((folder / "figure-scene-0-0.svg").read_text())


def on_page(part):
    return for_page([part | {"group": ""}], most=9, folder="figures")


def test_no_two_figures_of_a_page_share_an_id():
    names = ["Fig. 7", "7", "x", "x", "x-2", "A" * 300, "A" * 299]
    figure = NAMED[0]["figures"][0]
    part = PART | {"anchor": "own", "figures": [figure | {"name": name} for name in names]}
    (made,) = on_page(part)
    ids = [figure["id"] for figure in made["figures"]]
    assert len({*ids}) == len(names)
    assert max(map(len, ids)) < 80


def test_figures_are_not_written_where_a_link_leads(run, tmp_path):
    folder = tmp_path / "report"
    folder.mkdir()
    (folder / "figures").symlink_to(tmp_path)
    with pytest.raises(StoreError, match="a symbolic link"):
        written(tmp_path, *run, [])
    assert [path.name for path in tmp_path.iterdir()] == ["report"]
    assert [path.name for path in folder.iterdir()] == ["figures"]


def test_the_page_says_how_it_was_made(page):
    text = page.read_text()
    assert (
        "<dd>engine compiled, rtol 1e-9, atol rtol × static deflection, controller native, "
        "contact_force by_mode</dd>" in text
    )
    assert "0.133 min for 16 sweep points" in text  # half a second each
    settings = re.search(r"<pre[^>]*>(.*?)</pre>", text, re.S)[1]
    assert Study.from_dict(json.loads(unescape(settings)))


def test_claims_are_on_the_page_with_their_numbers(page):
    text = page.read_text()
    assert [v for v in VERDICTS if f'data-verdict="{v}"' not in text] == []
    assert "1 refuted, 1 partly, 1 confirmed, 1 undecidable" in text
    assert text.count("1, not ≤ 2") == len(VERDICTS)


@pytest.mark.parametrize(
    ("holds", "said"),
    [
        ((True, None, True), "1 of 3 tests undecided, none failed"),
        ((True, None, False), ""),
        ((True, True), ""),
        ((None, None), ""),
        ((), ""),
    ],
)
def test_what_is_partly_open_and_not_wrong_is_said(holds, said):
    test = {"says": "a", "value": 1.0, "floor": None, "op": "<=", "threshold": 2.0, "n": 3}
    tests = [test | {"holds": one} for one in holds]
    (row,) = claim_rows({"claims": [{"verdict": "partly", "tests": tests}]})
    assert row["open"] == said


def test_the_page_asks_for_nothing_and_allows_only_its_own_script(page):
    text = page.read_text()
    outside = re.findall(r'(?:src|href|url)\s*[=(]\s*["\']?(https?:[^"\'\s)]*)', text)
    assert [url for url in outside if "w3.org" not in url] == []
    digest = re.search(r"script-src 'sha256-([^']+)'", text)[1]
    script = re.search(r"<script>(.*?)</script>", text, re.DOTALL)[1]
    command = ["openssl", "dgst", "-sha256", "-binary"]
    raw = subprocess.run(command, input=script.encode(), capture_output=True, check=True).stdout
    assert (
        digest
        == subprocess.run(["base64"], input=raw, capture_output=True, check=True)
        .stdout.decode()
        .strip()
    )


def panelled():
    """Three panels with a legend of all, points, a shade and mathematics."""
    figure = Figure(figsize=(9.5, 3.0), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for i, axes in enumerate(panels):
        axes.plot(range(9), "o", label=f"<b> & 'c' {i}", rasterized=True)
        axes.set_title(f"$x^{i}$ — 7 %", fontsize=5)
        axes.axvspan(0, 1)
    panels[0].set(ylabel="height [mm]", xlabel="# 1.23456")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def words(picture):
    return [" ".join("".join(e.itertext()).split()) for e in ElementTree.fromstring(picture).iter(
        "{http://www.w3.org/2000/svg}text")]  # fmt: skip


def test_pictures_have_text_as_text_that_can_be_read():
    picture = pictures(panelled())["svg"]
    assert {"<b> & 'c' 1", "# 1.23456"} <= set(words(picture))
    sizes = [float(size) for size in re.findall(r"font-size: ([\d.]+)px", picture)]
    assert min(sizes) >= 8.5 * 0.7  # of mathematics, exponents
    assert len(re.findall("data:image/png", picture)) == 3


def test_the_same_figure_gives_the_same_picture():
    with matplotlib.rc_context(MATPLOTLIB):
        assert pictures(panelled()) == pictures(panelled())


def test_only_pictures_are_shown():
    drawn = pictures(panelled())
    stored = json.loads(json.dumps(PART | {"figures": [{**drawn, "caption": ""}]}))
    ((shown,),) = (part["figures"] for part in on_page(stored))
    assert shown["files"]["svg"].decode() == drawn["svg"]
    assert (shown["width"], shown["height"]) == (912, 288)
    for old, new in (
        ("</svg>", "<script>alert(1)</script></svg>"),
        ("</svg>", "</svg><svg></svg>"),
        ("</svg>", '<a href="https://a.b">c</a></svg>'),
        ("<g ", '<g onload="alert(1)" '),
        ("</svg>", '<use href="https://a.b/c#d"/></svg>'),
    ):
        assert old in drawn["svg"]
        changed = drawn | {"svg": drawn["svg"].replace(old, new)}
        assert on_page(PART | {"figures": [changed]})[0]["figures"] == [], new
    assert not is_picture("")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Part("a", "A", "Said."), "sentences: must be a list of texts, not 'Said.'"),
        (lambda: Part("a", "A", [1.5]), "one of sentences: must be text, not 1.5"),
        (
            lambda: Part("my part", "A", []),
            "anchor: must be of a to z, 0 to 9 and -, not 'my part'",
        ),
        (lambda: Part("a", None, []), "title: must be text, not None"),
        (lambda: Table("t", ["h"], [["1"], ["1", "2"]]), "row 2: 2 texts for 1 columns"),
        (lambda: Table("t", ["h"], [[1.5]]), "one of row 1: must be text, not 1.5"),
        (
            lambda: Figured(Figure().subplots(), "", ""),
            "must be a matplotlib.figure.Figure, not Axes",
        ),
        (lambda: rendered(None), "must give sections, as a list or by yield, not None"),
        (lambda: rendered([1]), "a section must be a Part, not 1"),
        (lambda: rendered([Part("a", "A", ["x"])] * 2), "anchor 'a': stands for more than one"),
    ],
)
def test_what_sections_must_hold(make, said):
    with pytest.raises((TypeError, ValueError), match=re.escape(said)):
        make()


def test_parts_that_hold_nothing_are_left_out():
    full = Part("a", "A", [], [Table("t", ["h"], [["1"]])])
    assert [part["anchor"] for part in rendered([Part("b", "B", []), full])] == ["a"]


@pytest.mark.parametrize(
    ("value", "op", "threshold", "holds", "text"),
    [
        (0.93, ">=", 0.8, True, "0.93 ≥ 0.8 holds"),
        (0.4, ">=", 0.8, False, "0.4, not ≥ 0.8"),
        (0.79, "<", 0.8, None, "undecided: 0.79 is within its uncertainty of < 0.8"),
        (None, ">", 0.8, None, "undecided: no finite number, required > 0.8"),
        (None, ">", None, None, "undecided: no finite number, required > no finite number"),
        (3.0, ">", None, None, "undecided: 3, required > no finite number"),
        (None, ">", 0.8, True, "no finite number > 0.8 holds"),
        (2.0, ">", None, False, "2, not > no finite number"),
    ],
)
def test_outcomes_of_tests_in_words(value, op, threshold, holds, text):
    assert outcome({"value": value, "op": op, "threshold": threshold, "holds": holds}) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1234.5, "1234"), (1.4e6, "1.4e6"), (0.01234, "0.0123"), (float("nan"), "–")],
)
def test_numbers_keep_three_digits(value, text):
    assert number(value) == text


def test_percent():
    assert [percent(v) for v in (0.0123456, 1.5, float("inf"))] == ["1.23 %", "150 %", "–"]
    assert json.dumps(percent(0.0)) == '"0 %"'


@pytest.mark.parametrize(
    ("made_from", "created", "is_shown"),
    [
        ({"study": "this"}, "2026-01-01T00:00:00+00:00", True),
        ({"study": "other"}, "2026-01-01T00:00:00+00:00", False),
        # Scenes of a benchmark are changed without a new sweep.
        ({"study": "other"}, "2026-03-01T00:00:00+00:00", True),
        ({"responses.nc": "other"}, "2026-03-01T00:00:00+00:00", False),
        ({"responses.nc": "recorded"}, "2026-01-01T00:00:00+00:00", True),
        ({}, "2026-01-01T00:00:00+00:00", False),
    ],
)
def test_a_file_counts_with_its_responses_or_its_study(tmp_path, made_from, created, is_shown):
    def write(name, inputs, when):
        attributes = {"made_from": json.dumps(inputs), "created": when}
        xr.Dataset(attrs=attributes).to_netcdf(tmp_path / name)

    write("responses.nc", {"study": "this"}, "2026-02-01T00:00:00+00:00")
    recorded = sha256(tmp_path / "responses.nc")
    (tmp_path / SUMS).write_text(f"{recorded}  responses.nc\n")
    write("bench.nc", {k: v.replace("recorded", recorded) for k, v in made_from.items()}, created)
    assert is_of_run(tmp_path / "bench.nc") == is_shown


def test_a_file_counts_where_no_digest_has_come_along(tmp_path):
    responses, agreement = tmp_path / "responses.nc", tmp_path / "agreement.nc"
    xr.Dataset().to_netcdf(responses)
    made_from = json.dumps({"responses.nc": sha256(responses)})
    xr.Dataset(attrs={"made_from": made_from}).to_netcdf(agreement)
    assert is_of_run(agreement)


def test_branches_lie_behind_the_attractors_with_their_special_points(tmp_path):
    """Of branch 1, of another stiffness, nothing is shown."""
    wanted = tables(["piecewise", "tanh-1e4"], OMEGA, starts=2)
    files = datasets(tmp_path, wanted, lambda _, omega, start: periodic([(1e-3, 0.0)], omega))
    stable = [[1, 1, 0, 0, 1], [1, 0, 0, -1, -1], [1, 1, 0, 0, 1]]
    special = [[0, 1, 0, 6, 0], [0, 3, 0, 0, 0], [0, 1, 0, 0, 5]]
    found = branches(
        stable, special, representation=["piecewise", "piecewise", "tanh-1e4"],
        K_c=[1.4e4, 1.0, 1.4e4], gap=["0.4/0.4"] * 3,
    )  # fmt: skip
    found["omega"] -= 4.0 - 0.01 * (found["branch"] > 1)
    inputs = Inputs(files[0], timing(files[0]), agreement(*files), files[1])
    (without,), (part,) = results(inputs), results(replace(inputs, branches=found))
    titles = [table.title for table in part.tables]
    assert titles[:-1] == [table.title for table in without.tables]
    assert [" | ".join(row) for row in part.tables[-1].rows] == [
        "LP, fold | 1 | piecewise | 1.5 | 1",
        "LP, fold | 3 | tanh-1e4 | 1.51 | 21",
        "GR, graze | 3 | tanh-1e4 | 3.01 | 24",
        "SB, symmetry breaking | 1 | piecewise | 2.5 | 3",
    ]
    assert not any("dashed where unstable" in figured.caption for figured in without.figures)
    figures = [figured for figured in part.figures if "dashed where unstable" in figured.caption]
    assert len(figures) == 2
    for figured in figures:
        assert "LP: fold, SB: symmetry breaking, GR" in figured.caption
        numbers = as_csv(figured.figure)
        assert "1,LP fold,point,1.5,1," in numbers
        assert "2,LP fold,point,1.51,21," in numbers
        assert "torus" not in numbers
        assert "Sacker" not in numbers


def test_special_points_are_compared_with_those_of_the_exact_law(tmp_path):
    """As branches.nc says; mirror images share a row, and a point that is left over has a dash."""
    wanted = tables(["piecewise", "tanh-1e4"], OMEGA)
    files = datasets(tmp_path, wanted, lambda _, omega, start: periodic([(1e-3, 0.0)], omega))
    labels = ["piecewise", "tanh-1e4", "tanh-1e4"]
    found = branches([[1, 1, 0]] * 3, [[0, 1, 0]] * 3, representation=labels)
    found["period_multiple"][:] = 1
    found["omega"][:] = np.array([5.0, 5.05, 5.05])[:, None]
    found["x_max"][:] = 1e-3 * np.array([1, 1, 2])[:, None]
    (table,) = special_points(found, files[0], "omega")
    assert table.rows == [
        ["LP, fold", "1", "piecewise", "5", "1"],
        ["LP, fold", "1", "tanh-1e4", "5.05", "1, 2"],
    ]
    matches = {"kind": [1, 2, 1], "period_multiple": [1, 1, 1], "exact": [5.0, 7.0, 1.0]}
    matches |= {"law": [5.05, np.nan, 1.0], "difference": [0.05, np.nan, 0.0]}
    scenes = {"representation": ["tanh-1e4"] * 3, "K_c": [1.4e4, 1.4e4, 1.0]}
    compared = found.assign(
        {f"match_{name}": ("match", column) for name, column in matches.items()}
    ).assign_coords({f"match_{name}": ("match", column) for name, column in scenes.items()})
    first, table = special_points(compared, files[0], "omega")
    assert first.rows == [["LP, fold", "1", "piecewise", "5", "1"]]
    assert table.title.endswith("exact law, forcing frequency [Hz]")
    assert table.rows == [
        ["LP, fold", "1", "tanh-1e4", "5", "5.05", "0.05"],
        ["PD, period doubling", "1", "tanh-1e4", "7", "–", "–"],
    ]
    assert [*special_points(found.assign(special=0 * found["special"]), files[0], "omega")] == []
    assert [*special_points(found, files[0], "K_c")] == []
    assert [*special_points(xr.Dataset(coords={"branch": []}), files[0], "omega")] == []


def test_attractors_on_no_branch_are_listed(tmp_path):
    wanted = tables(["piecewise", "tanh-1e4"], OMEGA)
    files = datasets(tmp_path, wanted, lambda _, omega, start: periodic([(1e-3, 0.0)], omega))
    of = {"on_branch": [0, -1, -1], "x_max": [1e-3, 2e-3, 3e-3], "period_multiple": [1, 2, 3]}
    states = [[1e-4, 0.0], [2e-4, 0.5], [3e-4, 0.0]]
    found = branches([[1]], [[0]]).assign(
        {f"attractor_{name}": ("attractor", column) for name, column in of.items()}
        | {"attractor_start_state": (("attractor", "state"), states)}
    )
    at = {"representation": ["piecewise"] * 3, "K_c": [1.4e4, 1.4e4, 1.0], "omega": [1.0, 2.0, 3.0]}
    found = found.assign_coords({f"attractor_{n}": ("attractor", row) for n, row in at.items()})
    found["attractor_x_max"].attrs = {"units": "m", "long_name": "peak"}
    found["attractor_omega"].attrs = {"units": "Hz", "long_name": "forcing frequency"}
    (table,) = special_points(found, files[0], "omega")
    assert table.rows == [["piecewise", "2", "2", "2", "0.0002, 0.5"]]
    assert table.header[2:4] == ["forcing frequency [Hz]", "peak [mm]"]
    assert [*special_points(found.drop_vars("attractor_omega"), files[0], "omega")] == []


def test_a_caption_names_the_few_frequencies_that_had_several_starts(tmp_path):
    study = tables(LABELS, OMEGA, starts=1, **HALF)
    study["sweep"].append(study["sweep"][0] | {"omega": [2.0], "initial_condition": [[2e-5, 0.0]]})
    files = datasets(tmp_path, study, lambda _, omega, start: periodic([(1e-3, 0.0)], omega))
    inputs = Inputs(files[0], timing(files[0]), agreement(*files), files[1])
    (part,) = results(inputs)
    captions = " ".join(figured.caption for figured in part.figures)
    assert "several initial conditions at 2 Hz only" in captions
    (head,) = SECTIONS[0].parts(inputs)
    assert head.content["map"]["starts"] == ["1–2"]
