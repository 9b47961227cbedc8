"""Reads and writes the JSON of Garment-Pattern-Generator (Korosteleva and Lee 2021) and GarmentCode (2023).

Both let the direction of an outline say which side of the cloth is outside; here every panel is counter-clockwise, so a
clockwise one is mirrored about its y axis and turned by half a turn, which leaves it where it was, with the edges'
numbers. Where that would turn the right side to the wearer the outline was merely drawn backwards, and is run the other
way, its edges numbered anew. Either is noted.
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from drape.errors import InputError, NotFound
from drape.files.atomic import write_whole
from recovery.pattern.geometry import TOUCH_M, area, check_pattern, on_chord
from recovery.pattern.sewing_pattern import Edge, EdgeKind, EdgeRef, Panel, PanelPlacement, Pattern, Stitch

FILE_UNITS_IN_METER = 100.0
OWN_KEY = "drape"  # inside "properties": name and material, which the format has no place for
TEMPLATE_KEYS = ("parameters", "parameter_order", "constraints", "constraint_order")
GENERIC_NAMES = ("specification", "template", "prediction")
RADIUS_SLACK = 1e-6  # a radius this much short of half the chord is a rounded half circle
RIGHT_WRONG = "right_wrong"
FLAT_ARC = 1e-12  # height per chord below which an arc is a line

_COMMENT = re.compile(r'("(?:\\.|[^"\\])*")|//[^\n]*')


def read_pattern(path: str | Path, *, units_in_meter: float | None = None) -> Pattern:
    """Returns the pattern in the JSON file at ``path``, checked; ``units_in_meter`` overrides what the file says.

    Lines may hold ``//`` comments. Raises ``NotFound`` for no file and ``InputError`` for what is not a pattern.
    """
    path = Path(path)
    if not path.is_file():
        raise NotFound("pattern", expected="a JSON file", got=f"{path}", cure="Check the path.")
    try:
        text = _COMMENT.sub(lambda match: match.group(1) or "", path.read_text(encoding="utf-8"))
        spec = json.loads(text)
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(
            f"{path.name}", expected="JSON", got=f"{error}", cure="Export it again as a pattern specification."
        ) from error
    stem = path.stem.removesuffix("_specification")
    name = path.resolve().parent.name if stem in GENERIC_NAMES else stem
    return pattern_from_spec(spec, name=name, units_in_meter=units_in_meter)


def pattern_from_spec(spec: Any, *, name: str = "pattern", units_in_meter: float | None = None) -> Pattern:
    """Returns the checked pattern of a specification ``spec`` as JSON types. ``name`` serves where it has none;
    ``units_in_meter`` overrides its own. Raises ``InputError`` for what is not a pattern."""
    properties = _member(spec, "properties", dict, "specification")
    body = _member(spec, "pattern", dict, "specification")
    units = properties.get("units_in_meter") if units_in_meter is None else units_in_meter
    if not isinstance(units, int | float) or isinstance(units, bool) or not 0.0 < units < np.inf:
        raise InputError(
            "units_in_meter",
            expected="how many of the file's units make a metre",
            got=f"{units}",
            cure="Write it into the file's properties, or pass it: 100 for centimetres.",
        )
    coordinates = properties.get("curvature_coords", "relative")
    if coordinates not in ("relative", "absolute"):
        raise InputError(
            "curvature_coords", expected="relative or absolute", got=f"{coordinates}", cure="Correct the properties."
        )
    centre = bool(properties.get("normalize_panel_translation", False))
    panels, turned, backwards, notes = [], set(), {}, []
    for panel_name, entry in _member(body, "panels", dict, "pattern").items():
        panel = _read_panel(panel_name, entry, float(units), coordinates == "absolute", centre)
        if area(panel) < 0.0:
            other_side = mirror_panel(panel)
            if _faces_wearer(other_side):
                panel = backward(panel)
                backwards[panel_name] = len(panel.edges)
            else:
                panel = other_side
                turned.add(panel_name)
            notes.append(f"panel {panel_name} runs clockwise in the file; it was turned round")
        panels.append(panel)
    order = None if body.get("panel_order") is None else _member(body, "panel_order", list, "pattern")
    stitches = _member(body, "stitches", list, "pattern", [])
    parts = {key: spec[key] for key in TEMPLATE_KEYS if key in spec}
    if backwards and any(parts.values()):
        notes.append("template parameters are left out, since edges are numbered anew")
    own = _member(properties, OWN_KEY, dict, "properties", {})
    pattern = Pattern(
        name=str(own.get("name", name)),
        panels=tuple(panels),
        stitches=tuple(_read_stitch(number, entry, backwards) for number, entry in enumerate(stitches)),
        material=str(own.get("material", "")),
        panel_order=None if order is None else tuple(order),
        # Templates name edges by numbers that hold no more where an outline was run backwards.
        template={} if backwards else _template(parts, 1.0 / float(units), turned),
        notes=tuple(notes),
    )
    check_pattern(pattern)
    return pattern


def mirror_panel(panel: Panel) -> Panel:
    """Returns ``panel`` seen from its other side: in the same place in the world, its outline in the opposite sense,
    its normal reversed."""
    matrix = panel.placement.matrix() @ np.diag([-1.0, 1.0, -1.0])
    return replace(
        panel,
        vertices=panel.vertices * [-1.0, 1.0],
        edges=tuple(edge.reflected() for edge in panel.edges),
        placement=replace(panel.placement, rotation_deg=_euler_deg(matrix)),
    )


def backward(panel: Panel) -> Panel:
    """Returns ``panel`` with its outline run the other way: edge n of N becomes edge N - 1 - n."""
    edges = tuple(
        replace(e, start=e.end, end=e.start, handles=tuple((1.0 - along, -left) for along, left in e.handles[::-1]))
        for e in panel.edges[::-1]
    )
    return replace(panel, edges=edges)


def _faces_wearer(panel: Panel) -> bool:
    """Whether the right side of the placed panel looks towards the axis of the body."""
    across = [0, 2]
    middle = panel.placement.apply(panel.vertices.mean(axis=0)[None])[0]
    return float(panel.placement.matrix()[across, 2] @ middle[across]) < -TOUCH_M


def _euler_deg(matrix: np.ndarray) -> tuple[float, float, float]:
    angles = Rotation.from_matrix(matrix).as_euler("xyz", degrees=True, suppress_warnings=True)
    return (float(angles[0]), float(angles[1]), float(angles[2]))


# --- reading ---------------------------------------------------------------------------------------------------------


def _member(owner: Any, key: str, kind: type, where: str, default: Any = None) -> Any:
    value = owner.get(key, default) if isinstance(owner, Mapping) else None
    if not isinstance(value, kind):
        raise InputError(
            f"{where}: {key}",
            expected="an object" if kind is dict else f"a {kind.__name__}",
            got="nothing" if value is None else f"{type(value).__name__}",
            cure="Compare with a specification of Garment-Pattern-Generator or GarmentCode.",
        )
    return value


def _numbers(values: Any, shape: tuple[int | None, ...], where: str) -> np.ndarray:
    """``values`` as float64 of ``shape``, where None admits any length."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(())
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = " x ".join("any" if want is None else str(want) for want in shape)
        raise InputError(where, expected=f"{wanted} numbers", got=f"{values}", cure="Correct the entry.")
    return array


