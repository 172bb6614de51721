// Sends an archive in several requests by the tus protocol, so that a broken connection loses only the bytes in
// transit. The browser's storage keeps the upload's address, so that the same files continue after a reload of the page.

import { DetailedError, Upload as TusUpload } from "tus-js-client";

import type { Capture } from "../archive/capture";
import { fingerprint } from "./fingerprint";
import { Problem, Unreachable, readProblem } from "./problem";
import type { Service } from "./service";
import type { Job, JobOptions } from "./types";

const REQUEST_BYTES = 32 * 1024 * 1024;
// The pauses after failures in a row, in milliseconds.
const PAUSES = [500, 1000, 2000, 4000, 8000, 8000, 8000];
// Statuses after which a repeated request may succeed: too slow, another offset, busy, unavailable.
const AGAIN = new Set([408, 409, 429, 502, 503, 504]);

/** The upload of a capture. After an error, `send` can be called again, and continues where the service's bytes end. */
export class Upload {
  private url: string | null = null;

  constructor(
    private readonly service: Service,
    private readonly capture: Capture,
    private readonly options: JobOptions,
  ) {}

  /** Send the capture, and return the job. Throws Problem, Unreachable, or the signal's AbortError. */
  async send(progress: (sent: number) => void, signal: AbortSignal): Promise<Job> {
    try {
      await this.transfer(progress, signal);
      return await this.service.submitUpload(this.url!);
    } catch (error) {
      // If the service no longer has the upload, it is sent from the start.
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
        // Received bytes are deleted too, because the user has cancelled.
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

  /** Delete the upload from the service, which refuses the rest. */
  private giveUp(upload: TusUpload): void {
    void upload.abort(true).catch(() => undefined);
    this.url = null;
  }

  /** Return whether a repeated request may succeed. */
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
