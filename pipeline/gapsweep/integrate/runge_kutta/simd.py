"""A SIMD vector of doubles for numba: ``WIDTH`` sweep points per value, ordinary Python operators.

numba has no vector type and its loop vectoriser gives up on the stepping loop, so this module adds
two types, ``Vec`` (LLVM ``<WIDTH x double>``) and ``Mask`` (``<WIDTH x i1>``), whose operators each
lower to one LLVM instruction. Code written with them reads like scalar code and compiles to one
instruction stream for all lanes. Every operation acts on each lane alone: a lane's numbers cannot
depend on its neighbours, which is what makes results independent of how points are batched.

Nothing here is fast-math. A fused multiply-add happens where `fma` is written and nowhere else.
"""

import operator

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import (
    intrinsic,
    lower_builtin,
    models,
    register_model,
)

WIDTH = 16
"""Points per vector: two AVX-512 registers, so that one hides the latency of the other (30 ns per
attempt and
point against 42 ns with 8 lanes)."""

_F64 = ir.DoubleType()
_I64 = ir.IntType(64)
_I1 = ir.IntType(1)
_VEC = ir.VectorType(_F64, WIDTH)
_IVEC = ir.VectorType(_I64, WIDTH)
_MASK = ir.VectorType(_I1, WIDTH)


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


def _splat(builder, scalar):
    """The scalar in every lane."""
    one = builder.insert_element(ir.Constant(_VEC, ir.Undefined), scalar, ir.Constant(_I64, 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(one, ir.Constant(_VEC, ir.Undefined), zeros)


def _as_vector(context, builder, value, numba_type):
    """A lane-wise value from a vector or from any scalar number."""
    if numba_type == vec:
        return value
    return _splat(builder, context.cast(builder, value, numba_type, types.float64))


_PAIRS = (
    (vec, vec),
    (vec, types.float64),
    (types.float64, vec),
    (vec, types.int64),
    (types.int64, vec),
)


def _define_binary(op, result, emit):
    """Teach numba ``op`` for every mixture of vector and scalar operands."""

    class Template(ConcreteTemplate):
        cases = [signature(result, *pair) for pair in _PAIRS]

    infer_global(op)(Template)

    def lower(context, builder, sig, args):
        left, right = (
            _as_vector(context, builder, a, t) for a, t in zip(args, sig.args, strict=True)
        )
        return emit(builder, left, right)

    for pair in _PAIRS:
        lower_builtin(op, *pair)(lower)


_define_binary(operator.add, vec, lambda b, x, y: b.fadd(x, y))
_define_binary(operator.sub, vec, lambda b, x, y: b.fsub(x, y))
_define_binary(operator.mul, vec, lambda b, x, y: b.fmul(x, y))
_define_binary(operator.truediv, vec, lambda b, x, y: b.fdiv(x, y))
for _op, _code in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
):
    # Ordered comparisons: NaN compares false, so "error <= 1" rejects a NaN step.
    _define_binary(_op, mask, lambda b, x, y, _code=_code: b.fcmp_ordered(_code, x, y))


class _Negate(ConcreteTemplate):
    cases = [signature(vec, vec)]


infer_global(operator.neg)(_Negate)


@lower_builtin(operator.neg, vec)
def _lower_negate(context, builder, sig, args):
    return builder.fneg(args[0])


def _define_mask_binary(op, emit):
    class Template(ConcreteTemplate):
        cases = [signature(mask, mask, mask)]

    infer_global(op)(Template)
    lower_builtin(op, mask, mask)(lambda context, builder, sig, args: emit(builder, *args))


_define_mask_binary(operator.and_, lambda b, x, y: b.and_(x, y))
_define_mask_binary(operator.or_, lambda b, x, y: b.or_(x, y))
_define_mask_binary(operator.xor, lambda b, x, y: b.xor(x, y))


class _Invert(ConcreteTemplate):
    cases = [signature(mask, mask)]


infer_global(operator.invert)(_Invert)


@lower_builtin(operator.invert, mask)
def _lower_invert(context, builder, sig, args):
    return builder.not_(args[0])


def _llvm_function(builder, name, function_type):
    return cgutils.get_or_insert_function(builder.module, function_type, name)


@intrinsic
def fma(typingctx, a, b, c):
    """``a * b + c`` with one rounding, lane by lane; any of the three may be a scalar."""

    def codegen(context, builder, sig, args):
        operands = [_as_vector(context, builder, v, t) for v, t in zip(args, sig.args, strict=True)]
        function = _llvm_function(
            builder, f"llvm.fma.v{WIDTH}f64", ir.FunctionType(_VEC, [_VEC] * 3)
        )
        return builder.call(function, operands)

    return vec(a, b, c), codegen


def _unary(llvm_name):
    """An intrinsic for a one-argument LLVM vector function."""

    @intrinsic
    def function(typingctx, a):
        def codegen(context, builder, sig, args):
            callee = _llvm_function(
                builder, f"llvm.{llvm_name}.v{WIDTH}f64", ir.FunctionType(_VEC, [_VEC])
            )
            return builder.call(callee, args)

        return vec(vec), codegen

    return function


sqrt = _unary("sqrt")
absolute = _unary("fabs")
floor = _unary("floor")
nearest = _unary("rint")


@intrinsic
def copysign(typingctx, magnitude, sign):
    """`magnitude` with the sign bit of `sign`."""

    def codegen(context, builder, sig, args):
        callee = _llvm_function(
            builder, f"llvm.copysign.v{WIDTH}f64", ir.FunctionType(_VEC, [_VEC] * 2)
        )
        return builder.call(callee, args)

    return vec(vec, vec), codegen


@intrinsic
def splat(typingctx, scalar):
    """The scalar in every lane."""

    def codegen(context, builder, sig, args):
        return _as_vector(context, builder, args[0], sig.args[0])

    return vec(scalar), codegen


@intrinsic
def select(typingctx, condition, if_true, if_false):
    """`if_true` where the mask is set, else `if_false`; either may be a scalar."""

    def codegen(context, builder, sig, args):
        picked = [
            _as_vector(context, builder, v, t) for v, t in zip(args[1:], sig.args[1:], strict=True)
        ]
        return builder.select(args[0], *picked)

    return vec(mask, if_true, if_false), codegen


@intrinsic
def minimum(typingctx, a, b):
    """The smaller of two; `b` where they do not compare."""

    def codegen(context, builder, sig, args):
        a_, b_ = (_as_vector(context, builder, v, t) for v, t in zip(args, sig.args, strict=True))
        return builder.select(builder.fcmp_ordered("<", a_, b_), a_, b_)

    return vec(a, b), codegen


@intrinsic
def maximum(typingctx, a, b):
    """The larger of two; `b` where they do not compare."""

    def codegen(context, builder, sig, args):
        a_, b_ = (_as_vector(context, builder, v, t) for v, t in zip(args, sig.args, strict=True))
        return builder.select(builder.fcmp_ordered(">", a_, b_), a_, b_)

    return vec(a, b), codegen


@intrinsic
def bits(typingctx, condition):
    """The mask as an integer, lane 0 in the lowest bit."""

    def codegen(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(WIDTH)), _I64)

    return types.int64(mask), codegen


