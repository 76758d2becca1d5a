"""Modes of a contact: whether its force acts, and which events end a mode.

A mode is `OFF`, `ON` or `SLACK` times the side of the wall, +1 for the upper and -1 for the lower
wall. In mode `SLACK` the gap is beyond the wall, but the force would pull: the contact's spring
relaxes more slowly than the body leaves. Only contacts that never pull have it.
"""

from typing import NamedTuple

OFF, ON, SLACK = 0, 1, 2


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
        watch the force, and not in mode `OFF`.
    """

    acts: bool
    after_wall: int
    after_zero: int


# By the mode's number.
MODES = (
    Mode(acts=False, after_wall=ON, after_zero=OFF),
    Mode(acts=True, after_wall=OFF, after_zero=SLACK),
    Mode(acts=False, after_wall=OFF, after_zero=ON),
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
    """

    damping: float = 0.0
    never_pulls: bool = False
    chi: float = 0.0
    by_function: bool = False

    @property
    def kind(self) -> tuple[bool, bool, bool]:
        """Whether energy is lost, whether there is a mode `SLACK`, and whether there is a chi."""
        return bool(self), self.never_pulls, self.chi > 0.0

    def __bool__(self) -> bool:
        """Whether energy is lost."""
        return self.damping > 0.0 or self.chi > 0.0 or self.by_function

    def __str__(self) -> str:
        """The number that loses energy, as ``damping = 60``."""
        if self.by_function:
            return "a force f(x, v)"
        return f"chi = {self.chi:g}" if self.chi else f"damping = {self.damping:g}"


NO_LOSSES = Losses()  # of all elastic contacts
