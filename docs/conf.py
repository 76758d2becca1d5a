"""Sphinx configuration. Build: ``python -m sphinx -W -b html docs OUT``; needs no network."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
import latex2mathml.converter  # noqa: E402
import tables  # noqa: E402
from docutils import nodes  # noqa: E402

import gapsweep  # noqa: E402

project = "gapsweep"
author = "the gapsweep developers"
copyright = author
release = gapsweep.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "reference/generated"]
html_theme = "furo"
html_title = f"gapsweep {release}"

# `name` in docstrings is a Python object.
default_role = "py:obj"
autodoc_typehints = "none"  # the NumPy sections say it in the field's words
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True

myst_heading_anchors = 3
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["style.css"]
myst_enable_extensions = ["dollarmath"]
# Notebooks are stored with their outputs; tests run them.
nb_execution_mode = "off"
nb_merge_streams = True


def make_pages(_app: object) -> None:
    """Tables that the code describes."""
    generated = HERE / "reference" / "generated"
    generated.mkdir(exist_ok=True)
    for name, text in tables.pages().items():
        (generated / f"{name}.md").write_text(text)


def formula(display: str) -> object:
    """A visitor that writes formulas as MathML, which browsers draw without a network."""

    def visit(writer: object, node: object) -> None:
        writer.body.append(latex2mathml.converter.convert(node.astext(), display=display))
        raise nodes.SkipNode

    return visit, None


def leave_out(app: object, _doctree: object) -> None:
    """Decision records stay out of the search: their wording is older than that of the pages."""
    if app.env.docname.startswith("decisions/"):
        app.env.metadata[app.env.docname]["nosearch"] = "true"


def setup(app: object) -> None:
    app.connect("builder-inited", make_pages)
    app.connect("doctree-read", leave_out)
    app.add_html_math_renderer("mathml", formula("inline"), formula("block"))
