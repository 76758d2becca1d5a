"""What cannot be used is refused in one line that names the value and what to do."""

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

import gapsweep as gs
from gapsweep.model.systems import paper_oscillator

GAP = gs.Gap(4e-4, 4e-4)
OSCILLATOR, LAW = paper_oscillator(), gs.Piecewise(1.4e4, GAP)


def simulated(**changes):
    given = {"oscillator": OSCILLATOR, "law": LAW, "omega": 9.0, "t_end": 0.1}
    return gs.simulate(**(given | changes))


def answered(**changes):
    given = {"oscillator": OSCILLATOR, "law": LAW, "omega": 9.0}
    return gs.respond(**(given | changes))


REFUSED = {
    "no frequency": (lambda: simulated(omega=[]), r"omega = \[\]: .* at least one"),
    "None for a frequency": (lambda: simulated(omega=None), "omega = None: must be a number"),
    "None for a start": (lambda: simulated(x_0=None), "x_0 = None: must be a number"),
    "no law": (lambda: simulated(law=None), r"law = None: .* gapsweep\.contact_law\("),
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
