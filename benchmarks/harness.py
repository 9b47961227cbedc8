"""The frame of every benchmark: options, rows, a table, and a record of machine, commit and command.

A benchmark measures cases (a garment in a fabric over a clip, say) by methods; each pair gives a row of measures. It is
a function of a ``Run``, made into a command:

    @Benchmark("folds", "What folds make of a clip.", COLUMNS, *inputs(), Option("--fps", 30.0, "frames a second"))
    def main(run: Run) -> None:
        run.add(rows)

    if __name__ == "__main__":
        main.command()

The command reads its options, calls the function, prints all rows as one table, and ends with one line of JSON, the
record. ``--save`` keeps the record under benchmarks/results, ``--out`` in another file. ``--quick`` asks for a small
form that ends within about a minute.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.tables import Columns, Record, Row, text_table
from drape.artifacts import DEFAULT_MODEL
from drape.errors import Unavailable, exit_status
from drape.files.atomic import write_whole
from drape.files.data import DATA_VARIABLE, data_folder

ROOT = Path(__file__).resolve().parents[1]
RESULTS_DIR = ROOT / "benchmarks" / "results"
NOTHING_EXIT = 3  # what is measured is not on this machine: scripts/bench takes that for no failure
AS_ALWAYS: Any = object()


@dataclass(frozen=True)
class Option:
    """An option of a command line: its ``flag``, its value where it is not given (``default``), and its value under
    ``--quick`` where that differs.

    ``kind`` turns a word into a value; without it that is the type of ``default``. An option whose default is a tuple
    takes several words, and one whose default is False is a switch.
    """

    flag: str
    default: Any
    help: str = ""
    quick: Any = AS_ALWAYS
    kind: Callable[[str], Any] | None = None
    choices: Collection[str] | None = None

    def add_to(self, parser: argparse.ArgumentParser, *, quick: bool) -> None:
        """Adds the option to ``parser``, with the default of ``--quick`` where ``quick`` is true."""
        default = self.quick if quick and self.quick is not AS_ALWAYS else self.default
        text = self.help.replace("%", "%%")
        if self.default is False:
            parser.add_argument(self.flag, action="store_true", default=default, help=text)
            return
        several = isinstance(self.default, tuple)
        kind = self.kind or type(self.default[0] if several and self.default else self.default or "")
        parser.add_argument(
            self.flag,
            type=str if kind is tuple else kind,
            nargs="+" if several else None,
            default=default,
            choices=None if self.choices is None else list(self.choices),
            help=text if default in (None, ()) else f"{text} (default %(default)s)".strip(),
        )


def inputs(
    garments: tuple[str, ...] = (),
    motions: tuple[str, ...] = (),
    *,
    quick_garments: tuple[str, ...] = AS_ALWAYS,
    quick_motions: tuple[str, ...] = AS_ALWAYS,
) -> tuple[Option, ...]:
    """Returns the options ``--garments``, ``--motions`` and ``--model``. The arguments are their defaults; () stands
    for all shipped garments or motions."""
    return (
        Option("--garments", garments, "names, files or folders", quick_garments),
        Option("--motions", motions, "names, files or folders", quick_motions),
        Option("--model", DEFAULT_MODEL, "name under drape/assets/models, or a folder"),
    )


COMMON = (
    Option("--threads", os.cpu_count(), "of the processor"),
    Option("--out", None, "write the record to this file", kind=Path),
    Option("--save", False, "keep the record as benchmarks/results/NAME.json"),
)


@dataclass
class Run:
    """A benchmark that runs: its ``options``, its ``rows`` so far, and what its record holds beside them (``extra``).

    ``summary`` are rows that are printed below the others and are not in the record, unless ``extra`` has them.
    ``notes`` are printed below the table. A run that ``failed`` ends the program with status 1.
    """

    name: str
    columns: Columns
    options: argparse.Namespace
    rows: list[Row] = field(default_factory=list)
    summary: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)
    failed: bool = False

    def add(self, rows: Iterable[Row]) -> None:
        """Adds ``rows`` and prints them."""
        more = list(rows)
        self.rows += more
        print(text_table(more, self.columns), flush=True)

    def record(self) -> Record:
        """Returns the record of the run: name, rows, ``extra``, machine, threads, commit and command."""
        where = {"machine": machine(), "threads": self.options.threads, "commit": commit_of_tree()}
        how = {"command": command(self.name, self.options.words)}
        return finite({"bench": self.name, "rows": self.rows, **self.extra, **where, **how})


class Command:
    """A benchmark as a function of command line arguments."""

    def __init__(self, bench: Benchmark, measure: Callable[[Run], None]) -> None:
        self._bench, self._measure = bench, measure
        self.__doc__ = measure.__doc__

    def parse(self, arguments: Sequence[str] | None = None) -> argparse.Namespace:
        """Returns the options that ``arguments`` ask for, those of the program by default, and under ``words`` the
        arguments themselves."""
        words = list(sys.argv[1:] if arguments is None else arguments)
        quick = argparse.ArgumentParser(add_help=False)
        quick.add_argument("--quick", action="store_true", help="a small form that ends within about a minute")
        parser = argparse.ArgumentParser(
            prog=f"python -m {module(self._bench.name)}", description=self._bench.description, parents=[quick]
        )
        for option in self._bench.options:
            option.add_to(parser, quick=quick.parse_known_args(words)[0].quick)
        options = parser.parse_args(words)
        options.words = words
        return options

    def __call__(self, arguments: Sequence[str] | None = None) -> Record:
        """Measures, prints the table and the record, writes the record where it is asked for, and returns it."""
        options = self.parse(arguments)
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(options.threads)
        run = Run(self._bench.name, self._bench.columns, options)
        self._measure(run)
        print("\n" + "\n".join([text_table([*run.rows, *run.summary], run.columns), *run.notes]))
        record = run.record()
        if options.save:
            write(RESULTS_DIR / f"{run.name}.json", record)
        if options.out is not None:
            write(options.out, record)
        print(json.dumps(record, allow_nan=False), flush=True)
        if run.failed:
            raise SystemExit(1)
        return record

    def command(self) -> None:
        """Runs the command line and ends the program: with status 0, with 1 or 2 after a failure or a refusal, and with
        ``NOTHING_EXIT`` where this machine lacks what is measured."""

        def measured() -> None:
            try:
                self()
            except Unavailable as error:
                print(error, file=sys.stderr)
                sys.exit(NOTHING_EXIT)

        sys.exit(exit_status(measured))


class Benchmark:
    """The command line of a benchmark: the ``name`` of its record, the ``columns`` of its table, and its options."""

    def __init__(self, name: str, description: str, columns: Columns, *options: Option) -> None:
        self.name, self.description, self.columns = name, description, columns
        self.options = (*options, *COMMON)

    def __call__(self, measure: Callable[[Run], None]) -> Command:
        """``measure``, which fills a run, as a command."""
        return Command(self, measure)


def write(target: Path, record: Record) -> None:
    """Writes ``record`` to the file ``target`` as JSON, a line for each key and for each item of a list of objects."""
    parts = []
    for key, value in record.items():
        text = json.dumps(value, allow_nan=False, separators=(",", ":"))
        if isinstance(value, list) and value and isinstance(value[0], dict):
            rows = (json.dumps(row, allow_nan=False, separators=(",", ":")) for row in value)
            text = "[\n" + ",\n".join(rows) + "\n]"
        parts.append(f"{json.dumps(key)}: {text}")
    write_whole(target, "{\n" + ",\n".join(parts) + "\n}\n")


def finite(value: Any) -> Any:
    """Returns ``value`` for JSON: None in place of NaN and infinity, floats rounded to six digits, lists for tuples."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


