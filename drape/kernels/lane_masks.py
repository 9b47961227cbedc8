"""Which lanes of a row (``drape.kernels.lanes``) something holds for, as the bits of a whole number:

    bits = lanes_above(row, 0.0)
    while bits:
        lane, bits = first_lane(bits), bits & (bits - 1)

goes over the lanes above zero and looks at no other one.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils

from drape.kernels import lanes
from drape.kernels.compiled import part
from drape.kernels.lanes import LANES, built, ir


@built
def lanes_above(typing: Any, a: Any, b: Any) -> Any:
    """The lanes where ``a`` is above ``b``, none where one is NaN; each is a row or one number."""
    row = lanes._row_of(a, b)

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        rows = [lanes._as_row(context, builder, *each, row) for each in zip(args, signature.args, strict=True)]
        return builder.zext(builder.bitcast(builder.fcmp_ordered(">", *rows), ir.IntType(LANES)), ir.IntType(64))

    return types.int64(a, b), code


@built
def first_lane(typing: Any, bits: Any) -> Any:
    """The first lane of ``bits``, which are not zero."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = ir.IntType(64)
        lowest = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(word, [word, ir.IntType(1)]), "llvm.cttz.i64"
        )
        return builder.call(lowest, [args[0], ir.IntType(1)(1)])

    return types.int64(types.int64), code


@part
def lanes_from(bits, lane):
    """``bits`` from ``lane`` on, all of them where that is negative."""
    return (bits >> max(lane, 0)) << max(lane, 0)


@part
def lanes_before(lane):
    """The bits of all lanes before ``lane``, which is not negative."""
    return (1 << min(lane, LANES)) - 1


@part
def other_lanes(bits):
    """The lanes that are not in ``bits``."""
    return lanes_before(LANES) ^ bits
