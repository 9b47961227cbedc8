"""Spans of requests, streams' frames and uploads for OpenTelemetry, if ``DRAPE_TRACE`` asks for them: ``Tracing``.

The collector, the share of traces and the name of the service come from OpenTelemetry's own variables
(``OTEL_EXPORTER_OTLP_ENDPOINT``, ``OTEL_TRACES_SAMPLER``, ``OTEL_SERVICE_NAME`` and others). Its SDK reads them, and is
imported only with tracing. A span never has headers, query strings, bodies or addresses.
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

CLOSE_S = 2.0  # the time for the last spans, as a collector that does not answer must not delay the service's end
ERROR_STATUS = 500  # a status from here on is a fault of ours


class Tracing:
    """Makes the spans of one service and sends them through ``provider``. Where that is None all methods do nothing.

    Any thread may call the methods. The parent of a span is the span of the caller's context (``contextvars``), so work
    for other threads must run in a copy of it.
    """

    def __init__(self, provider: TracerProvider | None = None) -> None:
        self._provider = provider
        self._tracer = None if provider is None else provider.get_tracer("drape", __version__)
        self.on = self._tracer is not None

    @contextmanager
    def request(self, method: str, headers: Mapping[str, str], request: str) -> Iterator[RequestSpan]:
        """Traces a request while the block runs, under the ``traceparent`` of its ``headers`` if there is one.
        ``request`` is its id in log lines. Yields its ``RequestSpan``."""
        if self._tracer is None:
            yield RequestSpan(None)
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
            yield RequestSpan(span)

    @contextmanager
    def work(self, name: str, links: Sequence[Link | None] = (), **attributes: str | int | float) -> Iterator[None]:
        """Traces work for several requests while the block runs, as a trace of its own called ``name`` with ``links``
        to the spans of the requests (``here``). A failure is noted with only the class of the error."""
        if self._tracer is None:
            yield
            return
        from opentelemetry.context import Context
        from opentelemetry.trace import StatusCode

        named = {f"drape.{key}": value for key, value in attributes.items()}
        with self._tracer.start_as_current_span(
            name,
            Context(),
            attributes=named,
            links=[link for link in links if link is not None],
            record_exception=False,
            set_status_on_exception=False,
        ) as span:
            try:
                yield
            except Exception as error:
                span.set_status(StatusCode.ERROR, type(error).__name__)
                raise

    def here(self) -> Link | None:
        """Returns a link to the span of the caller's context; None if there is none."""
        if self._tracer is None:
            return None
        from opentelemetry.trace import Link, get_current_span

        context = get_current_span().get_span_context()
        return Link(context) if context.is_valid else None

    def event(self, name: str) -> None:
        """Adds an event called ``name`` to the span of the caller's context."""
        if self._tracer is not None:
            from opentelemetry.trace import get_current_span

            get_current_span().add_event(name)

    def stage(self, name: str, took_s: float) -> None:
        """Adds a span for the stage ``name``, which ends now and took ``took_s`` [s]. Where other work came between
        steps of the stage, that time is not in ``took_s``, and the span begins too late."""
        if self._tracer is None:
            return
        now_ns = time.time_ns()
        self._tracer.start_span(name, start_time=now_ns - round(1e9 * took_s)).end(now_ns)

    def close(self) -> None:
        """Sends the spans that are not sent yet, within ``CLOSE_S``."""
        if self._provider is not None:
            last = threading.Thread(target=self._provider.shutdown, name="drape-spans", daemon=True)
            last.start()
            last.join(CLOSE_S)


class RequestSpan:
    """The open span of a request, or nothing without tracing."""

    def __init__(self, span: Span | None) -> None:
        self._span = span

    def note_answer(self, method: str, path: str, status: int) -> None:
        """Names the span by ``method`` and ``path`` (``logged_path``), and notes the ``status`` of the answer."""
        if self._span is None:
            return
        from opentelemetry.trace import StatusCode

        self._span.update_name(f"{method} {path}")
        self._span.set_attributes({"http.route": path, "http.response.status_code": status})
        if status >= ERROR_STATUS:
            self._span.set_status(StatusCode.ERROR)


def make_tracing(trace: bool) -> Tracing:
    """Returns tracing as OpenTelemetry's variables configure it, or one that does nothing if ``trace`` is false.
    Refuses (``Unavailable``) where its packages are missing."""
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
