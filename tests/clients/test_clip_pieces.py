"""Clients divide what is longer than the service takes, and join it again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from clients.client import AsyncDrapeClient, DrapeClient
from drape.errors import InputError, MotionError
from drape.motion.clip import MotionClip
from service.settings import Settings
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import served
from tests.fixtures.tiny_model import TINY_DYNAMIC

FRAMES = 70
CLIP = MotionClip(*smooth_motion(np.arange(FRAMES) / 30.0), 30.0, "smooth")


@pytest.fixture(scope="module")
def urls(make_settings: Callable[..., Settings]) -> Iterator[tuple[str, str]]:
    """A service that takes 25 frames at once, and one that takes them all."""
    few, many = (make_settings(model=TINY_DYNAMIC, max_frames=most) for most in (25, FRAMES))
    with served(few) as one, served(many) as other:
        yield one, other


def test_long_clips_are_divided_and_joined(urls: tuple[str, str]):
    few, many = urls
    with DrapeClient(few) as divided, DrapeClient(many) as whole:
        assert divided.health()["max_frames"] == 25
        vertices = whole.drape("tube", CLIP)
        assert vertices.shape == (FRAMES, 216, 3)
        assert_array_equal(divided.drape("tube", CLIP), vertices)
        for one, other in zip(divided.drape_at_root("tube", CLIP), whole.drape_at_root("tube", CLIP), strict=True):
            assert_array_equal(one, other)
        assert_array_equal(divided.drape_outfit(["tube"], CLIP)[0], vertices)
        jets = [client.drape_jets("tube", CLIP) for client in (divided, whole)]
        assert [frame.sequence for frame in jets[0]] == list(range(FRAMES))
        assert_array_equal([frame.jet for frame in jets[0]], [frame.jet for frame in jets[1]])
        body = divided.bodies()[0]["id"]
        assert_array_equal(divided.posed_body(body, CLIP), whole.posed_body(body, CLIP))
        pieces = list(divided.drape_frames("tube", CLIP, at_once=20))
        assert [len(one) for (one,) in pieces] == [20, 20, 20, 10]
        assert_array_equal(np.concatenate([one for (one,) in pieces]), vertices)

    async def awaited() -> None:
        async with AsyncDrapeClient(few) as client:
            assert_array_equal(await client.drape("tube", CLIP), vertices)
            found = [one async for (one,) in client.drape_frames(["tube"], CLIP)]
            assert [len(one) for one in found] == [25, 25, 20]
            assert_array_equal(np.concatenate(found), vertices)

    asyncio.run(awaited())


@pytest.mark.parametrize("quantised", [True, False])
def test_a_long_glb_is_written_as_the_service_writes_it(urls: tuple[str, str], quantised: bool):
    few, many = urls
    with DrapeClient(few) as divided, DrapeClient(many) as whole:
        expected = whole.drape_glb("tube", CLIP, quantised=quantised)
        assert divided.drape_glb("tube", CLIP, quantised=quantised) == expected
        with pytest.raises(InputError, match="body: expected at most 25 frames with it, got 70"):
            divided.drape_glb("tube", CLIP, body=True)


def test_as_many_translations_as_poses_are_needed():
    with (
        DrapeClient("http://example") as client,
        pytest.raises(MotionError, match=r"trans: expected shape \(70, 3\), got shape \(60, 3\)"),
    ):
        client.drape("tube", CLIP, trans=CLIP.trans[:60])
