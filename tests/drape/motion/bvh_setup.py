"""Fixtures of tests that write BVH files: rotations, places, and what writes them."""

import pytest

from drape.geometry.rotations import rotvec_to_matrix
from tests.drape.motion.motion_files import BODY_PARENTS, scheme_names, t_pose_offsets, write_bvh


@pytest.fixture
def local(rng):
    """Random rotations relative to the parent, away from gimbal lock."""
    return rotvec_to_matrix(0.5 * rng.normal(size=(5, 22, 3)))


@pytest.fixture
def root(rng):
    return rng.normal(size=(5, 3))


@pytest.fixture
def wrote(local, root, tmp_path):
    """Writes ``local`` and ``root``, with LAFAN's names and a T-pose at rest, or what is given instead."""

    def write(*, names=None, parents=BODY_PARENTS, offsets=None, turns=None, places=None, **more):
        names = scheme_names("lafan") if names is None else names
        offsets = t_pose_offsets() if offsets is None else offsets
        turns, places = local if turns is None else turns, root if places is None else places
        return write_bvh(tmp_path / "clip.bvh", names, parents, offsets, turns, places, **more)

    return write
