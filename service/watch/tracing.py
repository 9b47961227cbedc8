"""Spans of requests, streams' frames and uploads for OpenTelemetry, where ``DRAPE_TRACE`` asks for them: ``Tracing``.

The collector, the share of traces and the name of the service come from OpenTelemetry's own variables
(``OTEL_EXPORTER_OTLP_ENDPOINT``, ``OTEL_TRACES_SAMPLER``, ``OTEL_SERVICE_NAME`` and others), read by its SDK, which is
loaded only then. A span never has headers, query strings, bodies or addresses, as no log line has.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from drape import __version__
from drape.errors import Unavailable

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.trace import Link, Span

CLOSE_S = 2.0  # for spans that are not sent yet; a collector that does not answer must not hold the service's end
ERROR_STATUS = 500  # from here on a status is a fault of ours


class Tracing:
    """The spans of one service, sent through ``provider``; None: nobody asked, and every method does nothing.

    Every method may be called from any thread. A span's parent is what runs in the caller's context
    (``contextvars``): hand work to other threads in a copy of it.
    """

    def __init__(self, provider: TracerProvider | None = None) -> None:
        self._provider = provider
        self._tracer = None if provider is None else provider.get_tracer("drape", __version__)
        self.on = self._tracer is not None

    @contextmanager
    def request(self, method: str, headers: Mapping[str, str], request: str) -> Iterator[Answered]:
        """Traces a request while the block runs, under the ``traceparent`` of its ``headers`` if they have one.

        It yields the ``Answered`` that is told the status. ``request``: the id that log lines give it.
        """
        if self._tracer is None:
            yield Answered(None)
            return
        from opentelemetry.trace import SpanKind
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        sent = {name: headers[name] for name in ("traceparent", "tracestate") if name in headers}
        attributes = {"http.request.method": method, "drape.request": request}
        with self._tracer.start_as_current_span(
            method,
            TraceContextTextMapPropagator().extract(sent),
            SpanKind.SERVER,
            attributes,
            record_exception=False,
            set_status_on_exception=False,
        ) as span:
            yield Answered(span)

    @contextmanager
    def work(self, name: str, links: Sequence[Link | None] = (), **attributes: str | int | float) -> Iterator[None]:
        """Traces work that is done for others than its caller: a trace of its own, with ``links`` (``here``) to theirs.
        If it fails, its span holds only the class of the error."""
        if self._tracer is None:
            yield
            return
        from opentelemetry.context import Context
        from opentelemetry.trace import StatusCode

        found = [link for link in links if link is not None]
        named = {f"drape.{key}": value for key, value in attributes.items()}
        with self._tracer.start_as_current_span(
            name, Context(), attributes=named, links=found, record_exception=False, set_status_on_exception=False
        ) as span:
            try:
                yield
            except Exception as error:
                span.set_status(StatusCode.ERROR, type(error).__name__)
                raise

    def here(self) -> Link | None:
        """A link to the span that runs in the caller's context; None where there is none."""
        if self._tracer is None:
            return None
        from opentelemetry.trace import Link, get_current_span

        context = get_current_span().get_span_context()
        return Link(context) if context.is_valid else None

    def event(self, name: str) -> None:
        """Notes that something happened in the span that runs in the caller's context."""
        if self._tracer is not None:
            from opentelemetry.trace import get_current_span

            get_current_span().add_event(name)

    def stage(self, name: str, took_s: float) -> None:
        """A stage that ends now, ``took_s`` [s] of computing after its beginning: where others had their turn between
        its steps, the span is as long as the steps and begins too late."""
        if self._tracer is None:
            return
        now_ns = time.time_ns()
        self._tracer.start_span(name, start_time=now_ns - round(1e9 * took_s)).end(now_ns)

    def close(self) -> None:
        """Sends what is not sent yet, for ``CLOSE_S`` at most."""
        if self._provider is not None:
            last = threading.Thread(target=self._provider.shutdown, name="drape-spans", daemon=True)
            last.start()
            last.join(CLOSE_S)


class Answered:
    """The open span of a request; ``told`` names it by how the request was answered."""

    def __init__(self, span: Span | None) -> None:
        self._span = span

    def told(self, method: str, path: str, status: int) -> None:
        """Names the span by ``method`` and ``path``, which has its parameters' names, and notes the ``status``."""
        if self._span is None:
            return
        from opentelemetry.trace import StatusCode

        self._span.update_name(f"{method} {path}")
        self._span.set_attributes({"http.route": path, "http.response.status_code": status})
        if status >= ERROR_STATUS:
            self._span.set_status(StatusCode.ERROR)


def make_tracing(trace: bool) -> Tracing:
    """Tracing as OpenTelemetry's variables say where ``trace`` asks for it; refuses (``Unavailable``) without its
    packages."""
    if not trace:
        return Tracing()
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import SERVICE_NAME, SERVICE_VERSION, Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ModuleNotFoundError as error:
        raise Unavailable(
            "DRAPE_TRACE",
            expected="the packages of the extra 'otel'",
            got=f"no {error.name}",
            cure="Install the service with [otel], in a clone: pip install -e 'service[otel]'; or unset DRAPE_TRACE.",
        ) from error
    names = {SERVICE_VERSION: __version__}
    if "OTEL_SERVICE_NAME" not in os.environ:
        names[SERVICE_NAME] = "drape"
    provider = TracerProvider(resource=Resource.create(names), shutdown_on_exit=False)
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return Tracing(provider)
