"""Modes of a contact: whether its force acts, and which events end a mode.

A mode is one of the numbers below times the side of the wall, +1 for the upper and -1 for the lower
wall. In mode `SLACK` the gap is beyond the wall, but the force would pull: the contact's spring
relaxes more slowly than the body leaves. Only contacts that never pull have it. In mode `HOLD` the
gap stays on the wall, and the force is the one that this takes. Rigid walls have it, where an
impact lasts no time and leaves the mode `OFF`, and walls with a preload, where it ends in mode `ON`
if the force exceeds the preload.
"""

import math
from typing import NamedTuple

OFF, ON, SLACK, HOLD = range(4)


class Mode(NamedTuple):
    """A mode of a contact.

    Attributes
    ----------
    acts : bool
        Whether the contact force acts.
    after_wall : int
        Mode after the gap passes the wall.
    after_zero : int
        Mode after the force, as the contact law has it, passes zero. Only contacts that never pull
        watch the force, and not in mode `OFF`, and all contacts in mode `HOLD`.
    """

    acts: bool
    after_wall: int
    after_zero: int


# By the mode's number.
MODES = (
    Mode(acts=False, after_wall=ON, after_zero=OFF),
    Mode(acts=True, after_wall=OFF, after_zero=SLACK),
    Mode(acts=False, after_wall=OFF, after_zero=ON),
    Mode(acts=True, after_wall=HOLD, after_zero=OFF),
)


class Losses(NamedTuple):
    """Energy losses of both walls of a contact.

    Attributes
    ----------
    damping : float
        Force over the speed of penetration [N s/m].
    never_pulls : bool
        Whether the force is never less than zero, so that the contact has the mode `SLACK`.
    chi : float
        Relative increase of the spring's force over the speed of penetration [s/m].
    by_function : bool
        Whether the force is a user's function of displacement and velocity.
    is_rigid : bool
        Whether the walls are rigid: a contact is an impact.
    restitution : float
        Speed after an impact over the speed before it [-].
    preload : float
        Force of the spring at the wall [N]. It loses no energy.
    """

    damping: float = 0.0
    never_pulls: bool = False
    chi: float = 0.0
    by_function: bool = False
    is_rigid: bool = False
    restitution: float = 1.0
    preload: float = 0.0

    @property
    def kind(self) -> tuple[bool, ...]:
        """Whether there are losses or a preload, a mode `SLACK`, a chi, rigid walls, a preload."""
        return bool(self), self.never_pulls, self.chi > 0.0, self.is_rigid, self.preload > 0.0

    @property
    def may_hold(self) -> bool:
        """Whether there is a mode `HOLD`."""
        return self.is_rigid or self.preload > 0.0

    @property
    def of_impact(self) -> float:
        """Logarithm of the factor by which an impact shrinks volumes in state space, times -1."""
        return -2.0 * math.log(self.restitution) if self.restitution else math.inf

    @property
    def lose_energy(self) -> bool:
        """Whether energy may be lost."""
        return self.damping > 0.0 or self.chi > 0.0 or self.by_function or self.is_rigid

    def __bool__(self) -> bool:
        """Whether energy may be lost, or the force jumps at the wall: no elastic spring."""
        return self.lose_energy or self.preload > 0.0

    def __str__(self) -> str:
        """The number that loses energy, as ``damping = 60``, or the preload."""
        if self.by_function:
            return "a force f(x, v)"
        if self.is_rigid:
            return f"restitution = {self.restitution:g}"
        for name in ("chi", "damping"):
            if value := getattr(self, name):
                return f"{name} = {value:g}"
        return f"preload = {self.preload:g}"


NO_LOSSES = Losses()  # of all elastic contacts
