"""Clothes that a character came in by REST: what comes off, what is bare then, and what is alive."""

from __future__ import annotations

import json
from collections.abc import Iterator

import httpx
import numpy as np
import pytest
from websockets.sync.client import connect

from drape.avatar.character import character_in
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from drape.files.gltf import GltfFile
from service.settings import Settings
from tests.fixtures.avatar_calls import NUMBERS, POSES, ended, sent, stream_of
from tests.fixtures.dressed_characters import dressed_character, dressed_parts
from tests.fixtures.glb_reader import Reader
from tests.fixtures.serving import files_in
from tests.fixtures.streams import PROTOCOLS

OWN = {"top": "tank", "trousers": "shorts"}
N_TOP = "N00_007_01_Tops_01_CLOTH (Instance)"


@pytest.fixture(scope="module")
def dressed(api: httpx.Client, body: BodyModel) -> Iterator[str]:
    """Our body in a tank top and shorts of its own, without skin below, with a rucksack, sent with its clothes alive:
    its id in the service."""
    garments = {kind: open_garment(find_garments([name])[0], body) for kind, name in OWN.items()}
    payload = dressed_character(body, dressed_parts(body, garments, cut_away=True))
    job = sent(api, payload, "doll.glb", alive=True)
    assert job["state"] == "done", job["problem"]
    yield job["avatar"]
    api.delete(f"/avatars/{job['avatar']}")


def test_own_clothes_come_off_and_the_skin_below_is_there(api: httpx.Client, dressed: str):
    """The tube lies on the trunk alone: the T-shirt goes with the rucksack, and the trousers stay."""
    parts = {part["kind"]: part for part in api.get(f"/avatars/{dressed}").json()["parts"]}
    assert parts["carried"]["bulky"] and not parts["hair"]["bulky"]
    found = api.get(f"/avatars/{dressed}/covered", params={"garments": "tube"}).json()
    assert sum(found["hidden"][1::2]) == parts["top"]["faces"] + parts["carried"]["faces"]
    gone = [sum(one["hidden"][1::2]) for one in found["primitives"]]
    assert sum(gone) == sum(found["hidden"][1::2]) and set(gone) == {
        0,
        parts["top"]["faces"],
        parts["carried"]["faces"],
    }
    bare = api.get(f"/avatars/{dressed}/bare", params={"garments": "tube"})
    assert bare.status_code == 200, bare.text
    skin = character_in(GltfFile(bare.content))
    assert len(skin.faces) == found["bare"] > 500


def layers(answer: httpx.Response) -> list[str]:
    assert answer.status_code == 200, answer.text
    return [one.partition(":")[0] for one in answer.headers["X-Drape-Garments"].split(",")]


def test_its_clothes_are_garments_of_its_own(api: httpx.Client, dressed: str):
    told = api.get(f"/avatars/{dressed}").json()
    assert [(one["garment"], one["kind"]) for one in told["alive"]] == [
        ("doll~trousers", "trousers"),
        ("doll~top", "top"),
    ]
    named = {part["name"]: part["kind"] for part in told["parts"]}
    assert [[named[name] for name in one["parts"]] for one in told["alive"]] == [["trousers"], ["top"]]
    assert told["stiff"] == {}
    assert not [one["id"] for one in api.get("/garments").json() if "~" in one["id"]]
    assert api.get("/garments/doll~top").json()["materials"] == [N_TOP]
    assert len(api.get("/garments/doll~top/mesh").json()["faces"]) == told["parts"][4]["faces"]
    assert api.get("/garments/doll~top/looks").json()["materials"][0]["base_colour"][2] == pytest.approx(0.6, abs=0.01)
    assert api.get("/garments/doll~hat").status_code == 404
    assert api.get("/garments/nobody~top").status_code == 404


def test_its_clothes_change_only_with_it(api: httpx.Client, dressed: str):
    assert api.patch("/garments/doll~top", json={"name": "mine"}).status_code == 403
    assert api.delete("/garments/doll~top").status_code == 403
    assert not [one["id"] for one in api.get("/garments").json() if "~" in one["id"]]


