"""Which responses from different starts are the same attractor."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapsweep.response.result import Response, ResponseClass
from gapsweep.response.section import Section, cloud_distance, orbit_distance, scaled
from gapsweep.response.walks import DEVIATIONS

NONE = -1
# Two periodic orbits closer than this share of their reach are one, polished or not.
_SAME_ORBIT = 1e-3
# Two orbits about which their solver rattles are known to this share only.
_SAME_RATTLE = 0.1
# Two chaotic samples are of one attractor if they overlap this well, in shares of their extent.
_SAME_CLOUD = 0.25


@dataclass(frozen=True, slots=True)
class Attractor:
    """An attractor and how many of the starts end on it.

    Attributes
    ----------
    response : Response
        The response of the first start that ends on it.
    members : tuple of int
        Numbers of the starts that end on it.
    n_ending, n_starts : int
        How many of the counted starts end on it, and how many were counted.
    mirror_of : int
        Number of the attractor that is its mirror image (its own if it is symmetric), -1 if
        there is none among those found, or if the gap is not symmetric.
    """

    response: Response
    members: tuple[int, ...]
    n_ending: int
    n_starts: int
    mirror_of: int = NONE

    @property
    def basin_share(self) -> float:
        """Share of the starts that end on it [-]."""
        return self.n_ending / self.n_starts if self.n_starts else math.nan

    @property
    def basin_share_error(self) -> float:
        """Standard error of the share [-], of a binomial sample."""
        if not self.n_starts:
            return math.nan
        return math.sqrt(self.basin_share * (1.0 - self.basin_share) / self.n_starts)


def attractors(
    responses: Sequence[Response],
    omega: float,
    *,
    symmetric: bool,
    counted: Sequence[bool] | None = None,
) -> list[Attractor]:
    """Group the responses of different starts in one scene.

    Unresolved and failed responses belong to no attractor; they count among the starts.

    Parameters
    ----------
    responses : sequence of Response
        One per start.
    omega : float
        Forcing frequency [Hz].
    symmetric : bool
        Whether the gap is symmetric, so that mirror images of attractors are attractors.
    counted : sequence of bool, optional
        Which starts are a sample for basin shares; all if None. A sweep's are not.

    Returns
    -------
    list of Attractor
        In the order of their peaks, then troughs and period multiples.
    """
    groups: list[list[int]] = []
    for i, response in enumerate(responses):
        if not response.section or response.response_class > ResponseClass.CHAOTIC:
            continue
        own = (g for g in groups if _same(responses[g[0]], response, omega))
        group = next(own, None)
        if group is None:
            groups.append([i])
        else:
            group.append(i)
    groups.sort(key=lambda g: _rank(responses[g[0]]))
    firsts = [responses[group[0]] for group in groups]
    sample = [True] * len(responses) if counted is None else counted
    return [
        Attractor(
            response=responses[group[0]],
            members=tuple(group),
            n_ending=sum(sample[i] for i in group),
            n_starts=sum(sample),
            mirror_of=_mirror(responses[group[0]], firsts) if symmetric else NONE,
        )
        for group in groups
    ]


def numbers(found: Sequence[Attractor], n_starts: int) -> list[int]:
    """Number of the attractor of every start, `NONE` where there is none."""
    ids = [NONE] * n_starts
    for number, attractor in enumerate(found):
        for member in attractor.members:
            ids[member] = number
    return ids


def _rank(response: Response) -> tuple[float, float, int]:
    # Rounded, so that the last bits of twins do not decide their order.
    digits = 9
    return round(response.x_max, digits), round(response.x_min, digits), response.period_multiple


def _points(response: Response, omega: float) -> Section:
    return scaled(np.reshape(response.section, (-1, 2)), omega)


def _same(a: Response, b: Response, omega: float) -> bool:
    if a.response_class is not b.response_class:
        return False
    p, q = _points(a, omega), _points(b, omega)
    if a.response_class is ResponseClass.PERIODIC:
        reach = max(abs(a.x_max), abs(a.x_min))
        rattles = max(a.lyapunov_error, b.lyapunov_error) > 0.0
        noise = DEVIATIONS * max((n for n in (a.noise, b.noise) if math.isfinite(n)), default=0.0)
        share = _SAME_RATTLE if rattles else _SAME_ORBIT
        return orbit_distance(p, q) <= max(share * reach, noise)
    extent = max(np.ptp(part) for cloud in (p, q) for part in (cloud.real, cloud.imag))
    return cloud_distance(p, q) <= _SAME_CLOUD * float(extent)


def _mirror(response: Response, all_of_them: Sequence[Response]) -> int:
    """Number of the mirror image: same kind, extrema with the opposite signs."""
    reach = max(abs(response.x_max), abs(response.x_min))
    chaotic = response.response_class is ResponseClass.CHAOTIC
    close = (_SAME_CLOUD if chaotic else 2.0 * _SAME_ORBIT) * reach
    image = np.sort(-np.array(response.extrema))
    for number, other in enumerate(all_of_them):
        if other.response_class is not response.response_class:
            continue
        ends = abs(other.x_max + response.x_min), abs(other.x_min + response.x_max)
        if max(ends) > close or other.period_multiple != response.period_multiple:
            continue
        if chaotic:
            return number
        extrema = np.sort(other.extrema)
        if extrema.size == image.size and np.all(np.abs(extrema - image) <= close):
            return number
    return NONE