def module(bench: str) -> str:
    """Returns the name of the module of ``benchmarks`` that ``python -m`` runs now, or of ``benchmarks.BENCH`` where
    something else runs."""
    spec = sys.modules["__main__"].__spec__
    running = spec.name if spec is not None and spec.name.startswith("benchmarks.") else f"benchmarks.{bench}"
    return running.removesuffix(".__main__")


def command(bench: str, arguments: Sequence[str]) -> str:
    """Returns the command line of ``bench`` with ``arguments``, without folders of this machine: the folder of data is
    written as its variable, another absolute path as its last part."""
    data, words = data_folder(), [f"python -m {module(bench)}"]
    for word in arguments:
        path = Path(word).resolve()
        if data is not None and path.is_relative_to(data.resolve()):
            words.append("$" + str(DATA_VARIABLE / path.relative_to(data.resolve())))
        elif Path(word).is_absolute() and len(path.parts) > 2:
            words.append(shlex.quote(f".../{Path(word).name}"))
        else:
            words.append(shlex.quote(word))
    return " ".join(words)


def machine() -> str:
    """Returns the processor's model, the number of cores, the operating system and Python's version, as words."""
    model, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.is_file():
        named = (line for line in info.read_text().splitlines() if line.startswith("model name"))
        model = next((line.split(":", 1)[1].strip() for line in named), model)
    system = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    return f"{model}, {os.cpu_count()} cores, {system}"


def commit_of_tree() -> str:
    """Returns twelve digits of the hash of the commit that is checked out, with "+" where tracked files differ from it;
    "none" outside a clone."""
    try:
        head = _git("rev-parse", "--short=12", "HEAD")
        return head + ("+" if _git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.CalledProcessError):
        return "none"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, check=True, text=True).stdout.strip()
