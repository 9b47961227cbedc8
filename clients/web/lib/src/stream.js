// The WebSocket: poses out, frames in, every frame acknowledged; comes back by itself after a lost connection, and goes
// on at the successor of a service that ends, with what the cloth remembers.
import { DrapeError } from "./errors.js";
import { KIND, SUBPROTOCOL, headerOf, kindOf, packAck, packPose, packRigPose } from "./wire.js";

const FIRST_RETRY_S = 0.5;
const LAST_RETRY_S = 8;
const KEPT_POSES = 256;
const CLOSEST_S = 1 / 240; // of poses that are answered here: who sends one for each frame waits for the service
const HELD_S = 0.2; // that poses are answered here; a service takes a longer pause (0.25 s) for the end of a motion
const now = () => performance.now() / 1000;

export class Stream {
  // onFrame({ header, data, pose, trans, bytes, ageS }), data: the FRAME or JETS, the same object as before where SAME
  // repeats it. onState(state, refusal): "open", "waiting" or "refused", with a DrapeError of the last two.
  // base: the service's address. ticket(): a promise of one for the next connection, empty where none is asked for.
  constructor({ onFrame, onState, ticket = async () => "", base = location.origin }) {
    this.ticket = ticket;
    this.given = ""; // a ticket that came with the word to move
    this.attempt = 0;
    this.onFrame = onFrame;
    this.onState = onState;
    this.request = null;
    this.socket = null;
    this.ready = false;
    this.opened = null; // what the service said of the last opening
    this.retryS = FIRST_RETRY_S;
    this.base = base; // where the stream runs
    this.state = []; // STATE messages, to be handed on as they came
    this.moved = false;
    this.sequence = 0;
    this.poses = new Map();
    this.shown = null; // the last frame, which SAME repeats for another pose
    this.still = null; // the pose that changes nothing: sent again, it is answered here
    this.sentS = -HELD_S; // when a pose was last sent, and given to send()
    this.askedS = 0;
  }

  // Asks for garments, shape and how to drape; on an open connection it turns to them at once.
  open(request) {
    this.request = request;
    this.poses.clear();
    this.still = null;
    this.ready = false;
    clearTimeout(this.timer);
    const { readyState } = this.socket ?? {};
    if (readyState === WebSocket.OPEN) this.#sendOpening();
    else if (readyState !== WebSocket.CONNECTING) this.#connect(); // else it opens with the new request
  }

  // Ends it; open() begins anew.
  close() {
    this.ready = false;
    this.attempt += 1;
    clearTimeout(this.timer);
    const { socket } = this;
    this.socket = null; // so that its end is nothing lost
    socket?.close();
  }

  // Sends a pose if the stream is open, and says whether it is; pose: 72 numbers, trans: 3. Of an avatar's own rig: four
  // numbers a node, x, y, z, w, and where its pelvis is, or no numbers for its rest.
  send(pose, trans, rig = false) {
    if (!this.ready) return false;
    this.sequence = (this.sequence + 1) >>> 0;
    const clientTimeS = now();
    const sinceS = clientTimeS - this.askedS;
    this.askedS = clientTimeS;
    // The next pose, as much later as this one was after the one before, must not come too late either.
    const inTime = sinceS > CLOSEST_S && sinceS < this.sentS + HELD_S - clientTimeS;
    if (this.still && inTime && sameNumbers(this.still, { pose, trans })) {
      const header = { ...this.shown.header, sequence: this.sequence, client_time_s: clientTimeS, residence_us: 0 };
      this.shown = { ...this.shown, header };
      this.onFrame({ ...this.shown, pose, trans, rig, bytes: 0, ageS: () => now() - clientTimeS });
      return true;
    }
    this.still = null;
    this.sentS = clientTimeS;
    this.poses.set(this.sequence, { pose, trans, rig });
    if (this.poses.size > KEPT_POSES) this.poses.delete(this.poses.keys().next().value);
    const stamp = { sequence: this.sequence, clientTimeS };
    const placed = trans.length ? trans : null;
    this.socket.send(rig ? packRigPose({ ...stamp, place: placed, quaternions: pose }) : packPose({ ...stamp, trans, pose }));
    return true;
  }

