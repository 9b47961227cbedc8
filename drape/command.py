"""``drape``: drapes garments on moving bodies from a shell, and runs the other parts of the product."""

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
from drape.errors import InputError, Unavailable, refusing
from drape.garment.size_chart import SIZES
from drape.wire.options import TierName

if TYPE_CHECKING:
    from drape.library import Worn
    from drape.motion.clip import MotionClip

# Commands of other rooms, by the module whose ``main`` runs them and what comes before their arguments.
ELSEWHERE: dict[str, tuple[str, tuple[str, ...], str]] = {
    "serve": ("service.__main__", (), "run the service: REST, streams and the page"),
    "recover": ("recovery.run.__main__", (), "recover the sewing pattern of a scan"),
    "draft": ("recovery.pattern.__main__", ("draft",), "draft a base pattern for a body"),
    "train": ("training.run", (), "train the draping network"),
}

SHELLS = ("bash", "zsh", "tcsh")
BAR_WIDTH = 30


class _Mixed(argparse.ArgumentParser):
    """A parser whose arguments may stand anywhere between its options, also a list of them that may be empty."""

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
    """The parser of all commands. ``complete`` is how a shell completes arguments that are files, in words of shtab."""
    whole = argparse.ArgumentParser(prog="drape", description=__doc__.partition(": ")[2] if __doc__ else None)
    whole.add_argument("--version", action="version", version=f"drape {__version__}")
    commands = whole.add_subparsers(metavar="command", parser_class=_Mixed)

    wear = commands.add_parser("wear", help="drape garments over a motion and write a file")
    paths = [
        wear.add_argument("garment", nargs="*", help="the names or files of the garments, the innermost first"),
        wear.add_argument("motion", help="the name of a shipped clip, or a file: npz, BVH, GLB, VRMA or FBX"),
        wear.add_argument(
            "--out",
            type=Path,
            required=True,
            help="the file to write: .glb, .usdz, .usdc, .usda, NAME_vat.exr, .pc2, .mdd or .npy",
        ),
        wear.add_argument(
            "--on", type=Path, metavar="FILE", help="the GLB or VRM file of a character that wears the garments"
        ),
    ]
    wear.add_argument(
        "--modelled-on", metavar="JSON", help="of garments that are mesh files: the body that they were modelled on"
    )
    wear.add_argument("--betas", type=_numbers, help="the body's shape coefficients, separated by commas")
    wear.add_argument("--fps", type=float, default=30.0, help="frames a second of the file (30)")
    wear.add_argument("--as-recorded", action="store_true", help="leave the motion's translations as they are")
    wear.add_argument("--tier", choices=get_args(TierName), help="the tier: how much is computed (balanced)")
    wear.add_argument("--size", choices=SIZES, help="the size of the garments (M)")
    wear.add_argument("--fabric", help="the fabric of the garments (each garment's own)")
    wear.add_argument(
        "--alive", action="store_true", help="with --on: drape the clothes that the character came in, too"
    )
    wear.add_argument(
        "--rig", action="store_true",
        help="with --on: write the character's own file in the garments, exactly as they are draped: .glb; or its "
        "surface and theirs: .usdz, .usdc, .usda, NAME_vat.exr",
    )  # fmt: skip
    wear.add_argument(
        "--joints", type=int, metavar="N",
        help="with --on: write the character's own file in the garments, which hang on N joints each besides its own: "
        ".glb over the motion, .vrm with spring bones",
    )  # fmt: skip
    wear.add_argument("--float32", action="store_true", help="write a GLB in float32, twice as large")
    wear.set_defaults(run=_wear)

    garments = commands.add_parser("garments", help="list the shipped garments")
    garments.set_defaults(run=_garments)
    avatars = commands.add_parser("avatars", help="say how well the body fits the characters in GLB or VRM files")
    paths.append(avatars.add_argument("file", nargs="+", type=Path, help="the files of characters"))
    avatars.set_defaults(run=_avatars)
    tiers = commands.add_parser("tiers", help="list the tiers with their measured figures")
    tiers.set_defaults(run=_tiers)
    doctor = commands.add_parser("doctor", help="say what is installed and where, and test it")
    doctor.set_defaults(run=_doctor)
    for path in paths:
        path.complete = complete  # pyright: ignore[reportAttributeAccessIssue]
    completion = commands.add_parser("completion", help="print the completion of this command for a shell")
    completion.add_argument("shell", choices=SHELLS)
    completion.set_defaults(run=_completion)
    for one in (wear, garments, avatars, tiers, doctor):
        one.add_argument("--json", action="store_true", help="print the answer as JSON")
    for name, (_, _, said) in ELSEWHERE.items():
        commands.add_parser(name, help=said, add_help=False)
    return whole


@refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line. Returns 0 when it is done, 1 when ``doctor`` found something wrong, and 2 for a refusal."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words and words[0] in ELSEWHERE:
        return _elsewhere(words[0], words[1:])
    given = parser().parse_args(words)
    if not hasattr(given, "run"):
        parser().print_help()
        return 0
    try:
        return given.run(given)
    except KeyboardInterrupt:
        return 130


def _elsewhere(name: str, words: Sequence[str]) -> int:
    """Runs a command of ``ELSEWHERE`` with its ``words``."""
    module, before, expected = ELSEWHERE[name]
    try:
        run: Callable[..., int | None] = importlib.import_module(module).main
    except ModuleNotFoundError as error:
        cure = "README.md says which part to install."
        raise Unavailable(f"drape {name}", expected=expected, got=f"no package {error.name}", cure=cure) from error
    sys.argv = [f"drape {name}", *before, *words]
    return run() or 0


def _wear(given: argparse.Namespace) -> int:
    from drape.export.clips import SCENES, SUFFIXES, check_name
    from drape.library import load

    check_name(
        given.out, (".glb", ".vrm") if given.joints is not None else (".glb", *SCENES) if given.rig else SUFFIXES
    )
    for name, asked in (("--joints", given.joints is not None), ("--rig", given.rig), ("--alive", given.alive)):
        if asked and given.on is None:
            cure = "Name the file of a character: --on me.vrm."
            raise InputError(name, expected="a character, which has a rig", got="the standard body", cure=cure)
    opened = load()
    garments: list[Any] = list(given.garment)
    if given.modelled_on is not None:
        from drape.garment.intake import intake_outfit

        garments = [
            made
            for one in garments
            for made in (
                intake_outfit(Path(one), avatar=given.modelled_on, body=opened.body) if Path(one).is_file() else [one]
            )
        ]
    options = {name: value for name in ("tier", "fabric", "size") if (value := getattr(given, name)) is not None}
    worn = opened.wear(garments, on=given.on, alive=given.alive, betas=given.betas, **options)
    for note in dict.fromkeys(f"{one.name}: {note}" for one in worn.layers for note in one.warnings):
        print(note, file=sys.stderr)
    clip = worn.placed(given.motion, fps=given.fps, as_recorded=given.as_recorded)
    if given.joints is not None:
        return _wear_on_joints(worn, clip, given)
    return _wear_on_rig(worn, clip, given) if given.rig else _wear_frames(worn, clip, given)


def _wear_frames(worn: Worn, clip: MotionClip, given: argparse.Namespace) -> int:
    """Writes the garments that are ``worn`` over ``clip``."""
    from drape.export.clips import write_clip
    from drape.export.root_motion import RootMotion

    begun_s, frames = time.monotonic(), []
    for frame in worn.play(clip, fps=clip.fps, as_recorded=True):
        frames.append(frame.vertices)
        _progress(len(frames), clip.frame_count, begun_s)
    vertices = np.stack(frames)
    moved = None if given.float32 else RootMotion(clip.poses[:, 0], clip.trans + worn.body.rest_joints()[0])
    beside = write_clip(given.out, worn.garments, vertices, clip.fps, moved)
    summary = {
        "file": str(given.out),
        "bytes": given.out.stat().st_size,
        "frames": len(frames),
        "fps": clip.fps,
        "vertices": int(vertices.shape[1]),
        "tier": worn.tier,
        "beside": [str(one) for one in beside],
        "seconds": round(time.monotonic() - begun_s, 2),
    }
    line = "{file}: {frames} frames at {fps:g} a second, {vertices} vertices, {bytes} bytes".format(**summary)
    return _tell(summary, given, line)


def _wear_on_rig(worn: Worn, clip: MotionClip, given: argparse.Namespace) -> int:
    """Writes the character in the garments that are ``worn``, as they are draped."""
    from drape.export.clips import SCENES, write_pieces, write_scene
    from drape.scenes import scene

    begun_s, beside = time.monotonic(), list[Path]()
    if given.out.suffix.lower() in SCENES:
        beside = write_scene(given.out, scene(worn, clip, fps=clip.fps, as_recorded=True), clip.fps)
    else:
        write_pieces(given.out, [worn.glb(clip, fps=clip.fps, as_recorded=True)])
    size = given.out.stat().st_size
    told = {"file": str(given.out), "bytes": size, "frames": clip.frame_count, "beside": list(map(str, beside))}
    told |= {"garments": [one.name for one in worn.garments], "seconds": round(time.monotonic() - begun_s, 2)}
    names = ", ".join(told["garments"])
    return _tell(told, given, f"{given.out}: {names} over {clip.frame_count} frames, {size} bytes")


