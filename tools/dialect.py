"""List dialect words in the text that a user of gapsweep reads, with file and line.

    python tools/dialect.py [file or folder ...]

Read are strings with a space (messages, attributes, help), docstrings of public objects, pages,
templates and comments of studies; code in pages is not. The exit code is 1 if a word is found.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATHS = ("pipeline/gapsweep", "docs", "workflows", "README.md", "CONTRIBUTING.md", "CHANGELOG.md")
SKIPPED = ("docs/decisions/", "docs/_build/", "docs/generated/", "docs/notebooks/")
WORDS = re.compile(
    r"""(?i:\bstand-ins? | (?<!\.)\bscenes?\b | \bbesides?\b | \balone\b | \banew\b | \baside\b
    | \b(?:an?|the|its|their|every|each|all|one|two|same|other|random|several|of|\d+)\ starts?\b(?!\ (?:=|in\b|points))
    | \bstarts\ (?:of|that|and)\b | \bfloors?\b(?!\ :) | \bprices?\b | \btruths?\b | \btold\b | \bspecks?\b
    | \b(?:computed|made|compiled|read|done)\ again | \bby\ (?:itself|themselves)\b | \blast\ heard\b
    | \bof\ (?:its|their|your|one's)\ own\b | \bpour(?:ed|s)?\b | \brattle[ds]\b | \bhills?\b | \btraps?\b)
    | (?:^|(?<=[.!?:]\ ))(?:What\ (?![^.?]*\?)|Whose\b|Of\ (?!course)|That\ (?:is\b|are\b|\w+s\b))
    """,  # noqa: E501
    re.VERBOSE | re.MULTILINE,
)
HIDDEN = re.compile(
    r"^```.*?^```$|`[^`\n]*`|<!--.*?-->|<(script|style).*?</\1>|{[{%#].*?[}%#]}", re.M | re.S
)
# Python files of which every object is public, next to the objects of `gapsweep.__all__`.
PUBLIC = ("cli", "model/systems.py", "report/accessor.py", "analysis/claims.py")
EXPORTED = set(re.findall(r'^    "(\w+)",$', (ROOT / PATHS[0] / "__init__.py").read_text(), re.M))
EXPORTED.add("read")  # gapsweep.open


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """First line and text of every passage of a file that a user reads."""
    source = path.read_text()
    if path.suffix == ".py":
        package = path.relative_to(ROOT).as_posix().removeprefix(PATHS[0] + "/")
        yield from strings(ast.parse(source), package.startswith(PUBLIC))
    elif path.suffix == ".toml":
        yield 1, re.sub(r"^[^#\n]*#?", "", source, flags=re.M)
    else:
        yield 1, source


def strings(node: ast.AST, public: bool) -> Iterator[tuple[int, str]]:
    """Messages in a node, and its docstrings if they are public."""
    name = getattr(node, "name", None) or ""
    public = (public or name in EXPORTED) and not name.startswith("_")
    body = getattr(node, "body", None)
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
            if public and body and child is body[0] and name:
                yield child.lineno, str(child.value.value)
        elif isinstance(child, ast.Constant) and " " in str(child.value):
            yield child.lineno, str(child.value)
        else:
            yield from strings(child, public)


def dialect(paths: list[Path]) -> list[str]:
    """``file:line: word`` of every dialect word in files and folders."""
    found = []
    for path in (f for p in paths for f in (sorted(p.rglob("*")) if p.is_dir() else [p])):
        name = path.relative_to(ROOT).as_posix()
        if path.suffix in (".py", ".md", ".html", ".toml") and not name.startswith(SKIPPED):
            for line, text in texts(path):
                text = HIDDEN.sub(lambda code: re.sub(r"[^\n]", "-", code[0]), text)
                for word in WORDS.finditer(text):
                    found.append(f"{name}:{line + text.count(chr(10), 0, word.start())}: {word[0]}")
    return found


if __name__ == "__main__":
    words = dialect([Path(p).resolve() for p in sys.argv[1:]] or [ROOT / p for p in PATHS])
    print(*words, f"{len(words)} dialect words", sep="\n")
    sys.exit(bool(words))
