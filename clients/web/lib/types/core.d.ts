/**
 * A refusal of the service or of this library. `name` is that of the refused value; the other texts say what was
 * expected, what came, and what cures it.
 */
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

/** How a service is reached. */
export interface Access {
  /** An API key, or a function that returns it. A page that others open must not hold one: see `ticket`. */
  key?: string | (() => string);
  /** Promises a fresh ticket, which your own server has asked the service for. */
  ticket?: () => Promise<string>;
  /** Is called in place of the page's own `fetch`. */
  fetch?: typeof globalThis.fetch;
  /**
   * Returns a new worker that imports "@drape/client/worker". Null, or a function that returns null: frames are decoded
   * on the page's own thread.
   */
  worker?: (() => Worker | null) | null;
}

/** The names of how much is computed, the least first. */
export type TierName = "instant" | "fast" | "balanced" | "accurate";
/** A fabric: an id of `Drape.fabrics`, or numbers by their names there. */
export type FabricChoice = string | Record<string, number>;

/**
 * Options for experts, by their names on the wire. Each one that is left out is chosen by the tier or by the service.
 */
export interface AdvancedOptions {
  /** How many corrections of the network run. */
  passes?: number;
  /** How many steps the solver of folds takes in a frame; 0: no folds. */
  folds?: number;
  /** Whether a coarse cloth takes the steps of folds. */
  coarse?: boolean;
  /** The least number of steps for a pose unlike those of training. */
  safe_folds?: number;
  /** The factor on the number of steps for a frame without a past. */
  settle?: number;
  /** Whether vertices are moved out of the body and of the garments below. */
  push_out?: boolean;
  /** Whether a garment keeps off itself and off the garments below it. */
  cloth_contact?: boolean;
  /** Where inertia comes from: the cloth's own mass, or the network. */
  inertia?: "mesh" | "network";
}

/**
 * Options of a drape by their names on the wire. An option that is left out is the service's choice. The options of
 * `AdvancedOptions` belong into `advanced`: release 0.1 is the last that takes them beside it.
 */
export interface DrapeOptions extends AdvancedOptions {
  /** Shape coefficients of the service's body, in standard deviations. */
  betas?: number[];
  tier?: TierName;
  /** One fabric for all garments, or one for each, the innermost first; null: the garment's own. */
  fabric?: FabricChoice | (FabricChoice | null)[];
  /** `set` replaces all of these at once. */
  advanced?: AdvancedOptions;
  /** How much inertia moves the cloth, 0 to 1. 0: each frame is the drape of its pose at rest. */
  motion?: number;
  /** Planes, boxes and capsules in the world [m], as docs/guide/options.md describes them. */
  colliders?: object[];
  /** Pixels of the picture to a metre of the garment. Below 100 less is computed. */
  pixels_per_m?: number;
}

/** Options of `Drape.wear`. Those that `DrapeOptions` lacks cannot be changed while a garment is worn. */
export interface WearOptions extends DrapeOptions {
  /** The id of a character that wears the garments: see `Drape.avatar`. */
  avatar?: string;
  /**
   * Whether the avatar also wears its own clothes as cloth, except those that the garments replace. The list of
   * garments may then be empty.
   */
  alive?: boolean;
  /** The form of frames; "jets" are posed patches, of which the page makes vertices. */
  geometry?: "vertices" | "jets";
  /**
   * Who computes folds. "client": this page, from jets; refused where it cannot. "auto": this page where it can and
   * keeps up, else the service.
   */
  folds_by?: "server" | "client" | "auto";
  /** The mesh: that of the garment's file, or the finer one that the service made of a coarse file. */
  resolution?: "delivered" | "fine";
  /** Ids of garments of this drape that are not shown. */
  hidden?: string[];
  /** One size for all garments, or one for each, the innermost first; null: M. */
  size?: SizeName | (SizeName | null)[];
}

export type SizeName = "S" | "M" | "L" | "XL";

