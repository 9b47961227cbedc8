"""``python -m service.static GARMENT OUT`` writes a folder with a page that drapes the garment without a service.

python -m service.static tshirt shirt --motion walk,turn --tier balanced
python -m http.server 5173 --bind 127.0.0.1 --directory shirt
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from pathlib import Path
from typing import get_args

from drape.errors import DrapeError, with_numbers_bound
from drape.wire.options import DrapeOptions, TierName


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m service.static",
        description="Writes a folder of files with a page on which browsers drape one garment by themselves.",
    )
    parser.add_argument("garment", help="the garment's id, as GET /garments lists it")
    parser.add_argument("out", type=Path, help="the folder to write: a new one, or one that this command has written")
    parser.add_argument(
        "--motion", default="walk", help="the ids of the clips that the page plays, comma-separated (default: walk)"
    )
    parser.add_argument("--tier", choices=get_args(TierName), help="how much a frame computes (default: balanced)")
    parser.add_argument("--fabric", help="the name of a fabric (default: the garment's own)")
    parser.add_argument(
        "--betas", type=_numbers, default=(), help="the body's shape coefficients, comma-separated (default: zeros)"
    )
    options = parser.parse_args(with_numbers_bound(arguments))
    try:
        return _write(options)
    except DrapeError as error:
        print(f"service.static: {error}", file=sys.stderr)
        return 2


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(number) for number in text.split(","))


def _write(options: argparse.Namespace) -> int:
    # Imported here, so that --help does not need everything.
    from service.app import create_app
    from service.compute.drape_runtime import DrapeRuntime
    from service.settings import load_settings
    from service.static.site import FolderRequest, folder_sizes, write_folder

    settings = load_settings(keys_file=None)
    runtime = DrapeRuntime(settings)
    drape = DrapeOptions(**{name: value for name in ("tier", "fabric") if (value := getattr(options, name))})
    request = FolderRequest(options.garment, tuple(options.motion.split(",")), drape, options.betas)
    asyncio.run(write_folder(create_app(settings, runtime=runtime), runtime, request, options.out))
    sizes = folder_sizes(options.out)
    for name, count in sorted(sizes.items(), key=lambda item: -item[1]):
        print(f"{count / 1e6:8.3f} MB  {name}")
    print(f"{sum(sizes.values()) / 1e6:8.3f} MB  in all")
    return 0


if __name__ == "__main__":
    sys.exit(main())
