// Whether a device keeps up with what it computes for a frame: looked at for the first seconds, then decided.
const ALLOWED_S = 1 / 30; // that a frame may take: more, and cloth is seen to stutter
const WATCHED_S = 3;
const LEAST_FRAMES = 12; // a decision of fewer would be one of chance

const median = (numbers) => [...numbers].sort((a, b) => a - b)[Math.floor(numbers.length / 2)];

export class Pace {
  // now: the clock [s].
  constructor({ now = () => performance.now() / 1000, allowedS = ALLOWED_S, watchedS = WATCHED_S } = {}) {
    Object.assign(this, { now, allowedS, watchedS });
    this.sinceS = null;
    this.begunS = 0;
    this.took = [];
    this.typicalS = null; // the median of the frames so far
    this.slow = null; // true or false, once it is decided
  }

  begin() {
    this.begunS = this.now();
    this.sinceS ??= this.begunS;
  }

  // A frame is done; says whether it was the one with which the device was found slow.
  end() {
    if (this.slow !== null) return false;
    const endedS = this.now();
    this.took.push(endedS - this.begunS);
    this.typicalS = median(this.took);
    if (endedS - this.sinceS < this.watchedS || this.took.length < LEAST_FRAMES) return false;
    this.slow = this.typicalS > this.allowedS;
    return this.slow;
  }
}
