"""Folds in the client: the frames of a service's stages, and what the client's code makes of its jets."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.served import Stream
from drape.contact.skin import posed_table
from drape.engine.flat_records import flat_records
from drape.errors import Unavailable
from drape.live.clock import Frame
from drape.live.fold_records import fold_records
from drape.live.fold_step import FoldEffort
from drape.live.swing_constants import swing_constants
from drape.live.swing_step import swing
from drape.live.two_level import one_level, two_level
from drape.motion.clip import MotionClip
from drape.stages.batch import PoseInput
from drape.stages.scene import Entry
from drape.wire.folds import pack_folds
from drape.wire.jets import unpack_jets
from drape.wire.layout import unpack_layout
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime

LIBRARY = Path(__file__).resolve().parents[2] / "clients/web/lib"
SCRIPT = Path(__file__).with_suffix(".mjs")


@dataclass(frozen=True, eq=False)
class Streamed:
    """The messages of a stream, what each took the service [ms], its options, all of them known, and of a stream of
    vertices these [m] (F, V, 3), from the root."""

    messages: list[bytes]
    took_ms: np.ndarray
    options: DrapeOptions
    vertices: np.ndarray


@dataclass(frozen=True, eq=False)
class Decoded:
    """What a client made: ``vertices`` [m] (F, V, 3), what each frame took [ms], and swing and folds of it, and the
    start."""

    vertices: np.ndarray
    frame_ms: np.ndarray
    fold_ms: np.ndarray
    start_ms: float


@dataclass(frozen=True, eq=False)
class Worn:
    """A garment in a clip."""

    runtime: DrapeRuntime
    entry: Entry
    clip: MotionClip

    @classmethod
    def of(cls, runtime: DrapeRuntime, garment: str, motion: str) -> Worn:
        """The shipped ``garment`` on its fine mesh, in its own fabric, on the body of mean shape."""
        entry = next(each for each in runtime.garments.entries() if each.id == garment).fine
        clip = runtime.motions.placed(motion, runtime.body, np.zeros(runtime.body.shape_count))
        return cls(runtime, entry, clip)

    def streamed(self, frames: int, *options: dict[str, Any]) -> list[Streamed]:
        """The first ``frames`` of the clip in streams with ``options``, a frame of each after the other; their time is
        the clip's."""
        shape, streams, batches = np.zeros(self.runtime.body.shape_count), [], []
        for chosen in options:
            asked = DrapeOptions.model_validate({"resolution": "fine"} | chosen)
            plan = self.runtime.plan(self.entry, asked, messages=True)
            self.runtime.add_missing(plan)
            streams.append(Stream(plan, self.runtime.body.shape_count))
        for i in range(frames):
            pose = self.clip.poses[i : i + 1].astype(np.float32).astype(np.float64)  # as on the wire
            one = PoseInput(pose, self.clip.trans[i : i + 1], shape, np.array([i / self.clip.fps]))
            batches.append([stream.frame(one) for stream in streams])
        return [
            Streamed(
                [batch.messages[0] for batch in found],
                np.array(stream.clock.wall_ms),
                stream.plan.options,
                np.stack([batch.vertices[0] for batch in found])
                if stream.plan.options.geometry == "vertices"
                else np.zeros((frames, 0, 3), np.float32),
            )
            for stream, found in zip(streams, zip(*batches, strict=True), strict=True)
        ]

    def message(self, options: DrapeOptions) -> bytes:
        """The FOLDS message of a stream with ``options``, all of them known."""
        shape = np.zeros(self.runtime.body.shape_count)
        made = fold_records(self.entry.garment, self.runtime.body, None, shape, coarse=bool(options.coarse))
        return pack_folds(*flat_records(made))

    def smooth(self, messages: list[bytes]) -> np.ndarray:
        """The vertices [m] (F, V, 3) of JETS ``messages``, without folds."""
        layout = unpack_layout(self.entry.jet_layout)
        return np.stack([layout.positions(unpack_jets(message)) for message in messages])

    def folded(self, network: np.ndarray, options: DrapeOptions) -> np.ndarray:
        """The frames of the service's swing and folds of the vertices ``network`` [m] (F, V, 3)."""
        garment, body, effort, found = self.entry.garment, self.runtime.body, self.effort(options), []
        made = (two_level if options.coarse else one_level)(garment, body)
        swinging, memory, swung = swing_constants(garment, body, None), None, None
        shape, poses = np.zeros(body.shape_count), self.clip.poses[: len(network)]
        skin = posed_table(body, poses.astype(np.float32).astype(np.float64), shape)
        roots = self.clip.trans[: len(network)] + body.rest_joints(shape)[0]
        for number, vertices in enumerate(network):
            frame = Frame(vertices, skin[number].reshape(-1, 8), number / self.clip.fps)
            if swinging is not None and options.inertia == "mesh":
                vertices, swung = swing(swinging, swung, frame, roots[number])
            vertices, memory, _ = made.fold(memory, replace(frame, vertices=vertices), effort)
            found.append(vertices)
        return np.stack(found)

    def effort(self, options: DrapeOptions) -> FoldEffort:
        """The work of a frame under ``options``, all of them known."""
        assert options.folds and options.settle
        clearance_m = self.runtime.settings.clearance_m if options.push_out else 0.0
        return FoldEffort(options.folds, options.settle, bool(options.cloth_contact), clearance_m)


