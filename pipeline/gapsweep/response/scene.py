"""What moves: a model, how it is forced, and how it is solved."""

from dataclasses import dataclass, replace
from typing import Any

from gapsweep.integrate.problem import Solver
from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.model.oscillator import Oscillator
from gapsweep.model.system import System

# A tangent is as good as its motion where all kinks are located; else it takes this tolerance.
_TANGENT_RTOL = 1e-7
_LOOSE = 1e-5  # at looser tolerances an error estimate does not see the edge of a sharp layer


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What moves: the model, its forcing frequency [Hz] and the solver."""

    oscillator: Oscillator | System
    law: Any  # of a system a tuple, in the order of its contacts
    omega: float
    solver: Solver

    @property
    def laws(self) -> tuple[ContactLaw, ...]:
        """The law of every contact."""
        return self.law if isinstance(self.oscillator, System) else (self.law,)

    @property
    def is_located(self) -> bool:
        """Whether all contacts are."""
        return all(isinstance(law, Piecewise) and law.located for law in self.laws)

    @property
    def has_kinks(self) -> bool:
        """Whether steps pass kinks of the force that no event locates."""
        return any(isinstance(law, Piecewise) for law in self.laws) and not self.is_located

    @property
    def is_rattled(self) -> bool:
        """Whether steps may be thrown off by more than their error estimates, as by a kink or, at
        loose tolerances, by the sharp edge of a layer.
        """
        return self.has_kinks or (self.solver.rtol > _LOOSE and not self.is_located)

    @property
    def tangent_law(self) -> Any:
        """The same force, its kinks located if they can be."""
        exact = [replace(law, located=True) for law in self.laws if isinstance(law, Piecewise)]
        # All contacts are located or none.
        laws = tuple(exact) if len(exact) == len(self.laws) else self.laws
        return laws if isinstance(self.oscillator, System) else laws[0]

    @property
    def tangent_solver(self) -> Solver:
        """What the tangent along the motion is integrated with.

        A step's error estimate does not see a kink that no event locates, nor the jump that the
        tangent makes there: at loose tolerances its growth would be the solver's own invention.
        """
        solver = self.solver
        if self.is_located or (solver.rtol <= _TANGENT_RTOL and not self.has_kinks):
            return solver
        rtol = min(solver.rtol, _TANGENT_RTOL)
        return Solver.of(solver.engine, rtol, solver.atol / solver.rtol * rtol)

    @property
    def has_own_tangent(self) -> bool:
        """Whether motion and tangent are integrated together."""
        return self.tangent_law == self.law and self.tangent_solver == self.solver
