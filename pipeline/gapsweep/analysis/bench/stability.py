"""The failure atlas ``stability.nc``: all methods on hard scenarios with a known solution.

Definitions: docs/reference/bench.md.
"""

import numpy as np
import xarray as xr

from gapsweep.analysis.bench.cells import Say, cell_dataset, cell_table
from gapsweep.analysis.bench.judge import WRONG, CellOutcome
from gapsweep.analysis.bench.scenarios import methods, scenarios, tolerances
from gapsweep.execution.progress import DEFAULT_TIMEOUT
from gapsweep.study.study import Study

# Largest rtol at which a wrong result with status ok counts as a fault.
TIGHT_RTOL = 1e-6
VARIABLES = (
    *("outcome", "status", "solver_error", "total_error", "allowed_error", "n_contacts"),
    *("n_steps", "layer_over_step", "reference_distance", "growth", "n_wells", "n_wells_exact"),
    *("in_gap_frequency", "stiffness_ratio", "n_periods"),
)


def stability(
    study: Study, say: Say = lambda text: None, timeout: float = DEFAULT_TIMEOUT
) -> xr.Dataset:
    """Outcomes of every method on every scenario with a stated solution.

    `say` and `timeout`: as for `gapsweep.analysis.bench.cells.cell_table`. Result: over `scene`,
    `method` and `tolerance` (the rung of a method's ladder), `expected` over `scene`. Attribute
    `n_silent_wrong` counts wrong results with status ok at rtol 1e-6 or tighter.
    """
    found, ladder = scenarios(study, with_answer=True), methods(study)
    arrays = cell_table(found, ladder, timeout, say)
    _, rtol, _ = tolerances(ladder)["rtol"]
    silent = (arrays["outcome"] == CellOutcome.SILENT_WRONG) & (rtol <= TIGHT_RTOL * (1.0 + 1e-12))
    counted = {"n_silent_wrong": int(np.sum(silent)), "tight_rtol": TIGHT_RTOL, "wrong": WRONG}
    atlas = cell_dataset(VARIABLES, arrays, found, ladder, study.attributes | counted)
    stated = [scenario.expected for scenario in found]
    attributes = {"units": "1", "long_name": "kind of the known solution"}
    return atlas.assign_coords(expected=("scene", stated, attributes))
