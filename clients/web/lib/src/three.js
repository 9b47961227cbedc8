// Parts for those who build their own objects of three.js: poses of a rig, the service's body, characters, materials of cloth.
export { poseBones, readBody } from "./body.js";
export { borderDistances } from "./borders.js";
export { readCharacter } from "./character.js";
export { clothMaterial, dye, fabricLook, fabricSwatch, skinMaterial } from "./materials.js";
export { RigSource, rigSource } from "./rig.js";
