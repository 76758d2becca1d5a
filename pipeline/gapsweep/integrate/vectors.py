"""Arithmetic on vectors of lanes, written as Python expressions and emitted as LLVM IR.

An ``@intrinsic`` builds machine code by calling methods of an ``IRBuilder``; formulas written
that way cannot be read. `Vec` and `Mask` wrap the emitted values, so that a formula of the
stepping code reads as in a book and each operator emits one vector instruction:

    with one ``Vec`` per lane group:   ``x_1 = fma(h, v, x)``
    with one ``Mask`` for choices:     ``h = where(mask, t, h)``

No reordering is allowed anywhere (no fast-math flag), and no operation mixes lanes: the results of
a lane do not depend on its neighbours. Therefore a point has the same result in every batch, bit
for bit.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

F64 = ir.DoubleType()
I64 = ir.IntType(64)


class _LaneValues:
    """A value per lane, inside the function under construction."""

    __slots__ = ("builder", "value")

    def __init__(self, builder, value):
        self.builder = builder
        self.value = value


class Vec(_LaneValues):
    """A double per lane."""

    __slots__ = ()

    def constant(self, number):
        """Return a vector with the same number in every lane."""
        return Vec(
            self.builder,
            ir.Constant(self.value.type, [ir.Constant(F64, float(number))] * self.value.type.count),
        )

    def _other(self, other):
        return other if isinstance(other, Vec) else self.constant(other)

    def _with(self, operation, other):
        """Apply an operation of the builder; other kinds of operands define it themselves."""
        if not isinstance(other, Vec | int | float):
            return NotImplemented
        return Vec(self.builder, operation(self.builder, self.value, self._other(other).value))

    def __add__(self, other):
        return self._with(ir.IRBuilder.fadd, other)

    def __sub__(self, other):
        return self._with(ir.IRBuilder.fsub, other)

    def __rsub__(self, other):
        return self._other(other) - self

    def __mul__(self, other):
        return self._with(ir.IRBuilder.fmul, other)

    def __truediv__(self, other):
        return self._with(ir.IRBuilder.fdiv, other)

    def __rtruediv__(self, other):
        return self._other(other) / self

    def __neg__(self):
        return Vec(self.builder, self.builder.fneg(self.value))

    __radd__ = __add__
    __rmul__ = __mul__

    def _compare(self, operator, other):
        return Mask(
            self.builder, self.builder.fcmp_ordered(operator, self.value, self._other(other).value)
        )

    def __lt__(self, other):
        return self._compare("<", other)

    def __le__(self, other):
        return self._compare("<=", other)

    def __gt__(self, other):
        return self._compare(">", other)

    def __ge__(self, other):
        return self._compare(">=", other)

    def equals(self, other):
        """Lanes where both are equal; false for NaN, as every comparison here."""
        return self._compare("==", other)


class Mask(_LaneValues):
    """A boolean per lane."""

    __slots__ = ()

    def __and__(self, other):
        return Mask(self.builder, self.builder.and_(self.value, other.value))

    def __or__(self, other):
        return Mask(self.builder, self.builder.or_(self.value, other.value))

    def __invert__(self):
        return Mask(self.builder, self.builder.not_(self.value))

    def bits(self):
        """The mask as a 64-bit integer, lane 0 in the lowest bit."""
        width = self.value.type.count
        return self.builder.zext(self.builder.bitcast(self.value, ir.IntType(width)), I64)


def mask_of(builder, bits, width):
    """Mask from the lowest bits of an integer, as `Mask.bits` returns it."""
    lowest = builder.trunc(bits, ir.IntType(width))
    return Mask(builder, builder.bitcast(lowest, ir.VectorType(ir.IntType(1), width)))


def where(mask, a, b):
    """`a` in the lanes of `mask`, `b` in the others; either may be a number."""
    vec = a if isinstance(a, Vec) else b
    return Vec(
        vec.builder, vec.builder.select(mask.value, vec._other(a).value, vec._other(b).value)
    )


def minimum(a, b):
    """Lane-wise smaller value (`b` where either is NaN)."""
    return where(a < b, a, b)


def maximum(a, b):
    """Lane-wise larger value (`b` where either is NaN)."""
    return where(a > b, a, b)


def _call(name, *args):
    vec = args[0]
    vector = vec.value.type
    full_name = f"llvm.{name}.v{vector.count}f64"
    function = cgutils.get_or_insert_function(
        vec.builder.module, ir.FunctionType(vector, [vector] * len(args)), full_name
    )
    return Vec(vec.builder, vec.builder.call(function, [vec._other(a).value for a in args]))


def fma(a, b, c):
    """``a * b + c``, rounded once on every processor: in one instruction where it has one."""
    return _call("fma", a, b, c)


def absolute(a):
    """``|a|``."""
    return _call("fabs", a)


def sqrt(a):
    """Square root, NaN for negative lanes."""
    return _call("sqrt", a)


def nearest(a):
    """`a` rounded to the nearest integer."""
    return _call("rint", a)


def floor(a):
    """Largest integer that is not above `a`."""
    return _call("floor", a)


def copysign(magnitude, sign):
    """`magnitude` with the sign of `sign`."""
    return _call("copysign", magnitude, sign)


_EXPONENT_BIAS, _FRACTION_BITS = 1023, 52  # of a double


def power_of_two(a):
    """``2.0 ** a`` for whole numbers in [-1022, 1023]."""
    builder, integers = a.builder, ir.VectorType(I64, a.value.type.count)
    exponent = builder.add(builder.fptosi(a.value, integers), _integers(a, _EXPONENT_BIAS))
    bits = builder.shl(exponent, _integers(a, _FRACTION_BITS))
    return Vec(builder, builder.bitcast(bits, a.value.type))


def exponent(a):
    """Base-2 logarithm of positive normal numbers, rounded down."""
    builder, integers = a.builder, ir.VectorType(I64, a.value.type.count)
    raw = builder.lshr(builder.bitcast(a.value, integers), _integers(a, _FRACTION_BITS))
    whole = builder.sub(raw, _integers(a, _EXPONENT_BIAS))
    return Vec(builder, builder.sitofp(whole, a.value.type))


# 2**52 as a double: its low 52 bits hold an integer, so adding it converts a small integer
# to a double and back without the conversion instructions that AVX2 does not have.
_MAGIC_BITS = 0x4330000000000000
_MAGIC = 4503599627370496.0


def _integers(vec, number):
    return ir.Constant(
        ir.VectorType(I64, vec.value.type.count), [ir.Constant(I64, number)] * vec.value.type.count
    )


def rough_log2(a):
    """Base-2 logarithm of ``a >= 0``, piecewise linear between powers of two (error < 0.09).

    Zero gives -1023 and infinity 1024: finite, so that a step size made of it stays finite.
    """
    builder = a.builder
    bits = builder.bitcast(a.value, ir.VectorType(I64, a.value.type.count))
    high = builder.or_(builder.lshr(bits, _integers(a, 32)), _integers(a, _MAGIC_BITS))
    return (Vec(builder, builder.bitcast(high, a.value.type)) - _MAGIC) * 2.0**-20 - 1023.0


def rough_exp2(a):
    """Inverse of `rough_log2` for exponents within (-1000, 1000)."""
    builder = a.builder
    scaled = (a + 1023.0) * 2.0**20 + _MAGIC
    bits = builder.bitcast(scaled.value, ir.VectorType(I64, a.value.type.count))
    return Vec(builder, builder.bitcast(builder.shl(bits, _integers(a, 32)), a.value.type))


def is_nonzero(builder, bits):
    """Condition for a branch: any bit of a 64-bit integer set."""
    return builder.icmp_unsigned("!=", bits, ir.Constant(I64, 0))


def branch(builder, condition, compute, otherwise):
    """Emit a branch between two computations; return the values of the one that runs, as a list.

    `condition`: condition of `compute`, one for all lanes.
    `compute` and `otherwise`: each emits code and returns as many `Vec` and `Mask`.
    """
    results, blocks = [], []
    with builder.if_else(condition) as paths:
        for path, emit in zip(paths, (compute, otherwise), strict=True):
            with path:
                results.append(emit())
                blocks.append(builder.block)
    merged = []
    for values in zip(*results, strict=True):
        phi = builder.phi(values[0].value.type)
        for value, block in zip(values, blocks, strict=True):
            phi.add_incoming(value.value, block)
        merged.append(type(values[0])(builder, phi))
    return merged


def loop(builder, count, values, body):
    """Emit a loop; return the values after it.

    Parameters
    ----------
    count
        Number of passes, an int64.
    values : list of Vec
        Values before the first pass.
    body : callable
        Function of the number of the pass, from 0 on, and of the values before it; it emits code
        and returns the values after it.
    """
    start = builder.block
    head, inside, done = map(builder.append_basic_block, ("head", "each", "after"))
    builder.branch(head)
    builder.position_at_end(head)
    index, *before = (builder.phi(v.type) for v in (count, *(each.value for each in values)))
    builder.cbranch(builder.icmp_signed("<", index, count), inside, done)
    builder.position_at_end(inside)
    after = body(index, [Vec(builder, each) for each in before])
    index.add_incoming(ir.Constant(I64, 0), start)
    index.add_incoming(builder.add(index, ir.Constant(I64, 1)), builder.block)
    for phi, first, next_one in zip(before, values, after, strict=True):
        phi.add_incoming(first.value, start)
        phi.add_incoming(next_one.value, builder.block)
    builder.branch(head)
    builder.position_at_end(done)
    return [Vec(builder, each) for each in before]


def load_row(builder, pointer, row, width):
    """Row `row` of a lane-major array (shape (rows, width)) as a `Vec`."""
    vector = ir.VectorType(F64, width)
    address = builder.bitcast(
        builder.gep(pointer, [ir.Constant(I64, row * width)]), vector.as_pointer()
    )
    value = builder.load(address)
    value.align = 8  # numpy promises no more
    return Vec(builder, value)


def store_row(pointer, row, vec):
    """Write `vec` to row `row` of a lane-major array."""
    builder, width = vec.builder, vec.value.type.count
    address = builder.bitcast(
        builder.gep(pointer, [ir.Constant(I64, row * width)]), vec.value.type.as_pointer()
    )
    builder.store(vec.value, address).align = 8


def splat(builder, scalar, width):
    """Return a vector with a scalar double in every lane."""
    vector = ir.VectorType(F64, width)
    one = builder.insert_element(
        ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
    )
    zeros = ir.Constant(
        ir.VectorType(ir.IntType(32), width), [ir.Constant(ir.IntType(32), 0)] * width
    )
    return Vec(builder, builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), zeros))


@intrinsic
def lowest_bit(typingctx, bits):
    """Position of the lowest set bit of an int64 that is not zero: the first lane of a mask."""

    def codegen(context, builder, signature, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), codegen
