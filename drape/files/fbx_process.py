"""Reads the FBX file on standard input by the package ufbx; writes its contents as an npz to standard output.

With the argument ``motion`` these are its nodes in the frames of its longest animation, or of the one that is named.

It is a process of its own, since ufbx 0.0.5 frees memory that is still in use (``mesh.faces``, a material's maps), and
then it crashes. Here every object is kept until the process ends, which it does without freeing any. It limits its own
memory and time, but not on Windows, since files are strangers'.
"""

from __future__ import annotations

import gc
import io
import json
import os
import sys
from typing import Any

import numpy as np

if sys.platform != "win32":  # which has no such limits
    import resource

MEMORY_BYTES, CPU_S = 3 * 2**30, 60
DEEPEST = 500  # Nodes may lie so deep within each other.
MOST_NUMBERS = 60_000_000
MOST_MATRICES = 600_000  # Frames times nodes.
NUMBERS = ("base_factor", "metalness", "roughness", "opacity")
MAPS = {
    "base_color": ("pbr",),
    "metalness": ("pbr",),
    "roughness": ("pbr",),
    "normal_map": ("fbx", "pbr"),
    "bump": ("fbx",),
}
_KEPT: list[Any] = []


def _of(owner: Any, name: str | int) -> Any:
    """The attribute, or the item, ``name`` of ``owner``, kept until the process ends."""
    value = owner[name] if isinstance(name, int) else getattr(owner, name)
    _KEPT.append(value)
    return value


def _all(held: Any) -> list[Any]:
    return [_of(held, number) for number in range(len(held))]


