"""``python -m service [--host H] [--port P]``: loads everything, then listens."""

from __future__ import annotations

import argparse
import gc
import logging
import os
import signal
import sys
from contextlib import ExitStack

from drape import installed
from drape.errors import DrapeError


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m service", description="Serves draped garments. Other settings: docs/guide/operate.md."
    )
    parser.add_argument("--host", help="the address to listen on (default: DRAPE_HOST, or 127.0.0.1)")
    parser.add_argument(
        "--port", type=int, help="the port to listen on, 0 for a free one (default: DRAPE_PORT, or 8000)"
    )
    parser.add_argument(
        "--open",
        action="store_true",
        default=None,
        help="serve without keys to everybody who can reach the address (DRAPE_OPEN)",
    )
    options = parser.parse_args(arguments)
    try:
        return _serve({key: value for key, value in vars(options).items() if value is not None})
    except DrapeError as error:
        print(f"service: {error}", file=sys.stderr)
        return 2


def _serve(overrides: dict[str, object]) -> int:
    installed.check()
    # Imported here, so that --help and a missing package do not need everything.
    try:
        from service.app import create_app
        from service.compute.background import give_back_memory, take_turns
        from service.compute.drape_runtime import DrapeRuntime
        from service.server import bind_listener, make_server
        from service.settings import check_exposed, load_settings, unread_variables
        from service.watch.logs import set_up
        from service.watch.outputs import free_outputs
        from service.watch.probes import Lifecycle, Probes
        from service.watch.prometheus import Metrics
    except ModuleNotFoundError as error:
        print(
            f"service: expected the packages of the extra 'serve', got no {error.name}. "
            "Run make serve in a clone, or install the wheel with [serve].",
            file=sys.stderr,
        )
        return 2
    # SIGTERM ends the process also while it loads and after the server has ended. Without a handler the system would
    # not end a process with the number 1, as that of a container.
    signal.signal(signal.SIGTERM, lambda *_: os._exit(128 + signal.SIGTERM))
    give_back_memory()
    settings = load_settings(**overrides)
    check_exposed(settings)
    set_up(settings.log_format)
    free_outputs(settings.log_format)
    for name in unread_variables():
        logging.getLogger("drape.service").warning("%s is no setting; see docs/guide/operate.md", name)
    lifecycle, metrics = Lifecycle(stuck_s=settings.stuck_s), Metrics()
    listener = bind_listener(settings.host, settings.port)
    with ExitStack() as opened:
        opened.enter_context(listener)
        if settings.probe_port is not None:
            probes = Probes(bind_listener(settings.host, settings.probe_port), lifecycle, metrics)
            port = opened.enter_context(probes).server_address[1]
            logging.getLogger("drape.service").info("probes on port %d", port)
        runtime = DrapeRuntime(settings, metrics=metrics, at_once=False)
        server = make_server(create_app(settings, runtime=runtime, lifecycle=lifecycle), settings)
        host, port = listener.getsockname()[:2]
        loaded = f"{len(runtime.garments.entries())} garments, {runtime.engine.provider}"
        print(f"drape on http://{host}:{port} with model {runtime.engine.manifest.name}, {loaded}", flush=True)
        # Parsing sets off full collections, which hold the interpreter lock for 50 ms to look through what never goes.
        gc.collect()
        gc.freeze()
        take_turns()
        server.run(sockets=[listener])
    return 0


if __name__ == "__main__":
    sys.exit(main())
