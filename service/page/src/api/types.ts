// What the service sends, as /openapi.json describes it.

export type JobStatus = "queued" | "running" | "succeeded" | "failed" | "cancelled";

export interface CurvePoint {
  /** Of training, so far. */
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

/** One thing that the check of the photographs found. */
export interface Finding {
  code: string;
  severity: "error" | "warning" | "note";
  text: string;
  amount: number;
  unit: string;
  cure: string;
  /** Those concerned; empty if it is all of them. */
  photographs: string[];
  /** Camera positions from which photographs are missing. */
  places: [number, number, number][];
}

/** What changes while a job runs: a progress event carries some of these. */
export interface Progress {
  status: JobStatus;
  step: string | null;
  message: string | null;
  stage: string | null;
  iteration: number | null;
  total: number | null;
  progress: number;
  eta_seconds: number | null;
  /** Of the step alone, where it is long and comes before training. */
  step_progress: number | null;
  step_eta_seconds: number | null;
  training_seconds: number | null;
  losses: Record<string, number | null>;
  psnr: number | null;
  splats: Record<string, number>;
  /** Each picture that there is, and after how many iterations of training it was made. */
  previews: Record<string, number>;
  attempt: number | null;
  memory_bytes: number | null;
  /** The worst first; null before the check. */
  findings: Finding[] | null;
}

export interface Job extends Progress {
  id: string;
  name: string | null;
  created: string;
  finished: string | null;
  cancelling: boolean;
  /** Whether it stays after the service's retention. */
  pinned: boolean;
  /** When the service deletes it; null where it stays. */
  expires: string | null;
  curve: CurvePoint[];
  queue_position: number | null;
  /** The job whose archive this one took over. */
  rerun_of: string | null;
  round: number;
  error: Failure | null;
  metrics: Metrics;
  options: JobOptions;
}

/** What a run at a preset is expected to take. */
export interface Estimate {
  preset: string;
  seconds: number;
  memory_mib: number;
}

/** The headline figures of report.json. */
export interface Metrics {
  psnr_test?: number;
  ssim_test?: number;
  mesh?: { vertices?: number; faces?: number };
  gaussians?: Record<string, number>;
  seconds?: number | Record<string, number>;
  peak_memory_mib?: number;
  /** Of a dry run, which has no other figures. */
  estimate?: Estimate[];
}

export type SettingValue = boolean | number | string | null;

export interface JobOptions {
  name?: string | null;
  preset?: string;
  method?: string;
  settings?: Record<string, SettingValue>;
  /** What else the service's schema has. */
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
  /** Of a choice that is described elsewhere in the schema. */
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
  /** The most bytes of an archive. */
  max_upload: number;
}

export type Place = [number, number, number];

/** A photograph that was checked, and its camera in the capture's frame. */
export interface Photograph {
  name: string;
  center: Place;
  direction: Place;
  up: Place;
  /** Degrees that the camera sees across and down. */
  angles: [number, number];
  residual: number | null;
  reprojection: number | null;
}

/** The photographs that were checked; pictures of them lie in a sheet, in their order, in squares. */
export interface Photographs {
  tile: number;
  columns: number;
  masks: boolean;
  middle: Place;
  radius: number;
  photographs: Photograph[];
}
