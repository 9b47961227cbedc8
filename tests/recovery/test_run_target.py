"""What a target may look like: every repair leaves a note, every refusal says the cure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.errors import BodyError, InputError, MeshError
from drape.garment.cache import load_garment
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.geometry import closest, meshes
from recovery.pattern.pattern_files import export_pattern
from recovery.run.target import (
    MOST_OFF_M,
    OPENINGS,
    check_base,
    check_near,
    close_but_openings,
    inside_wearer,
    off_skin,
    placed_target,
    read_target_wearer,
    shape_body,
)
from recovery.run.task import RecoveryJob, prepare, read_base
from recovery.scan.holes import close_holes
from recovery.scan.repair import ScanFault, mend_sheet, one_sheet, read_target
from recovery.sim.skin_contact import check_closed
from tests.drape.cloth.cloth_shapes import grid, round_tube


def skirt_tube(radius: float = 0.24, top: float = 0.05, bottom: float = -0.45) -> GarmentMesh:
    """A tube round hips and legs of the shipped body: what a skirt is."""
    return plain_mesh("skirt", *round_tube([radius] * 21, np.linspace(bottom, top, 21), 40))


def write_obj(path: Path, mesh: GarmentMesh, *, materials: dict[str, np.ndarray] | None = None) -> Path:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    for name, faces in (materials or {"cloth": mesh.faces}).items():
        lines += [f"usemtl {name}", *("f " + " ".join(str(corner + 1) for corner in face) for face in faces)]
    path.write_text("\n".join(lines) + "\n")
    return path


def both(first: GarmentMesh, second: GarmentMesh) -> tuple[GarmentMesh, dict[str, np.ndarray]]:
    moved = second.faces + len(first.vertices)
    mesh = plain_mesh("both", np.concatenate([first.vertices, second.vertices]), np.concatenate([first.faces, moved]))
    return mesh, {"cloth": first.faces, "skin": moved}


def test_copies_of_vertices_flat_faces_and_crumbs_are_repaired_and_noted(tmp_path):
    mesh = skirt_tube()
    crumb = plain_mesh("crumb", np.array([[0, 0, 0.3], [0.01, 0, 0.3], [0, 0.01, 0.3]]), [[0, 1, 2]])
    soup = plain_mesh("soup", mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)))
    whole, _ = both(soup, crumb)
    flat = np.array([[0, 0, 1]])
    read = read_target(write_obj(tmp_path / "t.obj", replace(whole, faces=np.concatenate([whole.faces, flat]))))
    assert len(read.vertices) == len(mesh.vertices) and len(read.faces) == len(mesh.faces)
    assert len(meshes.boundary_loops(read.faces)) == 2
    notes = " / ".join(read.notes)
    assert "welded" in notes and "1 degenerate" in notes and "1 small loose" in notes


def test_two_pieces_are_refused_and_a_label_chooses_one(tmp_path):
    mesh, materials = both(skirt_tube(), skirt_tube(radius=0.4))
    path = write_obj(tmp_path / "t.obj", mesh, materials=materials)
    with pytest.raises(MeshError, match=r"2 pieces.*--label.*cloth, skin"):
        read_target(path)
    assert len(read_target(path, label="cloth").faces) == len(materials["cloth"])
    with pytest.raises(MeshError, match="one of cloth, skin"):
        read_target(path, label="hat")
    with pytest.raises(MeshError, match="faces of skin"):
        read_target(
            write_obj(tmp_path / "u.obj", mesh, materials={**materials, "skin": np.zeros((0, 3), int)}), label="skin"
        )


def test_an_edge_with_three_faces_is_cut_and_a_solid_refused(body, tmp_path):
    mesh = skirt_tube()
    fin = np.array([[mesh.faces[0][1], mesh.faces[0][2], len(mesh.vertices)]])
    finned = replace(
        mesh, vertices=np.concatenate([mesh.vertices, [[0.0, 0.0, 0.5]]]), faces=np.concatenate([mesh.faces, fin])
    )
    read = read_target(write_obj(tmp_path / "t.obj", finned))
    assert len(read.faces) == len(mesh.faces) and len(read.vertices) == len(mesh.vertices)
    assert "1 edges with more than two faces" in " / ".join(read.notes)
    with pytest.raises(MeshError, match="a closed surface"):
        read_target(write_obj(tmp_path / "u.obj", plain_mesh("body", body.v_template, body.faces)))


def without(mesh: GarmentMesh, *faces: int) -> GarmentMesh:
    return mesh.take_faces(~np.isin(np.arange(len(mesh.faces)), faces))


SHEET = plain_mesh("sheet", *grid(8, 8, cell_m=0.08))
SHUT = close_holes(skirt_tube(), lambda one: True).mesh
LONE = plain_mesh("lone", np.concatenate([[[0, 0, 0.3], [0.3, 0, 0.3], [0, 0.3, 0.3]], np.ones((30, 3))]), [[0, 1, 2]])


@pytest.mark.parametrize(
    ("mesh", "got"),
    [
        (SHUT, "a closed surface"),
        (without(SHUT, 700), r"closed once mended, with no border but holes \(1\)"),
        (without(SHUT, 300, 700, 1100), r"closed once mended, with no border but holes \(3\)"),
        (replace(SHUT, faces=SHUT.faces[:, ::-1]), "a closed surface"),
        (SHEET, "open from hem to neck"),
        (LONE, "open from hem to neck"),
        (replace(SHEET, vertices=SHEET.vertices * [1.0, 0.0, 0.0]), "faces with an area, got none"),
        (both(skirt_tube(), skirt_tube(radius=0.4))[0], "2 pieces of cloth"),
        (replace(SHEET, vertices=1e200 * SHEET.vertices), "Scale the file"),
        (replace(SHEET, vertices=1e-30 * SHEET.vertices), "Scale the file"),
    ],
)
def test_whatever_the_surface_the_refusal_is_a_sentence(tmp_path, mesh, got):
    """Also one that mending closes, and one whose fault is a point."""
    path = write_obj(tmp_path / "odd.obj", mesh)
    with pytest.raises(MeshError, match=got):
        prepare(RecoveryJob(target=path, out=tmp_path, base=None, body="anny_default"))


def test_a_whole_mesh_stays_as_it_is():
    mesh = skirt_tube()
    kept = one_sheet(mesh)
    assert_allclose(kept.vertices, mesh.vertices)
    assert (kept.faces == mesh.faces).all() and kept.notes == ()


def test_centimetres_z_up_and_inside_out_are_repaired_and_noted():
    skin = read_target_wearer("anny_default").skin
    mesh = skirt_tube()
    x, y, z = 100.0 * mesh.vertices.T
    found = placed_target(replace(mesh, vertices=np.stack([x, -z, y], axis=1), faces=mesh.faces[:, ::-1]), skin)
    assert_allclose(found.vertices, mesh.vertices, atol=1e-9)
    assert (np.sort(found.faces, axis=1) == np.sort(mesh.faces, axis=1)).all()
    assert_allclose(meshes.face_normals(found.vertices, found.faces), meshes.face_normals(mesh.vertices, mesh.faces))
    notes = " / ".join(found.notes)
    assert "from cm to m" in notes and "z up to y up" in notes and "normals point outward" in notes


@pytest.mark.parametrize(
    ("mesh", "got"),
    [(skirt_tube(radius=0.35), "cm away"), (skirt_tube(radius=0.09, top=0.4, bottom=-0.05), "cm inside")],
)
def test_a_target_off_its_body_is_refused(mesh, got):
    with pytest.raises(InputError, match=got):
        check_near(mesh, read_target_wearer("anny_default").skin)


@pytest.mark.parametrize(
    ("mesh", "unit", "got"),
    [
        (skirt_tube(radius=0.02, top=0.12, bottom=0.02), "auto", r"an extent of.*its unit"),
        (skirt_tube(radius=0.16, top=0.12, bottom=0.105), "m", r"target area: expected at least 0\.02 m\^2"),
    ],
)
def test_a_target_in_no_known_unit_or_of_too_little_cloth_is_refused(mesh, unit, got):
    with pytest.raises(MeshError, match=got):
        placed_target(mesh, read_target_wearer("anny_default").skin, unit=unit)


def test_the_base_must_have_the_openings_of_the_target():
    mesh, found = close_but_openings(skirt_tube(), load_body().joints_template)
    assert found == OPENINGS["skirt"] and mesh.notes == ()
    check_base("skirt", found)
    check_base("mine.json", found)  # nothing is known of its openings before it is draped
    with pytest.raises(InputError, match=r"the openings of a tshirt.*Take --base skirt"):
        check_base("tshirt", found)
    with pytest.raises(InputError, match="Take a base of the target's kind"):
        check_base("tshirt", {"trunk": 1})


def test_cloth_that_lies_off_the_skin_tells_how_far():
    skin = read_target_wearer("anny_default").skin
    (path,) = Path("drape/assets/garments").glob("tank-*.npz")
    tank = load_garment(path)
    mesh, known = plain_mesh("tank", tank.vertices, tank.faces), np.ones(len(tank.faces))
    assert_allclose(off_skin(mesh, skin, known), 0.0035, atol=3e-4)  # the catalogue's gap of 7.5 mm, less our 4
    # What closes a hole does not count, loose cloth lies nowhere, and cloth that cuts the body tells nothing.
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    far = closest.signed_distance(middles, skin.vertices, skin.faces) > 0.02
    assert off_skin(mesh, skin, far) == MOST_OFF_M
    for radius, told in ((0.3, MOST_OFF_M), (0.1, 0.0)):
        tube = skirt_tube(radius)
        assert off_skin(tube, skin, np.ones(len(tube.faces))) == told


@pytest.mark.parametrize("turned", [False, True])
def test_a_garment_that_is_open_from_hem_to_top_is_refused_with_its_place(turned):
    tube = skirt_tube()
    middles = tube.vertices[tube.faces].mean(axis=1)
    coat = tube.take_faces(~((np.abs(middles[:, 0]) < 0.05) & (middles[:, 2] > 0.0)))
    if turned:
        x, y, z = coat.vertices.T
        coat = replace(coat, vertices=np.stack([x, -z, y], axis=1))
    with pytest.raises(ScanFault, match=r"open from hem to neck.*Join the two edges") as fault:
        mend_sheet(coat)
    up = 2 if turned else 1
    assert len(fault.value.points) and np.abs(fault.value.points[:, up] + 0.2).max() < 0.2


@pytest.mark.parametrize("limb", [False, True])
def test_a_garment_that_is_one_surface_with_its_wearer_is_refused_with_its_place(limb):
    """A tube that closes over a ball as large as a head, or as over an arm; cut off it is a tube."""
    if limb:
        bag = round_tube([0.06] * 20 + [0.04, 0.01], [*np.linspace(0.0, 0.4, 20), 0.42, 0.43], 24)
    else:
        angle = np.linspace(-1.0, 1.55, 16)
        radius, height = 0.1 * np.cos(angle), 0.75 + 0.1 * np.sin(angle)
        bag = round_tube([0.3, 0.3, 0.06, *radius], [-0.3, 0.5, 0.6, *height], 40)
    mesh = plain_mesh("worn", *bag)
    top = max(meshes.boundary_loops(mesh.faces), key=lambda loop: mesh.vertices[loop, 1].mean())
    tip = np.stack([np.roll(top, -1), top, np.full(len(top), len(mesh.vertices))], axis=1)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[top].mean(axis=0)[None]])
    closed = plain_mesh("worn", vertices, np.concatenate([mesh.faces, tip]))
    with pytest.raises(ScanFault, match=r"without its wearer.*closes as over a head.*--label") as fault:
        mend_sheet(closed)
    assert fault.value.points[0, 1] > 0.35
    cut = closed.vertices[closed.faces][:, :, 1].max(axis=1) < (0.3 if limb else 0.55)
    assert len(meshes.boundary_loops(mend_sheet(closed.take_faces(cut)).faces)) == 2


def test_a_hole_is_noted_and_closed():
    mesh = skirt_tube()
    holed = mesh.take_faces(np.arange(len(mesh.faces)) != 410)
    mesh, found = close_but_openings(holed, load_body().joints_template)
    assert found == OPENINGS["skirt"] and "1 holes" in mesh.notes[0]
    assert len(meshes.boundary_loops(mesh.faces)) == 2


def test_a_body_with_a_hole_is_refused(body, tmp_path):
    with pytest.raises(MeshError, match=r"1 open borders.*Close its holes"):
        check_closed(body.v_template, body.faces[1:], "mine")
    path = write_obj(tmp_path / "open.obj", plain_mesh("open", body.v_template, body.faces[1:]))
    with pytest.raises(MeshError, match="a closed surface"):
        read_target_wearer(str(path))
    with pytest.raises(BodyError, match="its own shape and pose"):
        read_target_wearer(str(path), pose=np.zeros((24, 3)))


def test_a_shape_is_in_the_template_of_the_wearer():
    wearer = read_target_wearer("anny_default", betas=np.array([0.5, -1.0]))
    assert_allclose(wearer.skin.vertices, load_body().rest_vertices(np.array([0.5, -1.0])), atol=1e-12)
    assert_allclose(wearer.shaped.joints_template, load_body().rest_joints(np.array([0.5, -1.0])), atol=1e-12)
    assert shape_body(load_body(), np.zeros(2)).name == load_body().name


def test_a_job_refuses_what_does_not_go_together(tmp_path):
    path = write_obj(tmp_path / "t.obj", skirt_tube())
    job = RecoveryJob(target=path, out=tmp_path, base="skirt", body="fit", pose=np.zeros((24, 3)))
    with pytest.raises(InputError, match="--body fit"):
        prepare(job)
    wearer = read_target_wearer("anny_default")
    with pytest.raises(InputError, match="--base"):
        read_base("hat", wearer)
    with pytest.raises(InputError, match="--set"):
        read_base("mine.json", wearer, ["length_m=1"])


@pytest.mark.long
def test_a_body_is_found_inside_a_garment_in_another_unit_and_place(body):
    """The base's own panels as placed tell the size; cloth round the trunk, sleeves round lowered arms."""
    pose = np.zeros((24, 3))
    pose[16, 2], pose[17, 2] = -0.5, 0.5
    near = body.posed_vertices(pose[None])[0]
    normals = meshes.vertex_normals(near, body.faces)
    # A tight shirt: the skin of trunk and upper arms, 8 mm out.
    shirt = body.weights[:, [0, 3, 6, 9, 13, 14, 16, 17]].sum(axis=1) > 0.5
    keep = shirt[body.faces].all(axis=1)
    used, faces = np.unique(body.faces[keep], return_inverse=True)
    vertices = (near + 0.008 * normals)[used] + [0.1, 0.9, 0.0]
    mesh, wearer = inside_wearer(plain_mesh("scan", 100.0 * vertices, faces.reshape(-1, 3)))
    assert_allclose(mesh.vertices, vertices)
    assert "from cm to m" in mesh.notes[-1]
    assert np.linalg.norm(wearer.skin.vertices[shirt] - (near[shirt] + [0.1, 0.9, 0.0]), axis=1).mean() < 0.025
    assert wearer.residual_mm < 12.0 and wearer.pose is not None
    assert wearer.pose[[13, 16], 2].sum() < -0.3 and wearer.pose[[14, 17], 2].sum() > 0.3
    # A wide ring hangs on nobody.
    ring = plain_mesh("ring", *round_tube([0.5] * 9, np.linspace(1.0, 1.6, 9), 60))
    with pytest.raises(MeshError, match="Say the unit"):
        inside_wearer(ring, unit="m")
    # In a narrow one no body fits.
    with pytest.raises(MeshError, match="cloth that a human body fits in"):
        inside_wearer(plain_mesh("scan", vertices * [0.35, 1.0, 0.35], faces.reshape(-1, 3)), unit="m")


