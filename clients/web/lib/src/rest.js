// REST calls. A refusal of the service is thrown as a DrapeError.
import { DrapeError } from "./errors.js";

const TICKET_S = 30; // for which a ticket is used again; the service takes it for 60 s

// A query of what is given.
const queried = (fields) => new URLSearchParams(Object.entries(fields).filter(([, value]) => value !== null && value !== undefined));
const shapeOf = (betas, avatar) => (avatar === null ? `betas=${betas.join(",")}` : `avatar=${encodeURIComponent(avatar)}`);

const wornOf = (garments, sizes) =>
  queried({ garments: garments.join(","), size: sizes.some(Boolean) ? sizes.map((one) => one ?? "").join(",") : null });

export class Rest {
  // base: the service's address. key: its text, or a function that says it. ticket: a function that promises a fresh
  // ticket, for pages that must not have the key. fetch: asks in place of the page's own.
  constructor(base, { key = "", ticket = null, fetch = (...asked) => globalThis.fetch(...asked) } = {}) {
    this.base = base.replace(/\/$/, "");
    this.key = typeof key === "function" ? key : () => key;
    this.freshTicket = ticket;
    this.fetch = fetch;
    this.lastTicket = { ticket: "", sinceS: -Infinity };
  }

  async #bearer() {
    if (this.key() || !this.freshTicket) return this.key();
    const nowS = performance.now() / 1000;
    if (nowS - this.lastTicket.sinceS > TICKET_S) this.lastTicket = { ticket: await this.freshTicket(), sinceS: nowS };
    return this.lastTicket.ticket;
  }

  async request(path, options = {}) {
    const bearer = await this.#bearer();
    const headers = bearer ? { ...options.headers, Authorization: `Bearer ${bearer}` } : options.headers;
    let response;
    try {
      response = await this.fetch(this.base + path, { ...options, headers });
    } catch {
      throw new DrapeError(this.#unanswered());
    }
    if (response.ok) return response;
    let document = null;
    try {
      document = await response.json();
    } catch {
      // Not a problem document: the status has to do.
    }
    const got = `${response.status} ${response.statusText}`;
    const own = { name: path, expected: "an answer", got, cure: "Try again later.", detail: document?.detail ?? got };
    throw new DrapeError({ ...own, ...document, status: response.status });
  }

  // A browser hides from a page why another origin did not answer.
  #unanswered() {
    const origin = globalThis.location?.origin;
    const foreign = origin && origin !== "null" && this.base && new URL(this.base, origin).origin !== origin;
    const allowed = foreign ? ` Does its DRAPE_ALLOWED_ORIGINS name ${origin}?` : "";
    const cure = `Is it still running?${allowed}`;
    const words = { name: "service", expected: "an answer", got: "none", cure, kind: "Unavailable" };
    return { ...words, detail: `The service does not answer. ${cure}` };
  }

  async json(path, options) {
    return (await this.request(path, options)).json();
  }

  async #bytes(path, kind = "application/octet-stream") {
    return (await this.request(path, { headers: { Accept: kind } })).arrayBuffer();
  }

  // A ticket for a stream, which can send no header and spends it; empty where no key is asked for.
  async ticket() {
    if (this.key()) return (await this.json("/tickets", { method: "POST" })).ticket;
    return this.freshTicket ? this.freshTicket() : "";
  }

  health() {
    return this.json("/health");
  }

  garments() {
    return this.json("/garments");
  }

  garment(id) {
    return this.json(`/garments/${encodeURIComponent(id)}`);
  }

  fabrics() {
    return this.json("/fabrics");
  }

  tiers() {
    return this.json("/tiers");
  }

  motions() {
    return this.json("/motions");
  }

  motion(id, betas = [], avatar = null) {
    return this.json(`/motions/${encodeURIComponent(id)}?${shapeOf(betas, avatar)}`);
  }

  avatars() {
    return this.json("/avatars");
  }

  avatar(id) {
    return this.json(`/avatars/${encodeURIComponent(id)}`);
  }

  // Faces of an avatar that lie under garments, marginM from hems and what is bare; sizes: of each, null for the usual one.
  covered(id, garments, sizes = [], marginM = null) {
    const margin = marginM === null ? "" : `&margin_m=${marginM}`;
    return this.json(`/avatars/${encodeURIComponent(id)}/covered?${wornOf(garments, sizes)}${margin}`);
  }

  // Skin of an avatar that is bare where garments take off clothes of its own: a GLB on its nodes.
  bare(id, garments, sizes = []) {
    return this.#bytes(`/avatars/${encodeURIComponent(id)}/bare?${wornOf(garments, sizes)}`, "model/gltf-binary");
  }

  // Sends a character, the bytes of a GLB or VRM; the answer is the job.
  sendAvatar(bytes, name, alive = false) {
    const headers = { "Content-Type": "application/octet-stream" };
    return this.json(`/avatars?${new URLSearchParams({ name, alive })}`, { method: "POST", body: bytes, headers });
  }

  job(id) {
    return this.json(`/jobs/${encodeURIComponent(id)}`);
  }

  // Meshes of a garment and of a body, as meshes.js reads them.
  garmentMesh(id, { resolution = "delivered", size = null } = {}) {
    return this.#bytes(`/garments/${encodeURIComponent(id)}/mesh?${queried({ resolution, size })}`);
  }

  // How its materials look, and which faces have which; and a picture of theirs, PNG or JPEG.
  garmentLooks(id, { resolution = "delivered" } = {}) {
    return this.json(`/garments/${encodeURIComponent(id)}/looks?${queried({ resolution })}`);
  }

  async garmentTexture(id, number) {
    return (await this.request(`/garments/${encodeURIComponent(id)}/textures/${number}`)).blob();
  }

  jetLayout(id, { resolution = "delivered", avatar = null, size = null } = {}) {
    const path = `/garments/${encodeURIComponent(id)}/jets?${queried({ resolution, avatar, size })}`;
    return this.#bytes(path);
  }

  // The size of a garment that the body in the shape betas takes, and why in words.
  size(id, betas = []) {
    return this.json(`/garments/${encodeURIComponent(id)}/size?betas=${betas.join(",")}`);
  }

  // What a client needs to make the folds of a garment in a fabric (a name or numbers) on a body or an avatar.
  // coarse: whether a coarse cloth takes their steps, as the answer to its opening says; drawn: whether the mesh that hangs
  // on it comes too.
  foldConstants(id, { fabric = null, betas = [], resolution = "delivered", avatar = null, size = null, coarse = false, drawn = false } = {}) {
    const made = fabric === null || typeof fabric === "string" ? fabric : JSON.stringify(fabric);
    const asked = queried({ resolution, fabric: made, betas: betas.length ? betas.join(",") : null, avatar, size, coarse, drawn });
    return this.#bytes(`/garments/${encodeURIComponent(id)}/folds?${asked}`);
  }

  // Measures [m, kg] of a body in the shape betas, and what it can have of each.
  measures(id, betas = []) {
    return this.json(`/bodies/${encodeURIComponent(id)}/measures?betas=${betas.join(",")}`);
  }

  // The shape that has the measures asked for, by their names: chest_m and so on.
  shape(id, asked) {
    return this.#post(`/bodies/${encodeURIComponent(id)}/shapes`, asked);
  }

  // Where a garment is tight or loose; asked: betas, pose, fabric, size, vertices.
  fit(id, asked = {}) {
    return this.#post(`/garments/${encodeURIComponent(id)}/fit`, asked);
  }

  #post(path, document) {
    return this.json(path, { method: "POST", body: JSON.stringify(document), headers: { "Content-Type": "application/json" } });
  }

  // The address of a picture of the service as a page may show it: with a key it is fetched, as an image sends none.
  async picture(path) {
    if (!this.key() && !this.freshTicket) return this.base + path;
    return URL.createObjectURL(await (await this.request(path)).blob());
  }

  // Rest joints and height of the soles of a body in the shape betas.
  body(id, betas = []) {
    return this.json(`/bodies/${encodeURIComponent(id)}?betas=${betas.join(",")}`);
  }

  bodyFile(id, betas = []) {
    return this.#bytes(`/bodies/${encodeURIComponent(id)}/mesh?betas=${betas.join(",")}`);
  }
}
