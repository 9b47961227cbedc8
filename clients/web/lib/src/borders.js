// How far each vertex is from the borders of its panel: from hems, which end the cloth, and from seams, which go on.

const FURTHEST_M = 0.06; // what is further is not told

// The border edges of triangles, those of one triangle alone: pairs of vertices.
function borderEdges(index) {
  const count = new Map();
  const key = (a, b) => (a < b ? a * 4194304 + b : b * 4194304 + a);
  const corners = (visit) => {
    for (let f = 0; f < index.length; f += 3) {
      for (let k = 0; k < 3; k++) visit(index[f + k], index[f + ((k + 1) % 3)]);
    }
  };
  corners((a, b) => count.set(key(a, b), (count.get(key(a, b)) ?? 0) + 1));
  const edges = [];
  corners((a, b) => {
    if (count.get(key(a, b)) === 1) edges.push([a, b]);
  });
  return edges;
}

// The panel of each vertex: vertices that triangles of index join are of one.
function panelsOf(index, total) {
  const above = Uint32Array.from({ length: total }, (_, vertex) => vertex);
  const top = (vertex) => {
    while (above[vertex] !== vertex) vertex = above[vertex] = above[above[vertex]];
    return vertex;
  };
  for (let f = 0; f < index.length; f += 3) {
    above[top(index[f + 1])] = top(index[f]);
    above[top(index[f + 2])] = top(index[f]);
  }
  return above.map((_, vertex) => top(vertex));
}

// Two numbers [m] of each vertex, copies included: its distance to the nearest hem and to the nearest seam, FURTHEST_M at
// most, measured in the panels. layer: what topologyOf() gives, with texture coordinates.
export function borderDistances({ vertexCount, copies, index, uv, uvMetres }) {
  const total = vertexCount + copies.length;
  const vertexOf = (at) => (at < vertexCount ? at : copies[at - vertexCount]);
  const outer = new Set(borderEdges(index.map(vertexOf)).map(([a, b]) => `${a} ${b}`));
  const panel = panelsOf(index, total);
  const sides = new Map(); // of a panel: its hems, its seams
  for (const [a, b] of borderEdges(index)) {
    const own = sides.get(panel[a]) ?? [[], []];
    sides.set(panel[a], own);
    own[outer.has(`${vertexOf(a)} ${vertexOf(b)}`) ? 0 : 1].push(
      [uv[2 * a], uv[2 * a + 1], uv[2 * b], uv[2 * b + 1]].map((one) => one * uvMetres),
    );
  }
  const distances = new Float32Array(2 * total).fill(FURTHEST_M);
  for (let at = 0; at < total; at++) {
    const [x, y] = [uv[2 * at] * uvMetres, uv[2 * at + 1] * uvMetres];
    sides.get(panel[at])?.forEach((edges, kind) => {
      let least = FURTHEST_M ** 2;
      for (const [ax, ay, bx, by] of edges) {
        const [ex, ey, px, py] = [bx - ax, by - ay, x - ax, y - ay];
        const along = Math.min(1, Math.max(0, (px * ex + py * ey) / (ex * ex + ey * ey || 1)));
        const [dx, dy] = [px - along * ex, py - along * ey];
        least = Math.min(least, dx * dx + dy * dy);
      }
      distances[2 * at + kind] = Math.sqrt(least);
    });
  }
  return distances;
}
