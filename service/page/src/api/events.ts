// Server-sent events over fetch: EventSource can't send the header that carries the key.

import { Unreachable, isAbort } from "./problem";
import type { Service } from "./service";
import { pieces } from "./stream";
import type { Job, Progress } from "./types";

export interface ServerEvent {
  id: string;
  kind: string;
  data: string;
}

export interface Watcher {
  /** Called with the whole job: first, after each new connection, and when the job has ended. */
  job(job: Job): void;
  /** Called with the changed fields. */
  progress(change: Partial<Progress>): void;
}

const PAUSE = 2000;
// The service sends something at least every 15 s.
const SILENCE = 40_000;

/** Follow a job until it has ended or the signal aborts. Resumes after lost connections. Throws Problem if the
 * service refuses. */
export async function follow(service: Service, id: string, watcher: Watcher, signal: AbortSignal): Promise<void> {
  let last: string | null = null;
  let ended = false;
  while (!ended && !signal.aborted) {
    try {
      for await (const event of listen(service, id, last, signal)) {
        if (event.id !== "") last = event.id;
        ended = pass(event, watcher);
      }
      if (!ended) await pause(signal);
    } catch (error) {
      if (isAbort(error) && signal.aborted) return;
      if (!(error instanceof Unreachable)) throw error;
      await service.connection.back(signal).catch(() => undefined);
    }
  }
}

/** Pass an event to the watcher, and return whether the job has ended. */
function pass(event: ServerEvent, watcher: Watcher): boolean {
  if (event.kind === "progress") watcher.progress(JSON.parse(event.data) as Partial<Progress>);
  if (event.kind !== "job") return false;
  const job = JSON.parse(event.data) as Job;
  watcher.job(job);
  return job.finished !== null;
}

async function* listen(
  service: Service,
  id: string,
  last: string | null,
  signal: AbortSignal,
): AsyncGenerator<ServerEvent> {
  const silence = new AbortController();
  let timer = setTimeout(() => silence.abort(), SILENCE);
  const headers: Record<string, string> = last === null ? {} : { "Last-Event-ID": last };
  try {
    const both = AbortSignal.any([signal, silence.signal]);
    const answer = await service.request(`/jobs/${id}/events`, { headers, signal: both });
    const parser = new EventParser();
    for await (const chunk of pieces(answer.body!.pipeThrough(new TextDecoderStream()))) {
      clearTimeout(timer);
      timer = setTimeout(() => silence.abort(), SILENCE);
      yield* parser.take(chunk);
    }
  } catch (error) {
    if (signal.aborted || !(error instanceof TypeError || isAbort(error))) throw error;
    service.connection.lost(); // cut off in the middle, or silent for too long
    throw new Unreachable();
  } finally {
    clearTimeout(timer);
  }
}

/** A parser that takes the stream's text in pieces of any size. */
export class EventParser {
  private held = "";

  /** Add a piece, and yield the events that it completes. */
  *take(chunk: string): Generator<ServerEvent> {
    const blocks = (this.held + chunk).split("\n\n");
    this.held = blocks.pop()!;
    for (const block of blocks) {
      const fields = new Map(block.split("\n").map((line) => cut(line)));
      const data = fields.get("data");
      if (data !== undefined) yield { id: fields.get("id") ?? "", kind: fields.get("event") ?? "message", data };
    }
  }
}

function cut(line: string): [string, string] {
  const colon = line.indexOf(":");
  return [line.slice(0, colon), line.slice(colon + 1).trimStart()];
}

function pause(signal: AbortSignal): Promise<void> {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, PAUSE);
    signal.addEventListener("abort", () => {
      clearTimeout(timer);
      resolve();
    });
  });
}
