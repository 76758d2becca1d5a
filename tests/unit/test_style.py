"""Styles: contrast of marks on white, and laws that colour-blind readers can distinguish.

Contrast is defined by WCAG 2.2 (success criterion 1.4.11); sRGB, CIELAB and the distance of two
colours by IEC 61966-2-1 and CIE 015:2018. Colour blindness is simulated by the matrices of Machado,
Oliveira and Fernandes, "A Physiologically-based Model for Simulation of Color Vision Deficiency",
IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291-1298, for linear sRGB and a severity of 1.
"""

import re
import tomllib
from importlib.resources import files
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from gapsweep.report.branch_lines import KINDS
from gapsweep.report.style import (
    GREY,
    NOT_PERIODIC,
    NUMBERED,
    SWEEPS,
    colour,
    looks,
)

WORKFLOWS = Path(__file__).parents[2] / "workflows"
VISION = {
    "normal": np.eye(3),
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
}
TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
LEAST = {"normal": 25.0, "deuteranopia": 16.0, "protanopia": 16.0}  # distances of families
# Representations that occur in one figure.
TOGETHER = [
    ["piecewise", "piecewise-noevents", "tanh-10", "tanh-1e2", "tanh-1e3", "arctan-1e5", "poly-21"],
    ["piecewise", "tanh-1e4", "tanh-1e6", "poly-21", "my_module:spring"],
    ["piecewise", "tanh-1e4", "arctan-1e4", "poly-13", "huntcrossley-1", "huntcrossley-20"],
    ["piecewise", "piecewise@restart", "piecewise@scipy", "piecewise-noevents", "tanh-1e4"],
]


def linear(colour):
    share = np.array(list(bytes.fromhex(colour[1:]))) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def contrast(colour):
    """Contrast on white."""
    return 1.05 / (TO_XYZ[1] @ linear(colour) + 0.05)


def lab(colour, vision="normal"):
    seen = np.clip(VISION[vision] @ linear(colour), 0.0, 1.0)
    share = TO_XYZ @ seen / TO_XYZ.sum(axis=1)
    f = np.where(share > (6 / 29) ** 3, np.cbrt(share), share / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def distance(a, b, vision="normal"):
    return np.linalg.norm(lab(a, vision) - lab(b, vision))


def groups():
    """Representations in the figures of a report, of every block of the repository's studies."""
    yield from TOGETHER
    for path in (*WORKFLOWS.glob("*.toml"), WORKFLOWS / "paper" / "study.toml"):
        for block in tomllib.loads(path.read_text()).get("sweep", []):
            labels = block.get("representation", [])
            labels = [labels] if isinstance(labels, str) else labels
            yield [label for label in labels if "@" not in label] or labels


def family(label):
    law = label.partition("@")[0]
    return law if law.startswith("piecewise") else law.partition("-")[0]


def test_known_colours_have_their_published_contrast_and_lightness():
    assert contrast("#000000") == pytest.approx(21.0, rel=1e-4)
    assert contrast("#767676") == pytest.approx(4.54, abs=0.01)  # WCAG's example of grey text
    # sRGB red in CIELAB (D65)
    assert lab("#ff0000") == pytest.approx([53.24, 80.09, 67.20], abs=0.05)


def test_marks_have_a_contrast_of_3_on_white():
    laws = [f"{name}-1e{n}" for name in ("tanh", "arctan", "logarctan") for n in range(13)]
    laws += [f"poly-{n}" for n in range(1, 60, 2)] + [f"ratpoly-{n}/{n}" for n in range(1, 20)]
    laws += [f"huntcrossley-{n}" for n in range(30)]
    laws += [f"mine:spring{n}" for n in range(40)] + ["piecewise", "piecewise-noevents", "auto"]
    shades = {*map(colour, laws), *NUMBERED, GREY, NOT_PERIODIC}
    assert {shade for shade in shades if contrast(shade) < 3.0} == set()


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("labels", [*groups()], ids=lambda labels: labels[-1])
def test_laws_of_a_study_are_distinguishable(labels, vision):
    found = looks(labels)
    for a, b in combinations(labels, 2):
        apart = distance(found[a].colour, found[b].colour, vision)
        if family(a) != family(b):
            assert apart >= LEAST[vision], (a, b)
        else:  # by tone, or dashes and marker
            looks_of = [(found[label].dashes, found[label].marker) for label in (a, b)]
            assert apart >= 8.0 or len(set(looks_of)) == 2, (a, b)


@pytest.mark.parametrize("vision", VISION)
def test_attractors_are_distinguishable(vision):
    for a, b in combinations(NUMBERED, 2):
        assert distance(a, b, vision) >= 10.0, (a, b)


def test_a_law_has_one_style_and_the_exact_law_is_black():
    for label in ("piecewise", "tanh-1e4", "poly-13", "mine:spring"):
        (alone,) = looks([label]).values()
        assert looks(["arctan-1e3", "tanh-1e5", label])[label] == alone
        assert looks([f"{label}@loose"])[f"{label}@loose"] == alone
    assert colour("piecewise") == colour("piecewise@half") == "#000000"
    plain, loose = looks(["tanh-1e4", "tanh-1e4@loose"]).values()
    assert plain.dashes != loose.dashes
    assert plain.marker != loose.marker


def test_the_page_of_a_figure_draws_every_marker():
    laws = [f"{name}-1e{n}" for name in ("tanh", "arctan", "logarctan") for n in range(13)]
    used = {look.marker for look in looks(laws).values()} | {*SWEEPS.values()}
    used |= {marker for marker, _ in KINDS.values()} | {"|", "x"}  # ends of a frame, failures
    script = files("gapsweep.report").joinpath("templates", "figure.js").read_text()
    corners = script.partition("const CORNERS = {")[2].partition("};")[0]
    assert used - {"o"} == {*re.findall(r'^    "?(.)"?: ', corners, re.MULTILINE)}


def test_the_plain_law_has_the_laws_style_in_any_order():
    labels = ["tanh-1e4@loose", "piecewise", "tanh-1e4"]
    found = looks(labels)
    assert [*found] == labels
    assert found == looks(labels[::-1])
    assert found["tanh-1e4"] == looks(["tanh-1e4"])["tanh-1e4"]
