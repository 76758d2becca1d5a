"""Whether the force error of a smooth law tells its accuracy: docs/explanation/rule.md.

    python benchmarks/rule.py
    python benchmarks/rule.py --machines 24 --coupled 4 --page trial.md --picture trial.png

Draws machines, sweeps smooth laws of every family over decades of their parameter, and writes the
page and docs/images/rule.png. Points are cached: an interrupted run resumes. About 5 minutes on two
quiet cores. By similarity, zeta, K_c/k, p/(k g), alpha g²/k and the asymmetry of the gap describe
an oscillator; mass, frequency and gap width are drawn too, and must not matter.
"""

import argparse
import multiprocessing
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

import gapsweep as gs
from gapsweep.analysis.datasets.contact_errors import (
    ADEQUATE,
    FORCE_ERRORS,
    TOO_COARSE,
    expected_range,
    largest_in_gap,
    rms_error,
)
from gapsweep.model.equilibria import search_points
from gapsweep.model.labels import Representation
from gapsweep.report.style import MATPLOTLIB, colour
from gapsweep.response.result import ResponseClass
from gapsweep.user_code.package_digest import numerics_fingerprint

DOCS = Path(__file__).parents[1] / "docs"
PAGE, PICTURE = DOCS / "explanation" / "rule.md", DOCS / "images" / "rule.png"
SEED, N_OMEGA, STARTS = 2026, 24, (0.0, 1.5, -3.0, 6.0)  # initial displacements in gaps g
CLOSE, SHARE = 0.05, 0.95
_AT_REST = 0.9
EXACT, SHIFTED = "piecewise", "piecewise@shifted"
# Exponents of epsilon p/K_c, or degrees: lowest, highest, number of laws per machine.
DRAWN = {
    "tanh": (-0.3, 2.2, 3), "arctan": (0.2, 2.8, 3), "logarctan": (0.7, 4.5, 3), "poly": (5, 60, 3)
}  # fmt: skip
RATIOS = ("3/2", "5/3", "5/5", "7/5")
FITTED_BELOW = 30.0  # K_c/k: harder walls are beyond every fit
FAMILIES = (*DRAWN, "ratpoly")
NUMBERS = ("RMS", "mean magnitude", "maximum", "maximum in the gap")
BINS = (0.0, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, np.inf)
GRID = [digit * 10.0**power for power in range(-5, 1) for digit in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)]

Case = dict[str, Any]


