"""OpenTelemetry traces, which need the extra `mgsr[telemetry]` and an endpoint.

A job's record keeps the span of its submit. So all attempts belong to the same trace, on any machine and after any loss
of the queue. OpenTelemetry's own variables set endpoint, headers and sampling.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from service.contract.errors import SetupError

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

ENDPOINTS = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT")


def open_telemetry(program: str) -> TracerProvider | None:
    """Return the tracer provider that sends this program's spans, or None if no endpoint is set.

    Raises SetupError if the packages are missing.
    """
    if not any(os.environ.get(name) for name in ENDPOINTS):
        return None
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import SERVICE_NAME, Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ModuleNotFoundError as error:
        raise SetupError(
            f"{' or '.join(ENDPOINTS)} is set, but the package {error.name} is missing; run "
            "pip install 'mgsr[telemetry]'"
        ) from error
    provider = TracerProvider(resource=Resource.create({SERVICE_NAME: program}))
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return provider


def current_traceparent() -> str | None:
    """Return the current span as W3C `traceparent`, or None without a span."""
    try:
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
    except ModuleNotFoundError:
        return None
    carrier: dict[str, str] = {}
    TraceContextTextMapPropagator().inject(carrier)
    return carrier.get("traceparent")
