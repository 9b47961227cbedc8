"""Pictures in KTX2 of Basis Universal (glTF's KHR_texture_basisu), unpacked by opengl-basisu.

The package is the extra ``ktx2``. Pixels are bounded before the decoder sees a byte.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from drape.errors import MeshError

if TYPE_CHECKING:
    from PIL import Image

SIGNATURE = b"\xabKTX 20\xbb\r\n\x1a\n"
SIZE_AT = 20  # Width and height begin at this byte.


def ktx2_picture(payload: bytes, *, side: int, most_pixels: int, label: str) -> Image.Image:
    """Returns the picture in a KTX2 file as RGBA: the smallest of its sizes whose longer side is ``side`` [pixels] or
    more, else the largest.

    Raises ``MeshError`` where the package is not installed. A broken file raises anything, and one with more than
    ``most_pixels`` raises ``DecompressionBombError``.
    """
    from PIL import Image

    try:
        import opengl_basisu
    except ModuleNotFoundError as error:
        expected, cure = "the package opengl-basisu, which unpacks KTX2", "Install it, or export PNG or JPEG."
        raise MeshError(label, expected=expected, got="none", cure=cure) from error
    width, height = struct.unpack_from("<2I", payload, SIZE_AT)
    if width * height > most_pixels:
        raise Image.DecompressionBombError(f"{width} x {height}")
    texture = opengl_basisu.open(payload)
    level = max((one for one in range(texture.levels) if max(texture.level_size(one)) >= side), default=0)
    return Image.fromarray(texture.transcode("rgba8", level).data)
