"""Garments in other fabrics: what a request or a stream names is what is draped, and nothing else changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.errors import InputError, NotFound
from drape.inference import packing
from drape.stages.batch import PoseInput
from drape.stages.network import Network
from drape.stages.scene import check_known, layer_fabrics
from drape.stages.walk import run
from drape.wire.options import Advanced, DrapeOptions, FabricNumbers
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.poses import smooth_motion
from tests.fixtures.tiny_model import ROUNDING_M, TINY, expected_vertices

POSES, TRANS = smooth_motion(np.arange(3) / 30.0)
CLIP = PoseInput(POSES, TRANS, np.zeros(10), np.arange(3) / 30.0)
DENIM = fabric("denim")
NUMBERS = {name: getattr(DENIM, name) for name in FabricNumbers.model_fields}


@pytest.fixture(scope="module")
def runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    return make_runtime(model=TINY)


def packer_of(runtime: DrapeRuntime) -> packing.Packer:
    (network,) = (stage for stage in runtime.stages if isinstance(stage, Network))
    assert isinstance(network.packer, packing.Packer)
    return network.packer


def draped(runtime: DrapeRuntime, **options: Any) -> np.ndarray:
    """The tube on the clip (F, V, 3) [m]."""
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(push_out=False), **options))
    return run(plan, [CLIP]).world()


@pytest.mark.parametrize("chosen", ["denim", FabricNumbers(**NUMBERS), ("denim",)], ids=["name", "numbers", "list"])
def test_a_named_fabric_is_what_the_network_is_told(runtime: DrapeRuntime, chosen: object):
    entry = runtime.garments.get("tube")
    wanted = expected_vertices(runtime.body, entry.garment, POSES, TRANS, fabric=DENIM)
    found = draped(runtime, fabric=chosen)
    assert_allclose(found, wanted, rtol=0, atol=ROUNDING_M)
    assert np.abs(found - draped(runtime)).max() > 4.0 * ROUNDING_M


def test_a_fabric_changes_no_bit_of_the_others(runtime: DrapeRuntime):
    own = draped(runtime)
    satin = draped(runtime, fabric="satin")
    for name in ("denim", "chiffon"):
        draped(runtime, fabric=name)
    assert_array_equal(draped(runtime), own)
    assert_array_equal(draped(runtime, fabric="satin"), satin)
    assert_array_equal(draped(runtime, fabric="jersey"), own, "the tube's own")


def test_no_more_fabrics_are_kept_than_allowed(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(packing, "FABRICS_KEPT", 2)
    packer = packer_of(runtime)
    first = draped(runtime, fabric="rib")
    for name in ("swim", "twill", "poplin"):
        draped(runtime, fabric=name)
    key = runtime.garments.get("tube").garment.digest
    kept = [name for name in ("rib", "swim", "twill", "poplin") if f"{key} of {fabric(name).digest}" in packer.store]
    assert kept == ["twill", "poplin"]
    assert_array_equal(draped(runtime, fabric="rib"), first)


def test_a_garment_that_is_put_in_store_anew_takes_its_fabrics_with_it(runtime: DrapeRuntime):
    packer = packer_of(runtime)
    entry = runtime.garments.get("tube")
    before = draped(runtime, fabric="ponte")
    held = packer.store.bytes
    packer.add(entry.garment.digest, entry.garment)
    assert f"{entry.garment.digest} of {fabric('ponte').digest}" not in packer.store and packer.store.bytes < held
    assert_array_equal(draped(runtime, fabric="ponte"), before)


def test_layers_have_fabrics_of_their_own(outfit_settings: Settings):
    made = DrapeRuntime(outfit_settings)
    try:
        names = ["coat", "cape"]
        outfit = made.garments.scene(None, names)
        both = run(made.plan(outfit, DrapeOptions(advanced=Advanced(push_out=False), fabric=("satin", None))), [CLIP])
        alone = [
            run(
                made.plan(made.garments.get(name), DrapeOptions(advanced=Advanced(push_out=False), fabric=one)), [CLIP]
            ).world()
            for name, one in zip(names, ("satin", None), strict=True)
        ]
        assert_array_equal(both.world(), np.concatenate(alone, axis=1))
        with pytest.raises(InputError, match="fabric: expected one for all, or 2"):
            made.plan(outfit, DrapeOptions(fabric=("satin",)))
    finally:
        made.close()


def test_what_is_no_fabric_is_refused(runtime: DrapeRuntime):
    entry = runtime.garments.get("tube")
    with pytest.raises(NotFound, match="chain mail"):
        runtime.plan(entry, DrapeOptions(fabric="chain mail"))
    with pytest.raises(InputError, match="cross_n_per_m"):
        runtime.plan(entry, DrapeOptions(fabric=FabricNumbers(**NUMBERS | {"cross_n_per_m": 1e6})))
    with pytest.raises(InputError, match="trained on one cloth"):
        check_known(layer_fabrics(DrapeOptions(fabric="denim"), 1), known=False, model="old")
    check_known((None, None), known=False, model="old")


def test_numbers_on_the_wire_are_those_of_a_fabric():
    given = set(FabricNumbers.model_fields)
    assert given <= set(Fabric.__dataclass_fields__)
    assert set(Fabric.__dataclass_fields__) - given == {"name", "thickness_m", "friction", "damping_s", "source"}
