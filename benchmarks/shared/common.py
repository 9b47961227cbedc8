"""What every benchmark shares: its options, the machine's name, and the record in its last line.

A claim of speed or quality comes with command, machine, commit and numbers, so a
benchmark ends with one line of JSON that holds them; ``--save`` keeps it under
benchmarks/results and ``--out`` anywhere else.
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
from pathlib import Path
from typing import Any

from drape.artifacts import DEFAULT_MODEL
from drape.files.data import DATA_VARIABLE, data_folder

ROOT = Path(__file__).resolve().parents[2]
RESULTS_DIR = ROOT / "benchmarks" / "results"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds ``--quick``, ``--threads``, ``--save`` and ``--out``."""
    parser.add_argument("--quick", action="store_true", help="a small form that ends within about a minute")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="CPU threads (default: all)")
    parser.add_argument("--save", action="store_true", help="keep the record as benchmarks/results/NAME.json")
    parser.add_argument("--out", type=Path, help="write the record to this file")


def add_inputs(parser: argparse.ArgumentParser) -> None:
    """Adds ``--garments``, ``--motions`` and ``--model``."""
    parser.add_argument("--garments", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument(
        "--model", default=DEFAULT_MODEL, help=f"name under assets/models, or a folder (default {DEFAULT_MODEL})"
    )


def lines(record: dict[str, Any]) -> str:
    """``record`` as JSON with a line for each of its keys, and for each item of a list of objects."""
    parts = []
    for key, value in record.items():
        text = json.dumps(value, allow_nan=False, separators=(",", ":"))
        if isinstance(value, list) and value and isinstance(value[0], dict):
            rows = (json.dumps(row, allow_nan=False, separators=(",", ":")) for row in value)
            text = "[\n" + ",\n".join(rows) + "\n]"
        parts.append(f"{json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def finish(bench: str, rows: list[dict[str, Any]], options: argparse.Namespace, **extra: Any) -> dict[str, Any]:
    """Prints the record as the last line, writes it where the options ask, and returns it."""
    record = finite(
        {
            "bench": bench,
            "rows": rows,
            **extra,
            "machine": machine(),
            "threads": options.threads,
            "commit": commit(),
            "command": command(bench, sys.argv[1:]),
        }
    )
    targets = [RESULTS_DIR / f"{bench}.json"] if options.save else []
    for target in [*targets, *([options.out] if options.out else [])]:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = target.with_name(target.name + ".part")
        temporary.write_text(lines(record), encoding="utf-8")
        os.replace(temporary, target)
    print(json.dumps(record, allow_nan=False), flush=True)
    return record


def command(bench: str, arguments: list[str]) -> str:
    """The command line that runs: the module as it was named, else that of ``bench``; the folder of private data under
    its variable's name, other absolute paths cut to their end."""
    data, spec = data_folder(), sys.modules["__main__"].__spec__
    running = spec.name if spec is not None and spec.name.startswith("benchmarks.") else f"benchmarks.{bench}"
    words = [f"python -m {running.removesuffix('.__main__')}"]
    for word in arguments:
        path = Path(word).resolve()
        if data is not None and path.is_relative_to(data.resolve()):
            words.append("$" + str(DATA_VARIABLE / path.relative_to(data.resolve())))
        elif Path(word).is_absolute() and len(path.parts) > 2:
            words.append(shlex.quote(f".../{Path(word).name}"))
        else:
            words.append(shlex.quote(word))
    return " ".join(words)


def finite(value: Any) -> Any:
    """``value`` with NaN and infinity as None, which JSON can hold, and floats at six digits."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


def machine() -> str:
    """Processor model, core count and operating system."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    return (
        f"{model}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}, Python {platform.python_version()}"
    )


def commit() -> str:
    """Hash of the checked-out commit, "+" behind it where tracked files differ; "none" outside a clone."""
    try:
        head = _git("rev-parse", "--short=12", "HEAD")
        return head + ("+" if _git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.CalledProcessError):
        return "none"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, check=True, text=True).stdout.strip()


def print_table(rows: list[dict[str, Any]], columns: dict[str, str]) -> None:
    """Prints ``rows`` under the keys of ``columns``, each with its format; what a row lacks stays empty."""
    cells = [[_cell(row.get(key), form) for key, form in columns.items()] for row in rows]
    widths = [max(len(key), *(len(line[i]) for line in cells), 0) for i, key in enumerate(columns)]
    for line in [list(columns), *cells]:
        padded = [
            c.ljust(w) if form == "s" else c.rjust(w) for c, w, form in zip(line, widths, columns.values(), strict=True)
        ]
        print("  ".join(padded).rstrip())


def _cell(value: Any, form: str) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return format(value, form)
