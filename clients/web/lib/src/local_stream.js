// In place of a stream: poses go on to the decoder at once, which drapes them here.
import { DrapeError } from "./errors.js";
import { copied, sameNumbers } from "./stream.js";
import { packPose } from "./wire.js";

const STILL_S = 2; // of one pose, until cloth has come to rest (drape/stages/encode.py)
const STILL_FRAMES = 30;
// What may be chosen anew; all else is in the network and the constants.
const FREE = ["folds", "safe_folds", "settle", "cloth_contact", "push_out", "motion"];
const now = () => performance.now() / 1000;

export class LocalStream {
  // about: of the folder; onFrame, onState: as Stream takes them.
  constructor(about, { onFrame, onState }) {
    this.about = about;
    this.onFrame = onFrame;
    this.onState = onState;
    this.opened = null;
    this.ready = false;
    this.sequence = 0;
    this.last = null; // pose, trans and message; since when [s], and how often
  }

  open({ garment, garments, advanced, ...asked }) {
    const { options, opened } = this.about;
    const own = { ...options, ...options.advanced, garment: this.about.garment, geometry: "jets", folds_by: "client", resolution: "fine", tier: opened.tier, passes: opened.passes };
    const chosen = Object.entries({ garment: garments ?? garment, ...asked, ...advanced }).filter(([name, value]) => value !== undefined && (value !== null || name === "fabric"));
    const other = chosen.find(([name, value]) => !FREE.includes(name) && JSON.stringify(value) !== JSON.stringify(own[name] ?? null)); // no fabric: the garment's own
    if (other) {
      const [name, value] = other;
      const words = { name, expected: JSON.stringify(own[name]) ?? "nothing", got: JSON.stringify(value), kind: "InputError" };
      this.ready = false;
      this.onState("refused", new DrapeError({ ...words, cure: "This folder drapes one garment in one way: write another, or connect to a service." }));
      return;
    }
    const free = Object.fromEntries(chosen.filter(([name]) => FREE.includes(name)));
    const safe_folds = Math.max(free.folds ?? 0, free.safe_folds ?? (free.folds === undefined ? opened.safe_folds : 0));
    const coarse = opened.coarse && free.folds !== 0; // as the service has it
    this.opened = { ...opened, ...free, safe_folds, coarse, ...(free.push_out === false ? { clearance_m: 0 } : {}) };
    this.last = null;
    this.ready = true;
    this.onState("open", null);
  }

  send(pose, trans, rig = false) {
    if (!this.ready || rig) return false;
    this.sequence = (this.sequence + 1) >>> 0;
    const clientTimeS = now();
    const { sequence, last } = this;
    const still = last !== null && sameNumbers(last, { pose, trans });
    const { sinceS, frames } = still ? last : { sinceS: clientTimeS, frames: 0 };
    const holds = frames >= STILL_FRAMES && clientTimeS - sinceS >= STILL_S;
    const data = holds ? last.data : packPose({ sequence, clientTimeS, trans, pose });
    this.last = { ...copied({ pose, trans }), data, sinceS, frames: frames + 1 };
    const root = this.about.joints[0].map((x, a) => x + trans[a]);
    const header = { sequence, client_time_s: clientTimeS, server_time_s: Date.now() / 1000, root, dropped: 0, residence_us: 0, flags: 0 };
    this.onFrame({ header, data, pose, trans, rig, bytes: 0, ageS: () => now() - clientTimeS });
    return true;
  }

  close() {
    this.ready = false;
  }
}