def _wear_on_joints(worn: Worn, clip: MotionClip, given: argparse.Namespace) -> int:
    """Writes the character in the garments that are ``worn``, on joints."""
    from drape.catalog import MOTIONS_DIR
    from drape.distilling import distil
    from drape.export.clips import write_pieces

    begun_s, as_vrm = time.monotonic(), given.out.suffix.lower() == ".vrm"
    if as_vrm and worn.wearer is not None and not worn.wearer.vrm:
        raise InputError("--out", expected="a .glb, as the character is one", got=given.out.name, cure="Rename it.")
    jointed = distil(worn, [*sorted(MOTIONS_DIR.glob("*.npz")), clip], joints=given.joints)
    content = jointed.vrm() if as_vrm else jointed.glb(clip, fps=clip.fps)
    write_pieces(given.out, [content])
    summary = {"file": str(given.out), "bytes": len(content), "joints": given.joints, "frames": clip.frame_count}
    errors = jointed.errors_mm(clip, fps=clip.fps)
    summary["garments"] = [
        {"name": surface.name} | {name: round(value, 1) for name, value in one.items()}
        for surface, one in zip(worn.garments, errors, strict=True)
    ]
    summary["seconds"] = round(time.monotonic() - begun_s, 2)
    lines = ["{file}: {joints} joints a garment, {bytes} bytes".format(**summary)]
    for one in summary["garments"]:
        line = "{name}: from its drape {tracks} mm with tracks, {springs} mm on springs, {carried} mm without either"
        lines.append(line.format(**one))
    return _tell(summary, given, "\n".join(lines))


def _garments(given: argparse.Namespace) -> int:
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
    return _table(rows, given)


def _avatars(given: argparse.Namespace) -> int:
    from drape.avatar.wearer import read_wearer, wearer_name

    rows = []
    for path in given.file:
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
    return _table(rows, given)


def _tiers(given: argparse.Namespace) -> int:
    from drape.artifacts import load_manifest
    from drape.folders import ASSETS
    from drape.library import MODEL
    from drape.stages.tiers import read_tiers

    rows = [
        {"tier": tier.name, "passes": tier.passes, "folds": tier.folds, "coarse": tier.coarse} | dict(tier.figures)
        for tier in read_tiers(load_manifest(ASSETS / "models" / MODEL).tiers)
    ]
    return _table(rows, given)


def _doctor(given: argparse.Namespace) -> int:
    from drape.doctor import findings

    told, wrong = findings()
    lines = [f"{name}: {value}" for name, value in told.items()] + [f"wrong: {one}" for one in wrong]
    _tell(told | {"wrong": wrong}, given, "\n".join(lines))
    return 1 if wrong else 0


def _completion(given: argparse.Namespace) -> int:
    import shtab

    print(shtab.complete(parser(shtab.FILE), given.shell))
    return 0


def _table(rows: Sequence[dict[str, Any]], given: argparse.Namespace) -> int:
    """Prints ``rows`` in columns, or as JSON."""
    names = [name for name in rows[0] if not isinstance(rows[0][name], (dict, list))] if rows else []
    texts = [names, *([str(row[name]) for name in names] for row in rows)]
    widths = [max(len(text[i]) for text in texts) for i in range(len(names))]
    lines = ["  ".join(word.ljust(width) for word, width in zip(text, widths, strict=True)).rstrip() for text in texts]
    return _tell(list(rows), given, "\n".join(lines))


def _tell(told: Any, given: argparse.Namespace, text: str) -> int:
    print(json.dumps(told) if given.json else text)
    return 0


def _progress(done: int, whole: int, begun_s: float) -> None:
    """A bar on a terminal, with the seconds that are left."""
    if sys.stderr.isatty():
        filled = BAR_WIDTH * done // whole
        left_s = (time.monotonic() - begun_s) * (whole - done) / done
        bar = "#" * filled + "-" * (BAR_WIDTH - filled)
        end = "\n" if done == whole else ""
        print(f"\r[{bar}] {done} of {whole} frames, {left_s:.0f} s left ", end=end, file=sys.stderr, flush=True)


def _numbers(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]
