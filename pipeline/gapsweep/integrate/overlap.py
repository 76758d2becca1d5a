"""Walls that overlap: for an engine two contacts of one wall each.

Between such walls both act. An engine integrates a model in which each wall is a contact, and
`apart` gives its motions the contacts of the given model again.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motions import Events, Motions
from gapsweep.integrate.problem import Integrate, Models, Problems, Shifts, Solver
from gapsweep.model.oscillator import Oscillator

Prepare = Callable[..., Integrate]


def apart(prepare: Prepare) -> Prepare:
    """Return the function `prepared` of an engine for models with walls that may overlap."""

    def prepared(models: Models, solver: Solver, *shifts: Shifts) -> Integrate:
        owner = [k for k, law in enumerate(models.laws[0]) for _ in law.of_walls]
        if len(owner) == len(models.laws[0]):
            return prepare(models, solver, *shifts)
        moved = [replace(each, models=each.models.with_walls_apart()) for each in shifts]
        integrate = prepare(models.with_walls_apart(), solver, *moved)
        n, is_plain = models.systems[0].n, isinstance(models.systems[0], Oscillator)
        firsts = np.unique(owner, return_index=True)[1]
        # numbers of turning quantities: of coordinates as they are, of gaps once a contact
        turning = np.full(n + len(owner), -1)
        turning[:n] = np.arange(n)
        if not is_plain:
            turning[n + firsts] = n + np.arange(len(firsts))

        def joined(problems: Problems) -> Motions:
            found = integrate(problems)

            def events() -> Events:
                return _joined(found.events(), np.array(owner), turning)

            time, force = found.contact_time, found.contact_force
            return replace(
                found,
                events=events,
                contact_time=None if time is None else np.add.reduceat(time, firsts, axis=1),
                contact_force=None if force is None else np.maximum.reduceat(force, firsts, axis=1),
            )

        return joined

    return prepared


def _joined(found: Events, owner: NDArray[Any], turning: NDArray[Any]) -> Events:
    """Return events with the numbers of the given contacts, and extrema of each gap once."""
    of = turning[found.extrema_of]
    motion = np.repeat(np.arange(len(found.n_extrema)), found.n_extrema)[of >= 0]
    return replace(
        found,
        t_extrema=found.t_extrema[of >= 0],
        extrema=found.extrema[of >= 0],
        extrema_of=of[of >= 0],
        n_extrema=np.bincount(motion, minlength=len(found.n_extrema)),
        contacts_of=owner[found.contacts_of],
    )
