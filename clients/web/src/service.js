// What only this page asks of the service that it came from, and the key of its user.
import { DrapeError } from "../lib/src/errors.js";

const KEPT = "drape-key"; // until the tab closes
const POLL_MS = 500;
export const key = () => sessionStorage.getItem(KEPT) ?? "";
export const setKey = (said) => sessionStorage.setItem(KEPT, said);

export async function clipFile(rest, document) {
  const headers = { Accept: "model/gltf-binary", "Content-Type": "application/json" };
  return (await rest.request("/drape", { method: "POST", headers, body: JSON.stringify(document) })).blob();
}

// Uploads a garment, the parts { file, path } of it, the mesh first, and waits for its job; returns that when it is done.
// options: fields of POST /garments. onJob(job) is told where it is; signal: an AbortSignal that ends it there too.
export async function uploadGarment(rest, parts, options, onJob, signal) {
  const [{ file }] = parts;
  const given = Object.entries(options).filter(([, value]) => value);
  const query = new URLSearchParams([["name", file.name], ...given]);
  let job = await rest.json(`/garments?${query}`, { method: "POST", ...bodyOf(parts) });
  while (job.state === "queued" || job.state === "running") {
    onJob(job);
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
    if (signal?.aborted) await rest.request(`/jobs/${job.id}`, { method: "DELETE" });
    job = await rest.json(`/jobs/${job.id}`);
  }
  if (job.state === "cancelled") throw new Error(`${file.name} was cancelled.`);
  if (job.state === "failed") throw new DrapeError(job.problem);
  return job;
}

// One file goes as it is, several as the parts of a form.
function bodyOf(parts) {
  if (parts.length === 1) return { headers: { "Content-Type": "application/octet-stream" }, body: parts[0].file };
  const body = new FormData();
  for (const { file, path } of parts) body.append("file", file, path);
  return { body };
}

export const removeGarment = (rest, id) => rest.request(`/garments/${encodeURIComponent(id)}`, { method: "DELETE" });
