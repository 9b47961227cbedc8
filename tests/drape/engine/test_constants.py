"""Numbers that stand in the engine and in Python are the same.

Python has those that it makes tables with, those of formulas that graphs and training have as well, and those of
references. All others are the engine's alone.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

import pytest

from tests.architecture.repository import ROOT
from tests.drape.engine.source_constants import source_constants

# By header and module: names, and NAME=OTHER where Python's has another name.
SAME = {
    ("rows", "drape.engine.library"): "LANES",
    ("dense", "drape.network.dense"): "OUTPUTS",
    ("tiles", "drape.network.tiled"): "TILE_INPUTS=INPUTS TILE_GROUP=GROUP",
    ("body", "drape.body.skeleton"): "JOINTS=JOINT_COUNT PARENTS",
    ("body", "drape.body.features"): "STATIC_PER_JOINT",
    ("body", "drape.contact.samples"): "REGION_SIZE",
    ("body", "drape.graph.packed_inputs"): "PART_SIZE",
    ("patches", "drape.geometry.jets"): "PLANE=IN_PLANE_COUNT HEIGHT=HEIGHT_COUNT JETS=JET_COUNT FULL=FULL_COUNT",
    ("patches", "drape.garment.consensus"): "MEMBERS FIT=FIT_COUNT",
    ("patches", "drape.garment.patch_features"): "JOINT_REACH_M",
    ("patches", "training.layers"): "SEEN=SURROUNDINGS_COUNT",
    ("network", "drape.graph.packed_inputs"): "TILE_COLUMNS=COLUMNS TILE_CHARTS=CHARTS_PER_TILE",
    ("motion", "training.recurrent"): "REFERENCE_DT_S MOTION_LIMIT=INPUT_LIMIT LEAST_SIZE=TINY",
    ("felt", "drape.garment.consensus"): "POINTS=STRAIN_POINTS TRACE_SHARE",
    ("felt", "model_export.packed.strain"): "SOFTENING",
    ("felt", "training.layers"): "STRAIN=STRAIN_COUNT",
    ("felt", "drape.contact.field"): "BANDWIDTH_M",
    ("felt", "drape.contact.proximity"): "UNIT_M HELD_M SOFT_M FELT_GAP_M=GAP_M DEEP_LOW_M,DEEP_HIGH_M=DEEP_M",
    ("felt", "drape.contact.projection"): "BESIDE_LOW_M2,BESIDE_HIGH_M2=BESIDE_M2 AGREE_LOW,AGREE_HIGH=AGREEMENT "
    "REGION_BIAS_M2",
    ("push", "drape.contact.projection"): "CHARTS=CHARTS_PER_VERTEX TERMS PUSH_WIDTH=TILE_WIDTH HAS_OTHER JET_OVER "
    "LARGEST_PUSH_M DEPTH_LOW_M,DEPTH_HIGH_M=DEPTH_M",
    ("push", "drape.contact.push_tables"): "PUSH_GROUP=GROUP_SIZE",
    ("push", "drape.contact.field"): "LEAST_WEIGHT,LEAST_NORMALS=LEAST_WEIGHTS",
    ("push", "drape.contact.samples"): "CLUSTER_SIZE",
    ("push", "drape.contact.cloth_samples"): "CLOTH_MEMBERS=MEMBERS",
    ("colliders", "drape.geometry.colliders"): "CENTRE AXES HALF RADIUS COLLIDER=ROW",
    ("collapse", "drape.cloth.coarse_mesh"): "LINES",
    ("levels", "drape.live.coarse_weights"): "NEAREST",
    ("room", "drape.live.room"): "ROOM_M BOUND_M2",
    ("walks", "drape.live.skin_walks"): "NEIGHBOURS",
    ("untangle", "drape.live.untangle"): "BORDER OTHERS",
    ("turns", "drape.live.swing_mesh"): "SHARED",
    ("carry", "tests.reference.carry"): "CARRY_PASSES",
    ("swing", "drape.cloth.hanging"): "GRAVITY_M_S2",
    ("levels", "tests.reference.carry"): "FINE_PASSES",
    ("swing", "drape.live.clock"): "PAUSE_S SHORTEST_STEP_S",
    ("folds", "drape.live.fold_constants"): "HOLD",
    ("folds", "drape.contact.projection"): "MOVED_M",
    ("quantise", "drape.wire.messages"): "FLAT_M",
    ("frame_steps", "drape.network.frame"): "MOST_LAYERS",
    ("folds", "tests.reference.folds"): "FIRST_STEP_S",
    ("sweeps", "tests.reference.folds"): "SLIP_M",
    ("whole", "tests.reference.folds"): "CLAMP_M",
    ("skin", "tests.reference.skin"): "TURNS NEARER REACH_M BESIDE FREE HOLLOW_M APART_M",
    ("walks", "tests.reference.skin"): "WALK_STEPS=STEPS ALONG_STEPS ALONG",
    ("residual", "tests.reference.folds"): "FORGET LACK HEM MEND_M",
    ("room", "tests.reference.folds"): "SPACING KEPT KEPT_M",
    ("lift", "tests.reference.folds"): "OTHER_SHARE=OTHER DEEP_M TOO_DEEP_M",
    ("limit", "tests.reference.folds"): "LONGEST SHORTEST LIMIT_PASSES",
    ("pace", "tests.reference.pace"): "MOMENTUM FAST_MOMENTUM STIFF_MOMENTUM SETTLING_MOMENTUM LONG_ROUNDS SLOW_M "
    "FAST_M STIFF_N_PER_M SHAKEN SHAKEN_M_S",
    ("folds", "tests.reference.pace"): "FADE_S",
    ("swing_nodes", "tests.reference.swing"): "COMPRESSED",
    ("apart", "tests.drape.exact.test_apart"): "KEPT SLIGHT_M",
    ("blended_planes", "tests.drape.exact.test_blended_planes"): "WIDTH_M FADED",
    ("folds", "tests.drape.live.folds_setup"): "FAR_M CUT_M",
    ("layers", "tests.drape.live.test_ceiling"): "FADE_M CEILING_GAP_M=GAP_M COVERS_M=HIGHEST_M LEAST_OVER_M=LEAST_M",
    ("layers", "tests.drape.live.test_raised_skin"): "CLOSE_M HIGHEST_M STEEPEST",
    ("colliders", "tests.drape.live.test_colliders"): "THIN_M",
    ("eased", "tests.drape.live.test_eased"): "EASED_S",
    ("swing", "tests.drape.live.test_swing_step"): "STILL_S",
    ("untangle", "tests.drape.live.test_untangle"): "WAY_M MOST_PAIRS",
}
# Of the same name and number, by chance, with another meaning.
OTHERS = {("drape.exact.path", "HOLD_N_PER_M"), ("drape.cloth.problem", "REACH_M"), ("drape.exact.newton", "REACH_M")}


@pytest.mark.parametrize(("header", "module"), SAME)
def test_a_number_of_the_engine_is_that_of_python(header: str, module: str):
    engine, python = source_constants(), import_module(module)
    for names in SAME[header, module].split():
        theirs, _, ours = names.partition("=")
        values = tuple(engine[header, name] for name in theirs.split(","))
        there = getattr(python, ours or theirs)
        assert (values if len(values) > 1 else next(iter(values))) == there, f"{header}.hpp: {names}"


def test_a_number_that_is_shared_is_held():
    """A constant of the core with the name and the number of one of the engine's is in the table above."""
    numbers = {(name, value) for (_, name), value in source_constants().items() if isinstance(value, int | float)}
    held = {(module, names.partition("=")[2] or names) for (_, module), all_ in SAME.items() for names in all_.split()}
    for path in sorted((ROOT / "drape").rglob("*.py")):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        found = {(module, name) for name, value in literals(path) if (name, value) in numbers}
        assert found <= held | OTHERS, "put them into SAME, or import the other one"


def literals(path: Path) -> list[tuple[str, float]]:
    """The names and numbers that a module sets to literals."""
    found = []
    for node in ast.parse(path.read_text()).body:
        if not isinstance(node, ast.Assign):
            continue
        for target in node.targets:
            pairs = [(target, node.value)]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = list(zip(target.elts, node.value.elts, strict=True))
            for name, value in pairs:
                if isinstance(name, ast.Name) and isinstance(value, ast.Constant) and name.id.isupper():
                    found.append((name.id, value.value))
    return found
