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
    """For ``serve run service.ray_app:app least=1 most=4``: everything else from the environment."""
    return application(load_settings(), int(arguments.get("least", 1)), int(arguments.get("most", 1)))


def main(arguments: list[str] | None = None) -> int:
    """Serves until it is told to end; the exit status, 2 after a refusal."""
    parser = argparse.ArgumentParser(
        prog="python -m service.ray_app", description="Serves with several processes. docs/guide/deploy.md"
    )
    parser.add_argument("--host", help="address to listen on (DRAPE_HOST, 127.0.0.1)")
    parser.add_argument("--port", type=int, help="port to listen on (DRAPE_PORT, 8000)")
    parser.add_argument("--replicas", type=int, nargs=2, default=(1, 1), metavar=("LEAST", "MOST"), help="1 1")
    parser.add_argument("--address", help="of a Ray cluster that runs, or auto; without it, one of its own")
    parser.add_argument("--open", action="store_true", default=None, help="let everybody in who can reach it")
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
