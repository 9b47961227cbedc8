// What makes a person of the service's body, whose mesh has no picture of its own: short hair, brows, eyes and lips, and
// what it wears below everything, so that nobody stands there undressed. All is painted by where a point is at rest.
import { Color, Vector3, Vector4 } from "three";

const CLOTH = new Color("#a5a29f");
const HAIR = new Color("#2a201b");
const LIPS = new Color("#8e3f3c");
const CHEST = 0.3; // of the way from spine3 to the neck
const TRUNK_M = 0.32; // hands at rest are further out
const CROWN_M = 0.1575; // above the joint of the head, of the body that the numbers below are of [m]
const [HIPS, SPINE3, NECK, HEAD] = [[1, 2], 9, 12, 15];

const PAINT = /* glsl */ `
  vec3 q = (vRest - head.xyz) / head.w; // from the joint of the head, in metres of the mean body
  float fuzz = fract(sin(dot(floor(vRest * 900.0), vec3(12.9898, 78.233, 37.719))) * 43758.5453);
  float line = -0.027 + 0.069 * smoothstep(-0.055, -0.008, q.z) + 0.06 * smoothstep(0.03, 0.08, q.z);
  float hair = smoothstep(-0.004, 0.007, q.y - line + 0.004 * (fuzz - 0.5));
  diffuseColor.rgb = mix(diffuseColor.rgb, hairColour * (0.88 + 0.24 * fuzz), 0.94 * hair);
  dull = hair;
  float face = step(0.06, q.z);
  float t = (abs(q.x) - 0.033) / 0.02;
  float brow = smoothstep(0.0042, 0.0018, abs(q.y - 0.0585 - 0.0028 * (1.0 - t * t)) + 0.0012 * t) * smoothstep(1.05, 0.8, abs(t));
  diffuseColor.rgb = mix(diffuseColor.rgb, hairColour, 0.72 * brow * face);
  vec2 eye = vec2(abs(q.x) - 0.0327, q.y - 0.0427);
  float open = smoothstep(1.08, 0.92, length(eye / vec2(0.0125, 0.0041)));
  float iris = smoothstep(0.0072, 0.0062, length(eye - vec2(0.0, 0.0006)));
  float pupil = smoothstep(0.0036, 0.0028, length(eye - vec2(0.0, 0.0006)));
  vec3 ball = mix(mix(vec3(0.45, 0.42, 0.4), vec3(0.09, 0.05, 0.03), iris), vec3(0.006), pupil);
  float lash = smoothstep(1.5, 1.05, length((eye - vec2(0.0, 0.0012)) / vec2(0.0138, 0.0050)));
  diffuseColor.rgb = mix(mix(diffuseColor.rgb, hairColour, 0.55 * lash * face), ball, open * face);
  float mouth = smoothstep(1.1, 0.75, length(vec2(q.x, q.y + 0.0305) / vec2(0.0262, 0.0098)));
  diffuseColor.rgb = mix(diffuseColor.rgb, lipColour, 0.36 * mouth * face);
  float soft = fwidth(vRest.y) + 1e-5;
  float low = smoothstep(bands.x - soft, bands.x + soft, vRest.y) * smoothstep(bands.y + soft, bands.y - soft, vRest.y);
  float high = smoothstep(bands.z - soft, bands.z + soft, vRest.y) * smoothstep(bands.w + soft, bands.w - soft, vRest.y);
  diffuseColor.rgb = mix(diffuseColor.rgb, baseCloth, max(low, high) * step(abs(vRest.x), trunk));
`;

const DULL = /* glsl */ `
  material.roughness = mix(material.roughness, 0.9, dull);
  material.specularColorBlended *= 1.0 - 0.8 * dull;
  #ifdef USE_SHEEN
    material.sheenColor *= 1.0 - dull;
  #endif
`;

// A skin material with all of it. rest: places [m] of the joints at rest; crownM: the height of the crown there.
export function paintPerson(material, { rest, crownM }) {
  const hip = 0.5 * HIPS.reduce((sum, joint) => sum + rest[joint][1], 0);
  const chest = rest[SPINE3][1] + CHEST * (rest[NECK][1] - rest[SPINE3][1]);
  const head = new Vector3(...rest[HEAD]);
  const uniforms = {
    bands: { value: new Vector4(hip - 0.17, hip + 0.1, chest - 0.075, chest + 0.055) },
    head: { value: new Vector4(head.x, head.y, head.z, (crownM - head.y) / CROWN_M) },
    baseCloth: { value: CLOTH }, hairColour: { value: HAIR }, lipColour: { value: LIPS }, trunk: { value: TRUNK_M },
  };
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, uniforms);
    const vertex = "#include <begin_vertex>";
    shader.vertexShader = `varying vec3 vRest;\n${shader.vertexShader}`.replace(vertex, `${vertex}\n  vRest = position;`);
    const names = "float dull = 0.0;\nuniform vec4 bands;\nuniform vec4 head;\nuniform vec3 baseCloth;\nuniform vec3 hairColour;\nuniform vec3 lipColour;\nuniform float trunk;\n";
    const colour = "#include <color_fragment>";
    const painted = `varying vec3 vRest;\n${names}${shader.fragmentShader}`.replace(colour, `${colour}\n{${PAINT}}`);
    const light = "#include <lights_physical_fragment>"; // hair does not shine as skin does
    shader.fragmentShader = painted.replace(light, `${light}\n${DULL}`);
  };
  material.customProgramCacheKey = () => "drape person";
  return material;
}
