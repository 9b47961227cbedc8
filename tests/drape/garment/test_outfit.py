"""The garments in one file: which pieces are one, which lies over which, and what of the file each of them is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.garment.cloth_layer import join_sheets
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.intake import intake, intake_outfit
from drape.garment.outfit import MOST, garments_in, part_names, parted
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.garment.garment_files import obj_text, shirt, skirt
from tests.drape.garment.test_accessories import of, over

BODY = load_body()
SKIN = BODY.v_template
Piece = tuple[np.ndarray, np.ndarray]
SHIRT, SKIRT = shirt(BODY, SKIN, ease_m=0.03), skirt(BODY)


def together(*pieces: Piece) -> GarmentMesh:
    starts = np.cumsum([0] + [len(points) for points, _ in pieces])
    faces = np.concatenate([own + start for (_, own), start in zip(pieces, starts, strict=False)])
    mesh = plain_mesh("suit", np.concatenate([points for points, _ in pieces]), faces)
    count = [len(own) for _, own in pieces]
    names = tuple(f"cloth {number}" for number in range(len(pieces)))
    return GarmentMesh(
        **{**vars(mesh), "material_names": names, "face_material": np.repeat(np.arange(len(pieces)), count)}
    )


def ring(radius_m: float, height_m: float, at: tuple[float, float, float]) -> Piece:
    points, faces = tube(32, 12, radius_m=radius_m, height_m=height_m)
    return points + at, faces


def pieces(mesh: GarmentMesh) -> list[set[int]]:
    """The numbers of the pieces, which are materials, in each garment."""
    label = garments_in(mesh, SKIN, BODY)
    return [set(mesh.face_material[label == number].tolist()) for number in range(label.max() + 1)]


def test_the_garment_over_another_is_the_outer_layer_in_whatever_order_they_come():
    assert pieces(together(SKIRT, SHIRT)) == [{1}, {0}]  # the skirt stands out from the hips, the shirt lies in it
    assert pieces(together(SHIRT, SKIRT)) == [{0}, {1}]
    wide = shirt(BODY, SKIN, ease_m=0.055)
    assert pieces(together(wide, SHIRT)) == [{1}, {0}]


def test_a_pair_is_one_garment():
    socks = [ring(0.09, 0.4, (side * 0.12, -1.1, 0.0)) for side in (-1.0, 1.0)]
    assert pieces(together(*socks)) == [{0, 1}]
    assert pieces(together(SHIRT, *socks)) in ([{0}, {1, 2}], [{1, 2}, {0}])


def test_a_shoe_is_no_part_of_the_sock_in_it():
    shoes = [over(of(f"{side}_ankle", f"{side}_foot"), 0.012) for side in ("left", "right")]
    ankles = [BODY.joints_template[JOINT_NAMES.index(f"{side}_ankle")] for side in ("left", "right")]
    socks = [ring(0.07, 0.2, (x, y + 0.2, z)) for x, y, z in ankles]
    worn = together(*socks, *[(one.vertices, one.faces) for one in shoes])
    assert sorted(map(sorted, pieces(worn))) == [[0, 1], [2, 3]]


def test_what_is_sewn_and_what_is_small_is_no_layer():
    upper, lower = ring(0.3, 0.3, (0.0, 0.1, 0.0)), ring(0.3, 0.3, (0.0, -0.2, 0.0))
    assert pieces(together(upper, lower)) == [{0, 1}]
    button = ring(0.01, 0.01, tuple(SKIRT[0][100]))
    found = pieces(together(SHIRT, SKIRT, button))
    assert found == [{0}, {1, 2}]


def test_a_belt_that_stands_off_loose_cloth_is_no_layer():
    dress = ring(0.2, 0.6, (0.0, -0.3, 0.0))
    assert pieces(together(dress, ring(0.235, 0.04, (0.0, 0.0, 0.0)))) == [{0, 1}]
    assert len(pieces(together(dress, ring(0.235, 0.3, (0.0, -0.15, 0.0))))) == 2, "an apron, a skirt"


def test_more_garments_than_layers_go_with_the_nearest():
    rings = [ring(0.25 + 0.04 * number, 0.5, (0.0, 0.0, 0.0)) for number in range(MOST + 2)]
    label = garments_in(together(*rings), SKIN, BODY)
    assert label.max() + 1 == MOST
    assert label[0] == 0


def test_each_part_is_of_the_file():
    mesh = together(SKIRT, SHIRT)
    apart = plain_mesh("suit", mesh.vertices[mesh.faces.reshape(-1)], np.arange(mesh.faces.size).reshape(-1, 3))
    for whole in (mesh, apart):
        sheets = join_sheets(whole)
        parts = parted(whole, sheets, garments_in(sheets, SKIN, BODY))
        assert [len(part.faces) for part, _ in parts] == [len(SHIRT[1]), len(SKIRT[1])]
        for part, cut in parts:
            corners = part.vertices[part.faces]
            assert_allclose(np.sort(corners.reshape(-1)), np.sort(cut.vertices[cut.faces].reshape(-1)), rtol=0, atol=0)
            assert_array_equal(cut.vertices[: len(part.vertices)], part.vertices)
    assert part_names(mesh, [part for part, _ in parted(mesh, mesh, garments_in(mesh, SKIN, BODY))]) == [
        "suit cloth 1",
        "suit cloth 0",
    ]
    assert part_names(mesh, [mesh]) == ["suit"]


def test_a_file_of_two_is_an_outfit_and_found_again(tmp_path: Path):
    """A skirt over a band round the hips, both of few vertices."""
    file, said = tmp_path / "suit.obj", list[str]()
    hips = BODY.joints_template[JOINT_NAMES.index("pelvis")]
    band, faces = ring(1.0, 0.3, (0.0, 0.0, 0.0))
    band = band * [0.2, 1.0, 0.17] + hips + [0.0, 0.0, 0.02]
    mesh = together(SKIRT, (band, faces))
    file.write_bytes(obj_text(mesh.vertices, mesh.faces))
    made = intake_outfit(file, avatar="standard", folder=tmp_path)
    assert [garment.name for garment in made] == ["suit_1", "suit_2"]
    assert [garment.vertex_count for garment in made] == [len(band), len(SKIRT[0])]
    again = intake_outfit(file, avatar="standard", folder=tmp_path, report=said.append)
    assert [garment.digest for garment in again] == [garment.digest for garment in made]
    assert len(said) == 1 and said[0].startswith("cached")
    (tmp_path / made[1].file_name()).unlink()
    whole = intake(file, avatar="standard", folder=tmp_path)
    assert whole.vertex_count == sum(garment.vertex_count for garment in made)
    assert len(intake_outfit(file, avatar="standard", folder=tmp_path)) == 2
    assert all(len(meshes.boundary_loops(garment.faces)) > 0 for garment in made)
