"""The paper's claims: none is decided before it is measured, and its own numbers hold."""

import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from workflows.paper import claims as paper
from workflows.paper.cftool import RATIOS as RANDOM_RATIOS
from workflows.paper.cftool import UNITS
from workflows.paper.ladders import CONSTRAINTS, DEGREES, PARAMETERS, RATIOS, VARIABLES
from workflows.paper.language import SETTINGS, At, Quantity, alike
from workflows.paper.measures import median, named, ranges
from workflows.paper.refined import BASINS, CLOUD, MOTIONS, WINDOWS
from workflows.paper.scenes import EXACT, STARTS, TANGENTS, WEAK

from gapsweep.analysis.claims import NotInRunError, Number, Run, stated
from gapsweep.study.study import Study

EXACT_LAWS = (EXACT, f"{EXACT}@half", f"{EXACT}@jitter")
FOLDER = Path(paper.__file__).parent
CLAIMS = sorted(stated(vars(paper)), key=lambda claim: claim.id)
N_DRAWS, N_FEW = 60, 5
KINDS_OF_STARTS = ["fixed"] * 4 + ["sweep_up", "sweep_down"]
X_0 = [0.0, 4e-4, 1e-3, -1e-3, 0.0, 0.0]
N_STARTS = len(X_0)
LEVELS = (0.0, 0.02, 0.3, 0.6, 0.8, 0.97, 1.0)
COUNTS = {"period_multiple": 4, "n_extrema": 8, "response_class": 3, "n_wells": 4}
USUAL = {"period_multiple": (1, 3), "n_extrema": (2, 6), "response_class": (0, 1)}
SHARES = {"recall", "f1", "same_attractor", "class_agreement", "best_share", "pole_share"}


@pytest.fixture(scope="module")
def study():
    return Study.load(FOLDER / "study.toml")


