// REST calls. A refusal of the service is thrown as an Error whose message is its sentence, with its status.

const KEPT = "drape-key"; // until the tab closes
export const key = () => sessionStorage.getItem(KEPT) ?? "";
export const setKey = (said) => sessionStorage.setItem(KEPT, said);

async function request(path, options = {}) {
  let response;
  const headers = key() ? { ...options.headers, Authorization: `Bearer ${key()}` } : options.headers;
  try {
    response = await fetch(path, { ...options, headers });
  } catch {
    throw new Error("The service does not answer. Is it still running?");
  }
  if (response.ok) return response;
  let sentence = `${response.status} ${response.statusText}`;
  try {
    sentence = (await response.json()).detail ?? sentence;
  } catch {
    // Not a problem document: the status has to do.
  }
  throw Object.assign(new Error(sentence), { status: response.status });
}

const json = async (path, options) => (await request(path, options)).json();

// A ticket for a stream, which can send no header; empty where no key is asked for.
export const ticket = async () => (key() ? (await json("/tickets", { method: "POST" })).ticket : "");

export const health = () => json("/health");
export const garments = () => json("/garments");
export const fabrics = () => json("/fabrics");
export const tiers = () => json("/tiers");
export const motions = () => json("/motions");
export const motion = (id, betas) => json(`/motions/${encodeURIComponent(id)}?betas=${betas.join(",")}`);
export const garmentMesh = (id, resolution) =>
  json(`/garments/${encodeURIComponent(id)}/mesh?resolution=${resolution}`, { headers: { Accept: "application/json" } });

export async function jetLayout(id, resolution) {
  const path = `/garments/${encodeURIComponent(id)}/jets?resolution=${resolution}`;
  return (await request(path, { headers: { Accept: "application/octet-stream" } })).arrayBuffer();
}

export async function bodyFile(id, betas) {
  const path = `/bodies/${encodeURIComponent(id)}/mesh?betas=${betas.join(",")}`;
  return (await request(path, { headers: { Accept: "model/gltf-binary" } })).arrayBuffer();
}

export async function clipFile(document) {
  const headers = { Accept: "model/gltf-binary", "Content-Type": "application/json" };
  return (await request("/drape", { method: "POST", headers, body: JSON.stringify(document) })).blob();
}

// Uploads a garment file and waits for its job; returns the new id. onJob(job) is told where it is; signal: an AbortSignal
// that ends it there too.
export async function uploadGarment(file, avatar, onJob, signal) {
  const query = new URLSearchParams({ name: file.name });
  if (avatar) query.set("avatar", avatar);
  const headers = { "Content-Type": "application/octet-stream" };
  let job = await json(`/garments?${query}`, { method: "POST", headers, body: file });
  while (job.state === "queued" || job.state === "running") {
    onJob(job);
    await new Promise((resolve) => setTimeout(resolve, 500));
    if (signal?.aborted) await request(`/jobs/${job.id}`, { method: "DELETE" });
    job = await json(`/jobs/${job.id}`);
  }
  if (job.state === "cancelled") throw new Error(`${file.name} was cancelled.`);
  if (job.state === "failed") throw new Error(job.problem.detail);
  return job.garment;
}
