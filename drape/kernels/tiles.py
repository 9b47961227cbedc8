"""Products of matrices by a processor's tiles, where it has them (AMX, for numbers of 16 bits).

A tile has sixteen rows of 64 bytes. ``tile_product(c, a, b)`` adds to the float32 numbers of tile c

    c[m, n] += sum over i of a[m, 2 i] b[i, 2 n] + a[m, 2 i + 1] b[i, 2 n + 1],

of 32 numbers in each row of a and b, every one the upper half of a float32. A processor does so in the time of half a
hundred of its other instructions that multiply and add. Two halves hold sixteen bits of a number: ``split`` and
``put_split`` give them, in pairs.

``has_tiles`` says whether kernels may be given arrays for tiles; without them nothing of these functions is compiled.
Between ``begin_tiles`` and ``end_tiles`` a thread has eight of them.
"""

from __future__ import annotations

import ctypes
import platform
from functools import cache
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba.core import cgutils, types
from numba.core import config as _config
from numba.extending import intrinsic

from drape.kernels import lanes
from drape.kernels.compiled import part
from drape.kernels.lanes import LANES, ir

TILE = 256  # pairs of halves, or float32 numbers, of a tile
LINE = 16  # numbers of 32 bits in a line of the cache
SHAPES = np.zeros(64, np.uint8)  # what the processor is told of eight tiles: bytes a row, and rows
SHAPES[0], SHAPES[16:32:2], SHAPES[48:56] = 1, 64, LANES
_PERMIT = (158, 0x1023, 18)  # the system's call for the state of tiles: arch_prctl, ARCH_REQ_XCOMP_PERM, XTILEDATA
config: Any = _config  # numba adds its settings when it is imported
_literal: Any = intrinsic(prefer_literal=True)


@cache
def compiles_tiles() -> bool:
    """Whether kernels are compiled for a processor that has tiles."""
    plain = config.CPU_NAME is None and config.CPU_FEATURES is None  # numba's settings: for this very processor
    return plain and platform.machine() == "x86_64" and llvm.get_host_cpu_features().get("amx-bf16", False)


@cache
def has_tiles() -> bool:
    """Whether kernels may use tiles: the processor has them, and Linux lets this process keep their state."""
    if not compiles_tiles() or platform.system() != "Linux":
        return False
    return ctypes.CDLL(None).syscall(*map(ctypes.c_long, _PERMIT)) == 0


def split(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The upper halves nearest to ``values`` (..., 2 n) float32, and to what these lack, uint32 (..., n): the first of
    two numbers in the lower half of each."""
    high = _upper(values)
    low = _upper(values - high.view(np.float32))
    return _pairs(high), _pairs(low)


def aligned(array: np.ndarray) -> np.ndarray:
    """A copy of ``array`` that begins where tiles are read fastest: a row within one line of the cache."""
    room = np.empty(array.size + LINE, array.dtype)
    start = -(room.ctypes.data // room.itemsize) % LINE
    copy = room[start : start + array.size].reshape(array.shape)
    copy[...] = array
    return copy


def _upper(values: np.ndarray) -> np.ndarray:
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32)
    return (bits + (0x7FFF + ((bits >> 16) & 1))) & np.uint32(0xFFFF0000)  # to the nearest, of two the even one


def _pairs(upper: np.ndarray) -> np.ndarray:
    return (upper[..., 0::2] >> 16) | upper[..., 1::2]


def _instruct(context: Any, builder: Any, name: str, *arguments: Any) -> Any:
    """Writes an instruction for tiles where there are any."""
    if compiles_tiles():
        kind = ir.FunctionType(ir.VoidType(), [argument.type for argument in arguments])
        builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.x86.{name}"), arguments)
    return context.get_dummy_value()


def _byte(tile: types.IntegerLiteral) -> Any:
    return ir.Constant(ir.IntType(8), tile.literal_value)


def _place(context: Any, builder: Any, signature: Any, args: Any, array: int) -> Any:
    """Where the number at the ``array + 1``-st argument of the flat array before it is."""
    start = context.cast(builder, args[array + 1], signature.args[array + 1], types.intp)
    kind = ir.IntType(8)
    of = signature.args[array]
    data = lanes.make_array(of)(context, builder, args[array]).data
    return builder.bitcast(builder.gep(data, [start]), kind.as_pointer())


@_literal
def begin_tiles(typing: Any, shapes: Any) -> Any:
    """Gives the thread eight tiles of ``SHAPES``."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = lanes.make_array(shapes)(context, builder, args[0]).data
        return _instruct(context, builder, "ldtilecfg", data)

    return types.void(shapes), code


@_literal
def end_tiles(typing: Any) -> Any:
    """Takes them back: a thread that has tiles is slower to switch to."""
    return types.void(), lambda context, builder, signature, args: _instruct(context, builder, "tilerelease")


@_literal
def tile_zero(typing: Any, tile: Any) -> Any:
    """Fills the ``tile``, a number from 0 to 7, with zeros."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _instruct(context, builder, "tilezero", _byte(tile))

    return types.void(tile), code


@_literal
def tile_load(typing: Any, tile: Any, array: Any, start: Any) -> Any:
    """Reads the ``tile`` from the flat ``array``, row after row from ``start`` on."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        where = _place(context, builder, signature, args, 1)
        return _instruct(context, builder, "tileloadd64", _byte(tile), where, lanes._int(64))

    return types.void(tile, array, start), code


@_literal
def tile_store(typing: Any, tile: Any, array: Any, start: Any) -> Any:
    """Writes the ``tile`` to the flat ``array``, row after row from ``start`` on."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        where = _place(context, builder, signature, args, 1)
        return _instruct(context, builder, "tilestored64", _byte(tile), where, lanes._int(64))

    return types.void(tile, array, start), code


@_literal
def tile_product(typing: Any, c: Any, a: Any, b: Any) -> Any:
    """Adds the products of the tiles ``a`` and ``b`` to ``c``."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _instruct(context, builder, "tdpbf16ps", _byte(c), _byte(a), _byte(b))

    return types.void(c, a, b), code


@part
def room_for(count, kind):
    """Memory for ``count`` numbers of a ``kind`` of 32 bits, ``aligned``."""
    room = np.empty(count + LINE, kind)
    return room[-(room.ctypes.data // 4) % LINE :]


@lanes.built
def put_split(typing: Any, high: Any, low: Any, start: Any, a: Any, b: Any) -> Any:
    """Writes ``split`` of the pairs of the float32 rows ``a`` and ``b`` to the flat uint32 arrays ``high`` and ``low``
    from ``start`` on."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector = ir.VectorType(ir.IntType(32), LANES)

        def all_of(value: int) -> Any:
            return ir.Constant(vector, [value] * LANES)

        def upper(row: Any) -> Any:
            bits = builder.bitcast(row, vector)
            odd = builder.and_(builder.lshr(bits, all_of(16)), all_of(1))
            return builder.and_(builder.add(builder.add(bits, odd), all_of(0x7FFF)), all_of(0xFFFF0000))

        both = []
        for row in args[3:]:
            above = upper(row)
            both.append((above, upper(builder.fsub(row, builder.bitcast(above, row.type)))))
        start = context.cast(builder, args[2], signature.args[2], types.intp)
        for number, array in enumerate((high, low)):
            where = lanes._pointer(context, builder, args[number], array, start, vector)
            first = builder.lshr(both[0][number], all_of(16))
            builder.store(builder.or_(first, both[1][number]), where, align=4)
        return context.get_dummy_value()

    return types.void(high, low, start, a, b), code