@intrinsic
def as_float_bits(typingctx, whole):
    """2.0 ** whole, for whole numbers in [-1022, 1023] held as doubles."""

    def codegen(context, builder, sig, args):
        exponent = builder.add(builder.fptosi(args[0], _IVEC), ir.Constant(_IVEC, [1023] * WIDTH))
        return builder.bitcast(builder.shl(exponent, ir.Constant(_IVEC, [52] * WIDTH)), _VEC)

    return vec(vec), codegen


@intrinsic
def exponent_of(typingctx, a):
    """Floor of log2 of a positive normal number, as a double."""

    def codegen(context, builder, sig, args):
        raw = builder.lshr(builder.bitcast(args[0], _IVEC), ir.Constant(_IVEC, [52] * WIDTH))
        return builder.sitofp(builder.sub(raw, ir.Constant(_IVEC, [1023] * WIDTH)), _VEC)

    return vec(vec), codegen


def _row_pointer(context, builder, array_type, array, row):
    """Pointer to row `row` of a C-ordered (rows, WIDTH) array, as a vector pointer."""
    data = context.make_array(array_type)(context, builder, array).data
    address = builder.gep(data, [builder.mul(row, ir.Constant(_I64, WIDTH))])
    return builder.bitcast(address, _VEC.as_pointer())


@intrinsic
def load(typingctx, array, row):
    """Row `row` of a C-ordered float64 array of shape (rows, WIDTH)."""

    def codegen(context, builder, sig, args):
        row = context.cast(builder, args[1], sig.args[1], types.int64)
        return builder.load(_row_pointer(context, builder, sig.args[0], args[0], row), align=8)

    return vec(array, row), codegen


@intrinsic
def store(typingctx, array, row, value):
    """Write a vector (or one scalar to every lane) to row `row`."""

    def codegen(context, builder, sig, args):
        row = context.cast(builder, args[1], sig.args[1], types.int64)
        value = _as_vector(context, builder, args[2], sig.args[2])
        builder.store(value, _row_pointer(context, builder, sig.args[0], args[0], row), align=8)
        return context.get_dummy_value()

    return types.void(array, row, value), codegen


@intrinsic
def lane_value(typingctx, value, lane):
    """One lane's double."""

    def codegen(context, builder, sig, args):
        return builder.extract_element(
            args[0], context.cast(builder, args[1], sig.args[1], types.int64)
        )

    return types.float64(vec, lane), codegen


@intrinsic
def with_lane(typingctx, value, lane, scalar):
    """The vector with one lane replaced."""

    def codegen(context, builder, sig, args):
        lane_ = context.cast(builder, args[1], sig.args[1], types.int64)
        return builder.insert_element(args[0], args[2], lane_)

    return vec(vec, lane, types.float64), codegen
