"""The cut that a target tells: its base, where its openings lie, girths between, the panels of its texture."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.errors import InputError
from drape.garment.cache import load_garment
from drape.garment.contours import TRUNK
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.geometry import meshes
from recovery.catalogue.cuts import CATALOGUE
from recovery.fit.grading import in_other_size
from recovery.fit.objective import ease_left
from recovery.pattern import geometry
from recovery.pattern.bases import BASES
from recovery.pattern.coordinates import control_points, with_controls
from recovery.pattern.measurements import in_size
from recovery.pattern.pattern_mesh import mesh_pattern
from recovery.pattern.shirts import FALL_M, STAND_M
from recovery.pattern.style import NO_STYLE, Style
from recovery.run.cut import (
    Cut,
    SeenGarment,
    below,
    collarless,
    differences,
    girth_round,
    has_collar,
    panel_count,
    pieces,
    ring_panels,
    tell_base,
)
from recovery.run.draft import RANGES, draft_near, own_settings, read_settings
from recovery.run.job import style_pattern
from recovery.run.target import OF_TOPS, close_but_openings, long_contours
from tests.drape.cloth.cloth_shapes import round_tube
from tests.recovery.pattern_setup import bent_cap, default_measurements

SHIPPED = Path("drape/assets/garments")
CUTS = {
    "tshirt": "tshirt",
    "longsleeve": "tshirt",
    "sweat": "tshirt",
    "shirt": "tshirt",
    "tank": "tank",
    "dress": "sleeved_dress",
    "trousers": "trousers",
    "shorts": "trousers",
    "skirt": "skirt",
    "circle_skirt": "skirt",
}


@cache
def worn(name: str) -> GarmentMesh:
    """A garment of the catalogue on the shipped body in the T-pose."""
    (path,) = SHIPPED.glob(f"{name}-*.npz")
    garment = load_garment(path)
    return plain_mesh(name, garment.vertices, garment.faces)


def seen(mesh: GarmentMesh) -> SeenGarment:
    joints = load_body().joints_template
    return SeenGarment(mesh.vertices, mesh.faces, joints, joints)


@pytest.mark.parametrize("name", CUTS)
def test_the_base_is_told_by_openings_and_their_places(name):
    assert tell_base(seen(worn(name)), default_measurements()) == CUTS[name]


def test_a_sleeveless_dress_is_told_from_one_with_sleeves():
    tank = worn("tank")
    low = tank.vertices[:, 1] < 0.1
    longer = replace(tank, vertices=tank.vertices - np.where(low, 0.3, 0.0)[:, None] * [0.0, 1.0, 0.0])
    assert tell_base(seen(longer), default_measurements()) == "dress"


@pytest.mark.parametrize(
    ("low", "high", "base"), [(-0.5, 0.15, "skirt"), (-0.05, 0.38, "tube"), (-0.5, 0.38, "strapless_dress")]
)
def test_what_begins_at_the_chest_is_a_tube_or_a_strapless_dress_and_is_drafted_there(low, high, base):
    body = default_measurements()
    mesh = plain_mesh("tube", *round_tube([0.19] * 21, np.linspace(low, high, 21), 40))
    assert tell_base(seen(mesh), body) == base
    pattern, settings = draft_near(base, body, seen(mesh), {})
    if base != "skirt":
        tops = [panel.placement.apply(panel.vertices)[:, 1].max() for panel in pattern.panels]
        assert_allclose(max(tops), high, rtol=0, atol=0.005)
        assert_allclose(settings["length_m"], body.neck_y - low, rtol=0, atol=1e-6)


def test_a_cape_and_a_top_with_one_sleeve_have_no_base():
    joints = load_body().joints_template
    cape = plain_mesh("cape", *round_tube(np.linspace(0.5, 0.12, 21).tolist(), np.linspace(0.2, 0.57, 21), 40))
    with pytest.raises(InputError, match=r"2 round the trunk, the upper one at the neck.*--base FILE\.json"):
        tell_base(SeenGarment(cape.vertices, cape.faces, joints, joints), default_measurements())
    tshirt = seen(worn("tshirt"))
    del tshirt.openings["left_arm"]
    with pytest.raises(InputError, match="got 1 round the right arm, 2 round the trunk"):
        tell_base(tshirt, default_measurements())


def test_holes_in_the_cloth_do_not_hide_the_kind():
    """A T-shirt with a hole of 12 cm in front and one behind has six long borders and is a top."""
    tee = worn("tshirt")
    middle = tee.vertices[tee.faces].mean(axis=1)
    chest = middle[(np.abs(middle[:, 0]) < 0.05) & (np.abs(middle[:, 1] - 0.2) < 0.05)]
    places = [chest[chest[:, 2].argmax()], chest[chest[:, 2].argmin()]]
    away = np.min([np.linalg.norm(middle - place, axis=1) for place in places], axis=0)
    holed = tee.take_faces(np.flatnonzero(away > 0.06))
    assert len(long_contours(holed)) == 6 and close_but_openings(holed, load_body().joints_template)[1] == OF_TOPS


def test_a_collar_is_told_from_a_neckline():
    body = default_measurements()
    told = {
        name: has_collar(worn(name), seen(worn(name)), body) for name in ("tshirt", "sweat", "tank", "dress", "shirt")
    }
    assert told == {"tshirt": False, "sweat": False, "tank": False, "dress": False, "shirt": True}
    raised = worn("tshirt")
    ring = seen(raised).openings[TRUNK][0].contour.loop
    vertices = raised.vertices.copy()
    vertices[ring, 1] += 0.06
    standing = replace(raised, vertices=vertices)
    assert has_collar(standing, seen(standing), body)


def test_a_collar_is_cut_off_at_the_neck_and_said():
    body, shirt = load_body(), worn("shirt")
    found, (words,), width = collarless(shirt, body, body.joints_template, OF_TOPS)
    assert "cut off at the neck" in words and f"about {100 * width:.0f} cm wide" in words
    assert 0.0 < width - STAND_M - FALL_M < 0.025  # its points and its longer outer edge count as well
    cut, whole = seen(found), seen(shirt)
    assert cut.counts() == whole.counts() == OF_TOPS
    assert not has_collar(found, cut, default_measurements())
    neck, edge = (one.openings[TRUNK][0].contour.length_m for one in (cut, whole))
    assert neck < 0.8 * edge and neck < 7.2 * default_measurements().neck_half_width  # 1.3 times round the neck
    # Below the neck nothing is gone, and what has no collar stays as it is.
    low = shirt.vertices[shirt.faces].mean(axis=1)[:, 1] < default_measurements().underarm_y
    kept = found.vertices[found.faces].mean(axis=1)[:, 1] < default_measurements().underarm_y
    assert kept.sum() == low.sum()
    tshirt = worn("tshirt")
    assert collarless(tshirt, body, body.joints_template, OF_TOPS) == (tshirt, (), 0.0)
    assert collarless(worn("skirt"), body, body.joints_template, {TRUNK: 2})[1] == ()


def test_a_mesh_is_cut_along_a_plane():
    tube = plain_mesh("tube", *round_tube([0.1] * 5, [0.0, 0.1, 0.2, 0.3, 0.4], 24))
    cut = below(tube, tube.vertices[:, 1] - 0.27)
    assert_allclose(cut.vertices[:, 1].max(), 0.27)
    whole, left = (meshes.face_areas(one.vertices, one.faces).sum() for one in (tube, cut))
    assert_allclose(left, 0.27 / 0.4 * whole)
    assert len(meshes.boundary_loops(cut.faces)) == 2


def test_a_girth_is_the_length_of_the_loop_round_a_point():
    vertices, faces = round_tube([0.2] * 9, np.linspace(-0.4, 0.4, 9), 200)
    up, inside = np.array([0.0, 1.0, 0.0]), np.array([0.05, 0.03, 0.02])
    assert girth_round(vertices, faces, inside, up) == pytest.approx(0.4 * np.pi, rel=1e-3)
    assert girth_round(vertices, faces, np.array([0.5, 0.03, 0.0]), up) is None
    assert girth_round(vertices, faces, np.array([0.0, 2.0, 0.0]), up) is None
    two = np.concatenate([vertices, vertices * [1.5, 1.0, 1.5]])
    both = np.concatenate([faces, faces + len(vertices)])
    assert girth_round(two, both, inside, up) == pytest.approx(0.6 * np.pi, rel=1e-3)


READINGS_M = {  # what garments of the catalogue were cut with, and how far their readings may be off
    "tank": {"length_m": 0.64, "neck_depth_m": 0.15, "shoulder_out_m": -0.052, "chest_ease_m": 0.05},
    "tshirt": {"length_m": 0.65, "sleeve_length_m": 0.225, "sleeve_arm_ease_m": 0.085, "chest_ease_m": 0.10},
    "longsleeve": {"length_m": 0.65, "sleeve_hem_girth_m": 0.213, "chest_ease_m": 0.08},
    "trousers": {"knee_girth_m": 0.66, "hem_girth_m": 0.72, "hip_ease_m": 0.13},
    "shorts": {"inseam_m": 0.20, "hem_girth_m": 0.64, "hip_ease_m": 0.10},
    "skirt": {"length_m": 0.585, "hip_ease_m": 0.06},
    "dress": {"length_m": 1.02, "gather": 0.25, "waist_drop_m": -0.057, "chest_ease_m": 0.14, "sleeve_length_m": 0.2},
}


@pytest.mark.parametrize("name", READINGS_M)
def test_settings_are_read_off_a_garment_within_centimetres(name):
    told = read_settings(CUTS[name], default_measurements(), seen(worn(name)))
    for key, value in READINGS_M[name].items():
        assert_allclose(told[key], value, atol=0.036, err_msg=key)


@pytest.mark.parametrize("name", CUTS)
def test_a_base_is_drafted_near_its_target_and_keeps_what_is_given(name):
    body, there = default_measurements(), seen(worn(name))
    given = {"length_m": 0.777} if "length_m" in BASES[CUTS[name]].settings else {"inseam_m": 0.333}
    pattern, settings = draft_near(CUTS[name], body, there, given)
    assert pattern.name == CUTS[name] and given.items() <= settings.items()
    assert all(RANGES[key][0] <= value <= RANGES[key][1] for key, value in settings.items() if key not in given)
    told = read_settings(CUTS[name], body, there)
    own = own_settings(CUTS[name], body, told)
    assert sum(settings[key] == told[key] for key in told) > 0.7 * len(own)


def test_shaped_legs_have_a_knee_and_straight_ones_none():
    body = default_measurements()
    assert "knee_girth_m" not in read_settings("trousers", body, seen(worn("shorts")))
    straight, shaped = BASES["trousers"](body), draft_near("trousers", body, seen(worn("trousers")), {})[0]
    assert [len(panel.edges) for panel in straight.panels] == [6] * 4
    assert [len(panel.edges) for panel in shaped.panels] == [8] * 4 and len(shaped.stitches) == 12


def test_where_nothing_can_be_drafted_the_last_refusal_is_told():
    with pytest.raises(InputError, match="an upper arm of"):
        draft_near("tshirt", default_measurements(), seen(worn("tshirt")), {"sleeve_arm_ease_m": 0.9})


def laid_out(count: int) -> GarmentMesh:
    """A skirt of ``count`` panels, sewn in thought: its panels as they stand, with the texture of the cloth."""
    mesh = mesh_pattern(BASES["skirt"](default_measurements(), panels=float(count)), 0.08)
    shift = mesh.panel[:, None] * np.array([2.0, 0.0])
    plain = plain_mesh("skirt", mesh.placed(), mesh.panel_faces)
    return replace(plain, uv=0.1 * (mesh.rest + shift), uv_faces=mesh.panel_faces)


def test_a_texture_laid_out_as_panels_counts_them_and_another_does_not():
    assert [pieces(laid_out(count)) for count in (2, 8)] == [2, 8]
    mesh = laid_out(8)
    assert pieces(replace(mesh, uv=np.zeros((0, 2)), uv_faces=np.zeros((0, 3), int))) is None
    assert pieces(replace(mesh, uv=mesh.uv**3)) is None
    assert pieces(replace(mesh, uv=0.0 * mesh.uv)) is None


def test_a_skirt_takes_its_panels_from_the_texture():
    assert panel_count("skirt", 8) == {"panels": 8.0}
    assert panel_count("skirt", None) == panel_count("skirt", 2) == panel_count("skirt", 99) == {}
    assert panel_count("trousers", 8) == {}


def test_what_differs_from_the_target_has_a_sentence():
    body = default_measurements()
    skirt, shirt = worn("skirt"), worn("shirt")
    two, eight = (BASES["skirt"](body, panels=count) for count in (2.0, 8.0))
    (unseen,) = differences("skirt", two, seen(skirt), body, None)
    assert "does not show its seams" in unseen
    assert differences("skirt", eight, seen(skirt), body, 8) == ()
    (other,) = differences("skirt", two, seen(skirt), body, 8)
    assert "8 panels, this pattern has 2" in other
    (kind,) = differences("tank", BASES["tank"](body), seen(shirt), body, 2)
    assert "--base tshirt" in kind
    assert differences("mine.json", two, seen(skirt), body, 2) == ()


@pytest.mark.parametrize("name", sorted(BASES))
def test_a_recovered_pattern_grows_as_its_base_does_and_can_still_be_sewn(name):
    body = default_measurements()
    base = BASES[name](body)
    controls = control_points(base)
    moved = with_controls(base, controls, 1.03 * controls.positions)  # what a search might find
    areas = []
    for size in ("S", "M", "L", "XL", "XXL"):
        made = in_other_size(moved, name, body, {}, size)
        geometry.check_pattern(made)
        assert np.abs(ease_left(made, base)).max() < 1e-9
        areas.append(sum(geometry.area(panel) for panel in made.panels))
    assert (np.diff(areas) > 0.0).all()
    assert_allclose(areas[1], sum(geometry.area(panel) for panel in moved.panels), rtol=1e-9)
    same = in_other_size(base, name, body, {}, "XXL")
    grown = sum(geometry.area(panel) for panel in BASES[name](in_size(body, "XXL")).panels)
    assert_allclose(sum(geometry.area(panel) for panel in same.panels), grown, rtol=5e-3)


def test_a_pattern_of_a_file_does_not_say_how_it_grows():
    with pytest.raises(InputError, match="--sizes: expected a base that is drafted"):
        in_other_size(BASES["skirt"](default_measurements()), "mine.json", default_measurements(), {}, "L")


def test_panels_of_a_base_that_are_closed_to_a_ring_are_named():
    sleeves = CATALOGUE["longsleeve"](default_measurements()).pattern
    assert ring_panels(sleeves) == ["sleeve_left", "sleeve_right", "neckband"]
    darts = CATALOGUE["trousers"](default_measurements()).pattern
    assert ring_panels(darts) == ["waistband"]
    shirt = worn("tshirt")
    (words, *_) = differences("own.json", sleeves, seen(shirt), default_measurements(), None)
    assert words.startswith("Of the base sleeve_left, sleeve_right, neckband begin flat")


def test_a_target_with_a_collar_gets_one_and_what_has_no_room_is_left_out():
    pattern = BASES["tshirt"](default_measurements())
    cut = Cut("tshirt", by_openings=True, settings={}, differs=(), collar_m=0.08)
    warnings: list[str] = []
    style, with_lines, made = style_pattern(NO_STYLE, cut, pattern, warnings)
    assert cut.called == "tshirt" and replace(cut, base="patterns/own.json").called == "own.json"
    assert style.words() == "collar 8 cm" and with_lines is pattern and made.panels[-1].name == "collar"
    assert "neither draped nor fitted" in warnings[0] and "8.0 cm wide" in warnings[0]
    assert style_pattern(Style({"collar": 0.05}), cut, pattern, [])[0].words() == "collar 5 cm"
    plain = replace(cut, collar_m=0.0)
    assert style_pattern(NO_STYLE, plain, pattern, warnings) == (NO_STYLE, pattern, pattern)
    assert style_pattern(Style({"cuffs": 0.4}), plain, pattern, warnings) == (NO_STYLE, pattern, pattern)
    assert len(warnings) == 2 and warnings[1].startswith("The style lines (cuffs 40 cm) were left out: ")
    style_pattern(Style({"rib_neck": 0.02}), plain, pattern, ribs := [])
    assert "(rib neck by 12%)" in ribs[0] and "neither draped nor fitted" in ribs[0]
    joined = style_pattern(Style({}, whole_sleeves=True), plain, bent_cap(pattern), warnings)[2]
    assert len(joined.panels) == 4 and "that of sleeve_left by" in warnings[2] and "draw them fair" in warnings[2]
