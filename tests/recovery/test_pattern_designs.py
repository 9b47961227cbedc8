"""Designs of the catalogue and bases of a recovery: seams that match, sizes that grow, refusals, and panels that start
without stretch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.cloth.fabric_table import FABRICS
from drape.errors import InputError
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import closest_point
from recovery.catalogue.cuts import CATALOGUE
from recovery.pattern import geometry
from recovery.pattern.bases import BASES, dress, skirt, sleeved_dress, tank, trousers, tshirt
from recovery.pattern.design import Dart, Design, check_laid_flat, check_seams, waist_with_darts
from recovery.pattern.drafting import Cone, Flutes, Tube
from recovery.pattern.measurements import GROWTH_M, in_size, measure_body
from recovery.pattern.pattern_mesh import mesh_pattern
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.skirts import SkirtCut, a_line, circle, panelled_skirt
from recovery.pattern.tops import CAP_EASE, Sleeve, TopCut, cap, lines, top
from recovery.pattern.trousers import LegCut
from recovery.pattern.trousers import trousers as legs
from recovery.run.target import shape_body
from tests.recovery.pattern_setup import default_measurements

OPENINGS = {
    **dict.fromkeys(("tshirt", "longsleeve", "tank", "dress", "sweat"), 4),
    **dict.fromkeys(("trousers", "slim_trousers", "shorts"), 3),
    **dict.fromkeys(("skirt", "circle_skirt"), 2),
    "shirt": 4,  # the collar's edge runs round the neck opening
}


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_garment_sews_up_to_one_surface_with_its_openings(name):
    made = CATALOGUE[name](default_measurements())
    check_seams(made)
    check_laid_flat(made)
    assert made.fabric in FABRICS and made.pattern.name == name
    assert len(made.seam_names) == len(made.pattern.stitches)
    mesh = mesh_pattern(made.pattern, 0.05)
    assert mesh_graphs.connected_components(mesh.faces, mesh.node_count).max() == 0
    assert len(meshes.boundary_loops(mesh.faces)) == OPENINGS[name]
    # What is not sewn is a hem or an opening, and named so.
    free = [made.edge_names[ref] for ref in made.pattern.edge_refs() if ref not in made.pattern.sewn]
    assert free and all(named.startswith(("hem", "opening")) for named in free)


@pytest.mark.parametrize("name", CATALOGUE)
def test_sizes_grow_by_the_grade_and_their_seams_still_match(name):
    body = default_measurements()
    areas = []
    for size in ("S", "XXL"):
        made = CATALOGUE[name](in_size(body, size))
        check_seams(made)
        areas.append(sum(geometry.area(panel) for panel in made.pattern.panels))
    assert (np.diff(areas) > 0.0).all()


def test_the_grade_adds_eight_centimetres_to_a_girth_and_nothing_to_m():
    body = default_measurements()
    assert in_size(body, "M") is body
    large = in_size(body, "XL")
    assert_allclose(large.chest_girth - body.chest_girth, 0.16)
    assert_allclose(large.girth_at(0.0) - body.girth_at(0.0), 2 * GROWTH_M["waist_girth"])
    assert in_size(body, "S").hip_girth < body.hip_girth
    assert_allclose([in_size(body, size).longer_m for size in ("S", "M", "XL")], [-0.02, 0.0, 0.04])


def without_ease(made: Design, seam: str) -> Design:
    return replace(made, eased={name: share for name, share in made.eased.items() if name != seam})


def lengths(points: np.ndarray, place) -> np.ndarray:
    """Lengths in the world over those on the table, of short steps from ``points`` in two directions."""
    step = 1e-5
    return np.array(
        [
            np.linalg.norm(place(points + step * way) - place(points), axis=1) / step
            for way in (np.array([1.0, 0.0]), np.array([0.0, 1.0]))
        ]
    )


def test_a_tube_keeps_lengths_and_turns_the_right_side_outward():
    tube = Tube((0.1, 0.2, 0.3), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.07)
    points = np.random.default_rng(0).uniform(-0.15, 0.15, (50, 2))
    assert_allclose(lengths(points, tube.place), 1.0, atol=1e-4)
    world = tube.place(points)
    assert_allclose(np.linalg.norm(world[:, 1:] - [0.2, 0.3], axis=1), 0.07)
    flat = tube.tangent(points[0])
    assert_allclose(flat.apply(np.zeros((1, 2)))[0], world[0], atol=1e-12)
    assert flat.matrix()[:, 2] @ (world[0] - [world[0, 0], 0.2, 0.3]) > 0.069


def test_flutes_keep_the_length_of_every_circle():
    ring = Flutes((0.0, 1.0, 0.0), 0.13, 0.7, 9)
    for radius in (0.13, 0.3, 0.7):
        angle = np.linspace(-np.pi, np.pi, 4001)
        points = radius * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
        world = ring.place(points)
        length = np.linalg.norm(np.diff(world, axis=0), axis=1).sum()
        assert_allclose(length, 2.0 * np.pi * radius, rtol=0.06)  # the unevenness of flutes adds a little
    assert world[:, 1].max() < 0.6  # the hem hangs


def test_a_cone_goes_round_its_circle_and_opens_downward():
    cone = Cone((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), 0.1, 0.35, 0.7)
    angle = np.linspace(-0.6, 0.6, 7)
    inner, outer = (np.stack([r * np.sin(angle), 0.35 - r * np.cos(angle)], axis=1) for r in (0.35, 0.40))
    assert_allclose(np.hypot(*cone.place(inner)[:, [0, 2]].T), 0.1, atol=1e-12)
    assert_allclose(np.hypot(*cone.place(outer)[:, [0, 2]].T), 0.1 + 0.7 * 0.05, atol=1e-12)
    assert_allclose(np.linalg.norm(cone.place(outer) - cone.place(inner), axis=1), 0.05)
    assert (cone.place(outer)[:, 1] < 0.0).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda body: in_size(body, "XXXL"), "size: expected one of S, M, L, XL, XXL, got XXXL"),
        (lambda body: check_seams(without_ease(CATALOGUE["sweat"](body), "hemband_seam")), "seam hemband_seam of"),
        (lambda body: check_laid_flat(circle(body, SkirtCut("wide", "satin", 0.85))), r"panel front of wide: .*1\.5"),
        (lambda body: top(body, TopCut("t", "jersey", 0.66, -0.1)), "t: expected ease"),
        (lambda body: lines(body, TopCut("t", "jersey", 0.2, 0.1)), "t: expected ease"),
        (lambda body: top(body, TopCut("t", "jersey", 0.66, 0.1, Sleeve(0.05, 0.08, 0.36))), "sleeve: expected longer"),
        (
            lambda body: top(body, TopCut("t", "jersey", 0.66, 0.1, Sleeve(0.2, 0.30, 0.36))),
            "sleeve: expected an upper",
        ),
        (lambda body: cap([0.2, 0.2], 0.6), "sleeve: expected an upper arm"),
        (lambda body: legs(body, LegCut("t", "twill", -0.4, 0.5, 0.5)), "t: hip_ease_m"),
        (lambda body: legs(body, LegCut("t", "twill", 0.05, 0.5, 0.3)), "t: knee_girth_m"),
        (lambda body: legs(body, LegCut("t", "twill", 0.05, 0.2, 0.5)), "t: hem_girth_m"),
        (lambda body: a_line(body, SkirtCut("s", "twill", 0.2)), "s: expected ease at the hips"),
        (lambda body: circle(body, SkirtCut("s", "satin", 1.2)), "s: length_m"),
        (lambda body: waist_with_darts("w", (0.1, 0.0), (0.0, 0.0), [Dart(0.5, 0.09, 0.1)]), "dart 0 of w"),
        # Bases.
        (lambda body: tshirt(body, length_m=-1.0), r"length_m: expected a length in \(0, 3\) m"),
        (lambda body: tshirt(body, length_m=0.2), "one below the other"),
        (lambda body: tshirt(body, length_m=66.0), "length_m: expected a length"),
        (lambda body: tshirt(body, length_m=np.nan), "length_m: expected a length"),
        (lambda body: tshirt(body, neck_out_m=0.2), "outside the other"),
        (lambda body: tshirt(body, chest_ease_m=-0.05), "Add ease"),
        (lambda body: tshirt(body, sleeve_arm_ease_m=0.0), "wider than the arm's"),
        (lambda body: tshirt(body, sleeve_arm_ease_m=0.2), "Lower the armhole"),
        (lambda body: tshirt(body, sleeve_length_m=0.05), "Lengthen the sleeve"),
        (lambda body: tshirt(body, sleeve_hem_girth_m=0.05), "a hem of 0"),
        (
            lambda body: tshirt(body, sleeve_hem_m=0.3),
            "--set: expected one of length_m, .*sleeve_hem_girth_m, got sleeve_hem_m",
        ),
        (lambda body: trousers(body, hip_ease_m=-0.6), "Add ease"),
        (lambda body: trousers(body, hem_girth_m=0.2), "hem_girth_m: expected at least"),
        (lambda body: trousers(body, rise_drop_m=0.3), "a waist above the hips"),
        (lambda body: trousers(body, inseam_m=0.02, hem_girth_m=0.3), "Lengthen the legs"),
        (lambda body: skirt(body, length_m=0.1), "a waist above and a hem below them"),
        (lambda body: skirt(body, drop_m=0.4), "a waist above and a hem below them"),
        (lambda body: skirt(body, hip_ease_m=-0.1), "Add ease"),
        (lambda body: skirt(body, panels=2.5), "panels: expected a whole number from 2 to 12, got 2.5"),
        (lambda body: panelled_skirt(body, SkirtCut("s", "twill", 0.55, drop_m=0.05, panels=1)), "two panels or more"),
        (lambda body: tshirt(body, panels=4), "--set: expected one of"),
        (lambda body: tank(body, sleeve_length_m=0.2), "--set: expected one of"),
        (lambda body: dress(body, waist_drop_m=0.24), "underarm, waist, hips, hem one below the other"),
        (lambda body: dress(body, hip_ease_m=-0.1), "dress: expected ease at the hips"),
        (lambda body: dress(body, gather=-0.1), "no gather below 0"),
        (lambda body: dress(body, length_m=0.6), "underarm, waist, hips, hem one below the other"),
    ],
)
def test_cuts_that_no_garment_has_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make(default_measurements())


def patterns() -> dict[str, Pattern]:
    body = default_measurements()
    return {
        "tshirt": tshirt(body),
        "long": tshirt(body, length_m=1.05, flare_m=0.12),
        "tank": tank(body),
        "dress": dress(body),
        "sleeved_dress": sleeved_dress(body, waist_drop_m=-0.1, hip_ease_m=0.4),
        "trousers": trousers(body),
        "shorts": trousers(body, inseam_m=0.25, hem_girth_m=0.62),
        "skirt": skirt(body),
        "gores": skirt(body, panels=8.0, flare_m=0.2),
        "spread": skirt(body, spread=1.0, flare_m=0.12),
        "half_spread": skirt(body, spread=0.5, panels=4.0),
    }


def test_seams_of_the_bases_match():
    for pattern in patterns().values():
        geometry.check_pattern(pattern)
        for seam in geometry.seams(pattern):
            upper = seam.stitch.second.panel.removeprefix("bodice_")
            is_cap = "sleeve" in seam.stitch.first.panel and upper in ("front", "back")
            assert_allclose(seam.mismatch, -CAP_EASE / (1.0 + 0.5 * CAP_EASE) if is_cap else 0.0, rtol=0, atol=1e-8)
            ends = geometry.stitch_ends(pattern, seam.stitch).sum()
            assert ends < geometry.stitch_ends(pattern, seam.stitch, reverse=True).sum()


def mirrored(name: str, count: int) -> str:
    """The panel on the other side of the wearer; gores are numbered round from the front."""
    if name.startswith("gore_"):
        return f"gore_{(count + 1 - int(name[5:])) % count + 1}"
    return name.replace("left", "right") if "left" in name else name.replace("right", "left")


def test_left_and_right_are_mirror_images():
    for pattern in patterns().values():
        world = {panel.name: panel.placement.apply(geometry.outline(panel)) for panel in pattern.panels}
        for name, points in world.items():
            other = world[mirrored(name, len(world))]
            image = points * [-1.0, 1.0, 1.0]
            gap = np.linalg.norm(image[:, None] - other[None], axis=2).min(axis=1)
            assert gap.max() < 1e-3


def test_a_tank_has_straps_as_narrow_as_its_shoulders_are_set():
    """A strap's seam runs from the side of the neck to the shoulder's tip: across what both settings leave."""
    measured = default_measurements()
    front = tank(measured, shoulder_out_m=-0.055, neck_out_m=0.025).panel("front")
    seams = sorted(geometry.edge_length(front, number) for number in range(len(front.edges)))[:2]
    across = measured.shoulder_x - 0.055 - measured.neck_half_width - 0.025
    assert_allclose(seams, np.hypot(across, 0.025 - 0.6 * 0.025), rtol=1e-9)
    assert seams[0] < 0.035


@pytest.mark.parametrize("name", ["tshirt", "trousers", "skirt", "tank", "dress"])
def test_a_base_is_sewn_into_a_garment_that_clears_the_body(body, name):
    pattern = patterns()[name]
    mesh = mesh_pattern(pattern, 0.04)
    assert len(meshes.boundary_loops(mesh.faces)) == OPENINGS[name]
    assert min(mesh.smallest_angles_deg().values()) > 23.0
    placed = mesh.placed()
    nearest = closest_point(placed, body.v_template, body.faces)
    normals = meshes.face_normals(body.v_template, body.faces)[nearest.face]
    outside = ((placed - nearest.point) * normals).sum(axis=1)
    assert outside.min() > 0.0 and nearest.distance.min() > 0.02
    # The right side of every triangle looks away from the body.
    look = meshes.face_normals(placed, mesh.panel_faces)[:, 2]
    assert (look * placed[mesh.panel_faces[:, 0], 2] > 0.0).all()


def test_finished_girths_are_the_body_and_its_ease():
    body = default_measurements()
    front = patterns()["tshirt"].panel("front")
    assert_allclose(np.ptp(front.vertices[:, 0]), 0.5 * (body.chest_girth + 0.10), rtol=1e-12)
    pants = patterns()["trousers"]
    lower = {}
    for panel in pants.panels:
        world = panel.placement.apply(panel.vertices)
        by_name = {"hem": 1, "waist": 4} if panel.name in ("front_left", "back_right") else {"hem": 4, "waist": 1}
        for side, number in by_name.items():
            lower[side] = lower.get(side, 0.0) + geometry.edge_length(panel, number)
        assert world[:, 1].min() > body.ankle_y
    assert_allclose(lower["hem"], 2.0 * 0.44, rtol=1e-12)
    assert_allclose(lower["waist"], body.girth_at(body.waist_y - 0.09) + 0.01, rtol=3e-3)
    hem = [geometry.edge_length(panel, 0) for panel in patterns()["skirt"].panels]
    assert_allclose(hem, 2.0 * (0.25 * (body.hip_girth + 0.06) + 0.08), rtol=5e-3)


def test_a_longer_tshirt_is_a_dress_and_shorter_trousers_are_shorts():
    all_patterns = patterns()
    for long, short, panel in (("long", "tshirt", "front"), ("trousers", "shorts", "front_left")):
        heights = [np.ptp(all_patterns[name].panel(panel).vertices[:, 1]) for name in (long, short)]
        assert heights[0] > heights[1] + 0.3
    sleeves = [all_patterns[name].panel("sleeve_left_front").vertices for name in ("long", "tshirt")]
    assert_allclose(sleeves[0], sleeves[1])


def test_gores_have_the_girths_of_a_skirt_of_two_panels():
    body = default_measurements()
    two, eight = skirt(body), skirt(body, panels=8.0)
    assert len(eight.panels) == 8 and len(eight.stitches) == 16
    for number, tolerance in ((0, 0.01), (3, 0.01)):  # hem and waist, which are arcs
        girths = [sum(geometry.edge_length(panel, number) for panel in made.panels) for made in (two, eight)]
        assert_allclose(girths[1], girths[0], rtol=tolerance)
    mesh = mesh_pattern(eight, 0.05)
    assert len(meshes.boundary_loops(mesh.faces)) == 2


def test_a_spread_skirt_is_a_ring_and_keeps_its_girths():
    made = {share: skirt(default_measurements(), flare_m=0.12, spread=share) for share in (0.0, 0.5, 1.0)}
    hem, waist = ([[geometry.edge_length(p, n) for p in one.panels] for one in made.values()] for n in (0, 3))
    assert_allclose(hem, [hem[0]] * 3, rtol=6e-3)
    assert_allclose(waist, [waist[0]] * 3, rtol=6e-3)
    swing, even = [], []
    for one in made.values():
        panel = one.panel("front")
        low, high = panel.vertices[1:3]  # of the side seam; both meet in the ring's centre
        centre = low - low[0] / (high - low)[0] * (high - low)
        points = geometry.outline(panel)
        radius = np.linalg.norm(points[points[:, 1] <= low[1]] - centre, axis=1)
        swing.append(low[1] - points[:, 1].min())
        even.append(np.ptp(radius))
    assert swing[0] < swing[1] < swing[2] and swing[2] > 0.05
    assert even[2] < 0.004 < even[0]


def test_a_dress_has_the_girths_of_body_and_ease():
    body = default_measurements()
    made = dress(body, waist_ease_m=0.05, hip_ease_m=0.09)
    bodice, lower = made.panel("bodice_front"), made.panel("skirt_front")
    assert_allclose(np.ptp(bodice.vertices[:, 0]), 0.5 * (body.chest_girth + 0.08))
    widths = np.sort(np.unique(np.round(2.0 * np.abs(lower.vertices[:, 0]), 9)))
    assert_allclose(widths[:2], [0.5 * (body.waist_girth + 0.05), 0.5 * (body.hip_girth + 0.09)], atol=1e-8)
    for seam in geometry.seams(dress(body, gather=0.3)):
        waist = "bodice" in seam.stitch.first.panel and "skirt" in seam.stitch.second.panel
        assert_allclose(seam.second_m / seam.first_m, 1.3 if waist else 1.0, rtol=1e-9)


@pytest.mark.parametrize("shape", [(2.0,), (-2.0,), (0.0, 2.0), (0.0, -2.0, 1.0)])
def test_bases_fit_other_bodies(shape):
    body = measure_body(shape_body(load_body(), np.array(shape)))
    for base in BASES.values():
        pattern = base(body)
        geometry.check_pattern(pattern)
        assert max(abs(seam.mismatch) for seam in geometry.seams(pattern)) < 0.02
