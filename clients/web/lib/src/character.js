// A user's character, GLB or VRM, in poses of ours: its own surface and textures, moved by its own rig.
//
// A_j, the alignment (drape/motion/alignment.py), brings the T-pose onto the character's rest pose, joint by joint. With T_j
// the turn of a joint from the T-pose on and W_j the rotation of its node at rest, the node's rotation is T_j A_j^-1 W_j.
import { Group, Matrix4, Quaternion, Vector3 } from "three";
import { JOINT_NAMES, PARENTS } from "./humanoid.js";
import { jointTurns } from "./kinematics.js";

const ENDS = new Map([[1, 7], [2, 8], [7, 10], [8, 11], [16, 18], [17, 19], [18, 20], [19, 21]]); // bones that are measured
const FEET = [7, 8];
const STEEP_FOOT = 0.3; // a foot whose level share is less has no heading

const between = (places, joint) => new Vector3().subVectors(places[ENDS.get(joint)], places[joint]).normalize();

// The alignment of each joint. places: of the nodes at rest, null where there is none; body: rest joints of the avatar's body.
function alignments(places, body) {
  const left = new Vector3().subVectors(places[1], places[2]).normalize();
  const forward = new Vector3().crossVectors(left, new Vector3(0, 1, 0)).normalize();
  const up = new Vector3().crossVectors(forward, left);
  const found = [new Quaternion().setFromRotationMatrix(new Matrix4().makeBasis(left, up, forward))];
  for (let joint = 1; joint < PARENTS.length; joint++) {
    let start = found[PARENTS[joint]];
    found.push(start.clone());
    if (!ENDS.has(joint) || !places[joint] || !places[ENDS.get(joint)]) continue;
    const bone = between(places, joint);
    const direction = between(body, joint);
    if (FEET.includes(joint)) {
      bone.addScaledVector(up, -bone.dot(up)); // soles are flat in every rest pose
      if (bone.length() < STEEP_FOOT) continue;
      bone.normalize();
      direction.setY(0).normalize();
      start = found[0];
    }
    const turn = new Quaternion().setFromUnitVectors(direction.applyQuaternion(start), bone);
    found[joint] = turn.multiply(start);
  }
  return found;
}

// { object, rest, pose(pose, root) } of the bytes of a character whose avatar (GET /avatars/{id}) the service has made.
export async function readCharacter(bytes, avatar) {
  const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
  const { scene, parser } = await new GLTFLoader().parseAsync(bytes, "");
  const object = new Group();
  object.scale.setScalar(avatar.scale);
  object.add(scene);
  const nodeOf = new Map(); // by its place in the file
  scene.traverse((node) => {
    const place = parser.associations.get(node)?.nodes;
    if (place !== undefined && !nodeOf.has(place)) nodeOf.set(place, node);
    if (!node.isMesh) return;
    node.castShadow = node.receiveShadow = true;
    node.frustumCulled = false; // its box is that of the rest pose
  });
  const nodes = JOINT_NAMES.map((name) => {
    const place = parser.json.nodes.findIndex((node) => node.name === avatar.joints[name]);
    return nodeOf.get(place) ?? null;
  });
  scene.updateMatrixWorld(true);
  const places = nodes.map((node) => node && node.getWorldPosition(new Vector3()));
  const body = avatar.rest_joints.map((place) => new Vector3(...place));
  const undone = alignments(places, body).map((turn, joint) => {
    return nodes[joint] && turn.invert().multiply(nodes[joint].getWorldQuaternion(new Quaternion())); // A^-1 W
  });
  const jointOf = new Map(nodes.map((node, joint) => [node, joint]).filter(([node]) => node));

  function turn(node, above, turns) {
    let world;
    if (jointOf.has(node)) {
      const joint = jointOf.get(node);
      world = turns[joint].clone().multiply(undone[joint]);
      node.quaternion.copy(above).invert().multiply(world);
    } else {
      world = above.clone().multiply(node.quaternion);
    }
    for (const child of node.children) turn(child, world, turns);
  }

  function pose(numbers, root) {
    turn(scene, new Quaternion(), jointTurns(numbers));
    const pelvis = nodes[0];
    pelvis.parent.updateWorldMatrix(true, false);
    pelvis.position.copy(object.parent ? object.parent.localToWorld(new Vector3(...root)) : new Vector3(...root));
    pelvis.parent.worldToLocal(pelvis.position);
  }

  return { object, rest: avatar.rest_joints, pose };
}
