"""Vectors of eight numbers in compiled code: one formula serves one number and eight of them.

    cells = view_lanes(array)         array (rows, 8) float64, C order: cells[i] holds row i, one vector register
    cells[0] = cells[1] * 2.0 + cells[2]
    cells[3] = choose(cells[0] > 1.0, cells[1], cells[2])

A function of this project that is written with `choose`, `any_lane` and `all_lanes` in place of branches accepts plain
numbers and arrays, or vectors and views. The compiler makes one version of each. Vectors are LLVM's <8 x double>:
one AVX-512 register, two of AVX2, four of SSE2 or Neon. Every lane carries out the operations of the plain version in
the same order, without contraction, so its results are the same to the last bit. sin, cos, atan2, exp and log call
the scalar function lane by lane.

A view does not own its memory: the caller of the compiled function keeps the array.
Source: LLVM Language Reference Manual, "Vector Type"; Numba documentation, "Extending Numba", low-level interface.
"""

import math
import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, overload

from quasi.terms.lane_types import INDEX, LANE_VECTOR, LANES, ViewType, is_number, lanes, mask

_ALIGNMENT = 8  # bytes, of a row: that of its numbers
_read = ir.IRBuilder.load  # of memory, not of a file


# entries of views


def _address(context, builder, view_type, view, index_type, index):
    """Pointer to the first number of a row."""
    view = cgutils.create_struct_proxy(view_type)(context, builder, view)
    if view_type.ndim == 2:
        row, column = cgutils.unpack_tuple(builder, index)
        row = context.cast(builder, row, index_type[0], types.intp)
        column = context.cast(builder, column, index_type[1], types.intp)
        at = builder.add(builder.mul(row, view.columns), column)
    else:
        at = context.cast(builder, index, index_type, types.intp)
    return builder.gep(view.data, [builder.mul(at, ir.Constant(at.type, LANES))])


def _is_index(view, index):
    if view.ndim == 2:
        return isinstance(index, types.BaseTuple) and len(index) == 2
    return isinstance(index, types.Integer)


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, args, kws):
        view, index = args
        if not isinstance(view, ViewType):
            return None
        if _is_index(view, index):
            return signature(lanes, view, index)
        return signature(view, view, index) if view.ndim == 1 and isinstance(index, types.SliceType) else None


@lower_builtin(operator.getitem, ViewType, types.Any)
def _lower_getitem(context, builder, sig, args):
    view_type, index_type = sig.args
    if not isinstance(index_type, types.SliceType):
        at = _address(context, builder, view_type, args[0], index_type, args[1])
        return _read(builder, builder.bitcast(at, LANE_VECTOR.as_pointer()), align=_ALIGNMENT)
    view = cgutils.create_struct_proxy(view_type)(context, builder, args[0])
    part = context.make_helper(builder, index_type, args[1])
    stop = builder.select(builder.icmp_signed("<", part.stop, view.rows), part.stop, view.rows)
    out = cgutils.create_struct_proxy(view_type)(context, builder)
    out.data = builder.gep(view.data, [builder.mul(part.start, ir.Constant(part.start.type, LANES))])
    out.rows, out.columns = builder.sub(stop, part.start), ir.Constant(view.columns.type, 1)
    return out._getvalue()


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, args, kws):
        view, index, value = args
        if isinstance(view, ViewType) and _is_index(view, index) and (value == lanes or is_number(value)):
            return signature(types.none, view, index, value)
        return None


@lower_builtin(operator.setitem, ViewType, types.Any, types.Any)
def _lower_setitem(context, builder, sig, args):
    at = _address(context, builder, sig.args[0], args[0], sig.args[1], args[1])
    value = context.cast(builder, args[2], sig.args[2], lanes)
    builder.store(value, builder.bitcast(at, LANE_VECTOR.as_pointer()), align=_ALIGNMENT)
    return context.get_dummy_value()


@infer_global(len)
class _Length(AbstractTemplate):
    def generic(self, args, kws):
        return signature(types.intp, *args) if len(args) == 1 and isinstance(args[0], ViewType) else None


@lower_builtin(len, ViewType)
def _lower_length(context, builder, sig, args):
    return cgutils.create_struct_proxy(sig.args[0])(context, builder, args[0]).rows


def make_vectors(rows: int) -> np.ndarray:
    """Array (rows, 8) of zeros for `view_lanes`, each row in one cache line."""
    row_bytes = 8 * LANES
    raw = np.zeros((rows + 1) * LANES)
    begin = -raw.ctypes.data % row_bytes // 8
    return raw[begin : begin + rows * LANES].reshape(rows, LANES)


@intrinsic
def view_lanes(typingctx, array):
    """View an array (rows, 8) float64 in C order as `rows` vectors."""
    if not (isinstance(array, types.Array) and array.ndim == 2 and array.layout == "C"):
        return None

    def lower(context, builder, sig, args):
        given = context.make_array(sig.args[0])(context, builder, args[0])
        out = cgutils.create_struct_proxy(sig.return_type)(context, builder)
        out.data = builder.bitcast(given.data, out.data.type)
        out.rows = cgutils.unpack_tuple(builder, given.shape)[0]
        out.columns = ir.Constant(out.rows.type, 1)
        return out._getvalue()

    return signature(ViewType(1), array), lower