def _read_panel(name: str, entry: Any, units: float, absolute: bool, centre: bool) -> Panel:
    where = f"panel {name}"
    vertices = _numbers(_member(entry, "vertices", list, where), (None, 2), f"{where}: vertices")
    edges = []
    for number, item in enumerate(_member(entry, "edges", list, where)):
        edges.append(_read_edge(f"{where}: edge {number}", item, vertices, absolute))
    translation = _numbers(entry.get("translation", [0, 0, 0]), (3,), f"{where}: translation")
    rotation = _numbers(entry.get("rotation", [0, 0, 0]), (3,), f"{where}: rotation")
    if centre:  # as the format's own loader does it, in the plane of the unturned panel
        middle = vertices.mean(axis=0)
        vertices, translation = vertices - middle, translation + np.append(middle, 0.0)
    placed = translation / units
    return Panel(
        name=name,
        vertices=vertices / units,
        edges=tuple(edges),
        placement=PanelPlacement(
            (float(rotation[0]), float(rotation[1]), float(rotation[2])),
            (float(placed[0]), float(placed[1]), float(placed[2])),
        ),
        label=entry.get("label"),
    )


def _read_edge(where: str, entry: Any, vertices: np.ndarray, absolute: bool) -> Edge:
    ends = _numbers(_member(entry, "endpoints", list, where), (2,), f"{where}: endpoints")
    start, end = (int(value) for value in np.nan_to_num(ends, nan=-1.0))
    if not (0 <= start < len(vertices) and 0 <= end < len(vertices)):
        raise InputError(
            where, expected=f"vertices in [0, {len(vertices)})", got=f"{[start, end]}", cure="Correct the endpoints."
        )
    kind, handles = EdgeKind.LINE, []
    curvature = entry.get("curvature")
    if isinstance(curvature, list):  # the older form: one point of a quadratic curve
        curvature = {"type": "quadratic", "params": [curvature]}
    if curvature is not None:
        kinds = [kind.value for kind in EdgeKind if kind is not EdgeKind.LINE]
        if not isinstance(curvature, Mapping) or curvature.get("type") not in kinds:
            raise InputError(
                f"{where}: curvature", expected=f"a type out of {kinds}", got=f"{curvature}", cure="Correct the entry."
            )
        kind = EdgeKind(curvature["type"])
        params = curvature.get("params")
        chord = vertices[end] - vertices[start]
        if kind is EdgeKind.CIRCLE:
            height = _arc_height(_numbers(params, (3,), f"{where}: curvature"), chord, where)
            handles = [(0.5, height)]
            if abs(height) < FLAT_ARC:
                kind, handles = EdgeKind.LINE, []
        else:
            points = _numbers(params, (None, 2), f"{where}: curvature")
            handles = on_chord(points, vertices[start], vertices[end]) if absolute else points.tolist()
    return Edge(start, end, kind, tuple(handles), entry.get("label"))


