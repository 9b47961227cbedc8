/** A refusal as the service says it: the value's name, what was expected, what came, and what cures it. */
export class DrapeError extends Error {
  readonly name: string;
  readonly expected: string;
  readonly got: string;
  readonly cure: string;
  /** The class of the refusal: "NotFound", "InputError", "Busy", ... */
  readonly kind: string;
  /** HTTP status; 0 where there was no answer. */
  readonly status: number;
}

export interface Access {
  /** An API key. A page must not hold one: see `ticket`. */
  key?: string | (() => string);
  /** Gives a fresh ticket, which your own server asks the service for. */
  ticket?: () => Promise<string>;
  /** Asks in place of the page's own `fetch`. */
  fetch?: typeof globalThis.fetch;
  /** Makes a worker that imports "@drape/client/worker"; null: decode on the page's own thread. */
  worker?: (() => Worker | null) | null;
}

export type TierName = "instant" | "fast" | "balanced" | "accurate";
export type FabricChoice = string | Record<string, number>;

/** What a tier and the service choose for most, by its names on the wire. */
export interface AdvancedOptions {
  passes?: number;
  folds?: number;
  coarse?: boolean;
  safe_folds?: number;
  settle?: number;
  push_out?: boolean;
  cloth_contact?: boolean;
  inertia?: "mesh" | "network";
}

/**
 * Options of a drape by their names on the wire; what is left out is the service's choice. Those of `AdvancedOptions`
 * beside `advanced` are deprecated: release 0.1 is the last that takes them there.
 */
export interface DrapeOptions extends AdvancedOptions {
  betas?: number[];
  tier?: TierName;
  fabric?: FabricChoice | (FabricChoice | null)[];
  /** `set` takes the place of all of it. */
  advanced?: AdvancedOptions;
  /** 0 as if at rest, 1 in full. */
  motion?: number;
  hidden?: string[];
  colliders?: object[];
  pixels_per_m?: number;
}

/** What stays as it is for as long as a garment is worn. */
export interface WearOptions extends DrapeOptions {
  /** The id of a character that wears it: see `Drape.avatar`. */
  avatar?: string;
  /** Whether that also wears its own clothes as cloth, but for those that the garments replace; none needs to be named. */
  alive?: boolean;
  geometry?: "vertices" | "jets";
  /** Who makes the folds. "client": here, of jets, and refused where that cannot be; "auto": here where it can be. */
  folds_by?: "server" | "client" | "auto";
  resolution?: "delivered" | "fine";
  /** Of all garments that are worn, or of each, the innermost first (null: M). */
  size?: SizeName | (SizeName | null)[];
}

export type SizeName = "S" | "M" | "L" | "XL";

/** A size of a garment: girths without stress at the levels that it goes around, and its length. */
export interface SizeInfo {
  size: SizeName;
  chest_m: number | null;
  waist_m: number | null;
  hip_m: number | null;
  length_m: number;
  /** Least and greatest girth [m] of bodies that it is cut for, at the levels that decide. */
  cut_for: Record<string, [number, number]>;
}

export interface GarmentInfo {
  id: string;
  name: string;
  vertices: number;
  faces: number;
  source: "shipped" | "user";
  fabric: string | Record<string, unknown>;
  /** The smallest first; none where it comes in one. */
  sizes: SizeInfo[];
}

export interface FabricInfo {
  id: string;
  warp_n_per_m: number;
  weft_n_per_m: number;
  density_kg_m2: number;
  thickness_m: number;
  source: string;
}

export interface TierInfo {
  id: TierName;
  default: boolean;
  passes: number;
  folds: number;
}

export interface MotionInfo {
  id: string;
  name: string;
  frames: number;
  fps: number;
}

/** 24 rotation vectors [rad] by frame and joint, translations of the root [m] by frame. */
export interface Motion extends MotionInfo {
  poses: ArrayLike<number>[][] | ArrayLike<number>[];
  trans: ArrayLike<number>[];
}

/** 24 rotation vectors [rad], as triples or as 72 numbers. */
export type Pose = ArrayLike<number> | ArrayLike<number>[];

export interface Sample {
  poses: Pose;
  trans?: ArrayLike<number>;
}

/** Gives the pose of a moment, counted from when it is followed; null: none this time. */
export type SourceFunction = (timeS: number) => Sample | null;

export interface Source {
  sample: SourceFunction;
  /** Called before the first sample; may promise options that its stream is opened with. */
  begin?(drape: Drape, options: WearOptions): Promise<WearOptions | void>;
}

export interface PlayChoice {
  speed?: number;
  loop?: boolean;
}

export interface Stats {
  frames: number;
  /** Frames that came and were not decoded, as a newer one was there. */
  skipped: number;
  /** Poses that the service dropped, as a newer one was there. */
  dropped: number;
  /** From sending the pose to showing its frame. */
  ageS: number;
  residenceS: number;
  /** What decoding it took here, with the folds where they are made here. */
  hereS: number;
  bytes: number;
}

export type State = "opening" | "open" | "waiting" | "refused" | "closed";