@intrinsic
def reshape_lanes(typingctx, view, columns):
    """View (rows,) vectors as (rows / columns, columns) of them."""

    def lower(context, builder, sig, args):
        given = cgutils.create_struct_proxy(sig.args[0])(context, builder, args[0])
        out = cgutils.create_struct_proxy(sig.return_type)(context, builder)
        out.data, out.columns = given.data, args[1]
        out.rows = builder.sdiv(given.rows, args[1])
        return out._getvalue()

    return signature(ViewType(2), view, types.intp), lower


@intrinsic
def _get_view_entry(typingctx, view, row, lane):

    def lower(context, builder, sig, args):
        at = _address(context, builder, sig.args[0], args[0], types.intp, args[1])
        return _read(builder, builder.gep(at, [args[2]]))

    return signature(types.float64, view, types.intp, types.intp), lower


@intrinsic
def _set_view_entry(typingctx, view, row, lane, value):

    def lower(context, builder, sig, args):
        at = _address(context, builder, sig.args[0], args[0], types.intp, args[1])
        builder.store(args[3], builder.gep(at, [args[2]]))
        return context.get_dummy_value()

    return signature(types.none, view, types.intp, types.intp, types.float64), lower


def get_entry(array, row, lane):
    """Number of one lane in a row of a view (rows,); an array (rows,) has one lane."""
    return array[row]


def set_entry(array, row, lane, value):
    """Set the number of one lane in a row of a view (rows,); an array (rows,) has one lane."""
    array[row] = value


def count_lanes(array):
    """Lanes of a view, 1 for an array."""
    return 1


@overload(get_entry)
def _overload_get_entry(array, row, lane):
    if isinstance(array, ViewType):
        return lambda array, row, lane: _get_view_entry(array, row, lane)
    return lambda array, row, lane: array[row]


@overload(set_entry)
def _overload_set_entry(array, row, lane, value):
    def set_array(array, row, lane, value):
        array[row] = value

    def set_view(array, row, lane, value):
        _set_view_entry(array, row, lane, value)

    return set_view if isinstance(array, ViewType) else set_array


@overload(count_lanes)
def _overload_count_lanes(array):
    number = LANES if isinstance(array, ViewType) else 1
    return lambda array: number


# vectors as values


@intrinsic
def get_lane(typingctx, vector, lane):
    """Number of one lane of a vector."""

    def lower(context, builder, sig, args):
        return builder.extract_element(args[0], args[1])

    return signature(types.float64, lanes, types.intp), lower


@intrinsic
def set_lane(typingctx, vector, lane, value):
    """Vector with one lane replaced."""

    def lower(context, builder, sig, args):
        return builder.insert_element(args[0], args[2], args[1])

    return signature(lanes, lanes, types.intp, types.float64), lower


@intrinsic
def choose(typingctx, condition, one, other):
    """`one` where the condition holds, else `other`; both are evaluated. Numbers, or vectors with a mask."""
    if condition == mask or lanes in (one, other):
        kind, deciding = lanes, mask if condition == mask else types.boolean
    else:
        kind, deciding = types.float64, types.boolean

    def lower(context, builder, sig, args):
        return builder.select(args[0], args[1], args[2])

    return signature(kind, deciding, kind, kind), lower


@intrinsic
def common_value(typingctx, value):
    """Value of the first lane, for what is equal in all lanes; a number is returned as it is."""

    def lower(context, builder, sig, args):
        return builder.extract_element(args[0], ir.Constant(INDEX, 0)) if sig.args[0] == lanes else args[0]

    return signature(types.float64, value if value == lanes else types.float64), lower


def _reduce_mask(builder, value, wanted):
    bits = builder.bitcast(value, ir.IntType(LANES))
    return builder.icmp_unsigned("!=" if wanted == 0 else "==", bits, ir.Constant(bits.type, wanted))


@intrinsic
def any_lane(typingctx, condition):
    """Whether the condition holds in a lane; a plain condition is returned as it is."""

    def lower(context, builder, sig, args):
        return args[0] if sig.args[0] == types.boolean else _reduce_mask(builder, args[0], 0)

    return signature(types.boolean, condition if condition == mask else types.boolean), lower


@intrinsic
def all_lanes(typingctx, condition):
    """Whether the condition holds in every lane; a plain condition is returned as it is."""

    def lower(context, builder, sig, args):
        return args[0] if sig.args[0] == types.boolean else _reduce_mask(builder, args[0], 2**LANES - 1)

    return signature(types.boolean, condition if condition == mask else types.boolean), lower


def _map_function(function):
    @overload(function)
    def map_lanes(x):
        if x != lanes:
            return None

        def apply(x):
            out = x
            for i in range(LANES):
                out = set_lane(out, i, function(get_lane(x, i)))
            return out

        return apply


for _function in (math.sin, math.cos, math.exp, math.log):
    _map_function(_function)


def _map_function_of_two(function):
    @overload(function)
    def map_lanes(x, y):
        if lanes not in (x, y):
            return None

        def apply(x, y):
            out = x + y  # of vectors, where one of both is a number
            a, b = choose(True, x, out), choose(True, y, out)
            for i in range(LANES):
                out = set_lane(out, i, function(get_lane(a, i), get_lane(b, i)))
            return out

        return apply


for _function in (math.atan2, math.pow):
    _map_function_of_two(_function)
