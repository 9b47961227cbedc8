"""Jobs of a service, from their start to their end, in steps. A step is a call, or a pause between two calls."""

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
    """A step that waits so many ``seconds``."""

    seconds: float


Steps = Generator[Call[Any] | Pause, Any, Answer]


def exact_clip_steps(start: Call[dict[str, Any]], accept: str, progress: Progress) -> Steps[Any]:
    """Yields the steps that begin a job by the call ``start``, or find the job that its JSON names, and wait for its
    end.

    Returns the finished clip: vertices (F, V, 3) [m] in the world, or the bytes of a GLB, as ``accept`` says.
    ``progress`` is called with each state of the job. Raises the refusal of a job that fails or is cancelled.
    """
    known = start.json.pop("job", None)
    job = yield start if known is None else get_call("jobs", known)
    while job["state"] != "done":
        finished_id(job, "clip")
        progress(job)
        yield Pause(POLL_S)
        job = yield get_call("jobs", job["id"])
    progress(job)
    read = calls.read_vertices if accept == BINARY else calls.read_bytes
    return (yield get_call("jobs", job["id"], "clip", read=read, accept=accept))


def upload_steps(sent: Call[dict[str, Any]], kind: str, wait_s: float, progress: Progress) -> Steps[str]:
    """Yields the steps that make the call ``sent``, an upload, and wait for its job at most ``wait_s`` [s]. Returns the
    id of what it becomes: ``kind`` is "garment" or "avatar".

    ``progress`` is called with each state of the job; an exception that it raises cancels the job. Raises the refusal
    of a job that fails or is cancelled, and ``Unavailable`` where the time is over.
    """
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
    """Returns the id of what a finished ``job`` has made, which is its field ``kind``; None while it goes on. Raises
    the refusal of a job that failed, and ``Unavailable`` for one that was cancelled."""
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
    """Refuses (``Unavailable``) to wait longer for ``job`` once the monotonic clock is past ``deadline`` [s],
    ``wait_s`` [s] after the start."""
    if time.monotonic() > deadline:
        name, cure = f"upload {job['name']}", f"Ask again later: GET /jobs/{job['id']}."
        raise Unavailable(name, expected=f"an end within {wait_s:g} s", got=f"state {job['state']}", cure=cure)
