"""Numba types of vectors of eight numbers, of their masks and views, with arithmetic and comparisons; see `lanes`.

Sources: those of `lanes`.
"""

import math
import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, lower_cast, models, register_model

LANES = 8  # numbers of a vector: 512 bits, the widest register of x86-64
_DOUBLE, LANE_VECTOR = ir.DoubleType(), ir.VectorType(ir.DoubleType(), LANES)
_BITS = ir.VectorType(ir.IntType(1), LANES)
INDEX = ir.IntType(32)


class LanesType(types.Type):
    def __init__(self):
        super().__init__("lanes")

    def unify(self, typingctx, other):
        return self if isinstance(other, types.Number) else None

    def can_convert_from(self, typingctx, other):
        return Conversion.safe if isinstance(other, types.Number) else None


class MaskType(types.Type):
    def __init__(self):
        super().__init__("lane_mask")

    def unify(self, typingctx, other):
        return self if isinstance(other, types.Boolean) else None

    def can_convert_from(self, typingctx, other):
        return Conversion.safe if isinstance(other, types.Boolean) else None


class ViewType(types.Type):
    def __init__(self, ndim):
        self.ndim = ndim
        super().__init__(f"lane_view({ndim})")

    @property
    def key(self):
        return self.ndim


lanes, mask = LanesType(), MaskType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, LANE_VECTOR)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _BITS)


@register_model(ViewType)
class _ViewModel(models.StructModel):
    def __init__(self, manager, kind):
        members = [("data", types.CPointer(types.float64)), ("rows", types.intp), ("columns", types.intp)]
        super().__init__(manager, kind, members)


def _splat(builder, number):
    one = builder.insert_element(ir.Constant(LANE_VECTOR, ir.Undefined), number, ir.Constant(INDEX, 0))
    first = ir.Constant(ir.VectorType(INDEX, LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(LANE_VECTOR, ir.Undefined), first)


@lower_cast(types.Number, LanesType)
def _cast_number(context, builder, fromty, toty, value):
    return _splat(builder, context.cast(builder, value, fromty, types.float64))


def is_number(kind):
    return isinstance(kind, types.Float | types.Integer)


def _type_operation(function, result):
    """Accept vectors and numbers, at least one vector, as arguments of a function."""

    @infer_global(function)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if not kws and lanes in args and all(a == lanes or is_number(a) for a in args):
                return signature(result, *[lanes] * len(args))
            return None


def _lower_arithmetic(function, instruction):
    _type_operation(function, lanes)

    @lower_builtin(function, LanesType, LanesType)
    def lower(context, builder, sig, args):
        return getattr(builder, instruction)(*args)


def _lower_comparison(function, symbol):
    _type_operation(function, mask)

    @lower_builtin(function, LanesType, LanesType)
    def lower(context, builder, sig, args):
        compare = builder.fcmp_unordered if symbol == "!=" else builder.fcmp_ordered
        return compare(symbol, *args)


def _lower_extremum(function, symbol):
    """min and max as Python and Numba define them: the first argument, unless the second is beyond it."""
    _type_operation(function, lanes)

    @lower_builtin(function, LanesType, LanesType)
    def lower(context, builder, sig, args):
        return builder.select(builder.fcmp_ordered(symbol, args[1], args[0]), args[1], args[0])


def _lower_intrinsic(function, name):
    _type_operation(function, lanes)

    @lower_builtin(function, LanesType)
    def lower(context, builder, sig, args):
        made = cgutils.get_or_insert_function(builder.module, ir.FunctionType(LANE_VECTOR, [LANE_VECTOR]), name)
        return builder.call(made, args)


for _function, _instruction in (
    (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv"),
    (operator.iadd, "fadd"), (operator.isub, "fsub"), (operator.imul, "fmul"), (operator.itruediv, "fdiv"),
):  # fmt: skip
    _lower_arithmetic(_function, _instruction)
for _function, _symbol in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
    (operator.ne, "!="),
):  # fmt: skip
    _lower_comparison(_function, _symbol)
_lower_extremum(min, "<")
_lower_extremum(max, ">")
_lower_intrinsic(math.sqrt, "llvm.sqrt.v8f64")
_lower_intrinsic(abs, "llvm.fabs.v8f64")
_lower_intrinsic(np.rint, "llvm.rint.v8f64")
_type_operation(operator.neg, lanes)


@lower_builtin(operator.neg, LanesType)
def _lower_negation(context, builder, sig, args):
    return builder.fneg(args[0])


def _lower_logic(function, instruction):
    @infer_global(function)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if mask in args and all(a in (mask, types.boolean) for a in args):
                return signature(mask, mask, mask)
            return None

    @lower_builtin(function, MaskType, MaskType)
    def lower(context, builder, sig, args):
        return getattr(builder, instruction)(*args)


_lower_logic(operator.and_, "and_")
_lower_logic(operator.or_, "or_")


@lower_cast(types.Boolean, MaskType)
def _cast_boolean(context, builder, fromty, toty, value):
    bit = context.cast(builder, value, fromty, types.boolean)
    return builder.select(cgutils.is_not_null(builder, bit), ir.Constant(_BITS, [1] * LANES), ir.Constant(_BITS, None))
