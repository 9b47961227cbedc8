// A character's skin below garments, drawn a little deeper than it is: cloth through which it stands lies before it, and
// where a hem has moved on it is still there.
//
// The covered triangles of a mesh are drawn by a second mesh beside it, with a copy of its material whose depth is that of
// points further from the viewer. Both have an index of their own, in which what the other one draws has no area, so that
// groups of materials stay as they are. Hidden triangles, of clothes that a garment replaces, are drawn by neither one, and
// what was never modelled below them is skin on the character's bones (bare.js).
import { BufferAttribute, BufferGeometry, Mesh, PropertyBinding, SkinnedMesh } from "three";
import { nearer } from "./depth.js";

const drawn = new Map(); // by mesh: what is drawn in its place

// Covers skin of object, a rig in a scene, by the answer of GET /avatars/{id}/covered; the result takes that back.
// Several may cover the same skin.
export function coverSkin(object, covered) {
  const by = {};
  const found = meshesOf(object, covered.primitives);
  for (const [mesh, primitive] of found) {
    if (!drawn.has(mesh)) drawn.set(mesh, new Divided(mesh, covered.deeper_m));
    drawn.get(mesh).cover(by, primitive);
  }
  return () => {
    for (const [mesh] of found) {
      if (drawn.get(mesh)?.uncover(by)) drawn.delete(mesh);
    }
  };
}

const trianglesOf = ({ index, attributes }) => Math.floor((index ?? attributes.position).count / 3);

// The mesh of each primitive that has covered triangles: of those with as many triangles the one of its name, else the first.
function meshesOf(object, primitives) {
  const left = [];
  object.traverse((node) => node.isMesh && !node.userData.drapeCovered && left.push(node));
  const found = [];
  for (const primitive of primitives) {
    const alike = left.filter(({ geometry }) => trianglesOf(geometry) === primitive.triangles);
    const name = PropertyBinding.sanitizeNodeName(primitive.name);
    const mesh = alike.find((one) => one.name === name || one.parent?.name === name) ?? alike[0];
    if (!mesh) continue; // it is not in this scene
    left.splice(left.indexOf(mesh), 1);
    if (primitive.ranges.length || primitive.hidden?.length) found.push([mesh, primitive]);
  }
  return found;
}

// A mesh, and one that draws its covered triangles.
class Divided {
  constructor(mesh, deeperM) {
    this.mesh = mesh;
    this.own = mesh.geometry.index; // null where the file has none
    this.corners = this.own?.array ?? Uint32Array.from({ length: mesh.geometry.attributes.position.count }, (_, i) => i);
    this.by = new Map();
    const [above, below] = [0, 1].map(() => new BufferAttribute(this.corners.slice(), 1));
    Object.assign(this, { above, below, twin: twinOf(mesh, below, deeperM) });
    mesh.geometry.setIndex(above);
    mesh.add(this.twin);
  }

  cover(by, { ranges, hidden = [] }) {
    this.by.set(by, { ranges, hidden });
    this.#divide();
  }

  // Whether nobody covers it any more, and it is as it was.
  uncover(by) {
    this.by.delete(by);
    if (this.by.size) {
      this.#divide();
      return false;
    }
    this.mesh.geometry.setIndex(this.own);
    this.twin.removeFromParent();
    this.twin.geometry.setIndex(null); // attributes are the mesh's, and stay
    for (const material of [this.twin.material].flat()) material.dispose();
    return true;
  }

  #divide() {
    const { corners, above, below } = this;
    const where = new Uint8Array(corners.length / 3); // 0: above, 1: below, 2: hidden
    for (const [kind, name] of [[1, "ranges"], [2, "hidden"]]) {
      for (const { [name]: runs } of this.by.values()) {
        for (let i = 0; i < runs.length; i += 2) where.fill(kind, runs[i], runs[i] + runs[i + 1]);
      }
    }
    where.forEach((is, triangle) => {
      const at = 3 * triangle;
      for (let corner = at; corner < at + 3; corner++) {
        above.array[corner] = corners[is === 0 ? corner : at];
        below.array[corner] = corners[is === 1 ? corner : at];
      }
    });
    above.needsUpdate = below.needsUpdate = true;
  }
}

function twinOf(mesh, index, deeperM) {
  const { attributes, morphAttributes, morphTargetsRelative, groups, boundingSphere, boundingBox } = mesh.geometry;
  const geometry = Object.assign(new BufferGeometry(), { attributes, morphAttributes, morphTargetsRelative, groups, boundingSphere, boundingBox });
  geometry.setIndex(index);
  const material = Array.isArray(mesh.material) ? mesh.material.map((one) => deeper(one, deeperM)) : deeper(mesh.material, deeperM);
  const twin = mesh.isSkinnedMesh ? new SkinnedMesh(geometry, material) : new Mesh(geometry, material);
  if (mesh.isSkinnedMesh) {
    twin.bindMode = mesh.bindMode;
    twin.bind(mesh.skeleton, mesh.bindMatrix);
  }
  const { morphTargetInfluences, morphTargetDictionary, frustumCulled, castShadow, receiveShadow, renderOrder } = mesh;
  Object.assign(twin, { morphTargetInfluences, morphTargetDictionary, frustumCulled, castShadow, receiveShadow, renderOrder });
  twin.layers.mask = mesh.layers.mask;
  twin.raycast = () => {};
  twin.userData.drapeCovered = true;
  return twin;
}

function deeper(material, byM) {
  const copy = material.clone();
  copy.onBeforeCompile = material.onBeforeCompile; // clone() leaves both out
  copy.customProgramCacheKey = material.customProgramCacheKey;
  return nearer(copy, (-byM).toFixed(5));
}
