"""A model folder as a function."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks import model_drape as subject
from drape.artifacts import DEFAULT_MODEL, MODELS_DIR, load_manifest
from drape.cloth.fabric_table import fabric
from drape.errors import ArtifactError, InputError
from tests.benchmarks.quality_setup import bending, body, network, tube
from tests.fixtures.packed import SMALL, exported, exported_dynamic, garment
from tests.fixtures.tiny_model import ROUNDING_M, expected_vertices, write_tiny_model
from training.disagreement import chart_positions


def test_the_charts_that_come_with_the_vertices_blend_into_them_however_many_calls_they_take():
    poses = bending(subject.FRAMES_PER_CALL + 3)
    draped = network().drape(tube(), poses)
    said = chart_positions(tube(), draped.jet, draped.rotation, draped.centre)
    blended = np.einsum("vk,fvka->fva", tube().chart_weight, said) + draped.root
    assert draped.vertices.shape == (len(poses), *tube().vertices.shape)
    assert_allclose(draped.vertices, blended, rtol=0.0, atol=5e-6)


def test_all_of_the_subdivided_mesh_is_draped():
    assert network().drape(garment("shorts"), bending(1)).vertices.shape[1] == len(garment("shorts").vertices)


def test_a_dynamic_model_is_measured_at_rest():
    static, dynamic = (subject.ModelDrape(made()[1], body(), threads=1) for made in (exported, exported_dynamic))
    vertices = (made.drape(tube(), bending(2)).vertices for made in (dynamic, static))
    assert_allclose(*vertices, rtol=0.0, atol=2e-6)


def test_a_record_says_what_computed_which_model():
    folder = MODELS_DIR / DEFAULT_MODEL
    made = subject.ModelDrape(folder, body(), threads=1)
    assert made.record() == {"graph": "compiled", "model_digest": load_manifest(folder).digest}


def test_a_fabric_is_what_the_network_is_told_and_its_default_is_jersey():
    made, poses = subject.ModelDrape(exported()[1], body(), threads=1), bending(1)
    own, jersey, denim = (
        one.drape(tube(), poses).vertices for one in (made, *(made.made_of(fabric(f)) for f in ("jersey", "denim")))
    )
    assert_array_equal(jersey, own)
    wanted = expected_vertices(body(), tube(), poses, np.zeros((1, 3)), fabric=fabric("denim"))
    assert_allclose(denim, wanted, rtol=0.0, atol=ROUNDING_M)
    assert np.linalg.norm(denim - own, axis=-1).max() > 2.0 * ROUNDING_M


def test_as_many_passes_run_as_are_asked_for():
    whole, none = (subject.ModelDrape(exported()[1], body(), threads=1, passes=count) for count in (None, 0))
    assert (whole.passes, none.passes) == (SMALL.corrections, 0)
    drapes = [made.drape(tube(), bending(1)).vertices for made in (whole, none)]
    assert np.linalg.norm(drapes[0] - drapes[1], axis=-1).max() > 1e-3
    with pytest.raises(InputError, match=f"passes: expected 0 to {SMALL.corrections}"):
        subject.ModelDrape(exported()[1], body(), threads=1, passes=9)


def test_a_model_of_another_body_is_refused(tmp_path):
    folder = write_tiny_model(tmp_path, replace(body(), digest="0" * 64))
    with pytest.raises(ArtifactError, match="tiny body_digest"):
        subject.ModelDrape(folder, body(), threads=1)
