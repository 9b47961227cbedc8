// A character's own file in garments that the service wrote on its rig: one GLB, joined here, since the service gives no
// file of a user back. What the file had stays, but for the triangles that the garments replace or hide.
const [MAGIC, JSON_CHUNK, BIN_CHUNK, HEAD] = [0x46546c67, 0x4e4f534a, 0x004e4942, 20];
const DRACO = "KHR_draco_mesh_compression";
const TRANSFORM = { translation: [0, 0, 0], rotation: [0, 0, 0, 1], scale: [1, 1, 1] };
const PLAIN = { // what VRM 0 says of a material that is glTF's own
  shader: "VRM_USE_GLTFSHADER", renderQueue: 2000, floatProperties: {}, vectorProperties: {}, textureProperties: {}, keywordMap: {}, tagMap: {},
};
const INDICES = { 5121: Uint8Array, 5123: Uint16Array, 5125: Uint32Array };

// The GLB of the character in bytes, whose garments are those of worn: a GLB on its rig (POST /drape with rig). covered: the
// answer of GET /avatars/{id}/covered; what it calls covered or hidden is left out.
export function wornFile(bytes, worn, covered) {
  const [own, theirs] = [glbOf(bytes), glbOf(worn)];
  const parts = [own.binary];
  let size = own.binary.byteLength;
  const add = (array) => {
    const padding = -size & 3;
    if (padding) parts.push(new Uint8Array(padding));
    parts.push(array);
    const at = size + padding;
    size = at + array.byteLength;
    return at;
  };
  for (const one of covered.primitives) leaveOut(own, one, add);
  join(own.json, theirs.json, add(theirs.binary));
  own.json.buffers = [{ byteLength: size }];
  return new Blob(glbPieces(own.json, parts, size), { type: "model/gltf-binary" });
}

function glbOf(buffer) {
  const view = new DataView(buffer);
  if (view.getUint32(0, true) !== MAGIC) throw new Error("This character is no GLB.");
  const length = view.getUint32(12, true);
  const json = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, HEAD, length)));
  if (json.buffers?.length !== 1 || json.buffers[0].uri) throw new Error("This character has data in other files: export it as one GLB.");
  return { json, binary: new Uint8Array(buffer, HEAD + length + 8, json.buffers[0].byteLength) };
}

function* padded(text) {
  yield text;
  yield " ".repeat(-new TextEncoder().encode(text).length & 3);
}

function glbPieces(json, parts, size) {
  const text = new TextEncoder().encode([...padded(JSON.stringify(json))].join(""));
  const rest = new Uint8Array(-size & 3);
  const numbers = (...words) => new Uint32Array(words);
  const whole = HEAD + text.length + 8 + size + rest.length;
  return [numbers(MAGIC, 2, whole, text.length, JSON_CHUNK), text, numbers(size + rest.length, BIN_CHUNK), ...parts, rest];
}

// Takes triangles out of a primitive of the character; where none is left one without area stays, as no primitive is empty.
function leaveOut({ json, binary }, { node, primitive: place, triangles, ranges, hidden }, add) {
  const gone = new Uint8Array(triangles);
  for (const runs of [ranges, hidden]) for (let i = 0; i < runs.length; i += 2) gone.fill(1, runs[i], runs[i] + runs[i + 1]);
  if (!gone.includes(1)) return;
  const { mesh } = json.nodes[node];
  if (json.nodes.filter((one) => one.mesh === mesh).length > 1) {
    json.nodes[node].mesh = json.meshes.push(structuredClone(json.meshes[mesh])) - 1; // another node draws all of it
  }
  const primitive = json.meshes[json.nodes[node].mesh].primitives[place];
  if (primitive.extensions?.[DRACO]) return; // what is packed has triangles of its own
  const corners = cornersOf(json, binary, primitive, 3 * triangles);
  const kept = corners.filter((_, corner) => !gone[Math.floor(corner / 3)]);
  const indices = kept.length ? Uint32Array.from(kept) : new Uint32Array(3);
  const bufferView = json.bufferViews.push({ buffer: 0, byteOffset: add(indices), byteLength: indices.byteLength, target: 34963 }) - 1;
  primitive.indices = json.accessors.push({ bufferView, componentType: 5125, count: indices.length, type: "SCALAR" }) - 1;
}

function cornersOf(json, binary, { indices }, count) {
  if (indices === undefined) return Uint32Array.from({ length: count }, (_, corner) => corner);
  const { bufferView, byteOffset = 0, componentType, count: length } = json.accessors[indices];
  const at = binary.byteOffset + (json.bufferViews[bufferView].byteOffset ?? 0) + byteOffset;
  const Kind = INDICES[componentType];
  return new Kind(binary.buffer.slice(at, at + length * Kind.BYTES_PER_ELEMENT)); // files may begin it anywhere
}

