"""A dynamic model through the packed graph: moving and still clients in one call, and no recurrence unless asked."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.artifacts import load_manifest
from drape.body.assets import load_body
from drape.errors import ArtifactError
from drape.garment.cache import save_garment
from drape.graph.packing import pack_body
from service import drapery as drapery_module
from service.drapery import Drapery, PoseInput
from service.engine import DYNAMIC, PACKED, Engine
from service.packing import Packer, ScenePlan
from service.settings import Settings
from tests.fixtures.packed import KINDS, exported, exported_dynamic, garment
from tests.fixtures.poses import smooth_motion

pytestmark = pytest.mark.slow
TIMES_S = np.arange(8) / 30.0
NO_SHAPE = np.zeros(load_body().shape_count)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The static model, the dynamic one, the dynamic one without its packed graph, and garments."""
    folder = tmp_path_factory.mktemp("models")
    shutil.copytree(exported()[1], folder / "small")
    for name in ("moving", "plain"):
        shutil.copytree(exported_dynamic()[1], folder / name)
    manifest = load_manifest(folder / "plain")
    graphs = {key: spec for key, spec in manifest.graphs.items() if key != PACKED}
    (folder / "plain" / "manifest.json").write_text(replace(manifest, graphs=graphs).to_json())
    for kind in KINDS:
        save_garment(garment(kind), folder / "garments")
    return folder


@pytest.fixture(scope="module")
def open_model(models: Path, make_settings: Callable[..., Settings]) -> Iterator[Callable[[str], Drapery]]:
    opened: dict[str, Drapery] = {}

    def open_model(name: str) -> Drapery:
        if name not in opened:
            settings = make_settings(models_dir=models, model=name, shipped_garments_dir=models / "garments")
            opened[name] = Drapery(settings)
        return opened[name]

    yield open_model
    for drapery in opened.values():
        drapery.close()


def clip(times_s: np.ndarray = TIMES_S, *, seed: int = 0, motion: float = 1.0, bent: float = 0.0) -> PoseInput:
    poses, trans = smooth_motion(times_s, seed=seed)
    return PoseInput(poses, trans, NO_SHAPE + bent, False, motion, times_s)


def test_moving_and_still_clients_have_the_bits_that_each_has_alone(open_model: Callable[[str], Drapery]):
    drapery = open_model("moving")
    assert drapery.packer is not None
    entry = drapery.garments.get("tank")
    inputs = [
        clip(seed=1),
        clip(TIMES_S[:1], seed=2, motion=0.0),
        clip(1.3 * TIMES_S[:5], seed=3, motion=0.5, bent=0.7),
        clip(TIMES_S[:3], seed=4, motion=0.0, bent=-0.4),
    ]
    # Two begin in the midst of a motion.
    memories = drapery.compute(entry, [clip(TIMES_S[:6] - 0.2, seed=i) for i in (1, 3)]).memories
    inputs[0], inputs[2] = (replace(inputs[i], memory=m) for i, m in zip((0, 2), memories, strict=True))
    together, alone = drapery.compute(entry, inputs), [drapery.compute(entry, [one]) for one in inputs]
    assert_array_equal(together.vertices, np.concatenate([one.vertices for one in alone]))
    for memory, one in zip(together.memories, alone, strict=True):
        own = one.memories[0]
        assert (memory is None) == (own is None)
        if memory is not None and own is not None:
            assert_array_equal(memory.state, own.state)
            assert_array_equal(memory.code, own.code)
    assert [memory is None for memory in together.memories] == [False, True, False, True]


def test_a_moving_clip_is_that_of_the_readable_graph(open_model: Callable[[str], Drapery]):
    moving, unpacked = open_model("moving"), open_model("plain")
    packed, plain = (made.compute(made.garments.get("tank"), [clip()]).vertices for made in (moving, unpacked))
    still = moving.compute(moving.garments.get("tank"), [clip(motion=0.0)]).vertices
    assert np.abs(packed - still)[3:].max(axis=(1, 2)).min() > 3e-4, "the motion must be such that this means something"
    assert_allclose(packed, plain, rtol=0, atol=2e-5)


def test_a_still_scene_is_the_static_models_and_runs_no_recurrence(
    open_model: Callable[[str], Drapery], monkeypatch: pytest.MonkeyPatch
):
    static, moving = open_model("small"), open_model("moving")
    want = static.compute(static.garments.get("tank"), [clip(motion=0.0)]).vertices
    ran: list[str] = []
    run = Engine._run

    def recorded(engine: Engine, graph: str, *arguments: object):
        ran.append(graph)
        return run(engine, graph, *arguments)  # type: ignore[arg-type]

    def refused(*_: object) -> None:
        raise AssertionError("kinematics were computed")

    monkeypatch.setattr(Engine, "_run", recorded)
    monkeypatch.setattr(drapery_module, "kinematics", refused)
    got = moving.compute(moving.garments.get("tank"), [clip(motion=0.0)])
    assert_array_equal(got.vertices, want)
    assert ran == [] and got.memories == (None,)
    monkeypatch.setattr(drapery_module, "kinematics", lambda body, *rest: KINEMATICS(body, *rest))
    moving.compute(moving.garments.get("tank"), [clip(), clip(motion=0.0)])
    assert ran == [DYNAMIC] * (len(TIMES_S) - 2), "the first two frames have no motion yet"


KINEMATICS = drapery_module.kinematics


def test_bodies_without_a_code_hang_at_rest():
    packer = Packer(Engine(exported_dynamic()[1]), load_body())
    packer.add("tank", garment("tank"))
    rows = pack_body(load_body()).rows(smooth_motion(TIMES_S[:2])[0])
    code = np.zeros((2, exported_dynamic()[0].config.body_code_size), np.float32)
    items = [("tank", 0), ("tank", 1)]
    still = packer.run(ScenePlan(), rows, items)
    for given, none in zip(packer.run(ScenePlan(), rows | {"dynamic_code": code}, items), still, strict=True):
        assert_array_equal(given.arrays["vertices"], none.arrays["vertices"])
    code[1] = 1.0
    first, second = packer.run(ScenePlan(), rows | {"dynamic_code": code}, items)
    assert_array_equal(first.arrays["vertices"], still[0].arrays["vertices"])
    assert np.abs(second.arrays["vertices"] - still[1].arrays["vertices"]).max() > 1e-4


def test_a_packed_graph_that_takes_no_code_is_refused(tmp_path: Path):
    folder = Path(shutil.copytree(exported_dynamic()[1], tmp_path / "moving"))
    manifest = load_manifest(folder)
    spec = manifest.graphs[PACKED]
    inputs = tuple(tensor for tensor in spec.inputs if tensor.name != "dynamic_code")
    changed = replace(manifest, graphs={**manifest.graphs, PACKED: replace(spec, inputs=inputs)})
    (folder / "manifest.json").write_text(changed.to_json())
    with pytest.raises(ArtifactError, match="dynamic: expected drape graphs with a dynamic_code"):
        Engine(folder)