class Drawn(Run):
    """A run whose numbers are drawn anew, as the axes of the study have them.

    Laws differ by how often they agree with what all share, so that shares near 0 and 1, equal laws
    and unlike ones all come up.
    """

    def __init__(self, study, draw):
        super().__init__({})
        object.__setattr__(self, "study", study)
        object.__setattr__(self, "draw", draw)

    def rng(self, *key):
        return np.random.default_rng([self.draw, zlib.crc32(repr(key).encode())])

    def values(self, name, label, scene, shape):
        """Mostly what all laws share, or mostly not."""
        common, own = self.rng(name, scene), self.rng(name, scene, label)
        everywhere = self.rng("alike").random() < 0.2
        level = 1.0 if everywhere else self.levels(own, name, scene, shape)
        if label in EXACT_LAWS and self.rng("floors").random() < 0.5:
            level = 1.0
        agree = own.random(shape) < level
        if name == "status":
            return np.zeros(shape, int)
        if name in ("nfev", "t_simulated") and self.rng("table").random() < 0.2:
            return np.full(shape, 6.5 if name == "nfev" and "tan" not in label else 1.0)
        if name in COUNTS:
            both = (
                rng.choice(COUNTS[name], p=self.odds(rng, name), size=shape)
                for rng in (common, own)
            )
        elif name in SHARES:
            return agree.astype(float)
        else:
            level = 10.0 ** self.rng(name).choice([-6.0, -4.0, -2.0, 0.0])
            both = (
                level * 10.0 ** (rng.uniform(-1, 1) + rng.normal(0.0, 0.3, shape))
                for rng in (common, own)
            )
            if name in ("x_max", "x_min"):
                signs = (
                    rng.choice([-1.0, 1.0], p=self.odds(rng, 2), size=shape)
                    for rng in (common, own)
                )
                both = (value * sign for value, sign in zip(both, signs, strict=True))
        shared, other = both
        return np.where(agree, shared, other)

    def levels(self, own, name, scene, shape):
        """Shares of agreement of a law: below 15 Hz, above it, and in chaotic motion."""
        low, high, chaotic = own.choice(LEVELS, 3)
        omega = np.array(self.study.grid.omega)
        if np.ravel(shape)[0] != omega.size:
            return low
        level = np.where(omega < 15.0, low, high).reshape(-1, *[1] * (np.size(shape) - 1))
        if name in ("x_max", "x_min"):
            kind = self.values("response_class", "piecewise@paper", scene, shape)
            level = np.where(kind == 1, chaotic, level)
        return level

    def odds(self, rng, name):
        weights = rng.random(COUNTS.get(name, name)) ** 12 + 1e-4
        if name in USUAL and rng.random() < 0.5:
            weights[rng.choice(USUAL[name])] = 1e6
        return weights / weights.sum()

    def scene(self, name, representation, K_c, gap, *names):
        if name == "static":
            at = {"representation": representation, "K_c": K_c, "gap": gap}
            return self[name][list(names)].sel(at)
        key = (name, representation, K_c, gap, *names)
        if key not in self._read:
            self._read[key] = self.drawn_scene(*key)
        return self._read[key]

    def drawn_scene(self, name, representation, K_c, gap, *names):
        grid = self.study.grid
        sizes = {"omega": len(grid.omega), "initial_condition": N_STARTS}
        if name == "attractors":
            sizes = {"omega": len(grid.omega), "attractor": 4}
        found = xr.Dataset(coords={"omega": np.array(grid.omega)})
        for variable in names:
            dims = list(sizes)
            if variable in ("recall", "f1"):
                dims = ["omega"]
            shape = [sizes[dim] for dim in dims]
            if variable == "extrema":
                found[variable] = (
                    [*dims, "extremum"],
                    self.extrema(representation, (K_c, gap), shape),
                )
                continue
            found[variable] = (dims, self.values(variable, representation, (K_c, gap), shape))
        return found

    def extrema(self, label, scene, shape):
        """Random extrema: 2 to 19 for every point, or 20 for chaotic points and 2 for others."""
        n = self.rng("few").integers(2, 20, shape)
        if self.rng("kind").random() < 0.5:
            n = np.where(self.values("response_class", label, scene, shape) == 1, 20, 2)
        turns = np.linspace(0.5, 1.0, 20) * (-1.0) ** np.arange(20)
        return np.where(np.arange(20) < n[..., None], turns, np.nan)

    def select(self, name, *names, **at):
        return self[name].sel(at)

    def __getitem__(self, name):
        if name not in self._read:
            self._read[name] = self.drawn(name)
        return self._read[name]

    def field(self, key, dims, sizes):
        rng = self.rng(key)
        shape = [sizes[dim] for dim in dims]
        if key in SHARES:
            return dims, rng.choice(LEVELS, shape)
        if key in COUNTS:
            return dims, rng.integers(0, rng.choice([2, COUNTS[key]]), shape)
        if key == "poly_condition":
            return dims, 10.0 ** rng.uniform(0, rng.choice([5, 60]), shape)
        if key == "ratpoly_rmse" and rng.random() < 0.5:
            return dims, np.broadcast_to([1.0 / sum(map(int, r.split("/"))) for r in RATIOS], shape)
        if key == "poly_smallest_degree":
            return dims, rng.choice([0, 5, 13], shape)
        size = rng.choice([0.0, 0.05, 1.0, 6.0])
        value = 10.0 ** (rng.uniform(-8, 2) + rng.normal(0.0, size, shape))
        if key == "smooth_rmse" and rng.random() < 0.5:
            value = np.sort(value, axis=-1)[..., ::-1]
        return dims, value * rng.choice([1.0, -1.0] if key.endswith("at_zero") else [1.0], shape)

    def drawn(self, name):
        grid = self.study.grid
        scene = {"K_c": list(grid.K_c), "gap": [gap.label for gap in grid.gaps]}
        laws = {
            "representation": [
                EXACT,
                *dict.fromkeys(r.law for r in grid.representations),
            ][1:]
        }
        if name == "responses":
            at = {"start": KINDS_OF_STARTS, "x_0": X_0, "v_0": [0.0, 0.0, 0.01, 0.02, 0.0, 0.0]}
            return xr.Dataset(
                {name: ("initial_condition", values) for name, values in at.items()},
                {"representation": list(grid.representations)},
                {"study_json": self.study.json},
            )
        if name == "ladders":
            axes = {
                "gap": scene["gap"], "K_c": scene["K_c"], "constraint": list(CONSTRAINTS),
                "degree": list(DEGREES), "family": list(TANGENTS), "ratio": list(RATIOS),
                "parameter": list(PARAMETERS), "unit": list(UNITS),
            }  # fmt: skip
            dims = {variable: dims for variable, (dims, *_) in VARIABLES.items()}
        elif name == "cftool":
            axes = {"gap": scene["gap"], "ratio": list(RANDOM_RATIOS), "unit": list(UNITS)}
            dims = dict.fromkeys(("pole_share", "best_share", "rmse", "force_at_zero"), tuple(axes))
        elif name == "static":
            x = np.linspace(-4e-3, 4e-3, 81)
            axes = {**laws, **scene, "x": x, "equilibrium": np.arange(3)}
            names = ("rmse", "r_squared", "rmse_in_gap", "rmse_outside", "n_wells",
                     "in_gap_force", "in_gap_frequency_error")  # fmt: skip
            dims = dict.fromkeys(names, ("representation", "K_c", "gap"))
            dims |= {"force_error": (*dims["rmse"], "x"), "forcing": ()}
            dims |= dict.fromkeys(
                ("equilibrium_x", "equilibrium_stable"), (*dims["rmse"], "equilibrium")
            )
        elif name == "bands":
            axes = {"representation": [EXACT, *WEAK], "start": list(STARTS)}
            rng, shape = self.rng(name), (6, 2)
            usual = np.array([12.0, 20.0])[:, None, None] + rng.normal(0.0, 1.0, (2, *shape))
            low, high = np.sort(
                usual if rng.random() < 0.5 else rng.uniform(10, 30, usual.shape), axis=0
            )
            values = {"low": low, "high": high, "peak": rng.normal(11, 0.2, shape)}
            return xr.Dataset({n: (tuple(axes), v) for n, v in values.items()}, axes)
        elif name == "windows":
            axes = {"representation": list(WINDOWS), "start": list(STARTS)}
            axes["omega"] = np.arange(10.0, 30.01, 0.02).round(2)
            values = {
                variable: [
                    [self.values(variable, r, s, axes["omega"].size) for s in STARTS]
                    for r in WINDOWS
                ]
                for variable in ("period_multiple", "response_class")
            }
            return xr.Dataset({n: (tuple(axes), v) for n, v in values.items()}, axes)
        elif name == "cloud":
            dims = ("representation", "start", "x_0")
            periods = [[self.values("period_multiple", r, s, 101) for s in STARTS] for r in CLOUD]
            axes = {"representation": list(CLOUD), "start": list(STARTS)}
            return xr.Dataset({"period_multiple": (dims, np.array(periods))}, axes)
        elif name == "motions":
            axes = {"representation": list(MOTIONS), "start": list(STARTS)}
            axes["omega"], rng = np.arange(40.0), self.rng(name)
            shape = (len(MOTIONS), len(STARTS), 40, 4)
            shared = rng.choice(3, len(MOTIONS))  # who has whose motion, nearly
            x = (
                10.0 ** rng.uniform(-8, 0, 3)[shared][:, None, None, None]
                * rng.normal(size=(3, *shape[1:]))[shared]
                * 10.0 ** (rng.uniform(-3, 3) * (np.arange(40) % 2))[:, None]
            )
            x += 10.0 ** rng.uniform(-8, -1, (len(MOTIONS), 1, 1, 1)) * rng.normal(size=shape)
            kinds = np.tile(np.arange(40) % 2, (len(STARTS), 1))
            values = {"x": ((*axes, "sample"), x), "response_class": (("start", "omega"), kinds)}
            return xr.Dataset(values | {"width": 1.0}, axes)
        elif name == "basins":
            cases = [
                (r, *s, w) for s, (omegas, labels) in BASINS.items() for r in labels for w in omegas
            ]
            periods = [self.values("period_multiple", case, case[1:], 400) for case in cases]
            return xr.Dataset(
                {"period_multiple": (("case", "start"), np.array(periods))},
                {n: ("case", list(v)) for n, v in zip(("representation", "K_c", "gap", "omega"),
                                                      zip(*cases, strict=True), strict=True)},
            )  # fmt: skip
        else:
            assert name == "histories"
            bins, omega = np.arange(0.0, 10.0, 1 / 12), np.repeat([11.0, 21.75], len(STARTS))
            labels = self.study.spec.history[0].representation
            shape = (omega.size, len(labels), bins.size)
            spectrum = 10.0 ** self.rng(name).uniform(-4, 0, shape)
            return xr.Dataset(
                {"spectrum": (("history", "representation", "frequency_bin"), spectrum),
                 "omega": ("history", omega),
                 "x_0": ("history", [x_0 for x_0, _ in STARTS.values()] * 2),
                 "frequency": (("history", "frequency_bin"), np.outer(omega, bins))},
                {"representation": labels},
            )  # fmt: skip
        sizes = {dim: len(values) for dim, values in axes.items()}
        return xr.Dataset({n: self.field(n, d, sizes) for n, d in dims.items()}, axes)


