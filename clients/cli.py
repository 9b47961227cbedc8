"""``python -m clients.cli health | garments | upload | avatars | drape``: the service from the shell.

python -m clients.cli drape --garment tshirt --motion walk --out out.glb
python -m clients.cli drape --garment trousers tshirt --motion walk --out outfit.glb
python -m clients.cli drape --garment tshirt --motion walk --out walk.usda
python -m clients.cli drape --garment shirt.obj --avatar '{"gender": 1.0}' --motion clip.bvh --out out.npy
python -m clients.cli drape --garment tshirt --on me.vrm --motion walk --out out.glb
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import numpy as np
from pydantic.fields import FieldInfo

from clients.calls import DEFAULT_URL, name_sizes
from clients.client import DrapeClient
from clients.mesh_files import surface_of
from drape.errors import DrapeError, InputError, while_read, with_numbers_bound
from drape.export.clips import CACHES, SCENES, check_name, npy_head, write_pieces, write_scene
from drape.export.glb import GARMENT_COLOURS
from drape.export.mdd import mdd_frames, mdd_head
from drape.export.obj import obj_text
from drape.export.pc2 import pc2_head, pc2_samples
from drape.export.surface import MovingGarment
from drape.files.formats import MESH_SUFFIXES
from drape.motion.clip import MotionClip
from drape.motion.readers import MOTION_SUFFIXES, read_motion
from drape.wire.options import Advanced, DrapeOptions


@while_read
def main(arguments: list[str] | None = None) -> int:
    options = _parser().parse_args(with_numbers_bound(arguments))
    try:
        with DrapeClient(options.url, key=options.key) as client:
            options.run(client, options)
    except DrapeError as error:
        print(f"drape: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m clients.cli", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--url", default=os.environ.get("DRAPE_URL", DEFAULT_URL), help="the service (DRAPE_URL)")
    parser.set_defaults(key=os.environ.get("DRAPE_KEY"))  # not a flag, which every process of the machine could read
    commands = parser.add_subparsers(required=True, metavar="command")
    # The address may also follow the command.
    shared = argparse.ArgumentParser(add_help=False)
    shared.add_argument("--url", default=argparse.SUPPRESS, help="the service (DRAPE_URL)")

    health = commands.add_parser("health", parents=[shared], help="what the service runs with")
    health.set_defaults(run=_health)

    garments = commands.add_parser("garments", parents=[shared], help="the garments that can be draped")
    garments.set_defaults(run=_garments)

    upload = commands.add_parser("upload", parents=[shared], help="take a garment file in")
    upload.add_argument("file", type=Path)
    upload.add_argument("--avatar", help="the body it was modelled on: JSON, or a name of avatars.json")
    upload.add_argument("--name", help="name of the garment; the file's by default")
    upload.set_defaults(run=_upload)

    avatars = commands.add_parser("avatars", parents=[shared], help="characters that wear garments: list, add, remove")
    avatars.add_argument("--add", type=Path, metavar="FILE", help="take a character in, GLB or VRM")
    avatars.add_argument("--alive", action="store_true", help="with --add: make garments of its own clothes")
    avatars.add_argument("--remove", metavar="ID", help="remove one")
    avatars.set_defaults(run=_avatars)

    drape = commands.add_parser("drape", parents=[shared], help="drape a garment over a clip")
    drape.add_argument(
        "--garment",
        nargs="+",
        default=[],
        help="a garment's id, or a file to take in first; several are worn over each other, the innermost first",
    )
    drape.add_argument("--avatar", help="for a file: the body it was modelled on")
    drape.add_argument("--motion", required=True, help="a sample clip's name, or a file: npz, BVH, GLB, VRMA or FBX")
    drape.add_argument("--clip", metavar="NAME", help="of a file with several animations: which (the longest)")
    drape.add_argument(
        "--out",
        required=True,
        type=Path,
        help="out.glb (animated), out.npy (vertices [m], layer after layer),\n"
        "out.pc2 or out.mdd (point caches, and out.obj with their mesh), out.usda, .usdc or .usdz (scenes),\n"
        "out_vat.exr (vertex animation texture, and out.glb and out-remap_info.json)",
    )
    drape.add_argument("--as-recorded", action="store_true", help="for a file: leave its translations as they are")
    drape.add_argument("--fps", type=float, default=30.0, help="frames per second of the result (30)")
    drape.add_argument("--on", metavar="AVATAR", help="the character that wears it: an id, or a GLB or VRM file")
    drape.add_argument("--alive", action="store_true", help="with --on: in its own clothes too, to .glb or .npy")
    drape.add_argument("--size", nargs="+", metavar="SIZE", help="S, M, L or XL: for all, or by layer")
    drape.add_argument("--betas", help="body shape, comma-separated")
    drape.add_argument("--body", action="store_true", help="include the body in the GLB")
    drape.add_argument("--rig", action="store_true", help="with --on: the GLB on the character's own skeleton")
    drape.add_argument("--joints", type=int, metavar="N", help="with --rig: N joints a garment, and no morph targets")
    drape.add_argument("--job", metavar="ID", help="with --tier exact: the job that was begun before with the same")
    drape.add_argument("--float32", action="store_true", help="the GLB in float32, twice as large")
    for name, field in _options().items():
        flag = "--" + name.replace("_", "-")
        kind, *others = [kind for kind in get_args(field.annotation) if kind is not type(None)] or [None]
        words = argparse.SUPPRESS if name in Advanced.model_fields else field.description  # those are old names
        if name == "hidden":
            drape.add_argument(flag, nargs="+", metavar="NAME", help=field.description)
        elif name == "fabric":
            drape.add_argument(flag, nargs="+", metavar="NAME", help="what it is made of: for all, or by layer")
        elif name == "colliders":
            drape.add_argument(flag, type=_read_json, metavar="FILE", help="a JSON list of what else cloth lies on")
        elif name == "advanced":
            drape.add_argument(flag, nargs="+", type=_named_value, metavar="NAME=VALUE", help=_advanced_help())
        elif isinstance(kind, str):
            drape.add_argument(flag, choices=(kind, *others), help=words)
        elif get_origin(kind) is Literal:
            drape.add_argument(flag, choices=sum((get_args(each) for each in (kind, *others)), ()), help=words)
        elif kind is bool:
            drape.add_argument(flag, action=argparse.BooleanOptionalAction, help=words)
        else:
            drape.add_argument(flag, type=kind, help=words)
    drape.set_defaults(run=_drape)
    return parser


def _read_json(path: str) -> Any:
    """The contents of a JSON file; argparse tells of a ``ValueError``, and of an ``ArgumentTypeError`` by its words."""
    try:
        return json.loads(Path(path).read_bytes())
    except OSError as error:
        raise argparse.ArgumentTypeError(f"cannot read {path}: {error.strerror}") from error


def _options() -> dict[str, FieldInfo]:
    """The options of a drape that are flags: all but what comes, which the name of the file says."""
    fields = DrapeOptions.model_fields | Advanced.model_fields
    return {name: field for name, field in fields.items() if name != "geometry"}


def _advanced_help() -> str:
    told = (f"{name}: {field.description}" for name, field in Advanced.model_fields.items())
    return f"{DrapeOptions.model_fields['advanced'].description} {' '.join(told)}"


def _named_value(text: str) -> tuple[str, Any]:
    """The name and the value of ``NAME=VALUE``; the value is JSON, or else the text."""
    name, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"expected NAME=VALUE, as folds=3, got {text}")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def _health(client: DrapeClient, options: argparse.Namespace) -> None:
    print(json.dumps(client.health(), indent=1))


def _garments(client: DrapeClient, options: argparse.Namespace) -> None:
    for garment in client.garments():
        print(
            f"{garment['id']:<28} {garment['vertices']:>7} vertices {garment['patches']:>5} patches {garment['source']}"
        )


def _upload(client: DrapeClient, options: argparse.Namespace) -> None:
    print(client.upload_garment(options.file, options.avatar, name=options.name, progress=_progress()))


def _avatars(client: DrapeClient, options: argparse.Namespace) -> None:
    if options.add is not None:
        print(client.upload_avatar(options.add, alive=options.alive, progress=_progress()))
    elif options.remove is not None:
        client.remove_avatar(options.remove)
    else:
        for avatar in client.avatars():
            fit, kind = avatar["fit"]["median_mm"], f"VRM {avatar['vrm']}" if avatar["vrm"] else "GLB"
            print(f"{avatar['id']:<28} {avatar['height_m']:.2f} m, fits to {fit:.1f} mm, {kind}")


def _frame_lines() -> Callable[[dict[str, Any]], None]:
    """A function that writes a job's id on standard error, and a line for each new frame. Ctrl-C leaves the job as it
    is."""
    seen: set[int] = set()
    named = False

    def tell(job: dict[str, Any]) -> None:
        nonlocal named
        if not named:  # at once, since whoever breaks off before the first frame needs it to go on
            print(f"job {job['id']}: {job['frames']} frames", file=sys.stderr)
            named = True
        for frame in job["told"]:
            if frame["frame"] not in seen:
                seen.add(frame["frame"])
                line = f"job {job['id']}: frame {frame['frame']}, {len(seen)} of {job['frames']}: force left"
                line += (
                    f" {100 * frame['force_share']:.2f} % of the weight, {1e3 * frame['depth_m']:.1f} mm in the skin"
                )
                print(f"{line}, {frame['energy_j']:.4f} J, {frame['crossings']} crossings", file=sys.stderr)

    return tell


def _progress() -> Callable[[dict[str, Any]], None]:
    """A function that writes the state of an upload on standard error, whenever it changes, and its notes at its end.
    Ctrl-C cancels the upload."""
    shown = ""

    def tell(job: dict[str, Any]) -> None:
        nonlocal shown
        line = f"{job['name']}: {job['stage'] or job['state']}, {100 * job['share']:.0f} %"
        line += "".join(f"\n{job['name']}: {note}" for note in job.get("notes", ()))
        if line != shown:
            print(line, file=sys.stderr)
            shown = line

    return tell


def _drape(client: DrapeClient, options: argparse.Namespace) -> None:
    # Everything that can be refused here is refused before the service works.
    check_name(options.out)
    suffix = options.out.suffix.lower()
    betas = _numbers(options.betas)
    _check_choices(options, suffix)
    avatar = None if options.on is None else client.avatar(options.on, alive=options.alive).id
    clip = _clip(client, options, betas, avatar).resampled(options.fps)
    choices: dict[str, Any] = {name: getattr(options, name) for name in _options()}
    choices["advanced"] = choices["advanced"] and dict(choices["advanced"])
    choices |= {"avatar": avatar, "alive": options.alive, "size": options.size}
    for name in ("fabric", "size"):  # one is for all layers
        if choices[name] is not None and len(choices[name]) == 1:
            (choices[name],) = choices[name]
    worn: list[str] = []
    for garment in options.garment:
        if Path(garment).suffix.lower() in MESH_SUFFIXES:
            garment = client.upload_garment(garment, options.avatar)
            print(f"taken in as {garment}")
        worn.append(garment)
    if options.tier == "exact":
        if len(worn) > 1:
            raise InputError("--garment", expected="one with tier exact", got=str(len(worn)), cure="Drape one of them.")
        more = {} if options.job is None else {"job": options.job}
        more |= {"body": options.body, "quantised": not options.float32} if suffix == ".glb" else {}
        exact = client.exact(
            worn[0], clip, betas=betas, glb=suffix == ".glb", more=more, progress=_frame_lines(), **choices
        )
    if suffix == ".glb" and options.tier == "exact":
        write_pieces(options.out, [exact])
    elif suffix == ".glb":
        garments = worn[0] if len(worn) == 1 else worn
        more = {"body": options.body, "quantised": not options.float32, "rig": options.rig, "joints": options.joints}
        write_pieces(options.out, [client.drape_glb(garments, clip, betas=betas, **more, **choices)])
    elif suffix in SCENES:
        layers = [exact] if options.tier == "exact" else client.drape_outfit(worn, clip, betas=betas, **choices)
        for beside in write_scene(options.out, _moving(client, worn, layers, choices), clip.fps):
            print(f"{beside}: beside it")
    else:
        frames = client.drape_frames(worn, clip, betas=betas, **choices)
        frames = iter([[exact]]) if options.tier == "exact" else frames
        first = next(frames)
        joined = (np.concatenate(layers, axis=1) for layers in itertools.chain([first], frames))
        head, packed = {
            ".npy": (npy_head, pc2_samples),
            ".pc2": (pc2_head, pc2_samples),
            ".mdd": (partial(mdd_head, fps=clip.fps), mdd_frames),
        }[suffix]
        begun = head(sum(layer.shape[1] for layer in first), clip.frame_count)
        write_pieces(options.out, itertools.chain([begun], (packed(part) for part in joined)))
        if suffix in CACHES:
            meshes = [layer.surface for layer in _moving(client, worn, first, choices)]
            beside = options.out.with_suffix(".obj")
            write_pieces(beside, [obj_text(meshes, [layer[0] for layer in first]).encode()])
            print(f"{beside}: the mesh that the points belong to")
    size = options.out.stat().st_size
    print(f"{options.out}: {clip.frame_count} frames at {clip.fps:g} per second, {size} bytes")


def _check_choices(options: argparse.Namespace, suffix: str) -> None:
    """Refuses (``InputError``) choices of ``options`` that a file of this ``suffix``, or its tier, does not hold."""
    exact = options.tier == "exact"
    if not options.garment and not options.alive:
        raise InputError("--garment", expected="one or more", got="none", cure="Name a garment, or --alive.")
    if options.alive and (suffix not in (".glb", ".npy") or exact):
        cure = "Name its clothes as garments for others: GET /avatars/ID tells them."
        raise InputError("--alive", expected="a .glb or .npy, and no tier exact", got=options.out.name, cure=cure)
    if options.body and suffix != ".glb":
        raise InputError("--body", expected="a .glb", got=options.out.name, cure="Leave it out, or name a .glb.")
    if (options.rig or options.joints is not None) and (suffix != ".glb" or exact):
        cure = "Leave it out, name a .glb, or write other files with drape wear."
        name = "--rig" if options.rig else "--joints"
        raise InputError(name, expected="a .glb, and no tier exact", got=options.out.name, cure=cure)


def _moving(
    client: DrapeClient, worn: Sequence[str], layers: Sequence[np.ndarray], choices: Mapping[str, Any]
) -> list[MovingGarment]:
    """The ``layers`` (F, V, 3) of the garments ``worn`` with their meshes and colours."""
    resolution = choices["resolution"] or "delivered"
    hidden = choices["hidden"] or ()
    shown = [one for one in name_sizes(worn, choices["size"]) if one[0] not in hidden]
    meshes = [surface_of(client.mesh(name, resolution, size)) for name, size in shown]
    colours = itertools.cycle(GARMENT_COLOURS)
    return [MovingGarment(*parts, next(colours)) for parts in zip(meshes, layers, strict=True)]


def _clip(client: DrapeClient, options: argparse.Namespace, betas: np.ndarray | None, avatar: str | None) -> MotionClip:
    motion = options.motion
    if Path(motion).suffix.lower() not in MOTION_SUFFIXES:
        if options.clip is not None:
            cure = "Leave it out, or name a file as --motion."
            raise InputError("--clip", expected="none with a sample clip", got=options.clip, cure=cure)
        return client.motion(motion, betas, avatar)
    if not Path(motion).is_file():
        cure = "Check the path."
        raise InputError("--motion", expected="a file or a sample clip's name", got=motion, cure=cure)
    clip = read_motion(Path(motion), clip=options.clip)
    return clip if options.as_recorded else client.placed(clip, betas, avatar)


def _numbers(text: str | None) -> np.ndarray | None:
    try:
        return None if text is None else np.array([float(part) for part in text.split(",")])
    except ValueError as error:
        raise InputError(
            "--betas", expected="comma-separated numbers", got=text or "", cure="For example --betas 0.5,-1."
        ) from error


if __name__ == "__main__":
    sys.exit(main())
