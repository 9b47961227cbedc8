"""The manifests for a cluster name what the image, the settings and the series have, and their times add up."""

from __future__ import annotations

import re
from decimal import Decimal
from typing import Any

import pytest
import yaml

from service.server import END_S
from service.settings import Settings, check_exposed
from service.uploads.motions import MEMORY_MB
from service.watch.probes import PATHS
from service.watch.prometheus import SECONDS, Metrics
from tests.architecture.repository import ROOT

DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
MANIFESTS = {
    one["kind"]: one for one in yaml.safe_load_all((ROOT / "deploy" / "kubernetes.yaml").read_text(encoding="utf-8"))
}
POD: dict[str, Any] = MANIFESTS["Deployment"]["spec"]["template"]
(CONTAINER,) = POD["spec"]["containers"]
ENVIRONMENT = {one["name"]: one for one in CONTAINER["env"]}


def value(setting: str) -> str:
    return ENVIRONMENT[f"DRAPE_{setting}"]["value"]


def mebibytes(quantity: str) -> int:
    number, unit = re.fullmatch(r"(\d+)([MG])i", quantity).groups()  # pyright: ignore[reportOptionalMemberAccess]
    return int(number) * {"M": 1, "G": 1024}[unit]


def test_the_service_takes_its_environment(monkeypatch: pytest.MonkeyPatch):
    for name, one in ENVIRONMENT.items():
        assert name.removeprefix("DRAPE_").lower() in Settings.model_fields
        monkeypatch.setenv(name, one.get("value", "from a secret"))
    check_exposed(Settings(host="0.0.0.0"))  # with a file of keys, and without leave for everybody
    assert not Settings().open


def test_a_service_of_the_name_drape_sets_no_setting():
    assert "port" in Settings.model_fields  # a cluster sets DRAPE_PORT=tcp://... for it, where it is let
    assert MANIFESTS["Service"]["metadata"]["name"] == "drape" and POD["spec"]["enableServiceLinks"] is False


def test_ports_are_those_of_the_image_and_of_the_probes():
    ports = {one["name"]: one["containerPort"] for one in CONTAINER["ports"]}
    assert f"EXPOSE {ports['http']}\n" in DOCKERFILE
    assert str(ports["probes"]) == value("PROBE_PORT") == POD["metadata"]["annotations"]["prometheus.io/port"]
    (served,) = MANIFESTS["Service"]["spec"]["ports"]
    assert served["targetPort"] == "http"
    for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
        asked = CONTAINER[probe]["httpGet"]
        assert asked["port"] == "probes" and asked["path"] in PATHS
    assert POD["metadata"]["annotations"]["prometheus.io/path"] in PATHS


def test_it_writes_to_the_volume_alone_and_is_nobody():
    mounts = {one["name"]: one["mountPath"] for one in CONTAINER["volumeMounts"]}
    assert f"VOLUME {mounts['garments']}\n" in DOCKERFILE
    assert value("KEYS_FILE").startswith(f"{mounts['keys']}/")
    (item,) = next(one for one in POD["spec"]["volumes"] if one["name"] == "keys")["secret"]["items"]
    assert value("KEYS_FILE") == f"{mounts['keys']}/{item['path']}"
    inside, pod = CONTAINER["securityContext"], POD["spec"]["securityContext"]
    assert inside["readOnlyRootFilesystem"] and inside["capabilities"]["drop"] == ["ALL"] and pod["runAsNonRoot"]
    assert not inside["allowPrivilegeEscalation"] and f"USER {pod['runAsUser']}\n" in DOCKERFILE


def test_there_is_time_to_drain():
    _, wait_s = CONTAINER["lifecycle"]["preStop"]["exec"]["command"]
    assert POD["spec"]["terminationGracePeriodSeconds"] >= int(wait_s) + END_S + 5
    ready = CONTAINER["readinessProbe"]
    assert int(wait_s) >= ready["periodSeconds"] * ready["failureThreshold"]


def test_an_upload_an_exact_clip_and_a_motion_have_room_beside_the_service():
    asked = CONTAINER["resources"]
    limits = Settings.model_fields["intake_workers"].default + Settings.model_fields["exact_workers"].default
    held = mebibytes(asked["requests"]["memory"]) + limits * int(value("INTAKE_MEMORY_MB")) + MEMORY_MB
    assert held <= mebibytes(asked["limits"]["memory"])
    assert asked["requests"]["cpu"] == value("STREAM_THREADS")


def test_more_replicas_come_where_frames_are_late():
    (metric,) = MANIFESTS["HorizontalPodAutoscaler"]["spec"]["metrics"]
    adapter = yaml.safe_load((ROOT / "deploy" / "prometheus-adapter.yaml").read_text(encoding="utf-8"))
    (rule,) = adapter["rules"]["custom"]
    assert metric["pods"]["metric"]["name"] == rule["name"]["as"]
    series = rule["seriesQuery"].partition("{")[0]
    assert f"{series}{{" in Metrics().text().decode()
    late = metric["pods"]["target"]["averageValue"]
    deadline_s = Settings.model_fields["frame_deadline_s"].default
    assert Decimal(late.removesuffix("m")) / 1000 == Decimal(str(deadline_s)) and deadline_s in SECONDS


def test_all_of_them_mean_the_same_pods():
    labels = POD["metadata"]["labels"]
    deployment, budget = MANIFESTS["Deployment"], MANIFESTS["PodDisruptionBudget"]
    assert deployment["spec"]["selector"]["matchLabels"] == budget["spec"]["selector"]["matchLabels"] == labels
    assert MANIFESTS["Service"]["spec"]["selector"] == labels
    scaled = MANIFESTS["HorizontalPodAutoscaler"]["spec"]["scaleTargetRef"]
    assert (scaled["kind"], scaled["name"]) == ("Deployment", deployment["metadata"]["name"])
    claim = next(one for one in POD["spec"]["volumes"] if one["name"] == "garments")["persistentVolumeClaim"]
    assert claim["claimName"] == MANIFESTS["PersistentVolumeClaim"]["metadata"]["name"]
