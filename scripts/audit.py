"""Looks for known vulnerabilities of what is installed beside this interpreter, with pip-audit.

Ends with 1 where one is known, with 0 where none is. Where the index answers for no package at all, because there is
no network or because it is a mirror without advisories, nothing was audited: that is said, and ends with 2, or with 0
after ``--optional``.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from typing import Any

COMMAND = ["-m", "pip_audit", "--local", "--format", "json", "--progress-spinner", "off"]
SECONDS = 120.0


def vulnerabilities(report: dict[str, Any]) -> tuple[int, list[str]]:
    """Returns how many packages of pip-audit's ``report`` were audited, and a line of text for each known
    vulnerability: package, version, id and the releases that mend it."""
    audited = [package for package in report["dependencies"] if "vulns" in package]
    lines = []
    for package in audited:
        for fault in package["vulns"]:
            mended = ", ".join(fault["fix_versions"]) or "no release yet"
            lines.append(f"{package['name']} {package['version']}: {fault['id']}, mended in {mended}")
    return len(audited), lines


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--optional", action="store_true", help="an index that knows no advisories is no failure")
    optional = parser.parse_args(arguments).optional
    try:
        run = subprocess.run([sys.executable, *COMMAND], capture_output=True, text=True, timeout=SECONDS, check=False)
        report = json.loads(run.stdout)
    except (subprocess.TimeoutExpired, json.JSONDecodeError) as error:
        report, why = {"dependencies": []}, str(error)
    else:
        why = run.stderr.strip()[-300:]
    audited, lines = vulnerabilities(report)
    if lines:
        print("\n".join(["audit: expected no known vulnerability, got", *lines]), file=sys.stderr)
        return 1
    if audited == 0:
        print(f"audit: nothing audited, the package index told no advisories. {why}".rstrip(), file=sys.stderr)
        return 0 if optional else 2
    print(f"audit: no known vulnerability in {audited} packages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
