"""From a file to a stored garment: the same cloth whatever its unit, order kept, refusals clean."""

from __future__ import annotations

import json
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.cloth.rest_state import dihedral_angles
from drape.errors import InputError, MeshError, NotFound
from drape.garment import intake as intake_module
from drape.garment.avatars import STANDARD, phenotype_avatar
from drape.garment.cache import OWN_GARMENTS_DIR, load_garment
from drape.garment.clearance import CLEARANCE_M
from drape.garment.cloth_layer import VERTEX_LIMIT
from drape.garment.files.mesh import plain_mesh
from drape.garment.intake import IntakeOptions, garment_name, intake, main, read_fabric, with_rest_state
from drape.garment.mesh_checks import UNITS_M
from drape.garment.rest_detail import Rest, RestCloth, rest_of
from drape.garment.rest_mesh import with_unused, without_unused
from drape.geometry import meshes
from drape.geometry.closest import signed_distance
from tests.drape.garment.garment_files import at_rest, obj_text, shirt
from tests.fixtures.garments import reconstructed

BODY = load_body()
FEMALE = {"gender": 1.0, "age": 0.667}
AVATAR = phenotype_avatar(FEMALE, BODY)
VERTICES, FACES = shirt(BODY, AVATAR.vertices)
OF_WOMEN, OF_MEN = ("jeans", "pencil_skirt", "suit_jacket", "tshirt"), ("jeans", "long_sleeve_shirt", "tshirt")
GARMENTS = [*(f"female_{name}" for name in OF_WOMEN), *(f"male_{name}" for name in OF_MEN)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("garments")
    (folder / "avatars.json").write_text(json.dumps({"female": FEMALE}))
    (folder / "female_shirt.obj").write_bytes(obj_text(VERTICES, FACES))
    return folder


@pytest.fixture(scope="module")
def garment(folder: Path):
    return intake(folder / "female_shirt.obj", body=BODY, folder=folder / "out")


def test_garment_is_clear_in_order_and_says_what_happened(garment):
    assert garment.name == "female_shirt"
    assert garment.vertex_count == len(VERTICES)
    assert_array_equal(garment.faces, FACES)
    signed = signed_distance(garment.vertices.astype(np.float64), BODY.v_template, BODY.faces)
    assert signed.min() >= CLEARANCE_M
    target, _ = shirt(BODY, BODY.v_template)
    assert np.median(np.linalg.norm(garment.vertices[: len(target)] - target, axis=1)) < 0.01
    assert garment.manifest["avatar"]["source"].startswith("phenotype gender 1")
    assert garment.manifest["intake"]["clearance_mm"] >= 6.0
    assert set(garment.manifest["fit"]) >= {"point_rmse_m", "normal_error_deg"}


def test_second_intake_is_found_in_the_cache(garment, folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(intake_module, "rest_mesh", None)
    lines: list[str] = []
    again = intake(folder / "female_shirt.obj", body=BODY, folder=folder / "out", report=lines.append)
    assert again.digest == garment.digest
    assert lines[0].startswith("cached")
    assert len(list((folder / "out").iterdir())) == 1


def test_digest_follows_everything_that_matters(garment, folder: Path, monkeypatch: pytest.MonkeyPatch):
    payload = (folder / "female_shirt.obj").read_bytes()

    def digest(**change) -> str:
        given = {"payload": payload, "avatar": FEMALE, "options": IntakeOptions(), "name": "female_shirt"}
        return intake_module.garment_digest(body=BODY, **(given | change))

    assert digest() == garment.digest
    changes = [{"payload": payload + b"\n"}, {"avatar": STANDARD}, {"options": IntakeOptions(unit="m")}, {"name": "b"}]
    options = [IntakeOptions(patches=2.0), IntakeOptions(rest="flat"), IntakeOptions(fabric="denim")]
    changes += [{"options": option} for option in (*options, IntakeOptions(uv_unit_m=2.0))]
    assert len({digest(**change) for change in [{}, *changes]}) == 9
    monkeypatch.setattr(intake_module, "INTAKE_VERSION", -1)
    assert digest() != garment.digest


def test_a_garment_of_no_named_avatar_is_in_the_cache_before_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    payload = obj_text(*shirt(BODY, BODY.v_template))
    first = intake(payload, name="plain", kind="obj", body=BODY, folder=tmp_path)
    monkeypatch.setattr(intake_module, "modelled_on", None)
    assert intake(payload, name="plain", kind="obj", body=BODY, folder=tmp_path).digest == first.digest


def test_only_cloth_of_another_body_has_the_version_of_its_way_from_there(monkeypatch: pytest.MonkeyPatch):
    def digests() -> list[str]:
        avatars = (STANDARD, None, FEMALE)
        return [intake_module.garment_digest(b"mesh", avatar, BODY, IntakeOptions(), "a") for avatar in avatars]

    before = digests()
    monkeypatch.setattr(intake_module, "MOVED_VERSION", -1)
    assert [one == other for one, other in zip(before, digests(), strict=True)] == [True, False, False]


def test_a_garment_has_as_many_patches_as_are_asked_for(garment, folder: Path):
    """On the same body, told by its mesh."""
    (folder / "body.obj").write_bytes(obj_text(AVATAR.vertices, BODY.faces))
    options = IntakeOptions(patches=2.0)
    finer = intake(folder / "female_shirt.obj", avatar=folder / "body.obj", body=BODY, options=options)
    assert "body.obj" in finer.manifest["avatar"]["source"]
    assert finer.patch_count == 2 * garment.patch_count
    assert finer.manifest["fit"]["point_rmse_m"] < garment.manifest["fit"]["point_rmse_m"]


def test_a_digest_of_before_rest_states_stays():
    options = asdict(IntakeOptions())
    kept = {name: options[name] for name in ("unit", "up")} | {"repair": False, "clearance_m": CLEARANCE_M}
    header = {"name": "a", "avatar": STANDARD, "body": BODY.digest, "options": kept, "versions": [1, 5]}
    text = json.dumps(header, sort_keys=True).encode() + b"\0" + b"mesh"
    assert intake_module.garment_digest(b"mesh", STANDARD, BODY, IntakeOptions(), "a") == sha256(text).hexdigest()


def test_a_garment_carries_its_rest_state_and_fabric(garment):
    assert garment.fabric == "jersey"
    assert garment.rest_edges.dtype == garment.rest_angle.dtype == garment.rest_stiffening.dtype == np.float32
    state = garment.rest_state()
    assert_allclose(state.face_area, meshes.face_areas(garment.vertices, garment.fine_faces), rtol=1e-3, atol=1e-9)
    assert len(state.hinge_angle) == len(meshes.hinges(garment.fine_faces))
    assert (state.hinge_angle != 0.0).mean() == pytest.approx(garment.manifest["rest"]["kept_share"])


def test_rest_and_fabric_are_as_asked_for(garment):
    numbers = {"name": "mine", **{f"{way}_n_per_m": 500.0 for way in ("warp", "weft", "shear")}, "cross_n_per_m": 9.0}
    numbers |= {f"bending_{way}_j": 1e-5 for way in ("warp", "bias", "weft")} | {"density_kg_m2": 0.2}
    rest = at_rest(plain_mesh("shirt", VERTICES, FACES), AVATAR, BODY)
    modelled = with_rest_state(garment, rest, IntakeOptions(rest="modelled", fabric=numbers))
    worn = dihedral_angles(modelled.vertices.astype(np.float64), modelled.fine_faces)
    assert_allclose(modelled.rest_state().hinge_angle, worn, rtol=0.0, atol=1e-6)
    assert modelled.fabric == numbers
    assert modelled.manifest["rest"]["kept_share"] == 1.0


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"rest": "wet"}, InputError, "rest: expected one of auto, flat, modelled, got wet. Take auto."),
        ({"fabric": "wool"}, NotFound, "fabric: expected one of .* got wool. Use one of these names"),
        ({"fabric": {"warp_n_per_m": 3.0}}, InputError, "fabric: expected numbers for the fields .* Give the missing"),
        ({"uv_unit_m": 0.0}, InputError, "uv unit: expected metres > 0, got 0. Leave it out"),
        *(({"patches": share}, InputError, "patches: expected a number from") for share in (0.5, 3.0, float("nan"))),
    ],
)
def test_impossible_options_are_refused(options: dict, error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        IntakeOptions(**options)


def test_fabrics_are_read_from_the_command_line():
    assert read_fabric("denim") == "denim"
    assert read_fabric('{"warp_n_per_m": 3}') == {"warp_n_per_m": 3}
    with pytest.raises(InputError, match=r"fabric: expected a name or a JSON object, .* Correct the JSON"):
        read_fabric("{warp: 3}")


def test_unit_and_axis_do_not_matter():
    # Bits as from centimetres: rounding decides which vertices the clearance counts as short.
    metres = at_rest(plain_mesh("shirt", VERTICES * 100.0 * UNITS_M["cm"], FACES), AVATAR, BODY)
    turned = np.stack([VERTICES[:, 0], -VERTICES[:, 2], VERTICES[:, 1]], axis=1) * 100.0
    centimetres = at_rest(plain_mesh("shirt", turned, FACES), AVATAR, BODY)
    assert_array_equal(centimetres.vertices, metres.vertices)
    assert {"converted from cm to m", "turned from z up to y up"} <= set(centimetres.mesh.notes)


def test_garment_on_the_standard_body_is_unchanged_but_for_clearance():
    vertices, faces = shirt(BODY, BODY.v_template)
    rest = at_rest(plain_mesh("shirt", vertices, faces), intake_module.avatars.standard_avatar(BODY), BODY)
    assert_allclose(rest.vertices[: len(vertices)], vertices, rtol=0, atol=1e-3)
    assert rest.figures["move_strain_mean_pct"] == 0.0


def test_dense_cloth_rests_as_thin_cloth_and_is_drawn_as_it_was():
    vertices, faces = shirt(BODY, BODY.v_template)
    while len(vertices) <= VERTEX_LIMIT:
        vertices, faces, _ = meshes.subdivide(vertices, faces)
    mesh = plain_mesh("dense", vertices, faces)
    rest = at_rest(mesh, intake_module.avatars.standard_avatar(BODY), BODY)
    assert len(rest.mesh.vertices) <= VERTEX_LIMIT
    assert rest.drawn is not None
    assert_array_equal(rest.drawn.faces, faces)


def test_unused_vertices_keep_their_places(garment, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch):
    cloths: list[RestCloth] = []
    taken_in = garment.rest_state()

    def seen(cloth: RestCloth, rest: Rest):
        cloths.append(cloth)
        return rest_of(cloth, rest)

    monkeypatch.setattr(intake_module, "rest_of", seen)
    order = rng.permutation(len(VERTICES) + 3)
    place = np.argsort(order)
    vertices = np.concatenate([VERTICES, VERTICES[:2] + 0.3, [[0.0, 0.0, 0.0]]])[order]
    faces = place[FACES]
    compact, kept = without_unused(plain_mesh("a", vertices, faces))
    assert len(compact.vertices) == len(VERTICES)
    assert_array_equal(compact.vertices[kept][np.unique(faces)], vertices[np.unique(faces)])
    garment = intake(obj_text(vertices, faces), kind="obj", name="loose", avatar=FEMALE, body=BODY)
    assert garment.vertex_count == len(vertices)
    assert_array_equal(garment.faces, faces)
    assert garment.fine_faces.max() < len(garment.vertices)
    assert_allclose(reconstructed(garment), garment.vertices, rtol=0, atol=1e-5)
    assert with_unused(garment, garment.faces, np.arange(garment.vertex_count)) is garment
    assert_allclose(garment.rest_state().face_area, taken_in.face_area, rtol=1e-3, atol=1e-9)
    # The cloth as delivered has its vertices in the same order: its edges are about as long.
    edges = meshes.unique_edges(cloths[0].faces)
    before, after = (meshes.edge_lengths(points, edges) for points in (cloths[0].modelled, cloths[0].vertices))
    assert np.quantile(np.abs(np.log(after / before)), 0.99) < 0.7


def test_used_vertices_at_one_place_stay_apart():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [9, 9, 9]])
    compact, kept = without_unused(plain_mesh("seam", vertices, [[0, 1, 2], [3, 2, 1]]))
    assert_array_equal(compact.faces, [[0, 1, 2], [3, 2, 1]])
    assert_array_equal(kept[:4], np.arange(4))


