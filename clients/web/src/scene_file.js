// What a file of a scene holds, told without reading its numbers.
const HEAD = { magic: 0x46546c67, json: 20 }; // of a GLB: its mark, where its JSON begins
const MOST_CLIPS = 20;
const UNKNOWN = { skin: false, mesh: true, clips: [] }; // the service will say what is wrong with it

// { skin, mesh, clips } of a GLB, VRM or VRMA: whether it has a skin and a mesh, and the names of its animations, the
// longest first.
export async function aboutGlb(file) {
  const head = new DataView(await file.slice(0, HEAD.json).arrayBuffer());
  if (head.byteLength < HEAD.json || head.getUint32(0, true) !== HEAD.magic) return UNKNOWN;
  const text = await file.slice(HEAD.json, HEAD.json + head.getUint32(12, true)).text();
  try {
    const { skins = [], meshes = [], animations = [], accessors = [] } = JSON.parse(text);
    const ends = ({ samplers = [] }) => Math.max(0, ...samplers.map(({ input }) => accessors[input]?.max?.[0] ?? 0));
    const clips = animations.map((one) => ({ name: String(one.name ?? ""), endS: ends(one) })).sort((a, b) => b.endS - a.endS);
    return { skin: skins.length > 0, mesh: meshes.length > 0, clips: clips.slice(0, MOST_CLIPS).map(({ name }) => name) };
  } catch {
    return UNKNOWN;
  }
}

// Whether an FBX has a mesh, by the word that every one writes, in binary files too.
export const fbxHasMesh = async (file) => (await file.text()).includes("PolygonVertexIndex");
