// How far each vertex is from the borders of its panel: from hems, which end the cloth, and from seams, which go on.

export const FURTHEST_M = 0.06; // what is further is not told
const MOST = 1 << 22; // vertices

// The border edges of triangles, those of one triangle alone: pairs of corners of index. of(corner): the vertex there.
function borderEdges(index, of) {
  const next = (c) => (c % 3 === 2 ? c - 2 : c + 1);
  const names = new Float64Array(index.length);
  for (let c = 0; c < index.length; c++) {
    const [a, b] = [of(index[c]), of(index[next(c)])];
    names[c] = a < b ? a * MOST + b : b * MOST + a;
  }
  const sorted = names.slice().sort();
  const alone = new Set(sorted.filter((name, i) => name !== sorted[i - 1] && name !== sorted[i + 1]));
  const edges = [];
  for (let c = 0; c < index.length; c++) if (alone.has(names[c])) edges.push([index[c], index[next(c)]]);
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

const cellOf = (x) => Math.floor(x / FURTHEST_M);

// Two numbers [m] of each vertex, copies included: its distance to the nearest hem and to the nearest seam, FURTHEST_M at
// most, measured in the panels. layer: what unpackMesh() gives, with texture coordinates.
export function borderDistances({ vertexCount, copies, index, uv, uvMetres }) {
  const total = vertexCount + copies.length;
  const vertexOf = (at) => (at < vertexCount ? at : copies[at - vertexCount]);
  const outer = new Set(borderEdges(index, vertexOf).map(([a, b]) => a * MOST + b));
  const panel = panelsOf(index, total);
  const near = new Map(); // of each panel, by cells of the plane: hems and seams that may be near
  for (const [a, b] of borderEdges(index, (at) => at)) {
    const edge = [uv[2 * a], uv[2 * a + 1], uv[2 * b], uv[2 * b + 1]].map((one) => one * uvMetres);
    const kind = outer.has(a * MOST + b) ? 0 : 1;
    if (!near.has(panel[a])) near.set(panel[a], new Map());
    const cells = near.get(panel[a]);
    const [left, right] = [Math.min(edge[0], edge[2]), Math.max(edge[0], edge[2])].map(cellOf);
    const [low, high] = [Math.min(edge[1], edge[3]), Math.max(edge[1], edge[3])].map(cellOf);
    for (let i = left - 1; i <= right + 1; i++) {
      for (let j = low - 1; j <= high + 1; j++) {
        const cell = i * MOST + j;
        if (!cells.has(cell)) cells.set(cell, [[], []]);
        cells.get(cell)[kind].push(edge);
      }
    }
  }
  const distances = new Float32Array(2 * total).fill(FURTHEST_M);
  for (let at = 0; at < total; at++) {
    const [x, y] = [uv[2 * at] * uvMetres, uv[2 * at + 1] * uvMetres];
    const edges = near.get(panel[at])?.get(cellOf(x) * MOST + cellOf(y));
    for (let kind = 0; edges && kind < 2; kind++) distances[2 * at + kind] = nearest(x, y, edges[kind]);
  }
  return distances;
}

// The distance of a point to the nearest of edges, FURTHEST_M at most.
function nearest(x, y, edges) {
  let least = FURTHEST_M ** 2;
  for (const [ax, ay, bx, by] of edges) {
    const [ex, ey, px, py] = [bx - ax, by - ay, x - ax, y - ay];
    const along = Math.min(1, Math.max(0, (px * ex + py * ey) / (ex * ex + ey * ey || 1)));
    const [dx, dy] = [px - along * ex, py - along * ey];
    least = Math.min(least, dx * dx + dy * dy);
  }
  return Math.sqrt(least);
}