def _limit() -> None:
    """Limits this process's time and memory."""
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 1))
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    least = min(one for one in (soft, hard, MEMORY_BYTES) if one != resource.RLIM_INFINITY)
    resource.setrlimit(resource.RLIMIT_AS, (least, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main() -> None:
    """Reads the FBX file on standard input, writes its contents to standard output as the npz that ``drape.files.fbx``
    reads, and ends the process with status 0. Where it cannot read the file it writes the reason instead, and ends with
    status 3."""
    gc.disable()
    if sys.platform != "win32":
        _limit()
    import ufbx

    moving = sys.argv[1:2] == ["motion"]
    payload, out, status = sys.stdin.buffer.read(), io.BytesIO(), 0
    try:
        scene = ufbx.load_memory(
            payload,
            file_format=ufbx.FileFormat.FBX,
            load_external_files=False,
            ignore_animation=not moving,
            force_single_thread_ascii_parsing=True,
            node_depth_limit=DEEPEST,
            target_axes=ufbx.axes_right_handed_y_up,
            target_unit_meters=1.0,
        )
        _KEPT.append(scene)
        np.savez(out, allow_pickle=False, **(_motion(scene, *sys.argv[2:3]) if moving else _contents(scene)))
    except (ufbx.UfbxError, MemoryError, ValueError) as error:
        out, status = io.BytesIO(f"{type(error).__name__.removesuffix('Error')}: {error}"[:200].encode()), 3
    sys.stdout.buffer.write(out.getbuffer())
    sys.stdout.flush()
    os._exit(status)


def _contents(scene: Any) -> dict[str, np.ndarray]:
    """The arrays of the visible meshes, the pictures, and as JSON what names and numbers there are."""
    materials, textures = _all(_of(scene, "materials")), list[Any]()
    arrays: dict[str, np.ndarray] = {}
    meshes = list[dict[str, Any]]()
    total = 0
    for node in _all(_of(scene, "nodes")):
        mesh = _of(node, "mesh")
        if mesh is None or not node.visible:
            continue
        if (total := total + 6 * mesh.num_vertices + 4 * mesh.num_indices) > MOST_NUMBERS:
            raise ValueError(f"more than {MOST_NUMBERS >> 20} million numbers")
        number = len(meshes)
        arrays |= {f"{number}.{name}": array for name, array in _arrays(node, mesh).items()}
        used = _all(_of(node, "materials")) or _all(_of(mesh, "materials"))
        meshes.append({"name": node.name, "materials": [one.typed_id for one in used]})
    looks = [_look(one, textures) for one in materials]
    files = list[list[str]]()
    for number, texture in enumerate(textures):
        video = _of(texture, "video")
        content = _of(texture, "content") or (b"" if video is None else _of(video, "content"))
        arrays[f"picture.{number}"] = np.frombuffer(bytes(content), dtype=np.uint8)
        files.append([texture.relative_filename, texture.filename, texture.absolute_filename])
    description = {
        "unit_m": _of(scene, "settings").original_unit_meters,
        "meshes": meshes,
        "materials": looks,
        "pictures": files,
    }
    return arrays | {"description": np.frombuffer(json.dumps(description).encode(), dtype=np.uint8)}


def _motion(scene: Any, clip: str | None = None) -> dict[str, np.ndarray]:
    """The nodes at rest and in the frames of the longest animation, or of the one called ``clip``, at the file's own
    rate, and as JSON their names, parents, and that rate."""
    import ufbx

    nodes, stacks = _all(_of(scene, "nodes")), _all(_of(scene, "anim_stacks"))
    stacks = [one for one in stacks if clip is None or one.name in (clip, f"{clip}|{clip}")]
    if not stacks:
        raise ValueError("no animation" + ("" if clip is None else f" called {clip[:40]}"))
    longest = max(stacks, key=lambda one: one.time_end - one.time_begin)
    rate = min(max(_of(scene, "settings").frames_per_second, 15.0), 120.0)
    frames = round((longest.time_end - longest.time_begin) * rate) + 1
    if frames * len(nodes) > MOST_MATRICES:
        raise ValueError(f"more than {MOST_MATRICES // len(nodes):,} frames")
    place = {node.typed_id: number for number, node in enumerate(nodes)}
    parents = [place.get(parent.typed_id, -1) if (parent := _of(node, "parent")) else -1 for node in nodes]
    moves = np.empty((frames, len(nodes), 10))
    anim = _of(longest, "anim")
    for number, node in enumerate(nodes):
        for frame in range(frames):
            placed = ufbx.evaluate_transform(anim, node, longest.time_begin + frame / rate)
            moves[frame, number] = [*placed.translation, *placed.rotation, *placed.scale]
            _KEPT.append(placed)
    rest = np.array([np.array(_of(node, "node_to_world"), dtype=np.float64).T for node in nodes])
    description = {"names": [node.name for node in nodes], "parents": parents, "fps": rate}
    return {
        "moves": moves,
        "rest": rest,
        "description": np.frombuffer(json.dumps(description).encode(), dtype=np.uint8),
    }


def _arrays(node: Any, mesh: Any) -> dict[str, np.ndarray]:
    uv = _of(mesh, "vertex_uv")
    arrays = {
        "vertices": np.array(_of(mesh, "vertices"), dtype=np.float64).reshape(-1, 3),
        "corners": np.array(_of(mesh, "vertex_indices"), dtype=np.int64),
        "polygons": np.array(_of(mesh, "faces"), dtype=np.int64).reshape(-1, 2),
        "face_material": np.array(_of(mesh, "face_material"), dtype=np.int64),
        "placed": np.array(_of(node, "geometry_to_world"), dtype=np.float64).T,
    }
    if uv.exists:
        values = np.array(_of(uv, "values"), dtype=np.float64).reshape(-1, 2)
        arrays["uv"] = values[np.array(_of(uv, "indices"), dtype=np.int64)]
    return arrays


def _look(material: Any, textures: list[Any]) -> dict[str, Any]:
    """The numbers of ``material``, and which of ``textures`` its maps show; those that are new are added."""
    sides = {name: _of(material, name) for name in ("pbr", "fbx")}
    look: dict[str, Any] = {"name": material.name, "pictures": {}}
    colour = _of(sides["pbr"], "base_color")
    look["base_color"] = list(_of(colour, "value_vec4"))[:3] if colour.has_value else None
    for name in NUMBERS:
        held = _of(sides["pbr"], name)
        look[name] = _of(held, "value_vec4")[0] if held.has_value else None
    for name, places in MAPS.items():
        for held in (_of(sides[side], name) for side in places):
            texture = _of(held, "texture") if held.texture_enabled else None
            # Of several layers the lowest is read.
            files = [] if texture is None else _all(_of(texture, "file_textures"))
            if files and name not in look["pictures"]:
                known = [one.element_id for one in textures]
                if files[0].element_id not in known:
                    textures.append(files[0])
                    known.append(files[0].element_id)
                look["pictures"][name] = known.index(files[0].element_id)
    return look


if __name__ == "__main__":
    main()
