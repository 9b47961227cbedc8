"""``python -m service [--host H] [--port P]``: loads everything, then listens."""

from __future__ import annotations

import argparse
import gc
import logging
import sys

from drape.errors import DrapeError


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m service", description="Serves draped garments. Other settings: docs/guide/service.md."
    )
    parser.add_argument("--host", help="address to listen on (DRAPE_HOST, 127.0.0.1)")
    parser.add_argument("--port", type=int, help="port to listen on (DRAPE_PORT, 8000); 0 takes a free one")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    try:
        return _serve({key: value for key, value in vars(options).items() if value is not None})
    except DrapeError as error:
        print(f"service: {error}", file=sys.stderr)
        return 2


def _serve(overrides: dict[str, object]) -> int:
    # Imported here, so that --help and a missing package do not need everything.
    try:
        from service.app import create_app
        from service.drapery import Drapery
        from service.server import bind, make_server
        from service.settings import load_settings
    except ModuleNotFoundError as error:
        print(
            f"service: expected the packages of the extra 'service', got no {error.name}. Run make serve.",
            file=sys.stderr,
        )
        return 2
    settings = load_settings(**overrides)
    listener = bind(settings.host, settings.port)
    with listener:
        drapery = Drapery(settings)
        server = make_server(create_app(settings, drapery=drapery), settings)
        host, port = listener.getsockname()[:2]
        loaded = f"{len(drapery.garments.entries())} garments, {drapery.engine.provider}"
        print(f"drape on http://{host}:{port} with model {settings.model}, {loaded}")
        sys.stdout.flush()
        # Parsing sets off full collections, which hold the interpreter lock for 50 ms to look through what never goes.
        gc.collect()
        gc.freeze()
        server.run(sockets=[listener])
    return 0


if __name__ == "__main__":
    sys.exit(main())
