"""Text is plain English: it has no word of `tools/dialect.py`."""

import pytest
from tools import dialect

PACKAGE, *OTHERS = [dialect.ROOT / name for name in dialect.PATHS]
AREAS = [*OTHERS, *(p for p in PACKAGE.iterdir() if p.name != "__pycache__")]


@pytest.mark.parametrize("area", sorted(AREAS), ids=lambda p: p.name)
def test_text_is_plain(area):
    assert dialect.dialect([area]) == []


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("a.py", 'raise ValueError(f"{x}: the floor is told")', ["1: floor", "1: told"]),
        ("a.py", 'def _f():\n    """Whose price."""\n', ["2: Whose", "2: price"]),
        ("a.py", 'class Study:\n    """What it is."""\n    def g(self):\n        """A stand-in."""',
         ["2: What", "4: stand-in"]),
        ("a.py", '"""Which of them."""\n', ["1: Which"]),
        ("a.py", 'def f(scene):\n    """The law, which acts.\n\n    scene : int\n    """\n', []),
        ("a.py", "price = 1  # its price\n", ["1: price"]),
        ("a.py", "# What is new.\nname = 1\n", ["1: What"]),
        ("a.md", "Each start ends.\n\n```toml\nstart = 1.0\n```\n`floor`\n", ["1: Each start"]),
        ("a.md", "What is a torus? The sweep starts at 1 Hz.\n", []),
        ("a.toml", "floor = 1\nx = 2  # from a start\n", ["2: a start"]),
        ("a.html", "<p>{{ price }} beside</p>\n<script>anew</script>", ["1: beside"]),
    ],
)  # fmt: skip
def test_words_are_found_by_line(name, text, found, tmp_path, monkeypatch):
    monkeypatch.setattr(dialect, "ROOT", tmp_path)
    path = tmp_path / "pipeline" / "gapsweep" / name
    path.parent.mkdir(parents=True)
    path.write_text(text)
    hits = dialect.dialect([path])
    assert [hit.rpartition(f"{name}:")[2].strip() for hit in hits] == found