  #sendOpening() {
    this.unanswered += 1;
    for (const piece of this.state) this.socket.send(piece);
    this.state = [];
    this.socket.send(JSON.stringify({ type: "open", moves: true, same: true, ...this.request }));
  }

  async #connect() {
    this.socket?.close();
    this.socket = null;
    this.attempt += 1;
    const { attempt, given } = this;
    this.given = "";
    let ticket;
    try {
      ticket = given || (await this.ticket());
    } catch (error) {
      if (attempt !== this.attempt) return;
      this.refusal = error;
      this.#lost({ code: error.status === 401 ? 4401 : 1006 });
      return;
    }
    if (attempt !== this.attempt) return; // another opening was faster
    const address = `${this.base.replace(/^http/, "ws").replace(/\/$/, "")}/stream`;
    const socket = new WebSocket(address, ticket ? [SUBPROTOCOL, `ticket.${ticket}`] : [SUBPROTOCOL]);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.refusal = null;
    this.unanswered = 0; // openings; each has one answer, and the last one counts
    socket.onopen = () => this.#sendOpening();
    socket.onmessage = ({ data }) => this.#take(socket, data);
    socket.onclose = (event) => {
      if (socket === this.socket) this.#lost(event);
    };
  }

  #take(socket, data) {
    if (socket !== this.socket) return;
    if (typeof data === "string") {
      const message = JSON.parse(data);
      if (message.type === "error") this.refusal = new DrapeError(message);
      if (message.type === "moved") {
        this.moved = true;
        this.base = message.to || this.base;
        this.given = message.ticket ?? "";
      }
      if (message.type === "opened") this.unanswered -= 1;
      if (message.type === "opened" && this.unanswered === 0) {
        this.ready = true;
        this.opened = message;
        this.retryS = FIRST_RETRY_S;
        this.onState("open", null);
      }
      return;
    }
    if (kindOf(data) === KIND.STATE) {
      this.state.push(data);
      return;
    }
    const frame = this.#headed(data);
    this.shown = frame;
    if (kindOf(data) !== KIND.SAME) socket.send(packAck(frame.header.sequence));
    const sent = this.poses.get(frame.header.sequence);
    if (!sent || !this.ready) return; // of an earlier opening
    if (kindOf(data) === KIND.SAME && frame.header.sequence === this.sequence) this.still = copied(sent);
    for (const key of this.poses.keys()) {
      if (key >= frame.header.sequence) break;
      this.poses.delete(key);
    }
    this.onFrame({ ...frame, ...sent, bytes: data.byteLength, ageS: () => now() - frame.header.client_time_s });
  }

  #headed(data) {
    const header = headerOf(data);
    if (kindOf(data) !== KIND.SAME) return { header, data };
    const { sequence, client_time_s, server_time_s, dropped, residence_us } = header;
    const { shown } = this;
    return { ...shown, header: { ...shown.header, sequence, client_time_s, server_time_s, dropped, residence_us } };
  }

  #lost(event) {
    this.ready = false;
    if (this.moved) {
      this.moved = false;
      this.#connect();
      return;
    }
    const refusal = this.refusal ?? lost(event);
    this.refusal = null;
    // 44xx is our fault or the user's: trying again would be refused again. 4408 is a pause.
    if (event.code >= 4400 && event.code < 4500 && event.code !== 4408) {
      this.onState("refused", refusal);
      return;
    }
    this.onState("waiting", refusal);
    this.timer = setTimeout(() => this.#connect(), this.retryS * 1000);
    this.retryS = Math.min(2 * this.retryS, LAST_RETRY_S);
  }
}

const lost = ({ code, reason }) => {
  const detail = reason || "The connection is lost; trying again.";
  const words = { name: "stream", expected: "an open connection", got: `its end (${code})`, cure: "It is tried again." };
  return new DrapeError({ ...words, detail, kind: "Unavailable" });
};

export const copied = ({ pose, trans }) => ({ pose: Float32Array.from(pose), trans: Float32Array.from(trans) });

// Whether two poses are the same in the bytes that are sent.
export function sameNumbers(one, other) {
  const equal = (numbers, others) =>
    numbers.length === others.length && numbers.every((number, k) => number === Math.fround(others[k]));
  return equal(one.pose, other.pose) && equal(one.trans, other.trans);
}
