// A mesh of the service as graphics cards take it: one index for position and texture coordinates. Where these have a
// seam, vertices come twice: the delivered ones first, in their order, then their copies.

// mesh: the document of GET /garments/{id}/mesh.
export function topologyOf(mesh) {
  const vertexCount = mesh.vertices.length;
  const faces = Uint32Array.from(mesh.faces.flat());
  if (!mesh.uv.length) return { vertexCount, faces, index: faces, copies: new Uint32Array(0), uv: null, uvMetres: null };
  const corners = mesh.uv_faces.flat();
  const first = new Map(); // the texture coordinates of a vertex itself
  const seen = new Map(); // "vertex uv" to the copy's index
  const copies = [];
  const index = faces.map((vertex, corner) => {
    const uv = corners[corner];
    if (!first.has(vertex)) first.set(vertex, uv);
    if (first.get(vertex) === uv) return vertex;
    const name = `${vertex} ${uv}`;
    if (!seen.has(name)) {
      seen.set(name, { at: vertexCount + copies.length, uv });
      copies.push(vertex);
    }
    return seen.get(name).at;
  });
  const uv = new Float32Array(2 * (vertexCount + copies.length));
  for (const [vertex, coordinates] of first) uv.set(mesh.uv[coordinates], 2 * vertex);
  for (const { at, uv: coordinates } of seen.values()) uv.set(mesh.uv[coordinates], 2 * at);
  return { vertexCount, faces, index, copies: Uint32Array.from(copies), uv, uvMetres: metresOf(mesh) };
}

// Metres of a unit of texture coordinates: the median over edges at rest. Panels that are laid out flat give 1.
function metresOf({ vertices, faces, uv, uv_faces }) {
  const ratios = [];
  faces.forEach(([a, b], f) => {
    const [c, d] = uv_faces[f];
    const across = Math.hypot(uv[c][0] - uv[d][0], uv[c][1] - uv[d][1]);
    if (across > 1e-9) ratios.push(Math.hypot(...vertices[a].map((x, k) => x - vertices[b][k])) / across);
  });
  return ratios.sort((one, other) => one - other)[ratios.length >> 1] ?? null;
}
