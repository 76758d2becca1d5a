"""How long motions are watched before they count as settled, or as never settling."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.ensemble import Ensemble
from gapsweep.response.result import Steady

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

# The next look comes when disturbances have shrunk to this share.
_LOOK = 0.25
_ENDLESS = 1e7  # forcing periods that no motion is watched for


@dataclass(frozen=True, slots=True)
class Limits:
    """How many forcing periods motions are given.

    Attributes
    ----------
    pause, settled, last : ndarray of int, shape (n,)
        Between looks, to settle, and until the last look.
    longest : ndarray, shape (n,)
        At a time after that, for an exponent or a torus; infinity where nothing bounds it.
    """

    pause: Counts
    settled: Counts
    last: Counts
    longest: Array

    @classmethod
    def of(cls, ensemble: Ensemble, steady: Steady) -> "Limits":
        rate, omega = ensemble.settling_rate, ensemble.omega
        # Without damping nothing settles: what does not repeat at once never will.
        with np.errstate(over="ignore"):
            decay_periods = np.divide(omega, rate, out=np.zeros(len(rate)), where=rate > 0.0)
        pause, settled, longest = (
            np.ceil(np.minimum(times * decay_periods, _ENDLESS)).astype(np.int64)
            for times in (
                math.log(1.0 / _LOOK),
                math.log(1.0 / steady.settle_tol),
                steady.max_decay_times,
            )
        )
        # A full window more: slow forcing leaves no period between settling and the end.
        last = np.maximum(settled, np.minimum(longest, steady.max_periods)) + steady.n_periods
        longest = omega * (math.inf if steady.t_max is None else steady.t_max)
        last = np.floor(np.minimum(last, np.maximum(1.0, longest))).astype(np.int64)
        return cls(np.maximum(1, np.minimum(pause, last)), settled, last, longest)
