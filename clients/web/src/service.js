// The service that this page came from, with the key of its user.
import { DrapeError } from "../lib/src/errors.js";
import { Rest } from "../lib/src/rest.js";

const KEPT = "drape-key"; // until the tab closes
const key = () => sessionStorage.getItem(KEPT) ?? "";
export const setKey = (said) => sessionStorage.setItem(KEPT, said);

export const service = new Rest(location.origin, { key });

export async function clipFile(document) {
  const headers = { Accept: "model/gltf-binary", "Content-Type": "application/json" };
  return (await service.request("/drape", { method: "POST", headers, body: JSON.stringify(document) })).blob();
}

// Uploads a garment file and waits for its job; returns the new id. onJob(job) is told where it is; signal: an AbortSignal
// that ends it there too.
export async function uploadGarment(file, avatar, onJob, signal) {
  const query = new URLSearchParams({ name: file.name });
  if (avatar) query.set("avatar", avatar);
  const headers = { "Content-Type": "application/octet-stream" };
  let job = await service.json(`/garments?${query}`, { method: "POST", headers, body: file });
  while (job.state === "queued" || job.state === "running") {
    onJob(job);
    await new Promise((resolve) => setTimeout(resolve, 500));
    if (signal?.aborted) await service.request(`/jobs/${job.id}`, { method: "DELETE" });
    job = await service.json(`/jobs/${job.id}`);
  }
  if (job.state === "cancelled") throw new Error(`${file.name} was cancelled.`);
  if (job.state === "failed") throw new DrapeError(job.problem);
  return job.garment;
}
