"""Rows of ``LANES`` numbers as values of kernels: added and multiplied number by number, by vector instructions.

A loop over lanes is not always compiled to vector instructions. An index that may be negative, a running sum, or
numbers that are gathered one by one prevent it. A ``Row`` is in registers until ``put`` writes it to memory. Points are
loaded as whole vectors of four numbers and transposed in registers, which is faster than a processor's own gathers.

Sums keep their order, as everywhere (``drape.kernels.compiled``); ``sums`` halves the lanes in a fixed order.
Comparisons are those of numbers, false where one is NaN.

numba calls a function that is ``built`` with types. It returns its signature and a function ``code`` that writes LLVM's
instructions for the values. ``numba.core`` and ``numba.np`` are not documented: docs/decisions/0011-numba.md.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.extending import intrinsic, overload, register_model
from numba.np.arrayobj import make_array

from drape.kernels.compiled import FAST, part

LANES = 16
_PER_LN2, _LN2_HIGH, _LN2_LOW = 1.4426950408889634, 0.693359375, -2.1219444005469057e-4
ir: Any = cgutils.ir  # of llvmlite, in the version that numba has
_FLAGS = tuple(sorted(FAST))
built: Any = intrinsic  # the function that it returns is called without the first argument, numba's typing context


class Row(types.Type):
    """The type of ``LANES`` numbers of ``dtype``."""

    def __init__(self, dtype: types.Float) -> None:
        self.dtype = dtype
        super().__init__(name=f"Row({dtype})")


def _int(value: int) -> Any:
    return ir.Constant(ir.IntType(64), value)


def _vector(dtype: types.Float, count: int = LANES) -> Any:
    return ir.VectorType(ir.FloatType() if dtype.bitwidth == 32 else ir.DoubleType(), count)


@register_model(Row)
class _RowModel(models.PrimitiveModel):
    def __init__(self, manager: Any, row: Row) -> None:
        super().__init__(manager, row, _vector(row.dtype))


def _shuffled(builder: Any, a: Any, b: Any, order: Sequence[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), len(order)), list(order)))


def _as_row(context: Any, builder: Any, value: Any, of: Any, row: Row) -> Any:
    """The row ``value``, or a row of the one number ``value``."""
    if isinstance(of, Row):
        return value
    vector = _vector(row.dtype)
    one = context.cast(builder, value, of, row.dtype)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), one, _int(0))
    return _shuffled(builder, first, first, [0] * LANES)


def _row_of(*args: Any) -> Any:
    return next((a for a in args if isinstance(a, Row)), None)


def _operator(by: Callable, name: str) -> None:
    @built
    def lowered(typing: Any, a: Any, b: Any) -> Any:
        row = _row_of(a, b)

        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            both = [_as_row(context, builder, *each, row) for each in zip(args, signature.args, strict=True)]
            return getattr(builder, name)(*both, flags=_FLAGS)

        return row(a, b), code

    @overload(by)
    def chosen(a, b):
        return (lambda a, b: lowered(a, b)) if _row_of(a, b) else None


_operator(operator.add, "fadd")
_operator(operator.sub, "fsub")
_operator(operator.mul, "fmul")
_operator(operator.truediv, "fdiv")


@built
def _negative(typing: Any, a: Any) -> Any:
    return a(a), lambda context, builder, signature, args: builder.fneg(args[0], flags=_FLAGS)


@overload(operator.neg)
def _negated(a):
    return (lambda a: _negative(a)) if isinstance(a, Row) else None


@built
def root(typing: Any, a: Any) -> Any:
    """The square root of each number."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector = args[0].type
        name = f"llvm.sqrt.v{LANES}f{a.dtype.bitwidth}"
        return builder.call(
            cgutils.get_or_insert_function(builder.module, ir.FunctionType(vector, [vector]), name), args
        )

    return a(a), code


