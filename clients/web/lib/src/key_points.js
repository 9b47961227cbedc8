// Key points of a person in space, by name: MediaPipe's 33 world landmarks, or COCO's 17 points.
import { DrapeError } from "./errors.js";
import { across, cross, length, less, mean, ofColumns, times } from "./turns.js";

const VISIBLE = 0.5; // a point that is less visible is not believed
const LEAST_LENGTH_M = 1e-3; // points so close have no direction
const LEAST_SINE = 1e-2; // lines so nearly parallel span no frame

const bothSides = (left) =>
  Object.fromEntries(Object.entries(left).flatMap(([name, at]) => [[`left_${name}`, at], [`right_${name}`, at + 1]]));

// Which point is which, and the signs that turn their axes into ours: MediaPipe's y points down, its z away from the camera.
export const LAYOUTS = {
  mediapipe: {
    count: 33,
    signs: [1, -1, -1],
    index: { nose: 0, ...bothSides({ ear: 7, shoulder: 11, elbow: 13, wrist: 15, hip: 23, knee: 25, ankle: 27, heel: 29, toe: 31 }) },
  },
  coco: {
    count: 17,
    signs: [1, 1, 1],
    index: { nose: 0, ...bothSides({ ear: 3, shoulder: 5, elbow: 7, wrist: 9, hip: 11, knee: 13, ankle: 15 }) },
  },
};

export function refuse(name, expected, got, cure) {
  throw new DrapeError({ name, expected, got, cure, kind: "MotionError" });
}

export function checkLayout(layout) {
  if (!LAYOUTS[layout]) refuse("layout", Object.keys(LAYOUTS).join(" or "), String(layout), "Name the order of the points.");
}

// Points as a tracker gives them, x, y, z of each in triples or as objects, and whether each is seen. visibility: a number
// for each from 0 to 1; left out, that of the objects.
export function checkedPoints(points, visibility, layout) {
  const triple = (one) => (Array.isArray(one) || ArrayBuffer.isView(one) ? Array.from(one) : [one.x, one.y, one.z]);
  const places = Array.from(points, triple);
  const shares = Array.from(visibility ?? Array.from(points, (one) => one.visibility ?? 1));
  const { count } = LAYOUTS[layout];
  if (places.length !== count || shares.length !== count) {
    refuse("landmarks", `${count} points of ${layout}`, `${places.length} and ${shares.length} visibilities`, "Send one person.");
  }
  if (!places.every((one) => one.length === 3 && one.every(Number.isFinite)) || !shares.every(Number.isFinite)) {
    refuse("landmarks", "finite numbers, three a point", "others", "Give points that were not found a visibility of 0.");
  }
  return { places, seen: shares.map((share) => share >= VISIBLE) };
}

// Points [m] in our axes by name, each with whether it is seen.
export class KeyPoints {
  constructor(named, label = "landmarks") {
    this.named = named;
    this.label = label;
  }

  // Checked points, as checkedPoints gives them, in our axes.
  static of({ places, seen }, layout) {
    const { index, signs } = LAYOUTS[layout];
    const entries = Object.entries(index).map(([name, at]) => {
      return [name, { place: places[at].map((number, axis) => number * signs[axis]), seen: seen[at] }];
    });
    return new KeyPoints(Object.fromEntries(entries));
  }

  has(name) {
    return name in this.named;
  }

  sees(...names) {
    return names.every((name) => this.named[name].seen);
  }

  place(name) {
    return this.named[name].place;
  }

  // These points and the middles of some, seen where all of those are.
  withMiddles(middles) {
    const named = { ...this.named };
    for (const [name, parts] of Object.entries(middles)) {
      named[name] = { place: mean(parts.map((part) => this.place(part))), seen: this.sees(...parts) };
    }
    return new KeyPoints(named, this.label);
  }

  // The unit vector from one point to another.
  line(start, end) {
    const way = less(this.place(end), this.place(start));
    const far = length(way);
    if (far >= LEAST_LENGTH_M) return times(1 / far, way);
    if (this.sees(start, end)) {
      refuse(this.label, `${start} and ${end} apart`, "one place", "Give points that were not found a visibility of 0.");
    }
    return way;
  }

  // The rotation with x along the unit vector left and z in the half plane of ahead; of: the points that span it.
  frame(left, ahead, of) {
    const aside = across(ahead, left);
    const sine = length(aside);
    const flat = sine < LEAST_SINE;
    if (flat && this.sees(...of)) {
      refuse(this.label, `${of.join(", ")} off one line`, "all on a line", "Give points that were not found a visibility of 0.");
    }
    const forward = flat ? aside : times(1 / sine, aside);
    return ofColumns(left, cross(forward, left), forward);
  }
}
