"""Which initial conditions give the band of period 3 that the paper's Fig. 8b shows."""

import numpy as np
import xarray as xr

from gapsweep.model.labels import contact_law
from gapsweep.model.oscillator import Gap
from gapsweep.response.respond import respond
from gapsweep.study.study import Study

from .scenes import EXACT, SOFT


def starts(study: Study) -> xr.Dataset:
    """Scan of initial conditions: the exact law, soft contact, gap 0.4/0.4 mm.

    Returns
    -------
    Dataset
        Over ``x_0`` [m] and ``v_0`` [m/s]: share of the frequencies with period 3 ``inside`` the
        band of Figs 6b and 8b, 17 to 21 Hz, and ``outside`` it, above 12 Hz.
    """
    law = contact_law(EXACT, SOFT, Gap(4e-4, 4e-4))
    omega = np.arange(12.0, 30.05, 0.1).round(1)
    x_0, v_0 = np.linspace(-1e-3, 1e-3, 41), np.linspace(-0.05, 0.05, 5)
    points = np.meshgrid(omega, x_0, v_0, indexing="ij")
    found = respond(study.oscillator, law, *points, rtol=1e-8, atol=1e-11)
    hits, inside = np.equal(found.period_multiple, 3), (omega >= 17.0) & (omega <= 21.0)
    shares = {"inside": hits[inside].mean(axis=0), "outside": hits[~inside].mean(axis=0)}
    return xr.Dataset(
        {
            name: (("x_0", "v_0"), share, {"units": "1", "long_name": f"period 3 {name} the band"})
            for name, share in shares.items()
        },
        {
            "x_0": ("x_0", x_0, {"units": "m", "long_name": "initial displacement"}),
            "v_0": ("v_0", v_0, {"units": "m s-1", "long_name": "initial velocity"}),
        },
    )
