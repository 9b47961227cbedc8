// Skin of a character where garments take off clothes of its own, below which nothing was modelled.
import { Matrix4, Skeleton } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const nameOf = (node) => node.userData.name ?? node.name;

// Puts skin on the bones of object, a rig: bytes are a GLB, of GET /avatars/{id}/bare. The result takes it off.
export async function bareSkin(object, bytes) {
  const { scene } = await new GLTFLoader().parseAsync(bytes, "");
  const named = new Map();
  object.traverse((node) => !node.isMesh && !named.has(nameOf(node)) && named.set(nameOf(node), node));
  let skin = null;
  scene.traverse((node) => (skin = node.isSkinnedMesh ? node : skin));
  const bones = skin.skeleton.bones.map((bone) => named.get(nameOf(bone)));
  if (!bones.every(Boolean)) return () => {}; // another character's
  skin.bind(new Skeleton(bones, skin.skeleton.boneInverses), new Matrix4());
  Object.assign(skin, { castShadow: true, receiveShadow: true, frustumCulled: false });
  skin.userData.drapeCovered = true;
  object.add(skin);
  return () => {
    skin.removeFromParent();
    skin.geometry.dispose();
    skin.material.dispose();
  };
}
