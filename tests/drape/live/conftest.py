"""A tank on two levels, at rest on the body and a little crumpled."""

from __future__ import annotations

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.cloth.fabric_table import fabric
from drape.contact.skin import shaped_skin
from drape.live.clock import Frame
from drape.live.two_level import TwoLevel, two_level
from tests.fixtures.garments import shipped


@pytest.fixture(scope="session")
def tank() -> TwoLevel:
    return two_level(shipped("tank"), load_body(), fabric("jersey"))


@pytest.fixture(scope="session")
def still() -> Frame:
    """The tank at rest on the body at rest, a little crumpled, so that there is something to fold."""
    garment, body = shipped("tank"), load_body()
    poses = np.zeros((1, 24, 3))
    skin = shaped_skin(body).table(*body.bones(poses), np.zeros((1, body.shape_count)))
    vertices = garment.vertices[: garment.vertex_count].astype(np.float64)
    wave = 0.004 * np.sin(60.0 * vertices[:, 1:2]) * np.array([1.0, 0.0, 1.0])
    return Frame((vertices + wave).astype(np.float32), skin.reshape(-1, skin.shape[-1]), 0.0)
