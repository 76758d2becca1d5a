"""Invalid input gives an error of one line with the value and the remedy."""

import math
import tempfile
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import norm

import gapsweep as gs
from gapsweep.model.systems import paper_oscillator

GAP = gs.Gap(4e-4, 4e-4)
TABLES = {
    "study": {"name": "small"},
    "oscillator": {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0},
    "sweep": [{"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}],
}
OSCILLATOR, LAW = paper_oscillator(), gs.Piecewise(1.4e4, GAP)


def spring(x):
    return 1e4 * x


def simulated(**changes):
    given = {"oscillator": OSCILLATOR, "law": LAW, "omega": 9.0, "t_end": 0.1}
    return gs.simulate(**(given | changes))


def answered(**changes):
    given = {"oscillator": OSCILLATOR, "law": LAW, "omega": 9.0}
    return gs.respond(**(given | changes))


MEASURED = {"frequency [Hz]": [7.0, 8.0, 9.0], "amplitude [mm]": [0.5, 0.6, 0.7]}
WITH_NOISE = MEASURED | {"noise [mm]": [0.01, 0.01, 0.01]}
FIT = {"data": MEASURED, "free": {"gap": [1e-4, 1e-3]}}
UNCERTAIN = {"samples": 2, "chi": {"normal": 1.0, "sd": 0.1}, "quantities": ["x_max"]}


def differentiated(parameters, **changes):
    return gs.gradient(
        **({"oscillator": OSCILLATOR, "law": LAW, "omega": 9.0} | changes), parameters=parameters
    )


def of_argument(a):
    return OSCILLATOR


REFUSED = {
    "no parameter": (lambda: differentiated(None), r"parameters = None: .* as \["),
    "number for a parameter": (lambda: differentiated(3), r"parameters = 3: .* as \["),
    "parameter named twice": (lambda: differentiated(["gap", "gap"]), r"parameters = .* different"),
    "argument without a value": (
        lambda: differentiated("a", oscillator=of_argument),
        r"a: has no default; write values={'a': 1\.0}",
    ),
    "text for an argument": (
        lambda: differentiated("a", oscillator=of_argument, values={"a": "x"}),
        "a = 'x': must be a number",
    ),
    "list for arguments": (
        lambda: differentiated("a", oscillator=of_argument, values=[1]),
        r"values = \[1\]: must be by name",
    ),
    "misspelt argument": (
        lambda: differentiated("a", oscillator=of_argument, values={"a": 1.0, "b": 2.0}),
        "values: 'b': no argument of the function, which has a",
    ),
    "branches of a function with two arguments": (
        lambda: gs.branches(lambda a, b: OSCILLATOR, LAW, "a", (1.0, 2.0), omega=9.0),
        r"argument 'b' has no default; write functools\.partial\(",
    ),
    "fit to nothing": (
        lambda: gs.fit({"f [Hz]": [], "amplitude [m]": []}, OSCILLATOR, LAW, free={"mass": (1, 2)}),
        "has 0 points; must have >= 3",
    ),
    "list for a parameter": (
        lambda: gs.branches(OSCILLATOR, LAW, ["gap"], (1e-4, 1e-3), omega=9.0),
        r"parameter = \['gap'\]: must be one name",
    ),
    "choice without a law": (
        lambda: gs.choose("gap", (1e-4, 1e-3), OSCILLATOR, so_that=gs.no_contact(), omega=9.0),
        r"law: missing .*law=gs\.Piecewise\(",
    ),
    "basins at two frequencies": (
        lambda: gs.basins(OSCILLATOR, LAW, [8.0, 9.0], x=[0.0, 1e-3], v=0.0),
        r"omega = \[8\.0, 9\.0\]: must be one frequency",
    ),
    "demand without a limit": (lambda: gs.at_most("amplitude"), r"limit.* write gs\.at_most\("),
    "demand with an argument": (lambda: gs.no_contact(1), "too many .* parameters are none"),
    "misspelt argument of a probability": (
        lambda: gs.probability({"response_class": "chaotic"}, 0.1, {"gap": norm()}, sample=64),
        r"'sample'.* its parameters are event, at_most, .* write gs\.probability\(",
    ),
    "distribution of no width": (
        lambda: gs.risk(OSCILLATOR, LAW, {"gap": norm(4e-4, 0.0)}, 9.0, quantities=["x_max"]),
        "gap: the distribution has no median",
    ),
    "noise of a fit in two places": (
        lambda: gs.Study.from_dict(TABLES | {"fit": FIT | {"data": WITH_NOISE, "noise": 1e-5}}),
        r"noise = 1e-05: leave it out",
    ),
    "noise of a fit in words": (
        lambda: gs.Study.from_dict(TABLES | {"fit": FIT | {"noise": "x"}}),
        "noise = 'x': must be a number in m",
    ),
    "uncertain chi of elastic walls": (
        lambda: gs.Study.from_dict(TABLES | {"uncertain": UNCERTAIN}),
        "chi: .* huntcrossley without a number has",
    ),
    "event without a name": (
        lambda: gs.risk(
            OSCILLATOR,
            LAW,
            {"gap": norm(4e-4, 1e-5)},
            9.0,
            events={"": {"quantity": "x_max", "above": 1}},
        ),
        r"event\[0\]\.name = '': must not be empty",
    ),
    "number for labels": (lambda: gs.explore(approximations=3), "approximations = 3: must be"),
    "number for a label": (lambda: gs.explore(approximations=[3]), r"approximations = \[3\]: must"),
    "no frequency": (lambda: simulated(omega=[]), r"omega = \[\]: .* at least one"),
    "None for a frequency": (lambda: simulated(omega=None), "omega: missing; write omega = 9"),
    "None for a start": (lambda: simulated(x_0=None), "x_0 = None: must be a number"),
    "no law": (lambda: simulated(law=None), r"law = None: .* gs\.contact_law\("),
    "function for a law": (lambda: answered(law=spring), r"law = .* gs\.law\(function, K_c, gap\)"),
    "function for a contact": (
        lambda: gs.respond(
            gs.System(mass=[[1.0]], stiffness=[[1.0]], contacts={"a": [1.0]}),
            {"a": spring},
            q_0=1.0,
        ),
        r"law = .* gs\.law\(function, K_c, gap\)",
    ),
    "own law without its gap": (lambda: gs.law(spring, K_c=1.0), r"'gap'; .*write gs\.law\("),
    "own law without its arguments": (lambda: gs.law(spring), r"K_ratio, \*\*parameters: write"),
    "misspelt K_c": (lambda: gs.law(spring, Kc=1.0, gap=GAP), r"'K_c'; .*write gs\.law\("),
    "misspelt start": (lambda: answered(xo=0.0), r"'xo'; .*x_0.*write gs\.respond\("),
    "misspelt end": (lambda: simulated(tend=1.0), r"'tend'; .*t_end.*write gs\.simulate\("),
    "misspelt criterion": (lambda: gs.Steady(n_period=3), r"'n_period'; .*write gs\.Steady\("),
    "label without numbers": (lambda: gs.contact_law("tanh-1e4"), r"'K_c'; .*gs\.contact_law\("),
    "basins with half a ray": (
        lambda: gs.basins(OSCILLATOR, LAW, 9.0, x=[0.0], v=[0.0], rays=0.5),
        r"rays = 0\.5: must be a whole number in 0\.\.4096",
    ),
    "basins without starts": (lambda: gs.basins(OSCILLATOR, LAW, 9.0), r"'x'; .*gs\.basins\("),
    "branches of no law": (lambda: gs.branches(OSCILLATOR), r"^law: missing .*law=gs\.Piecewise\("),
    "curve of nothing": (lambda: gs.special_curve(OSCILLATOR), r"'point'; .*gs\.special_curve\("),
    "error of nothing": (lambda: gs.static_error(), r"'law'; .*write gs\.static_error\("),
    "misspelt workers": (lambda: gs.run(TABLES, worker=2), r"'worker'; .*write gs\.run\("),
    "misspelt cache": (lambda: gs.plan(TABLES, caches="a"), r"'caches'; .*write gs\.plan\("),
    "law by its label": (lambda: simulated(law="tanh-1e4"), r"'tanh-1e4': .*contact_law\("),
    "no oscillator": (
        lambda: simulated(oscillator=None),
        r"oscillator = None: .*Oscillator\(\.\.\.\)",
    ),
    "huge frequency": (lambda: simulated(omega=1e300), r"omega = 1e\+300: must be within"),
    "tiny frequency": (lambda: simulated(omega=[9.0, 1e-310]), "omega = 1e-310: must be >= 1e-50"),
    "huge start": (lambda: simulated(v_0=-1e300), r"v_0 = -1e\+300: must be within"),
    "tiny tolerance": (lambda: simulated(atol=1e-300), "atol = 1e-300: must be >= 1e-50"),
    "huge damping": (lambda: paper_oscillator(zeta=1e308), r"zeta = 1e\+308: must be within"),
    "huge omega_n": (lambda: paper_oscillator(omega_n=1e308), r"omega_n = 1e\+308: must be within"),
    "tiny mass": (lambda: paper_oscillator(mass=1e-308), "mass = 1e-308: must be >= 1e-50"),
    "huge gamma": (lambda: gs.LogArctan(1.4e4, GAP, 1e300), r"gamma = 1e\+300: must be within"),
    "response without law": (lambda: answered(law=None), "law = None: must be a contact law"),
    "text for a time": (
        lambda: simulated(dense_output=True).sample("a"),
        "t = 'a': must be a time",
    ),
    "text for n_periods": (lambda: gs.Steady(n_periods="a"), "n_periods = 'a': must be a whole"),
    "None for n_periods": (lambda: gs.Steady(n_periods=None), "n_periods = None: must be a whole"),
    "half an extremum": (lambda: gs.Steady(max_extrema=2.5), "max_extrema = 2.5: must be a whole"),
    "too many extrema": (lambda: gs.Steady(max_extrema=10**6), r"max_extrema = .* in 1\.\.65536"),
    "label for a function": (lambda: gs.law("tanh-1e4", 1e4, GAP), "'tanh-1e4': .*contact_law"),
    "one wall for a gap": (lambda: gs.Piecewise(1e4, 1e-4), r"gap = 0.0001: .* both walls .*Gap\("),
    "three walls": (
        lambda: gs.Piecewise(1e4, (0.0, 0.0, 0.0)),
        r"gap = .*0.0\): .* both walls",
    ),
    "gap with one wall": (lambda: gs.Gap(1e-4), r"Gap: .*j_2.*gs\.Gap\("),
    "oscillator by position": (lambda: gs.Oscillator(0.02, 20), r"zeta, omega_n, .*mass=3"),
    "free motion without a frequency": (
        lambda: gs.simulate(gs.Oscillator(**MACHINE | {"forcing": 0.0}), LAW, x_0=1e-3, t_end=1.0),
        r"omega: missing; .*gs\.System",
    ),
    "number left out": (
        lambda: gs.Oscillator(mass=1.0, omega_n=2.0, zeta=0.1),
        r"'forcing'.*write gs.Oscillator\(mass=3.0, omega_n=5.0, zeta=0.03, forcing=4.0\)",
    ),
    "misnamed change": (lambda: gs.systems.paper_oscillator(m=1), r"'m'; .*mass.*Hz"),
    "misnamed mass": (lambda: gs.Oscillator(m=1), r"'m'; .*mass.*Hz"),
    "law without sharpness": (lambda: gs.Tanh(1e4, GAP), r"Tanh: .*epsilon.*1/m"),
    "load by position": (lambda: gs.Harmonic([30.0, 0.0]), r"Harmonic: .*amplitude=\["),
    "study by its path": (lambda: gs.Study("quick.toml"), r"'quick.toml': .*Study\.load\("),
    "no label": (lambda: gs.contact_law(None, 1e4, GAP), "None: must be a label, one of piecewise"),
    "half a degree": (lambda: gs.Polynomial(1e4, GAP, 2.5), r"2\.5: must be a whole .*1\.\.60"),
    "text for a degree": (lambda: gs.RationalPolynomial(1e4, GAP, "a", 2), "numerator .*whole"),
    "error of no law": (lambda: gs.static_error(None), "law = None: must be a contact law"),
    "basins of nothing": (
        lambda: gs.basins(OSCILLATOR, LAW, 9.0, x=["a"], v=[0.0]),
        r"x = \['a'\]: must be finite numbers",
    ),
}

NO_NUMBERS = ["1", "9.0", b"1", True, np.True_, np.array(True), np.str_("1"), 1j]
NUMBERS = [1, np.float32(1.0), np.int8(1), np.array(1.0), np.array(1), Fraction(1), Decimal(1)]
TAKE_NUMBERS = {
    "wall": lambda value: gs.Gap(value, 0.0),
    "damping": lambda value: paper_oscillator(zeta=value),
    "stiffness": lambda value: gs.Piecewise(value, GAP),
    "frequency": lambda value: simulated(omega=value),
    "one of some starts": lambda value: simulated(x_0=[value, 0.0]),
    "one of some objects": lambda value: simulated(x_0=np.array([value, 0.0], dtype=object)),
    "end": lambda value: simulated(t_end=value),
    "tolerance": lambda value: simulated(atol=value),
    "frequency of a response": lambda value: answered(omega=value),
    "matrix": lambda value: gs.System(mass=[[1.0]], stiffness=[[value]]),
    "speed": lambda value: gs.systems.typical_section(speed=value),
    "time of a sample": lambda value: simulated(t_end=1.0, dense_output=True).sample(value),
}


@pytest.mark.parametrize("value", NO_NUMBERS, ids=repr)
@pytest.mark.parametrize("name", TAKE_NUMBERS)
def test_text_and_truth_values_are_no_numbers(name, value):
    with pytest.raises(gs.ModelError, match="must be a"):
        TAKE_NUMBERS[name](value)


@pytest.mark.parametrize("value", NUMBERS, ids=repr)
@pytest.mark.parametrize("name", TAKE_NUMBERS)
def test_numbers_of_all_kinds_are_taken(name, value):
    TAKE_NUMBERS[name](value)


@pytest.mark.parametrize("value", [True, np.True_, "2"], ids=repr)
def test_truth_values_are_no_whole_numbers(value):
    with pytest.raises(gs.ModelError, match="must be a whole number"):
        gs.Steady(n_periods=value)


@pytest.mark.parametrize("name", REFUSED)
def test_one_line_names_the_value_and_the_remedy(name):
    ask, message = REFUSED[name]
    with pytest.raises((gs.ModelError, gs.StudyError), match=message) as refused:
        ask()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "oscillator",
    [
        paper_oscillator(mass=1e-50, alpha=1e50, forcing=1e50),
        paper_oscillator(zeta=1e50, omega_n=1e50),
        paper_oscillator(omega_n=1e-50, mass=1e-50, forcing=1e50),
    ],
    ids=["light", "damped", "slow"],
)
@pytest.mark.parametrize("label", ["piecewise", "tanh-1e50", "logarctan-1e50"])
@pytest.mark.filterwarnings("ignore:(zeta|omega) = :UserWarning")  # no machine is there
def test_what_is_accepted_overflows_nowhere(label, oscillator):
    # Warnings are errors here. The motion may fail: that is a status.
    law = gs.contact_law(label, 1e50, gs.Gap(1e-50, 1.0))
    for omega in (1e-50, 1.0):
        run = gs.simulate(oscillator, law, omega, t_end=1e-3)
        assert run.status is not gs.Status.OK or math.isfinite(run.x_end)


@pytest.mark.parametrize("K_c", [1e35, 1e50])
def test_reference_engine_that_cannot_take_a_step_says_so(K_c):
    run = simulated(law=gs.Piecewise(K_c, GAP), engine="scipy")
    assert run.status is gs.Status.STEP_UNDERFLOW
    assert 0.0 < run.t_end < 0.1
    assert len(run.t_contacts) == run.n_contacts


CALLED = {
    "workers": [-1, 0, "2", 1.5, True, None, 10**6],
    "batch": [0, -5, "a"],
    "timeout": [0, -1.0, float("nan"), "a", None],
    "out": ["n" * 400, "a\0b", 3],
    "cache": ["n" * 400, "a\0b", 3],
    "scheduler": [3, b"tcp://127.0.0.1:8786"],
}


@pytest.mark.parametrize(
    ("name", "value"),
    [(name, value) for name, values in CALLED.items() for value in values],
    ids=lambda value: f"{value!r:.10}",
)
def test_arguments_of_a_run_are_refused_before_anything_starts(tmp_path, monkeypatch, name, value):
    monkeypatch.chdir(tmp_path)
    calls = [gs.run, *([gs.query] * (name in ("workers", "cache", "scheduler")))]
    calls += [gs.plan] * (name in ("timeout", "cache"))
    for call in calls:
        with pytest.raises(gs.GapsweepError, match=f"^{name} = .*: must be ") as refused:
            call(gs.Study.from_dict(TABLES), **{name: value})
        assert "\n" not in str(refused.value)
        assert len(str(refused.value)) < 300
    assert not list(tmp_path.iterdir())


def test_a_folder_too_long_for_sockets_is_named_before_a_cluster_starts(tmp_path, monkeypatch):
    """Names of sockets have up to 107 bytes (man 7 unix); those of workers add 32."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / ("n" * 100)))
    (tmp_path / ("n" * 100)).mkdir()
    with pytest.raises(gs.ClusterError, match=r"TMPDIR = .* TMPDIR=/tmp"):
        gs.query(gs.Study.from_dict(TABLES), cache=tmp_path / "cache")


def test_a_refusal_of_many_blocks_is_short():
    many = {**TABLES, "sweep": [{"representation": "piecewise"}] * 2000}
    with pytest.raises(gs.StudyError, match=r"and 5900 more problems$") as refused:
        gs.Study.from_dict(many)  # K_c, gap and omega are missing
    assert len(refused.value.problems) == 101


def test_lists_without_an_end_are_refused_at_once():
    block = TABLES["sweep"][0]
    many = np.broadcast_to(9.0, 10**7 + 1)
    with pytest.raises(gs.StudyError, match="10000001 values: must have <= 10000000"):
        gs.Study.from_dict({**TABLES, "sweep": [{**block, "omega": many}]})
    itself = []
    itself.append(itself)
    with pytest.raises(gs.StudyError, match="must not contain itself"):
        gs.Study.from_dict({**TABLES, "sweep": [{**block, "omega": itself}]})


MACHINE = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
BLOCK = {"representation": "piecewise", "K_c": 1.4e4, "gap": [4e-4, 4e-4], "omega": 9.0}
NAN, INF = float("nan"), float("inf")


def machine(**changes):
    return lambda: gs.Oscillator(**_with(MACHINE, changes)), {"oscillator": changes}


def contact(label="piecewise", K_c=1.4e4, gap=(4e-4, 4e-4), **more):
    def law():
        return gs.contact_law(label, K_c, gs.Gap(*gap), **more)

    block = {"representation": label, "K_c": K_c, "gap": list(gap), **more}
    return law, {"sweep": block}


def frequency(omega):
    return lambda: answered(omega=omega), {"sweep": {"omega": omega}}


def start(x, v=0.0):
    return lambda: answered(x_0=x, v_0=v), {"sweep": {"initial_condition": [[x, v]]}}


def settings(**changes):
    return lambda: answered(**changes), {"solver": changes}


def steady(**changes):
    return lambda: gs.Steady(**changes), {"steady": changes}


# From a call and the tables of a study with one mistake to the words that both must have.
BOTH = {
    "negative zeta": (*machine(zeta=-1.0), "must be >= 0"),
    "zeta in words": (*machine(zeta="3 Hz"), "zeta = '3 Hz': must be a number"),
    "zeta nan": (*machine(zeta=NAN), "zeta = nan: must be finite"),
    "no zeta": (*machine(zeta=None), "missing"),
    "zero mass": (*machine(mass=0.0), "must be > 0"),
    "mass in words": (*machine(mass="3 m"), "mass = '3 m': must be a number"),
    "truth for a mass": (*machine(mass=True), "mass = True: must be a number"),
    "no mass": (*machine(mass=None), "missing"),
    "huge mass": (*machine(mass=1e80), "mass = 1e+80: must be within -1e+50..1e+50"),
    "negative omega_n": (*machine(omega_n=-5.0), "must be >= 0"),
    "no omega_n": (*machine(omega_n=None), "missing"),
    "infinite forcing": (*machine(forcing=INF), "forcing = inf: must be finite"),
    "no forcing": (*machine(forcing=None), "missing"),
    "misspelt omega_n": (*machine(omegan=5.0), "omega_n"),
    "huge alpha": (*machine(alpha=1e80), "alpha = 1e+80: must be within -1e+50..1e+50"),
    "negative c": (*machine(c=-1.0), "must be >= 0"),
    "load in words": (*machine(mean_load="2 kg"), "mean_load = '2 kg': must be a number"),
    "negative K_c": (*contact(K_c=-1.0), "must be >= 0"),
    "K_c in words": (*contact(K_c="14 kN"), " = '14 kN': must be a number"),
    "infinite K_c": (*contact(K_c=INF), " = inf: must be finite"),
    "negative ratio": (*contact(K_ratio=-1.0), "must be >= 0"),
    "gap without walls": (*contact(gap=(INF, INF)), "no wall on either side"),
    "gap that is no number": (*contact(gap=(math.nan, 4e-4)), " = nan: must be "),
    "unknown law": (
        *contact("tan-1e4"),
        "unknown representation 'tan-1e4': did you mean tanh-1e4?",
    ),
    "law of no sharpness": (*contact("tanh"), "'tanh': must be tanh and its convergence parameter"),
    "sharpness 0": (*contact("tanh-0"), "'tanh-0': the convergence parameter must be > 0"),
    "high degree": (*contact("poly-99"), "degree '99' must be a whole number in 1..60"),
    "frequency 0": (*frequency(0.0), "must be > 0"),
    "negative frequency": (*frequency(-9.0), "must be > 0"),
    "frequency in words": (*frequency("9 1/s"), " = '9 1/s': must be a number"),
    "frequency nan": (*frequency(NAN), " = nan: must be finite"),
    "no frequency": (*frequency(None), "omega: missing; write omega = "),
    "infinite start": (*start(INF), " = inf: must be finite"),
    "start in words": (*start("1 kg"), " = '1 kg': must be a number"),
    "loose rtol": (*settings(rtol=1.0), "must be <= 0.1"),
    "rtol 0": (*settings(rtol=0.0), "must be >= 1e-13"),
    "negative atol": (*settings(atol=-1.0), "must be > 0"),
    "settle_tol": (*steady(settle_tol=2.0), "must be <= 0.1"),
}


def _with(table, changes):
    return {k: v for k, v in (table | changes).items() if v is not None}


@pytest.mark.parametrize("name", BOTH)
def test_a_call_and_a_study_refuse_in_the_same_words(name):
    call, changes, words = BOTH[name]
    ((table, changed),) = changes.items()
    tables = {"study": {"name": "s"}, "oscillator": MACHINE, "sweep": BLOCK}
    tables |= {table: _with(tables.get(table, {}), changed)}
    tables["sweep"] = [tables["sweep"]]
    with pytest.raises(gs.ModelError) as called:
        call()
    with pytest.raises(gs.StudyError) as studied:
        gs.Study.from_dict(tables)
    (line,) = str(studied.value).splitlines()
    assert words in str(called.value)
    assert words in line
