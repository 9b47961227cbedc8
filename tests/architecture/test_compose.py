"""The compose files name what the image, the service's settings and the dashboard have."""

from __future__ import annotations

import json
import re
import tomllib
from typing import Any

import pytest
import yaml

from service.settings import Settings
from tests.architecture.repository import ROOT

DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
PREFIX = "DRAPE_"


def read(name: str) -> dict[str, Any]:
    return yaml.safe_load((ROOT / "deploy" / name).read_text(encoding="utf-8"))


def drape(name: str) -> dict[str, Any]:
    return read(name)["services"]["drape"]


@pytest.mark.parametrize("name", ["compose.yaml", "compose.gpu.yaml"])
def test_the_image_knows_its_arguments_and_the_service_its_settings(name: str, monkeypatch: pytest.MonkeyPatch):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for argument, value in drape(name)["build"].get("args", {}).items():
        assert re.search(rf"^ARG {argument}=", DOCKERFILE, re.MULTILINE) and f"${{{argument}}}" in DOCKERFILE
        assert set(value.split(",")) <= set(extras)
    for variable, value in drape(name)["environment"].items():
        assert variable.removeprefix(PREFIX).lower() in Settings.model_fields
        monkeypatch.setenv(variable, str(value))
    Settings()  # takes the values


def test_it_is_built_from_here_and_serves_this_machine_alone():
    service = drape("compose.yaml")
    assert (ROOT / "deploy" / service["build"]["context"] / "Dockerfile").resolve() == ROOT / "Dockerfile"
    (published,) = service["ports"]
    assert published == f"127.0.0.1:{Settings.model_fields['port'].default}:8000" and "EXPOSE 8000" in DOCKERFILE
    ports = [port for one in read("compose.yaml")["services"].values() for port in one["ports"]]
    assert all(port.startswith("127.0.0.1:") for port in ports)


def test_what_users_send_outlives_the_container_and_nothing_else_is_written():
    service = drape("compose.yaml")
    (mounted,) = service["volumes"]
    name, path = mounted.split(":")
    assert name in read("compose.yaml")["volumes"] and service["read_only"] is True
    assert f"VOLUME {path}\n" in DOCKERFILE and f"XDG_DATA_HOME={path} " in DOCKERFILE
    assert re.search(rf"--mode=1777 {path}$", DOCKERFILE, re.MULTILINE), "whoever it runs as may write there"


def test_prometheus_asks_the_port_of_probes_and_is_given_its_file():
    (job,) = read("prometheus.yml")["scrape_configs"]
    host, port = job["static_configs"][0]["targets"][0].split(":")
    assert host in read("compose.yaml")["services"]
    assert port == drape("compose.yaml")["environment"]["DRAPE_PROBE_PORT"]
    assert job["metrics_path"] == "/metrics"
    prometheus = read("compose.yaml")["services"]["prometheus"]
    source, target, _ = prometheus["volumes"][0].split(":")
    assert (ROOT / "deploy" / source).is_file() and f"--config.file={target}" in prometheus["command"]


def test_the_dashboard_is_of_the_job_that_is_scraped_or_of_all():
    board = json.loads((ROOT / "deploy" / "grafana.json").read_text(encoding="utf-8"))
    (job,) = read("prometheus.yml")["scrape_configs"]
    named = set(re.findall(r'job=\\?"([^"\\]+)', json.dumps(board)))
    assert named <= {job["job_name"]}


def test_the_gpu_file_changes_services_that_there_are():
    assert set(read("compose.gpu.yaml")["services"]) <= set(read("compose.yaml")["services"])
    (device,) = drape("compose.gpu.yaml")["deploy"]["resources"]["reservations"]["devices"]
    assert device["capabilities"] == ["gpu"]
