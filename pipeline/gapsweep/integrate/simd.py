"""A SIMD vector of doubles for numba: ``WIDTH`` sweep points per value, ordinary Python operators.

numba has no vector type and its loop vectoriser gives up on the stepping loop, so this module adds
two types, ``Vec`` (LLVM ``<WIDTH x double>``) and ``Mask`` (``<WIDTH x i1>``), whose operators each
lower to one LLVM instruction, emitted by `vectors`. Code written with them reads like scalar code
and compiles to one instruction stream for all lanes. No operation mixes lanes: a lane's numbers
cannot depend on its neighbours, hence results do not depend on how points are batched.

Nothing here is fast-math. A fused multiply-add happens where `fma` is written and nowhere else.
"""

import operator

from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from gapsweep.integrate import elementary, vectors
from gapsweep.integrate.vectors import F64, I64, Mask, Vec

WIDTH = 16
"""Points per vector: two AVX-512 registers, so that one hides the latency of the other (30 ns per
attempt and point against 42 ns with 8 lanes). At most 16: four masks of as many bits are packed
into one 64-bit answer of a Taylor step."""

_VEC = ir.VectorType(F64, WIDTH)
_MASK = ir.VectorType(ir.IntType(1), WIDTH)


class VecType(types.Type):
    """`WIDTH` doubles in one value."""

    def __init__(self):
        super().__init__(name=f"Vec{WIDTH}")


class MaskType(types.Type):
    """`WIDTH` booleans in one value."""

    def __init__(self):
        super().__init__(name=f"Mask{WIDTH}")


vec = VecType()
mask = MaskType()


@register_model(VecType)
class _VecModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _VEC)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _MASK)


def _lifted(context, builder, value, numba_type):
    """Wrap a value of compiled code as `Vec` or `Mask`; a scalar is copied to every lane."""
    if numba_type == mask:
        return Mask(builder, value)
    if numba_type == vec:
        return Vec(builder, value)
    return vectors.splat(builder, context.cast(builder, value, numba_type, types.float64), WIDTH)


def _lowered(emit):
    """Return numba's code generator for a function of `Vec` and `Mask`."""

    def lower(context, builder, sig, args):
        forms = (_lifted(context, builder, *pair) for pair in zip(args, sig.args, strict=True))
        return emit(*forms).value

    return lower


def _define(op, result, emit, *cases):
    """Register an operator with numba: result type, code generator and types of operands."""

    class Template(ConcreteTemplate):
        pass

    Template.cases = [signature(result, *case) for case in cases]
    infer_global(op)(Template)
    for case in cases:
        lower_builtin(op, *case)(_lowered(emit))


_SCALARS = (types.float64, types.int64)
_PAIRS = [(vec, vec), *((vec, s) for s in _SCALARS), *((s, vec) for s in _SCALARS)]
for _op in (operator.add, operator.sub, operator.mul, operator.truediv):
    _define(_op, vec, _op, *_PAIRS)
# Ordered comparisons: NaN compares false, so "error <= 1" rejects a NaN step.
for _op in (operator.lt, operator.le, operator.gt, operator.ge):
    _define(_op, mask, _op, *_PAIRS)
_define(operator.eq, mask, Vec.equals, *_PAIRS)
_define(operator.neg, vec, operator.neg, (vec,))
_define(operator.and_, mask, operator.and_, (mask, mask))
_define(operator.or_, mask, operator.or_, (mask, mask))
_define(operator.invert, mask, operator.invert, (mask,))


def _of_one(emit):
    """Return a function of one vector for compiled code, emitted by `emit`."""

    @intrinsic
    def function(typingctx, a):
        return vec(a), _lowered(emit)

    return function


def _of_two(emit):
    @intrinsic
    def function(typingctx, a, b):
        return vec(a, b), _lowered(emit)

    return function


def _of_three(emit):
    @intrinsic
    def function(typingctx, a, b, c):
        return vec(a, b, c), _lowered(emit)

    return function


sqrt = _of_one(vectors.sqrt)
absolute = _of_one(vectors.absolute)
floor = _of_one(vectors.floor)
nearest = _of_one(vectors.nearest)
splat = _of_one(lambda a: a)
exp = _of_one(elementary.exp)
cos_turns = _of_one(elementary.cos_turns)
arctan = _of_one(elementary.arctan)
log = _of_one(elementary.log)
power = _of_two(elementary.power)
minimum = _of_two(vectors.minimum)
maximum = _of_two(vectors.maximum)
copysign = _of_two(vectors.copysign)
fma = _of_three(vectors.fma)
select = _of_three(vectors.where)


@intrinsic
def bits(typingctx, condition):
    """Return the mask as an integer, lane 0 in the lowest bit."""

    def codegen(context, builder, sig, args):
        return Mask(builder, args[0]).bits()

    return types.int64(mask), codegen


def _row_pointer(context, builder, array_type, array, row):
    """Pointer to row `row` of a C-ordered (rows, WIDTH) array, as a vector pointer."""
    data = context.make_array(array_type)(context, builder, array).data
    address = builder.gep(data, [builder.mul(row, ir.Constant(I64, WIDTH))])
    return builder.bitcast(address, _VEC.as_pointer())


@intrinsic
def load(typingctx, array, row):
    """Return row `row` of a C-ordered float64 array of shape (rows, WIDTH) as a vector."""

    def codegen(context, builder, sig, args):
        row = context.cast(builder, args[1], sig.args[1], types.int64)
        return builder.load(_row_pointer(context, builder, sig.args[0], args[0], row), align=8)

    return vec(array, row), codegen


def loads(rows):
    """Return a function that returns some rows of such an array, as a tuple of vectors."""

    @intrinsic
    def function(typingctx, array):
        def codegen(context, builder, sig, args):
            at = (ir.Constant(I64, row) for row in rows)
            pointers = (_row_pointer(context, builder, array, args[0], row) for row in at)
            found = [builder.load(pointer, align=8) for pointer in pointers]
            return context.make_tuple(builder, sig.return_type, found)

        return types.UniTuple(vec, len(rows))(array), codegen

    return function


@intrinsic
def store(typingctx, array, row, value):
    """Write a vector (or one scalar to every lane) to row `row`."""

    def codegen(context, builder, sig, args):
        row = context.cast(builder, args[1], sig.args[1], types.int64)
        value = _lifted(context, builder, args[2], sig.args[2]).value
        builder.store(value, _row_pointer(context, builder, sig.args[0], args[0], row), align=8)
        return context.get_dummy_value()

    return types.void(array, row, value), codegen


@intrinsic
def lane_value(typingctx, value, lane):
    """Return the value of one lane."""

    def codegen(context, builder, sig, args):
        return builder.extract_element(
            args[0], context.cast(builder, args[1], sig.args[1], types.int64)
        )

    return types.float64(vec, lane), codegen


@intrinsic
def with_lane(typingctx, value, lane, scalar):
    """Return the vector with the value of one lane replaced."""

    def codegen(context, builder, sig, args):
        lane_ = context.cast(builder, args[1], sig.args[1], types.int64)
        return builder.insert_element(args[0], args[2], lane_)

    return vec(vec, lane, types.float64), codegen
