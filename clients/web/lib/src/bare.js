// What is seen of a character where garments take off clothes of its own: skin, where nothing was modelled below, and a top
// that is tucked in, which is drawn deeper than it is, so that it does not stand through the cloth.
import { Matrix4, Skeleton } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { nearer } from "./depth.js";

const nameOf = (node) => node.userData.name ?? node.name;

// Puts it on the bones of object, a rig: bytes are a GLB, of GET /avatars/{id}/bare. The result takes it off.
export async function bareSkin(object, bytes) {
  const { scene } = await new GLTFLoader().parseAsync(bytes, "");
  const named = new Map();
  object.traverse((node) => !node.isMesh && !named.has(nameOf(node)) && named.set(nameOf(node), node));
  const found = [];
  scene.traverse((node) => node.isSkinnedMesh && found.push(node));
  const bones = found[0].skeleton.bones.map((bone) => named.get(nameOf(bone)));
  if (!bones.every(Boolean)) return () => {}; // another character's
  for (const mesh of found) {
    const byM = mesh.userData.deeper_m ?? mesh.parent.userData.deeper_m; // the parent's of several materials
    if (byM) nearer(mesh.material, (-byM).toFixed(5));
    mesh.bind(new Skeleton(bones, mesh.skeleton.boneInverses), new Matrix4());
    Object.assign(mesh, { castShadow: true, receiveShadow: true, frustumCulled: false });
    mesh.userData.drapeCovered = true;
    object.add(mesh);
  }
  return () => {
    for (const mesh of found) {
      mesh.removeFromParent();
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
  };
}
