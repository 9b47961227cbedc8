"""A model folder as a function."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks import network as subject
from drape.errors import ArtifactError
from drape.garment.disagreement import chart_positions
from tests.benchmarks.quality_setup import bending, body, network, tube
from tests.fixtures.tiny_model import expected_vertices, tube_garment, write_tiny_model


def test_vertices_are_the_models_in_the_world_however_many_calls_they_take(tmp_path):
    poses = bending(subject.FRAMES_PER_CALL + 3)
    garment = tube_garment(body())  # its features lift the patches: the embedding must arrive
    draped = network(tmp_path).drape(garment, poses)
    expected = expected_vertices(body(), garment, poses, np.zeros((len(poses), 3)))
    assert_allclose(draped.vertices, expected, rtol=0.0, atol=2e-6)


def test_the_charts_that_come_with_the_vertices_blend_into_them(tmp_path):
    draped = network(tmp_path).drape(tube(), bending(2))
    said = chart_positions(tube(), draped.jet, draped.rotation, draped.centre)
    blended = np.einsum("vk,fvka->fva", tube().chart_weight, said) + draped.root[:, None]
    assert_allclose(draped.vertices, blended, rtol=0.0, atol=2e-6)


def test_a_model_of_another_body_is_refused(tmp_path):
    folder = write_tiny_model(tmp_path, replace(body(), digest="0" * 64))
    with pytest.raises(ArtifactError, match="model tiny body"):
        subject.Network(folder, body(), threads=1)
