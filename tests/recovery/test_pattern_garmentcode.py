"""The JSON of Garment-Pattern-Generator and GarmentCode: every form is read, and what is written is read back."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import InputError, NotFound
from recovery.pattern import garmentcode, geometry
from recovery.pattern.sewing_pattern import EdgeKind, EdgeRef, Pattern
from tests.recovery.pattern_setup import assert_same_pattern, curved, rectangle, tube

# A front and a back in centimetres; the back runs clockwise: its outside looks backwards.
SPEC = {
    "pattern": {
        "panels": {
            "front": {
                "vertices": [[-20, 0], [20, 0], [20, 50], [-20, 50]],
                "edges": [
                    {"endpoints": [0, 1]},
                    {"endpoints": [1, 2], "curvature": {"type": "cubic", "params": [[0.3, 0.05], [0.6, -0.02]]}},
                    {"endpoints": [2, 3], "curvature": {"type": "circle", "params": [25.0, 0, 0]}},
                    {"endpoints": [3, 0], "curvature": [0.5, 0.1], "label": "side"},
                ],
                "translation": [0, 90, 25],
                "rotation": [0, 0, 0],
                "label": "body",
            },
            "back": {
                "vertices": [[-20, 0], [20, 0], [20, 50], [-20, 50]],
                "edges": [
                    {"endpoints": [1, 0]},
                    {"endpoints": [0, 3], "curvature": {"type": "quadratic", "params": [[0.5, -0.1]]}},
                    {"endpoints": [3, 2]},
                    {"endpoints": [2, 1]},
                ],
                "translation": [3, 90, -20],
                "rotation": [10, 20, 30],
            },
        },
        "stitches": [
            [{"panel": "front", "edge": 1}, {"panel": "back", "edge": 3}],
            [{"panel": "front", "edge": 3}, {"panel": "back", "edge": 1}, "right_wrong"],
        ],
        "panel_order": ["back", "front"],
    },
    "parameters": {
        "wide": {
            "type": "additive_length",
            "value": 2,
            "range": [-5, 10],
            "influence": [{"panel": "back", "edge_list": [{"id": 0, "along": [1, 1], "direction": "both"}]}],
        },
        "bend": {"type": "curve", "value": 1, "range": [0, 1], "influence": [{"panel": "back", "edge_list": [1]}]},
    },
    "parameter_order": ["wide", "bend"],
    "properties": {"curvature_coords": "relative", "normalize_panel_translation": False, "units_in_meter": 100},
}


def spec() -> dict:
    return copy.deepcopy(SPEC)


def test_lengths_become_metres_and_every_form_of_curve_is_read():
    pattern = garmentcode.pattern_from_spec(spec(), name="shirt")
    front = pattern.panel("front")
    assert_allclose(front.vertices, [[-0.2, 0], [0.2, 0], [0.2, 0.5], [-0.2, 0.5]])
    assert_allclose(front.placement.translation_m, (0, 0.9, 0.25))
    assert [edge.kind for edge in front.edges] == [EdgeKind.LINE, EdgeKind.CUBIC, EdgeKind.CIRCLE, EdgeKind.QUADRATIC]
    assert front.label == "body" and front.edges[3].label == "side"
    # Radius 25 over a chord of 40: the arc rises by 25 - 15 to the left, into the panel.
    assert_allclose(front.edges[2].handles, [(0.5, 0.25)])
    assert_allclose(geometry.edge_points(front, 2, np.array([0.5])), [[0.0, 0.4]], atol=1e-15)
    assert pattern.panel_order == ("back", "front")
    assert [stitch.right_to_wrong for stitch in pattern.stitches] == [False, True]
    assert pattern.stitches[1].second == EdgeRef("back", 1)


def test_a_clockwise_panel_is_mirrored_and_stays_where_it_was():
    pattern = garmentcode.pattern_from_spec(spec())
    back, entry = pattern.panel("back"), SPEC["pattern"]["panels"]["back"]
    assert geometry.area(back) > 0.0
    given = replace(rectangle("given"), vertices=np.array(entry["vertices"]) / 100.0)
    placement = replace(back.placement, rotation_deg=(10.0, 20.0, 30.0), translation_m=(0.03, 0.9, -0.2))
    assert_allclose(back.placement.apply(back.vertices), placement.apply(given.vertices), atol=1e-15)
    assert_allclose(back.placement.matrix()[:, 2], -placement.matrix()[:, 2], atol=1e-15)
    # The curve too: to the right of the upward edge in the file, so outwards.
    middle = geometry.edge_points(back, 1, np.array([0.5]))
    assert_allclose(back.placement.apply(middle), placement.apply(np.array([[-0.175, 0.25]])), atol=1e-15)


def test_a_front_that_is_drawn_clockwise_is_the_one_that_is_drawn_counter_clockwise():
    """Its outside looks forward either way, so seams, curves and labels are the same."""
    entry = spec()
    given = garmentcode.pattern_from_spec(entry, name="shirt")
    front = garmentcode.backward(given.panel("front"))
    drawn = Pattern("shirt", (front, given.panel("back")))
    other = garmentcode.pattern_to_spec(drawn)
    clockwise = copy.deepcopy(entry)
    clockwise["pattern"]["panels"]["front"] = other["pattern"]["panels"]["front"]
    for stitch, number in zip(clockwise["pattern"]["stitches"], (2, 0), strict=True):
        stitch[0]["edge"] = number  # edges 1 and 3 of four, counted the other way
    assert geometry.area(front) < 0.0
    got = garmentcode.pattern_from_spec(clockwise, name="shirt")
    assert_same_pattern(got, replace(given, template={}))
    assert [note.split(";")[0] for note in got.notes] == [
        "panel front runs clockwise in the file",
        "panel back runs clockwise in the file",
        "template parameters are left out, since edges are numbered anew",
    ]
    assert len(given.notes) == 1


def trapeze(params: list) -> dict:
    """The front alone with straight sides, its top 10 cm wide and an arc with ``params``."""
    entry = spec()
    entry["pattern"].update(stitches=[], panel_order=None)
    del entry["pattern"]["panels"]["back"]
    front = entry["pattern"]["panels"]["front"]
    front["vertices"][2:] = [[5, 20], [-5, 20]]
    front["edges"] = [{"endpoints": [start, (start + 1) % 4]} for start in range(4)]
    front["edges"][2]["curvature"] = {"type": "circle", "params": params}
    return entry


@pytest.mark.parametrize(("large", "right"), [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_an_arc_is_the_one_of_svg_seen_with_y_up(large, right):
    front = garmentcode.pattern_from_spec(trapeze([5.5, large, right])).panel("front")
    rise = np.sqrt(5.5**2 - 5.0**2)
    height = 5.5 + rise if large else 5.5 - rise
    # The edge runs from right to left, so its left is below.
    expected = 0.2 + 0.01 * (height if right else -height)
    assert_allclose(geometry.edge_points(front, 2, np.array([0.5])), [[0.0, expected]], rtol=0, atol=1e-15)


def test_a_flat_arc_is_a_line_and_a_rounded_half_circle_is_one():
    assert garmentcode.pattern_from_spec(trapeze([1e15, 0, 0])).panel("front").edges[2].kind is EdgeKind.LINE
    rounded = garmentcode.pattern_from_spec(trapeze([5.0 * (1.0 - 1e-7), 0, 1])).panel("front").edges[2]
    assert_allclose(rounded.handles, [(0.5, -0.5)], rtol=1e-6)


def test_absolute_control_points_are_read_as_relative_ones():
    relative, absolute = spec(), spec()
    absolute["properties"]["curvature_coords"] = "absolute"
    for name, panel in absolute["pattern"]["panels"].items():
        read = garmentcode.pattern_from_spec(relative).panel(name)
        for number, edge in enumerate(panel["edges"]):
            if read.edges[number].kind in (EdgeKind.LINE, EdgeKind.CIRCLE):
                continue
            start, end = (np.array(panel["vertices"][vertex], dtype=float) for vertex in edge["endpoints"])
            chord = end - start
            flip = -1.0 if name == "back" else 1.0
            points = [
                (start + along * chord + flip * left * np.array([-chord[1], chord[0]])).tolist()
                for along, left in read.edges[number].handles
            ]
            edge["curvature"] = points[0] if number == 3 else {"type": read.edges[number].kind.value, "params": points}
    assert_same_pattern(garmentcode.pattern_from_spec(absolute), garmentcode.pattern_from_spec(relative), 1e-14)


def test_other_units_and_a_given_unit():
    other = spec()
    other["properties"]["units_in_meter"] = 200
    half = garmentcode.pattern_from_spec(other)
    assert_allclose(half.panel("front").vertices * 2.0, garmentcode.pattern_from_spec(spec()).panel("front").vertices)
    assert half.template["parameters"]["wide"]["value"] == 0.01
    assert_same_pattern(garmentcode.pattern_from_spec(other, units_in_meter=100), garmentcode.pattern_from_spec(spec()))


def test_centring_moves_the_origin_to_the_mean_corner():
    entry = spec()
    entry["properties"]["normalize_panel_translation"] = True
    front = garmentcode.pattern_from_spec(entry).panel("front")
    assert_allclose(front.vertices.mean(axis=0), 0.0, atol=1e-16)
    assert_allclose(front.placement.apply(front.vertices)[:, 1].min(), 0.9)


def test_template_parameters_are_carried_in_metres_and_mirrored_with_their_panel():
    pattern = garmentcode.pattern_from_spec(spec())
    wide = pattern.template["parameters"]["wide"]
    assert (wide["value"], wide["range"]) == (0.02, [-0.05, 0.1])
    assert wide["influence"][0]["edge_list"][0]["along"] == [-1, 1]
    written = garmentcode.pattern_to_spec(pattern)
    assert_allclose(written["parameters"]["wide"]["range"], [-5, 10])
    assert written["parameter_order"] == ["wide", "bend"]
    assert SPEC["parameters"]["wide"]["value"] == 2  # the input is not touched


def everything() -> list[Pattern]:
    kinds = list(EdgeKind)
    turned = tuple(kinds[2:] + kinds[:2])
    return [
        garmentcode.pattern_from_spec(spec(), name="shirt"),
        replace(tube(), material="twill"),
        Pattern("curved", (curved(), curved("other", turned)), panel_order=("other", "curved")),
    ]


@pytest.mark.parametrize("units", [1.0, 100.0, 300.0, 1000.0])
def test_what_is_written_is_read_back(units, tmp_path):
    for pattern in everything():
        path = garmentcode.write_pattern(pattern, tmp_path / "deep" / "specification.json", units_in_meter=units)
        assert_same_pattern(garmentcode.read_pattern(path), pattern)
        assert list(path.parent.iterdir()) == [path]


def test_comments_are_skipped_but_not_inside_strings(tmp_path):
    entry = spec()
    entry["properties"]["drape"] = {"name": "a//b", "material": "wool"}
    text = json.dumps(entry, indent=1).replace('"panels": {', '"panels": { // the pieces "of" cloth\n')
    path = tmp_path / "commented.json"
    path.write_text("// a template\n" + text)
    pattern = garmentcode.read_pattern(path)
    assert (pattern.name, pattern.material) == ("a//b", "wool")


@pytest.mark.parametrize(
    ("name", "expected"), [("tee.json", "tee"), ("tee_specification.json", "tee"), ("template.json", "jacket")]
)
def test_a_pattern_is_named_by_its_file_or_a_generic_file_by_its_folder(name, expected, tmp_path):
    path = tmp_path / "jacket" / name
    path.parent.mkdir()
    path.write_text(json.dumps(SPEC))
    assert garmentcode.read_pattern(path).name == expected


def change(entry: dict, path: str, value) -> dict:
    *parents, last = path.split(".")
    owner = entry
    for key in parents:
        owner = owner[int(key)] if isinstance(owner, list) else owner[key]
    if value is KeyError:
        del owner[last]
    elif isinstance(owner, list):
        owner[int(last)] = value
    else:
        owner[last] = value
    return entry


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("properties", KeyError, "properties"),
        ("pattern", [], "pattern"),
        ("pattern.panels", KeyError, "panels"),
        ("pattern.panels.front", 3, "vertices"),
        ("pattern.panels.front.vertices", [[0, 0, 0]], "vertices"),
        ("pattern.panels.front.vertices", "round", "vertices"),
        ("pattern.panels.front.vertices.0.0", "wide", "vertices"),
        ("pattern.panels.front.vertices.0.0", float("nan"), "finite"),
        ("pattern.panels.front.edges.0.endpoints", [0], "endpoints"),
        ("pattern.panels.front.edges.0.endpoints", [0, 9], "endpoints"),
        ("pattern.panels.front.edges.1.curvature.type", "spline", "type out of"),
        ("pattern.panels.front.edges.1.curvature", 0.5, "type out of"),
        ("pattern.panels.front.edges.1.curvature.params", [[0.5, 0.1]], "handles"),
        ("pattern.panels.front.edges.1.curvature.params", None, "curvature"),
        ("pattern.panels.front.edges.2.curvature.params", [19.0, 0, 0], "half the chord"),
        ("pattern.panels.front.translation", [0, 0], "translation"),
        ("pattern.panels.front.translation", [[0, 0, 0], [1, 1, 1]], "translation"),
        ("pattern.panels.front.rotation", [0, 0, None], "rotation"),
        ("pattern.panels.front.rotation", None, "rotation"),
        ("pattern.stitches.0", [{"panel": "front", "edge": 1}], "two sides"),
        ("pattern.stitches.0.1.edge", "one", "two sides"),
        ("pattern.stitches.0", "front", "two sides"),
        ("pattern.stitches.0.1.edge", 7, "edges that the pattern has"),
        ("pattern.panel_order", ["front"], "panel_order"),
        ("properties.units_in_meter", KeyError, "units_in_meter"),
        ("properties.units_in_meter", 0, "units_in_meter"),
        ("properties.units_in_meter", True, "units_in_meter"),
        ("properties.units_in_meter", 1, "units_in_meter"),  # centimetres read as metres
        ("properties.curvature_coords", "polar", "curvature_coords"),
        ("pattern.panels.front.edges.0.endpoints", [0, float("nan")], "endpoints"),
        ("pattern.stitches", 3, "stitches: expected a list, got int"),
        ("pattern.panel_order", "front", "panel_order: expected a list"),
        ("properties.drape", [1], "drape: expected an object"),
        ("parameters", [1], "template parameters"),
        ("parameters", {"length": {"type": "additive_length", "influence": []}}, "template parameters"),
    ],
)
def test_what_is_no_pattern_is_refused_with_the_place(path, value, message):
    with pytest.raises(InputError, match=message):
        garmentcode.pattern_from_spec(change(spec(), path, value))


def test_files_that_are_missing_or_no_json_are_refused(tmp_path):
    with pytest.raises(NotFound, match="Check the path"):
        garmentcode.read_pattern(tmp_path / "nothing.json")
    for content in (b"{", b"\xff\xfe\x00", b"[1, 2]"):
        path = tmp_path / "broken.json"
        path.write_bytes(content)
        with pytest.raises(InputError):
            garmentcode.read_pattern(path)


@pytest.mark.data
def test_every_pattern_of_the_data_folder_goes_through(pattern_files):
    for path in pattern_files:
        pattern = garmentcode.read_pattern(path)
        read_back = garmentcode.pattern_from_spec(json.loads(json.dumps(garmentcode.pattern_to_spec(pattern))))
        assert_same_pattern(read_back, pattern)
        assert all(geometry.area(panel) > 0.0 for panel in pattern.panels)
        assert max(abs(seam.mismatch) for seam in geometry.seams(pattern)) < 0.02
