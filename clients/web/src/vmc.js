// Poses of a sender of VMC on this machine, by python -m clients.vmc, which only this page reaches.
import { LEG, PELVIS } from "../lib/src/humanoid.js";
import { say } from "./words.js";

export const VMC = "vmc"; // the id of this motion
const ADDRESS = "ws://127.0.0.1:39540";
const MISSING = "No sender of VMC is heard: start python -m clients.vmc on this machine, then choose VMC again.";

const distance = (a, b) => Math.hypot(...a.map((one, k) => one - b[k]));

export class Vmc {
  // motions: the list that it joins; where the program ends, onEnd().
  constructor(motions, onEnd) {
    Object.assign(this, { motions, onEnd });
    this.ending = null;
  }

  // Plays it; it joins the list with its first connection.
  async choose() {
    const { motions } = this;
    await motions.choose(VMC);
    if (motions.clip?.id === VMC && !motions.clips.some(({ id }) => id === VMC)) motions.offer([...motions.clips, { id: VMC, name: "VMC" }], VMC);
  }

  // The motion of whoever the sender tells of, on body { joints }: sample() gives the newest pose, end() stops it.
  async load({ joints }) {
    this.ending?.(); // that of another body
    const socket = new WebSocket(ADDRESS);
    await new Promise((resolve, reject) => {
      socket.addEventListener("open", resolve);
      socket.addEventListener("error", () => reject(new Error(MISSING)));
    });
    const [hip, knee, ankle] = LEG.map((joint) => joints[joint]);
    const legM = distance(hip, knee) + distance(knee, ankle);
    let newest = null;
    socket.addEventListener("message", ({ data }) => {
      const { poses, pelvis } = JSON.parse(data);
      newest = { poses, trans: pelvis.map((way, k) => way * legM - joints[PELVIS][k]) };
    });
    const lost = () => {
      say("python -m clients.vmc has ended.", { bad: true });
      this.onEnd();
    };
    socket.addEventListener("close", lost);
    this.ending = () => {
      socket.removeEventListener("close", lost);
      socket.close();
    };
    return { id: VMC, sample: () => newest, end: this.ending };
  }
}
