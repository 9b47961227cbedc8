"""Documents name only what exists: commands, links and settings."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
from pathlib import Path

import pytest

from tests.architecture.repository import PACKAGES, ROOT, repository_files

DOCUMENTS = [path for path in repository_files() if path.suffix == ".md"]
ARCHIVE, LOG = ROOT / "docs" / "archive", ROOT / "docs" / "log.md"  # they say what was true on their day
CURRENT = [path for path in DOCUMENTS if ARCHIVE not in path.parents]
COMMAND = re.compile(r"python -m ([A-Za-z_][\w.]*)")
OF_A_COMMIT = re.compile(r"commit [0-9a-f]{7,}")
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)")
IMPORT = re.compile(r"^from ([\w.]+) import ([\w, ]+)$", re.MULTILINE)
CODE = re.compile(r"```[a-z]*\n(.*?)```|`([^`\n]+)`", re.DOTALL)
MAKE_TARGET = re.compile(r"^(?:[A-Z_]+=\S+ )*make ([a-z][a-z0-9-]*)", re.MULTILINE)


def is_command(name: str) -> bool:
    """Whether ``python -m name`` runs something of ours."""
    try:
        spec = importlib.util.find_spec(name)
    except ModuleNotFoundError:
        return False
    if spec is None:
        return False
    if spec.submodule_search_locations is not None:
        return importlib.util.find_spec(name + ".__main__") is not None
    return spec.origin is not None and '__name__ == "__main__"' in Path(spec.origin).read_text(encoding="utf-8")


def our_commands(document: Path) -> set[str]:
    """The modules of ours that ``document`` runs with ``python -m``; one on a line that names its commit is of then."""
    lines = document.read_text(encoding="utf-8").splitlines()
    now = "\n".join(line for line in lines if not OF_A_COMMIT.search(line))
    names = {name.rstrip(".") for name in COMMAND.findall(now)}
    return {name for name in names if name.partition(".")[0] in PACKAGES}


@pytest.mark.parametrize("document", sorted({*CURRENT} - {LOG}), ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_in_documents_exist(document: Path):
    assert {name for name in our_commands(document) if not is_command(name)} == set()


def names_in(module: str) -> set[str]:
    """The names that ``module`` defines or imports at its top, and its submodules, without running it."""
    spec = importlib.util.find_spec(module)
    assert spec is not None and spec.origin is not None, module
    below = {path.stem for folder in spec.submodule_search_locations or () for path in Path(folder).glob("*.py")}
    body = ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body
    bound = {node.id for part in body for node in ast.walk(part) if isinstance(node, ast.Name)}
    imported = {name.asname or name.name for part in body if isinstance(part, ast.ImportFrom) for name in part.names}
    defined = {part.name for part in body if isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)}
    return below | bound | imported | defined


@pytest.mark.parametrize("document", sorted({*CURRENT} - {LOG}), ids=lambda path: str(path.relative_to(ROOT)))
def test_examples_in_documents_import_what_exists(document: Path):
    found = IMPORT.findall(document.read_text(encoding="utf-8"))
    asked = {(module, name) for module, names in found for name in re.findall(r"(\w+)(?: as \w+)?", names)}
    ours = {(module, name) for module, name in asked if module.partition(".")[0] in PACKAGES}
    assert {(module, name) for module, name in ours if name not in names_in(module)} == set()


def files_of_tables(document: Path) -> set[str]:
    """The Python files that rows name below a head that says "file of `FOLDER`", by their paths."""
    folder, found = "", set[str]()
    for line in document.read_text(encoding="utf-8").splitlines():
        head = re.search(r"\| file of `([\w/]+)`", line)
        folder = head[1] if head else folder if line.startswith("|") else ""
        for name in re.findall(r"`([\w/]+\.py)`", line) if folder else ():
            found.add(name if name.startswith(tuple(PACKAGES)) else f"{folder}/{name}")
    return found


@pytest.mark.parametrize("document", sorted({*CURRENT} - {LOG}), ids=lambda path: str(path.relative_to(ROOT)))
def test_files_in_tables_of_documents_exist(document: Path):
    assert {name for name in files_of_tables(document) if not (ROOT / name).is_file()} == set()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_relative_links_resolve(document: Path):
    targets = [target.partition("#")[0] for target in LINK.findall(document.read_text(encoding="utf-8"))]
    local = [target for target in targets if target and not re.match(r"[a-z]+:", target)]
    assert [target for target in local if not (document.parent / target).exists()] == []


def anchors(document: Path) -> set[str]:
    """What a link to a heading of ``document`` may end with."""
    text = re.sub(r"```.*?```", "", document.read_text(encoding="utf-8"), flags=re.DOTALL)
    titles = [re.sub(r"\]\([^)]*\)", "", title) for title in re.findall(r"^#+ (.+)$", text, re.MULTILINE)]
    found: set[str] = set()
    for title in titles:
        name = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
        found.add(name if name not in found else f"{name}-1")
    return found


@pytest.mark.parametrize("document", CURRENT, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_to_headings_resolve(document: Path):
    broken = []
    for target in LINK.findall(document.read_text(encoding="utf-8")):
        name, _, anchor = target.partition("#")
        page = document.parent / name if name else document
        if anchor and page.suffix == ".md" and page.is_file() and anchor not in anchors(page):
            broken.append(target)
    assert broken == []


@pytest.mark.parametrize("document", CURRENT, ids=lambda path: str(path.relative_to(ROOT)))
def test_make_targets_in_documents_exist(document: Path):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z][a-z0-9-]*):", makefile, re.MULTILINE))
    code = "\n".join(block or inline for block, inline in CODE.findall(document.read_text(encoding="utf-8")))
    assert set(MAKE_TARGET.findall(code)) - targets == set()


def test_readme_runs_something():
    assert our_commands(ROOT / "README.md")


def test_every_setting_of_the_service_is_documented():
    settings = importlib.import_module("service.settings").Settings
    prefix = settings.model_config.get("env_prefix", "")
    page = (ROOT / "docs/guide/operate.md").read_text(encoding="utf-8")
    assert [name for name in settings.model_fields if (prefix + name).upper() not in page] == []
