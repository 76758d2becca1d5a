"""Access to rows of lanes, loops, dot products and polynomials in emitted vector code."""

from llvmlite import ir
from numba import types

from gapsweep.integrate.vectors import I64, branch, fma, load_row, loop, store_row

from .row_layout import counts_of


class LaneRows:
    """Rows of all lanes, by number or name; each access emits a vector load or store.

    `counts` has the numbers of the layout that are read at run time.
    """

    def __init__(self, builder, pointer, layout, counts=None):
        self.builder, self.pointer, self.layout = builder, pointer, layout
        self.counts = counts or {}

    def _number(self, row):
        return self.layout.first[row] if isinstance(row, str) else row

    def __getitem__(self, row):
        return load_row(self.builder, self.pointer, self._number(row), self.layout.width)

    def __setitem__(self, row, vec):
        store_row(self.pointer, self._number(row), vec)

    def below(self, group, n_rows):
        """Return the rows from the first of a group of `n_rows` on, for a run-time `group`."""
        first = self.builder.mul(group, ir.Constant(I64, n_rows * self.layout.width))
        pointer = self.builder.gep(self.pointer, [first])
        return LaneRows(self.builder, pointer, self.layout, self.counts)

    def of_item(self, block, index, n_rows):
        """Return the rows of a block of `n_rows` for every load, spring or modulation from item
        `index` on."""
        first = self.count(block)
        return self.below(first, 1).below(index, n_rows)

    def item(self, block, index, n_rows=1):
        """Return the rows of a load, a cubic spring or a modulation in a block."""
        found = self.of_item(block, index, n_rows)
        return [found[i] for i in range(n_rows)]

    def count(self, name):
        """Return a number of the layout, of which some are known at run time only."""
        return self.counts.get(name) or ir.Constant(I64, getattr(self.layout, name))

    def each(self, name, values, body):
        """Emit `body` for every one of the things counted by `name`; see `vectors.loop`."""
        if not getattr(self.layout, name):
            return values

        def one():
            return body(ir.Constant(I64, 0), values)

        if name not in self.counts:
            return one()
        builder, count = self.builder, self.counts[name]
        is_one = builder.icmp_signed("==", count, ir.Constant(I64, 1))
        return branch(builder, is_one, one, lambda: loop(builder, count, values, body))

    def rows(self, block):
        """Return all rows of a block."""
        assert block not in self.layout.counted, "their number is not known to the code"
        first = self.layout.first[block]
        return [self[first + i] for i in range(self.layout.blocks[block])]

    def matrix(self, block, n_rows):
        """Return the entries of a block as a matrix of `n_rows` rows."""
        rows = self.rows(block)
        n = len(rows) // max(n_rows, 1)
        return [rows[i * n : (i + 1) * n] for i in range(n_rows)]


def rows_of(context, builder, signature, args):
    """Return `LaneRows` of the arrays among the arguments, the first of which is the layout."""
    typ = signature.args[0]
    counts = counts_of(context, builder, typ, args[0])
    return [
        LaneRows(builder, context.make_array(t)(context, builder, a).data, typ.layout, counts)
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
