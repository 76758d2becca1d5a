"""Sphinx configuration. Build: ``python -m sphinx -W -b html docs OUT``; needs no network."""

import os
import shutil
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
# Notebooks run while the documentation is built, each in an empty folder.
nb_execution_mode = os.environ.get("GAPSWEEP_DOCS_NOTEBOOKS", "cache")
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True


def make_pages(_app: object) -> None:
    """What is not written by hand: notebooks, and tables from the code they describe."""
    notebooks = HERE / "notebooks"
    shutil.rmtree(notebooks, ignore_errors=True)
    shutil.copytree(HERE.parent / "workflows" / "notebooks", notebooks)
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


def setup(app: object) -> None:
    app.connect("builder-inited", make_pages)
    app.add_html_math_renderer("mathml", formula("inline"), formula("block"))