// Adds everything of the document more, whose bytes begin at offset, to own. What is the character's own node there is here
// too, so meshes and tracks go on these.
function join(own, more, offset) {
  const lists = ["bufferViews", "accessors", "images", "samplers", "textures", "materials", "meshes", "skins"];
  const first = Object.fromEntries(lists.map((name) => [name, (own[name] ??= []).length]));
  const node = sameNodes(own, more);
  const views = (one) => ({ ...one, bufferView: one.bufferView + first.bufferViews });
  own.bufferViews.push(...more.bufferViews.map((one) => ({ ...one, byteOffset: (one.byteOffset ?? 0) + offset })));
  own.accessors.push(...more.accessors.map(views));
  own.images.push(...(more.images ?? []).map(views));
  own.textures.push(...(more.textures ?? []).map(({ source }) => ({ source: source + first.images })));
  own.materials.push(...more.materials.map((one) => withTextures(one, first.textures)));
  const numbered = (named) => Object.fromEntries(Object.entries(named).map(([name, one]) => [name, one + first.accessors]));
  own.meshes.push(...more.meshes.map((one) => ({ ...one, primitives: one.primitives.map((part) => ({
    ...part, attributes: numbered(part.attributes), indices: part.indices + first.accessors, material: part.material + first.materials,
    ...(part.targets ? { targets: part.targets.map(numbered) } : {}),
  })) })));
  more.nodes.forEach((one, number) => {
    if (one.mesh === undefined) return;
    const { mesh, skin } = one;
    own.nodes[node[number]] = { ...one, mesh: mesh + first.meshes, ...(skin === undefined ? {} : { skin: skin + first.skins }) };
  });
  own.skins.push(...more.skins.map((one) => ({ ...one, joints: one.joints.map((joint) => node[joint]), inverseBindMatrices: one.inverseBindMatrices + first.accessors })));
  const tracks = (more.animations ?? []).map(({ channels, samplers, ...one }) => ({
    ...one,
    channels: channels.map((channel) => ({ ...channel, target: { ...channel.target, node: node[channel.target.node] } })),
    samplers: samplers.map((sampler) => ({ ...sampler, ...numbered({ input: sampler.input, output: sampler.output }) })),
  }));
  own.animations = [...tracks, ...(own.animations ?? [])]; // players begin with the first
  for (const name of ["extensionsUsed", "extensionsRequired"]) {
    const used = [...new Set([...(own[name] ?? []), ...(more[name] ?? [])])];
    if (used.length) own[name] = used;
  }
  for (const name of lists) if (!own[name].length) delete own[name];
  const told = own.extensions?.VRM && (own.extensions.VRM.materialProperties ??= []);
  told?.push(...own.materials.slice(told.length).map(({ name }) => ({ name, ...PLAIN })));
}

function withTextures(material, first) {
  const moved = (one) => one && { ...one, index: one.index + first };
  const { pbrMetallicRoughness: surface, normalTexture, ...rest } = material;
  const { baseColorTexture, metallicRoughnessTexture, ...numbers } = surface;
  const held = { baseColorTexture: moved(baseColorTexture), metallicRoughnessTexture: moved(metallicRoughnessTexture) };
  return JSON.parse(JSON.stringify({ ...rest, pbrMetallicRoughness: { ...numbers, ...held }, normalTexture: moved(normalTexture) }));
}

// The node of own for each node of more: the skeleton's nodes are the same, in the same order below each; meshes are new.
function sameNodes(own, more) {
  const found = new Array(more.nodes.length);
  const tops = own.scenes[own.scene ?? 0].nodes;
  const below = new Set(own.nodes.flatMap(({ children = [] }) => children));
  const roots = [...tops, ...own.nodes.keys()].filter((one, place, all) => !below.has(one) && all.indexOf(one) === place);
  const follow = (numbers, candidates) => {
    let next = 0;
    for (const number of numbers) {
      const one = more.nodes[number];
      if (one.mesh !== undefined) continue;
      while (next < candidates.length && !alike(one, own.nodes[candidates[next]])) next += 1;
      if (next === candidates.length) throw new Error("The service drapes another version of this character: drop it again.");
      found[number] = candidates[next++];
      follow(one.children ?? [], own.nodes[found[number]].children ?? []);
    }
  };
  follow(more.scenes[0].nodes, roots);
  more.nodes.forEach(({ mesh }, number) => {
    if (mesh === undefined) return;
    found[number] = own.nodes.push({}) - 1;
    tops.push(found[number]);
  });
  return found;
}

// Whether they have the same name and, where neither has a matrix, stand alike.
function alike(one, other) {
  if ((one.name ?? "") !== (other.name ?? "")) return false;
  if (other.matrix) return true;
  return Object.entries(TRANSFORM).every(([path, usual]) => (one[path] ?? usual).every((value, i) => Math.abs(value - (other[path] ?? usual)[i]) < 1e-6));
}
