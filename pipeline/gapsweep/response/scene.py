"""Parameter set and solver of one motion, and the solver that its tangent needs."""

from dataclasses import dataclass, replace

from gapsweep.integrate.problem import Laws, Model, Solver
from gapsweep.model.contact import ContactLaw, Piecewise

# A tangent is as accurate as its motion if all kinks are located; else it needs this tolerance. At
# looser ones a stable orbit or chaos may be due to solver errors: exponents are computed at this
# tolerance, too, and orbits are confirmed at the second one.
TANGENT_RTOL, CONFIRMING_RTOL = 1e-7, 1e-9
_LOOSE = 1e-5  # at looser tolerances an error estimate does not see the edge of a sharp layer


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """A model, its forcing frequency [Hz] and the solver."""

    oscillator: Model
    law: ContactLaw | Laws  # a tuple of several in the order of the system's contacts
    omega: float
    solver: Solver

    @property
    def laws(self) -> Laws:
        """Contact laws, one per contact."""
        return self.law if isinstance(self.law, tuple) else (self.law,)


@dataclass(frozen=True, slots=True)
class Forces:
    """Contact laws and a solver: whether the solver resolves their kinks, and the tangent's solver.

    Attributes
    ----------
    laws : tuple of ContactLaw
        The law of every contact.
    solver : Solver
    """

    laws: Laws
    solver: Solver

    @property
    def is_located(self) -> bool:
        """Whether all contacts are located, and no step passes a kink before it is cut there."""
        is_by_mode = self.solver.contact_force == "by_mode"
        return is_by_mode and all(law.is_located for law in self.laws)

    @property
    def has_kinks(self) -> bool:
        """Whether steps pass kinks of the force that no event locates."""
        return any(isinstance(law, Piecewise) for law in self.laws) and not self.is_located

    @property
    def is_noisy(self) -> bool:
        """Whether errors of steps may exceed their estimates: at kinks that are not located or, at
        loose tolerances, at the sharp edge of a layer.
        """
        return self.has_kinks or (self.solver.rtol > _LOOSE and not self.is_located)

    @property
    def has_own_tangent(self) -> bool:
        """Whether motion and tangent are integrated together."""
        is_exact = all(isinstance(law, Piecewise) for law in self.laws)
        return self.is_located or not (is_exact or self.tangent_solver != self.solver)

    @property
    def tangent_solver(self) -> Solver:
        """Solver of the tangent along the motion.

        A step's error estimate does not see a kink that no event locates, nor the tangent's jump
        there: at loose tolerances the growth of the tangent would be a solver error.
        """
        solver = self.solver
        if self.is_located or (solver.rtol <= TANGENT_RTOL and not self.has_kinks):
            return solver
        rtol = min(solver.rtol, TANGENT_RTOL)
        return replace(
            solver.with_rtol(rtol), controller="native", restart=False, contact_force="by_mode"
        )


def located(laws: Laws) -> Laws:
    """Return the laws with all contacts located, if all are exact; else the laws as they are."""
    exact = [law for law in laws if isinstance(law, Piecewise)]
    exact = [law if law.located else replace(law, located=True) for law in exact]
    return tuple(exact) if len(exact) == len(laws) else laws