/**
 * A size of a garment: its girths without stress [m] at chest, waist and hip, null where it does not go around, and its
 * length [m].
 */
export interface SizeInfo {
  size: SizeName;
  chest_m: number | null;
  waist_m: number | null;
  hip_m: number | null;
  length_m: number;
  /** The least and the greatest girth [m] of bodies that the size is cut for, by the measures that decide it. */
  cut_for: Record<string, [number, number]>;
}

/** A garment of the service. */
export interface GarmentInfo {
  /** The name that `Drape.wear` takes. */
  id: string;
  name: string;
  /** How many vertices and triangles its mesh has. */
  vertices: number;
  faces: number;
  source: "shipped" | "user";
  /** Its own fabric: an id of `Drape.fabrics`, or numbers. */
  fabric: string | Record<string, unknown>;
  /** The smallest first; empty where it has one size only. */
  sizes: SizeInfo[];
}

/** A fabric that a drape may name by `id`. */
export interface FabricInfo {
  id: string;
  /** Stiffness against stretch along warp and weft [N/m]. */
  warp_n_per_m: number;
  weft_n_per_m: number;
  /** Mass per area [kg/m2]. */
  density_kg_m2: number;
  thickness_m: number;
  /** Where its numbers are from. */
  source: string;
}

/** How much a tier computes. */
export interface TierInfo {
  id: TierName;
  /** Whether the service takes it where a drape names none. */
  default: boolean;
  /** Corrections of the network. */
  passes: number;
  /** Steps of folds. */
  folds: number;
}

/** A sample motion of the service, which `play` takes by `id`. */
export interface MotionInfo {
  id: string;
  name: string;
  frames: number;
  /** Frames a second. */
  fps: number;
}

/**
 * A motion with its numbers. `poses`: for each frame the rotation vectors [rad] of SMPL's 24 joints, as triples or as
 * 72 numbers. `trans`: for each frame the translation of the root [m].
 */
export interface Motion extends MotionInfo {
  poses: ArrayLike<number>[][] | ArrayLike<number>[];
  trans: ArrayLike<number>[];
}

/** The rotation vectors [rad] of SMPL's 24 joints, as triples or as 72 numbers. */
export type Pose = ArrayLike<number> | ArrayLike<number>[];

/** The pose of one moment, and the translation of the root [m], zero if left out. */
export interface Sample {
  poses: Pose;
  trans?: ArrayLike<number>;
}

/** Returns the pose at `timeS` seconds after `follow` was called; null: no pose this time. */
export type SourceFunction = (timeS: number) => Sample | null;

/** Where poses come from: `follow` calls `sample` with each picture of the page. */
export interface Source {
  sample: SourceFunction;
  /** Is called before the first sample. It may promise options, which the stream then takes. */
  begin?(drape: Drape, options: WearOptions): Promise<WearOptions | void>;
}

/** How a motion plays: `speed` is a factor, 1 if left out; `loop`, true if left out, begins again at the end. */
export interface PlayChoice {
  speed?: number;
  loop?: boolean;
}

/** Figures of something worn: counts since it was put on, and times of the frame that is shown. */
export interface Stats {
  /** Frames that were shown. */
  frames: number;
  /** Frames that came and were not decoded, since a newer one was there. */
  skipped: number;
  /** Poses that the service dropped, since a newer one was there. */
  dropped: number;
  /** From the sending of the pose to the showing of its frame [s]. */
  ageS: number;
  /** From the arrival of the pose at the service to the sending of its frame [s]. */
  residenceS: number;
  /** How long this page decoded the frame, with the folds if it computes them [s]. */
  hereS: number;
  /** The size of the frame's message. */
  bytes: number;
}

/**
 * The state of a stream. "waiting": the connection is lost and tried again. "refused": the service refuses what is
 * asked, and nothing is tried again.
 */
export type State = "opening" | "open" | "waiting" | "refused" | "closed";

