"""Stored optima come back as they were, and whatever they depend on makes them miss."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from benchmarks.judge import physics, physics_cache
from benchmarks.judge.physics_cache import cache_key, cached
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material, material
from drape.cloth.rest_state import flat_rest, grain_along, modelled_rest
from drape.exact.linear import Charts
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere


def task(**changes) -> physics.OptimumTask:
    """A sheet beside a ball, in two starts."""
    ball, faces = icosphere(3, radius_m=0.1)
    rest, sheet = grid(4, 4, cell_m=0.01)
    start = np.stack([1.1 * rest, 0.9 * rest]) + np.array([0.0, 0.3, 0.0])
    parts = {
        "cloth": ClothMesh.from_rest(rest, sheet),
        "material": material(),
        "contact": BodyContact(faces, len(ball)),
        "body_vertices": np.stack([ball, ball]),
        "starts": (start,),
    }
    return physics.OptimumTask(**{**parts, **changes})


def key(step_limit: int = 120, tolerance: float = physics.TOLERANCE, **changes) -> str:
    return cache_key(task(**changes), step_limit, tolerance)


def minimise() -> physics.Optimum:
    return physics.minimise(task(), step_limit=5)


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


def test_the_key_is_the_same_every_time_and_does_not_follow_the_name():
    assert key() == key()
    assert key(name="other") == key()


def test_whatever_the_optimum_depends_on_changes_the_key():
    rest, sheet = grid(4, 4, cell_m=0.01)
    bent = rest + np.array([0.0, 0.0, 1.0]) * (rest[:, :1] > 0.02) * 0.005
    turned = modelled_rest(rest, sheet, grain_along(rest, sheet, (1.0, 1.0, 0.0)))
    one = task()
    contact = one.contact
    states = {
        "flat": ClothMesh.of(flat_rest(bent, sheet), sheet, len(rest)),
        "curved": ClothMesh.of(modelled_rest(bent, sheet), sheet, len(rest)),
        "grain": ClothMesh.of(turned, sheet, len(rest)),
        "hem": ClothMesh.of(replace(turned, stiffening=2.0 * turned.stiffening), sheet, len(rest)),
    }
    changed = [
        *(key(cloth=cloth) for cloth in states.values()),
        *(key(material=Material.of(fabric(name))) for name in ("jersey", "poplin")),
        key(body_vertices=one.body_vertices + 1e-6),
        key(contact=BodyContact(contact.faces, contact.vertex_count, vertices=np.arange(20))),
        key(starts=(one.starts[0] + 1e-6,)),
        key(starts=(*one.starts, *one.starts)),
        key(charts=Charts(np.zeros((len(rest), 1), np.int32), np.ones((len(rest), 1)))),
        key(waistband=physics.Waistband(np.arange(3), np.ones(3), np.zeros((2, 3, 3)))),
        key(step_limit=119),
        key(tolerance=0.02),
    ]
    assert len({key(), *changed}) == 1 + len(changed)


def test_a_changed_source_changes_the_key(tmp_path, monkeypatch):
    source = tmp_path / "source.py"
    source.write_text("STEP = 0.2\n")
    monkeypatch.setattr(physics_cache, "SOURCES", (source,))
    before = key()
    source.write_text('"""How far."""\n\nSTEP = 0.2  # of the way\n')
    assert key() == before
    source.write_text("STEP = 0.3\n")
    assert key() != before


def test_the_sources_hold_minimiser_energy_and_contact():
    names = {f"{source.parent.name}/{source.name}" for source in physics_cache.SOURCES}
    assert {"judge/physics.py", "exact/newton.py", "cloth/energies.py", "cloth/contact.py"} <= names
    assert {"source/physics.hpp", "source/elements.hpp", "source/blended_planes.hpp", "source/linear.hpp"} <= names