def _arc_height(params: np.ndarray, chord: np.ndarray, where: str) -> float:
    """Signed height per chord of the arc (radius, more than half a circle, to the right of the chord)."""
    radius, large, right = params
    half = 0.5 * float(np.linalg.norm(chord))
    if not radius >= half * (1.0 - RADIUS_SLACK):
        raise InputError(
            f"{where}: curvature",
            expected=f"a radius of at least half the chord, {half:.6g}",
            got=f"{radius:.6g}",
            cure="Enlarge the radius.",
        )
    root = float(np.sqrt(max(radius * radius - half * half, 0.0)))
    height = (radius + root if large else half * half / (radius + root)) / (2.0 * half)
    return -height if right else height


def _read_stitch(number: int, entry: Any, backwards: Mapping[str, int]) -> Stitch:
    where = f"stitch {number}"
    sides = [side for side in entry if side != RIGHT_WRONG] if isinstance(entry, list) else []
    named = [isinstance(side, Mapping) and "panel" in side and isinstance(side.get("edge"), int) for side in sides]
    if named != [True, True]:
        raise InputError(
            where,
            expected="two sides, each with a panel and the number of an edge",
            got=f"{entry}",
            cure="Split it into stitches of two edges.",
        )
    counts = [backwards.get(str(side["panel"]), 0) for side in sides]
    numbers = [
        n - 1 - side["edge"] if 0 <= side["edge"] < n else side["edge"] for side, n in zip(sides, counts, strict=True)
    ]
    first, second = (EdgeRef(str(side["panel"]), n) for side, n in zip(sides, numbers, strict=True))
    return Stitch(first, second, right_to_wrong=RIGHT_WRONG in entry)


