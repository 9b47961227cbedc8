"""The avatars in service: whose they are, what other services did with them, what they wear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from drape.avatar import wears
from drape.avatar.own_clothes import Halves
from drape.avatar.own_garments import own_garments
from drape.avatar.wearer import Wearer, read_wearer, save_wearer
from drape.avatar.wears import Reach
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from drape.contact import skin
from drape.contact.skin import keep_skins
from drape.errors import BodyError, InputError, NotFound, TooLarge
from drape.garment.cache import Garment, save_garment
from drape.stages.scene import Entry
from service.compute import avatars as in_service
from service.compute.drape_runtime import DrapeRuntime
from tests.fixtures.characters import bare_wearer
from tests.fixtures.dressed_characters import dressed_character, dressed_parts


@pytest.fixture(scope="module")
def wearers() -> list[Wearer]:
    """Two wearers of one name."""
    one = replace(bare_wearer(), name="twin")
    return [one, replace(one, digest=one.digest[::-1])]


def add(avatars: in_service.Avatars, wearer: Wearer, folder: Path, owner: str | None) -> in_service.AvatarEntry:
    file = folder / "sent.glb"
    file.write_bytes(b"")
    made = save_wearer(wearer, folder)
    entry = avatars.add(made, file, owner)
    assert not made.exists() and not file.exists()
    return entry


def test_two_of_one_name_have_two_ids_and_one_of_a_key_is_its_own(
    make_runtime: Callable[..., DrapeRuntime], wearers: list[Wearer], tmp_path: Path
):
    avatars = make_runtime().avatars
    one, other = (add(avatars, wearer, tmp_path, None) for wearer in wearers)
    own = add(avatars, wearers[0], tmp_path, "alice")
    assert one.id == "twin" and other.id == f"twin-{wearers[1].digest[:8]}" and own.id.startswith("twin-")
    assert avatars.visible("alice") == [one, other, own] and avatars.visible("bob") == [one, other]
    for entry in (one, other, own):
        avatars.remove(entry)
    assert not avatars.visible("alice") and not [path for path in own.path.parent.iterdir() if path.is_file()]


def test_what_is_done_with_avatars_in_one_service_the_other_takes_over(
    make_runtime: Callable[..., DrapeRuntime], wearers: list[Wearer], tmp_path: Path
):
    runtime = make_runtime()
    here = runtime.avatars
    there = in_service.Avatars(runtime.body, runtime.settings, runtime.stages_on)
    entry = add(here, wearers[0], tmp_path, "alice")
    assert not there.visible("alice")
    there.follow()
    assert there.get(entry.id, "alice") == entry
    tube = runtime.garments.get("tube")
    before = there.dress(entry.id, tube)
    there.follow()
    assert there.dress(entry.id, tube) is before, "nothing changed"
    here.replace(entry, save_wearer(replace(wearers[0], median_mm=3.0), tmp_path))
    there.follow()
    assert there.get(entry.id, "alice").facts.fit["median_mm"] == 3.0 and there.wearer(entry.id).median_mm == 3.0
    assert not there.worn or there.dress(entry.id, tube) is not before
    there.remove(there.get(entry.id, "alice"))
    here.follow()
    assert not here.visible("alice") and not here.worn


def test_few_avatars_are_kept_dressed(
    make_runtime: Callable[..., DrapeRuntime], wearers: list[Wearer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    runtime = make_runtime()
    monkeypatch.setattr(in_service, "MOST_WORN", 1)
    for wearer in wearers:
        entry = add(runtime.avatars, wearer, tmp_path, None)
        runtime.avatars.dress(entry.id, runtime.garments.get("tube"))
    assert len(runtime.avatars.worn) == 1


def test_what_an_avatar_cannot_wear_is_told_before_and_in_the_same_words(
    make_runtime: Callable[..., DrapeRuntime], wearers: list[Wearer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    runtime = make_runtime()
    entry, tube = add(runtime.avatars, wearers[0], tmp_path, None), runtime.garments.get("tube")
    assert runtime.avatars.wears(entry.id, [tube]) == {"tube": None}
    monkeypatch.setattr(in_service, "reach_of", lambda garment, body: Reach(Halves(False, True), True))
    monkeypatch.setattr(wears, "THICKEST", 0.01)
    avatars = runtime.avatars
    avatars._reaches.clear()
    why = avatars.wears(entry.id, [tube])["tube"]
    assert why is not None and "times as thick as long" in why
    with pytest.raises(BodyError) as refused:
        avatars.dress(entry.id, tube)
    assert str(refused.value) == why


def test_while_an_intake_runs_the_skins_of_its_wearer_are_made_and_where_garments_lie(
    make_runtime: Callable[..., DrapeRuntime], wearers: list[Wearer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    runtime = make_runtime()
    runtime.expect_avatar("start", tmp_path, None)
    runtime.expect_avatar("read", tmp_path, None)
    assert runtime.constants_process._process is not None
    save_wearer(wearers[0], tmp_path)
    (tmp_path / "twin~top-0.npz").touch()  # its clothes come later
    body = replace(wearers[0].body, digest="another")
    monkeypatch.setattr("service.compute.drape_runtime.load_wearer", lambda *of: replace(wearers[0], body=body))
    runtime.expect_avatar("cloth", tmp_path, None)
    keep_skins(body, lambda *of: pytest.fail("they are there"))
    assert runtime.constants_process.call_there(kept_skins, "another") == 2, "there as well"
    entry = add(runtime.avatars, wearers[0], tmp_path, None)
    monkeypatch.setattr(in_service, "reach_of", lambda *of: pytest.fail("it is known"))
    assert runtime.avatars.wears(entry.id, runtime.garments.visible(None)) == {"tube": None}


def kept_skins(digest: str) -> int:
    """How many skins of the body ``digest`` this process keeps."""
    return sum(key[1] == digest for key in skin._KEPT)


def test_own_clothes_count_among_the_layers(
    make_runtime: Callable[..., DrapeRuntime],
    body: BodyModel,
    tube: Garment,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    """A character in a top of its own wears that, and shorts of ours with it only where two are draped; nobody else
    wears it."""
    shorts = open_garment(find_garments(["shorts"])[0], body)
    payload = dressed_character(body, dressed_parts(body, {"top": tube}, rucksack=False))
    wearer = read_wearer(payload, name="doll", body=body)
    own = own_garments(payload, wearer)
    scene = Entry("shorts", shorts, "shipped")
    for limit in (1, 2):
        avatars = make_runtime(max_layers=limit).avatars
        (tmp_path / "sent.glb").write_bytes(payload)
        files = in_service.OwnFiles([save_garment(one, tmp_path) for one in own.garments], own.stiff)
        entry = avatars.add(save_wearer(wearer, tmp_path), tmp_path / "sent.glb", None, files)
        with monkeypatch.context() as patched:
            patched.setattr(in_service, "load_wearer", None)
            patched.setattr(in_service, "load_garment", None)
            assert [one.id for one in avatars.with_own(entry.id, None).layers] == ["doll~top"], "nothing is read again"
        if limit == 2:
            me = add(avatars, replace(bare_wearer(), name="me"), tmp_path, None)
            with pytest.raises(InputError, match="expected doll, who came in doll~top, got me"):
                avatars.dress(me.id, avatars.with_own(entry.id, None))
            with pytest.raises(NotFound, match="an avatar with garments of its own"):
                avatars.with_own(me.id, None)
            assert [one.id for one in avatars.with_own(entry.id, scene).layers] == ["shorts", "doll~top"]
            return
        with pytest.raises(TooLarge, match="at most 1 layers, got 2"):
            avatars.with_own(entry.id, scene)
        avatars.remove(entry)
