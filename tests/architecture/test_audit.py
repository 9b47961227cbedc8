"""Whether known vulnerabilities of what is installed are seen, on reports that pip-audit itself wrote."""

from __future__ import annotations

import importlib.util
import json
from types import ModuleType

import pytest
from packaging.version import Version
from pip_audit._format import JsonFormat
from pip_audit._service.interface import ResolvedDependency, SkippedDependency, VulnerabilityID, VulnerabilityResult

from tests.architecture.repository import ROOT


@pytest.fixture(scope="module")
def audit() -> ModuleType:
    spec = importlib.util.spec_from_file_location("audit", ROOT / "scripts/audit.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def report(vulnerable: bool) -> dict:
    found = VulnerabilityResult.create(
        ids=[VulnerabilityID("PYSEC-2026-1")],
        description="reads past the end",
        fix_versions=[Version("1.2")],
        published=None,
    )
    result = {
        ResolvedDependency("first", Version("1.1")): [found] if vulnerable else [],
        ResolvedDependency("second", Version("3.0")): [],
        SkippedDependency("drape", "not on the index"): [],
    }
    return json.loads(JsonFormat(output_desc=False, output_aliases=False).format(result, []))


def test_a_vulnerability_is_named_with_its_cure(audit: ModuleType):
    assert audit.vulnerabilities(report(vulnerable=True)) == (2, ["first 1.1: PYSEC-2026-1, mended in 1.2"])


def test_what_could_not_be_audited_does_not_count(audit: ModuleType):
    assert audit.vulnerabilities(report(vulnerable=False)) == (2, [])
    assert audit.vulnerabilities({"dependencies": [{"name": "drape", "skip_reason": "unknown"}]}) == (0, [])


@pytest.mark.parametrize(("vulnerable", "expected"), [(True, 1), (False, 0)])
def test_the_command_fails_for_a_vulnerability_alone(
    audit: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    vulnerable: bool,
    expected: int,
):
    printing = ["-c", f"print({json.dumps(report(vulnerable))!r})"]
    monkeypatch.setattr(audit, "COMMAND", printing)
    assert audit.main([]) == expected
    assert ("PYSEC-2026-1" in capsys.readouterr().err) == vulnerable


def test_no_advisories_are_a_failure_unless_optional(audit: ModuleType, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(audit, "COMMAND", ["-c", "print('no network')"])
    assert audit.main([]) == 2
    assert audit.main(["--optional"]) == 0
