"""Pictures of strangers' files, made anew: pixels stay, and what else a file may carry goes."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from drape.errors import MeshError
from drape.files.ktx2 import SIGNATURE, ktx2_picture
from drape.files.looks import Looks, replace_pictures
from drape.files.notes import absent_picture

if TYPE_CHECKING:
    from PIL import Image

READ = ("PNG", "JPEG", "WEBP", "TGA", "BMP")
KINDS = ", ".join((*READ, "KTX2"))
Channel = tuple[bytes, int]
MOST_PIXELS = 2**26  # 8192 x 8192.
LARGEST_SIDE = 2048
MOST_BYTES = 48 * 2**20  # All pictures of a garment, made anew, have at most so many bytes.


def remake_picture(payload: bytes, *, label: str, side: int = LARGEST_SIDE) -> bytes:
    """Returns the picture in ``payload`` as the bytes of a new file, none of whose sides is longer than ``side``
    [pixels]: JPEG if it was a JPEG, or a WebP or KTX2 without alpha, otherwise PNG.

    Raises ``MeshError`` for other formats, damaged files and more than ``MOST_PIXELS``.
    """
    from PIL import Image

    try:
        with _opened(payload, side, label) as image:
            kind, (width, height) = image.format, image.size
            if width * height <= MOST_PIXELS:
                image.draft("RGB", (side, side))  # Of a larger JPEG this decodes only what is needed.
                has_alpha = "A" in image.getbands() or "transparency" in image.info
                plain = image.convert("RGBA" if has_alpha else "RGB")
                if has_alpha and plain.getchannel("A").getextrema() == (255, 255):
                    plain = plain.convert("RGB")
                plain.thumbnail((side, side))
                plain.info.clear()  # Comments and profiles would be written again.
                out = io.BytesIO()
                if kind in ("JPEG", "WEBP", None) and plain.mode == "RGB":
                    plain.save(out, "JPEG", quality=92)
                else:
                    plain.save(out, "PNG")
                return out.getvalue()
    except (MemoryError, MeshError):
        raise
    except Exception as error:  # A broken file can raise anything inside the library.
        got = "too many pixels" if isinstance(error, Image.DecompressionBombError) else f"{type(error).__name__}"
        raise MeshError(label, expected=f"a whole {KINDS}", got=got, cure="Export it again.") from error
    got = f"{width} x {height}"
    raise MeshError(
        label, expected=f"at most {MOST_PIXELS // 10**6} million pixels", got=got, cure="Shrink the picture."
    )


def _opened(payload: bytes, side: int, label: str) -> Image.Image:
    from PIL import Image

    if payload.startswith(SIGNATURE):
        return ktx2_picture(payload, side=side, most_pixels=MOST_PIXELS, label=label)
    return Image.open(io.BytesIO(payload), formats=READ)


def remake_pictures(looks: Looks) -> tuple[Looks, tuple[str, ...]]:
    """Returns ``looks`` with its pictures made anew, and warnings. A picture that cannot be made is left out, and a
    warning says why."""
    cleaned: list[bytes | None] = []
    notes, size = [], 0
    for number, picture in enumerate(looks.pictures, start=1):
        try:
            png = remake_picture(picture, label=f"picture {number}")
            size += len(png)
            if size > MOST_BYTES:
                most, cure = f"at most {MOST_BYTES >> 20} MiB of pictures", "Export them smaller."
                raise MeshError(f"picture {number}", expected=most, got="more", cure=cure)
            cleaned.append(png)
        except MeshError as error:
            notes.append(absent_picture(error))
            cleaned.append(None)
    return replace_pictures(looks, cleaned), tuple(notes)


def metallic_roughness(metallic: Channel | None, roughness: Channel | None, *, label: str) -> bytes:
    """Returns the PNG file that glTF takes: roughness in green and metallic in blue. Each is given as the bytes of a
    picture and the number (0 to 3) of its channel there; None, for one of them at most, becomes white. Raises
    ``MeshError`` as ``remake_picture`` does."""
    from PIL import Image

    planes = [None if one is None else _channel(*one, label=label) for one in (roughness, metallic)]
    size = next(one.size for one in planes if one is not None)
    white = Image.new("L", size, 255)
    green, blue = (white if one is None else one.resize(size) for one in planes)
    out = io.BytesIO()
    Image.merge("RGB", (white, green, blue)).save(out, "PNG")
    return out.getvalue()


def _channel(payload: bytes, number: int, *, label: str) -> Image.Image:
    from PIL import Image

    with Image.open(io.BytesIO(remake_picture(payload, label=label))) as image:
        return image.convert("RGBA").getchannel(number)
