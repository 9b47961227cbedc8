"""What garments are made of: the fabrics that a request names, by layer."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.errors import InputError
from drape.wire.options import DrapeOptions, FabricChoice


def layer_fabrics(options: DrapeOptions, layers: int) -> tuple[Fabric | None, ...]:
    """The fabric of each of ``layers`` garments, None where it is the garment's own.

    Refuses (``InputError``, ``NotFound``) what is no fabric, and a list of another length.
    """
    chosen = options.fabric
    if not isinstance(chosen, tuple):
        return (_fabric(chosen),) * layers
    if len(chosen) != layers:
        raise InputError(
            "fabric",
            expected=f"one for all, or {layers}: one for each garment",
            got=str(len(chosen)),
            cure="Put null where a garment keeps its own.",
        )
    return tuple(_fabric(one) for one in chosen)


def _fabric(chosen: FabricChoice | None) -> Fabric | None:
    if chosen is None:
        return None
    return fabric(chosen) if isinstance(chosen, str) else _of_numbers(tuple(chosen.model_dump().items()))


@lru_cache(maxsize=256)
def _of_numbers(numbers: tuple[tuple[str, float], ...]) -> Fabric:
    """Looked at once, not in every frame."""
    return fabric(dict(numbers))


def check_known(fabrics: Sequence[Fabric | None], *, known: bool, model: str) -> None:
    """Refuses (``InputError``) any fabric where the ``model`` has one cloth only."""
    if not known and any(one is not None for one in fabrics):
        raise InputError(
            "fabric", expected=f"none: model {model} was trained on one cloth", got="a fabric", cure="Leave it out."
        )
