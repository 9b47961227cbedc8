// Without a service: a folder with one garment (python -m service.static), draped on the page.
import { Drape, DrapeError } from "./index.js";
import { filesOf } from "./files.js";
import { LocalStream } from "./local_stream.js";

const FORMAT = 3;
const GIVEN = { folds_by: "client", geometry: "jets", resolution: "fine" };

// The worker's script as text, which build.mjs puts in.
/* global LOCAL_WORKER_TEXT */
function inlineWorker() {
  const address = URL.createObjectURL(new Blob([LOCAL_WORKER_TEXT], { type: "text/javascript" }));
  return new Worker(address, { type: "module" });
}

class LocalDrape extends Drape {
  constructor(folder, { worker = inlineWorker }) {
    super(folder.base, { worker: () => this.#begun(worker()) });
    this.folder = folder;
    this.computing = null; // promises { warmMs } of what was put on last
    this.rest.request = (path) => this.#answer(path); // all that a service would be asked for
  }

  makeStream(heard) {
    return new LocalStream(this.folder.about, heard);
  }

  async engine() {
    const { about, file } = this.folder;
    return WebAssembly.compile(await file(about.engine));
  }

  // The garment as soon as its network is ready. Options are those of the folder, but for how it folds.
  async wear(garments, options = {}) {
    const shirt = await super.wear(garments, { ...this.folder.about.options, ...options, ...GIVEN });
    try {
      await this.computing;
    } catch (error) {
      shirt.dispose();
      throw error;
    }
    return shirt;
  }

  #begun(worker) {
    const { base, about } = this.folder;
    const { port1, port2 } = new MessageChannel();
    this.computing = new Promise((resolve, reject) => {
      port1.onmessage = ({ data }) => (data.error ? reject(new DrapeError({ name: "network", ...data.error, detail: data.error.message })) : resolve(data));
      worker.addEventListener("error", (event) => reject(new DrapeError({ name: "worker", detail: event.message || "The worker did not load." })));
    });
    worker.postMessage({ base, about, port: port2 }, [port2]);
    return worker;
  }

  async #answer(path) {
    const { about, file } = this.folder;
    const [name] = decodeURI(path).split("?");
    if (about.answers[name]) return new Response(await file(about.answers[name]));
    const expected = Object.keys(about.answers).join(", ");
    throw new DrapeError({ name: "folder", expected: `one of ${expected}`, got: name, cure: "Write another folder, or connect to a service.", kind: "NotFound" });
  }
}

// A Drape, as connect() gives it, of the folder at an address. worker: a function that gives a module worker of "@drape/client/local-worker", where a page may have none from a blob.
export async function openFolder(address = "./", options = {}) {
  const base = new URL(address.endsWith("/") ? address : `${address}/`, globalThis.location?.href).href;
  const file = filesOf(base);
  const about = JSON.parse(new TextDecoder().decode(await file("about.json")));
  if (about.format !== FORMAT) {
    const words = { name: "about.json", expected: `format ${FORMAT}`, got: `${about.format}`, kind: "ArtifactError" };
    throw new DrapeError({ ...words, cure: "Write the folder again with this version." });
  }
  return new LocalDrape({ base, about, file }, options).open();
}