@built
def whole(typing: Any, a: Any) -> Any:
    """Each number without what is behind its point; within the range of 32 or 64 bits."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector = ir.VectorType(ir.IntType(a.dtype.bitwidth), LANES)
        return builder.sitofp(builder.fptosi(args[0], vector), args[0].type)

    return a(a), code


@built
def times_two_to(typing: Any, a: Any, power: Any) -> Any:
    """``a`` times two to the ``power``, whole numbers for which two to them is a normal number."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bits = a.dtype.bitwidth
        vector, behind, bias = ir.VectorType(ir.IntType(bits), LANES), *((23, 127) if bits == 32 else (52, 1023))
        power = builder.add(builder.fptosi(args[1], vector), ir.Constant(vector, [bias] * LANES))
        shifted = builder.shl(power, ir.Constant(vector, [behind] * LANES))
        return builder.fmul(args[0], builder.bitcast(shifted, args[0].type), flags=_FLAGS)

    return a(a, power), code


@built
def where_above(typing: Any, a: Any, b: Any, then: Any, other: Any) -> Any:
    """``then`` in the lanes where ``a`` is above ``b``, ``other`` in the rest; each is a row or one number."""
    row = _row_of(a, b, then, other)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        rows = [_as_row(context, builder, *each, row) for each in zip(args, signature.args, strict=True)]
        return builder.select(builder.fcmp_ordered(">", rows[0], rows[1]), rows[2], rows[3])

    return row(a, b, then, other), code


