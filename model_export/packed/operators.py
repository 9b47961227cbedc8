"""ONNX for those operations of the packed graph that the exporter writes in a slower way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import onnxscript
import torch
from torch import Tensor, nn


@torch.library.custom_op("drape::softsign", mutates_args=())
def softsign(x: Tensor) -> Tensor:
    """Returns ``x / (1 + |x|)``: one operation of the graph, where torch's own is written as three."""
    return nn.functional.softsign(x)


@softsign.register_fake
def _(x: Tensor) -> Tensor:
    return torch.empty_like(x)


def _gather(table, dim, index):
    """``torch.index_select`` as one Gather; the exporter's own adds a Reshape and a Cast to every index.

    Columns of a matrix with few rows as GatherElements, which walks a row at once: 4.5 times as fast on a processor.
    """
    op: Any = onnxscript.opset20
    if dim != 1 or len(table.shape) != 2:
        return op.Gather(table, index, axis=dim)
    if isinstance(table.shape[0], int):
        shape = op.Constant(value_ints=[table.shape[0], 1])
    else:
        shape = op.Concat(op.Shape(table, start=0, end=1), op.Constant(value_ints=[1]), axis=0)
    return op.GatherElements(table, op.Expand(index, shape), axis=1)


def _softsign(x):
    return onnxscript.opset20.Softsign(x)


TRANSLATIONS = {torch.ops.aten.index_select.default: _gather, torch.ops.drape.softsign.default: _softsign}


def rows(table: Tensor, index: Tensor) -> Tensor:
    """Returns the rows (n, ...) of ``table`` (m, ...) that ``index`` (n,) names."""
    return torch.index_select(table, 0, index)


class WithTables(nn.Module):
    """A module whose constant ``tables`` are its buffers, attributes by name."""

    def __init__(self, tables: Mapping[str, Tensor]) -> None:
        super().__init__()
        for name, value in tables.items():
            self.register_buffer(name, value)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Tensor: ...
