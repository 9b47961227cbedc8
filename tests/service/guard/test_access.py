"""Keys, tickets and limits; garments that belong to a key; and the start that refuses to stand open."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
from starlette.datastructures import Headers
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Subprotocol

from clients import cli
from clients.client import AsyncDrapeClient, DrapeClient
from clients.stream import DrapeStream
from drape.avatar.wearer import save_wearer
from drape.body.model import BodyModel
from drape.errors import DrapeError, InputError
from drape.garment.cache import save_garment
from drape.wire import messages as wire
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.compute.threads import SlicedThread
from service.errors import Busy, Full, Unauthorized
from service.guard.access import Access
from service.guard.key_file import key_digest, load_keys
from service.guard.tickets import LIFE_S, Tickets
from service.settings import Settings, check_exposed
from service.uploads.jobs import Uploads
from tests.architecture.repository import ROOT
from tests.fixtures.characters import bare_wearer
from tests.fixtures.garments import tube_garment
from tests.fixtures.patience import PATIENT_S
from tests.fixtures.serving import files_in, serve, served
from tests.fixtures.streams import PROTOCOLS, stream_address

KEYS = {"shop": "key-of-shop", "lab": "key-of-lab", "slow": "key-of-slow"}
LIMITS = {"lab": {"garments": 1, "streams": 1, "clips": 0}, "slow": {"rate": 0.01, "bytes": 1000}}
REST = np.zeros((1, 24, 3)).tolist()


def write_keys(folder: Path) -> Path:
    path = folder / "keys.json"
    path.write_text(
        json.dumps({name: {"sha256": key_digest(key), **LIMITS.get(name, {})} for name, key in KEYS.items()})
    )
    return path


@pytest.fixture(scope="module")
def guarded(
    make_settings: Callable[..., Settings], tmp_path_factory: pytest.TempPathFactory, body: BodyModel
) -> Settings:
    settings = make_settings(keys_file=write_keys(tmp_path_factory.mktemp("keys")))
    for owner, name in (("shop", "coat"), ("lab", "cape")):
        save_garment(tube_garment(body, name=name), settings.garments_dir / f"of-{owner}")
    return settings


@pytest.fixture(scope="module")
def url(guarded: Settings) -> Iterator[str]:
    with served(guarded) as address:
        yield address


def bearer(name: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {KEYS[name]}"}


def ids(url: str, name: str) -> set[str]:
    return {garment["id"] for garment in httpx.get(url + "/garments", headers=bearer(name)).json()}


def own(url: str, name: str) -> str:
    return next(garment for garment in ids(url, name) if garment != "tube")


def test_without_a_key_nothing_is_answered_but_life(url: str):
    for path in (
        "/garments",
        "/health",
        "/motions",
        "/bodies",
        "/fabrics",
        "/metrics",
        "/jobs/x",
        "/garments/tube/jets",
    ):
        response = httpx.get(url + path)
        assert response.status_code == 401 and response.headers["WWW-Authenticate"] == "Bearer", path
        assert "key: expected an API key or a ticket, got none" in response.json()["detail"]
    for path in ("/drape", "/garments", "/tickets", "/bodies/anny_default/posed"):
        assert httpx.post(url + path).status_code == 401
    assert httpx.patch(url + "/garments/tube").status_code == httpx.delete(url + "/garments/tube").status_code == 401
    for path in ("/livez", "/readyz", "/docs", "/openapi.json"):
        assert httpx.get(url + path).status_code == 200
    wrong = httpx.get(url + "/garments", headers={"Authorization": "Bearer nonsense"})
    assert wrong.status_code == 401 and "nonsense" not in wrong.text


def test_a_ticket_of_a_key_asks_for_it(url: str):
    made = httpx.post(url + "/tickets", headers=bearer("shop")).json()
    assert made["expires_s"] == LIFE_S
    header = {"Authorization": f"Bearer {made['ticket']}"}
    assert {garment["id"] for garment in httpx.get(url + "/garments", headers=header).json()} == ids(url, "shop")
    again = httpx.post(url + "/tickets", headers=header)
    assert again.status_code == 401 and "got a ticket" in again.json()["detail"]
    forged = httpx.get(url + "/garments", headers={"Authorization": "Bearer " + made["ticket"][:-2] + "AA"})
    assert forged.status_code == 401 and "did not sign" in forged.json()["detail"]


def stream(url: str, offered: list[str], headers: dict[str, str] | None = None, garment: str = "tube") -> dict:
    async def talk() -> dict:
        try:
            async with connect(
                stream_address(url), subprotocols=[Subprotocol(one) for one in offered], additional_headers=headers
            ) as socket:
                assert socket.response is not None
                assert socket.response.headers["Sec-WebSocket-Protocol"] == wire.SUBPROTOCOL
                await socket.send(json.dumps({"type": "open", "garment": garment}))
                return json.loads(await socket.recv())
        except InvalidStatus as refused:
            return json.loads(refused.response.body)

    return asyncio.run(talk())


def test_a_stream_is_opened_by_a_header_or_by_a_ticket_that_it_spends(url: str):
    ticket = httpx.post(url + "/tickets", headers=bearer("shop")).json()["ticket"]
    offered = [wire.SUBPROTOCOL, f"ticket.{ticket}"]
    assert stream(url, offered, garment=own(url, "shop"))["type"] == "opened"
    assert "used for another stream" in stream(url, offered)["detail"]
    assert stream(url, [wire.SUBPROTOCOL], bearer("shop"))["type"] == "opened"
    assert stream(url, [wire.SUBPROTOCOL])["status"] == 401
    other = stream(url, ["drape.v0", f"ticket.{ticket}"])
    assert other["status"] == 400 and ticket not in json.dumps(other)
    assert stream(url, [wire.SUBPROTOCOL], bearer("lab"), own(url, "shop"))["status"] == 404


def test_tickets_end_and_are_of_one_secret():
    tickets = Tickets("secret")
    ticket = tickets.make("shop", now_s=100.0)
    assert tickets.name(ticket, now_s=100.0) == Tickets("secret").name(ticket, now_s=100.0 + LIFE_S) == "shop"
    with pytest.raises(Unauthorized, match="expired"):
        tickets.name(ticket, now_s=101.0 + LIFE_S)
    for other in (Tickets("other"), Tickets()):
        with pytest.raises(Unauthorized, match="did not sign"):
            other.name(ticket, now_s=100.0)
    assert tickets.name(ticket, spend=True, now_s=100.0) == "shop"
    with pytest.raises(Unauthorized, match="another stream"):
        tickets.name(ticket, spend=True, now_s=100.0)


def test_a_ticket_of_a_key_that_is_gone_is_refused(guarded: Settings):
    access = Access(guarded)
    ticket = access.tickets.make("former")
    with pytest.raises(Unauthorized, match="a key that no longer exists"):
        access.admit(httpx_headers(f"Bearer {ticket}"))


def httpx_headers(value: str) -> Headers:
    return Headers({"authorization": value})


def test_limits_of_a_key_are_its_own(url: str, guarded: Settings):
    assert [httpx.get(url + "/garments", headers=bearer("slow")).status_code for _ in range(2)] == [200, 429]
    refused = httpx.get(url + "/garments", headers=bearer("slow"))
    assert "requests: expected at most 0.01 a second" in refused.json()["detail"] and refused.headers["Retry-After"]
    clip = {"garment": "tube", "poses": REST}
    assert httpx.post(url + "/drape", json=clip, headers=bearer("lab")).status_code == 429
    assert httpx.post(url + "/drape", json=clip, headers=bearer("shop")).status_code == 200
    full = httpx.post(url + "/garments?name=b.obj", content=b"x", headers=bearer("lab"))
    assert full.status_code == 507 and "garments of a key: expected at most 1, got 1" in full.json()["detail"]
    access = Access(guarded)
    lab = access.admit(httpx_headers(f"Bearer {KEYS['lab']}"))
    with access.using(lab, "streams"), pytest.raises(Busy, match="at most 1 of one key"), access.using(lab, "streams"):
        pass
    with access.using(lab, "streams"):
        pass


def test_characters_count_among_the_bytes_of_a_key(guarded: Settings, make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime(keys_file=guarded.keys_file)
    uploads = Uploads(runtime, SlicedThread(), access := Access(runtime.settings))
    uploads.check_place(slow := access.client("slow"))
    folder = runtime.settings.garments_dir / ".avatars" / "of-slow"
    folder.mkdir(parents=True)
    (folder / "me.glb").write_bytes(bytes(1000))
    with pytest.raises(Full, match="bytes of a key's garments: expected at most 1000, got 1000"):
        uploads.check_place(slow)


def test_a_garment_is_private_until_published(url: str, guarded: Settings):
    mine = own(url, "shop")
    assert mine.startswith("coat-") and mine not in ids(url, "lab")
    for path in (f"/garments/{mine}", f"/garments/{mine}/mesh", f"/garments/{mine}/jets"):
        foreign = httpx.get(url + path, headers=bearer("lab"))
        assert foreign.status_code == 404 and mine not in foreign.json()["expected"]
        assert httpx.get(url + path, headers=bearer("shop")).status_code == 200
    address = f"{url}/garments/{mine}"
    assert httpx.patch(address, json={"published": True}, headers=bearer("lab")).status_code == 404
    changed = httpx.patch(address, json={"published": True, "name": "Mantel"}, headers=bearer("shop")).json()
    assert (changed["id"], changed["name"], changed["published"]) == (mine, "Mantel", True)
    assert mine in ids(url, "lab")
    for call in (
        httpx.delete(address, headers=bearer("lab")),
        httpx.patch(address, json={"name": "x"}, headers=bearer("lab")),
    ):
        assert call.status_code == 403 and "one of another key" in call.json()["detail"]
    (about,) = guarded.garments_dir.glob("of-shop/*.about.json")
    assert json.loads(about.read_text()) == {"title": "Mantel", "published": True}
    httpx.patch(address, json={"published": False}, headers=bearer("shop"))
    assert mine not in ids(url, "lab")
    assert httpx.patch(address, json={}, headers=bearer("shop")).status_code == 400


def test_shipped_garments_stay(url: str):
    response = httpx.delete(url + "/garments/tube", headers=bearer("shop"))
    assert response.status_code == 403 and "a shipped one" in response.json()["detail"]


def test_what_was_uploaded_without_a_key_stays(
    make_settings: Callable[..., Settings], guarded: Settings, body: BodyModel, tmp_path: Path
):
    """All keys may use what was there before there were keys, and none may change it."""
    settings = make_settings(keys_file=guarded.keys_file)
    save_garment(tube_garment(body, name="veil"), settings.garments_dir)
    app = create_app(settings)
    source = tmp_path / "old.glb"
    source.write_bytes(b"")
    with serve(app, settings) as url:
        app.state.drape.runtime.avatars.add(save_wearer(replace(bare_wearer(), name="old"), tmp_path), source, None)
        for path in ("/garments/veil", "/avatars/old"):
            assert httpx.get(url + path, headers=bearer("shop")).status_code == 200
            for change in (httpx.delete, httpx.patch):
                refused = change(url + path, headers=bearer("shop"))
                assert refused.status_code == 403 and "one of your own" in refused.json()["detail"]


def test_a_deleted_garment_is_gone_from_service_disk_and_streams(
    make_settings: Callable[..., Settings], body: BodyModel, tmp_path: Path
):
    settings = make_settings()
    save_garment(tube_garment(body, name="gown", radius_m=0.21), settings.garments_dir)
    app = create_app(settings)
    with serve(app, settings) as url:
        registry = app.state.drape.runtime.garments
        key = registry.get("gown").garment.digest

        async def worn() -> tuple[int, int]:
            async with connect(stream_address(url), subprotocols=PROTOCOLS) as socket:
                await socket.send(json.dumps({"type": "open", "garment": "gown"}))
                await socket.recv()
                deleted = await asyncio.to_thread(httpx.delete, url + "/garments/gown")
                try:
                    while True:
                        await asyncio.wait_for(socket.recv(), PATIENT_S)
                except ConnectionClosed as closed:
                    return deleted.status_code, 0 if closed.rcvd is None else closed.rcvd.code

        assert asyncio.run(worn()) == (204, 4404)
        assert httpx.get(url + "/garments/gown").status_code == 404
        assert files_in(settings.garments_dir) == []
        stages = {stage.name: stage for stage in app.state.drape.runtime.stages}
        assert key not in stages["collision"].pusher._stored and key not in stages["network"].packer._store
        assert httpx.post(url + "/drape", json={"garment": "tube", "poses": REST}).status_code == 200


def test_names_and_publishing_outlive_the_service(make_settings: Callable[..., Settings], body: BodyModel):
    from service.compute.drape_runtime import DrapeRuntime

    settings = make_settings()
    path = save_garment(tube_garment(body, name="gown"), settings.garments_dir / "of-shop")
    path.with_suffix(".about.json").write_text('{"title": "Kleid", "published": true}')
    shutil.copy(path, settings.garments_dir / "broken.npz")
    (settings.garments_dir / "broken.about.json").write_text("[]")
    runtime = DrapeRuntime(settings)
    (gown,) = [entry for entry in runtime.garments.visible(None) if entry.source == "user"]
    assert (gown.name, gown.owner, gown.published) == ("Kleid", "shop", True)
    assert len(runtime.garments.refused) == 1 and "title and published" in runtime.garments.refused[0]
    runtime.close()


def test_the_disk_has_a_quota(make_settings: Callable[..., Settings]):
    with served(make_settings(max_stored_bytes=0)) as url:
        response = httpx.post(url + "/garments?name=a.obj", content=b"x")
        assert response.status_code == 507 and "bytes of all garments" in response.json()["detail"]
        nobody = httpx.post(url + "/tickets")
        assert nobody.status_code == 400 and "a service with keys" in nobody.json()["detail"]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("{", "JSON"),
        ("{}", "at least one key"),
        ('{"a": {}}', "a.sha256"),
        ('{"A b": {"sha256": "%s"}}' % ("0" * 64), "small letters"),
    ],
)
def test_a_file_of_keys_that_cannot_be_used_stops_the_start(tmp_path: Path, text: str, word: str):
    path = tmp_path / "keys.json"
    path.write_text(text)
    with pytest.raises(InputError, match=word):
        load_keys(path)


def test_a_file_of_keys_that_is_not_there_stops_the_start(tmp_path: Path):
    with pytest.raises(InputError, match="readable file"):
        load_keys(tmp_path / "none.json")


def test_the_command_makes_a_key_that_works(tmp_path: Path):
    run = subprocess.run([sys.executable, "-m", "service.keys", "shop"], cwd=ROOT, capture_output=True, text=True)
    (tmp_path / "keys.json").write_text(run.stdout)
    assert load_keys(tmp_path / "keys.json")[key_digest(run.stderr.split()[-1])].name == "shop"
    bad = subprocess.run([sys.executable, "-m", "service.keys", "A shop"], cwd=ROOT, capture_output=True, text=True)
    assert bad.returncode == 2 and "small letters" in bad.stderr


def test_a_service_for_others_has_keys_or_says_that_it_is_open(tmp_path: Path):
    for host in ("127.0.0.1", "::1", "localhost"):
        check_exposed(Settings(host=host))
    for host in ("0.0.0.0", "::", "192.0.2.1", "example.org"):
        with pytest.raises(InputError, match="--open"):
            check_exposed(Settings(host=host))
        check_exposed(Settings(host=host, open=True))
        check_exposed(Settings(host=host, keys_file=tmp_path / "keys.json"))
    command = [sys.executable, "-m", "service", "--host", "0.0.0.0"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 2 and run.stderr.startswith("service: DRAPE_KEYS_FILE: expected keys")


def test_the_python_clients_and_the_command_line_have_a_key(url: str, monkeypatch: pytest.MonkeyPatch, capsys):
    with DrapeClient(url, key=KEYS["shop"]) as client:
        names = {garment["id"] for garment in client.garments()}
    assert names == ids(url, "shop")
    with DrapeClient(url) as client, pytest.raises(DrapeError, match="expected an API key or a ticket, got none"):
        client.garments()

    async def streamed(key: str) -> int:
        async with AsyncDrapeClient(url, key=key) as client:
            assert {garment["id"] for garment in await client.garments()} == names
        async with await DrapeStream.open(url, "tube", key=key) as stream:
            await stream.send(np.zeros((24, 3)))
            return len((await stream.receive()).frame.positions)

    assert asyncio.run(streamed(KEYS["shop"])) == 216
    monkeypatch.setenv("DRAPE_KEY", KEYS["shop"])
    assert cli.main(["--url", url, "garments"]) == 0 and "tube" in capsys.readouterr().out
    monkeypatch.delenv("DRAPE_KEY")
    assert cli.main(["--url", url, "garments"]) == 2
