"""The engine in WebAssembly is that of the service: a small sleeve in motion, with every part of a step, and a body."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.feed import BodyFeed
from drape.body.model import BodyModel
from drape.contact.skin import posed_table
from drape.engine.flat_records import TYPES, flat_records
from drape.engine.records import HASH, RECORDS
from drape.errors import InputError
from drape.garment.bound import Drawer, bind
from drape.garment.files.mesh import plain_mesh
from drape.geometry import meshes
from drape.graph.packing import tile_charts
from drape.live.clock import Frame
from drape.live.fold_records import shape_feed
from drape.live.fold_step import FoldEffort
from drape.live.two_level import TwoLevel
from drape.wire.folds_message import pack_folds, unpack_folds, with_hung
from drape.wire.layout import JetLayout, pack_layout
from drape.wire.messages import FOLDS
from tests.clients.built import engine_for_browsers
from tests.clients.node import answer_of
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.live.conftest import still, tank
from tests.drape.live.folds_setup import EASE_M, HEIGHT_M, RADIUS_M, constants, folded, frame, held_for, sleeve

__all__ = ["still", "tank"]  # fixtures
FRAMES = 24
SCRIPT = """
import { readFileSync } from "node:fs";
import { Engine } from "./engine.js";
import { Folding } from "./folding.js";
const bytes = (name) => new Uint8Array(readFileSync(new URL(name, import.meta.url))).buffer;
const module = await WebAssembly.compile(bytes("engine.wasm"));
const folding = await Folding.make({ module, constants: bytes("constants.bin") });
const { engine } = folding;
if (input.samples) folding.around = engine.record("Surroundings", { skin: engine.array("numbers", input.samples) });
const frames = input.frames.map(({ vertices, skin, timeS, effort, rest }) => {
  if (rest) folding.rest(rest);
  engine.view(folding.around.skin).set(skin);
  engine.view(folding.smooth).set(vertices);
  const happened = folding.fold(folding.smooth, timeS, effort.folds, effort);
  return { happened: Object.values(happened), vertices: [...engine.view(folding.folded)] };
});
const skins = input.poses.map((pose) => [...folding.skin(pose)]);
const refused = [];
const refuse = (spoil) => {
  const message = bytes("constants.bin");
  spoil(new Uint8Array(message));
  try { engine.lay(message); refused.push(""); } catch (error) { refused.push(error.message); }
};
refuse((message) => (message[5] = 5));
refuse((message) => (message[20 + input.layoutAt] ^= 1));
console.log(JSON.stringify({ frames, skins, refused }));
"""


def no_body() -> BodyFeed:
    none = np.zeros(0)
    return BodyFeed(none, np.zeros((24, 3)), none, none, none, none, none)


def in_client(records: dict[str, Any], folder: Path, frames: list[dict], *, poses=(), samples: int = 0) -> dict:
    """What the client's engine makes of ``frames`` with the ``records``, over a skin of so many ``samples``."""
    shutil.copy(engine_for_browsers(), folder)
    message = pack_folds(*flat_records(records))
    (folder / "constants.bin").write_bytes(message)
    at = json.dumps(flat_records(records)[0], separators=(",", ":")).index(f"{HASH:016x}")
    poses = [np.ravel(pose).tolist() for pose in poses]
    return answer_of(SCRIPT, {"frames": frames, "poses": poses, "samples": 8 * samples, "layoutAt": at}, folder)


def of_sleeve(frames: list[dict], folder: Path, material: str = "rib") -> dict:
    """The same of the sleeve."""
    records = {"FoldConstants": constants(material), "BodyFeed": no_body()}
    return in_client(records, folder, frames, samples=len(frame(sleeve()[0], 0).skin))


def asked(one: Frame, effort: FoldEffort) -> dict:
    return {
        "vertices": one.vertices.astype(np.float32).ravel().tolist(),
        "skin": np.ravel(one.skin).tolist(),
        "timeS": one.time_s,
        "effort": {
            "folds": effort.steps,
            "settle": effort.settle,
            "cloth_contact": effort.cloth_contact,
            "clearance_m": effort.clearance_m,
        },
    }


@pytest.mark.parametrize(
    ("material", "effort"),
    [
        ("rib", FoldEffort(steps=2, settle=2, cloth_contact=True)),
        ("denim", FoldEffort(steps=1, settle=16, cloth_contact=True, clearance_m=0.0)),
        ("rib", FoldEffort(steps=1, settle=8)),
    ],
)
def test_the_client_is_as_near_to_float64_as_the_service(material: str, effort: FoldEffort, tmp_path: Path):
    rest, _ = sleeve(material)
    frames = [frame(rest, number) for number in range(FRAMES)]
    frames += held_for(frames[-1], 4, start=FRAMES)
    single = np.stack([one for one, *_ in folded(constants(material), frames, effort)])
    double = np.stack([one for one, *_ in folded(constants(material, dtype=np.float64), frames, effort)])
    said = of_sleeve([asked(one, effort) for one in frames], tmp_path, material)
    got = np.array([one["vertices"] for one in said["frames"]]).reshape(single.shape)
    assert np.abs(got - double).max() < 10.0 * np.abs(single - double).max()
    assert [one["happened"] for one in said["frames"]] == [[1, 0, 0]] + [[0, 0, 0]] * (len(frames) - 1)
    assert "not a FOLDS message" in said["refused"][0] and "the layout" in said["refused"][1]


