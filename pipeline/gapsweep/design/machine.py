"""A model and its contact laws as functions of named parameters, and its steady responses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.family import AMPLITUDE, Family
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Laws, Model, Models, Solver
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.response.respond import respond_models
from gapsweep.response.result import Responses, Steady

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Machine:
    """Responses of a model at values of its parameters; the engine's defaults unless `rtol`."""

    family: Family
    solver: Solver
    steady: Steady

    @classmethod
    def of(
        cls,
        oscillator: Model | Callable[..., Model],
        law: AnyLaw | None,
        ranges: Mapping[str, tuple[float, float]],
        omega: Any,
        rtol: float | None,
    ) -> Machine:
        """Return a machine after its model was built at both ends of all ranges.

        Raises `ModelError` if a parameter is unknown, or invalid within its range.
        """
        if AMPLITUDE in ranges:
            raise ModelError("parameter 'amplitude': is a result; name a parameter of the model")
        low, high = ({name: ends[k] for name, ends in ranges.items()} for k in (0, 1))
        first = None if omega is None else float(np.min(omega))
        family = Family(oscillator, {} if law is None else law, first, tuple(ranges), low)
        models, laws = zip(
            *((family.model_at(end), family.laws_at(end)) for end in (low, high)), strict=True
        )
        ends = [end.get("omega", first or 0.0) for end in (low, high)]
        start = np.zeros((1, family.example.n_states))
        warn_of(doubts(models, laws, np.array(ends), start))
        return cls(family, Solver.of(rtol=rtol), Steady())

    @property
    def n_states(self) -> int:
        """Number of states of the model."""
        return int(self.family.example.n_states)

    def parts(self, values: Array) -> tuple[list[Model], list[Laws], NDArray[np.intp]]:
        """Return the distinct models and laws of rows of parameter values, and each row's number.

        `values`: shape (n, number of parameters).
        """
        rows, which = np.unique(values, axis=0, return_inverse=True)
        named = [dict(zip(self.family.names, row, strict=True)) for row in rows.tolist()]
        models = [self.family.model_at(one) for one in named]
        return models, [self.family.laws_at(one) for one in named], which.ravel()

    def respond(self, values: Array, omega: Array, states: Array) -> Responses:
        """Return the steady responses of n rows.

        `values`: shape (n, number of parameters); values of the parameters `family.names`.
        `omega`: shape (n,); forcing frequencies [Hz]; 0 if the model is not forced.
        `states`: shape (n, n_states).
        """
        models, laws, which = self.parts(values)
        if "omega" in self.family.names:
            omega = values[:, self.family.names.index("omega")]
        rows = which.tolist()
        many = Models.of([models[i] for i in rows], [laws[i] for i in rows], omega)
        return respond_models(many, self.solver, states, self.steady)

    def sweeps(self, values: Array, frequencies: Sequence[Array]) -> list[Responses]:
        """Return the responses of sweeps, each point from the end state of the one before.

        The first point starts from rest. All sweeps at all values advance together.

        `values`: shape (m, number of parameters).
        `frequencies`: frequencies [Hz] of each sweep in its order.
        Result: for each sweep, of ``m * len(frequencies)`` points: all values at the first
        frequency, then at the second one.
        """
        m = len(values)
        states = [np.zeros((m, self.n_states)) for _ in frequencies]
        found: list[list[Responses]] = [[] for _ in frequencies]
        for k in range(max(map(len, frequencies), default=0)):
            left = [s for s, omega in enumerate(frequencies) if k < len(omega)]
            omega = np.repeat([frequencies[s][k] for s in left], m)
            batch = self.respond(
                np.tile(values, (len(left), 1)), omega, np.concatenate([states[s] for s in left])
            )
            for i, s in enumerate(left):
                part = batch.take(np.arange(i * m, (i + 1) * m))
                found[s].append(part)
                states[s] = np.where(part.has_end[:, None], part.ends, states[s])
        return [Responses.concatenated(parts) for parts in found]