def _template(parts: dict[str, Any], scale: float, turned: set[str]) -> dict[str, Any]:
    """Template parameters with lengths times ``scale``, and directions of ``turned`` panels mirrored. Refuses
    (``InputError``) parameters of another form."""
    parts = copy.deepcopy(parts)
    try:
        _change_template(parts, scale, turned)
    except (AttributeError, IndexError, KeyError, TypeError) as error:
        cure = "Compare with a template of Garment-Pattern-Generator, or leave the parameters out."
        raise InputError(
            "template parameters", expected="those of a template", got=f"{type(error).__name__}: {error}", cure=cure
        ) from error
    return parts


def _change_template(parts: dict[str, Any], scale: float, turned: set[str]) -> None:
    for entry in [*parts.get("parameters", {}).values(), *parts.get("constraints", {}).values()]:
        if entry.get("type") == "additive_length":
            entry["value"] = entry["value"] * scale
            entry["range"] = [bound * scale for bound in entry["range"]]
        for influence in entry.get("influence", []):
            for item in influence["edge_list"] if influence["panel"] in turned else []:
                if isinstance(item, dict) and "along" in item:
                    item["along"] = [-item["along"][0], item["along"][1]]


# --- writing ---------------------------------------------------------------------------------------------------------


def pattern_to_spec(pattern: Pattern, *, units_in_meter: float = FILE_UNITS_IN_METER) -> dict[str, Any]:
    """Returns the specification of ``pattern`` as JSON types, from which ``pattern_from_spec`` reads the same
    pattern."""
    body: dict[str, Any] = {
        "panels": {panel.name: _panel_entry(panel, units_in_meter) for panel in pattern.panels},
        "stitches": [_stitch_entry(stitch) for stitch in pattern.stitches],
    }
    if pattern.panel_order is not None:
        body["panel_order"] = list(pattern.panel_order)
    template = _template(dict(pattern.template), units_in_meter, set())
    properties = {
        "curvature_coords": "relative",
        "normalize_panel_translation": False,
        "normalized_edge_loops": True,
        "units_in_meter": units_in_meter,
        OWN_KEY: {"name": pattern.name, "material": pattern.material},
    }
    return {"pattern": body, "parameters": {}, "parameter_order": [], **template, "properties": properties}


def write_pattern(pattern: Pattern, path: str | Path, *, units_in_meter: float = FILE_UNITS_IN_METER) -> Path:
    """Writes the specification of ``pattern`` to ``path`` as JSON, and returns the path."""
    return write_whole(Path(path), json.dumps(pattern_to_spec(pattern, units_in_meter=units_in_meter), indent=2) + "\n")


def _panel_entry(panel: Panel, units: float) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "translation": [value * units for value in panel.placement.translation_m],
        "rotation": list(panel.placement.rotation_deg),
        "vertices": (panel.vertices * units).tolist(),
        "edges": [_edge_entry(edge, panel, units) for edge in panel.edges],
    }
    return entry if panel.label is None else {**entry, "label": panel.label}


def _edge_entry(edge: Edge, panel: Panel, units: float) -> dict[str, Any]:
    entry: dict[str, Any] = {"endpoints": [edge.start, edge.end]}
    if edge.kind is EdgeKind.CIRCLE:
        length = float(np.linalg.norm(panel.vertices[edge.end] - panel.vertices[edge.start])) * units
        height = edge.handles[0][1]
        radius = length * (0.25 + height * height) / (2.0 * abs(height))
        entry["curvature"] = {"type": edge.kind.value, "params": [radius, int(abs(height) > 0.5), int(height < 0.0)]}
    elif edge.kind is not EdgeKind.LINE:
        entry["curvature"] = {"type": edge.kind.value, "params": [list(handle) for handle in edge.handles]}
    return entry if edge.label is None else {**entry, "label": edge.label}


def _stitch_entry(stitch: Stitch) -> list[Any]:
    entry: list[Any] = [{"panel": side.panel, "edge": side.edge} for side in (stitch.first, stitch.second)]
    return [*entry, RIGHT_WRONG] if stitch.right_to_wrong else entry
