"""Mistakes that a newcomer makes: one line says what to write instead."""

import re
import tomllib

import pytest

import gapsweep as gs
from gapsweep.cli.main import exit_code
from gapsweep.model.systems import paper_oscillator
from gapsweep.study.spec import parse

STUDY = """
[study]
name = "mine"
[oscillator]
mass = 3.0
omega_n = 5.0
forcing = 4.0
alpha = 7e8
zeta = 0.03
[[sweep]]
representation = ["piecewise", "tanh-1e4"]
K_c = [1.4e4]
gap = [[4e-4, 4e-4]]
omega = { start = 1.0, stop = 30.0, step = 1.0 }
[solver]
engine = "compiled"
"""
GRID = "{ start = 1.0, stop = 30.0, step = 1.0 }"
# What is written in place of what, and what must be answered, whole.
IN_A_STUDY = {
    "plural": (
        "gap =",
        "gaps =",
        "sweep[0].gaps = [[0.0004, 0.0004]]: unknown key; did you mean gap?",
    ),
    "case": ("K_c", "k_c", "sweep[0].k_c = [14000.0]: unknown key; did you mean K_c?"),
    "name of another tool": (
        "zeta",
        "damping",
        "oscillator.damping = 0.03: unknown key; known keys: zeta, omega_n, mass, alpha, forcing, "
        "mean_load, c, unbalance, base_amplitude, base_damping",
    ),
    "misspelt table": (
        "[oscillator]",
        "[oscilator]",
        "oscilator: unknown key; did you mean oscillator?",
    ),
    "one bracket": ("[[sweep]]", "[sweep]", "sweep: must be a list of tables; write [[sweep]]"),
    "unit in the number": (
        "[1.4e4]",
        '"14 kN"',
        "sweep[0].K_c[0] = '14 kN': must be a number in N/m, or a quantity of this dimension",
    ),
    "per cent": (
        "0.03",
        '"3 m"',
        "oscillator.zeta = '3 m': must be a number or a quantity without dimension, as 2 %",
    ),
    "range of MATLAB": (
        GRID,
        '"1:30"',
        "sweep[0].omega[0] = '1:30': must be a number, in Hz; write a range as "
        "{ start = 1.0, stop = 30.0, step = 0.5 }",
    ),
    "end of a range": (
        "stop",
        "end",
        "sweep[0].omega.stop: missing; write stop = 30.0",
        "sweep[0].omega.end = 30.0: unknown key; known keys: start, stop, step, num",
    ),
    "no step": (", step = 1.0", "", "sweep[0].omega: give step or num"),
    "no frequencies": (
        f"omega = {GRID}",
        "",
        "sweep[0].omega: missing; write omega = { start = 1.0, stop = 30.0, step = 0.5 }, in Hz",
    ),
    "no name": ('name = "mine"', "", 'study.name: missing; write name = "my-study"'),
    "one wall": (
        "[[4e-4, 4e-4]]",
        "4e-4",
        "sweep[0].gap = 0.0004: must be the distances of both walls [m], as [4e-4, 4e-4], or a "
        "list of such pairs",
    ),
    "swept in the wrong table": (
        "0.03",
        "[0.03, 0.1]",
        "oscillator.zeta = [0.03, 0.1]: must be a number; write swept values in [[sweep]]",
    ),
    "engine": ("compiled", "scipi", "solver.engine = 'scipi': must be 'compiled' or 'scipy'"),
    "protocol": (
        "tanh-1e4",
        "tanh-1e4@fine",
        "protocol 'fine' is used by a label, but [protocol.fine] is missing",
    ),
    "number for a name": ('"mine"', "3", "study.name = 3: must be text, in quotes"),
}
LABELS = {
    "rigid 0.8": "did you mean rigid-0.8? Or",
    "tahn-1e4": "did you mean tanh-1e4? Or use one of piecewise, ",
    "tanh1e4": "did you mean tanh-1e4? Or",
    "poly13": "did you mean poly-13? Or",
    "Piecewise": "did you mean piecewise? Or",
    "ratpol-5/3": "did you mean ratpoly-5/3? Or",
    "exact": "unknown representation 'exact': use one of piecewise, ",
    "tanh": "must be tanh and its convergence parameter in 1/m, as tanh-1e4",
}
GAP = gs.Gap(4e-4, 4e-4)
IN_PYTHON = {
    "label for a law": (
        lambda: gs.respond(paper_oscillator(), "piecewise", omega=9.0),
        "law = 'piecewise': must be a contact law, as gs.contact_law('piecewise', K_c, gap)",
    ),
    "label for a function": (
        lambda: gs.law("tanh-1e4", 1.4e4, GAP),
        "for the law of a label use gapsweep.contact_law(label, K_c, gap)",
    ),
    "text for a number": (lambda: paper_oscillator(mass="3"), "mass = '3': must be a number"),
}
ON_THE_COMMAND_LINE = {
    "study by its name": (
        ["run", "quick"],
        "error: quick: cannot be read: No such file or directory; write an example study "
        "with 'gapsweep init'",
    ),
    "folder for a study": (["plan", "."], "error: .: cannot be read: Is a directory"),
    "study for a folder": (
        ["status", "mine.toml"],
        "mine.toml: must be the folder of a run, as data/runs/quick",
    ),
    "misspelt column": (
        ["query", "mine.toml", "--columns", "xmax", "--scheduler", "tcp://nobody:1"],
        "'xmax': no such variable; did you mean x_max?",  # before a cluster is used
    ),
    "misspelt command": (["paln"], "No such command 'paln'. Did you mean 'plan'?"),
    "misspelt option": (["run", "mine.toml", "--worker", "4"], "Did you mean '--workers'?"),
    "value that is not there": (
        ["query", "mine.toml", "--sel", "gap=0.4"],
        "gap = '0.4': not in the study, which has 0.4/0.4",
    ),
    "start of a query": (
        ["query", "mine.toml", "--sel", "omega"],
        "'omega': must be KEY=VALUE, as omega=10",
    ),
}
OF_PYDANTIC = re.compile("valid |[Ii]nput|should|required|permitted|Value error")


