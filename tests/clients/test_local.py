"""Without a service: what the client computes by itself, and the folder of ``service.static`` in Chromium."""

from __future__ import annotations

import base64
import json
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.artifacts import DEFAULT_MODEL, MODELS_DIR
from drape.body.model import BodyModel
from drape.body.pose_distance import read_pose_support
from drape.errors import InputError, Unavailable
from drape.graph.packing import pack_body
from drape.wire.messages import Pose, pack_pose
from service.static.site import FolderRequest, folder_sizes
from tests.clients.browser import open_page
from tests.clients.node import answer_of
from tests.clients.test_folds import FIRST, FIRST_MM, MOST_MM, shirt
from tests.fixtures.drapes_of_folders import draped_in, write_static
from tests.fixtures.folds_of_clients import Worn, rms_mm
from tests.fixtures.poses import random_motion

__all__ = ["shirt"]  # a fixture
FRAMES = 12
FOLDER_BYTES, ENGINE_BYTES = 8_000_000, 150_000
PORTS = """
import { quaternionsOf } from "./folding.js";
import { PoseSupport } from "./pose_support.js";
const support = new PoseSupport(Uint8Array.from(Buffer.from(input.kept, "hex")).buffer, input.support);
console.log(JSON.stringify({
  quaternions: input.poses.map((pose) => [...quaternionsOf(pose)]),
  novelty: input.poses.map((pose) => support.novelty(pose)),
}));
"""


def test_novelty_and_quaternions_are_those_of_the_service(body: BodyModel, tmp_path: Path):
    poses, _ = random_motion(3, seed=5)
    poses[1, 3] = 0.0  # a joint that is not turned
    support = read_pose_support(MODELS_DIR / DEFAULT_MODEL / "poses.npz")
    parts = (support.legs, support.trunk, support.tilt)
    document = {
        "poses": poses.reshape(3, 72).tolist(),
        "kept": b"".join(part.tobytes() for part in parts).hex(),
        "support": {"rows": [len(part) for part in parts], "limits": support.limits.tolist()},
    }
    said = answer_of(PORTS, document, tmp_path)
    rows = pack_body(body).rows(poses)["joint_quaternion"][:, :24]
    assert_allclose(np.reshape(said["quaternions"], rows.shape), rows, rtol=0, atol=1e-7)
    assert_allclose(said["novelty"], support.novelty(poses), rtol=1e-5)


@contextmanager
def served_files(folder: Path) -> Iterator[str]:
    """The address of a server of files and of nothing else."""

    class Files(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            """Says nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Files, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


# The poses of a clip as the worker of the page drapes them, long after those that it has played.
DRAPED = """(async () => {
  shirt.stop();
  const { wearing } = shirt;  // takes one message at a time
  while (wearing.busy || wearing.newest) await new Promise((done) => setTimeout(done, 10));
  const { decoding, layers: [{ vertexCount }], opened: effort } = wearing;
  const frames = [];
  for (const text of MESSAGES) {
    const message = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
    const [{ positions }] = await decoding.decode(message, { effort });
    const bytes = new Uint8Array(positions.buffer, 0, 12 * vertexCount);
    frames.push(await new Promise((done) => {
      const reader = new FileReader();
      reader.onload = () => done(reader.result.split(",")[1]);
      reader.readAsDataURL(new Blob([bytes]));
    }));
  }
  return frames;
})()"""
REFUSED = """(async () => {
  const said = [];
  for (const options of [{ fabric: "denim" }, { tier: "fast" }, { passes: 0 }]) {
    said.push(await shirt.set(options).then(() => "", ({ name, kind }) => `${name} ${kind}`));
  }
  await shirt.set({ advanced: { folds: 2 } });
  return [...said, shirt.wearing.opened.folds, shirt.foldsBy, shirt.state];
})()"""


@pytest.fixture(scope="module")
def folder(shirt: Worn, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the shirt; the runtime is closed then."""
    target = tmp_path_factory.mktemp("static") / "folder"
    (target.parent / "other").mkdir()
    (target.parent / "other/file").touch()
    try:
        with pytest.raises(InputError, match="a new folder"):
            write_static(shirt.runtime, FolderRequest("tshirt", ("walk",)), target.parent / "other")
        write_static(shirt.runtime, FolderRequest("tshirt", ("walk",)), target)
    except Unavailable as missing:
        pytest.skip(str(missing))
    return target


@pytest.fixture(scope="module")
def served(shirt: Worn) -> np.ndarray:
    """The vertices of the service, before its runtime is closed."""
    return shirt.streamed(FRAMES, {})[0].vertices


def test_a_folder_is_small_and_drapes_as_the_service_does(
    served: np.ndarray, shirt: Worn, folder: Path, tmp_path: Path
):
    found = folder_sizes(folder)
    assert sum(found.values()) < FOLDER_BYTES
    assert found["engine.wasm.gz"] < ENGINE_BYTES
    copied = shutil.copytree(folder, tmp_path / "copied")
    draped = draped_in(copied, replace(shirt.clip, poses=shirt.clip.poses[:FRAMES], trans=shirt.clip.trans[:FRAMES]))
    apart_mm = rms_mm(draped, served)
    assert (apart_mm[:FIRST] < FIRST_MM).all() and (apart_mm < MOST_MM).all()


@pytest.mark.browser
def test_a_folder_s_page_shows_it(served: np.ndarray, shirt: Worn, folder: Path):
    clip = shirt.clip
    with served_files(folder) as address, open_page(address) as page:
        page.wait_for("Number(document.body?.dataset.frames) > 2")
        before = page.wait_for_picture(lambda picture: picture.std() > 10.0, "the page is blank")
        frames = page.evaluate("Number(document.body.dataset.frames)")
        page.wait_for(f"Number(document.body.dataset.frames) > {frames} + 5")
        page.wait_until_it_moves(before)
        poses = [Pose(i, 1e6 + i / clip.fps, clip.trans[i], clip.poses[i]) for i in range(FRAMES)]
        messages = [base64.b64encode(pack_pose(pose)).decode() for pose in poses]
        draped = page.evaluate(DRAPED.replace("MESSAGES", json.dumps(messages)))
        vertices = np.array([np.frombuffer(base64.b64decode(text), "<f4") for text in draped])
        assert (rms_mm(vertices.reshape(served.shape), served) < MOST_MM).all()
        refused = ["fabric InputError", "tier InputError", "passes InputError"]
        assert page.evaluate(REFUSED) == [*refused, 2, "client", "open"]
        assert page.errors == []
