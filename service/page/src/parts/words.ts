// Words for the service's names. A name without words is shown as it is.

import { Problem, Unreachable } from "../api/problem";
import type { Job } from "../api/types";
import { moment, percent, timeLeft } from "./format";

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
  learned_masks: "Learning the silhouettes",
  start: "Building the first surface",
  exposures: "Comparing the exposures",
  object: "Looking for the object",
  background: "Training the background",
  plan: "Planning the training",
  train: "Training",
  export: "Writing the splats",
  render: "Rendering the held-out views",
  mesh: "Extracting the mesh",
  evaluate: "Scoring the surface",
  model: "Texturing the model",
  report: "Writing the report",
  publish: "Storing the results",
};

const STAGES: Record<string, string> = {
  warmup_surfels: "surfels, warm-up",
  warmup_gaussians: "Gaussians, warm-up",
  alone: "one branch alone",
  mutual: "both branches teach each other",
  finish: "the branch that renders",
  selection_off: "model selection: no reflections",
  selection_shared: "model selection: environment map",
  selection_both: "model selection: environment map and reflections",
  selection_own: "model selection: reflections",
  selection_degree_1: "model selection: SH degree 1",
  selection_degree_0: "model selection: SH degree 0",
};

export const PRESETS: Record<string, string> = {
  draft: "A fast first look",
  standard: "The balance for most captures",
  high: "The most detail, the longest time",
};

/** Return the preset above a job's: standard after draft, then high; null after that. */
export function nextPreset(preset: string): string | null {
  const names = Object.keys(PRESETS);
  return names[names.indexOf(preset) + 1] ?? null;
}

const SEVERITIES: Record<string, string> = { error: "Error", warning: "Warning", note: "Note" };

export const METHODS: Record<string, string> = {
  mgsr: "Both branches: surface and light split (recommended)",
  "2dgs": "Surfels alone: a surface without light split",
  "3dgs": "Gaussians alone, for comparison",
};

export const PREVIEWS: Record<string, string> = {
  render: "Render",
  normals: "Surface normals",
  transmitted: "Own colour",
  reflected: "Reflections",
};

// Sentences for errors, by their stable codes. The service's own sentence, with names and limits, is shown below them.
const TROUBLES: Record<string, string> = {
  key_unknown: "The service does not know this API key.",
  host_refused: "The service does not answer at this address.",
  origin_refused: "The service does not accept requests from this page.",
  job_unknown: "This job does not exist. Someone may have deleted it, or it belongs to another key.",
  job_ended: "The job has already ended.",
  job_open: "The job is still running. Cancel it first.",
  not_retryable: "A retry would fail in the same way.",
  archive_gone: "The photographs of this job are gone. Send them again.",
  no_results: "The job has no results.",
  artifact_unknown: "The job does not have this file.",
  not_yet: "This file does not exist yet.",
  range_outside: "The file is shorter than expected.",
  bad_options: "One of the options is invalid.",
  bad_request: "The service did not understand the request.",
  idempotency_conflict: "An upload with this key had other content. Start the upload again.",
  webhook_refused: "The service must not call this webhook address.",
  archive_missing: "The upload was empty.",
  archive_too_large: "The archive exceeds the service's size limit.",
  archive_unsupported: "This file is neither an archive (zip, tar, tar.gz, tar.zst) nor a video (mp4, mov, webm).",
  archive_damaged: "The archive is damaged. Create it again.",
  archive_unsafe_member: "The archive has an unsafe entry, so the service refused it.",
  archive_too_many_members: "The archive has too many files.",
  archive_ratio: "The archive would unpack to a suspicious size.",
  image_too_large: "One of the images has too many pixels.",
  content_type_unsupported: "The service does not accept this type of file.",
  multipart_malformed: "The upload arrived damaged. Send it again.",
  field_unknown: "The upload has an unknown field.",
  options_too_large: "The options are too long.",
  upload_too_slow: "The upload was too slow, so the service stopped it. Send it again.",
  upload_unknown: "The service no longer has this upload. Send it again.",
  upload_expired: "The upload has expired. Send it again.",
  upload_incomplete: "Not all of the upload has arrived. Send it again.",
  upload_offset: "The service has another part of the upload. Send it again.",
  upload_too_long: "The file has changed during the upload. Send it again.",
  checksum_unsupported: "The service does not know this kind of checksum.",
  checksum_mismatch: "The upload arrived damaged. Send it again.",
  tus_version: "The service expects another version of this page. Reload it.",
  upload_cut: "The connection broke during the upload. Send it again.",
  queue_full: "You have reached the limit of open jobs. Wait until one ends.",
  storage_full: "Your jobs would take more space than you have. Delete old ones.",
  disk_full: "The disk is full. Delete old jobs, or ask the administrator of the service.",
  store_unavailable: "The service cannot reach its storage. Try again soon.",
  queue_unavailable: "The service cannot reach its queue. Try again soon.",
  bad_scene: "MGSR cannot use this capture.",
  bad_option: "One of the options does not suit this capture.",
  empty_mesh: "The reconstruction has no surface.",
  training_failed: "Training failed.",
  out_of_memory: "The job needed more memory than it may use.",
  deadline_exceeded: "The job exceeded its time limit. A retry continues where it stopped.",
  crashed: "The job's process ended unexpectedly.",
  worker_lost: "The workers of this job were killed.",
  internal: "A bug in MGSR ended the job. The log has details.",
};

export const severityWord = (severity: string): string => SEVERITIES[severity] ?? severity;
export const statusWord = (status: string): string => STATUS[status] ?? status;
export const stageWord = (stage: string): string => STAGES[stage] ?? stage.replaceAll("_", " ");

/** Return the sentence for a code, or null if there is none. */
export function troubleWord(code: string): string | null {
  return TROUBLES[code] ?? null;
}

/** Return the current activity of a job. */
export function activity(job: Job): string {
  if (job.cancelling) return "Stopping after a checkpoint";
  if (job.status === "queued") return queueWord(job.queue_position);
  const step = job.step === null ? "Starting" : (STEPS[job.step] ?? job.message ?? job.step);
  if (job.step_progress !== null) return `${step}: ${percent(job.step_progress)}`;
  return job.step === "train" && job.stage !== null ? `${step}: ${stageWord(job.stage)}` : step;
}

/** Return the time left, `waited` seconds after the service's estimate; empty if it is unknown. */
export function remaining(job: Job, waited: number): string {
  if (job.eta_seconds !== null) return timeLeft(Math.max(0, job.eta_seconds - waited));
  if (job.step_eta_seconds === null) return "";
  return `for this step: ${timeLeft(Math.max(0, job.step_eta_seconds - waited))}`;
}

/** Return how long a job is kept; empty if there is no limit. */
export function stayWord(job: Job): string {
  if (job.pinned) return "kept";
  return job.expires === null ? "" : `will be deleted ${moment(job.expires)}`;
}

function queueWord(position: number | null): string {
  if (position === null) return "Waiting for a worker";
  return position === 1 ? "Next in the queue" : `Number ${position} in the queue`;
}

/** Return a headline for an error, and its details if there are any. */
export function explain(error: unknown): { headline: string; detail: string | null } {
  if (error instanceof Unreachable) return { headline: "The service does not answer.", detail: null };
  if (error instanceof Problem) {
    const headline = troubleWord(error.code);
    if (headline === null) return { headline: error.detail, detail: null };
    // The service's sentence on a missing key is for programs.
    return { headline, detail: error.status === 401 ? null : error.detail };
  }
  return { headline: "This page has a bug. Reload it.", detail: String(error) };
}