def test_a_cut_begins_anew_and_a_rest_does_not(tmp_path: Path):
    rest, _ = sleeve()
    effort = FoldEffort(steps=1, settle=4)
    first, second = frame(rest, 0), frame(rest, 1)
    late = asked(second, effort) | {"timeS": 9.0}
    frames = [asked(first, effort), late, late | {"timeS": 20.0, "rest": 20.0 - 1.0 / 30.0}, late | {"timeS": 19.0}]
    said = of_sleeve(frames, tmp_path)
    assert [one["happened"][0] for one in said["frames"]] == [1, 1, 0, 1]
    again = folded(constants(), [second], effort)[0][0]
    assert_allclose(np.reshape(said["frames"][1]["vertices"], (-1, 3)), again, rtol=0, atol=1e-6)


def test_no_folds_are_better_than_those_that_are_none(tmp_path: Path):
    rest, _ = sleeve()
    effort = FoldEffort(steps=1, settle=2)
    torn = asked(frame(rest, 0), effort)
    torn["vertices"][0] = 1e30  # a vertex far away: its neighbours follow
    said = of_sleeve([torn], tmp_path)
    assert said["frames"][0]["happened"] == [1, 1, 1]  # settled, begun anew, lost
    assert_allclose(said["frames"][0]["vertices"], torn["vertices"], rtol=1e-6)


def test_steps_of_a_coarse_cloth_go_on_from_a_lift_as_in_the_service(tank: TwoLevel, still: Frame, tmp_path: Path):
    idle, effort = FoldEffort(0, clearance_m=0.004), FoldEffort(steps=1, settle=2, cloth_contact=True)
    efforts, memory, expected, reports = [idle, idle, effort, effort, idle], None, [], []
    frames = [replace(still, time_s=number / 30.0) for number in range(len(efforts))]
    for one, each in zip(frames, efforts, strict=True):
        vertices, memory, report = tank.fold(memory, one, each)
        expected.append(vertices)
        reports.append([report.settled, report.reset])
    records = {"Levels": tank.levels, "BodyFeed": no_body()}
    given = [asked(one, each) for one, each in zip(frames, efforts, strict=True)]
    said = in_client(records, tmp_path, given, samples=len(still.skin))
    got = np.array([one["vertices"] for one in said["frames"]]).reshape(np.shape(expected))
    apart_m = np.sqrt(np.square(got - expected).sum(axis=2).mean(axis=1))
    assert (apart_m < 1e-5).all()  # single vertices may fold another way
    assert [one["happened"][:2] for one in said["frames"]] == reports


def test_the_client_poses_the_skin_as_the_service_does(body: BodyModel, rng, tmp_path: Path):
    poses, betas = rng.uniform(-0.8, 0.8, (3, 24, 3)), rng.normal(size=body.shape_count)
    poses[0] = 0.0
    expected = posed_table(body, poses.astype(np.float32), betas).reshape(3, -1, 8)
    records = {"FoldConstants": constants(), "BodyFeed": shape_feed(body, betas)}
    said = in_client(records, tmp_path, [], poses=poses)
    got = np.reshape(said["skins"], expected.shape)
    assert_allclose(got[..., :4], expected[..., :4], rtol=0, atol=2e-5)
    assert_allclose(got, expected, rtol=0, atol=1e-4)  # normals are products of tangents that may be short


TILES = """
import { readFileSync } from "node:fs";
import { tilesOf } from "./tiles.js";
import { unpackLayout } from "./wire.js";
const layout = unpackLayout(new Uint8Array(readFileSync(new URL("layout.bin", import.meta.url))).buffer);
const kinds = {};
const laid = tilesOf(layout, (kind, numbers) => (kinds[kind] = (kinds[kind] ?? 0) + 1) && [...numbers]);
console.log(JSON.stringify({ ...laid, kinds }));
"""


