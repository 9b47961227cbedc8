"""Tiers: what a name, a budget, or nothing at all comes to, and that it is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, replace

import httpx
import numpy as np
import pytest

from drape.artifacts import load_manifest
from drape.errors import ArtifactError
from drape.stages.tiers import NAMES, TIERS, Tier, capped, chosen, read_tiers, spared, tier_of
from drape.wire.options import Advanced, DrapeOptions
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.serving import serve
from tests.fixtures.tiny_model import TINY, write_tiny_model

PASSES = 4  # of a model that leaves the choice
OWN = (
    Tier("instant", 0, 0, 0, coarse=True),
    Tier("fast", 0, 1, 0, coarse=True),
    Tier("balanced", 0, 3, None),
    Tier("accurate", 1, 4, None, {"gain_trained": 0.99}),
)
REST = {"garment": "tube", "poses": np.zeros((1, 24, 3)).tolist()}


@pytest.fixture(scope="module")
def own_settings(make_settings: Callable[..., Settings], body, tmp_path_factory) -> Settings:
    """Of a model whose manifest has tiers; folds are what the tier says."""
    folder = tmp_path_factory.mktemp("tiers")
    model = write_tiny_model(folder, body)
    manifest = replace(load_manifest(model), tiers=[asdict(tier) for tier in OWN])
    (model / "manifest.json").write_text(manifest.to_json())
    return make_settings(model=str(folder / TINY), folds=None)


@pytest.fixture
def runtime(own_settings: Settings) -> Iterator[DrapeRuntime]:
    made = DrapeRuntime(own_settings)
    yield made
    made.close()


def values(options: DrapeOptions, pass_count: int = PASSES, **settings: object) -> tuple[int | None, int | None]:
    found = chosen(options, TIERS, Settings(**settings), pass_count)  # pyright: ignore[reportArgumentType]
    assert found.tier is None
    return found.advanced.passes, found.advanced.folds


@pytest.mark.parametrize(
    ("asked", "settings", "want"),
    [
        ({}, {}, (0, 2)),
        ({}, {"tier": "fast"}, (0, 1)),
        ({}, {"folds": 0}, (None, 0)),
        ({"tier": "accurate"}, {"tier": "fast", "folds": 0}, (0, 4)),
        ({"passes": 2}, {}, (2, 2)),
        ({"folds": 0}, {}, (None, 0)),
        ({"tier": "fast", "folds": 0}, {}, (0, 0)),
        ({"tier": "instant"}, {"folds": 3}, (0, 0)),
        ({"geometry": "jets"}, {}, (None, 0)),
        ({"geometry": "jets", "tier": "fast"}, {}, (0, 0)),
        ({"tier": "fast", "folds": 5, "passes": 1}, {}, (1, 5)),
    ],
)
def test_what_is_named_wins_then_its_tier_then_the_settings(asked: dict, settings: dict, want: tuple):
    assert values(DrapeOptions(**asked), **settings) == want


def test_a_model_of_fixed_passes_is_asked_for_none_of_them():
    assert values(DrapeOptions(), pass_count=0) == (None, 2)
    assert tier_of(chosen(DrapeOptions(), TIERS, Settings(), 0), TIERS, 0) == "balanced"


@pytest.mark.parametrize("geometry", ["vertices", "jets"])
def test_the_tier_of_what_was_chosen_is_told_by_name(geometry):
    for name in NAMES:
        found = chosen(DrapeOptions(tier=name, geometry=geometry), TIERS, Settings(), PASSES)  # type: ignore[arg-type]
        told = tier_of(found, TIERS, PASSES)
        alike = ({"instant", "fast"}, {"balanced", "accurate"})  # jets have no folds
        assert told == name or (geometry == "jets" and any({told, name} <= pair for pair in alike))
    odd = chosen(DrapeOptions(advanced=Advanced(folds=3, passes=1), geometry="vertices"), TIERS, Settings(), PASSES)
    assert tier_of(odd, TIERS, PASSES) == "custom"


def test_a_cap_never_asks_for_more_than_was_asked():
    instant, fast, balanced, accurate = TIERS
    for folds in (0, 1, 2, 16):
        for passes in (0, 2, None):
            asked = chosen(DrapeOptions(advanced=Advanced(folds=folds, passes=passes)), TIERS, Settings(), PASSES)
            for tier in TIERS:
                held = capped(asked, tier).advanced
                assert held.folds is not None and held.folds <= min(folds, tier.folds)
                assert passes is None or (held.passes is not None and held.passes <= passes)
    high = chosen(DrapeOptions(tier="accurate"), TIERS, Settings(), PASSES)
    assert [capped(high, tier).advanced.folds for tier in (instant, fast, balanced, accurate)] == [0, 1, 2, 4]
    assert [capped(high, tier).advanced.coarse for tier in (fast, balanced, accurate)] == [True, True, False]
    jets = chosen(DrapeOptions(geometry="jets"), TIERS, Settings(), PASSES)
    assert (capped(jets, fast).advanced.passes, capped(jets, balanced)) == (0, jets)


def test_what_is_spared_is_cloth_against_cloth_where_there_are_folds():
    asked = chosen(DrapeOptions(advanced=Advanced(push_out=True), tier="fast"), TIERS, Settings(), PASSES)
    assert spared(asked) == asked.updated(cloth_contact=False) != asked
    for without in (DrapeOptions(advanced=Advanced(folds=0)), DrapeOptions(geometry="jets")):
        plain = chosen(without, TIERS, Settings(), PASSES)
        assert spared(plain) == plain


def test_layers_spare_nothing(outfit_settings: Settings):
    runtime = DrapeRuntime(outfit_settings)
    try:
        for worn, differs in ((["tube"], True), (["tube", "coat"], False)):
            plan = runtime.plan(runtime.garments.scene(None, worn), DrapeOptions(tier="fast"), messages=True)
            carried, lowest, least, *_ = steps = runtime.steps(plan)
            assert len(steps) == runtime.step_count
            assert lowest.options.advanced.push_out and lowest.options.advanced.cloth_contact != differs
            assert (lowest != least) == differs == carried.carried
            assert carried == (replace(lowest, carried=True) if differs else lowest)
    finally:
        runtime.close()


@pytest.mark.parametrize(
    "rows",
    [
        [asdict(OWN[0])],
        [asdict(tier) for tier in reversed(OWN)],
        [asdict(OWN[0]), asdict(replace(OWN[1], folds=0)), *map(asdict, OWN[2:])],
        [asdict(replace(OWN[0], folds=1)), *map(asdict, OWN[1:])],
        [asdict(replace(OWN[0], coarse=False)), *map(asdict, OWN[1:])],
        [*map(asdict, OWN[:2]), asdict(replace(OWN[2], passes=2)), asdict(OWN[3])],
        [*map(asdict, OWN[:3]), asdict(replace(OWN[3], coarse=True))],
        [*map(asdict, OWN[:3]), asdict(OWN[3]) | {"speed": 9}],
        [{"name": name} for name in NAMES],
    ],
    ids=[
        "too few",
        "out of order",
        "without folds",
        "folds in the first",
        "unlifted",
        "less than below",
        "coarse over fine",
        "unknown field",
        "no numbers",
    ],
)
def test_tiers_that_are_none_stop_the_start(rows: list[dict]):
    with pytest.raises(ArtifactError, match="tiers of the manifest: expected instant, fast, balanced, accurate"):
        read_tiers(rows)


def test_tiers_come_from_the_manifest_and_are_listed(runtime: DrapeRuntime):
    assert runtime.tiers == OWN and read_tiers([]) == TIERS
    with serve(create_app(runtime.settings, runtime=runtime), runtime.settings) as url:
        instant, fast, balanced, accurate = httpx.get(url + "/tiers").json()
        least = {"default": False, "passes": 0, "coarse": True, "alone": 0, "figures": {}}
        assert (instant, fast) == ({"id": "instant", "folds": 0} | least, {"id": "fast", "folds": 1} | least)
        assert (balanced["default"], balanced["alone"]) == (True, runtime.engine.pass_count)
        assert accurate["figures"] == {"gain_trained": 0.99}
        for more, tier, folds in (
            ({}, "balanced", "3"), ({"tier": "fast"}, "fast", "1"), ({"tier": "instant"}, "instant", "0"),
            ({"folds": 7}, "custom", "7"),
        ):  # fmt: skip
            headers = httpx.post(url + "/drape", json=REST | more).headers
            assert (headers["X-Drape-Tier"], headers["X-Drape-Folds"]) == (tier, folds)
        assert httpx.post(url + "/drape", json=REST | {"tier": "best"}).status_code == 400


def test_the_default_of_the_product_is_folds(make_runtime: Callable[..., DrapeRuntime]):
    assert (Settings().tier, Settings().folds) == ("balanced", None)
    made = make_runtime(folds=None)
    plan = made.plan(made.garments.get("tube"), DrapeOptions())
    assert made.engine.manifest.name == TINY and [stage.name for stage in plan.stages] == ["network", "folds"]
