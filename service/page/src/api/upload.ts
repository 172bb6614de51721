// Sends an archive. By XMLHttpRequest: fetch can't tell how far an upload has come.

import { Unreachable, readProblem } from "./problem";
import type { Service } from "./service";
import type { Job, JobOptions } from "./types";

export interface Upload {
  archive: Blob;
  /** Media type of the archive. */
  type: string;
  options: JobOptions;
  /** The same for every try, so that a job whose answer got lost is not made twice. */
  idempotencyKey: string;
}

/** The job that the service makes of it. Throws Problem, Unreachable, or the signal's AbortError. */
export function send(service: Service, upload: Upload, progress: (sent: number) => void, signal: AbortSignal): Promise<Job> {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", `/jobs?options=${encodeURIComponent(JSON.stringify(upload.options))}`);
    const headers = {
      ...service.credentials,
      "Content-Type": upload.type,
      "Idempotency-Key": upload.idempotencyKey,
    };
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.onprogress = (event) => progress(event.loaded);
    request.onload = () => {
      if (request.status === 202) return resolve(JSON.parse(request.responseText) as Job);
      const problem = readProblem(request.status, request.responseText);
      service.refused(problem);
      reject(problem);
    };
    request.onerror = () => {
      service.connection.lost();
      reject(new Unreachable());
    };
    request.onabort = () => reject(signal.reason);
    signal.addEventListener("abort", () => request.abort());
    request.send(upload.archive);
  });
}
