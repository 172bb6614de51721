// What the service's names mean, in words. A name that is not here is shown as it is.

import { Problem, Unreachable } from "../api/problem";
import type { Job } from "../api/types";
import { percent, timeLeft } from "./format";

const STATUS: Record<string, string> = {
  queued: "Waiting",
  running: "Running",
  succeeded: "Done",
  failed: "Failed",
  cancelled: "Cancelled",
};

const STEPS: Record<string, string> = {
  fetch: "Fetching the photographs",
  unpack: "Unpacking the archive",
  load: "Reading the photographs",
  cameras: "Finding the cameras",
  check: "Checking the photographs",
  start: "Finding where to start",
  train: "Training",
  export: "Writing the splats",
  render: "Rendering the held-back views",
  mesh: "Building the surface",
  evaluate: "Measuring the quality",
  report: "Writing the report",
  publish: "Storing the results",
};

const STAGES: Record<string, string> = {
  warmup_surfels: "flat Gaussians, warm-up",
  warmup_gaussians: "3D Gaussians, warm-up",
  alone: "one branch",
  mutual: "both branches teach each other",
  selection_off: "model selection: no reflections",
  selection_shared: "model selection: environment map",
  selection_both: "model selection: environment map and reflections",
  selection_own: "model selection: reflections",
  selection_degree_1: "model selection: simpler colours",
  selection_degree_0: "model selection: plain colours",
};

export const PRESETS: Record<string, string> = {
  draft: "A first look, fast",
  standard: "The balance for most captures",
  high: "More detail, takes longest",
};

/** The preset after a job's: after a draft the usual one, then the best; null after that. */
export function nextPreset(preset: string): string | null {
  const names = Object.keys(PRESETS);
  return names[names.indexOf(preset) + 1] ?? null;
}

const SEVERITIES: Record<string, string> = { error: "Error", warning: "Warning", note: "Note" };

export const METHODS: Record<string, string> = {
  mgsr: "Surface and light split (recommended)",
  "2dgs": "Flat Gaussians alone: surface, no light split",
  "3dgs": "3D Gaussians alone: for comparison",
};

export const PREVIEWS: Record<string, string> = {
  render: "Render",
  normals: "Surface normals",
  transmitted: "Own colour",
  reflected: "Reflections",
};

// What went wrong, by the stable code; the service's own sentence, with names and limits, is shown below it.
const TROUBLES: Record<string, string> = {
  key_unknown: "This API key is not known to the service.",
  host_refused: "The service does not answer under this address.",
  origin_refused: "The service does not take requests from this page.",
  job_unknown: "There is no such job. It may have been deleted, or belongs to another key.",
  job_ended: "The job has ended already.",
  job_open: "The job is still going on. Cancel it first.",
  not_retryable: "Trying again would not help here.",
  archive_gone: "The photographs of this job are gone. Send them again.",
  no_results: "The job has no results.",
  artifact_unknown: "The job has no such file.",
  not_yet: "That is not there yet.",
  range_outside: "The file is shorter than expected.",
  bad_options: "One of the options does not fit.",
  bad_request: "The service did not understand the request.",
  idempotency_conflict: "This upload was begun before with other content. Start it anew.",
  webhook_refused: "The service may not call this webhook address.",
  archive_missing: "Nothing was in the upload.",
  archive_too_large: "The archive is larger than the service takes.",
  archive_unsupported: "This is neither an archive (zip, tar, tar.gz, tar.zst) nor a video (mp4, mov, webm).",
  archive_damaged: "The archive is damaged. Pack it again.",
  archive_unsafe_member: "The archive has an entry that could leave its folder, so it was refused.",
  archive_too_many_members: "The archive has too many files.",
  archive_ratio: "The archive unpacks to suspiciously much.",
  image_too_large: "One of the images has too many pixels.",
  content_type_unsupported: "The service does not take this kind of file.",
  multipart_malformed: "The upload came through garbled. Send it again.",
  field_unknown: "The upload came with an unknown field.",
  options_too_large: "The options are too long.",
  upload_too_slow: "The upload was too slow, and was given up. Send it again.",
  upload_cut: "The connection ended during the upload. Send it again.",
  queue_full: "You have as many open jobs as the service allows. Wait for one to end.",
  disk_full: "The disk is full. Delete old jobs, or ask who runs the service.",
  store_unavailable: "The service can't reach its storage right now. Try again soon.",
  queue_unavailable: "The service can't reach its queue right now. Try again soon.",
  bad_scene: "The capture can't be used as it is.",
  bad_option: "One of the options does not fit this capture.",
  empty_mesh: "No surface came out of it.",
  training_failed: "Training came to nothing usable.",
  out_of_memory: "The job needed more memory than there is.",
  deadline_exceeded: "The job ran into its time limit. Retry goes on where it stopped.",
  crashed: "The job's program ended unexpectedly.",
  worker_lost: "The machines that worked on the job were lost.",
  internal: "A defect of MGSR ended the job. The log tells more.",
};

export const severityWord = (severity: string): string => SEVERITIES[severity] ?? severity;
export const statusWord = (status: string): string => STATUS[status] ?? status;
export const stageWord = (stage: string): string => STAGES[stage] ?? stage.replaceAll("_", " ");

/** What a code means; null for one that has no words. */
export function troubleWord(code: string): string | null {
  return TROUBLES[code] ?? null;
}

/** What a job does at the moment. */
export function activity(job: Job): string {
  if (job.cancelling) return "Stopping; a checkpoint is kept";
  if (job.status === "queued") return queueWord(job.queue_position);
  const step = job.step === null ? "Starting" : (STEPS[job.step] ?? job.message ?? job.step);
  if (job.step_progress !== null) return `${step}: ${percent(job.step_progress)}`;
  return job.step === "train" && job.stage !== null ? `${step}: ${stageWord(job.stage)}` : step;
}

/** How long it will take, `waited` seconds after the service said so; empty where nobody knows. */
export function remaining(job: Job, waited: number): string {
  if (job.eta_seconds !== null) return timeLeft(Math.max(0, job.eta_seconds - waited));
  if (job.step_eta_seconds === null) return "";
  return `this step: ${timeLeft(Math.max(0, job.step_eta_seconds - waited))}`;
}

function queueWord(position: number | null): string {
  if (position === null) return "Waiting for a worker";
  return position === 1 ? "Next in the queue" : `Number ${position} in the queue`;
}

/** An error as a headline, and the details if there are any. */
export function explain(error: unknown): { headline: string; detail: string | null } {
  if (error instanceof Unreachable) return { headline: "The service does not answer right now.", detail: null };
  if (error instanceof Problem) {
    const headline = troubleWord(error.code);
    if (headline === null) return { headline: error.detail, detail: null };
    // What the service says of a missing key is for programs.
    return { headline, detail: error.status === 401 ? null : error.detail };
  }
  return { headline: "The page has a defect; reloading it may help.", detail: String(error) };
}
