"""The steady response of one sweep point: what it is, how stable, and how sure that is.

A disturbance shrinks like ``exp(-ζ ω_n t)``, so damping sets the time scale. After each pause a
window of forcing periods is recorded. If the section contracts towards a repeat, shooting
finds the periodic orbit itself; it is accepted only if it is close, stable, of that prime
period, and if the motion then really approaches it. A motion that has found no orbit once
transients must have decayed (`settle_tol`) may still be in transient chaos: it is looked at again
and again (`max_decay_times`, `max_periods`). What has found none by then is asked for its Lyapunov
exponent, and looked at for a last time: if it still finds none, positive beyond three standard
errors is chaotic. Negative beyond three, a motion that passes kinks unlocated is a periodic one
that its solver rattles, if it scatters no more than the solver strays. Anything else is
`unresolved`.
With ζ > 0 every area of the section shrinks by the same factor, so there is no third kind.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import DEFAULT_ENGINE, Solver, law_kind
from gapsweep.integrate.simulate import broadcast
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator
from gapsweep.response.ensemble import Ensemble, Scene, State
from gapsweep.response.result import Response, Responses, Steady
from gapsweep.response.search import Search


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What a steady response is asked for: the checked arguments of `respond`."""

    scene: Scene
    start: State
    steady: Steady

    def __post_init__(self) -> None:
        for name, value, kind in (
            ("oscillator", self.scene.oscillator, Oscillator),
            ("steady", self.steady, Steady),
        ):
            if not isinstance(value, kind):
                raise ModelError(f"{name} = {value!r}: must be a gapsweep.{kind.__name__}")


def respond(
    oscillator: Oscillator,
    law: ContactLaw,
    omega: ArrayLike,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
    *,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    steady: Steady | None = None,
) -> Response:
    """Find the steady response from one initial state, or the responses from many.

    Parameters
    ----------
    oscillator : Oscillator
    law : ContactLaw
    omega : float or array_like
        Forcing frequency [Hz], ``> 0``.
    x_0, v_0 : float or array_like
        Initial displacement [m] and velocity [m/s], at forcing phase zero; broadcast against
        `omega`. Sixty points in one call cost a quarter of what they cost one by one.
    engine, rtol, atol
        As in `gapsweep.simulate`.
    steady : Steady, optional
        When the response counts as steady.

    Returns
    -------
    Response
        Its attributes are arrays if any of `omega`, `x_0`, `v_0` is one: of their shape; of
        `extrema`, `extremum_kind`, `multipliers` and `section` an array of arrays.

    Raises
    ------
    ModelError
        If an argument is out of range. A numerical failure is no error but a `status`.
    """
    solver, steady = Solver.of(engine, rtol, atol), Steady() if steady is None else steady
    omega, x_0, v_0 = broadcast(omega=omega, x_0=x_0, v_0=v_0)
    points = zip(omega.ravel().tolist(), x_0.ravel().tolist(), v_0.ravel().tolist(), strict=True)
    responses = respond_all(
        [
            Question(
                scene=Scene(oscillator=oscillator, law=law, omega=at, solver=solver),
                start=(x, v),
                steady=steady,
            )
            for at, x, v in points
        ]
    )
    return responses.shaped(omega.shape) if omega.shape else responses.row(0)


def respond_all(questions: Sequence[Question]) -> Responses:
    """Steady responses of many points, those of a kind advanced together; in their order.

    No point sees the others: each response is the same to the last bit in any company.
    """
    groups: dict[Hashable, list[int]] = {}
    for i, question in enumerate(questions):
        scene = question.scene
        # Settings that are equal but not one are a group of their own, which changes no response.
        kind = law_kind(scene.law), id(scene.solver), id(question.steady)
        groups.setdefault(kind, []).append(i)
    found = []
    for numbers in groups.values():
        group = [questions[i] for i in numbers]
        start = np.array([question.start for question in group]).T
        search = Search(Ensemble([question.scene for question in group]), start, group[0].steady)
        found.append(search.responses())
    responses = Responses.concatenated(found)
    if len(found) == 1:
        return responses
    return responses.take(np.argsort([i for numbers in groups.values() for i in numbers]))
