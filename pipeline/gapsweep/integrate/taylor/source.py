"""Source of a parameter column: the derivative of the equation of motion by a parameter.

A parameter column Q is the derivative of the motion by a parameter. It solves the variational
equation with a source, from zero::

    Q' = A Q + df/dp

The source is linear in the derivatives of the blocks of rows that the equation is made of, which
are in the column's own rows (`lanes.columns`). One piece of code hence serves all parameters.
"""

from llvmlite import ir

from gapsweep.integrate.lanes.rows import dot
from gapsweep.integrate.vectors import I64, fma, where

from .series import Spring, speeds
from .terms import product_term


def column_rows(lanes, coefficients, number):
    """Return lanes and coefficients as of a solution, for a run-time number of a column.

    The state of the column is in the rows of `tangent_state`.
    """
    layout, builder = lanes.layout, lanes.builder
    before = builder.mul(number, lanes.count("column_size"))
    first = builder.add(lanes.count("column"), before)
    first = builder.sub(first, ir.Constant(I64, layout.tangent_state))
    solution = builder.add(number, ir.Constant(I64, layout.n_states))
    size = (layout.n + layout.m) * layout.n_terms
    return lanes.below(first, 1), coefficients.below(solution, size)


class Source:
    """Series of the source of a column.

    Parameters
    ----------
    lanes, coefficients : LaneRows
        Rows and series of the motion.
    one : Equation
    modes : Modes
        At the beginning of the step.
    square : list of Vec
        Series of the square of a plain oscillator's coordinate.
    column : LaneRows
        Lanes as returned by `column_rows`.
    """

    def __init__(self, lanes, coefficients, one, modes, square, column):
        layout = lanes.layout
        self._lanes, self._coefficients, self._one, self._square = lanes, coefficients, one, square
        self._column = column.below(ir.Constant(I64, layout.tangent_state), 1)
        n, m, k = layout.n, layout.m, layout.contacts
        self._stiffness, self._damping = self._matrix("stiffness", n), self._matrix("damping", n)
        self._lag_force = self._matrix("lag_force", n)
        parts = [self._matrix(name, m) for name in ("of_speed", "of_place", "of_lag")]
        self._lags = [a + b + c for a, b, c in zip(*parts, strict=True)]
        self._pull = self._matrix("pull", n)
        above = [mode > 0.0 for mode in lanes.rows("mode_0")]
        self._moving = changes = [self._rows(each) for each in ("lower", "upper")]
        if layout.has_preload:
            changes = [self._rows(each) for each in ("lower_rest", "upper_rest")]
        stiffer = [self._rows(f"{each}_stiffness") for each in ("lower", "upper")]
        self._contacts = [
            (
                where(modes.touching[i], where(above[i], stiffer[1][i], stiffer[0][i]), 0.0),
                where(modes.touching[i], where(above[i], changes[1][i], changes[0][i]), 0.0),
                modes.stiffness[i],
                modes.rest[i],
            )
            for i in range(k)
        ]
        damped = zip(modes.touching, self._rows("contact_damping"), strict=False)
        self._losses = [
            (where(here, change, 0.0), damping)
            for (here, change), damping in zip(damped, modes.damping, strict=True)
        ]
        self._chi = []
        numbers = zip(lanes.rows("chi"), self._rows("chi"), one.chi, strict=True)
        for i, (chi, change, signed) in enumerate(numbers):
            by = fma(change, modes.stiffness[i], chi * self._contacts[i][0])
            self._chi.append((where(above[i], by, -by), signed))
        self._push = one.harmonics(self._amplitudes)

    def _rows(self, block):
        first = self._lanes.layout.sources[block]
        return [self._column[first + i] for i in range(self._lanes.layout.blocks[block])]

    def _matrix(self, block, n_rows):
        rows = self._rows(block)
        n = len(rows) // max(n_rows, 1)
        return [rows[i * n : (i + 1) * n] for i in range(n_rows)]

    def _amplitudes(self, index):
        """Derivatives of the amplitudes of a load."""
        rows = self._column.below(self._lanes.count("push_source"), 1)
        rows = rows.below(index, self._lanes.layout.n)
        return [rows[i] for i in range(self._lanes.layout.n)]

    def _terms(self, first, count, n):
        """Coefficient n of series from a number on."""
        n_terms = self._lanes.layout.n_terms
        return [self._coefficients[(first + i) * n_terms + n] for i in range(count)]

    def _state(self, n):
        """Coefficient n of speeds, coordinates and first-order states."""
        layout = self._lanes.layout
        speeds = [x * float(n + 1) for x in self._terms(0, layout.n, n + 1)]
        return speeds, self._terms(0, layout.n, n), self._terms(layout.n, layout.m, n)

    def moving(self, contact, above):
        """Derivative of the place of a contact's upper wall where `above`, else of its lower."""
        lower, upper = self._moving
        return where(above, upper[contact], lower[contact])

    def rebound(self, contact, speed, share, compliance):
        """Change of the column's speeds by the derivative of an impact at unchanged speeds.

        It is that of ``-share u M^-1 b`` with ``share = (1 + e) / (b'M^-1 b)`` and the speed u of
        the gap before the impact.
        """
        one, impulse, zero = self._one, share * speed, self._one.zero
        more = where(impulse.equals(0.0), 0.0, self._rows("restitution")[contact] * speed)
        if one.is_plain:
            return [-more]
        pull, moved = ([row[contact] for row in each] for each in (one.pull, self._pull))
        more = (more - impulse * dot(one.direction[contact], moved, zero)) / compliance
        return [-fma(a, impulse, b * more) for a, b in zip(moved, pull, strict=True)]

    def accelerations(self, n):
        """Coefficient n of the source of every coordinate's acceleration."""
        layout, one = self._lanes.layout, self._one
        velocities, places, lags = self._state(n)
        gaps = self._terms(layout.first_gap, layout.contacts, n)
        forces, depths = [], []
        for (stiffer, moved, stiffness, rest), gap in zip(self._contacts, gaps, strict=True):
            depth = gap - rest if n == 0 else gap
            force = stiffer * depth
            forces.append(force - stiffness * moved if n == 0 else force)
            depths.append(stiffness * depth)
        rates = self._terms(layout.first_gap, layout.contacts, n + 1)
        for k, (change, damping) in enumerate(self._losses):
            rate = rates[k] * float(n + 1)
            forces[k], depths[k] = fma(change, rate, forces[k]), fma(damping, rate, depths[k])
        for k, (change, chi) in enumerate(self._chi):
            gap = [self._terms(layout.first_gap + k, 1, i)[0] for i in range(n + 2)]
            _, moved, _, rest = self._contacts[k]
            pressed = product_term([gap[0] - rest, *gap[1:]], speeds(gap), n)
            forces[k] = fma(change, pressed, forces[k] - chi * moved * speeds(gap)[n])
            depths[k] = fma(chi, pressed, depths[k])
        if layout.has_impacts and not one.is_plain:
            holding = self._terms(layout.first_hold, layout.contacts, n)
            depths = [a + b for a, b in zip(depths, holding, strict=True)]
        totals = []
        for i, push in enumerate(self._push):
            total = dot(self._stiffness[i], places, one.zero)
            total = dot(self._damping[i], velocities, total)
            total = dot(self._lag_force[i], lags, total)
            if one.is_plain:
                total = total + forces[0]
            else:
                total = dot(self._pull[i], depths, dot(one.pull[i], forces, total))
            totals.append(push[n] - total)
        return self._less_cubes(n, totals)

    def _less_cubes(self, n, totals):
        """Totals less the changes of the forces of cubic springs."""
        layout = self._lanes.layout
        if self._one.is_plain:
            x = [self._terms(0, 1, i)[0] for i in range(n + 1)]
            return [totals[0] - self._rows("cubic")[0] * product_term(self._square, x, n)]

        def less(index, now):
            spring = Spring(self._lanes, self._coefficients, index)
            along, square = (spring.series(which, n) for which in (Spring.ALONG, Spring.SQUARE))
            cube = product_term(square, along, n)
            rows = self._column.below(ir.Constant(I64, layout.sources["cubic"]), 1)
            rows = rows.below(index, layout.n)
            return [total - rows[i] * cube for i, total in enumerate(now)]

        return self._lanes.each("cubics", totals, less)

    def lags(self, n):
        """Coefficient n of the source of every first-order state's rate."""
        speeds, places, lags = self._state(n)
        state = [*speeds, *places, *lags]
        return [dot(row, state, self._one.zero) for row in self._lags]
