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
MOST_RATIO = 250  # of a file above RATIO_FROM
RATIO_FROM = 2**20
ARCHIVES = (".zip", ".rar", ".7z", ".gz", ".tar")
MESHES = (*(one.suffix for one in MESH_FORMATS if one.name != "zip"), ".vrm")

Files = Mapping[str, Callable[[], bytes]]


def read_zip(payload: bytes, *, name: str, vertex_limit: int) -> GarmentMesh:
    """The one mesh in a zip or in the parts of a form, with the pictures beside it."""
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
    """Returns a function that gives the content of a file that a mesh in ``folder`` names, None where ``files`` lacks
    it.

    The file is looked for at its path from ``folder``, and else by the last part of its name.
    """

    def beside(wanted: str) -> bytes | None:
        plain = str(PurePosixPath(wanted.replace("\\", "/")))
        here = [path for path in files if path.lower() == str(folder / plain).lower()]
        last = plain.rpartition("/")[2].lower()  # exporters write the paths of their own machine
        named = here or [path for path in files if path.rpartition("/")[2].lower() == last]
        return files[named[0]]() if named else None

    return beside


def zip_members(payload: bytes, name: str) -> Files:
    """The files of a zip; refuses one that is too large, encrypted or damaged, or that has names outside of it."""
    if (entries := payload.count(b"PK\x01\x02")) > MOST_FILES:
        raise mesh_fault(
            name, f"at most {MOST_FILES} files in the zip", f"{entries}", "Keep the mesh and its pictures."
        )
    try:
        archive = zipfile.ZipFile(io.BytesIO(payload))
        members = [one for one in archive.infolist() if not one.is_dir()]
    except Exception as error:  # a broken file can raise anything inside the library
        raise mesh_fault(name, "a whole zip", f"{type(error).__name__}", "Pack it again.") from error
    if (size := sum(one.file_size for one in members)) > MOST_BYTES:
        raise mesh_fault(name, f"at most {MOST_BYTES >> 20} MiB unpacked", f"{size >> 20} MiB", "Shrink its pictures.")
    for one in members:
        if one.file_size > RATIO_FROM and one.file_size > MOST_RATIO * one.compress_size:
            got = f"{one.file_size / max(one.compress_size, 1):.0f} in {one.filename!a:.60}"
            raise mesh_fault(name, f"files packed to at least 1/{MOST_RATIO}", got, "Leave that file out.")
        if one.filename.startswith("/") or ".." in one.filename.split("/"):
            raise mesh_fault(name, "names inside the zip", f"{one.filename!a:.60}", "Pack the folder itself.")
        if one.flag_bits & 1 or one.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise mesh_fault(name, "a zip that is only deflated", "encryption or another packing", "Pack it again.")

    def read(one: zipfile.ZipInfo) -> bytes:
        try:
            return archive.read(one)
        except Exception as error:
            raise mesh_fault(
                name, f"a whole {one.filename!a:.60}", f"{type(error).__name__}", "Pack it again."
            ) from error

    return {one.filename: lambda one=one: read(one) for one in members}


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
