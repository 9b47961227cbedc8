"""What feeds and packing make is what the groups of inputs declare: names, types, and one length for every axis."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.artifacts import TensorSpec
from drape.body.assets import load_body
from drape.contact.projection import PushFeed
from drape.graph.feeds import body_feed, garment_feed
from drape.graph.inputs import FEELS, PARTS, AgreementTensors, BodyTensors, ChartTensors, PatchTensors
from drape.graph.layer_feed import LayerFeed, layer_feed
from drape.graph.packed_inputs import PackedTensors
from drape.graph.packing import Place, compose_garments, pack_body, pack_garment
from drape.graph.push_feed import SkinShapes, push_feed
from tests.fixtures.packed import garment
from tests.fixtures.poses import random_motion

WIDTH, FRAMES = 6, 3


def check(specs: tuple[TensorSpec, ...], arrays: dict[str, np.ndarray]) -> dict[str, int]:
    """Lengths of the named axes of ``specs``, which ``arrays`` are all of."""
    assert {spec.name for spec in specs} == set(arrays)
    lengths: dict[str, int] = {}
    for spec in specs:
        array = arrays[spec.name]
        assert array.dtype == spec.dtype, spec.name
        assert array.ndim == len(spec.shape), spec.name
        for axis, length in zip(spec.shape, array.shape, strict=True):
            assert length == (lengths.setdefault(axis, length) if isinstance(axis, str) else axis), (spec.name, axis)
    return lengths


@pytest.mark.parametrize("fine", [False, True])
@pytest.mark.parametrize("feels", [False, True])
def test_feeds_are_what_the_readable_graph_declares(feels: bool, fine: bool):
    body, whole = load_body(), garment("tank")
    kinds = (BodyTensors, PatchTensors, ChartTensors, AgreementTensors)
    parts = tuple(part for part in PARTS if feels or part != FEELS)
    made = body_feed(body, *random_motion(FRAMES, seed=1), skin=feels)
    arrays = made.arrays | garment_feed(whole, fine=fine, body=body if feels else None)
    assert all(array.flags.c_contiguous for array in arrays.values())
    del arrays["patch_slot"]  # of packing
    lengths = check(tuple(spec for kind in kinds for spec in kind.specs(parts)), arrays)
    count = len(whole.vertices) if fine else whole.vertex_count
    assert (lengths["frames"], lengths["patches"], lengths["vertices"]) == (FRAMES, whole.patch_count, count)
    assert made.root.shape == (FRAMES, 3) and made.root.dtype == np.float64


def test_packing_is_what_the_packed_graph_declares():
    body, whole = load_body(), garment("tank")
    packed = pack_garment(garment_feed(whole, body=body), np.zeros((whole.patch_count, WIDTH)))
    bodies = pack_body(body).rows(random_motion(FRAMES, seed=1)[0])
    bodies |= SkinShapes(body).feed(bodies["betas"]) | {"dynamic_code": np.zeros((FRAMES, 5), np.float32)}
    items = compose_garments([(packed, Place(0, 0), frame) for frame in range(FRAMES)])
    lengths = check(PackedTensors.specs(PARTS, width=WIDTH), packed.stored | bodies | items.arrays)
    assert (lengths["bodies"], lengths["code"]) == (FRAMES, 5)
    assert lengths["patches"] == FRAMES * lengths["stored_patches"]


def test_the_push_out_takes_what_it_declares():
    body = load_body()
    lengths = check(PushFeed.specs(), push_feed(garment("tank"), body).flat())
    assert lengths["vertices"] == len(garment("tank").vertices)
    lengths = check(LayerFeed.specs(), layer_feed(garment("shorts"), [garment("tank")], body).flat())
    assert lengths["all_parts"] != lengths["cloth_parts"]


def test_bodies_of_many_shapes_are_fed_as_each_by_itself(rng):
    body, (poses, trans) = load_body(), random_motion(FRAMES, seed=2)
    shapes = rng.normal(size=(FRAMES, body.shape_count))
    together = body_feed(body, poses, trans, shapes, skin=True)
    for n in range(FRAMES):
        alone = body_feed(body, poses[n : n + 1], trans[n : n + 1], shapes[n], skin=True)
        assert_allclose(together.root[n], alone.root[0], rtol=0, atol=1e-12)
        for name, array in alone.arrays.items():
            assert_allclose(together.arrays[name][n], array[0], rtol=0, atol=1e-5, err_msg=name)