def test_smpl_avatars_are_taken():
    vertices, _ = shirt(BODY, BODY.v_template)
    told = intake(obj_text(vertices, FACES), kind="obj", name="a", avatar={"betas": [0.0]}, body=BODY)
    assert told.manifest["avatar"]["source"] == "SMPL parameters"


def test_bytes_of_a_client_name_no_files(folder: Path):
    with pytest.raises(NotFound):
        intake(obj_text(VERTICES, FACES), kind="obj", avatar=str(folder / "avatars.json"), body=BODY)


def test_garment_that_nobody_fits_in_is_refused_and_nothing_is_written(tmp_path: Path):
    (tmp_path / "unknown.obj").write_bytes(obj_text(VERTICES[:, [1, 0, 2]] * [1.0, 0.1, 3.0], FACES))
    with pytest.raises(MeshError, match=r"; at best .*\. Leave out what was said of the file .*, or say which avatar"):
        intake(tmp_path / "unknown.obj", body=BODY, folder=tmp_path / "out", options=IntakeOptions(unit="m", up="y"))
    assert not (tmp_path / "out").exists()


def test_unnamed_wearer_is_found_and_stands_in_the_manifest(tmp_path: Path):
    (tmp_path / "unknown.obj").write_bytes(obj_text(VERTICES, FACES))
    garment = intake(tmp_path / "unknown.obj", body=BODY, options=IntakeOptions(unit="m", up="y"))
    wearer = garment.manifest["wearer"]
    assert (wearer["unit"], wearer["up"], wearer["facing"]) == ("m", "y", "z")
    assert abs(wearer["height_m"] - np.ptp(AVATAR.vertices[:, 1])) < 0.15
    assert any("nobody named the avatar" in note for note in garment.manifest["notes"])


