"""The spans of a worker's round in the trace of the job's submit: the wait, the work and its steps."""

from __future__ import annotations

import time
from contextlib import ExitStack
from datetime import datetime
from types import TracebackType
from typing import TYPE_CHECKING

from service.contract.records import JobRecord, Outcome

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.trace import Span, Tracer


class RoundTrace:
    """The spans of an attempt at a round, as a context manager. Without a provider it does nothing."""

    def __init__(
        self, provider: TracerProvider | None, record: JobRecord, number: int, waiting_since: datetime | None
    ) -> None:
        """Prepare the spans. waiting_since: when the round was put into the queue."""
        self._tracer: Tracer | None = None if provider is None else provider.get_tracer("mgsr.worker")
        self._record, self._number, self._waiting_since = record, number, waiting_since
        self._work: Span | None = None
        self._step: Span | None = None
        self._step_name: str | None = None
        self._stack = ExitStack()

    def __enter__(self) -> RoundTrace:
        if self._tracer is None:
            return self
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        submit = TraceContextTextMapPropagator().extract({"traceparent": self._record.traceparent or ""})
        about: dict[str, str | int] = {"mgsr.job": self._record.id, "mgsr.round": self._number}
        if self._waiting_since is not None:
            started_at = round(self._waiting_since.timestamp() * 1e9)
            self._tracer.start_span("queue", submit, attributes=about, start_time=started_at).end()
        work = self._tracer.start_as_current_span("job", submit, attributes=about)
        self._work = self._stack.enter_context(work)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.step(None)
        self._stack.__exit__(kind, error, trace)

    def step(self, name: str | None) -> None:
        """Begin the span of a step, and end that of the previous step."""
        if self._tracer is None or name == self._step_name:
            return
        if self._step is not None:
            self._step.end(time.time_ns())
        self._step_name = name
        self._step = None if name is None else self._tracer.start_span(f"step {name}")

    def ended(self, attempt: int, outcome: Outcome) -> None:
        """Record how the round ended."""
        if self._work is None:
            return
        from opentelemetry.trace import StatusCode

        self._work.set_attributes({"mgsr.attempt": attempt, "mgsr.status": outcome.status})
        if outcome.error is not None:
            self._work.set_status(StatusCode.ERROR, f"{outcome.error.code}: {outcome.error.message}")
