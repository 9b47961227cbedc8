// Poses of whoever stands before the camera, by a tracker that the user brings. It runs in a frame of its own
// (tracker.html), which gets the pictures and gives points: so foreign code sees neither this page nor the service.
import { landmarkSource } from "../lib/src/landmarks.js";
import { element, make } from "./words.js";

const SIZE = { width: 640, height: 480 };
const LATEST_MS = 20_000; // for a tracker to load
const DENIED = "The browser may not use the camera here. Allow it beside the address, then choose Camera again.";
const WORDS = {
  NotAllowedError: DENIED,
  SecurityError: DENIED,
  NotFoundError: "There is no camera at this machine. Plug one in, then choose Camera again.",
  OverconstrainedError: "There is no camera at this machine. Plug one in, then choose Camera again.",
  NotReadableError: "The camera is taken by another program. Close that, then choose Camera again.",
};

// What is said of a camera that does not come.
export const refusalOf = (error) => WORDS[error.name] ?? `The camera does not start: ${error.message}`;

export class Camera {
  // onWords(sentence, bad): what is to be said, "" for nothing more. Where the tracker ends, onEnd().
  constructor({ onWords, onEnd }) {
    Object.assign(this, { onWords, onEnd });
    this.frame = this.video = this.source = null;
    addEventListener("message", ({ data, source }) => source === this.frame?.contentWindow && this.#told(data));
  }

  // Loads the tracker of the files that the user chose, in place of the one before; rejects in words.
  async take(files) {
    this.stop();
    this.frame?.remove();
    const read = Promise.all(Array.from(files, async (file) => ({ name: file.name, bytes: await file.arrayBuffer() })));
    this.frame = make("iframe", { id: "camera", src: "tracker.html", title: "Your camera", sandbox: "allow-scripts", hidden: true });
    const loaded = this.#answer();
    this.files = read; // sent when the frame is ready
    document.body.append(this.frame);
    try {
      await loaded;
    } catch (error) {
      this.frame.remove();
      this.frame = null;
      throw error;
    }
  }

  #answer() {
    return new Promise((resolve, reject) => {
      const late = setTimeout(() => reject(new Error("The tracker does not load.")), LATEST_MS);
      this.settle = (failure) => {
        clearTimeout(late);
        this.settle = null;
        if (failure) reject(new Error(`The tracker does not load: ${failure}`));
        else resolve();
      };
    });
  }

  get ready() {
    return this.frame !== null;
  }

  // The motion of whoever is seen, on the body or avatar of options: sample() gives the newest pose, end() stops it.
  async motion(drape, options) {
    const source = landmarkSource();
    await source.begin(drape, options);
    if (!this.video) this.video = await this.#look();
    this.source = source;
    this.frame.hidden = false;
    this.onWords("Stand back until your hips and feet are in the picture.", false);
    this.#show(this.video);
    return { sample: () => this.source?.sample() ?? null, end: () => this.stop() };
  }

  async #look() {
    if (!navigator.mediaDevices?.getUserMedia) throw new Error("A browser shows its camera to pages by https and of this machine only.");
    let stream;
    try {
      stream = await navigator.mediaDevices.getUserMedia({ video: SIZE });
    } catch (error) {
      throw new Error(refusalOf(error));
    }
    const video = make("video", { muted: true, playsInline: true, srcObject: stream });
    await video.play();
    return video;
  }

  // Sends the frame a picture; the next one goes when it has been seen.
  async #show(video) {
    if (video !== this.video || video.readyState < HTMLMediaElement.HAVE_CURRENT_DATA) return;
    const picture = await createImageBitmap(video);
    if (video === this.video) this.frame.contentWindow.postMessage({ picture }, "*", [picture]);
  }

  async #told(data) {
    const { frame } = this;
    if (data.ready) {
      const files = await this.files;
      if (frame === this.frame) frame.contentWindow.postMessage({ files }, "*");
    } else if (data.loaded) this.settle?.();
    else if (data.seen && this.video) requestAnimationFrame(() => this.video && this.#show(this.video));
    else if (data.failed && this.settle) this.settle(data.failed);
    else if (data.failed && this.source) {
      this.onWords(`The tracker ended: ${data.failed}`, true);
      this.onEnd();
    } else if (data.points) this.#put(data);
  }

  #put({ points, visibility }) {
    try {
      this.source?.put(points, visibility);
      this.onWords("", false);
    } catch (error) {
      this.onWords(error.message, true);
    }
  }

  // Lets go of the camera; the tracker stays for the next time.
  stop() {
    for (const track of this.video?.srcObject.getTracks() ?? []) track.stop();
    this.video = this.source = null;
    if (this.frame) this.frame.hidden = true;
    if (this.ready) this.onWords("", false);
  }
}

// The dialog in which the tracker is chosen; onFiles(files) takes what was chosen.
export function makeDoor(onFiles) {
  const door = element("camera-door");
  const input = element("tracker-files");
  input.addEventListener("change", () => {
    const files = [...input.files];
    input.value = ""; // so that the same ones can be chosen again
    door.close();
    if (files.length) onFiles(files);
  });
  return door;
}