export interface Controls {
  readonly stats: Stats;
  readonly state: State;
  /** Who makes the folds now. */
  readonly foldsBy: "server" | "client";
  /** Sends one pose, and says whether the stream took it. */
  pose(poses: Pose, trans?: ArrayLike<number>): boolean;
  /** One pose of the avatar's own rig: x, y, z, w of each of its nodes, and where that of its pelvis is [m]. */
  rigPose(quaternions: ArrayLike<number> | ArrayLike<ArrayLike<number>>, place?: ArrayLike<number>): boolean;
  follow(source: SourceFunction | Source | null): Promise<void>;
  /** Plays a motion of the service by name, or numbers of your own. */
  play(motion: string | Motion, choice?: PlayChoice): Promise<void>;
  stop(): void;
  fabric(name: DrapeOptions["fabric"]): Promise<void>;
  /** Drapes otherwise from now on; rejects what the service refuses, and stays as it was. */
  set(options: DrapeOptions): Promise<void>;
}

export interface Layer {
  id: string;
  /** 3 vertices a triangle, of the delivered mesh. */
  faces: Uint32Array;
  /** The same triangles of `positions`, where vertices at seams of the texture come twice. */
  index: Uint32Array;
  uv: Float32Array | null;
  /** Metres of a unit of `uv`; null without any. */
  uvMetres: number | null;
  vertexCount: number;
  /** The vertices that come again behind all others. */
  copies: Uint32Array;
}

/** What is worn, for any engine. */
export interface Wearing extends Controls {
  readonly layers: Layer[];
  /** By layer, from `root` [m]; valid until the next frame. */
  readonly positions: Float32Array[] | null;
  readonly normals: Float32Array[] | null;
  /** Place of the body's root [m], for which float32 would be too coarse far away. */
  readonly root: number[];
  readonly bodyPose: ArrayLike<number> | null;
  onFrame: (wearing: Wearing) => void;
  /** The service makes the folds from now on, as this device is too slow for them. */
  onFolds: () => void;
  onState: (state: State, refusal: DrapeError | null) => void;
  close(): void;
}

export interface BodyInfo {
  id: string;
  joints: [number, number, number][];
  floor_m: number;
}

/** A user's character that wears garments: which of its nodes is which joint, and how well our body fits it. */
export interface AvatarInfo {
  id: string;
  joints: Record<string, string>;
  /** Whether VRM's bones, names, the places of the joints or a correction told these, and how sure that is, to 1. */
  found_by: "vrm" | "names" | "shape" | "told";
  confidence: number;
  notes: string[];
  /** The nodes of its file: the order of a pose of its own rig. */
  nodes: string[];
  fit: { median_mm: number; p95_mm: number };
  height_m: number;
  /** Metres per unit of its file. */
  scale: number;
  rest_joints: [number, number, number][];
  floor_m: number;
  /** Its own clothes as garments, the innermost first; null where it was sent without `alive`. */
  alive: { garment: string; kind: string; parts: string[] }[] | null;
  /** Why other clothes stay on its skin, by the names of its parts. */
  stiff: Record<string, string>;
}

export class Drape {
  readonly health: { model: string; body: string; layers: number; version: string };
  garments(): Promise<GarmentInfo[]>;
  fabrics(): Promise<FabricInfo[]>;
  tiers(): Promise<TierInfo[]>;
  motions(): Promise<MotionInfo[]>;
  motion(name: string, betas?: number[], avatar?: string | null): Promise<Motion>;
  body(betas?: number[], avatar?: string | null): Promise<BodyInfo>;
  avatars(): Promise<AvatarInfo[]>;
  /** Sends a character, the bytes of a GLB or VRM, and gives its id when garments can be cut for it; takes seconds. */
  avatar(bytes: ArrayBuffer | Blob | Uint8Array<ArrayBuffer>, name?: string, choice?: { alive?: boolean }): Promise<string>;
  wear(garments: string | string[], options?: WearOptions): Promise<Wearing>;
  close(): void;
}

export function connect(url: string, access?: Access): Promise<Drape>;
export function clipSource(clip: Motion, choice?: PlayChoice): SourceFunction;

/** A point of a tracker [m]: three numbers, or an object as MediaPipe gives it. */
export type KeyPoint = ArrayLike<number> | { x: number; y: number; z: number; visibility?: number };

/** Follows whoever a tracker sees: `shirt.follow(source)`, then `source.put(points)` with each picture. */
export interface LandmarkSource extends Source {
  /** The points of one person in a picture taken at `timeS`; `visibility` of each from 0 to 1, if the points do not tell it. */
  put(points: ArrayLike<KeyPoint>, visibility?: ArrayLike<number>, timeS?: number): void;
}

export interface LandmarkChoice {
  /** MediaPipe's 33 world landmarks in their own axes, or COCO's 17 points in ours. */
  layout?: "mediapipe" | "coco";
  /** Numbers of the One Euro filter; null: none. */
  smoothing?: { minCutoff?: number; beta?: number; dCutoff?: number } | null;
}

export function landmarkSource(choice?: LandmarkChoice): LandmarkSource;