@pytest.fixture(scope="module")
def outcomes(study):
    """Every outcome that every test of every claim has had, over many drawn runs, by setting.

    A claim whose tests have all gone both ways is not drawn again.
    """
    found = {}
    for draw in range(N_DRAWS):
        run = Drawn(study, draw)
        for claim in CLAIMS:
            known = found.setdefault(claim.id, {})
            if draw >= N_FEW and all({True, False} <= seen for _, seen in known.values()):
                continue
            with suppress(NotInRunError):  # nothing of a kind was drawn
                tests, _, others = claim.find(run)
                for words, one in {"": tests, **others}.items():
                    for i, test in enumerate(one):
                        known.setdefault((words, i), (test.says, set()))[1].add(test.holds)
    return {(id, *key): seen for id, known in found.items() for key, seen in known.items()}


@pytest.mark.extended
@pytest.mark.filterwarnings("ignore")
def test_no_test_of_a_claim_is_vacuous_or_impossible(outcomes):
    one_way = {key: seen for key, seen in outcomes.items() if not {True, False} <= seen[1]}
    # Numbers that were printed or measured elsewhere decide what they decide.
    known = "Table 2, ", "time of "
    assert not {key: seen for key, seen in one_way.items() if not any(k in seen[0] for k in known)}


def test_claims_are_numbered_without_gaps():
    assert [claim.id for claim in CLAIMS] == list(range(1, 83))


