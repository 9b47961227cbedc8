"""The service on Ray Serve: ``python -m service.ray_app --replicas 1 4``, or ``serve run service.ray_app:app``."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from drape.errors import DrapeError
from service.replicas.ray_deployment import application, prepare_ray, run_replicas
from service.settings import check_exposed, load_settings

if TYPE_CHECKING:
    from ray.serve import Application  # pyright: ignore[reportMissingImports]


def app(arguments: dict[str, str]) -> Application:
    """Returns the deployment for ``serve run service.ray_app:app least=1 most=4``: so many replicas at least and at
    most, 1 by default. All other settings come from the environment."""
    return application(load_settings(), int(arguments.get("least", 1)), int(arguments.get("most", 1)))


def main(arguments: list[str] | None = None) -> int:
    """Serves until the process is told to end. Returns the exit status: 0, or 2 after a refusal."""
    parser = argparse.ArgumentParser(
        prog="python -m service.ray_app",
        description="Serves with several processes by Ray Serve; see docs/guide/deploy.md.",
    )
    parser.add_argument("--host", help="the address to listen on (default: DRAPE_HOST, or 127.0.0.1)")
    parser.add_argument("--port", type=int, help="the port to listen on (default: DRAPE_PORT, or 8000)")
    parser.add_argument(
        "--replicas",
        type=int,
        nargs=2,
        default=(1, 1),
        metavar=("LEAST", "MOST"),
        help="the least and the greatest number of processes, between which Ray chooses by load (default: 1 1)",
    )
    parser.add_argument("--address", help="the address of a running Ray cluster, or auto (default: start one here)")
    parser.add_argument(
        "--open", action="store_true", default=None, help="serve without keys to everybody who can reach the address"
    )
    options = vars(parser.parse_args(arguments))
    least, most = options.pop("replicas")
    address = options.pop("address")
    try:
        settings = load_settings(**{key: value for key, value in options.items() if value is not None})
        check_exposed(settings)
        if address is None:
            prepare_ray()
        serving = application(settings, least, most)
        run_replicas(serving, settings, address)
    except DrapeError as error:
        print(f"service: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