def test_the_charts_of_a_layout_lie_in_tiles_as_those_of_the_service(rng, tmp_path: Path):
    patches, vertices = 3, 70
    rotation, _ = np.linalg.qr(rng.normal(size=(patches, 3, 3)))
    patch = np.where(rng.uniform(size=(vertices, 4)) < 0.8, 0, rng.integers(patches, size=(vertices, 4)))
    weight = rng.uniform(size=(vertices, 4))
    uv = rng.uniform(-1.0, 1.0, (vertices, 4, 2))
    layout = JetLayout(
        rotation, rng.normal(size=(patches, 3)), np.array([0.1, 0.2, 0.3]), rng.normal(size=(vertices, 3)),
        patch, weight / weight.sum(axis=1, keepdims=True), uv,
    )  # fmt: skip
    (tmp_path / "layout.bin").write_bytes(pack_layout(layout))
    said = answer_of(TILES, {}, tmp_path)
    tiling = tile_charts(patch, patches)
    assert_array_equal(said["patch"], tiling.patch)
    assert_array_equal(np.reshape(said["charts"], (4, vertices)).T, tiling.column)
    local = np.einsum("vcai,vca->vci", rotation[patch], layout.rest[:, None] - layout.centre[patch])
    powers = [uv[..., 0] ** (i - j) * uv[..., 1] ** j for i in range(5) for j in range(i + 1)]
    columns = np.concatenate([local / layout.scale[patch][..., None], np.stack(powers, axis=-1)], axis=-1)
    expected = tiling.lay(layout.chart_weight[..., None] * columns)
    assert_allclose(np.reshape(said["columns"], expected.shape), expected, rtol=0, atol=2e-6 * np.abs(expected).max())
    assert said["kinds"] == {"numbers": 2, "int32s": 1, "uint16s": 1}


def test_a_message_holds_the_records_that_were_packed_and_nothing_else_is_read():
    layers = [SimpleNamespace(weight=np.arange(6.0), bias=np.ones(2), slope=0.25, tiles=np.zeros(0))]
    weights = {name: layers if kind.endswith("[]") else np.arange(3.0) for name, kind in RECORDS["Weights"].items()}
    weights |= {name: layers[0] for name, kind in RECORDS["Weights"].items() if kind == "Layer"}
    memory = {name: np.arange(4) for name in RECORDS["FoldMemory"]} | {"turn": 3, "step_s": 0.1}
    values = {"Weights": SimpleNamespace(**weights), "FoldMemory": SimpleNamespace(**memory)}
    document, arrays = flat_records(values)
    message = pack_folds(document, arrays)
    assert len(message) % 4 == 0
    read, data = unpack_folds(message)
    assert read == document and read["layout"] == f"{HASH:016x}"
    told = read["records"]["FoldMemory"]
    assert list(told) == list(RECORDS["FoldMemory"]) and (told["turn"], told["step_s"], told["own"]) == (3, 0.1, 4)
    assert read["records"]["Weights"]["body"] == [{"weight": 6, "bias": 2, "slope": 0.25, "tiles": 0}]
    planes = [one.view(np.uint8).reshape(len(one), -1).T.tobytes() for one in arrays if len(one)]
    assert data == b"".join(one + b"\0" * (-len(one) % 4) for one in planes)
    assert {one.dtype.str for one in arrays} <= {np.dtype(kind).str for kind in TYPES.values()}
    for wrong, expected in (
        (message[:18], "folds message"),
        (message[:40], "expected a document"),
        (message[:5] + b"\x05" + message[6:], f"kind {FOLDS}"),
    ):
        with pytest.raises(InputError, match=expected):
            unpack_folds(wrong)


HANG = """
import { readFileSync } from "node:fs";
import { Folding } from "./folding.js";
const bytes = (name) => new Uint8Array(readFileSync(new URL(name, import.meta.url))).buffer;
const module = await WebAssembly.compile(bytes("engine.wasm"));
const folding = await Folding.make({ module, constants: bytes("constants.bin") });
const { engine } = folding;
const drawn = input.cloths.map((cloth) => {
  engine.view(folding.smooth).set(cloth);
  return [...engine.view(folding.drawnOn(folding.smooth))];
});
console.log(JSON.stringify({ drawn }));
"""


def test_what_hangs_on_the_cloth_is_drawn_as_in_the_service(rng, tmp_path: Path):
    """A lining off the cloth, vertices on it, and a stiff button."""
    rest, faces = tube(11, 6, radius_m=RADIUS_M + EASE_M, height_m=HEIGHT_M)
    faces = faces.astype(np.int64)
    normals = meshes.vertex_normals(rest, faces)
    button = rest[40] + 0.004 * rng.normal(size=(6, 3)) + 0.01 * normals[40]
    places = np.concatenate([rest, rest - 0.003 * normals, button])
    row = np.concatenate([np.arange(len(rest)), np.full(len(rest) + 6, -1)])
    part = np.concatenate([np.full(2 * len(rest), -1), np.zeros(6, dtype=int)])
    mesh = plain_mesh("lined", places, np.concatenate([faces, faces + len(rest), [[0, 1, 2]]]))
    drawer = Drawer(bind(mesh, places, rest, faces, row, part), faces)
    cloths = [rest, rest + 0.05 * np.sin(9.0 * rest[:, [1, 2, 0]])]
    shutil.copy(engine_for_browsers(), tmp_path)
    told = flat_records({"FoldConstants": constants("rib"), "BodyFeed": no_body()})
    (tmp_path / "constants.bin").write_bytes(pack_folds(*with_hung(*told, drawer.arrays())))
    said = answer_of(HANG, {"cloths": [np.ravel(one).tolist() for one in cloths]}, tmp_path)
    for cloth, got in zip(cloths, said["drawn"], strict=True):
        assert_allclose(np.reshape(got, (-1, 3)), drawer.draw(cloth.astype(np.float32)), rtol=0, atol=1e-6)