@pytest.mark.parametrize("id", [53, 54, 55, 56, 57, 72])
@pytest.mark.filterwarnings("ignore")
def test_the_papers_own_table_confirms_what_it_restates(study, id):
    tests = CLAIMS[id - 1].find(Drawn(study, 0))[0]
    printed = [test for test in tests if test.says.startswith("Table 2, ")]
    assert printed
    assert all(test.holds for test in printed)


def quantity(**numbers):
    """Numbers by name, those that are pairs with their uncertainty."""
    read = {name: Number(*np.atleast_1d(number)) for name, number in numbers.items()}
    return Quantity("size", tuple((name, lambda _, n=n: n) for name, n in read.items()))


@pytest.mark.parametrize(
    ("comparison", "holds"),
    [
        (quantity(a=1.0, b=3.0) <= 2.0, [True, False]),
        (quantity(a=(1.9, 0.2)) <= 2.0, [None]),
        (quantity(a=1.0) < quantity(b=2.0, c=0.5), [True, False]),  # each with each
        (quantity(a=1.0, b=3.0) < quantity(a=2.0, b=4.0), [True, True]),  # of the same names
        (quantity(a=1.0, b=3.0) / quantity(c=2.0) > 1.0, [False, True]),
        (quantity(a=3.0) - quantity(b=2.0) >= 1.0, [True]),
        (alike(quantity(a=2.0), quantity(b=3.0), 1.6), [True]),
        (alike(quantity(a=3.0), quantity(b=2.0), 1.4), [False]),
    ],
)
def test_quantities_are_compared_pair_by_pair(comparison, holds):
    tests, words = comparison.decided(At(Run({}), {}))
    assert [test.holds for test in tests] == holds
    assert ("✗" in words) is (False in holds)
    assert ("open" in words) is (None in holds)


