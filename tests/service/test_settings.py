"""Settings come from the environment; a bad one stops the start with a sentence."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from drape.errors import InputError, Unavailable
from service.server import bind_listener
from service.settings import OTHERS, Settings, load_settings, unread_variables
from tests.architecture.repository import ROOT, repository_files


def test_environment_sets_and_arguments_win(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("DRAPE_PORT", "8123")
    monkeypatch.setenv("DRAPE_STREAM_STEP_DOWN", "false")
    monkeypatch.setenv("DRAPE_ALLOWED_ORIGINS", '["https://shop.example"]')
    settings = load_settings()
    assert (settings.port, settings.stream_step_down) == (8123, False)
    assert settings.allowed_origins == ("https://shop.example",)
    assert load_settings(port=9).port == 9


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("PORT", "http"),
        ("PORT", "70000"),
        ("PROVIDER", "tpu"),
        ("MAX_FRAMES", "0"),
        ("THREADS", ""),
        ("FOLDS", "-1"),
        ("MAX_LAYERS", "0"),
        ("ALLOWED_HOSTS", "drape.example"),
    ],
)
def test_a_bad_value_is_refused_by_name(monkeypatch: pytest.MonkeyPatch, name: str, value: str):
    monkeypatch.setenv(f"DRAPE_{name}", value)
    with pytest.raises(InputError, match=rf"^DRAPE_{name}: .*docs/guide/operate.md"):
        load_settings()


def test_there_are_few_settings():
    assert len(Settings.model_fields) <= 45


def test_a_variable_that_nothing_reads_is_told(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("DRAPE_PROT", "8123")
    monkeypatch.setenv("DRAPE_ISA", "v3")
    assert "DRAPE_PROT" in unread_variables() and not {"DRAPE_ISA", "DRAPE_PORT"} & set(unread_variables())


def test_other_variables_that_are_known_are_read_somewhere():
    sources = [path for path in repository_files() if path.suffix == ".py"]
    texts = [path.read_text(encoding="utf-8") for path in sources]
    assert [name for name in OTHERS if not any(f'"DRAPE_{name}"' in text for text in texts)] == []


def test_an_unknown_argument_is_refused():
    with pytest.raises(InputError, match="DRAPE_PROT"):
        load_settings(prot=1)


def test_a_taken_port_and_a_foreign_address_are_refused():
    with bind_listener("127.0.0.1", 0) as taken, pytest.raises(Unavailable, match="--port"):
        bind_listener("127.0.0.1", taken.getsockname()[1])
    with pytest.raises(InputError, match=r"host: .*no-such-host"):
        bind_listener("no-such-host.invalid", 0)
    with pytest.raises(InputError, match="can be bound"):
        bind_listener("192.0.2.1", 0)  # reserved for documents: no machine has it


def start(tiny_folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    known = {"DRAPE_MODEL": str(tiny_folder / "models/tiny")}
    return subprocess.run(
        [sys.executable, "-m", "service", *arguments],
        cwd=ROOT,
        env={**os.environ, **known, **environment},
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_the_start_refuses_with_one_sentence_and_status_two(tiny_folder: Path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        runs = {
            f"port {port}": start(tiny_folder, "--port", port, DRAPE_PROT="8123"),
            "model": start(tiny_folder, "--port", "0", DRAPE_MODEL="nothing"),
            "DRAPE_PORT": start(tiny_folder, DRAPE_PORT="x"),
        }
    told = {name: run.stderr.strip().splitlines() for name, run in runs.items()}
    assert "DRAPE_PROT is no setting; see docs/guide/operate.md" in told[f"port {port}"].pop(0)
    for name, run in runs.items():
        assert run.returncode == 2
        (line,) = told[name]
        assert line.startswith(f"service: {name}: expected "), line
