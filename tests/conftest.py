"""Fixtures of every test (a body, a tiny garment, seeded randomness), skips that say their cure, budgets of time.

``body`` is the shipped body and ``tube`` a garment of 216 vertices: a test names them as arguments, nothing to import.
``tests.fixtures.garments`` has both, and the shipped garments, for set-ups outside of tests.
``tests.fixtures.laws.each`` multiplies laws by cases: one decorator, applied to every law that the cases share.
"""

from __future__ import annotations

import gc
import logging
import os
import shutil
import signal
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import certifi
import numpy as np
import pytest
from hypothesis import settings

from drape.body.model import BodyModel
from drape.files.data import HOW_TO_SET_DATA, data_folder
from drape.garment.cache import Garment
from tests.clients.built import why_not_the_page
from tests.fixtures import garments
from tests.fixtures.fuzzing import SOAK
from tests.fixtures.patience import make_clients_patient
from tests.fixtures.run_folder import RUN_FOLDER

ROOT = Path(__file__).resolve().parents[1]

# Seconds of a processor, which do not depend on what else runs. Two cores share them, so that half of their sum
# stays well under the quarter of an hour that the whole suite may take; browsers' own are not among them.
FOLDER_BUDGET_S = {
    "collection": 40,  # of both processes: a file that computes while it is imported is seen here
    "architecture": 40,
    "drape": 620,
    "training": 60,
    "model_export": 40,
    "service": 400,
    "clients": 150,
    "recovery": 180,
    "benchmarks": 75,
    "extremes": 15,
    "examples": 40,
}
LONGEST_FIRST = (
    "examples",
    "training",
    "recovery",
    "service",
    "model_export",
    "benchmarks",
    "clients",
    "drape",
    "extremes",
    "architecture",
)
EXPORTING = {"tiny_folder", "exported", "exported_dynamic"}  # fixtures and functions that take a minute the first time
UNIT_CPU_S = 30.0  # thrice what marks a test as slow, since processors differ
FILE_CPU_S = 120.0  # a file that takes more fails the run: long tests left out, processes that it starts counted
CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

# Examples are drawn from a fixed seed: a red run on one machine is red on the next.
settings.register_profile("drape", deadline=None, derandomize=True, print_blob=True)
settings.register_profile(SOAK, deadline=None, print_blob=True)
settings.load_profile("drape")
make_clients_patient()


def find_chromium() -> str | None:
    """The path of the browser that browser tests drive, or None."""
    named = os.environ.get("CHROMIUM")
    if named and os.access(named, os.X_OK):
        return named
    return next((path for name in CHROMIUM_NAMES if (path := shutil.which(name))), None)


def skip_reason(item: pytest.Item) -> str | None:
    """Why this machine cannot run ``item``, with the cure; None if it can."""
    if item.get_closest_marker("data") and data_folder() is None:
        return HOW_TO_SET_DATA
    if item.get_closest_marker("gpu") and shutil.which("nvidia-smi") is None:
        return "No NVIDIA GPU here: run the test on a machine where nvidia-smi answers."
    if item.get_closest_marker("browser"):
        if find_chromium() is None:
            return "No Chromium: `sudo apt-get install chromium`, or name one in CHROMIUM."
        if not (ROOT / "clients/web/dist/index.html").is_file():
            return why_not_the_page()
    return None


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--stop-after", type=float, metavar="S", help="skip what has not ended after S seconds")


_made: list[str] = []
_running = False
TIME_IS_UP = "The time is up: `make test` runs it."
_begun_s = time.monotonic()


def pytest_configure(config: pytest.Config) -> None:
    """Makes a folder that all processes of the run share; those that pytest-xdist starts inherit its name.

    One that the environment names already is kept: exported models in it are taken as they are by the next run.
    """
    if RUN_FOLDER not in os.environ:
        _made.append(os.environ.setdefault(RUN_FOLDER, tempfile.mkdtemp(prefix="drape-tests-")))

    # asyncio.run would set a handler of its own, and Python would print all that the run gave back to look that up.
    signal.signal(signal.SIGINT, lambda number, frame: signal.default_int_handler(number, frame))

    # A client over HTTP reads the certificates of all authorities when it is made, which takes 40 ms of a processor
    # each time. None is asked for on this machine, so one certificate will do.
    if "SSL_CERT_FILE" not in os.environ:
        one = Path(os.environ[RUN_FOLDER]) / "one_authority.pem"
        first, end, _ = Path(certifi.where()).read_text(encoding="utf-8").partition("-----END CERTIFICATE-----\n")
        one.write_text(first + end, encoding="utf-8")
        os.environ["SSL_CERT_FILE"] = str(one)

    if (stop_after_s := config.getoption("stop_after")) is not None:
        signal.signal(signal.SIGALRM, _skip_what_runs)
        # An alarm that meets no test is followed by others, which may.
        signal.setitimer(signal.ITIMER_REAL, max(stop_after_s - (time.monotonic() - _begun_s), 0.01), 1.0)


def _skip_what_runs(number: int, frame: object) -> None:
    """Ends the test that runs: the one that begins last may take as long as all before it."""
    if _running:
        pytest.skip(TIME_IS_UP)


def pytest_unconfigure(config: pytest.Config) -> None:
    if config.getoption("stop_after") is not None:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    for folder in _made:
        shutil.rmtree(folder, ignore_errors=True)