def test_it_is_draped_in_them_and_in_what_replaces_them(api: httpx.Client, dressed: str):
    asked = {"avatar": dressed, "poses": POSES.tolist(), "alive": True}
    answer = api.post("/drape", json=asked, headers=NUMBERS)
    assert layers(answer) == ["doll~trousers", "doll~top"]
    vertices = np.frombuffer(answer.content, "<f4")
    assert np.isfinite(vertices).all() and np.ptp(vertices.reshape(2, -1, 3)[0], axis=0)[1] > 0.8
    assert layers(api.post("/drape", json=asked | {"garment": "tube"}, headers=NUMBERS)) == ["doll~trousers", "tube"]
    twice = api.post("/drape", json=asked | {"garments": ["doll~top"]}, headers=NUMBERS)
    assert layers(twice) == ["doll~trousers", "doll~top"]
    alone = api.post("/drape", json={"garment": "doll~top", "poses": POSES.tolist()}, headers=NUMBERS)
    assert alone.status_code == 200 and "X-Drape-Garments" not in alone.headers
    rig = api.post("/drape", json=asked | {"rig": True}, headers={"Accept": "model/gltf-binary"})
    made = Reader(rig.content)
    assert [mesh["name"] for mesh in made.json["meshes"]] == ["doll~trousers", "doll~top", "bare skin"]
    bare = made.array(made.json["meshes"][2]["primitives"][0]["indices"]).size // 3
    covered = api.get(f"/avatars/{dressed}/covered", params={"alive": True}).json()
    assert 500 < bare < covered["bare"], "what nobody sees is in no file"


def test_a_stream_shows_them(api: httpx.Client, dressed: str):
    with connect(stream_of(api), subprotocols=PROTOCOLS) as socket:
        socket.send(json.dumps({"type": "open", "avatar": dressed, "alive": True}))
        opened = json.loads(socket.recv(60.0))
    assert [one["id"] for one in opened["garments"]] == ["doll~trousers", "doll~top"], opened


def test_their_faces_are_hidden_and_what_they_replace_is_not(api: httpx.Client, dressed: str):
    """The rucksack stays over the own top, and goes with that where a tube replaces it."""
    faces = {part["kind"]: part["faces"] for part in api.get(f"/avatars/{dressed}").json()["parts"]}
    own, under = (
        api.get(f"/avatars/{dressed}/covered", params={"alive": True} | more).json()
        for more in ({}, {"garments": "tube"})
    )
    assert sum(own["hidden"][1::2]) == faces["top"] + faces["trousers"]
    assert sum(under["hidden"][1::2]) == faces["top"] + faces["trousers"] + faces["carried"]
    assert own["share"] > 0.0


def test_they_are_garments_too_where_only_one_is_draped(api: httpx.Client, dressed: str):
    refused = api.post("/drape", json={"avatar": dressed, "poses": POSES.tolist(), "alive": True, "tier": "exact"})
    assert (refused.status_code, refused.json()["expected"]) == (400, "one garment with tier exact"), refused.text


@pytest.mark.parametrize("asked", [{}, {"garment": "tube"}])
def test_clothes_of_nobody_are_refused(api: httpx.Client, asked: dict[str, str]):
    refused = api.post("/drape", json={"poses": POSES.tolist(), "alive": True, **asked})
    assert (refused.status_code, refused.json()["expected"]) == (400, "an avatar"), refused.text


def test_a_part_is_corrected_and_clothes_go_with_the_avatar(api: httpx.Client, dressed: str, settings: Settings):
    before = {part["name"]: part for part in api.get(f"/avatars/{dressed}").json()["parts"]}
    name = next(key for key, part in before.items() if part["kind"] == "top")
    job = ended(api, api.patch(f"/avatars/{dressed}", json={"parts": {name: "skin"}}))
    assert job["state"] == "done", job
    told = api.get(f"/avatars/{dressed}").json()
    after = {part["name"]: part for part in told["parts"]}
    assert (after[name]["kind"], after[name]["sure"], told["found_by"]) == ("skin", 1.0, "names")
    assert after.keys() == before.keys()
    assert [one["kind"] for one in told["alive"]] == ["trousers"]
    names = [path.name for path in files_in(settings.garments_dir)]
    assert [name for name in names if "~" in name] == ["doll~trousers.npz"]
    assert api.patch(f"/avatars/{dressed}", json={"parts": {name: "wig"}}).status_code == 400
    assert api.delete(f"/avatars/{dressed}").status_code == 204
    assert not [path for path in files_in(settings.garments_dir) if path.name.startswith("doll")]
