"""Stored optima come back as they were, and whatever they depend on makes them miss."""

from __future__ import annotations

from dataclasses import fields, replace
from types import ModuleType

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from benchmarks.shared import physics, physics_cache
from benchmarks.shared.physics_cache import cache_key, cached
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from tests.benchmarks.quality.quality_setup import bending, body, tube
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere

ARGUMENTS = {
    "garment": tube(),
    "body": body(),
    "poses": bending(2),
    "material": material(),
    "step_limit": 2000,
    "tolerance": physics.TOLERANCE,
}


STATE = tube().rest_state()
RESTS = (
    STATE,
    replace(STATE, edges=1.001 * STATE.edges),
    replace(STATE, hinge_angle=STATE.hinge_angle + 0.1),
    replace(STATE, stiffening=2.0 * STATE.stiffening),
)


def key(**changes) -> str:
    return cache_key(**{**ARGUMENTS, **changes})


def minimise(step_limit: int = 120) -> physics.Optimum:
    """A sheet beside a ball, for a moment."""
    ball, faces = icosphere(3, radius_m=0.1)
    rest, sheet = grid(4, 4, cell_m=0.01)
    start = np.stack([1.1 * rest, 0.9 * rest]) + np.array([0.0, 0.3, 0.0])
    return physics.minimise(
        ClothMesh.from_rest(rest, sheet),
        material(),
        start,
        BodyContact(faces, len(ball)),
        np.stack([ball, ball]),
        step_limit=step_limit,
    )


def test_a_stored_optimum_comes_back_bit_for_bit_with_its_seconds(tmp_path):
    made, was_stored = cached("a", minimise, tmp_path / "new")
    assert not was_stored
    found, was_stored = cached("a", lambda: pytest.fail("minimised again"), tmp_path / "new")
    assert was_stored
    for item in fields(physics.Optimum):
        assert_array_equal(getattr(found, item.name), getattr(made, item.name))
    assert found.seconds > 0.0
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a.npz"]


def test_without_a_folder_nothing_is_stored(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert not cached("a", minimise, None)[1]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 cut off", None])
def test_a_damaged_file_is_made_again(tmp_path, capsys, damage):
    made, _ = cached("a", minimise, tmp_path)
    path = tmp_path / "a.npz"
    if damage is None:
        np.savez(path, vertices=made.vertices)  # the other fields are missing
    else:
        path.write_bytes(damage)
    again, was_stored = cached("a", minimise, tmp_path)
    assert not was_stored
    assert "cannot be read" in capsys.readouterr().out
    assert_array_equal(again.vertices, made.vertices)
    assert cached("a", lambda: pytest.fail("minimised again"), tmp_path)[1]


def test_the_key_is_the_same_every_time_and_does_not_follow_the_patches():
    assert key() == key()
    moved = replace(tube(), name="other", patch_centre=tube().patch_centre + 1.0)
    assert key(garment=moved) == key()


def test_whatever_the_optimum_depends_on_changes_the_key():
    garment, other = tube(), np.array(tube().skin_weights)
    other[0] = np.roll(other[0], 1)
    changed = [
        key(garment=replace(garment, vertices=garment.vertices + np.float32(1e-6))),
        key(garment=replace(garment, fine_faces=garment.fine_faces[1:])),
        key(garment=replace(garment, skin_weights=other)),
        key(body=replace(body(), digest="0" * 64)),
        key(poses=bending(2, 0.71)),
        key(poses=bending(3)),
        key(material=material("soft")),
        key(step_limit=1999),
        *(key(rest=rest) for rest in RESTS),
        key(tolerance=2e-4),
    ]
    assert len({key(), *changed}) == 1 + len(changed)


def test_a_changed_source_changes_the_key(tmp_path, monkeypatch):
    source = ModuleType("source")
    source.__file__ = str(tmp_path / "source.py")
    (tmp_path / "source.py").write_text("STEP = 0.2\n")
    monkeypatch.setattr(physics_cache, "SOURCES", (source,))
    before = key()
    (tmp_path / "source.py").write_text("STEP = 0.3\n")
    assert key() != before


def test_the_sources_hold_minimiser_energy_and_contact():
    names = {module.__name__ for module in physics_cache.SOURCES}
    assert {"benchmarks.shared.physics", "drape.cloth.energies", "drape.cloth.contact", "drape.body.model"} <= names
