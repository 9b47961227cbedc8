"""Groups of tensors that a graph takes, each declared once: its name, named axes, type, unit, and when it is there.

A group is a frozen dataclass whose fields are made by ``tensor`` and ``group``. From the declaration come what the
manifest says of the inputs (``specs``), the group of a flat mapping of arrays by name (``from_flat``) and that mapping
again (``flat``); so a function takes a group, and a new input is one line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from typing import Any, Self, cast

from drape.arrays import Array
from drape.artifacts import TensorSpec

_DECLARED = "declared"


@dataclass(frozen=True)
class _Group:
    """A field that holds a group, some of whose axes have other names there."""

    kind: type[Tensors]
    axes: Mapping[str, str]
    part: str


@dataclass(frozen=True)
class _Tensor:
    """A field that holds a tensor; of networks with ``part`` alone, where that is not empty."""

    spec: TensorSpec
    part: str


def tensor(name: str, *shape: str | int, dtype: str = "float32", unit: str = "1", part: str = "") -> Any:
    """Returns a field of a group that declares the tensor ``name`` of a graph.

    ``shape`` has a length or a name for each axis; a named axis has any length. A tensor with a ``part`` belongs to
    networks with that part, and is None for others.
    """
    return _field(_Tensor(TensorSpec(name, shape, dtype, unit), part))


def group(kind: type[Tensors], *, part: str = "", **axes: str) -> Any:
    """Returns a field of a group that holds another group, of the class ``kind``. ``axes`` gives new names to axes of
    ``kind``: ``old="new"``. A group with a ``part`` belongs to networks with that part, and is None for others."""
    return _field(_Group(kind, axes, part))


def _field(declared: _Tensor | _Group) -> Any:
    return field(default=None if declared.part else MISSING, metadata={_DECLARED: declared})


class Tensors:
    """Base of the groups: frozen dataclasses whose fields ``tensor`` and ``group`` declare."""

    @classmethod
    def specs(cls, parts: tuple[str, ...] = (), **sizes: int) -> tuple[TensorSpec, ...]:
        """Returns the declared tensors of a network with ``parts``: those of every network first, then those of each
        part.

        Axes named in ``sizes`` have that length.
        """
        found = [(spec, part) for spec, part in cls._declared() if part in ("", *parts)]
        found.sort(key=lambda one: ("", *parts).index(one[1]))
        return tuple(_renamed(spec, sizes) for spec, _ in found)

    @classmethod
    def from_flat(cls, arrays: Mapping[str, Array]) -> Self:
        """Returns the group of ``arrays`` by the names of their tensors; a tensor of a part is None where ``arrays``
        lack it.

        Raises ``KeyError`` where a tensor of every network is missing.
        """
        values: dict[str, Any] = {}
        for item in fields(cast(Any, cls)):
            declared = item.metadata[_DECLARED]
            if isinstance(declared, _Tensor):
                values[item.name] = arrays.get(declared.spec.name) if declared.part else arrays[declared.spec.name]
            elif not declared.part or any(spec.name in arrays for spec in declared.kind.specs()):
                values[item.name] = declared.kind.from_flat(arrays)
        return cast(Any, cls)(**values)

    def flat(self) -> dict[str, Array]:
        """Returns the arrays of the group by the names of their tensors, without those that are None."""
        arrays: dict[str, Array] = {}
        for item, value in self._values():
            declared = item.metadata[_DECLARED]
            arrays |= value.flat() if isinstance(value, Tensors) else {declared.spec.name: value}
        return arrays

    def each(self, change: Callable[[Array], Array]) -> Self:
        """Returns a group with the results of ``change`` for each of this group's arrays."""
        values = {
            item.name: value.each(change) if isinstance(value, Tensors) else change(value)
            for item, value in self._values()
        }
        return cast(Any, type(self))(**values)

    def _values(self) -> Iterator[tuple[Field, Any]]:
        for item in fields(cast(Any, self)):
            value = getattr(self, item.name)
            if value is not None:
                yield item, value

    @classmethod
    def _declared(cls) -> Iterator[tuple[TensorSpec, str]]:
        """Every tensor with its part, in the order of the fields."""
        for item in fields(cast(Any, cls)):
            declared = item.metadata[_DECLARED]
            if isinstance(declared, _Tensor):
                yield declared.spec, declared.part
                continue
            for spec, part in declared.kind._declared():
                yield _renamed(spec, declared.axes), part or declared.part


def _renamed(spec: TensorSpec, axes: Mapping[str, str | int]) -> TensorSpec:
    return replace(spec, shape=tuple(axes.get(axis, axis) if isinstance(axis, str) else axis for axis in spec.shape))