@built
def where_other(typing: Any, a: Any, i: Any, b: Any, j: Any, then: Any) -> Any:
    """``then`` in lanes where whole numbers ``a`` from ``i`` on and ``b`` from ``j`` on, flat, differ, 0 elsewhere."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        numbers = []
        for k in (0, 2):
            place = context.cast(builder, args[k + 1], signature.args[k + 1], types.intp)
            vector = ir.VectorType(ir.IntType(signature.args[k].dtype.bitwidth), LANES)
            where = _pointer(context, builder, args[k], signature.args[k], place, vector)
            numbers.append(builder.load(where, align=signature.args[k].dtype.bitwidth // 8))
        other = builder.icmp_signed("!=", *numbers)
        return builder.select(other, args[4], ir.Constant(args[4].type, [0.0] * LANES))

    return then(a, i, b, j, then), code


def _pointer(context: Any, builder: Any, array: Any, of: Any, start: Any, vector: Any) -> Any:
    """Where the number ``start`` of a flat ``array`` is, as that of a ``vector``."""
    data = make_array(of)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [start]), vector.as_pointer())


@built
def row_at(typing: Any, array: Any, start: Any) -> Any:
    """The numbers of a flat ``array`` from ``start`` on, which is not negative."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = context.cast(builder, args[1], signature.args[1], types.intp)
        where = _pointer(context, builder, args[0], array, place, _vector(array.dtype))
        return builder.load(where, align=array.dtype.bitwidth // 8)

    return Row(array.dtype)(array, start), code


@built
def number_at(typing: Any, array: Any, start: Any) -> Any:
    """The number at ``start`` of a flat ``array``; not negative, which an index in brackets is asked each time."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = context.cast(builder, args[1], signature.args[1], types.intp)
        return builder.load(builder.gep(make_array(array)(context, builder, args[0]).data, [place]))

    return array.dtype(array, start), code


@built
def put(typing: Any, array: Any, start: Any, row: Any) -> Any:
    """Writes a ``row``, or one number in all lanes, to a flat ``array`` from ``start`` on, which is not negative."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = context.cast(builder, args[1], signature.args[1], types.intp)
        where = _pointer(context, builder, args[0], array, place, _vector(array.dtype))
        value = _as_row(context, builder, args[2], row, Row(array.dtype))
        builder.store(value, where, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, start, row), code


def _turned(builder: Any, rows: Sequence[Any]) -> list[Any]:
    """The first, second, third and fourth numbers of ``LANES`` vectors ``rows`` of four, as rows."""
    wide = []
    for k in range(4):  # lanes k, k + 4, k + 8, k + 12 side by side, so that shuffles stay within quarters
        low = _shuffled(builder, rows[k], rows[k + 4], range(8))
        high = _shuffled(builder, rows[k + 8], rows[k + 12], range(8))
        wide.append(_shuffled(builder, low, high, range(16)))
    quarters = range(0, LANES, 4)

    def joined(a: Any, b: Any, order: Sequence[int]) -> Any:
        return _shuffled(builder, a, b, [q + (i if i < 4 else i - 4 + LANES) for q in quarters for i in order])

    found = []
    for pair in ((0, 4, 1, 5), (2, 6, 3, 7)):
        first, second = joined(wide[0], wide[1], pair), joined(wide[2], wide[3], pair)
        found += [joined(first, second, (0, 1, 4, 5)), joined(first, second, (2, 3, 6, 7))]
    return found


def _gather(width: int, begin: int, *, spare: bool = False) -> Any:
    """A function that gathers from an array (P, ``width``): four numbers from ``begin`` on, or three at its end; with
    ``spare`` there is memory for a fourth one behind that."""
    count = min(4, width - begin)

    @built
    def lowered(typing: Any, x: Any, index: Any, start: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            size = x.dtype.bitwidth // 8
            data, places = (
                make_array(of)(context, builder, array).data for of, array in zip((x, index), args[:2], strict=True)
            )
            start = context.cast(builder, args[2], signature.args[2], types.intp)

            four, mask = _vector(x.dtype, 4), ir.VectorType(ir.IntType(1), 4)
            kind = ir.FunctionType(four, [four.as_pointer(), ir.IntType(32), mask, four])
            # A fourth number may be behind the array's end: what the mask leaves out is not touched.
            some = cgutils.get_or_insert_function(builder.module, kind, f"llvm.masked.load.v4f{x.dtype.bitwidth}.p0")
            known = [ir.IntType(32)(size), mask([1] * count + [0] * (4 - count)), four([0.0] * 4)]
            fours = []
            for lane in range(LANES):
                place = builder.load(builder.gep(places, [builder.add(start, _int(lane))]))
                place = builder.mul(builder.sext(place, start.type), _int(width))
                first = builder.gep(data, [builder.add(place, _int(begin))])
                first = builder.bitcast(first, four.as_pointer())
                fours.append(
                    builder.load(first, align=size) if spare or count == 4 else builder.call(some, [first, *known])
                )
            return cgutils.pack_array(builder, _turned(builder, fours)[:count])

        return types.UniTuple(Row(x.dtype), count)(x, index, start), code

    return lowered


# Each is called with an array, a flat index and the start of ``LANES`` places in that index. ``points_at`` returns the
# three rows of points (P, 3); ``spared_at`` does so faster, of points that are ``with_spare``. From a table of samples
# (S, 8) ``samples_at`` returns four rows, the points and their squares, and ``normals_at`` four, the normals and normal
# times point.
points_at, spared_at, samples_at, normals_at = _gather(3, 0), _gather(3, 0, spare=True), _gather(8, 0), _gather(8, 4)


@built
def points_in(typing: Any, x: Any, start: Any) -> Any:
    """The points of ``x`` (P, 3) from ``start`` on: a vector of three rows."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        where, size = _points(context, builder, signature, args, x)
        numbers = builder.load(where, align=size)
        rows = [_shuffled(builder, numbers, numbers, range(axis, 3 * LANES, 3)) for axis in range(3)]
        return cgutils.pack_array(builder, rows)

    return types.UniTuple(Row(x.dtype), 3)(x, start), code


@built
def put_points(typing: Any, x: Any, start: Any, a: Any) -> Any:
    """Writes a vector ``a`` of three rows to the points of ``x`` (P, 3) from ``start`` on."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        where, size = _points(context, builder, signature, args, x)
        rows = cgutils.unpack_tuple(builder, args[2], 3)
        two = _shuffled(builder, rows[0], rows[1], range(2 * LANES))
        third = _shuffled(builder, rows[2], rows[2], range(2 * LANES))
        order = [lane + LANES * axis for lane in range(LANES) for axis in range(3)]
        builder.store(_shuffled(builder, two, third, order), where, align=size)
        return context.get_dummy_value()

    return types.void(x, start, a), code


def _points(context: Any, builder: Any, signature: Any, args: Any, x: Any) -> tuple[Any, int]:
    """A pointer to the points of ``x`` (P, 3) from a start on as one vector, and the bytes of a number."""
    start = builder.mul(context.cast(builder, args[1], signature.args[1], types.intp), _int(3))
    return _pointer(context, builder, args[0], x, start, _vector(x.dtype, 3 * LANES)), x.dtype.bitwidth // 8


@built
def sums(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """The sums of three rows over their lanes."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        fours = []
        for row in args:
            half, count = row, LANES
            while count > 4:
                count //= 2
                low, high = (_shuffled(builder, half, half, range(i * count, (i + 1) * count)) for i in (0, 1))
                half = builder.fadd(low, high, flags=_FLAGS)
            fours.append(half)
        first = builder.fadd(
            _shuffled(builder, fours[0], fours[1], (0, 4, 1, 5)),
            _shuffled(builder, fours[0], fours[1], (2, 6, 3, 7)),
            flags=_FLAGS,
        )
        second = builder.fadd(
            _shuffled(builder, fours[2], fours[2], (0, 0, 1, 1)),
            _shuffled(builder, fours[2], fours[2], (2, 2, 3, 3)),
            flags=_FLAGS,
        )
        found = builder.fadd(
            _shuffled(builder, first, second, (0, 1, 4, 5)),
            _shuffled(builder, first, second, (2, 3, 6, 7)),
            flags=_FLAGS,
        )
        return cgutils.pack_array(builder, [builder.extract_element(found, _int(i)) for i in range(3)])

    return types.UniTuple(a.dtype, 3)(a, b, c), code


@part
def rows3_at(array, start):
    """The vector of three rows from ``start`` on."""
    return row_at(array, start), row_at(array, start + LANES), row_at(array, start + 2 * LANES)


@part
def row3(array, start, lane):
    """The vector of one ``lane`` of the three rows from ``start`` on."""
    return array[start + lane], array[start + LANES + lane], array[start + 2 * LANES + lane]


@part
def put3(array, start, a):
    """Writes the vector ``a`` of three rows from ``start`` on."""
    put(array, start, a[0])
    put(array, start + LANES, a[1])
    put(array, start + 2 * LANES, a[2])


@part
def exponential(a):
    """e to each number, to 3e-8 of it or the type's rounding; below -80 that of -80, above 80 that of 80."""
    a = least(most(a, -80.0), 80.0)
    n = a * _PER_LN2
    n = whole(n + where_above(a, 0.0, 0.5, -0.5))
    x = (a - n * _LN2_HIGH) - n * _LN2_LOW  # within half of ln 2
    series = x * (1.0 / 5040.0) + 1.0 / 720.0
    series = series * x + 1.0 / 120.0
    series = series * x + 1.0 / 24.0
    series = series * x + 1.0 / 6.0
    series = series * x + 0.5
    series = series * x + 1.0
    return times_two_to(series * x + 1.0, n)


@part
def tangent(a):
    """The hyperbolic tangent of each number."""
    size = root(a * a)
    small = exponential(size * -2.0)
    bent = (1.0 - small) / (1.0 + small)
    return where_above(a, 0.0, bent, -bent)


@part
def most(a, b):
    """The larger one of two numbers in each lane, ``b`` where one is NaN."""
    return where_above(a, b, a, b)


@part
def least(a, b):
    """The smaller one of two numbers in each lane, ``b`` where one is NaN."""
    return where_above(b, a, a, b)
