// The body that a service drapes on, as a skinned mesh of three.js.
import { rotationOf } from "./kinematics.js";
import { skinMaterial } from "./materials.js";

// Turns each bone by its rotation vector [rad], 3 numbers of pose, and puts the first one at root [m].
export function poseBones(bones, pose, root) {
  bones.forEach((bone, joint) => rotationOf(pose, 3 * joint, bone.quaternion));
  bones[0].position.fromArray(root); // the root joint turns about itself
}

// The group of a body file (GLB), its skinned mesh and its bones; the loader comes when it is needed.
export async function readBody(buffer, material = skinMaterial()) {
  const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
  const { scene: group } = await new GLTFLoader().parseAsync(buffer, "");
  let mesh = null;
  group.traverse((node) => {
    if (node.isSkinnedMesh) mesh = node;
  });
  mesh.material = material;
  mesh.castShadow = mesh.receiveShadow = true;
  mesh.frustumCulled = false; // its box is that of the rest pose
  return { group, mesh, bones: mesh.skeleton.bones };
}