def pytest_itemcollected(item: pytest.Item) -> None:
    """Every test is of one kind: ``browser``, ``server``, which exports a model and may serve it, or ``unit``."""
    if item.get_closest_marker("browser") is None:
        names = {*getattr(item, "fixturenames", ()), *vars(getattr(item, "module", object))}
        item.add_marker("server" if names & EXPORTING else "unit")


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[Any]:
    """Of two processes one imports from the end: what the other has compiled by then is not compiled again."""
    report = yield
    second = os.environ.get("PYTEST_XDIST_WORKER") == "gw1" and collector.config.getoption("stop_after") is None
    if second and isinstance(collector, pytest.Dir):
        report.result.reverse()
    return report


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Folders with the longest files first: none of the processes is then left with a long one at the end. Files
    stay as they are named where time is short."""
    if config.getoption("stop_after") is None:
        places = {name: place for place, name in enumerate(LONGEST_FIRST)}
        items.sort(key=lambda item: (places.get(item.path.relative_to(ROOT).parts[1], len(places)), item.path))


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[Any]:
    """What is imported stays to the end: the collector would look through it time and again, meanwhile and later."""
    begun_s = processor_s()
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()
        _cpu_s["tests/collection/files"] = processor_s() - begun_s


@contextmanager
def _running_now() -> Iterator[None]:
    """For ``_skip_what_runs``."""
    global _running
    _running = True
    try:
        yield
    finally:
        _running = False


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    stop_after_s = item.config.getoption("stop_after")
    if stop_after_s is not None and time.monotonic() - _begun_s > stop_after_s:
        pytest.skip(TIME_IS_UP)
    if reason := skip_reason(item):
        pytest.skip(reason)
    if item.get_closest_marker("browser") and (reason := why_not_the_page()):
        pytest.fail(reason, pytrace=False)
    with _running_now():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Fails a test of units that takes long and does not say so, by the processor's time: the clock's depends on what
    else runs."""
    begun_s = time.process_time()
    with _running_now():
        result = yield
    spent_s = time.process_time() - begun_s
    named = any(map(item.get_closest_marker, ("server", "browser", "slow", "long")))
    if spent_s > UNIT_CPU_S and not named:
        pytest.fail(f"It takes {spent_s:.0f} s of a processor: make it shorter, or mark it slow.")
    return result


@pytest.fixture(scope="module", autouse=True)
def process_unchanged() -> Iterator[None]:
    """A test file leaves the process as it was: lines of INFO that are kept hold what they tell of, and what is frozen
    is never collected, both of which other files' tests of leaks would see."""
    level, frozen = logging.getLogger().level, gc.get_freeze_count()
    yield
    assert logging.getLogger().level == level and gc.get_freeze_count() <= frozen


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed; tests that want another draw take their own."""
    return np.random.default_rng(20260101)


@pytest.fixture(scope="session")
def body() -> BodyModel:
    """The shipped body."""
    return garments.default_body()


@pytest.fixture(scope="session")
def tube() -> Garment:
    """A garment of 216 vertices in 12 patches, fitted to the shipped body."""
    return garments.tube()


@pytest.fixture
def data() -> Path:
    """The folder named by DRAPE_DATA; the test skips, saying how to set it, where there is none."""
    folder = data_folder()
    if folder is None:
        pytest.skip(HOW_TO_SET_DATA)
    return folder


@pytest.fixture
def chromium() -> str:
    """The path of Chromium; the test skips where there is none."""
    path = find_chromium()
    if path is None:
        pytest.skip("No Chromium: `sudo apt-get install chromium`, or name one in CHROMIUM.")
    return path


_cpu_s: dict[str, float] = defaultdict(float)


def processor_s() -> float:
    """Seconds of a processor that this process, and those that it started and that have ended, took so far."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Counts what a test takes with its fixtures, by its file."""
    before_s = processor_s()
    result = yield
    if item.get_closest_marker("long") is None:
        _cpu_s[item.nodeid.split("::")[0]] += processor_s() - before_s
    return result


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Takes over what a process of pytest-xdist has counted."""
    for file, spent_s in getattr(node, "workeroutput", {}).get("cpu_s", {}).items():
        _cpu_s[file] += spent_s


def pytest_sessionfinish(session: pytest.Session) -> None:
    output = getattr(session.config, "workeroutput", None)
    if output is not None:
        output["cpu_s"] = dict(_cpu_s)
    elif max(_cpu_s.values(), default=0.0) > FILE_CPU_S and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    folders: dict[str, float] = defaultdict(float)
    for file, spent_s in _cpu_s.items():
        parts = Path(file).parts
        folders[parts[1] if len(parts) > 2 else ""] += spent_s
        if spent_s > FILE_CPU_S:
            said = f"{file} takes {spent_s:.0f} s of a processor, more than {FILE_CPU_S:.0f}: the run fails."
            terminalreporter.write_line(said, red=True)
    terminalreporter.section("seconds of a processor per folder, spent / budget")
    for folder, spent_s in sorted(folders.items()):
        budget_s = FOLDER_BUDGET_S.get(folder)
        line = f"{folder:<14} {spent_s:7.1f} / {'none' if budget_s is None else budget_s}"
        over = budget_s is not None and spent_s > budget_s
        terminalreporter.write_line(line + ("   OVER BUDGET" if over else ""), yellow=over)
