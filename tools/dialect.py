"""List dialect words in the text of gapsweep, with file and line.

    python tools/dialect.py [file or folder ...]

Read are strings with a space (messages, attributes, help), pages, templates and comments of
studies; of the package also all docstrings and comments. Code in pages is not read. A docstring
must begin with what is returned or done: `DOCSTRING` lists beginnings that do not. The exit code
is 1 if a word is found.
"""

import ast
import io
import re
import sys
import tokenize
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
    r"^```.*?^```$|`[^`\n]*`|<!--.*?-->|<(script|style).*?</\1>|{[{%#].*?[}%#]}|^ +[\w, ]+ : ",
    re.M | re.S,
)
# A docstring begins with what is returned or done, not with these words.
DOCSTRING = re.compile(
    r"\A(?:What|Of|Those|That|Whose|Where|Which|How|Whether\ it|The\ same|As\ of)\b |"
    + WORDS.pattern,
    WORDS.flags,
)


def texts(path: Path) -> Iterator[tuple[int, str, re.Pattern[str]]]:
    """First line and text of every passage of a file, and the pattern of its dialect words."""
    source = path.read_text()
    if path.suffix == ".py":
        is_package = path.is_relative_to(ROOT / PATHS[0])
        yield from strings(ast.parse(source), is_package)
        for token in tokenize.generate_tokens(io.StringIO(source).readline) if is_package else ():
            if token.type == tokenize.COMMENT:
                yield token.start[0], token.string.lstrip("# "), WORDS
    elif path.suffix == ".toml":
        yield 1, re.sub(r"^[^#\n]*#?", "", source, flags=re.M), WORDS
    else:
        yield 1, source, WORDS


def strings(node: ast.AST, has_docstrings: bool) -> Iterator[tuple[int, str, re.Pattern[str]]]:
    """Messages in a node, and its docstrings if these are wanted."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
            if has_docstrings:
                yield child.lineno, str(child.value.value), DOCSTRING
        elif isinstance(child, ast.Constant) and " " in str(child.value):
            yield child.lineno, str(child.value), WORDS
        else:
            yield from strings(child, has_docstrings)


def dialect(paths: list[Path]) -> list[str]:
    """``file:line: word`` of every dialect word in files and folders."""
    found = []
    for path in (f for p in paths for f in (sorted(p.rglob("*")) if p.is_dir() else [p])):
        name = path.relative_to(ROOT).as_posix()
        if path.suffix in (".py", ".md", ".html", ".toml") and not name.startswith(SKIPPED):
            for line, text, pattern in texts(path):
                text = HIDDEN.sub(lambda code: re.sub(r"[^\n]", "-", code[0]), text)
                for word in pattern.finditer(text):
                    found.append(f"{name}:{line + text.count(chr(10), 0, word.start())}: {word[0]}")
    return found


if __name__ == "__main__":
    words = dialect([Path(p).resolve() for p in sys.argv[1:]] or [ROOT / p for p in PATHS])
    print(*words, f"{len(words)} dialect words", sep="\n")
    sys.exit(bool(words))
