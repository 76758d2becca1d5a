"""Studies that sweep parameters of contacts, from the file to the report."""

import numpy as np
import pytest
import xarray as xr
from tests.builders.runs import run

import gapsweep as gs
from gapsweep.execution.explain import explain
from gapsweep.execution.plan import plan
from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import verify

pytestmark = pytest.mark.extended

RATIOS = (0.2, 1.0, 5.0)
SAME = ("x_max", "x_min", "force_max", "contact_share", "n_contacts", "nfev", "lyapunov")


@pytest.fixture
def swept(tables):
    starts = [[0.0, 0.0], [1e-3, 0.0], [-1e-3, 0.0]]
    tables["sweep"][0] |= {"K_ratio": list(RATIOS), "initial_condition": starts}
    return gs.Study.from_dict(tables)


def test_every_ratio_is_what_it_is_by_itself(swept, tables, client, tmp_path):
    cache = tmp_path / "cache"
    with gs.run(swept, client, out=tmp_path / "out", cache=cache) as ds:
        found = ds.load()
    dims = "representation", "K_c", "gap", "omega", "K_ratio", "initial_condition"
    assert found["x_max"].dims == dims
    assert found["K_ratio"].values.tolist() == list(RATIOS)
    assert found["K_ratio"].attrs["units"] == "1"
    for label in tables["sweep"][0]["representation"]:
        for K_ratio in RATIOS:
            law = gs.contact_law(label, 1.4e4, gs.Gap(0.4e-3, 0.4e-3), K_ratio=K_ratio)
            alone = gs.respond(gs.systems.paper_oscillator(), law, 12.0, steady=swept.steady)
            cell = found.sel(representation=label, K_ratio=K_ratio, omega=12.0).squeeze()
            cell = cell.isel(initial_condition=0)
            for name in SAME:
                assert cell[name].item() == getattr(alone, name), (label, K_ratio, name)
    peaks = found["x_max"].sel(representation="piecewise", omega=12.0).isel(initial_condition=0)
    assert len(np.unique(peaks)) == len(RATIOS)

    attractors = gs.open(tmp_path / "out" / "attractors.nc").load()
    images = attractors["mirror_of"] >= 0
    assert images.sel(K_ratio=1.0).any()
    assert not images.sel(K_ratio=[0.2, 5.0]).any()
    static = gs.open(tmp_path / "out" / "static.nc")
    assert static["force"].dims == ("representation", "K_c", "gap", "K_ratio", "displacement")
    agreement = gs.open(tmp_path / "out" / "agreement.nc")
    assert agreement["n_attractors"].dims == dims[:-1]
    page = (tmp_path / "out" / "report" / "index.html").read_text()
    assert "K_ratio = 0.2" in page

    with Cache(cache) as store:
        assert verify(store).is_sound
    del tables["sweep"][0]["K_ratio"]
    plain = gs.Study.from_dict(tables)
    with Cache(cache, read_only=True) as store:
        assert plan(plain, store).n_missing == 0
        tables["sweep"][0]["K_ratio"] = 0.5
        other = gs.Study.from_dict(tables)
        missing = plan(other, store)
        assert missing.n_missing == missing.n_points
        said = next(iter(explain(missing, 1)))
    assert "K_ratio = 0.5" in said.label
    assert list(said.differences) == ["K_ratio"]
    assert said.differences["K_ratio"][0] == "0.5"


def test_auto_and_sweeps_take_the_ratio_along(tables, client, tmp_path):
    block = {"representation": ["auto", "piecewise"], "K_ratio": [0.5, 2.0], "omega": [7.0, 12.0]}
    tables["sweep"][0] |= block | {"initial_condition": ["sweep_up"]}
    study = gs.Study.from_dict(tables)
    with gs.run(study, client, out=tmp_path / "out", cache=tmp_path / "c-cache") as ds:
        found = ds.load()
    assert (found["status"] == gs.Status.OK).all()
    auto, exact = (found["x_max"].sel(representation=r).squeeze() for r in block["representation"])
    np.testing.assert_allclose(auto, exact, rtol=1e-6)
    apart = exact.diff("K_ratio")
    assert (abs(apart) > 1e-6).all()


def test_axes_of_losses_have_the_results_of_labels(tables, client, tmp_path):
    """Bit for bit; laws without the parameter have the same results at all of its values."""
    (block,) = tables["sweep"]
    block |= {"representation": ["piecewise", "huntcrossley", "rigid"], "omega": [9.0, 12.0]}
    losses = {"chi": [0.0, 0.3], "restitution": [0.6, 1.0]}
    swept = run(tables | {"sweep": [block | losses]}, client, tmp_path, "swept")
    labels = ["piecewise", "huntcrossley-0", "huntcrossley-0.3", "rigid-0.6", "rigid-1"]
    block |= {"representation": labels}
    expected = run(tables | {"sweep": [block]}, client, tmp_path, "labelled")
    assert swept["chi"].attrs["units"] == "s m-1"
    computed = [name for name in swept.data_vars if name not in ("cpu_time", "host", "attractor")]
    for chi in losses["chi"]:
        for e in losses["restitution"]:
            here = swept.sel(chi=chi, restitution=e)
            pairs = {"piecewise": "piecewise"}
            pairs |= {"huntcrossley": f"huntcrossley-{chi:g}", "rigid": f"rigid-{e:g}"}
            for ours, theirs in pairs.items():
                one = here.sel(representation=ours, drop=True).drop_vars(losses)
                other = expected.sel(representation=theirs, drop=True)
                xr.testing.assert_equal(one[computed], other[computed])
    for law, n in (("piecewise", 1), ("huntcrossley", 2), ("rigid", 2)):
        assert len(np.unique(swept["nfev"].sel(representation=law, omega=9.0))) == n
    with Cache(tmp_path / "swept-cache", read_only=True) as store:
        assert store.n_points == 2 * (1 + 2 + 2)
    page = (tmp_path / "swept" / "report" / "index.html").read_text()
    assert "huntcrossley, chi = 0.3 s/m" in page
    assert "rigid, restitution = 0.6" in page
