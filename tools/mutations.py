"""Change the package at random, a place at a time, and report whether the tests notice.

    python tools/mutations.py --seed 1 --draw 40 --tests tests --limit 90

A mutation flips a comparison, changes a number, swaps and/or, swaps two arguments of a call, or
deletes a statement. Its tests are the files that name the mutated function, or what calls it, the
nearest and rarest names first; they run in a copy until one fails or the limit [s] is reached.
Of several folders of tests, as those of an older commit and the present ones, each runs only if
the one before it has caught the mutation. ``--only 3 7`` tries only these numbers of the draw.
``--tiers`` runs the tests of the README's command first, and the extended ones only if all pass.
"""

import argparse
import ast
import itertools
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
KERNELS = "integrate"  # every mutation there compiles all kernels again: few are drawn
FLIPPED = {ast.Lt: ast.GtE, ast.Gt: ast.LtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot}
FLIPPED |= {ast.In: ast.NotIn, ast.And: ast.Or}
FLIPPED |= {other: one for one, other in FLIPPED.items()}
WORDS = re.compile(r"\w{4,}")
COMMON, REST = "not extended and not slow and not browser", "extended and not slow"


def mutate(node):
    """Change a node in place; the kind of the mutation, or None where there is none."""
    if isinstance(node, ast.Compare):
        node.ops[0] = FLIPPED[type(node.ops[0])]()
        return "comparison"
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        node.value = node.value + 1 if type(node.value) is int else node.value * 1.01 or 0.01
        return "number"
    if isinstance(node, ast.BoolOp):
        node.op = FLIPPED[type(node.op)]()
        return "and/or"
    if isinstance(node, ast.Call) and len({*map(ast.dump, node.args[:2])}) == 2:
        node.args[:2] = node.args[1::-1]
        return "arguments"
    is_call = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    return "statement" if is_call or isinstance(node, ast.AugAssign | ast.Raise) else None


def sites(source):
    """Kind, number of the node in `ast.walk`, names of the enclosing class and function."""
    tree, changed, names = ast.parse(source), ast.parse(source), {}
    kinds = [mutate(node) for node in list(ast.walk(changed))]
    for number, (kind, node) in enumerate(zip(kinds, ast.walk(tree), strict=True)):
        own = (node.name,) if isinstance(node, ast.FunctionDef | ast.ClassDef) else ()
        names |= dict.fromkeys(ast.iter_child_nodes(node), names.get(node, ()) + own)
        if kind and names.get(node):
            yield kind, number, names[node]


def mutated(source, number):
    """The source with this node changed, and its line."""
    tree = ast.parse(source)
    node = list(ast.walk(tree))[number]
    if mutate(node) == "statement":
        for parent in ast.walk(tree):
            for body in (b for _, b in ast.iter_fields(parent) if isinstance(b, list)):
                body[:] = [ast.Pass() if each is node else each for each in body]
    return ast.unparse(ast.fix_missing_locations(tree)), node.lineno


def ranked(stem, names, functions, tests):
    """Test files by how near they name the function or its callers, and how rare that name is."""
    spread = Counter(name for words in tests.values() for name in words)
    score = Counter({file: 0.2 for file in tests if stem in file.stem})
    level = set(names[-2:])
    for weight in (1.0, 0.3, 0.1, 0.03):
        for name, (file, words) in itertools.product(level, tests.items()):
            score[file] += (name in words) * weight / max(1, spread[name]) / len(words) ** 0.5
        level = {name for name, words in functions if words & level}
    return [file for file, value in score.most_common(10) if value > 0.0]


def caught_by(folder, copy, mutation, functions, limit, tier=None):
    """The first failed test of a folder of tests, or the reason why none failed; seconds."""
    path, names = mutation
    shutil.rmtree(copy / "tests", ignore_errors=True)
    shutil.copytree(folder, copy / "tests")
    texts = {file: file.read_text() for file in sorted((copy / "tests").rglob("test_*.py"))}
    if tier == COMMON:
        texts = {file: text for file, text in texts.items() if "\npytestmark" not in text}
    tests = {file: {*WORDS.findall(text)} for file, text in texts.items()}
    python_path = os.pathsep.join([str(copy / "pipeline"), str(copy)])
    begin, files = time.monotonic(), ranked(path.stem, names, functions, tests)
    command = ["timeout", str(limit), sys.executable, "-B", "-m", "pytest", "-q", "-x", "-n", "0"]
    done = subprocess.run(
        [*command, *files, *(("-m", tier) if tier else ())], cwd=copy,
        env=os.environ | {"PYTHONPATH": python_path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    failed = re.search(r"^(FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    survived = "-: limit" if done.returncode == 124 else "-"
    return failed[2] if failed else survived, time.monotonic() - begin


def main():
    parser = argparse.ArgumentParser()
    for name, default in (("seed", 1), ("draw", 40), ("limit", 90), ("kernels", 2)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--tests", type=Path, nargs="+", default=[ROOT / "tests"])
    parser.add_argument("--only", type=int, nargs="+")
    parser.add_argument("--tiers", action="store_true")
    asked = parser.parse_args()
    copy = Path(tempfile.mkdtemp()) / "clone"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv", "tests"))
    package = copy / "pipeline" / "gapsweep"
    sources = {path: path.read_text() for path in sorted(package.rglob("*.py"))}
    nodes = [node for text in sources.values() for node in ast.walk(ast.parse(text))]
    defined = [node for node in nodes if isinstance(node, ast.FunctionDef)]
    functions = [(each.name, {*WORDS.findall(ast.unparse(each))}) for each in defined]
    places = [(path, *site) for path, text in sources.items() for site in sites(text)]
    draw, drawn = random.Random(asked.seed), []
    while len(drawn) < asked.draw:
        kind = draw.choice(sorted({place[1] for place in places}))
        place = draw.choice([place for place in places if place[1] == kind])
        n_kernels = sum(KERNELS in path.parts for path, *_ in drawn)
        if KERNELS not in place[0].parts or n_kernels < asked.kernels:
            drawn.append(place)
    print("| seed | place | function | kind |", *(f" {each} | s |" for each in asked.tests), sep="")
    print("|---" * (4 + 2 * len(asked.tests)), "|", sep="")
    for number in asked.only or range(1, asked.draw + 1):
        path, kind, node, names = drawn[number - 1]
        text, line = mutated(sources[path], node)
        path.write_text(text)
        where = f"{path.relative_to(package)}:{line}"
        print(f"| {asked.seed}.{number} | {where} | {'.'.join(names)} | {kind} |", end="")
        for folder in asked.tests:
            for tier in (COMMON, REST) if asked.tiers else (None,):
                how = folder, copy, (path, names), functions, asked.limit, tier
                found, seconds = caught_by(*how)
                print(f" {found} | {seconds:.0f} |", end="", flush=True)
                if not found.startswith("-"):
                    break
            if found.startswith("-"):
                break
        print(flush=True)
        path.write_text(sources[path])


if __name__ == "__main__":
    main()
