// The service's API. Every method throws Problem, Unreachable, or the AbortError of its signal.

import { Connection } from "./connection";
import { Problem, Unreachable, isAbort, readProblem } from "./problem";
import { pieces } from "./stream";
import type { Artifact, Job, JobList, JobOptions, Options, Photographs } from "./types";

const KEY = "mgsr-key";

export class Service extends EventTarget {
  readonly connection = new Connection();

  /** The API key, which lasts as long as the browser tab. */
  get key(): string | null {
    return sessionStorage.getItem(KEY);
  }

  set key(value: string | null) {
    if (value === null) sessionStorage.removeItem(KEY);
    else sessionStorage.setItem(KEY, value);
  }

  /** The headers that identify the caller. */
  get credentials(): Record<string, string> {
    return this.key === null ? {} : { Authorization: `Bearer ${this.key}` };
  }

  /** Send a request and return the answer. Throws for errors. A refused key also dispatches the event `key`. */
  async request(path: string, init: RequestInit = {}): Promise<Response> {
    const answer = await this.send(path, init);
    if (answer.ok || answer.status === 304) return answer;
    const problem = readProblem(answer.status, await answer.text());
    this.refused(problem);
    throw problem;
  }

  /** Report a problem of a request that did not go through this class. */
  refused(problem: Problem): void {
    if (problem.status === 401) this.dispatchEvent(new CustomEvent("key", { detail: problem }));
  }

  options(): Promise<Options> {
    return this.json("/options");
  }

  jobs(limit: number): Promise<JobList> {
    return this.json(`/jobs?limit=${limit}`);
  }

  /** Make a job of a complete upload, which has the job's options. A repeated call returns the same job. */
  async submitUpload(url: string): Promise<Job> {
    const answer = await this.request(`${new URL(url, location.href).pathname}/job`, { method: "POST" });
    return (await answer.json()) as Job;
  }

  async cancel(job: string): Promise<void> {
    await this.request(`/jobs/${job}`, { method: "DELETE" });
  }

  async retry(job: string): Promise<void> {
    await this.request(`/jobs/${job}/retry`, { method: "POST" });
  }

  /** Start a new job from the archive of another with changed options, and return its id. */
  async rerun(job: string, options: JobOptions): Promise<string> {
    const query = encodeURIComponent(JSON.stringify(options));
    const answer = await this.request(`/jobs/${job}/rerun?options=${query}`, { method: "POST" });
    return ((await answer.json()) as Job).id;
  }

  /** Pin a job, so that it is kept beyond the service's retention, or unpin it. */
  async pin(job: string, pinned: boolean): Promise<Job> {
    return (await this.request(`/jobs/${job}/pin`, { method: pinned ? "PUT" : "DELETE" })).json() as Promise<Job>;
  }

  async remove(job: string): Promise<void> {
    await this.request(`/jobs/${job}/data`, { method: "DELETE" });
  }

  async artifacts(job: string): Promise<Artifact[]> {
    return (await this.json<{ artifacts: Artifact[] }>(`/jobs/${job}/artifacts`)).artifacts;
  }

  /** Get a result file. The service itself sends it, as the page may not connect to the bucket behind it. */
  async file(job: string, artifact: Artifact, progress?: (share: number) => void): Promise<Blob> {
    const name = artifact.name.split("/").map(encodeURIComponent).join("/");
    const answer = await this.request(`/jobs/${job}/artifacts/${name}?redirect=false`);
    const chunks: Uint8Array<ArrayBuffer>[] = [];
    let received = 0;
    try {
      for await (const chunk of pieces(answer.body!)) {
        chunks.push(chunk);
        received += chunk.length;
        progress?.(received / artifact.size);
      }
    } catch {
      throw this.unreachable();
    }
    return new Blob(chunks, { type: artifact.content_type });
  }

  /** Get a preview of a job in training with its version, or null if the version is still the given one. */
  async preview(job: string, name: string, version: string): Promise<{ picture: Blob; version: string } | null> {
    const answer = await this.request(`/jobs/${job}/previews/${name}.webp`, { headers: { "If-None-Match": version } });
    if (answer.status === 304) return null;
    return { picture: await answer.blob(), version: answer.headers.get("ETag") ?? "" };
  }

  /** Get the checked photographs of a job, with their cameras. */
  photographs(job: string): Promise<Photographs> {
    return this.json(`/jobs/${job}/photographs`);
  }

  /** Get the sheet of small pictures of these photographs, or of their masks. */
  async sheet(job: string, name: "photographs" | "masks"): Promise<Blob> {
    return (await this.request(`/jobs/${job}/previews/${name}.webp`)).blob();
  }

  async log(job: string): Promise<string> {
    return (await this.request(`/jobs/${job}/log.txt`)).text();
  }

  private async json<T>(path: string): Promise<T> {
    return (await this.request(path)).json() as Promise<T>;
  }

  private async send(path: string, init: RequestInit): Promise<Response> {
    try {
      return await fetch(path, { ...init, headers: { ...this.credentials, ...init.headers }, cache: "no-store" });
    } catch (error) {
      if (isAbort(error)) throw error;
      throw this.unreachable();
    }
  }

  private unreachable(): Unreachable {
    this.connection.lost();
    return new Unreachable();
  }
}
