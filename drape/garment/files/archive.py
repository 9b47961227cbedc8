"""Reads a mesh that comes with files beside it: a zip, or the parts of a form (multipart/form-data).

Nothing is unpacked to disk, so no name in an archive is a path of this machine. Its limits hold before a byte is
unpacked, and a file is unpacked only when the mesh asks for it.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import PurePosixPath

from drape.files.formats import HEAD_BYTES, MESH_FORMATS
from drape.garment.files.mesh import Beside, GarmentMesh, mesh_fault, read_payload

MOST_FILES = 1000
MOST_BYTES = 384 * 2**20
MOST_RATIO = 250  # unpacked over packed bytes, of files above RATIO_FROM
RATIO_FROM = 2**20
ARCHIVES = (".zip", ".rar", ".7z", ".gz", ".tar")
MESHES = (*(one.suffix for one in MESH_FORMATS if one.name != "zip"), ".vrm")

Files = Mapping[str, Callable[[], bytes]]


def read_zip(payload: bytes, *, name: str, vertex_limit: int) -> GarmentMesh:
    """Returns the one mesh in ``payload``, a zip or a form (multipart/form-data), with the pictures that lie beside it.
    Raises ``MeshError`` where there is not exactly one mesh, or where a file cannot be read."""
    files = _parts(payload, name) if payload[:2] == b"--" else zip_members(payload, name)
    shown = {path: read for path, read in files.items() if not path.startswith(("__MACOSX/", ".")) and "/." not in path}
    meshes = [path for path in shown if path.lower().endswith(MESHES)]
    if not meshes and (inner := [path for path in shown if path.lower().endswith(ARCHIVES)]):
        cure = "Unpack it, and pack the mesh with its pictures into one zip."
        raise mesh_fault(name, "a mesh in the zip", f"another archive, {inner[0]!a:.60}", cure)
    if len(meshes) != 1:
        got = ", ".join(f"{one!a:.40}" for one in meshes[:3]) or "none"
        raise mesh_fault(name, f"one mesh, {', '.join(MESHES)}", got, "Keep one mesh and its pictures in the zip.")
    content, kind = shown[meshes[0]](), PurePosixPath(meshes[0]).suffix.lower().lstrip(".")
    beside = files_beside(shown, PurePosixPath(meshes[0]).parent)
    return read_payload(content, name=name, kind=kind, vertex_limit=vertex_limit, beside=beside)


def files_beside(files: Files, folder: PurePosixPath) -> Beside:
    """Returns a function that takes a file's name, as a mesh in ``folder`` gives it, and returns the file's bytes; None
    where ``files`` lacks it. ``files``: what ``zip_members`` returns. The file is looked for at its path from
    ``folder``, and then by the last part of its name."""

    def beside(wanted: str) -> bytes | None:
        plain = str(PurePosixPath(wanted.replace("\\", "/")))
        here = [path for path in files if path.lower() == str(folder / plain).lower()]
        last = plain.rpartition("/")[2].lower()  # exporters write the paths of their own machine
        named = here or [path for path in files if path.rpartition("/")[2].lower() == last]
        return files[named[0]]() if named else None

    return beside


def zip_members(payload: bytes, name: str) -> Files:
    """Returns a dictionary: by the path of each file in the zip ``payload``, a function without arguments that returns
    the file's bytes. Raises ``MeshError`` for a zip that is too large, encrypted or damaged, or has paths that lead out
    of it; the functions raise it for damaged files."""
    if (entries := payload.count(b"PK\x01\x02")) > MOST_FILES:
        raise mesh_fault(
            name, f"at most {MOST_FILES} files in the zip", f"{entries}", "Keep the mesh and its pictures."
        )
    try:
        archive = zipfile.ZipFile(io.BytesIO(payload))
        members = [member for member in archive.infolist() if not member.is_dir()]
    except Exception as error:  # a broken file can raise anything inside the library
        raise mesh_fault(name, "a whole zip", f"{type(error).__name__}", "Pack it again.") from error
    if (size := sum(member.file_size for member in members)) > MOST_BYTES:
        raise mesh_fault(name, f"at most {MOST_BYTES >> 20} MiB unpacked", f"{size >> 20} MiB", "Shrink its pictures.")
    for member in members:
        if member.file_size > RATIO_FROM and member.file_size > MOST_RATIO * member.compress_size:
            got = f"{member.file_size / max(member.compress_size, 1):.0f} in {member.filename!a:.60}"
            raise mesh_fault(name, f"files packed to at least 1/{MOST_RATIO}", got, "Leave that file out.")
        if member.filename.startswith("/") or ".." in member.filename.split("/"):
            raise mesh_fault(name, "names inside the zip", f"{member.filename!a:.60}", "Pack the folder itself.")
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise mesh_fault(name, "a zip that is only deflated", "encryption or another packing", "Pack it again.")

    def read(member: zipfile.ZipInfo) -> bytes:
        try:
            return archive.read(member)
        except Exception as error:
            raise mesh_fault(
                name, f"a whole {member.filename!a:.60}", f"{type(error).__name__}", "Pack it again."
            ) from error

    return {member.filename: lambda member=member: read(member) for member in members}


def _parts(payload: bytes, name: str) -> Files:
    """The files of a form by their names; the first line is the boundary."""
    line, _, _ = payload[:HEAD_BYTES].partition(b"\r\n")
    if payload.count(line) > MOST_FILES:
        raise mesh_fault(name, f"at most {MOST_FILES} parts", "more", "Send the mesh and its pictures.")
    files: dict[str, Callable[[], bytes]] = {}
    for part in (b"\r\n" + payload).split(b"\r\n" + line)[1:]:
        head, _, body = part.partition(b"\r\n\r\n")
        if found := re.search(rb'filename="([^"\r\n]{1,400})"', head):
            files[found[1].decode("utf-8", errors="replace").replace("\\", "/")] = lambda body=body: body
    return files