def drawn(n: int, coupled: bool) -> tuple[dict[str, Any], dict[str, float], float]:
    """A study of one machine with all its laws, its dimensionless groups, and g [m]."""
    rng = np.random.default_rng([SEED, n, coupled])
    zeta, g, peak = rng.uniform(0.015, 0.06), 10 ** rng.uniform(-4, -3), rng.uniform(2, 15)
    asymmetry = (0.0, 0.0, rng.uniform(0, 1), 1.0)[rng.integers(4)]
    alpha, is_joint = 0.0, False
    if coupled:  # a wall for the first of two masses, or a joint between them
        mass = np.diag(10 ** rng.uniform(-0.5, 0.7, 2))
        k_1, k_2 = 10 ** rng.uniform(1.5, 3, 2)
        stiffness = np.array([[k_1 + k_2, -k_2], [-k_2, k_2]])
        is_joint = bool(rng.integers(2))
        # The first coordinate is that of the contact.
        turned = np.array([[1.0, 1.0], [0.0, 1.0]]) if is_joint else np.eye(2)
        mass, stiffness = (turned.T @ each @ turned for each in (mass, stiffness))
        lowest = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real.min())
        damping = zeta / lowest * stiffness
        k = 1.0 / np.linalg.inv(stiffness)[0, 0]

        def receptance(w: float) -> float:
            matrix = stiffness - w * w * mass + 1j * w * damping
            return float(abs(np.linalg.solve(matrix, [0.0, 1.0])[0]))

        p = g * peak / max(map(receptance, lowest * np.linspace(0.4, 2.2, 400)))
        omega = lowest * np.linspace(0.4, 2.2, N_OMEGA // 2) / 2 / np.pi
        model: dict[str, Any] = {
            "system": {
                "mass": mass.tolist(),
                "damping": damping.tolist(),
                "stiffness": stiffness.tolist(),
                "contacts": {"c": [1.0, 0.0]},
                "forcing": [{"amplitude": [0.0, float(p)]}],
            }
        }
    else:
        mass, omega_n = 10 ** rng.uniform(-1, 1.5), 10 ** rng.uniform(0.3, 2)
        k = mass * (2 * np.pi * omega_n) ** 2
        p = 2 * zeta * k * g * peak
        alpha = 0.0 if rng.random() < 0.5 else k / g**2 * 10 ** rng.uniform(-3, -1)
        omega = omega_n * np.linspace(0.3, 3, N_OMEGA)
        oscillator = {"mass": mass, "omega_n": omega_n, "zeta": zeta, "forcing": p, "alpha": alpha}
        model = {"oscillator": oscillator}
    K_c = k * 10 ** rng.uniform(-0.5, 2.6)
    laws = [EXACT, SHIFTED]
    for family, (low, high, several) in DRAWN.items():
        edges = np.linspace(low, high, 2 if coupled else several + 1)
        values = rng.uniform(edges[:-1], edges[1:])
        if family != "poly":
            laws += [f"{family}-{x:.2e}" for x in 10**values * K_c / p]
        elif K_c < FITTED_BELOW * k and not coupled:
            laws += [f"poly-{round(x)}" for x in values]
            laws += [f"ratpoly-{RATIOS[rng.integers(len(RATIOS))]}"]
    at_rest = [0.0] * (3 if coupled else 1)
    sweep = {
        "representation": laws,
        "K_c": K_c,
        "gap": [g * (1 - asymmetry), g * (1 + asymmetry)],
        "omega": omega.tolist(),
        "initial_condition": [[x * g, *at_rest] for x in STARTS],
    }
    # An aperiodic motion of two masses would be followed for minutes, and counts nowhere.
    steady = {"max_periods": 300, "max_decay_times": 20.0} if coupled else {}
    study = model | {
        "study": {"name": "rule"},
        "steady": steady,
        "approximation": {"range": 1.2 * g * max(peak, max(STARTS))},
        "protocol": {"shifted": {"start_jitter": 1e-4 * g}},
        "sweep": [sweep],
    }
    groups = {
        "zeta": zeta, "K_c/k": K_c / k, "p/(k g)": p / k / g, "alpha g²/k": alpha * g * g / k,
        "asymmetry": asymmetry, "coordinates": 1 + coupled, "joint": is_joint, "K_c/p": K_c / p,
    }  # fmt: skip
    return study, {name: float(value) for name, value in groups.items()}, g


def ends(ds: Any, label: int) -> tuple[np.ndarray, np.ndarray]:
    """Highest, then lowest displacements over frequencies and starts; periods, 0 for none."""
    one = ds.isel(representation=label, K_c=0, gap=0)
    high, low, kind, period = (
        one[name].transpose("omega", "initial_condition", ...).values
        for name in ("x_max", "x_min", "response_class", "period_multiple")
    )
    x = np.concatenate([each.reshape(*kind.shape, -1) for each in (high, low)], axis=2)
    return x, np.where(kind == ResponseClass.PERIODIC, period, 0)


def errors(
    exact: tuple[np.ndarray, np.ndarray],
    law: tuple[np.ndarray, np.ndarray],
    g: float,
    n_images: int,
) -> np.ndarray:
    """Error of every periodic attractor of the exact law: of the closest one of the same period.

    The larger error of highest and lowest displacement over the amplitude, or half of g; infinite
    without any. With two images, mirror images count as one attractor.
    """
    found = []
    for x, period, theirs, periods in zip(*exact, *law, strict=True):
        seen: list[np.ndarray] = []
        for at in np.flatnonzero(period):
            high, low = np.split(x[at], 2)
            images = np.array([[*high, *low], [*-low, *-high]])[:n_images]
            if any(np.abs(images - other).max(axis=1).min() < 1e-5 * g for other in seen):
                continue
            seen.append(x[at])
            scale = np.tile(np.maximum((high - low) / 2, g / 2), 2)
            away = np.abs(images[:, None] - theirs[periods == period[at]]) / scale
            found.append(away.max(axis=2).min(initial=np.inf))
    return np.array(found)


def numbers(law: Any, low: float, high: float, p: float) -> dict[str, float]:
    """Force errors of a law over the visited displacements, over the forcing."""
    reach = max(-low, high)
    points = search_points(law, reach)
    x = np.union1d(points[(points > low) & (points < high)], [low, high])
    error = np.abs(law.force(x) - law.exact.force(x))
    mean = float(np.trapezoid(error, x)) / (high - low)
    found = rms_error(law, low, high), mean, float(error.max()), largest_in_gap(law, reach)
    return dict(zip(NUMBERS, np.divide(found, p).tolist(), strict=True))


def measured(machine: tuple[int, bool], cache: str | None, client: Any = None) -> list[Case]:
    """The laws of a machine: numbers, attractors found, median error of their displacements."""
    tables, groups, g = drawn(*machine)
    study = gs.Study.from_dict(tables)
    with warnings.catch_warnings(action="ignore"):  # coarse laws are meant
        ds = gs.query(study, client or _client(), cache=cache, on_progress=lambda _: None)
    exact = ends(ds, 0)
    n_images = 1 + (groups["asymmetry"] == 0.0)
    touched = exact[0][exact[1] > 0]
    low, high = touched[:, touched.shape[1] // 2].min(), touched[:, 0].max()
    (K_c,), (gap,) = study.grid.axes["K_c"], study.grid.gaps
    cases = []
    for at, label in enumerate(study.grid.representations):
        away = errors(exact, ends(ds, at), g, n_images)
        case = {"machine": machine, "groups": groups, "law": label, "n": len(away)}
        case |= {"found": np.mean(away < CLOSE), "error": float(np.median(away))}
        if label not in (EXACT, SHIFTED):
            law = study.law(label, K_c, gap)
            case |= numbers(law, float(low), float(high), K_c / groups["K_c/p"])
        elif label == EXACT and study.model.is_oscillator:
            a, b = expected_range(study.oscillator, study.law(EXACT, K_c, gap))
            law = gs.Tanh(K_c, gap, epsilon=30 * groups["K_c/p"])
            case["expected"] = (
                (b - a) / (high - low),
                rms_error(law, a, b) / rms_error(law, low, high),
            )
        cases.append(case)
    return cases


@lru_cache
def _client() -> Any:
    """A cluster in this process, so that each fit is made once."""
    from distributed import Client

    return Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None)


def wilson(cases: Sequence[Case], is_true: Callable[[Case], bool]) -> tuple[float, float, float]:
    """A share and its 95 % interval; the laws of a machine, which are alike, are one trial."""
    share = float(np.mean([is_true(case) for case in cases]))
    n, z = len({case["machine"] for case in cases}), 1.96
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2)
    return share, max(0.0, middle - half), min(1.0, middle + half)


