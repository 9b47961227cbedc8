"""Garments trained on: variants per process, fresh partitions, the same ones again from their seeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from drape.cloth.rest_state import grain_along
from drape.contact.skin import body_skin
from drape.errors import InputError
from drape.garment.cache import GARMENTS_DIR, load_garment
from drape.garment.partition import patch_count_for
from drape.geometry import meshes
from drape.geometry.closest import signed_distance
from tests.training.training_setup import CPU, TINY_RUN, body
from training.batches import draw_partition
from training.wardrobe import Wardrobe

DATA = replace(TINY_RUN.data, partitions=2, variants=1, variant_partitions=1)


@pytest.fixture(scope="module")
def wardrobe() -> Wardrobe:
    return Wardrobe(DATA, body(), seed=1, device=CPU)


def test_a_wardrobe_holds_designs_and_variants_with_their_partitions(wardrobe: Wardrobe):
    assert [(g.name, len(g.partitions)) for g in wardrobe.garments] == [("shorts", 2), ("shorts_0", 1)]
    own, variant = wardrobe.garments
    assert own.rest.vertices.shape != variant.rest.vertices.shape


@pytest.mark.long
def test_processes_share_the_design_and_not_the_variants(wardrobe: Wardrobe):
    other = Wardrobe(replace(DATA, partitions=1), body(), seed=1, device=CPU, process=1)
    assert np.array_equal(other.garments[0].rest.vertices, wardrobe.garments[0].rest.vertices)
    assert other.garments[1].rest.vertices.shape != wardrobe.garments[1].rest.vertices.shape


def test_a_fresh_partition_differs_and_its_seed_brings_the_old_one_back(wardrobe: Wardrobe):
    seeds = wardrobe.seeds()
    before = [[p.patches.centre for p in g.partitions] for g in wardrobe.garments]
    wardrobe.refresh(np.random.default_rng(0))
    changed = [(i, j) for i, row in enumerate(seeds) for j, s in enumerate(row) if wardrobe.seeds()[i][j] != s]
    assert len(changed) == 1
    i, j = changed[0]
    fresh = wardrobe.garments[i].partitions[j].patches.centre
    assert fresh.shape != before[i][j].shape or not torch.equal(fresh, before[i][j])
    wardrobe.restore(seeds)
    for garment, row in zip(wardrobe.garments, before, strict=True):
        for partition, centre in zip(garment.partitions, row, strict=True):
            assert torch.equal(partition.patches.centre, centre)


def test_patch_counts_lie_in_the_span(wardrobe: Wardrobe):
    rest = wardrobe.garments[0].rest
    by_rule = patch_count_for(float(rest.areas.sum()))
    for span in ((1.5, 1.5), (0.75, 2.2)):
        partition = draw_partition(
            rest, body_skin(body()), seed=5, span=span, device=CPU, warp=grain_along(rest.vertices, rest.faces)
        )
        assert span[0] - 0.02 <= len(partition.patches.scale) / by_rule <= span[1] + 0.02


@pytest.mark.parametrize(("share", "wanted"), [(1.0, 1.0), (0.0, 0.5)])
def test_the_own_share_is_the_chance_of_the_designs_themselves(wardrobe: Wardrobe, share: float, wanted: float):
    wardrobe.config, kept = replace(DATA, own_share=share), wardrobe.config
    rng = np.random.default_rng(0)
    drawn = [wardrobe.draw(rng)[0].name == "shorts" for _ in range(400)]
    wardrobe.config = kept
    assert np.mean(drawn) == pytest.approx(wanted, abs=0.08)


def test_a_garment_file_goes_through_intake(tmp_path):
    tank = load_garment(next(GARMENTS_DIR.glob("tank-*.npz")))
    mesh = trimesh.Trimesh(tank.vertices, tank.fine_faces, process=False)
    mesh.export(tmp_path / "top.obj")
    path = str(tmp_path / "top.obj")
    (garment,) = Wardrobe(replace(DATA, garments=(path,), partitions=1), body(), seed=1, device=CPU).garments
    assert garment.name == path
    assert signed_distance(garment.rest.vertices, body().v_template, body().faces).min() >= 0.006
    assert len(garment.partitions) == 1


def test_a_sewn_garment_is_trained_on_as_its_panels():
    path = next(GARMENTS_DIR.glob("skirt-*.npz"))
    (garment,) = Wardrobe(replace(DATA, garments=(str(path),), partitions=1), body(), seed=1, device=CPU).garments
    panels = load_garment(path).rest_state().face_area.sum()
    worn = meshes.face_areas(garment.rest.vertices, garment.rest.faces).sum()
    assert float(garment.cloth.vertex_area.sum()) == pytest.approx(panels, rel=1e-5)
    assert abs(worn / panels - 1.0) > 1e-3  # its weight and its waist stretch what is worn


def test_unknown_garment_is_refused():
    with pytest.raises(InputError, match="toga"):
        Wardrobe(replace(DATA, garments=("toga",)), body(), seed=1, device=CPU)
