// The types of the service's answers, as in /openapi.json.

export type JobStatus = "queued" | "running" | "succeeded" | "failed" | "cancelled";

export interface CurvePoint {
  /** Seconds of training so far. */
  seconds: number;
  stage: string;
  iteration: number;
  loss: number | null;
  /** The PSNR on held-out views, in dB. */
  psnr: number | null;
}

export interface Failure {
  code: string;
  message: string;
  retryable: boolean;
  peak_memory_bytes: number | null;
}

/** A finding of the check of the photographs. */
export interface Finding {
  code: string;
  severity: "error" | "warning" | "note";
  text: string;
  amount: number;
  unit: string;
  cure: string;
  /** The affected photographs; empty if all are affected. */
  photographs: string[];
  /** Camera positions from which photographs are missing. */
  places: [number, number, number][];
}

/** The fields that change while a job runs. A progress event has some of them. */
export interface Progress {
  status: JobStatus;
  step: string | null;
  message: string | null;
  stage: string | null;
  iteration: number | null;
  total: number | null;
  progress: number;
  eta_seconds: number | null;
  /** The progress of the current step, if it is a long one before training. */
  step_progress: number | null;
  step_eta_seconds: number | null;
  training_seconds: number | null;
  losses: Record<string, number | null>;
  psnr: number | null;
  splats: Record<string, number>;
  /** The available pictures, each with its iteration of training. */
  previews: Record<string, number>;
  attempt: number | null;
  memory_bytes: number | null;
  /** The findings, worst first; null before the check. */
  findings: Finding[] | null;
}

export interface Job extends Progress {
  id: string;
  name: string | null;
  created: string;
  finished: string | null;
  cancelling: boolean;
  /** Whether the job is kept beyond the service's retention. */
  pinned: boolean;
  /** When the service deletes the job; null if it is kept. */
  expires: string | null;
  curve: CurvePoint[];
  queue_position: number | null;
  /** The job whose archive this job reuses. */
  rerun_of: string | null;
  round: number;
  error: Failure | null;
  metrics: Metrics;
  options: JobOptions;
}

/** The estimated cost of a run at a preset. */
export interface Estimate {
  preset: string;
  seconds: number;
  memory_mib: number;
}

/** The main figures of report.json. */
export interface Metrics {
  psnr_test?: number;
  ssim_test?: number;
  mesh?: { vertices?: number; faces?: number };
  gaussians?: Record<string, number>;
  seconds?: number | Record<string, number>;
  peak_memory_mib?: number;
  /** The estimates of a dry run, which has no other figures. */
  estimate?: Estimate[];
}

export type SettingValue = boolean | number | string | null;

export interface JobOptions {
  name?: string | null;
  preset?: string;
  method?: string;
  settings?: Record<string, SettingValue>;
  /** Further fields of the service's schema. */
  [other: string]: unknown;
}

export interface JobList {
  jobs: Job[];
  next: string | null;
}

export interface Artifact {
  name: string;
  size: number;
  sha256: string;
  content_type: string;
}

/** The part of JSON schema that settings use. */
export interface SettingSchema {
  type?: "boolean" | "integer" | "number" | "string" | "null";
  description?: string;
  enum?: string[];
  minimum?: number;
  maximum?: number;
  default?: SettingValue;
  anyOf?: SettingSchema[];
  /** The reference of a choice that is described elsewhere in the schema. */
  $ref?: string;
}

/** The JSON schema of a job's options. */
export interface OptionsSchema {
  properties: Record<string, SettingSchema>;
  $defs?: Record<string, SettingSchema>;
}

export interface Options {
  options: OptionsSchema;
  presets: Record<string, Record<string, string>>;
  methods: Record<string, Record<string, string>>;
  settings: Record<string, SettingSchema>;
  /** The largest size of an archive, in bytes. */
  max_upload: number;
}

export type Place = [number, number, number];

/** A checked photograph, and its camera in the capture's frame. */
export interface Photograph {
  name: string;
  center: Place;
  direction: Place;
  up: Place;
  /** The camera's horizontal and vertical field of view, in degrees. */
  angles: [number, number];
  residual: number | null;
  reprojection: number | null;
}

/** The checked photographs. A sheet holds pictures of them in squares, in the same order. */
export interface Photographs {
  tile: number;
  columns: number;
  masks: boolean;
  middle: Place;
  radius: number;
  photographs: Photograph[];
}