@pytest.mark.slow
def test_arms_bend_where_long_sleeves_do(body):
    pose = np.zeros((24, 3))
    pose[[16, 17], 2], pose[[18, 19], 1] = (-0.6, 0.6), (-0.7, 0.7)
    near = body.posed_vertices(pose[None])[0]
    shirt = body.weights[:, [0, 3, 6, 9, 13, 14, 16, 17, 18, 19]].sum(axis=1) > 0.5
    used, faces = np.unique(body.faces[shirt[body.faces].all(axis=1)], return_inverse=True)
    vertices = (near + 0.01 * meshes.vertex_normals(near, body.faces))[used]
    _, wearer = inside_wearer(plain_mesh("scan", vertices, faces.reshape(-1, 3)))
    assert wearer.pose is not None
    assert_allclose(wearer.pose[[18, 19], 1], [-0.7, 0.7], rtol=0, atol=0.25)
    assert np.linalg.norm(wearer.skin.vertices[shirt] - near[shirt], axis=1).mean() < 0.02


def test_without_a_base_the_target_tells_it_and_its_settings(tmp_path):
    path = write_obj(tmp_path / "t.obj", skirt_tube())
    found = prepare(RecoveryJob(target=path, out=tmp_path, base=None, body="anny_default"))
    assert (found.cut.base, found.cut.by_openings, found.base.name) == ("skirt", True, "t")
    assert_allclose(found.cut.settings["length_m"], 0.5, atol=1e-6)
    assert any("chosen by the target's openings: skirt" in note for note in found.warnings)
    named = prepare(
        RecoveryJob(target=path, out=tmp_path, base="skirt", body="anny_default", settings=["length_m=0.4"])
    )
    assert not named.cut.by_openings and named.cut.settings["length_m"] == 0.4
    with pytest.raises(InputError, match=r"--set: expected NAME=NUMBER"):
        prepare(RecoveryJob(target=path, out=tmp_path, base=None, body="anny_default", settings=["length_m"]))
    pattern = export_pattern(found.base, tmp_path, ["json"])[0]
    with pytest.raises(InputError, match=r"--sizes: expected a base that is drafted"):
        prepare(RecoveryJob(target=path, out=tmp_path, base=str(pattern), body="anny_default", sizes=["L"]))
