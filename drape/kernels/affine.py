"""Affine maps in kernels: a row of numbers (``drape.kernels.lanes``) that turns and moves a point."""

from __future__ import annotations

from typing import Any

from numba import types

from drape.kernels import lanes
from drape.kernels.lanes import LANES, built, ir


@built
def put_moved(typing: Any, out: Any, x: Any, v: Any, row: Any) -> Any:
    """Writes point ``v`` of ``x`` (P, 3), moved by a ``row``, to that of ``out``: x + A x + b.

    The row has the three columns of A and b, a fourth number behind each, which has no meaning.
    """

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        size, flags = x.dtype.bitwidth // 8, lanes._FLAGS
        first = builder.mul(context.cast(builder, args[2], signature.args[2], types.intp), ir.IntType(64)(3))

        def pointer(k: int, axis: int, count: int) -> Any:
            kind = lanes._vector(x.dtype, count) if count > 1 else lanes._vector(x.dtype).element
            where = builder.add(first, ir.IntType(64)(axis))
            return lanes._pointer(context, builder, args[k], signature.args[k], where, kind)

        def halves(a: Any) -> Any:
            n = a.type.count // 2
            low, high = (lanes._shuffled(builder, a, a, range(begin, begin + n)) for begin in (0, n))
            return builder.fadd(low, high, flags=flags)

        two, third = builder.load(pointer(1, 0, 2), align=size), builder.load(pointer(1, 2, 1))
        point = builder.insert_element(lanes._shuffled(builder, two, two, (0, 1, 0, 0)), third, ir.IntType(64)(2))
        point = builder.insert_element(point, point.type.element(1.0), ir.IntType(64)(3))
        columns = lanes._shuffled(builder, point, point, [lane // 4 for lane in range(LANES)])
        moved = builder.fadd(point, halves(halves(builder.fmul(args[3], columns, flags=flags))), flags=flags)
        builder.store(lanes._shuffled(builder, moved, moved, (0, 1)), pointer(0, 0, 2), align=size)
        builder.store(builder.extract_element(moved, ir.IntType(64)(2)), pointer(0, 2, 1))
        return context.get_dummy_value()

    return types.void(out, x, v, row), code
