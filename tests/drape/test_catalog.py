"""Names on a command line find shipped files, files and folders."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drape import catalog
from drape.errors import ArtifactError, NotFound
from drape.garment.cache import save_garment
from tests.fixtures.cut_garments import cut_garment


def test_names_files_and_folders_are_found(tmp_path):
    for name in ("tank-0123456789abcdef.npz", "long-sleeve.obj", "avatar_female.obj", "notes.txt"):
        (tmp_path / name).touch()
    suffixes = (".npz", ".obj")

    def find(*names):
        return [path.name for path in catalog.find_files(names, tmp_path, suffixes, "garment")]

    assert find() == ["long-sleeve.obj", "tank-0123456789abcdef.npz"]
    assert find("tank") == ["tank-0123456789abcdef.npz"]
    assert find("long-sleeve", str(tmp_path / "notes.txt")) == ["long-sleeve.obj", "notes.txt"]
    with pytest.raises(NotFound, match="tank"):
        find("trousers")


def test_without_names_everything_shipped_is_found():
    garments = catalog.find_garments([])
    assert "tshirt" in {catalog.short_name(path) for path in garments}
    assert [path.stem for path in catalog.find_motions(["walk"])] == ["walk"]


def test_a_model_was_trained_on_the_designs_and_files_that_it_names(body, tube):
    cut = cut_garment("tank")
    assert catalog.was_trained_on(cut, ["tshirt", "tank"])
    assert not catalog.was_trained_on(cut, ["tshirt"])
    sewn = catalog.open_garment(catalog.find_garments(["tank"])[0], body)  # has the name of a design, and is none
    assert not catalog.was_trained_on(sewn, ["tshirt", "tank"])
    for name in (f"runs/sewn/{sewn.file_name()}", f"{sewn.name}-{sewn.digest[:16]}"):  # a model's manifest has these
        assert catalog.was_trained_on(sewn, [name])
    other = replace(tube, name="tank")  # no design: the name alone says nothing
    assert not catalog.was_trained_on(other, ["tank"])
    assert catalog.was_trained_on(other, ["tshirt", f"runs/sewn/{other.file_name()}"])


def test_a_cached_garment_is_opened_unless_it_was_made_for_another_body(tmp_path, body, tube):
    path = save_garment(tube, tmp_path)
    assert catalog.open_garment(path, body).digest == tube.digest
    other = save_garment(replace(tube, name="other", body_digest="0" * 64), tmp_path)
    with pytest.raises(ArtifactError, match="garment other body"):
        catalog.open_garment(other, body)
