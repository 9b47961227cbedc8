// What the person does: clips of the service and of the user's, played, paused, and looked through.
import { element, make, title } from "./words.js";

const SAVED_FPS = 30;
const STILL = matchMedia("(prefers-reduced-motion: reduce)");

export class Motions {
  // load(id): promises a clip with sample(timeS), fps and frames; one without frames is live: what is now, until its end().
  constructor({ load }) {
    this.load = load;
    this.clips = []; // { id, name }
    this.clip = null;
    this.timeS = 0;
    this.playing = !STILL.matches; // who asks for less motion begins with a still
    element("play").addEventListener("click", () => this.setPlaying(!this.playing));
    element("scrub").addEventListener("input", () => {
      this.setPlaying(false);
      this.timeS = Number(element("scrub").value) * this.lengthS;
    });
    this.setPlaying(this.playing);
  }

  get lengthS() {
    return this.clip?.frames ? this.clip.frames / this.clip.fps : 0;
  }

  setPlaying(playing) {
    this.playing = playing;
    element("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    element("play").dataset.playing = playing;
  }

  offer(clips, chosen = null) {
    this.clips = clips;
    const buttons = clips.map(({ id, name }) => {
      const chip = make("button", { type: "button", className: "option", textContent: title(name), "data-clip": id, "aria-pressed": id === chosen });
      chip.addEventListener("click", () => this.choose(id));
      return chip;
    });
    element("clips").replaceChildren(...buttons);
  }

  // Plays a clip from its beginning; the same one again goes on where it is, as for another body.
  async choose(id) {
    this.#press(id);
    this.wanted = id;
    const clip = await this.load(id);
    if (this.wanted !== id) {
      if (clip?.id !== this.wanted) clip?.end?.(); // another was chosen meanwhile
      return;
    }
    if (!clip) {
      if (this.clip) this.#press((this.wanted = this.clip.id)); // it could not be had, which was said
      return;
    }
    if (clip.id !== this.clip?.id) {
      this.timeS = 0;
      this.clip?.end?.();
    }
    this.clip = clip;
    for (const control of ["play", "scrub", "speed"]) element(control).disabled = !clip.frames;
  }

  #press(id) {
    for (const chip of element("clips").children) {
      chip.setAttribute("aria-pressed", chip.dataset.clip === id);
      if (chip.dataset.clip === id) element("clips").scrollLeft = chip.offsetLeft - element("clips").offsetLeft - 40;
    }
  }

  // The next one of the list, or the one before (-1).
  step(way) {
    const at = this.clips.findIndex(({ id }) => id === this.wanted);
    const next = this.clips.at((at + way) % this.clips.length);
    if (next) return this.choose(next.id);
    return null;
  }

  // The pose stepS seconds after the last one, or null.
  pose(stepS) {
    if (!this.clip?.frames) return this.clip?.sample() ?? null;
    if (this.playing) this.timeS = (this.timeS + stepS * Number(element("speed").value)) % this.lengthS;
    const scrub = element("scrub");
    if (document.activeElement !== scrub || this.playing) scrub.value = this.timeS / this.lengthS;
    return this.clip.sample(this.timeS);
  }
}

// What a request has of a clip: poses, trans and fps, of SAVED_FPS frames a second at most.
export function sampled(clip) {
  const stride = Math.max(1, Math.round(clip.fps / SAVED_FPS));
  const kept = Array.from({ length: Math.ceil(clip.frames / stride) }, (_, i) => clip.sample((stride * i + 0.5) / clip.fps));
  const poses = kept.map(({ poses: pose }) => Array.from({ length: 24 }, (_, joint) => Array.from(pose.slice(3 * joint, 3 * joint + 3))));
  return { poses, trans: kept.map(({ trans }) => Array.from(trans)), fps: clip.fps / stride };
}
