"""What the folder without a service is made of: answers of the application, and refusals of what no client drapes."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from fastapi import FastAPI

from drape.artifacts import DEFAULT_MODEL, MODELS_DIR, TensorSpec, load_manifest
from drape.errors import ArtifactError, InputError, NotFound, Unavailable
from drape.inference.graph_names import PACKED
from drape.stages.network import Network
from drape.wire.options import Advanced, DrapeOptions
from service.http import problems
from service.http.answers import JSON
from service.static import site
from service.static.site import ask_application


def test_an_application_is_asked_in_its_process_and_its_refusals_are_raised():
    app = FastAPI()
    problems.install_handlers(app)

    @app.get("/told/{name}")
    async def told(name: str, often: int) -> list[str]:
        if often == 0:
            raise NotFound("name", expected="one that is told", got=name, cure="Tell it once.")
        return often * [name]

    assert asyncio.run(ask_application(app, "/told/walk?often=2", JSON)) == b'["walk","walk"]'
    with pytest.raises(InputError, match=r"name: expected one that is told, got walk\. Tell it once\."):
        asyncio.run(ask_application(app, "/told/walk?often=0", JSON))


def test_jets_that_are_not_those_of_the_wire_are_refused():
    manifest = load_manifest(MODELS_DIR / DEFAULT_MODEL)
    site.check_jets(manifest)
    packed = manifest.graphs[PACKED]
    outputs = tuple(replace(one, shape=("patches", 27)) if one.name == "jet" else one for one in packed.outputs)
    assert all(isinstance(one, TensorSpec) for one in outputs)
    older = replace(manifest, graphs=manifest.graphs | {PACKED: replace(packed, outputs=outputs)})
    with pytest.raises(ArtifactError, match="expected 45 numbers a patch, got 27"):
        site.check_jets(older)


def test_a_network_that_no_page_computes_is_refused():
    stage = Network.__new__(Network)
    stage.engine = cast(Any, SimpleNamespace(compiled=None, manifest=SimpleNamespace(name="paper")))
    with pytest.raises(ArtifactError, match="paper: expected a network that the engine has, got another kind"):
        stage.records(cast(Any, None))


def test_a_page_that_is_not_built_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(site, "PAGE", tmp_path / "page")
    with pytest.raises(Unavailable, match=r"got no .*/page/index.html\. Run make page\."):
        site.check_built()
    (tmp_path / "page").mkdir()
    (tmp_path / "page/index.html").touch()
    monkeypatch.setattr(site, "ENGINE", tmp_path / "engine.wasm")
    with pytest.raises(Unavailable, match=r"got no .*/engine\.wasm\. Run make page\."):
        site.check_built()


def test_inertia_of_the_network_is_refused():
    site.check_inertia(DrapeOptions(advanced=Advanced(inertia="mesh"), motion=1.0))
    site.check_inertia(DrapeOptions(advanced=Advanced(inertia="network"), motion=0.0))
    with pytest.raises(InputError, match="inertia: expected mesh without a service, got network"):
        site.check_inertia(DrapeOptions(advanced=Advanced(inertia="network"), motion=1.0))


def test_only_folders_of_its_own_are_replaced(tmp_path: Path):
    assert site.is_ours(tmp_path)
    (tmp_path / "about.json").write_text("not ours")
    assert not site.is_ours(tmp_path) and not site.is_ours(tmp_path / "about.json")
    (tmp_path / "about.json").write_text('{"format": 1}')
    assert not site.is_ours(tmp_path)
    (tmp_path / "about.json").write_text('{"format": 1, "garment": "tube", "answers": {}, "network": {}}')
    assert site.is_ours(tmp_path)
