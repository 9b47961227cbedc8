// The body that a service drapes on, as a skinned mesh of three.js.
import { Bone, BufferAttribute, BufferGeometry, Group, Skeleton, SkinnedMesh } from "three";
import { JOINT_NAMES, PARENTS } from "./humanoid.js";
import { rotationOf } from "./kinematics.js";
import { skinMaterial } from "./materials.js";
import { unpackBody } from "./meshes.js";

// Turns each bone by its rotation vector [rad], 3 numbers of pose, and puts the first one at root [m].
export function poseBones(bones, pose, root) {
  bones.forEach((bone, joint) => rotationOf(pose, 3 * joint, bone.quaternion));
  bones[0].position.fromArray(root); // the root joint turns about itself
}

// The group of a body, its skinned mesh, its bones, and rest, where these are [m]. message: the BODY of a service.
export function readBody(message, material = skinMaterial()) {
  const { index, positions, joints, bones: skinBones, weights } = unpackBody(message);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("skinIndex", new BufferAttribute(skinBones, 4));
  geometry.setAttribute("skinWeight", new BufferAttribute(weights, 4));
  geometry.setIndex(new BufferAttribute(index, 1));
  geometry.computeVertexNormals();
  const rest = JOINT_NAMES.map((_, joint) => joints.slice(3 * joint, 3 * joint + 3));
  const bones = JOINT_NAMES.map((name) => Object.assign(new Bone(), { name }));
  PARENTS.forEach((parent, joint) => {
    bones[joint].position.set(...rest[joint].map((x, axis) => x - (parent < 0 ? 0 : rest[parent][axis])));
    if (parent >= 0) bones[parent].add(bones[joint]);
  });
  const mesh = new SkinnedMesh(geometry, material);
  const group = new Group().add(bones[0], mesh);
  group.updateMatrixWorld(true);
  mesh.bind(new Skeleton(bones));
  mesh.castShadow = mesh.receiveShadow = true;
  mesh.frustumCulled = false; // its box is that of the rest pose
  return { group, mesh, bones, rest };
}
