// Parts for those who build their own objects of three.js: poses of a rig, the service's body.
export { poseBones, readBody } from "./body.js";
export { RigSource, rigSource } from "./rig.js";