def is_adequate(case: Case) -> bool:
    return bool(case["found"] >= SHARE)


def fitted(cases: Sequence[Case], share: float) -> tuple[float, float]:
    """Largest force error with 95 % of the laws adequate, smallest with 5 %, a decade at a time."""
    error = np.array([case["RMS"] for case in cases])
    good = np.array([case["found"] >= share for case in cases])
    below = [t for t in GRID if good[(error > t / 10) & (error <= t)].mean() >= 0.95]
    above = [t for t in GRID if good[(error >= t) & (error < 10 * t)].mean() <= 0.05]
    return max(below, default=np.nan), min(above, default=np.nan)


def sorting(cases: Sequence[Case], number: str) -> float:
    """Probability that an adequate law has the smaller number than an inadequate one."""
    good = np.array([is_adequate(case) for case in cases])
    ranks = rankdata([case[number] for case in cases])
    n = good.sum()
    return float(1 - (ranks[good].sum() - n * (n + 1) / 2) / (n * (len(good) - n)))


def table(head: Sequence[str], rows: Iterator[Sequence[str]] | list[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n" + "".join(f"| {' | '.join(line)} |\n" for line in lines) + "\n"


def said(cases: Sequence[Case], is_true: Callable[[Case], bool] = is_adequate) -> str:
    """A share of cases with its interval, as text."""
    if not cases:
        return "–"
    share, low, high = wilson(cases, is_true)
    return f"{share:.0%} [{low:.0%}, {high:.0%}] of {len(cases)}"


def by_error(cases: Sequence[Case]) -> Iterator[list[str]]:
    for low, high in pairwise(BINS):
        here = [case for case in cases if low <= case["RMS"] < high]
        if not here:
            continue
        ratios = [c["error"] / c["RMS"] for c in here if c["RMS"] and np.isfinite(c["error"])]
        quartiles = np.quantile(ratios, [0.25, 0.5, 0.75]) if ratios else [np.nan] * 3
        bounds = f"below {high:g}" if not low else f"above {low:g}"
        yield [
            bounds if not low or np.isinf(high) else f"{low:g} to {high:g}",
            said(here),
            f"{min(case['found'] for case in here):.0%}",
            "{1:.2g} [{0:.2g} to {2:.2g}]".format(*quartiles),
        ]


def parts(cases: Sequence[Case]) -> dict[str, list[Case]]:
    """Groups of cases by name."""
    of = lambda key, test: [case for case in cases if test(case["groups"][key])]  # noqa: E731
    found = {name: [c for c in cases if c["law"].startswith(f"{name}-")] for name in FAMILIES}
    one = of("coordinates", lambda n: n == 1)
    found["one coordinate, equal walls"] = [c for c in one if c["groups"]["asymmetry"] == 0.0]
    found["one coordinate, unequal walls"] = [
        c for c in one if 0.0 < c["groups"]["asymmetry"] < 1.0
    ]
    found["one coordinate, a wall at rest"] = [c for c in one if c["groups"]["asymmetry"] == 1.0]
    found["linear spring"] = [c for c in one if not c["groups"]["alpha g²/k"]]
    found["cubic spring"] = [c for c in one if c["groups"]["alpha g²/k"]]
    two = of("coordinates", lambda n: n == 2)
    found["two coordinates, a wall"] = [c for c in two if not c["groups"]["joint"]]
    found["two coordinates, a joint"] = [c for c in two if c["groups"]["joint"]]
    return found


def by_part(cases: Sequence[Case]) -> Iterator[list[str]]:
    for name, here in {**parts(cases), "all": list(cases)}.items():
        use = [case for case in here if case["RMS"] <= ADEQUATE]
        no = [case for case in here if case["RMS"] >= TOO_COARSE]
        rest = [case for case in here if ADEQUATE < case["RMS"] < TOO_COARSE]
        yield [name, said(use), said(rest), said(no)]


def sharpness(case: Case) -> float:
    return float(Representation(case["law"]).parameter)


def by_sharpness(cases: Sequence[Case]) -> Iterator[list[str]]:
    for name in ("tanh", "arctan", "logarctan"):
        here = parts(cases)[name]
        row = [name]
        for low, high in ((1, 10), (10, 30), (30, 100), (100, 1000), (1000, np.inf)):
            some = [
                case for case in here if low <= sharpness(case) / case["groups"]["K_c/p"] < high
            ]
            row.append(said(some))
        yield row


def failing(cases: Sequence[Case]) -> Iterator[list[str]]:
    """Machines of which a law that is predicted adequate is not."""
    machines: dict[Any, list[Case]] = {}
    for case in cases:
        if case["RMS"] <= ADEQUATE and not is_adequate(case):
            machines.setdefault(case["machine"], []).append(case)
    for (n, coupled), here in machines.items():
        groups = here[0]["groups"]
        laws = ", ".join(f"{c['law']} ({c['RMS']:.1g}: {c['found']:.1%})" for c in here)
        names = ("zeta", "K_c/k", "p/(k g)", "alpha g²/k", "asymmetry")
        numbers = [f"{groups[name]:.3g}" for name in names]
        yield [f"{n}{' (two coordinates)' if coupled else ''}", *numbers, str(here[0]["n"]), laws]


def draw(cases: Sequence[Case], path: Path) -> None:
    """Share found over force error, all laws in their colours, with both thresholds."""
    import matplotlib as mpl
    from matplotlib import pyplot as plt

    with mpl.rc_context({**MATPLOTLIB, "font.size": 11}):
        figure, axes = plt.subplots(figsize=(8.0, 4.6), dpi=120)
        smallest = 1e-6
        jitter = np.random.default_rng(0).uniform(-0.006, 0.006, len(cases))
        for name in reversed(FAMILIES):
            here = [i for i, c in enumerate(cases) if c["law"].startswith(f"{name}-")]
            x = [max(cases[i]["RMS"], smallest) for i in here]
            y = [cases[i]["found"] + jitter[i] for i in here]
            axes.plot(x, y, ".", color=colour(name), ms=5, alpha=0.55, mew=0, label=name)
        axes.axhline(SHARE, color="#888888", lw=1)
        for at, text, side in (
            (ADEQUATE, "use ", "right"),
            (ADEQUATE, " run the study", "left"),
            (TOO_COARSE, " too coarse", "left"),
        ):
            axes.axvline(at, color="#000000", lw=1, ls="--")
            axes.text(at, 1.01, text, ha=side, transform=axes.get_xaxis_transform())
        axes.set_xscale("log")
        axes.set_xlim(smallest * 0.8, 30)
        axes.set_ylim(-0.03, 1.03)
        axes.set_yticks([0, 0.25, 0.5, 0.75, SHARE], ["0", "25 %", "50 %", "75 %", "95 %"])
        axes.set_xlabel("RMS force error over the visited displacements / forcing amplitude")
        axes.set_ylabel("periodic attractors found")
        handles, names = axes.get_legend_handles_labels()
        axes.legend(
            handles[::-1],
            names[::-1],
            loc="center left",
            bbox_to_anchor=(0.0, 0.42),
            markerscale=2.5,
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
        plt.close(figure)


def texts(cases: Sequence[Case]) -> Iterator[tuple[str, str]]:
    """What stands between the markers of the page, by their names."""
    laws = [case for case in cases if "RMS" in case]
    fit, test = ([case for case in laws if case["machine"][0] % 2 == half] for half in (0, 1))
    limits = [
        [f"{share:.0%} of attractors found", f"{fitted(fit, share)[0]:g}", f"at most **{limit:g}**"]
        for share, limit in FORCE_ERRORS.items()
    ]
    limits += [["too coarse", f"{fitted(fit, SHARE)[1]:g}", f"at least **{TOO_COARSE:g}**"]]
    yield "limits", table(["a law is", "fitted", "used"], limits)
    for name, some in (("drawn", laws), ("test", test)):
        machines = {case["machine"] for case in some}
        n = sum(is_coupled for _, is_coupled in machines)
        counts = f"{len(machines) - n} oscillators and {n} systems of two masses"
        yield name, f"{counts}, {len(some)} laws"
    shifted = [case for case in cases if case["law"] == SHIFTED and case["machine"][0] % 2]
    yield "floor", said(shifted)
    ratios = np.array([case["expected"] for case in cases if "expected" in case])
    for name, each in zip(("wide", "low"), ratios.T, strict=True):
        yield name, "{:.2g} to {:.2g}".format(*np.quantile(each, [0.05, 0.95]))
    head = ["force error", "adequate laws", "least found", "amplitude error / force error"]
    yield "errors", table(head, by_error(test))
    head = ["laws", f"force error ≤ {ADEQUATE:g}", "in between", f"≥ {TOO_COARSE:g}"]
    yield "parts", table(head, by_part(test))
    head = ["", "1 to 10", "10 to 30", "30 to 100", "100 to 1000", "above 1000"]
    yield "sharpness", table(head, by_sharpness(test))
    head = ["machine", "ζ", "K_c/k", "p/(k g)", "α g²/k", "asymmetry", "attractors", "laws"]
    yield "failing", table(head, failing(test))
    failed = {
        case["machine"]: case["groups"]["asymmetry"]
        for case in test
        if case["RMS"] <= ADEQUATE and not is_adequate(case)
    }
    lost = sum(case["machine"] in failed and case["found"] < 1.0 for case in shifted)
    at_rest = sum(asymmetry > _AT_REST for asymmetry in failed.values())
    yield (
        "why",
        (
            f"{at_rest} of the {len(failed)} have a wall at the rest position (asymmetry above "
            f"{_AT_REST:g}); on {lost} the exact law loses attractors too, from shifted starts"
        ),
    )
    yield "sorting", ", ".join(f"{name} {sorting(laws, name):.3f}" for name in NUMBERS)
    yield "made", f"numerics {numerics_fingerprint()}"


def written(page: str, name: str, text: str) -> str:
    """A page with a text between two of its markers."""
    marks = re.compile(f"(<!-- {name} -->\n?).*?(<!-- /{name} -->)", re.DOTALL)
    changed, n = marks.subn(lambda found: found[1] + text + found[2], page)
    if n != 1:
        raise ValueError(f"{PAGE}: {n} places marked <!-- {name} -->, not 1")
    return changed


def main(machines: int, coupled: int, page: Path, picture: Path, cache: str | None) -> None:
    wanted = [(n, False) for n in range(machines)] + [(n, True) for n in range(coupled)]
    cases: list[Case] = []
    spawned = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=spawned) as pool:
        for n, found in enumerate(pool.map(partial(measured, cache=cache), wanted), 1):
            cases += found
            print(f"{n} of {len(wanted)} machines", end="\r", flush=True)
    text = PAGE.read_text()
    for name, part in texts(cases):
        text = written(text, name, part)
    page.write_text(text)
    draw([case for case in cases if "RMS" in case], picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--machines", type=int, default=240, help="oscillators")
    parser.add_argument("--coupled", type=int, default=24, help="systems of two masses")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--picture", type=Path, default=PICTURE)
    parser.add_argument("--cache", help="folder of the cache, as for gapsweep run")
    main(**vars(parser.parse_args()))