@contextmanager
def client_folder(
    worn: Worn, messages: list[bytes], options: DrapeOptions, network: np.ndarray | None = None
) -> Iterator[Path]:
    """A folder with the library's modules and all that they need to decode ``messages`` of a stream with ``options``,
    or to fold the ``network``'s vertices [m] (F, V, 3) in their place.

    Raises ``Unavailable`` where the library is not built.
    """
    if not (LIBRARY / "dist/folds.js").is_file():
        raise Unavailable("@drape/client", expected="its build", got="none", cure="Run make page.")
    garment, effort = worn.entry.garment, worn.effort(options)
    about = {
        "vertices": garment.vertex_count,
        "message_bytes": len(messages[0]),
        "poses": worn.clip.poses[: len(messages)].reshape(-1, 72).tolist(),
        "fps": worn.clip.fps,
        "exact": network is not None,
        "effort": {
            "folds": effort.steps,
            "safe_folds": options.safe_folds,
            "settle": effort.settle,
            "cloth_contact": effort.cloth_contact,
            "clearance_m": effort.clearance_m,
            "coarse": bool(options.coarse),
            "inertia": options.inertia,
            "motion": options.knob,
        },
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for source in (*(LIBRARY / "src").glob("*.js"), LIBRARY / "dist/folds.js", SCRIPT):
            shutil.copy(source, folder)
        (folder / "package.json").write_text('{"type": "module"}')
        (folder / "about.json").write_text(json.dumps(about))
        (folder / "index.html").write_text(f'<!doctype html><script type="module" src="{SCRIPT.name}"></script>')
        (folder / "layout.bin").write_bytes(worn.entry.jet_layout)
        (folder / "constants.bin").write_bytes(worn.message(options))
        if network is not None:
            (folder / "network.bin").write_bytes(network.astype("<f4").tobytes())
        (folder / "messages.bin").write_bytes(b"".join(messages))
        (folder / "faces.bin").write_bytes(garment.faces.astype("<u4").tobytes())
        yield folder


def node_here() -> str:
    """The program of Node.js; raises ``Unavailable`` where there is none."""
    node = shutil.which("node")
    if node is None:
        raise Unavailable("node", expected="Node.js 18 or newer", got="none", cure="sudo apt-get install nodejs")
    return node


def in_node(folder: Path) -> Decoded:
    """What Node.js decodes; raises ``Unavailable`` where there is none."""
    run = subprocess.run([node_here(), str(folder / SCRIPT.name)], capture_output=True, text=True, timeout=300)
    if run.returncode:
        raise RuntimeError(run.stderr)
    return _decoded(folder, json.loads(run.stdout))


def in_browser(folder: Path, browser: str) -> Decoded:
    """What the program ``browser``, a Chromium, decodes on a page without a window."""
    return _decoded(folder, said_in_browser(folder, browser))


def said_in_browser(folder: Path, browser: str, *, page: str = "", wait_s: float = 300.0) -> dict[str, Any]:
    """What the ``page`` of ``folder`` says at its end: said.json, after other files that it sends.

    Raises ``RuntimeError`` where it has not said anything after ``wait_s``.
    """
    ended = threading.Event()

    class Served(SimpleHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            (folder / Path(self.path).name).write_bytes(body)
            self.send_response(204)
            self.end_headers()
            if self.path == "/said.json":
                ended.set()

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Served, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        address = f"http://127.0.0.1:{server.server_address[1]}/{page}"
        usual = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run", "--disable-gpu"]
        process = subprocess.Popen(
            [browser, *usual, f"--user-data-dir={profile}", address],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            if not ended.wait(wait_s):
                raise RuntimeError("the page said nothing")
        finally:
            process.terminate()
            process.wait(timeout=20.0)
            server.shutdown()
            server.server_close()
    return json.loads((folder / "said.json").read_text())


def _decoded(folder: Path, said: dict[str, Any]) -> Decoded:
    took = np.array(said["took"])
    vertices = np.frombuffer((folder / "vertices.bin").read_bytes(), "<f4").reshape(len(took), -1, 3)
    return Decoded(vertices, took[:, 0], took[:, 1], float(said["start_ms"]))


def rms_mm(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """RMS distance [mm] (F,) of the vertices ``a`` [m] (F, V, 3) from ``b``."""
    return 1e3 * np.sqrt(np.square(a.astype(np.float64) - b).sum(axis=2).mean(axis=1))
