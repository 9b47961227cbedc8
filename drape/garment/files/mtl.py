"""The materials of a Wavefront OBJ (MTL): colours, alpha and the pictures that lie beside."""

from __future__ import annotations

import re
from contextlib import suppress

import numpy as np

from drape.files.looks import Looks, Material, Slot
from drape.files.notes import absent_file
from drape.garment.files.mesh import Beside

PICTURES: dict[str, Slot] = {"map_kd": "base_colour", "norm": "normal", "map_bump": "normal", "bump": "normal"}
MOST_LIBRARIES = 32
_NUMBERS = re.compile(r"[-+.\dEe]+\Z|(on|off)\Z")


def mtl_looks(libraries: list[str], beside: Beside, names: tuple[str, ...]) -> tuple[Looks, tuple[str, ...]]:
    """Returns the look of each of the materials ``names``, None for one that no library defines, and notes about files
    that are missing. ``libraries`` are names of MTL files; ``beside`` returns the bytes of these and of pictures."""
    keywords, pictures, missing = dict[str, dict[str, str]](), dict[str, int](), list[str]()
    held: list[bytes] = []
    for library in list(dict.fromkeys(libraries))[:MOST_LIBRARIES]:
        content = beside(library)
        if content is None:
            missing.append(library)
            continue
        current: dict[str, str] = {}
        for line in content.decode("utf-8", errors="replace").splitlines():
            keyword, _, rest = line.strip().partition(" ")
            if keyword.lower() == "newmtl":
                current = keywords.setdefault(rest.strip(), {})
            else:
                current[keyword.lower()] = rest.strip()

    def picture(statement: str) -> int | None:
        words = statement.split(" ")
        while words and words[0].startswith("-"):  # options, each with numbers or a switch
            words = words[1 + (words[0] in ("-imfchan", "-type")) :]
            while len(words) > 1 and _NUMBERS.match(words[0]):
                words = words[1:]
        name = " ".join(words)
        if name and name not in pictures:
            content = beside(name)
            if content is None:
                missing.append(name)
                return None
            pictures[name] = len(held)
            held.append(content)
        return pictures.get(name)

    def material(said: dict[str, str]) -> Material:
        used: dict[Slot, int] = {}
        for keyword, slot in PICTURES.items():
            # A bump is a height or, as often, a normal map: its name says which.
            if keyword in said and (keyword in ("map_kd", "norm") or re.search("nor|nrm", said[keyword].lower())):
                found = picture(said[keyword])
                if found is not None:
                    used[slot] = found
        alpha = _numbers(said.get("d", ""), 1) or [1.0 - v for v in _numbers(said.get("tr", ""), 1)] or [1.0]
        colour = [1.0] * 3 if "base_colour" in used else _numbers(said.get("kd", ""), 3) or [0.8] * 3
        mode = "BLEND" if alpha[0] < 1.0 else "MASK" if "map_d" in said else "OPAQUE"
        shiny, metal = _numbers(said.get("pr", ""), 1) or [0.85], _numbers(said.get("pm", ""), 1) or [0.0]
        rgba = (colour[0], colour[1], colour[2], alpha[0])
        return Material(rgba, metallic=metal[0], roughness=shiny[0], alpha_mode=mode, pictures=used)

    looks = tuple(material(keywords[name]) if name in keywords else None for name in names)
    notes = [absent_file(name) for name in missing[:20]]
    return Looks(looks, tuple(held)), tuple(notes)


def _numbers(text: str, count: int) -> list[float]:
    """The first ``count`` numbers of ``text`` within 0 and 1, none where there are fewer."""
    with suppress(ValueError):
        found = [float(word) for word in text.split()[:count]]
        if len(found) == count and np.isfinite(found).all():
            return np.clip(found, 0.0, 1.0).tolist()
    return []
