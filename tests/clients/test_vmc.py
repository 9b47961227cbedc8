"""The bridge of VMC: packets of a sender, over loopback, become poses for the page; nobody else gets them."""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager

import numpy as np
import pytest
from numpy.testing import assert_allclose
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from clients.vmc import MOST_BYTES, MOST_MESSAGES, MOST_PACKETS, MOST_PAGES, Receiver, main, osc_messages
from drape.errors import InputError
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.samples import SAMPLES
from tests.architecture.repository import ROOT
from tests.drape.motion.vmc_sender import messages
from tests.fixtures.patience import PATIENT_S

CLIP = SAMPLES["turn"]()
PAGE = "http://127.0.0.1:8000"


def text(words: str) -> bytes:
    return words.encode() + bytes(4 - len(words) % 4)


def message(address: str, values: list) -> bytes:
    """A message as OSC 1.0 writes it, numbers as float32."""
    kinds = "".join("s" if isinstance(value, str) else "f" for value in values)
    packed = [text(value) if isinstance(value, str) else struct.pack(">f", value) for value in values]
    return text(address) + text(f",{kinds}") + b"".join(packed)


def bundle(*parts: bytes) -> bytes:
    return b"#bundle\0" + bytes(7) + b"\1" + b"".join(struct.pack(">i", len(part)) + part for part in parts)


def packets(frame: int) -> list[bytes]:
    return [message(*one) for one in messages(CLIP.poses[frame], CLIP.trans[frame])]


def test_packets_are_read_as_another_library_writes_them():
    builders = pytest.importorskip("pythonosc.osc_message_builder", reason="No python-osc: `pip install python-osc`.")
    for address, values in messages(CLIP.poses[0], CLIP.trans[0]):
        builder = builders.OscMessageBuilder(address=address)
        for value in values:
            builder.add_arg(value)
        assert builder.build().dgram == message(address, values)
    builder = builders.OscMessageBuilder(address="/VMC/Ext/OK")
    builder.add_arg(1)
    assert osc_messages(builder.build().dgram) == [("/VMC/Ext/OK", [1])]


def test_bundles_hold_messages_and_bundles():
    one, two = message("/a", ["x", 1.5]), message("/bcd", [])
    assert osc_messages(bundle(one, bundle(two))) == [("/a", ["x", 1.5]), ("/bcd", [])]


@pytest.mark.parametrize(
    ("packet", "words"),
    [
        (b"", "subsection"),
        (b"words", "subsection"),
        (text("words") + text(","), "the address"),
        (text("/a"), "subsection"),
        (text("/a") + text(",ff") + bytes(4), "buffer"),
        (text("/a") + text(",b") + bytes(8), "type 'b'"),
        (text("/a") + text(",s") + b"\xff\xfe\0\0", "decode"),
        (b"#bundle\0" + bytes(8) + struct.pack(">i", -4), "a part of -4 bytes"),
        (b"#bundle\0" + bytes(8) + bytes(4), "a part of 0 bytes"),
        (b"#bundle\0" + bytes(8) + struct.pack(">i", 400) + bytes(8), "a part of 400 bytes"),
        (b"#bundle\0" + bytes(9), "buffer"),
        (bundle(bundle(bundle(bundle(bundle(message("/a", [])))))), "5 deep"),
        (bundle(*[message("/a", [])] * (MOST_MESSAGES + 1)), f"{MOST_MESSAGES + 1} messages"),
        (bytes(MOST_BYTES + 1), f"{MOST_BYTES + 1} bytes"),
    ],
)
def test_what_is_no_packet_is_refused(packet: bytes, words: str):
    with pytest.raises(InputError, match=words):
        osc_messages(packet)


def test_more_packets_than_a_sender_needs_are_thrown_away():
    receiver = Receiver()
    bone = packets(0)[1]
    for _ in range(3 * MOST_PACKETS):  # within two seconds
        receiver.datagram_received(bone, None)
    assert receiver.refused >= MOST_PACKETS
    assert receiver.poses.count + receiver.refused == 3 * MOST_PACKETS


@contextmanager
def bridge(*words: str) -> Iterator[tuple[int, int]]:
    """The sender's and the page's port of a running bridge.

    The system gives the port where the page looks to other connections too, so one that has it is waited for.
    """
    command, tries = [sys.executable, "-m", "clients.vmc", *words], 20
    while True:
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        said, tries = process.stdout.readline().split(), tries - 1
        if said or not tries:
            break
        process.communicate()
        time.sleep(0.5)
    with process:
        assert said, "the bridge did not start"
        yield int(said[said.index("port") + 1].rstrip(",")), int(said[-1])
        process.terminate()


@pytest.fixture(scope="module")
def ports() -> Iterator[tuple[int, int]]:
    with bridge("--port", "0", "--page-port", "0", "--page", PAGE) as found:
        yield found


def page(ports: tuple[int, int], origin: str = PAGE) -> AbstractContextManager[ClientConnection]:
    return connect(f"ws://127.0.0.1:{ports[1]}", origin=Origin(origin))


def send(port: int, *more: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for packet in more:
            sender.sendto(packet, ("127.0.0.1", port))


def shown(connection: ClientConnection, frame: int, ports: tuple[int, int], *more: bytes) -> dict:
    """The pose that the page has once it is that of ``frame``, which is sent until then."""
    want, until_s = rotvec_to_matrix(CLIP.poses[frame]), time.monotonic() + PATIENT_S
    while time.monotonic() < until_s:
        send(ports[0], *more)
        found = json.loads(connection.recv(timeout=PATIENT_S))
        if np.abs(rotvec_to_matrix(np.reshape(found["poses"], (24, 3))) - want).max() < 1e-3:
            return found
    pytest.fail("the page never saw the pose")


def test_a_sender_moves_the_page_whatever_else_comes(ports: tuple[int, int]):
    for name in (PAGE, "http://localhost:8000"):
        with page(ports, name) as connection:
            shown(connection, 30, ports, *packets(30))  # a packet a bone
            found = shown(connection, 90, ports, b"#bundle\0" + bytes(8) + b"\xff\xff\xff\xfc", bundle(*packets(90)))
            assert_allclose(np.array(found["pelvis"]) * 0.78, CLIP.trans[90], atol=1e-3)


def test_other_pages_get_nothing_and_four_are_enough(ports: tuple[int, int]):
    with pytest.raises(InvalidStatus, match="403"), page(ports, "https://elsewhere.example"):
        pass
    with ExitStack() as held:
        for _ in range(MOST_PAGES):
            held.enter_context(page(ports))
        with page(ports) as fifth, pytest.raises(ConnectionClosed):
            fifth.recv(timeout=PATIENT_S)


def test_a_port_that_is_taken_is_told(ports: tuple[int, int], capsys: pytest.CaptureFixture[str]):
    assert main(["--port", str(ports[0]), "--page-port", "0"]) == 2
    assert "port: expected a free one" in capsys.readouterr().err
