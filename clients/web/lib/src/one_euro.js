// The One Euro filter (Casiez, Roussel, Vogel, CHI 2012): little jitter while points rest, little lag while they move.
// A first-order low pass whose cut-off frequency [Hz] grows with the speed v: minCutoff + beta |v|; v is smoothed at dCutoff.
import { length, less } from "./turns.js";

const share = (cutoffHz, dtS) => 1 - 1 / (2 * Math.PI * cutoffHz * dtS + 1);

export class OneEuro {
  constructor({ minCutoff = 1, beta = 1, dCutoff = 1 } = {}) {
    Object.assign(this, { minCutoff, beta, dCutoff, last: null });
  }

  // The points (x, y, z of each), dtS after the last ones. One that is not seen, or was not before, comes out as it is.
  filter(points, dtS, seen) {
    const before = this.last;
    const now = points.map((point, at) => {
      const was = before?.[at];
      if (!was || !was.seen || !seen[at]) return { place: point, velocity: [0, 0, 0], seen: seen[at] };
      const ahead = less(point, was.place);
      const drag = share(this.dCutoff, dtS);
      const velocity = was.velocity.map((number, axis) => number + drag * (ahead[axis] / dtS - number));
      const part = share(this.minCutoff + this.beta * length(velocity), dtS);
      return { place: was.place.map((number, axis) => number + part * ahead[axis]), velocity, seen: true };
    });
    this.last = now;
    return now.map(({ place }) => place);
  }
}