def test_command_line_prints_steps_and_refuses_with_two(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "out"
    cloth = ["--rest", "flat", "--fabric", "denim"]
    assert main([str(folder / "female_shirt.obj"), "--out", str(out), *cloth]) == 0
    printed = capsys.readouterr().out
    for word in ("avatar", "residual", "clearance", "strain", "RMSE", "normal error", "keep an angle", "stored"):
        assert word in printed
    stored = list(out.iterdir())
    assert len(stored) == 1
    garment = load_garment(stored[0])
    assert garment.vertex_count == len(VERTICES) and garment.fabric == "denim"
    assert_array_equal(garment.rest_angle, 0.0)
    (tmp_path / "broken.obj").write_bytes(obj_text(VERTICES, FACES) + b"\nf 1 2 999999\n")
    refused = (["--avatar", "nobody"], ["--fabric", "wool"], ["--uv-unit", "-1"])
    for words in (["broken.obj"], ["absent.obj"], *(["broken.obj", *option] for option in refused)):
        assert main([str(tmp_path / words[0]), *words[1:], "--out", str(out)]) == 2
        assert "expected" in capsys.readouterr().err
    assert list(out.iterdir()) == stored
    for words in (["--unit", "foot"], ["--up", "x"], ["--rest", "wet"]):
        with pytest.raises(SystemExit, match="2"):
            main([str(folder / "female_shirt.obj"), *words])
        assert "choose from" in capsys.readouterr().err


def test_without_out_a_garment_goes_where_the_service_looks(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    went: list[Path] = []
    monkeypatch.setattr("drape.garment.intake.intake_outfit", lambda source, **options: went.append(options["folder"]))
    assert main([str(folder / "female_shirt.obj")]) == 0
    assert went == [OWN_GARMENTS_DIR]


def test_names_are_plain():
    named = {"Female T-shirt (2)": "female_t_shirt_2", "../../etc/x": "etc_x", "A" * 99: "a" * 64}
    assert {text: garment_name(text) for text in named} == named
    with pytest.raises(InputError, match="--name"):
        garment_name("../..")


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", GARMENTS)
def test_real_garment_comes_clear_with_little_strain(name: str, data: Path):
    path = data / "garments" / f"{name}.obj"
    if not path.is_file():
        pytest.skip(f"No garments/{name}.obj in DRAPE_DATA: docs/guide/data.md says where to get it.")
    mesh = intake_module.read_mesh(path)
    meaning = intake_module.avatars.parse_avatar(None, beside=path)
    rest = at_rest(mesh, intake_module.avatars.read_avatar(meaning, BODY), BODY)
    signed = signed_distance(rest.vertices, BODY.v_template, BODY.faces)
    assert signed.min() >= CLEARANCE_M
    assert len(rest.vertices) >= 3000
    assert_array_equal(np.sort((rest.drawn or rest).faces, axis=1), np.sort(mesh.faces, axis=1))
    # Measured: moved 5 to 11 %, pushed 0.6 to 3.6 %.
    assert rest.figures["move_strain_mean_pct"] < 12.0
    assert rest.figures["push_strain_mean_pct"] < 4.5