def problems(text):
    with pytest.raises(gs.StudyError) as refused:
        gs.Study.from_dict(tomllib.loads(text), "mine.toml")
    return list(refused.value.problems)


def test_the_study_to_spoil_is_sound():
    assert gs.Study.from_dict(tomllib.loads(STUDY)).name == "mine"
    assert len(IN_A_STUDY) + len(LABELS) + len(IN_PYTHON) + len(ON_THE_COMMAND_LINE) > 20


@pytest.mark.parametrize("mistake", IN_A_STUDY)
def test_in_a_study(mistake):
    right, wrong, *answers = IN_A_STUDY[mistake]
    assert right in STUDY
    found = problems(STUDY.replace(right, wrong))
    assert set(answers) <= {line.removeprefix("mine.toml: ") for line in found}
    assert not [line for line in found if OF_PYDANTIC.search(line)]


def test_one_stiffness_may_stand_alone():
    one = gs.Study.from_dict(tomllib.loads(STUDY.replace("[1.4e4]", "1.4e4")))
    assert one.grid.K_c == (1.4e4,)


@pytest.mark.parametrize("label", LABELS)
def test_in_a_label(label):
    (line,) = problems(STUDY.replace("tanh-1e4", label))
    assert line.startswith(f"mine.toml: sweep[0].representation[1] = {label!r}: ")
    assert LABELS[label] in line


@pytest.mark.parametrize("mistake", IN_PYTHON)
def test_in_python(mistake):
    call, answer = IN_PYTHON[mistake]
    with pytest.raises(gs.ModelError) as refused:
        call()
    assert answer in str(refused.value)


@pytest.mark.parametrize("mistake", ON_THE_COMMAND_LINE)
def test_on_the_command_line(mistake, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(STUDY)
    arguments, answer = ON_THE_COMMAND_LINE[mistake]
    assert exit_code(arguments) in (1, 2)
    assert answer in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("written", "line"),
    [
        ("K_c = 10**5", "K_c = 10**5"),
        ("gap = [4e-4, 4e-4", "complete? gap = [4e-4, 4e-4"),
        ("zeta = True", "zeta = True"),
    ],
)
def test_a_file_that_is_no_toml_shows_the_line(written, line):
    name = written.partition(" = ")[0]
    text = re.sub(rf"^{name} = .*$", written, STUDY, flags=re.M)
    with pytest.raises(gs.StudyError, match=re.escape(line) + "$"):
        parse(text)


@pytest.mark.parametrize(
    "call",
    [
        lambda model: gs.explore(model),
        lambda model: gs.branches(model, LAW, "k", (1.0, 2.0), omega=0.1),
    ],
    ids=["explore", "branches"],
)
def test_a_function_that_returns_no_model_or_raises_is_named_in_one_line(call):
    def broken(k=1.0):
        raise KeyError(f"no spring {k}")

    for model, said in ((broken, r"broken\(k=1.0\) raised KeyError"), (lambda k=1.0: k, "System")):
        with pytest.raises(gs.ModelError, match=said) as raised:
            call(model)
        assert "\n" not in str(raised.value)


LAW = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
