// The errors of requests to the service.

/** The service answered with an error: RFC 9457 problem details. */
export class Problem extends Error {
  constructor(
    readonly status: number,
    readonly code: string,
    readonly detail: string,
  ) {
    super(detail);
  }
}

/** The service did not answer. */
export class Unreachable extends Error {
  constructor() {
    super("the service does not answer");
  }
}

/** Return the problem that an answer's body describes, or one made from the status alone. */
export function readProblem(status: number, body: string): Problem {
  try {
    const { code, detail } = JSON.parse(body) as { code?: unknown; detail?: unknown };
    if (typeof code === "string" && typeof detail === "string") return new Problem(status, code, detail);
  } catch {
    // The answer comes from something in front of the service, such as a proxy.
  }
  return new Problem(status, "unknown", `the service answered with status ${status}`);
}

/** Return whether an error only means that the page itself cancelled the request. */
export function isAbort(error: unknown): boolean {
  return error instanceof DOMException && error.name === "AbortError";
}
