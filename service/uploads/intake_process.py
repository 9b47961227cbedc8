"""The intake of a stranger's file in a limited process of its own (``service.uploads.sandbox``), and what it says."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from drape.errors import ArtifactError, DrapeError, InputError, TooLarge
from service.compute.processes import Process, ended, running
from service.errors import TABLE
from service.settings import Settings
from service.uploads.accepted import Kind
from service.uploads.sandbox import THINGS

SHARES: dict[str, dict[str, float]] = {
    "garment": {"start": 0.12, "read": 0.16, "rest": 0.28, "fit": 0.36, "cloth": 0.01, "store": 0.04, "prepare": 0.03},
    "avatar": {"start": 0.1, "read": 0.01, "map": 0.04, "fit": 0.45, "cloth": 0.33, "store": 0.05, "prepare": 0.02},
}
"""Stages of an upload, those of the intake between a process's start and the garment's constants, and their shares."""


async def run_sandbox(
    file: Path,
    avatar: str | None,
    out: Path,
    settings: Settings,
    begun: Callable[[str], None] = lambda stage: None,
    *,
    kind: Kind | Literal["motion"] = "garment",
    waiting: Process | None = None,
) -> dict[str, Any]:
    """The report of the intake process; raises its refusal, or one for the limit that it ran into.

    ``avatar``: of a garment, what it was modelled on; of an avatar, its joints and parts and whether its clothes are
    alive, as JSON; of a motion, which clip.

    ``begun`` is called with each stage as the process begins it; ``waiting``, a spare process (``uploads.spare``),
    takes the file in.
    """
    thing = THINGS[kind]
    command = [str(file), "--out", str(out), "--body", settings.body, "--kind", kind]
    command += ["--memory-mb", str(settings.intake_memory_mb), "--cpu-s", str(settings.intake_cpu_s)]
    label = f"upload {file.name}"
    child = running(
        "intake",
        "service.uploads.sandbox",
        *command,
        # A command line takes no avatar above 128 KiB, and anybody may read it.
        write=lambda stdin: stdin.write((avatar or "").encode()),
        folder=file.parent,
        quiet=True,
        waiting=waiting,
    )
    try:
        async with child as (process, said), asyncio.timeout(settings.intake_wall_s):
            report = await _report(said, begun, SHARES.get(kind, {}))
            await ended(process)
    except TimeoutError:
        raise TooLarge(
            label, expected=f"an intake within {settings.intake_wall_s:g} s", got="no end by then", cure=thing.smaller
        ) from None
    if report is not None and "problem" in report:
        raise _refusal(report["problem"])
    if report is not None and "files" in report:
        return report
    if process.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise TooLarge(
            label,
            expected=f"an intake within {settings.intake_cpu_s} s of processor time",
            got="more",
            cure=thing.smaller,
        )
    raise thing.refusal(
        label,
        expected=thing.words,
        got=f"a file on which the intake ends with status {process.returncode}",
        cure="Export it again.",
    )


async def _report(
    said: asyncio.StreamReader, begun: Callable[[str], None], stages: Mapping[str, float]
) -> dict[str, Any] | None:
    """The last line of JSON that was ``said``; stages before it are told to ``begun``."""
    last: dict[str, Any] | None = None
    async for line in said:
        last = _document(line)
        if last is not None and last.get("stage") in stages:
            begun(last["stage"])
    return last


def _document(line: bytes) -> dict[str, Any] | None:
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


_KINDS: dict[str, type[DrapeError]] = {kind.__name__: kind for kind in (*TABLE, ArtifactError)}


def _refusal(said: dict[str, str]) -> DrapeError:
    """The error that the intake process put in words."""
    kind = _KINDS.get(said["kind"], InputError)
    return kind(said["name"], expected=said["expected"], got=said["got"], cure=said["cure"])
