"""Runs the intake of a stranger's file in a process of its own with limits (``service.uploads.sandbox``)."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from drape.errors import InputError, TooLarge
from service.compute.processes import Process, run_process, wait_for_end
from service.errors import spoken_error
from service.settings import Settings
from service.uploads.accepted import Kind
from service.uploads.sandbox import THINGS

SHARES: dict[str, dict[str, float]] = {
    "garment": {"start": 0.12, "read": 0.16, "rest": 0.28, "fit": 0.36, "cloth": 0.01, "store": 0.04, "prepare": 0.03},
    "avatar": {"start": 0.1, "read": 0.01, "map": 0.04, "fit": 0.45, "cloth": 0.33, "store": 0.05, "prepare": 0.02},
}
"""The stages of an upload by its kind, and the share of the usual time that each takes. "start" is the start of the
process, "prepare" makes the garment's constants, and those between are stages of the intake."""


async def run_sandbox(
    file: Path,
    avatar: str | None,
    out: Path,
    settings: Settings,
    begin_stage: Callable[[str], None] = lambda stage: None,
    *,
    kind: Kind | Literal["motion"] = "garment",
    waiting: Process | None = None,
) -> dict[str, Any]:
    """Runs the intake of ``file`` in a process with limits, and returns its report: ``files``, the names of the files
    that it wrote to ``out``, as ``intake_files``, ``avatar_files`` or ``motion_file`` says; ``stiff``, only of an
    avatar whose clothes shall become garments, as ``avatar_files`` says. Raises the refusal of the intake, or
    ``TooLarge`` for a limit of time or memory.

    ``avatar`` is, for a garment, the body that it was modelled on; for an avatar, its joints and parts and whether its
    clothes become garments, as JSON; for a motion, the name of the clip. ``begin_stage`` is called with the name of
    each stage when it begins. ``waiting`` is a spare process (``uploads.spare``) that does the work.
    """
    thing = THINGS[kind]
    command = [str(file), "--out", str(out), "--body", settings.body, "--kind", kind]
    command += ["--memory-mb", str(settings.intake_memory_mb), "--cpu-s", str(settings.intake_cpu_s)]
    label = f"upload {file.name}"
    child = run_process(
        "intake",
        "service.uploads.sandbox",
        *command,
        # A command line takes at most 128 KiB, and every user of the machine may read it.
        write=lambda stdin: stdin.write((avatar or "").encode()),
        folder=file.parent,
        quiet=True,
        waiting=waiting,
    )
    try:
        async with child as (process, lines), asyncio.timeout(settings.intake_wall_s):
            report = await _report(lines, begin_stage, SHARES.get(kind, {}))
            await wait_for_end(process)
    except TimeoutError:
        raise TooLarge(
            label, expected=f"an intake within {settings.intake_wall_s:g} s", got="no end by then", cure=thing.smaller
        ) from None
    if report is not None and "problem" in report:
        raise spoken_error(report["problem"], InputError)
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
    lines: asyncio.StreamReader, begin_stage: Callable[[str], None], stages: Mapping[str, float]
) -> dict[str, Any] | None:
    """Returns the last of ``lines`` as JSON, None if it is no JSON object. Calls ``begin_stage`` with each stage that a
    line names."""
    last: dict[str, Any] | None = None
    async for line in lines:
        last = _document(line)
        if last is not None and last.get("stage") in stages:
            begin_stage(last["stage"])
    return last


def _document(line: bytes) -> dict[str, Any] | None:
    try:
        document = json.loads(line)
    except ValueError:
        return None
    return document if isinstance(document, dict) else None
