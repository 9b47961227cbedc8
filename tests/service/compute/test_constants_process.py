"""What is made beside streams is made in another, nicer process, with the same bits; and here where that is lost."""

from __future__ import annotations

import io
import os
import pickle
import subprocess
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.body.model import BodyModel
from drape.contact.skin import keep_skins, skins
from drape.errors import DrapeError
from drape.garment.cache import Garment, load_garment
from drape.live.fold_constants import fold_constants
from drape.stages.collision import Collision
from drape.wire.options import Advanced, DrapeOptions
from service.compute.background import NICE, thread_steps_back
from service.compute.constants_calls import receive, send
from service.compute.constants_process import ConstantsProcess
from service.compute.drape_runtime import DrapeRuntime
from service.settings import ROOT, Settings
from tests.fixtures.patience import PATIENT_S


@pytest.fixture(scope="module")
def constants_process() -> Iterator[ConstantsProcess]:
    made = ConstantsProcess(lambda: True)
    yield made
    made.close()


def test_calls_are_made_in_a_nicer_process(constants_process: ConstantsProcess):
    assert constants_process.call(os.getpid) == constants_process.call(os.getpid) != os.getpid()
    assert constants_process.call(os.nice, 0) == min(19, os.nice(0) + NICE)


def test_where_it_is_not_wanted_calls_are_made_here():
    assert ConstantsProcess(lambda: False).call(os.getpid) == os.getpid()


def test_what_is_to_be_kept_there_is_made_there_though_nobody_streams():
    process = ConstantsProcess(lambda: False)
    assert process.call_there(os.getpid) != os.getpid() == process.call(os.getpid)
    process.close()


def test_beside_a_call_that_is_made_here_another_is_made_in_the_process():
    process = ConstantsProcess(lambda: False)
    assert process.call(process.call, os.getpid) == os.getpid() and process._process is None, "none is started for that"
    process.begin()
    assert process._process is not None
    begun, end = threading.Event(), threading.Event()
    with ThreadPoolExecutor(1) as pool:
        here = pool.submit(process.call, lambda: (begun.set(), end.wait(60.0), os.getpid())[-1])
        assert begun.wait(60.0)
        other = process.call(os.getpid)
        end.set()
        assert here.result() == os.getpid() != other
    assert process.call(os.getpid) == os.getpid()
    process.close()


def test_the_engine_takes_constants_of_the_workshop_as_their_own(
    constants_process: ConstantsProcess, tube: Garment, body: BodyModel
):
    here = fold_constants(tube, body)
    assert here.record and here.laid.record, "which hold addresses of this process"
    assert pickle.loads(pickle.dumps(here)).__dict__.keys() == {field.name for field in fields(here)}
    there = constants_process.call(fold_constants, tube, body)
    for one, other in zip(here.record.arrays, there.record.arrays, strict=True):
        assert one.dtype == other.dtype and one.shape == other.shape
        assert_array_equal(one, other)


def test_a_refusal_is_raised_here(constants_process: ConstantsProcess, tmp_path: Path):
    with pytest.raises(DrapeError) as there:
        constants_process.call(load_garment, tmp_path / "none.npz")
    with pytest.raises(DrapeError) as here:
        load_garment(tmp_path / "none.npz")
    assert (type(there.value), str(there.value)) == (type(here.value), str(here.value))


def test_what_is_printed_there_is_no_answer(constants_process: ConstantsProcess):
    assert constants_process.call(print, "said") is None
    assert constants_process.call(abs, -3) == 3


def test_where_the_process_is_lost_calls_are_made_here_and_the_next_in_a_new_one():
    constants_process = ConstantsProcess(lambda: True)
    first = constants_process.call(os.getpid)
    assert constants_process._process is not None
    constants_process._process.kill()
    assert constants_process.call(os.getpid) == os.getpid()
    assert constants_process.call(os.getpid) not in (first, os.getpid())
    constants_process.close()


def test_the_process_ends_with_who_asked():
    command = [sys.executable, "-m", "service.compute.constants_calls"]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None and process.stdout is not None
        send(process.stdin, (abs, (-2,), {}))
        assert receive(process.stdout) == (True, 2)
        process.stdin.close()
        assert process.wait(timeout=PATIENT_S) == 0


