// The body that a service drapes on, as a skinned mesh of three.js.
import { MeshStandardMaterial, Vector3 } from "three";

const axis = new Vector3();

// Turns each bone by its rotation vector [rad], 3 numbers of pose, and puts the first one at root [m].
export function poseBones(bones, pose, root) {
  bones.forEach((bone, joint) => {
    axis.fromArray(pose, 3 * joint);
    const angle = axis.length();
    bone.quaternion.setFromAxisAngle(angle > 1e-9 ? axis.divideScalar(angle) : axis.set(0, 1, 0), angle);
  });
  bones[0].position.fromArray(root); // the root joint turns about itself
}

// The group of a body file (GLB), its skinned mesh and its bones; the loader comes when it is needed.
export async function readBody(buffer, material = new MeshStandardMaterial({ color: 0xcdb3a0, roughness: 0.72 })) {
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
