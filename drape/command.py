"""The command ``drape``: drapes garments on moving bodies, and runs the other parts of the product."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from drape import __version__
from drape.errors import InputError, Unavailable, refusing, with_numbers_bound
from drape.garment.size_chart import SIZES
from drape.wire.options import TierName

if TYPE_CHECKING:
    from drape.library import Worn
    from drape.motion.clip import MotionClip

# Commands of other packages: the module whose ``main`` runs each, the words before its arguments, and its help.
ELSEWHERE: dict[str, tuple[str, tuple[str, ...], str]] = {
    "serve": ("service.__main__", (), "run the service: REST, streams and the page"),
    "recover": ("recovery.run.__main__", (), "recover the sewing pattern of a garment from a scan"),
    "draft": ("recovery.pattern.__main__", ("draft",), "draft a base pattern for a body"),
    "train": ("training.run", (), "train the network that drapes"),
}

SHELLS = ("bash", "zsh", "tcsh")
BAR_WIDTH = 30


class _Mixed(argparse.ArgumentParser):
    """A parser whose positional arguments, even a list that may be empty, can stand anywhere between its options."""

    _inside = False

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self._inside:
            return super().parse_known_args(args, namespace)
        self._inside = True
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._inside = False


def parser(complete: object = None) -> argparse.ArgumentParser:
    """Returns the parser of all commands. ``complete`` is what shtab takes to complete names of files, None for
    none."""
    description = "Drapes garments on moving bodies, and runs the other parts of the product."
    whole = argparse.ArgumentParser(prog="drape", description=description)
    whole.add_argument("--version", action="version", version=f"drape {__version__}")
    commands = whole.add_subparsers(metavar="command", parser_class=_Mixed)

    wear = commands.add_parser("wear", help="drape garments on a moving body and write a file")
    paths = [
        wear.add_argument("garment", nargs="*", help="the names or files of the garments, the innermost first"),
        wear.add_argument("motion", help="the name of a shipped clip, or a motion file: npz, BVH, GLB, VRMA or FBX"),
        wear.add_argument(
            "--out",
            type=Path,
            required=True,
            help="the file to write, in the format of its name: .glb, .usdz, .usdc, .usda, NAME_vat.exr, .pc2, .mdd or "
            ".npy",
        ),
        wear.add_argument(
            "--on", type=Path, metavar="FILE", help="the GLB or VRM file of a character that wears the garments"
        ),
    ]
    wear.add_argument(
        "--modelled-on",
        metavar="JSON",
        help="the body on which garments that are mesh files were modelled: a phenotype or SMPL parameters as JSON "
        "(default: found from the cloth)",
    )
    wear.add_argument(
        "--betas", type=_numbers, help="the body's shape coefficients, separated by commas (default: zeros)"
    )
    wear.add_argument("--fps", type=float, default=30.0, help="the frames per second of the file (default: 30)")
    wear.add_argument(
        "--as-recorded",
        action="store_true",
        help="keep the motion's translations, and do not put its feet on the ground",
    )
    wear.add_argument("--tier", choices=get_args(TierName), help="how much is computed (default: balanced)")
    wear.add_argument("--size", choices=SIZES, help="the size of the garments (default: M)")
    wear.add_argument("--fabric", help="the name of the fabric of all garments (default: each garment's own)")
    wear.add_argument("--alive", action="store_true", help="with --on: drape the character's own clothes, too")
    wear.add_argument(
        "--rig", action="store_true",
        help="with --on: write the character wearing the garments exactly as they are draped: as .glb on its own rig, "
        "or without a rig as .usdz, .usdc, .usda or NAME_vat.exr",
    )  # fmt: skip
    wear.add_argument(
        "--joints", type=int, metavar="N",
        help="with --on: write the character's own file with the garments skinned to N more joints each, which follow "
        "the drape closely: .glb with the motion, or .vrm with spring bones",
    )  # fmt: skip
    wear.add_argument("--float32", action="store_true", help="write a GLB in float32, which makes it larger")
    wear.set_defaults(run=_wear)

    garments = commands.add_parser("garments", help="list the shipped garments")
    garments.set_defaults(run=_garments)
    avatars = commands.add_parser("avatars", help="say how well the body fits characters in GLB or VRM files")
    paths.append(avatars.add_argument("file", nargs="+", type=Path, help="the GLB or VRM files of the characters"))
    avatars.set_defaults(run=_avatars)
    tiers = commands.add_parser("tiers", help="list the tiers with their measured figures")
    tiers.set_defaults(run=_tiers)
    doctor = commands.add_parser("doctor", help="say what is installed and where, and test it")
    doctor.set_defaults(run=_doctor)
    for path in paths:
        path.complete = complete  # pyright: ignore[reportAttributeAccessIssue]
    completion = commands.add_parser("completion", help="print the script by which a shell completes this command")
    completion.add_argument("shell", choices=SHELLS, help="the shell")
    completion.set_defaults(run=_completion)
    for command in (wear, garments, avatars, tiers, doctor):
        command.add_argument("--json", action="store_true", help="print the answer as JSON")
    for name, (_, _, summary) in ELSEWHERE.items():
        commands.add_parser(name, help=summary, add_help=False)
    return whole


@refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line ``arguments``, that of the process by default. Returns the exit status: 0, 1 where
    ``doctor`` finds something wrong, 2 after a refusal, 130 after Ctrl-C."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words and words[0] in ELSEWHERE:
        return _run_elsewhere(words[0], words[1:])
    options = parser().parse_args(with_numbers_bound(words))
    if not hasattr(options, "run"):
        parser().print_help()
        return 0
    try:
        return options.run(options)
    except KeyboardInterrupt:
        return 130


def _run_elsewhere(name: str, words: Sequence[str]) -> int:
    """Runs the command ``name`` of ``ELSEWHERE`` with the arguments ``words``. Returns its exit status."""
    module, before, summary = ELSEWHERE[name]
    try:
        run: Callable[..., int | None] = importlib.import_module(module).main
    except ModuleNotFoundError as error:
        cure = "docs/guide/install.md says which wheel has it."
        expected = f"the package that can {summary}"
        raise Unavailable(f"drape {name}", expected=expected, got=f"no package {error.name}", cure=cure) from error
    sys.argv = [f"drape {name}", *before, *words]
    return run() or 0


def _wear(options: argparse.Namespace) -> int:
    from drape.export.clips import SCENES, SUFFIXES, check_name
    from drape.library import load

    check_name(
        options.out, (".glb", ".vrm") if options.joints is not None else (".glb", *SCENES) if options.rig else SUFFIXES
    )
    for name, asked in (("--joints", options.joints is not None), ("--rig", options.rig), ("--alive", options.alive)):
        if asked and options.on is None:
            cure = "Name the file of a character: --on me.vrm."
            raise InputError(name, expected="a character, which has a rig", got="the standard body", cure=cure)
    opened = load()
    garments: list[Any] = []
    for name in options.garment:
        if options.modelled_on is not None and Path(name).is_file():
            from drape.garment.intake import intake_outfit

            garments += intake_outfit(Path(name), avatar=options.modelled_on, body=opened.body)
        else:
            garments.append(name)
    chosen = {name: value for name in ("tier", "fabric", "size") if (value := getattr(options, name)) is not None}
    worn = opened.wear(garments, on=options.on, alive=options.alive, betas=options.betas, **chosen)
    for note in dict.fromkeys(f"{layer.name}: {note}" for layer in worn.layers for note in layer.warnings):
        print(note, file=sys.stderr)
    clip = worn.placed(options.motion, fps=options.fps, as_recorded=options.as_recorded)
    if options.joints is not None:
        return _wear_on_joints(worn, clip, options)
    return _wear_on_rig(worn, clip, options) if options.rig else _wear_frames(worn, clip, options)


def _wear_frames(worn: Worn, clip: MotionClip, options: argparse.Namespace) -> int:
    """Drapes the garments that are ``worn`` in each frame of ``clip`` and writes them. Returns the exit status."""
    from drape.export.clips import write_clip
    from drape.export.root_motion import RootMotion

    begun_s, frames = time.monotonic(), []
    for frame in worn.play(clip, fps=clip.fps, as_recorded=True):
        frames.append(frame.vertices)
        _progress(len(frames), clip.frame_count, begun_s)
    vertices = np.stack(frames)
    moved = None if options.float32 else RootMotion(clip.poses[:, 0], clip.trans + worn.body.rest_joints()[0])
    beside = write_clip(options.out, worn.garments, vertices, clip.fps, moved)
    summary = {
        "file": str(options.out),
        "bytes": options.out.stat().st_size,
        "frames": len(frames),
        "fps": clip.fps,
        "vertices": int(vertices.shape[1]),
        "tier": worn.tier,
        "beside": [str(path) for path in beside],
        "seconds": round(time.monotonic() - begun_s, 2),
    }
    line = "{file}: {frames} frames at {fps:g} a second, {vertices} vertices, {bytes} bytes".format(**summary)
    return _tell(summary, options, line)


def _wear_on_rig(worn: Worn, clip: MotionClip, options: argparse.Namespace) -> int:
    """Writes the character with the garments that are ``worn``, as they are draped. Returns the exit status."""
    from drape.export.clips import SCENES, write_pieces, write_scene
    from drape.scenes import scene

    begun_s, beside = time.monotonic(), list[Path]()
    if options.out.suffix.lower() in SCENES:
        beside = write_scene(options.out, scene(worn, clip, fps=clip.fps, as_recorded=True), clip.fps)
    else:
        made = worn.glb(clip, fps=clip.fps, as_recorded=True, quantised=not options.float32)
        write_pieces(options.out, [made])
    size = options.out.stat().st_size
    summary = {"file": str(options.out), "bytes": size, "frames": clip.frame_count, "beside": list(map(str, beside))}
    summary |= {"garments": [mesh.name for mesh in worn.garments], "seconds": round(time.monotonic() - begun_s, 2)}
    names = ", ".join(summary["garments"])
    return _tell(summary, options, f"{options.out}: {names} over {clip.frame_count} frames, {size} bytes")


def _wear_on_joints(worn: Worn, clip: MotionClip, options: argparse.Namespace) -> int:
    """Writes the character with the garments that are ``worn`` on more joints. Returns the exit status."""
    from drape.catalog import MOTIONS_DIR
    from drape.distilling import distil
    from drape.export.clips import write_pieces

    begun_s, as_vrm = time.monotonic(), options.out.suffix.lower() == ".vrm"
    if as_vrm and worn.wearer is not None and not worn.wearer.vrm:
        raise InputError("--out", expected="a .glb, as the character is one", got=options.out.name, cure="Rename it.")
    jointed = distil(worn, [*sorted(MOTIONS_DIR.glob("*.npz")), clip], joints=options.joints)
    content = jointed.vrm() if as_vrm else jointed.glb(clip, fps=clip.fps)
    write_pieces(options.out, [content])
    summary = {"file": str(options.out), "bytes": len(content), "joints": options.joints, "frames": clip.frame_count}
    errors = jointed.errors_mm(clip, fps=clip.fps)
    summary["garments"] = [
        {"name": surface.name} | {name: round(value, 1) for name, value in distances.items()}
        for surface, distances in zip(worn.garments, errors, strict=True)
    ]
    summary["seconds"] = round(time.monotonic() - begun_s, 2)
    lines = ["{file}: {joints} joints a garment, {bytes} bytes".format(**summary)]
    line = "{name}: from its drape {tracks} mm with tracks, {springs} mm on springs, {carried} mm without either"
    lines += [line.format(**garment) for garment in summary["garments"]]
    return _tell(summary, options, "\n".join(lines))


def _garments(options: argparse.Namespace) -> int:
    from drape.catalog import find_garments, short_name
    from drape.garment.cache import load_garment

    rows = []
    for path in find_garments([]):
        garment = load_garment(path)
        name = short_name(path)
        rows.append(
            {
                "name": name,
                "vertices": garment.surface.vertex_count,
                "patches": garment.patch_count,
                "fabric": garment.fabric,
            }
        )
    return _table(rows, options)


def _avatars(options: argparse.Namespace) -> int:
    from drape.avatar.wearer import read_wearer, wearer_name

    rows = []
    for path in options.file:
        if not path.is_file():
            raise InputError(str(path), expected="a GLB or VRM file", got="no file", cure="Check the path.")
        wearer = read_wearer(path.read_bytes(), name=wearer_name(path.stem))
        rows.append(
            {
                "name": wearer.name,
                "kind": f"VRM {wearer.vrm}" if wearer.vrm else "GLB",
                "height_m": round(wearer.height_m, 3),
                "fit_mm": round(wearer.median_mm, 1),
                "joints_by": wearer.found_by,
                "notes": "; ".join(wearer.notes),
            }
        )
    return _table(rows, options)


def _tiers(options: argparse.Namespace) -> int:
    from drape.artifacts import load_manifest
    from drape.folders import ASSETS
    from drape.library import MODEL
    from drape.stages.tiers import read_tiers

    rows = [
        {"tier": tier.name, "passes": tier.passes, "folds": tier.folds, "coarse": tier.coarse} | dict(tier.figures)
        for tier in read_tiers(load_manifest(ASSETS / "models" / MODEL).tiers)
    ]
    return _table(rows, options)


def _doctor(options: argparse.Namespace) -> int:
    from drape.doctor import findings

    facts, wrong = findings()
    lines = [f"{name}: {value}" for name, value in facts.items()] + [f"wrong: {fault}" for fault in wrong]
    _tell(facts | {"wrong": wrong}, options, "\n".join(lines))
    return 1 if wrong else 0


def _completion(options: argparse.Namespace) -> int:
    import shtab

    print(shtab.complete(parser(shtab.FILE), options.shell))
    return 0


def _table(rows: Sequence[dict[str, Any]], options: argparse.Namespace) -> int:
    """Prints ``rows`` in columns, or as JSON. Returns the exit status."""
    names = [name for name in rows[0] if not isinstance(rows[0][name], (dict, list))] if rows else []
    texts = [names, *([str(row[name]) for name in names] for row in rows)]
    widths = [max(len(text[i]) for text in texts) for i in range(len(names))]
    lines = ["  ".join(word.ljust(width) for word, width in zip(text, widths, strict=True)).rstrip() for text in texts]
    return _tell(list(rows), options, "\n".join(lines))


def _tell(answer: Any, options: argparse.Namespace, text: str) -> int:
    """Prints ``answer`` as JSON, or ``text`` without ``--json``. Returns the exit status."""
    print(json.dumps(answer) if options.json else text)
    return 0


def _progress(done: int, whole: int, begun_s: float) -> None:
    """Draws a bar on a terminal for ``done`` of ``whole`` frames, with the seconds that are left."""
    if sys.stderr.isatty():
        filled = BAR_WIDTH * done // whole
        left_s = (time.monotonic() - begun_s) * (whole - done) / done
        bar = "#" * filled + "-" * (BAR_WIDTH - filled)
        end = "\n" if done == whole else ""
        print(f"\r[{bar}] {done} of {whole} frames, {left_s:.0f} s left ", end=end, file=sys.stderr, flush=True)


def _numbers(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]
