"""Hidden garments of an outfit: those that are worn and do not come, of which no more is computed than the visible ones
feel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drape.errors import InputError
from drape.wire.options import DrapeOptions

if TYPE_CHECKING:
    from service.compute.garments import Scene


def narrowed(scene: Scene, options: DrapeOptions, *, felt: bool) -> tuple[Scene, DrapeOptions]:
    """What must be draped of ``scene``, and ``options`` for that: without the hidden garments that no visible one
    feels. Layers feel those below them, so a hidden garment stays where a visible one lies over it, if they are
    ``felt`` at all.

    Refuses (``InputError``) hidden garments that are not worn, and an outfit of which nothing comes.
    """
    if options.hidden is None:
        return scene, options
    worn = [layer.id for layer in scene.layers]
    unknown = [name for name in options.hidden if name not in worn]
    if unknown:
        cure = "Hide garments of this request only."
        raise InputError("hidden", expected=f"some of: {', '.join(worn)}", got=unknown[0], cure=cure)
    visible = [i for i, name in enumerate(worn) if name not in options.hidden]
    if not visible:
        raise InputError("hidden", expected="one visible garment or more", got="none", cure="Leave one out of hidden.")
    kept = [i for i in range(len(worn)) if i in visible or (felt and i < visible[-1])]
    narrow: dict[str, Any] = {"hidden": tuple(worn[i] for i in kept if i not in visible) or None}
    if isinstance(options.fabric, tuple):
        narrow["fabric"] = tuple(options.fabric[i] for i in kept)
    return scene.only([worn[i] for i in kept]), options.model_copy(update=narrow)
