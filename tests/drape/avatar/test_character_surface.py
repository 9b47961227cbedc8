"""A character's own surface over a clip is where a player's skin puts it, in its own materials."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from numpy.testing import assert_allclose

from drape.avatar.below_cloth import keep_below
from drape.avatar.character_surface import moving_character
from drape.avatar.own_garments import Undressed
from drape.avatar.rig_file import Dressed
from drape.avatar.rig_motion import RigClip, rig_motion
from drape.avatar.wearer import read_wearer
from drape.avatar.worn_file import undressed_file, worn_on_rig
from drape.body.model import BodyModel
from drape.export.surface import MeshSurface, MovingGarment
from drape.garment.cache import Garment
from tests.fixtures.characters import bare_wearer, character
from tests.fixtures.glb_reader import Reader
from tests.fixtures.poses import smooth_motion

COLOUR = (0.1, 0.2, 0.3, 1.0)


def dressed_up(document: dict[str, Any]) -> None:
    """A material with a name, and the same mesh on a bone, without a skin."""
    document["materials"][0] |= {"name": "Haut", "pbrMetallicRoughness": {"baseColorFactor": [0.9, 0.5, 0.4, 1.0]}}
    document["nodes"].append({"name": "twin", "mesh": 0})
    document["nodes"][4].setdefault("children", []).append(len(document["nodes"]) - 1)


def test_it_is_where_a_player_puts_it(body: BodyModel, tube: Garment):
    payload = character(body, scale=100.0, arms_rad=0.5, yaw_rad=1.0, change=dressed_up)
    worn = read_wearer(payload, name="somebody", body=body)
    rig = worn.file
    assert rig is not None
    poses, trans = smooth_motion(np.arange(3) / 30.0)
    clip = RigClip(*worn.to_rig(poses, trans), 30.0)
    motion = rig_motion(clip, worn, rig.skeleton)
    skin, twin = moving_character(payload, motion, worn.scale)
    assert skin.surface.material_names == ("Haut",) and skin.vertices.dtype == np.float32
    look = skin.surface.looks.material(0)
    assert look is not None and look.base_colour == (0.9, 0.5, 0.4, 1.0)
    cloth = np.broadcast_to(tube.vertices, (3, *tube.vertices.shape))
    reader = Reader(worn_on_rig(payload, [Dressed(tube, cloth, COLOUR)], clip, worn, rig).to_bytes())
    node = next(i for i, one in enumerate(reader.json["nodes"]) if one.get("name") == "twin")
    assert_allclose(twin.vertices[1:], worn.scale * _along(reader, node), atol=1e-5)
    del reader.json["nodes"][node]["mesh"]  # so that one node has the mesh
    assert_allclose(skin.vertices[1:], worn.scale * reader.skinned(3), atol=1e-5)


def _along(reader: Reader, node: int) -> np.ndarray:
    places = reader.world(3)[:, node]
    (primitive,) = reader.json["meshes"][0]["primitives"]
    points = reader.array(primitive["attributes"]["POSITION"])
    return points @ places[:, :3, :3].swapaxes(-1, -2) + places[:, None, :3, 3]


def test_what_is_gone_is_left_out_and_bare_skin_is_there(body: BodyModel):
    payload, worn = character(body), bare_wearer()
    assert worn.file is not None
    off, bare = np.ones(len(worn.faces), dtype=bool), np.arange(len(worn.body.faces)) < 500
    content = undressed_file(payload, worn, worn.file, Undressed(off, bare))
    still = RigClip(*worn.to_rig(np.zeros((1, 24, 3)), np.zeros((1, 3))), 30.0)
    (skin,) = moving_character(content, rig_motion(still, worn, worn.file.skeleton), worn.scale)
    used = np.unique(worn.body.faces[bare])
    assert skin.surface.faces.shape == (500, 3)
    for vertices in skin.vertices:
        assert_allclose(vertices, worn.body.v_template[used], atol=1e-4)


def test_covered_skin_is_kept_below_the_cloth():
    """Of a ball in a larger one that is open below, what the cloth covers at rest and no hem is near."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    faces = ball.faces[ball.vertices[ball.faces].mean(axis=1)[:, 1] > -0.1]
    cloth = 1.05 * ball.vertices
    none = np.zeros((0, 2)), np.zeros((0, 3), int), (), np.zeros(0, int)
    skin, sheet = (MeshSurface("one", len(ball.vertices), own, *none) for own in (ball.faces, faces))
    grown = np.stack([ball.vertices, 1.1 * ball.vertices]).astype(np.float32)  # through the cloth by a centimetre
    part = MovingGarment(skin, np.concatenate([grown[:1], grown]), COLOUR)
    worn = MovingGarment(sheet, np.stack([cloth, cloth]).astype(np.float32), COLOUR)
    (below,) = keep_below([part], [(cloth, faces)], [worn])
    assert below.vertices.shape == (2, len(cloth), 3)
    assert_allclose(below.vertices[0], ball.vertices, atol=1e-7)
    reach, high = np.linalg.norm(below.vertices[1], axis=1), ball.vertices[:, 1]
    assert (reach[high > 0.0] < 1.05 * 0.2).all() and (reach[high < -0.12] > 0.21).all()