@pytest.mark.parametrize(("rest", "verdict"), [(1.0, "confirmed"), (3.0, "refuted")])
def test_a_claim_is_decided_with_every_setting_that_it_uses(rest, verdict):
    first, *_ = SETTINGS["start"]
    numbers = {first: 1.0, "rest": rest}
    size = Quantity("size", (("it", lambda at: Number(numbers[at["start"]])),))
    decided = paper.claim(1, "Fig. 1", "'small'", size < 2.0).decided(Run({}))
    assert decided["verdict"] == "confirmed"
    assert f"rest: {verdict}" in decided["sentence"]


@pytest.mark.parametrize("id", [3, 65, 66, 67, 68, 69, 70, 71, 82])
@pytest.mark.filterwarnings("ignore")
def test_claims_on_located_contacts_are_decided_with_both_contact_forces(study, id):
    """The unlocated and smooth laws have one solver, the located one has two."""
    decided = CLAIMS[id - 1].decided(Drawn(study, 0))
    both = [*SETTINGS["force"].values()]
    assert f"{both[0]}: " in decided["sentence"]
    assert f"{both[1].capitalize()}: " in decided["sentence"]
    assert (both[1] in decided["otherwise"]) is (id != 82)


@pytest.mark.parametrize("id", [58, 74])
@pytest.mark.filterwarnings("ignore")
def test_numbers_that_are_typed_in_are_named_so(study, id):
    decided = CLAIMS[id - 1].decided(Drawn(study, 0))
    assert "typed in from benchmarks/one_method.py" in decided["sentence"]
    assert all("typed in" in test["says"] for test in decided["tests"])


def test_the_difference_of_medians_is_that_of_the_pairs():
    """Frequencies differ by decades and the two laws by a tenth of one at each."""
    decades, of = np.linspace(-6.0, 0.0, 41), np.arange(41.0)
    far, near = median(decades + 0.1, of), median(decades, of)
    assert far.floor > 0.5
    paired = far - near
    assert (paired.value, paired.floor) == pytest.approx((0.1, 0.0), abs=1e-12)
    unpaired = far - median(decades[:20], of[:20])
    assert unpaired.floor > 0.5


def test_claims_quote_the_paper():
    for claim in CLAIMS:
        assert "'" in claim.text, claim.id


def test_bands_in_words():
    omega = np.arange(1.0, 9.0)
    assert ranges(omega, np.isin(omega, [2, 3, 4, 7])) == "2-4, 7 Hz"
    assert ranges(omega, np.zeros(8, bool)) == "no frequency"
    assert ranges(omega, np.isin(omega, [1, 3, 4, 6, 8])) == "1, 3-4, 6 Hz and 1 narrower"


def test_names_are_those_of_the_paper():
    names = {
        "poly-13": "Poly-13", "ratpoly-5/3": "RatPoly 5/3", "piecewise": "exact law",
        "logarctan-1e4": "log-arctan", "tanh-1e9@paper": "tanh-1e9 (rtol 1e-4)",
        "piecewise-noevents@finer": "without events (rtol 1e-6)",
    }  # fmt: skip
    assert {label: named(label) for label in names} == names