/** The controls of something worn. */
export interface Controls {
  readonly stats: Stats;
  readonly state: State;
  /** Who computes folds now. */
  readonly foldsBy: "server" | "client";
  /** Sends one pose with the translation of the root [m], zero if left out. Returns whether the stream took it. */
  pose(poses: Pose, trans?: ArrayLike<number>): boolean;
  /**
   * Sends one pose of the avatar's own rig: the local quaternions of its nodes, x, y, z, w, in the order of
   * `AvatarInfo.nodes`, and the place of its pelvis's node [m], its rest place if left out. Returns whether the stream
   * took it; throws a `DrapeError` for another number of nodes.
   */
  rigPose(quaternions: ArrayLike<number> | ArrayLike<ArrayLike<number>>, place?: ArrayLike<number>): boolean;
  /** Takes poses from `source` from now on; null: from nowhere. Resolves once the source has begun. */
  follow(source: SourceFunction | Source | null): Promise<void>;
  /** Plays a motion of the service, by its id, or one of your own. Resolves once it has begun. */
  play(motion: string | Motion, choice?: PlayChoice): Promise<void>;
  /** Ends what `follow` or `play` began; the cloth stays as it is. */
  stop(): void;
  /** Drapes the garments in another fabric; the same as `set({ fabric })`. */
  fabric(name: DrapeOptions["fabric"]): Promise<void>;
  /** Changes options from now on. Rejects with the service's refusal, and then changes nothing. */
  set(options: DrapeOptions): Promise<void>;
}

/**
 * The mesh of one garment. Vertices at seams of the texture are copied behind all others, once for each further place
 * in the texture.
 */
export interface Layer {
  /** The garment's id. */
  id: string;
  /** The triangles: 3 indices each of vertices without copies. */
  faces: Uint32Array;
  /** The same triangles: 3 indices each into `positions`, with copies. */
  index: Uint32Array;
  /** Texture coordinates: 2 numbers for each vertex, copies included; null if the mesh has none. */
  uv: Float32Array | null;
  /** How many metres a unit of `uv` is; null without texture coordinates. */
  uvMetres: number | null;
  /** The number of vertices without copies. */
  vertexCount: number;
  /** The index of the copied vertex, for each copy. */
  copies: Uint32Array;
}

/** Garments that are worn, for any engine that draws. */
export interface Wearing extends Controls {
  /** The meshes of the garments that are shown, the innermost first. */
  readonly layers: Layer[];
  /**
   * For each layer 3 coordinates [m] a vertex, copies included, relative to `root`; overwritten by the next frame, null
   * before the first.
   */
  readonly positions: Float32Array[] | null;
  /** For each layer the unit normals of `positions`. */
  readonly normals: Float32Array[] | null;
  /** The place of the body's root joint in the world [m], in float64. */
  readonly root: number[];
  /** The pose, 72 numbers [rad], that the shown frame answers; null before the first, and for poses of a rig. */
  readonly bodyPose: ArrayLike<number> | null;
  /** Is called when positions, normals, root and body pose have changed. */
  onFrame: (wearing: Wearing) => void;
  /** Is called when the service begins to compute folds, since this device is too slow for them. */
  onFolds: () => void;
  /** Is called with each new state, and with the refusal behind "waiting" or "refused". */
  onState: (state: State, refusal: DrapeError | null) => void;
  /** Ends the stream. */
  close(): void;
}

/** A body at rest. */
export interface BodyInfo {
  id: string;
  /** The places of SMPL's 24 joints [m]. */
  joints: [number, number, number][];
  /** The height of its soles [m]. */
  floor_m: number;
}

