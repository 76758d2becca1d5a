"""Access to rows of lanes, dot products and polynomials in emitted vector code."""

from llvmlite import ir
from numba import types

from gapsweep.integrate.vectors import I64, fma, load_row, store_row


class LaneRows:
    """Rows of all lanes, by number or name; each access emits a vector load or store."""

    def __init__(self, builder, pointer, layout):
        self.builder, self.pointer, self.layout = builder, pointer, layout

    def _number(self, row):
        return self.layout.first[row] if isinstance(row, str) else row

    def __getitem__(self, row):
        return load_row(self.builder, self.pointer, self._number(row), self.layout.width)

    def __setitem__(self, row, vec):
        store_row(self.pointer, self._number(row), vec)

    def below(self, group, n_rows):
        """Return the rows from the first of a group of `n_rows` on, for a run-time `group`."""
        first = self.builder.mul(group, ir.Constant(I64, n_rows * self.layout.width))
        return LaneRows(self.builder, self.builder.gep(self.pointer, [first]), self.layout)

    def rows(self, block):
        """Return all rows of a block."""
        first = self.layout.first[block]
        return [self[first + i] for i in range(self.layout.blocks[block])]

    def matrix(self, block, n_rows):
        """Return the entries of a block as a matrix of `n_rows` rows."""
        rows = self.rows(block)
        n = len(rows) // max(n_rows, 1)
        return [rows[i * n : (i + 1) * n] for i in range(n_rows)]


def pointers(context, builder, signature, args):
    """Return the data pointers of the arrays among the arguments."""
    return [
        context.make_array(t)(context, builder, a).data
        for t, a in zip(signature.args, args, strict=True)
        if isinstance(t, types.Array)
    ]


def dot(factors, values, total):
    """Return `total` plus the sum of products."""
    for a, b in zip(factors, values, strict=True):
        total = fma(a, b, total)
    return total


def value_and_slope(series, t):
    """Value and derivative of a polynomial at t by Horner's rule."""
    value, slope = series[-1], None
    for a in reversed(series[:-1]):
        slope = value if slope is None else fma(slope, t, value)
        value = fma(value, t, a)
    return value, slope
