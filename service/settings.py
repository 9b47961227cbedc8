"""Settings, read from the environment with the prefix ``DRAPE_``; a bad value stops the start.

Every field is described in docs/guide/operate.md.
"""

from __future__ import annotations

import ipaddress
import os
from importlib.resources import files
from pathlib import Path
from typing import Literal

from pydantic import Field, SecretStr, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict, SettingsError

from drape.artifacts import DEFAULT_MODEL
from drape.body.assets import DEFAULT_BODY
from drape.catalog import MOTIONS_DIR
from drape.errors import InputError
from drape.folders import CLONE
from drape.garment.cache import GARMENTS_DIR, OWN_GARMENTS_DIR
from drape.wire.options import Inertia, TierName

ROOT = Path(__file__).resolve().parents[1]


def page_folder(page: str) -> Path:
    """Returns the folder in which the build of ``page`` lies: in ``clients/web`` of a clone, or in this package where
    it is installed. The folder need not exist."""
    return ROOT / "clients/web" / page if CLONE else Path(str(files("service"))) / "pages" / page


PAGE = page_folder("dist")
# Variables that begin with DRAPE_ too and that other parts of the product, or its tests, read.
OTHERS = ("BPY", "CACHE", "DATA", "ENGINE", "ISA", "KEY", "SYSTEM", "TEST_RUN", "URL")
CURE = "Correct or unset the variable; docs/guide/operate.md lists the settings."


class Settings(BaseSettings):
    """The settings of a service. The variable of the environment for a field is its name in capitals after ``DRAPE_``;
    docs/guide/operate.md explains each."""

    model_config = SettingsConfigDict(env_prefix="DRAPE_", extra="forbid", frozen=True, protected_namespaces=())

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    open: bool = False
    keys_file: Path | None = None
    ticket_secret: SecretStr | None = None
    probe_port: int | None = Field(default=None, ge=0, le=65535)
    stuck_s: float = Field(default=15.0, gt=0.0)
    log_format: Literal["json", "text"] = "json"
    trace: bool = False

    model: str = DEFAULT_MODEL
    body: str = DEFAULT_BODY
    provider: Literal["cpu", "cuda"] = "cpu"
    threads: int = Field(default=1, ge=1, le=64)
    chunk_frames: int = Field(default=8, ge=1, le=256)

    shipped_garments_dir: Path = GARMENTS_DIR
    garments_dir: Path = OWN_GARMENTS_DIR
    motions_dir: Path = MOTIONS_DIR

    tier: TierName = "balanced"
    folds: int | None = Field(default=None, ge=0, le=16)
    inertia: Inertia = "mesh"

    max_connections: int = Field(default=512, ge=1)
    max_connections_per_address: int = Field(default=128, ge=1)
    max_body_bytes: int = Field(default=8 * 2**20, ge=1024)
    max_upload_bytes: int = Field(default=64 * 2**20, ge=1024)
    max_clips: int = Field(default=8, ge=1)
    max_frames: int = Field(default=1200, ge=1)
    max_vertices: int = Field(default=400_000, ge=3)
    max_layers: int = Field(default=4, ge=1, le=16)
    max_answer_bytes: int = Field(default=512 * 2**20, ge=1024)

    max_stored_bytes: int = Field(default=8 * 2**30, ge=0)

    intake_wall_s: float = Field(default=300.0, gt=0.0)
    intake_cpu_s: int = Field(default=300, ge=1)
    intake_memory_mb: int = Field(default=6144, ge=256)
    intake_workers: int = Field(default=1, ge=1, le=16)
    intake_queue: int = Field(default=8, ge=1)
    exact_workers: int = Field(default=1, ge=1, le=256)
    garments_look_s: float = Field(default=0.0, ge=0.0)

    stream_step_down: bool = True
    stream_sessions: int = Field(default=64, ge=1)
    stream_threads: int | None = Field(default=None, ge=1, le=64)
    stream_idle_s: float = Field(default=60.0, gt=0.0)
    frame_deadline_s: float = Field(default=0.066, gt=0.0)
    successor: str = Field(default="", pattern=r"^(https?://[^\s/]+\S*)?$", max_length=200)
    allowed_origins: tuple[str, ...] = ()
    allowed_hosts: tuple[str, ...] = ()


def check_exposed(settings: Settings) -> None:
    """Refuses (``InputError``) to listen beyond this machine without keys, unless ``open`` says that it is meant."""
    if settings.open or settings.keys_file is not None or _is_loopback(settings.host):
        return
    raise InputError(
        "DRAPE_KEYS_FILE",
        expected=f"keys where others can reach {settings.host}",
        got="none",
        cure="Make keys (python -m service.keys NAME), listen on 127.0.0.1, or say --open.",
    )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def load_settings(**overrides: object) -> Settings:
    """Returns the settings: ``overrides``, else the environment's variables, else the defaults. Raises ``InputError``
    for the first bad value."""
    try:
        return Settings(**overrides)  # pyright: ignore[reportArgumentType]
    except ValidationError as error:
        first = error.errors()[0]
        name = f"DRAPE_{'.'.join(str(part) for part in first['loc'])}".upper()
        raise InputError(name, expected=first["msg"], got=repr(first.get("input")), cure=CURE) from error
    except SettingsError as error:  # a list that is no JSON, found before any field is checked
        name = next(f"DRAPE_{name}".upper() for name in Settings.model_fields if f'"{name}"' in str(error))
        raise InputError(name, expected="a JSON list", got=repr(os.environ.get(name)), cure=CURE) from error


def unread_variables() -> list[str]:
    """Returns the names of the environment's variables that begin with ``DRAPE_`` and that nothing reads, sorted."""
    known = {name.upper() for name in Settings.model_fields} | {*OTHERS}
    present = {name.upper().removeprefix("DRAPE_") for name in os.environ if name.upper().startswith("DRAPE_")}
    return sorted(f"DRAPE_{name}" for name in present - known)