def test_arrays_come_as_they_were(rng: np.random.Generator):
    sent = {"columns": np.asfortranarray(rng.normal(size=(3, 4))), "none": np.zeros((0, 3)), "few": rng.normal(size=5)}
    file = io.BytesIO()
    send(file, sent)
    file.seek(0)
    found = receive(file)
    assert receive_fails(file)
    for name, array in sent.items():
        assert found[name].flags.f_contiguous == array.flags.f_contiguous and found[name].flags.writeable
        assert_array_equal(found[name], array)


def receive_fails(file: io.BytesIO) -> bool:
    with pytest.raises(EOFError):
        receive(file)
    return True


def test_an_outfit_that_is_prepared_beside_streams_is_the_same(outfit_settings: Settings):
    found = []
    for streamed_s in (-np.inf, time.monotonic() + 1000.0):
        runtime = DrapeRuntime(outfit_settings)
        runtime.threads.streamed_s = streamed_s
        apart = DrapeOptions(
            advanced=Advanced(folds=1, cloth_contact=False)
        )  # layers that do not feel each other are pushed apart
        plan = runtime.plan(runtime.garments.scene(None, ["tube", "coat"]), apart, messages=True)
        for stage in plan.stages:
            stage.prepare(plan)
        assert (runtime.constants_process._process is not None) == np.isfinite(streamed_s)
        (pusher,) = (stage.pusher for stage in plan.stages if isinstance(stage, Collision))
        layer: Any = pusher._layer(plan.keys)
        found.append(flat(asdict(layer)))
        runtime.close()
        assert runtime.constants_process._process is None
    assert found[0].keys() == found[1].keys()
    for name, array in found[0].items():
        assert_array_equal(array, found[1][name])


def flat(record: dict[str, Any]) -> dict[str, Any]:
    """The arrays of a ``record`` and of the records in it."""
    return {
        name: array
        for own, value in record.items()
        for name, array in (flat(value) if isinstance(value, dict) else {own: value}).items()
    }


def test_the_skins_of_a_character_are_made_apart_and_kept_here(body: BodyModel, monkeypatch: pytest.MonkeyPatch):
    character = replace(body, name="taller", digest="taller", v_template=1.1 * body.v_template)
    made = pickle.loads(pickle.dumps(skins(character)))  # as it comes from another process
    asked: list[object] = []

    def make(*call: object) -> object:
        asked.append(call)
        return made

    def here(*_: object) -> None:
        pytest.fail("made between frames")

    monkeypatch.setattr("drape.contact.skin._KEPT", OrderedDict())
    monkeypatch.setattr("drape.contact.skin.skin_samples", here)
    monkeypatch.setattr("drape.contact.skin.ShapedSkin.__init__", here)
    for _ in range(2):  # the second time they are there
        keep_skins(character, make)
    assert asked == [(skins, character)]
    assert skins(character) == made


# The file is empty where a process is in no group: the system's first session.
SAY = """
import os
from pathlib import Path
from service.compute.background import step_back
step_back()
group = Path("/proc/self/autogroup")
print(os.nice(0), *(group.read_text() if group.is_file() else "").split()[-1:])
"""


def said(*, own_session: bool) -> list[str]:
    command = [sys.executable, "-c", SAY]
    return subprocess.run(
        command, capture_output=True, check=True, text=True, start_new_session=own_session
    ).stdout.split()


def test_a_process_is_nicer():
    assert said(own_session=True)[0] == str(min(19, os.nice(0) + NICE))


@pytest.mark.skipif(not Path("/proc/self/autogroup").is_file(), reason="this system has no niceness of sessions")
def test_a_session_is_nicer_where_it_has_no_other_process():
    ours = Path("/proc/self/autogroup").read_text()
    assert said(own_session=True)[1] == str(NICE)
    said(own_session=False)
    assert Path("/proc/self/autogroup").read_text() == ours


@pytest.mark.skipif(sys.platform != "linux", reason="niceness of threads")
def test_a_thread_is_nicer_and_the_others_are_not():
    before = os.nice(0)

    def nicer() -> int:
        thread_steps_back()
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    with ThreadPoolExecutor(1) as thread:
        assert thread.submit(nicer).result() == min(19, before + NICE)
    assert os.nice(0) == before
