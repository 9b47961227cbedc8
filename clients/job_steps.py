"""Jobs of a service: what they are asked until they end. A step is a call, or a pause between two."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from clients import calls
from clients.calls import BINARY, Answer, Call, get_call, url_path
from clients.refusals import problem_error
from drape.errors import Unavailable

POLL_S = 0.1
Progress = Callable[[dict[str, Any]], None]


@dataclass(frozen=True)
class Pause:
    """A step that waits."""

    seconds: float


Steps = Generator[Call[Any] | Pause, Any, Answer]


def exact_clip_steps(asked: Call[dict[str, Any]], accept: str, progress: Progress) -> Steps[Any]:
    """Yields the steps that begin a job by ``asked``, or find the job that it names, and wait for it. Returns the
    finished clip: vertices, or a GLB."""
    known = asked.json.pop("job", None)
    job = yield asked if known is None else get_call("jobs", known)
    while job["state"] != "done":
        finished_id(job, "clip")
        progress(job)
        yield Pause(POLL_S)
        job = yield get_call("jobs", job["id"])
    progress(job)
    read = calls.read_vertices if accept == BINARY else calls.read_bytes
    return (yield get_call("jobs", job["id"], "clip", read=read, accept=accept))


def upload_steps(sent: Call[dict[str, Any]], kind: str, wait_s: float, progress: Progress) -> Steps[str]:
    """Yields the steps that send the upload ``sent`` and wait for its job. Returns the id of the ``kind`` of thing that
    it becomes."""
    job = yield sent
    deadline = time.monotonic() + wait_s
    while (name := finished_id(job, kind)) is None:
        check_deadline(job, deadline, wait_s)
        try:
            progress(job)
            yield Pause(POLL_S)
        except BaseException:
            yield Call("DELETE", url_path("jobs", job["id"]), calls.read_bytes)
            raise
        job = yield get_call("jobs", job["id"])
    progress(job)
    return name


def finished_id(job: dict[str, Any], kind: str = "garment") -> str | None:
    """Returns the id of the garment or the avatar of a finished ``job``; None while it goes on. Raises the refusal of a
    job that failed or was cancelled."""
    if job["state"] == "failed":
        raise problem_error(job["problem"])
    if job["state"] == "cancelled":
        raise Unavailable(
            f"{'clip' if kind == 'clip' else 'upload'} {job['name']}",
            expected="its end",
            got="one that was cancelled",
            cure="Ask again.",
        )
    return job[kind] if job["state"] == "done" else None


def check_deadline(job: dict[str, Any], deadline: float, wait_s: float) -> None:
    """Refuses (``Unavailable``) to wait longer for ``job`` once the clock has passed ``deadline`` [s]."""
    if time.monotonic() > deadline:
        name, cure = f"upload {job['name']}", f"Ask again later: GET /jobs/{job['id']}."
        raise Unavailable(name, expected=f"an end within {wait_s:g} s", got=f"state {job['state']}", cure=cure)
