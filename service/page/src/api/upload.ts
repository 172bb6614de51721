// Sends an archive in several requests, by the tus protocol: a broken connection costs only what was on its way. The
// browser's storage keeps the upload's address, so that the same files go on after a restart of the page.

import { DetailedError, Upload as TusUpload } from "tus-js-client";

import type { Capture } from "../archive/capture";
import { fingerprint } from "./fingerprint";
import { Problem, Unreachable, readProblem } from "./problem";
import type { Service } from "./service";
import type { Job, JobOptions } from "./types";

const REQUEST_BYTES = 32 * 1024 * 1024;
// Pauses after failures in a row, milliseconds.
const PAUSES = [500, 1000, 2000, 4000, 8000, 8000, 8000];
// Statuses after which the same bytes may be taken later: too slow, another offset, busy, away.
const AGAIN = new Set([408, 409, 429, 502, 503, 504]);

/** A capture on its way. `send` can be called again after an error: it goes on where the service has it. */
export class Upload {
  private url: string | null = null;

  constructor(
    private readonly service: Service,
    private readonly capture: Capture,
    private readonly options: JobOptions,
  ) {}

  /** The job that the service makes of it. Throws Problem, Unreachable, or the signal's AbortError. */
  async send(progress: (sent: number) => void, signal: AbortSignal): Promise<Job> {
    try {
      await this.transfer(progress, signal);
      return await this.service.submitUpload(this.url!);
    } catch (error) {
      // What the service no longer has is sent from the start.
      if (error instanceof Problem && (error.status === 404 || error.status === 410)) this.url = null;
      throw error;
    }
  }

  private transfer(progress: (sent: number) => void, signal: AbortSignal): Promise<void> {
    return new Promise((resolve, reject) => {
      const upload = new TusUpload(this.capture.archive, {
        endpoint: "/uploads",
        uploadUrl: this.url,
        chunkSize: REQUEST_BYTES,
        retryDelays: PAUSES,
        headers: this.service.credentials,
        metadata: { options: JSON.stringify(this.options) },
        fingerprint: () => Promise.resolve(fingerprint([...this.capture.identity, JSON.stringify(this.options)])),
        removeFingerprintOnSuccess: true,
        onUploadUrlAvailable: () => {
          this.url = upload.url;
        },
        onProgress: progress,
        onShouldRetry: (error) => this.mayPass(error),
        onSuccess: () => resolve(),
        onError: (error) => {
          const understood = this.understood(error);
          if (understood instanceof Problem && understood.status !== 401) this.giveUp(upload);
          reject(understood);
        },
      });
      signal.addEventListener("abort", () => {
        // Also what has arrived: the person wants none of it.
        void upload.abort(true).catch(() => undefined);
        reject(signal.reason);
      });
      void upload.findPreviousUploads().then((earlier) => {
        if (signal.aborted) return;
        const last = earlier.at(-1);
        if (last !== undefined) upload.resumeFromPreviousUpload(last);
        upload.start();
      });
    });
  }

  /** Delete what the service has: it does not want the rest. */
  private giveUp(upload: TusUpload): void {
    void upload.abort(true).catch(() => undefined);
    this.url = null;
  }

  /** Whether the same bytes may be taken later. */
  private mayPass(error: DetailedError): boolean {
    if (error.originalResponse !== null) return AGAIN.has(error.originalResponse.getStatus());
    this.service.connection.lost();
    return true;
  }

  private understood(error: Error | DetailedError): Error {
    const answer = "originalResponse" in error ? error.originalResponse : null;
    if (answer === null) {
      this.service.connection.lost();
      return new Unreachable();
    }
    const problem = readProblem(answer.getStatus(), answer.getBody());
    this.service.refused(problem);
    return problem;
  }
}