/** A user's character that can wear garments. */
export interface AvatarInfo {
  id: string;
  /** The names of its nodes, by the names of SMPL's joints. */
  joints: Record<string, string>;
  /** How the joints were found: by VRM's bones, by names, by the places of the nodes, or as a correction says. */
  found_by: "vrm" | "names" | "shape" | "told";
  /** How much joints that were found by their places are like a person's, 0 to 1. */
  confidence: number;
  /** Sentences on what looks wrong with the character. */
  notes: string[];
  /** The names of its file's nodes, in the order of `rigPose`. */
  nodes: string[];
  /** The distance of its surface to the service's body in its shape [mm]: median, and 95th percentile. */
  fit: { median_mm: number; p95_mm: number };
  height_m: number;
  /** Metres in a unit of its file. */
  scale: number;
  /** The places of SMPL's 24 joints at rest [m], those of the body that stands for it. */
  rest_joints: [number, number, number][];
  /** The height of its soles at rest [m]. */
  floor_m: number;
  /**
   * Its own clothes as garments, the innermost first, with the parts of its file that they are; null where it was sent
   * without `alive`.
   */
  alive: { garment: string; kind: string; parts: string[] }[] | null;
  /** Why other clothes of its own move with its skin and not as cloth, by the names of the parts of its file. */
  stiff: Record<string, string>;
}

/** A service. Every promise rejects with its refusal, a `DrapeError`. */
export class Drape {
  /** The names of model and body, the greatest number of layers, and the version of the service. */
  readonly health: { model: string; body: string; layers: number; version: string };
  garments(): Promise<GarmentInfo[]>;
  fabrics(): Promise<FabricInfo[]>;
  /** The tiers, the one that computes least first. */
  tiers(): Promise<TierInfo[]>;
  motions(): Promise<MotionInfo[]>;
  /** The motion with this id, with the soles on the ground of the body in the shape `betas`, or of an avatar. */
  motion(name: string, betas?: number[], avatar?: string | null): Promise<Motion>;
  /** The service's body in the shape `betas` at rest, or the body that stands for an avatar. */
  body(betas?: number[], avatar?: string | null): Promise<BodyInfo>;
  avatars(): Promise<AvatarInfo[]>;
  /**
   * Sends a character, the bytes of a GLB or VRM, and promises its id once garments can be draped on it, in seconds.
   * `alive`: its own clothes become garments.
   */
  avatar(bytes: ArrayBuffer | Blob | Uint8Array<ArrayBuffer>, name?: string, choice?: { alive?: boolean }): Promise<string>;
  /**
   * Puts on a garment, or several over each other, the innermost first, by their ids. Resolves once the service has
   * opened the stream.
   */
  wear(garments: string | string[], options?: WearOptions): Promise<Wearing>;
  /** Takes off all that is worn. */
  close(): void;
}

/** The service at an address, once it has answered. */
export function connect(url: string, access?: Access): Promise<Drape>;
/** A source that plays a motion. */
export function clipSource(clip: Motion, choice?: PlayChoice): SourceFunction;

/** A point that a tracker has found [m]: three numbers, or an object like MediaPipe's; `visibility` is 0 to 1. */
export type KeyPoint = ArrayLike<number> | { x: number; y: number; z: number; visibility?: number };

/**
 * The poses of a person whom a tracker sees: call `shirt.follow(source)` once, then `source.put(points)` with each
 * picture.
 */
export interface LandmarkSource extends Source {
  /**
   * Takes the points of one person in a picture of the time `timeS` [s], by default now. `visibility`: that of each
   * point, 0 to 1, if the points have none.
   */
  put(points: ArrayLike<KeyPoint>, visibility?: ArrayLike<number>, timeS?: number): void;
}

/** How the points of a tracker are read. */
export interface LandmarkChoice {
  /** MediaPipe's 33 world landmarks in their own axes, or COCO's 17 points in ours. */
  layout?: "mediapipe" | "coco";
  /** The parameters of the One Euro filter that smooths poses; null: no filter. */
  smoothing?: { minCutoff?: number; beta?: number; dCutoff?: number } | null;
}

/** A source of poses from the points of a tracker. */
export function landmarkSource(choice?: LandmarkChoice): LandmarkSource;
