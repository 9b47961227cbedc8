// Who wore a garment that was uploaded: what was found in its cloth, others that are as likely, and what a hand says instead.
import { element, make } from "./words.js";

const SURE = 0.5; // from here on nobody is asked
const SHOULDERS = [16, 17]; // joints of a pose, left and right
const COLLARS = [13, 14];
const ARM_JOINTS = [...COLLARS, ...SHOULDERS, 18, 19, 20, 21];
const CHOICES = ["unit", "up", "facing", "body", "arms"];

// The avatar for POST /garments that says, as a JSON text, what chosen names: { unit, up, facing, body, arms }, "" for what is
// as it was found. found: the answer's wearer, or null.
export function avatarOf({ body, arms, ...reading }, found = null) {
  const told = Object.fromEntries(Object.entries(reading).filter(([, value]) => value));
  const named = body === "standard" ? { betas: [] } : body ? JSON.parse(body) : null;
  const known = found ? JSON.parse(found.options.avatar) : {};
  if (!named && !arms) return Object.keys(told).length ? JSON.stringify(told) : "";
  const who = named ?? { ...known, ...told };
  if (!arms || (named && !("betas" in named))) return JSON.stringify({ ...who, ...told }); // a phenotype has a pose of its own
  return JSON.stringify({ ...who, ...told, pose: withArms(who.pose, (Number(arms) * Math.PI) / 180) });
}

// A pose of 72 numbers whose arms hang so far below the horizontal [rad].
function withArms(pose = Array(72).fill(0), down = 0) {
  const posed = pose.slice();
  for (const joint of ARM_JOINTS) posed.fill(0, 3 * joint, 3 * joint + 3);
  SHOULDERS.forEach((joint, right) => (posed[3 * joint + 2] = right ? down : -down)); // about the axis to the front
  return posed;
}

export class WearerCard {
  // onChoose(upload, options): the garment is wanted on another body; options: fields of POST /garments.
  constructor({ onChoose }) {
    this.onChoose = onChoose;
    this.upload = null;
    element("wearer-open").addEventListener("click", () => this.show(true));
    element("wearer-close").addEventListener("click", () => this.show(false));
    element("wearer-again").addEventListener("click", () => this.#choose({ avatar: avatarOf(this.#said(), this.upload.wearer) }));
    for (const choice of element("modelled-on").options) if (choice.value) element("wearer-body").append(choice.cloneNode(true));
    const changed = () => (element("wearer-again").disabled = !Object.values(this.#said()).some(Boolean));
    for (const name of CHOICES) element(`wearer-${name}`).addEventListener("change", changed);
  }

  show(shown) {
    element("wearer-card").hidden = !shown;
  }

  #said() {
    return Object.fromEntries(CHOICES.map((name) => [name, element(`wearer-${name}`).value]));
  }

  #choose(options) {
    this.show(false);
    this.onChoose(this.upload, options);
  }

  // upload: { name, wearer, said, ... }: wearer null where nobody was found; said the avatar that a hand chose, "" for none.
  // Nobody is asked where it is sure, or was told.
  tell(upload, { asked = false } = {}) {
    this.upload = upload;
    const { name, wearer, said } = upload;
    const all = wearer ? [wearer, ...wearer.others] : [];
    element("wearer-open").hidden = false;
    element("wearer-file").textContent = name;
    for (const choice of CHOICES) element(`wearer-${choice}`).value = "";
    element("wearer-again").disabled = true;
    element("wearer-arms").disabled = !wearer;
    const found = ["Nobody was looked for in it.", `It seems made for ${wearer?.words}, ${sureness(wearer)}.`, "It fits more than one person. Which one is it?"];
    const words = asked ? "It does not go on a body. Say what you know of it:" : said ? "It is worn as you said." : found[Math.min(all.length, 2)];
    element("wearer-words").textContent = words;
    element("wearer-choices").replaceChildren(...all.map((one, number) => this.#choice(one, said ? one.options.avatar === said : number === 0)));
    element("wearer-more").open = asked;
    this.show(asked || (!said && (all.length > 1 || (wearer !== null && wearer.sure < SURE))));
  }

  #choice({ words, picture, sure, options }, worn) {
    const drawn = picture ? [make("img", { alt: "", src: `data:image/png;base64,${picture}`, width: 224, height: 224 })] : []; // none of old garments
    const told = make("span", { className: "words", children: [make("b", { textContent: worn ? "Worn now" : "This one" }), make("small", { textContent: `${words}; ${sureness({ sure })}` })] });
    const card = make("button", { type: "button", className: "card", "aria-pressed": worn, children: [...drawn, told] });
    card.addEventListener("click", () => (worn ? this.show(false) : this.#choose(options)));
    return card;
  }
}

const sureness = (wearer) => `${Math.round(100 * (wearer?.sure ?? 0))} % sure`;
