// What can go wrong between page and service.

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

/** The problem that an answer's body describes; one made from the status alone where it describes none. */
export function readProblem(status: number, body: string): Problem {
  try {
    const { code, detail } = JSON.parse(body) as { code?: unknown; detail?: unknown };
    if (typeof code === "string" && typeof detail === "string") return new Problem(status, code, detail);
  } catch {
    // Something before the service answered, such as a proxy.
  }
  return new Problem(status, "unknown", `the service answered with status ${status}`);
}

/** Whether an error only says that the page itself gave up. */
export function isAbort(error: unknown): boolean {
  return error instanceof DOMException && error.name === "AbortError";
}
