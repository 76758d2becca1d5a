"""Uncertain numbers in a study, on real worker processes: `risk.nc`, its report, and the cache."""

import math

import numpy as np
import pytest
import scipy.stats
import xarray as xr

import gapsweep as gs

pytestmark = pytest.mark.extended

TABLES = {
    "study": {"name": "sure"},
    "oscillator": {"mass": 1.0, "omega_n": 0.5 / math.pi, "zeta": 0.025},
    "sweep": [{"representation": ["piecewise"], "K_c": 2.0, "omega": 1.1 / (2.0 * math.pi)}],
    "uncertain": {
        **{"samples": 32, "repeats": 2, "seed": 5, "indices": True},
        "gap": {"lognormal": 0.1745, "sd": 0.05},
        "forcing": {"lognormal": 0.03, "sd": 0.1},
        "event": [{"name": "large", "quantity": "amplitude", "above": 0.2}],
    },
}
LAW = gs.Piecewise(2.0, gs.Gap(0.1745, 0.1745))


def test_a_study_has_the_risk_of_a_call(client, tmp_path):
    """The same samples, once by a plan, workers and files, once by one call from lists."""
    out = tmp_path / "out"
    study = gs.Study.from_dict(TABLES)
    with gs.risk(study, client=client, out=out, cache=tmp_path / "c") as ds:
        found = ds.load().squeeze(drop=True)
    of = {
        n: scipy.stats.lognorm(sd, scale=x)
        for n, sd, x in (("gap", 0.05, 0.1745), ("forcing", 0.1, 0.03))
    }
    events = {"large": {"quantity": "amplitude", "above": 0.2}}
    settings = {"samples": 32, "repeats": 2, "seed": 5, "indices": True}
    oscillator = gs.Oscillator(mass=1.0, omega_n=0.5 / math.pi, zeta=0.025, forcing=0.03)
    omega = study.grid.omega[0]
    expected = gs.risk(oscillator, LAW, of, omega, events=events, **settings).squeeze(drop=True)
    for name in expected.data_vars:
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-9, err_msg=name)
    assert "agreement.nc" not in {path.name for path in out.iterdir()}
    page = (out / "report" / "index.html").read_text()
    assert "Largest probability of “large”" in page


def test_twice_the_samples_compute_only_the_new_ones(client, tmp_path):
    twice = TABLES | {"uncertain": TABLES["uncertain"] | {"samples": 64}}
    counts = []
    for tables in (TABLES, twice):
        ds = gs.query(gs.Study.from_dict(tables), client, cache=tmp_path / "c")
        counts.append([ds.attrs[name] for name in ("n_points", "n_hits", "n_computed")])
    assert counts == [[256, 0, 256], [512, 256, 256]]
    header, *rows = ds.gapsweep.to_csv().splitlines()
    gap = header.split(",").index("drawn_gap [mm]")
    drawn = [float(row.split(",")[gap]) for row in rows]
    np.testing.assert_allclose(drawn, 1e3 * ds["drawn_gap"], rtol=1e-12)


def test_safe_values_come_first_in_the_report(client, tmp_path):
    uncertain = TABLES["uncertain"] | {
        **{
            "samples": 64,
            "repeats": 8,
            "indices": False,
            "gap": {"lognormal": 1.0, "sd": 0.05, "nominal": "times"},
        },
        "safe": {"along": "gap", "event": "large", "probability": 0.05},
    }
    gaps = [[0.1745, 0.1745], [0.21, 0.21], [0.25, 0.25]]
    sweep = [TABLES["sweep"][0] | {"gap": gaps}]
    study = gs.Study.from_dict(TABLES | {"sweep": sweep, "uncertain": uncertain})
    with gs.risk(study, client=client, out=tmp_path / "out", cache=tmp_path / "c") as ds:
        p = ds["probability"].squeeze().values
    # Large if gap/.1745 < R F/.03, of a number with the logarithms' standard deviation.
    z = np.log(1.0873784908816 * 0.1745 / np.array([0.1745, 0.21, 0.25])) / math.hypot(0.05, 0.1)
    np.testing.assert_allclose(p, scipy.stats.norm.cdf(z), atol=0.02)
    page = (tmp_path / "out" / "report" / "index.html").read_text()
    first = page.index("the smallest gap with P(large) at most 0.05 is 250/250 mm")
    assert first < page.index("Largest probability of")
    with xr.open_dataset(tmp_path / "out" / "responses.nc") as responses:
        assert responses["amplitude"].dims[-2:] == ("sample", "initial_condition")
        assert responses["drawn_gap"].dims == ("sample",)


def test_a_study_has_the_disturbances_of_a_call(client, tmp_path):
    """Computed by the workers, in two cases at once; the first has a single attractor."""
    axis, omegas = [-1.0, 0.0, 1.0], [1.0 / (2.0 * math.pi), 1.3 / (2.0 * math.pi)]
    starts = {"grid": [3, 3], "x": [-1.0, 1.0], "v": [-1.0, 1.0]}
    sweep = {"representation": "piecewise", "K_c": 2.0, "gap": [0.1745, 0.1745]}
    tables = {
        "study": {"name": "knocks"},
        "oscillator": TABLES["oscillator"] | {"forcing": 0.03},
        "sweep": [sweep | {"omega": omegas, "initial_condition": starts}],
        "attractors": {"rays": 8},
    }
    study = gs.Study.from_dict(tables)
    gs.run(study, client, out=tmp_path / "out", cache=tmp_path / "c").close()
    expected = gs.basins(study.oscillator, LAW, study.grid.omega[1], x=axis, v=axis, rays=8)
    with gs.open(tmp_path / "out" / "attractors.nc") as ds:
        one, two = (ds.squeeze().isel(omega=k) for k in (0, 1))
        assert two["n_attractors"] == expected.sizes["attractor_number"] == 2
        for name in ("disturbance", "disturbed_x", "disturbance_v", "single_up_v", "single_down_x"):
            np.testing.assert_allclose(two[name], expected[name], rtol=1e-7, err_msg=name)
        assert one["n_attractors"] == 1
        assert np.isnan(one["disturbance"]).all()


def test_disturbances_of_user_laws_are_refused():
    tables = {
        "study": {"name": "own"},
        "oscillator": TABLES["oscillator"] | {"forcing": 0.03},
        "sweep": [{"representation": "own:spring", "omega": 1.0}],
        "attractors": {"rays": 8},
    }
    with pytest.raises(gs.StudyError, match="attractors: not with user laws"):
        gs.Study.from_dict(tables)
