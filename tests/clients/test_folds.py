"""Folds that the client makes of a stream's jets are those of the service's stage, for the shipped network."""

from __future__ import annotations

import pytest

from drape.errors import Unavailable
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.folds_of_clients import Worn, client_folder, in_node, rms_mm
from tests.fixtures.garments import ship

FRAMES, FIRST = 12, 10
FIRST_MM, MOST_MM = 0.2, 1.0  # folds remember what is rounding: of the network, of swing's turns and of jets


@pytest.fixture(scope="module")
def shirt(tmp_path_factory: pytest.TempPathFactory) -> Worn:
    folder = ship(tmp_path_factory.mktemp("shirt"), "tshirt")
    runtime = DrapeRuntime(Settings(shipped_garments_dir=folder, garments_dir=folder / "uploads"))
    return Worn.of(runtime, "tshirt", "walk")


def test_the_client_s_shirt_in_a_walk_is_that_of_the_service(shirt: Worn):
    network, server, jets = shirt.streamed(
        FRAMES,
        {"folds": 0, "push_out": False, "motion": 0.0, "passes": 1},
        {},
        {"geometry": "jets", "folds_by": "client"},
    )
    assert len(jets.messages[0]) < 0.25 * len(server.messages[0])
    try:
        with client_folder(shirt, jets.messages, jets.options) as folder:
            client = in_node(folder)
        with client_folder(shirt, jets.messages[:FIRST], jets.options, network.vertices[:FIRST]) as folder:
            same = in_node(folder)
    except Unavailable as missing:
        pytest.skip(str(missing))
    assert (rms_mm(same, server.vertices[:FIRST]) < FIRST_MM).all()
    assert (rms_mm(client, server.vertices) < MOST_MM).all()
    assert (rms_mm(shirt.smooth(jets.messages), server.vertices) > 4.0 * MOST_MM).all()
