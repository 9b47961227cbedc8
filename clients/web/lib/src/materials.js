// How fabrics and skin look, as materials of three.js. Everything follows from what the service tells of a fabric.
import { Color, DoubleSide, MeshLambertMaterial, MeshPhysicalMaterial, Vector2 } from "three";
import { nearer } from "./depth.js";
import { YARNS, swatchPixels, weaveTextures } from "./weave.js";

const KNIT_N_PER_M = 120; // a knit gives way to less along its softer direction, a weave does not
const SHEER_KG_M2 = 0.08; // lighter cloth lets light through
const OF_NAME = [
  [/denim|twill/, "twill"], [/satin|silk/, "satin"], [/rib/, "rib"], [/sweat|fleece|blanket|wool/, "fleece"],
  [/jersey|ponte|knit|swim|interlock/, "jersey"],
];
// Of each bond: pitch, yarns per thickness; roughness; sheen and its roughness; relief; grain, how much light runs along the
// warp; uneven, how much its shade varies over centimetres.
const LOOKS = {
  plain: { pitch: 1.1, roughness: 0.88, sheen: 0.35, sheenRoughness: 0.5, relief: 0.8, grain: 0, uneven: 0.1 },
  twill: { pitch: 0.9, roughness: 0.92, sheen: 0.3, sheenRoughness: 0.6, relief: 1, grain: 0, uneven: 0.14 },
  satin: { pitch: 0.8, roughness: 0.36, sheen: 0.4, sheenRoughness: 0.3, relief: 0.25, grain: 0.75, uneven: 0.03 },
  jersey: { pitch: 1, roughness: 0.95, sheen: 0.6, sheenRoughness: 0.5, relief: 0.8, grain: 0, uneven: 0.06 },
  rib: { pitch: 0.9, roughness: 0.95, sheen: 0.6, sheenRoughness: 0.5, relief: 1, grain: 0, uneven: 0.06 },
  fleece: { pitch: 1, roughness: 1, sheen: 0.9, sheenRoughness: 0.55, relief: 0.9, grain: 0, uneven: 0.16 },
};

// How a fabric looks. fabric: one of GET /fabrics, or numbers of one; nothing: a jersey. Its pitch is that of the yarns [m].
export function fabricLook(fabric) {
  const { id = "", warp_n_per_m = 200, weft_n_per_m = 80, density_kg_m2 = 0.19, thickness_m = 0.0008 } = fabric ?? {};
  const knit = Math.min(warp_n_per_m, weft_n_per_m) < KNIT_N_PER_M;
  const bond = OF_NAME.find(([words]) => words.test(id))?.[1] ?? (knit ? "jersey" : "plain");
  const { pitch, ...look } = LOOKS[bond];
  const opacity = density_kg_m2 < SHEER_KG_M2 ? 0.8 : 1;
  return { bond, knit, ...look, thicknessM: thickness_m, pitchM: pitch * thickness_m, pale: /denim/.test(id) ? 0.5 : 0, opacity };
}

// Pixels of a swatch of a look, as ImageData takes them; yarns: how many across.
export function fabricSwatch(look, colour, size, yarns = 12) {
  const { r, g, b } = new Color(colour).getRGB({}, "srgb");
  return swatchPixels(look.bond, { colour: [255 * r, 255 * g, 255 * b], size, yarns, relief: look.relief, pale: look.pale });
}

// Fibres scatter light at grazing angles in a paler tone of the cloth's own colour.
export function dye(material, colour) {
  material.color.set(colour);
  material.sheenColor?.set(colour).lerp(new Color(0xffffff), 0.35).multiplyScalar(0.6);
  return material;
}

// Lines of seams, of a hem's stitches, the inside darker: from the attribute "border" (borders.js), in metres.
const BORDER_LINES = /* glsl */ `
  if (!gl_FrontFacing) diffuseColor.rgb *= 0.62;
  {
    vec2 across = fwidth(vBorder) + 1e-7;
    vec2 texel = fwidth(vClothUv) + 1e-7;
    vec2 steep = clamp(2.5 * across / max(texel.x, texel.y) - 0.4, 0.0, 1.0); // 0 where a triangle has borders all around
    float seam = (1.0 - smoothstep(0.0005, 0.0005 + 1.2 * across.y, vBorder.y)) * min(1.0, 0.0018 / across.y);
    float puckered = exp(-vBorder.y * vBorder.y / 2.0e-5);
    float turned = abs(vBorder.x - 0.018);
    float stitch = (1.0 - smoothstep(0.0005, 0.0005 + 1.2 * across.x, turned)) * min(1.0, 0.0016 / across.x);
    float along = (vClothUv.x + vClothUv.y) / 0.0042; // borders run along warp or weft, most of them
    float dashes = mix(0.6, step(0.32, fract(along)), clamp(0.8 - fwidth(along), 0.0, 1.0));
    float doubled = 1.0 - smoothstep(0.016, 0.018, vBorder.x); // a hem is two layers, its light is less
    diffuseColor.rgb *= 1.0 - steep.y * (0.5 * seam + 0.12 * puckered);
    diffuseColor.rgb *= 1.0 - steep.x * (0.42 * stitch * dashes + 0.06 * doubled);
    float folded = 2.0 * thicknessM; // the edge itself is cloth turned over, and catches light
    float edge = (1.0 - smoothstep(folded, folded + across.x, vBorder.x)) * min(1.0, folded / across.x);
    diffuseColor.rgb *= 1.0 + 0.18 * steep.x * edge;
  }
`;
const UNEVEN = /* glsl */ `
  #ifdef USE_NORMALMAP
    diffuseColor.rgb *= 1.0 + uneven * 2.0 * (texture2D(normalMap, 0.11 * vNormalMapUv).a - 0.5);
  #endif
`;

function withBorders(material, { uvMetres, uneven, thicknessM }) {
  material.onBeforeCompile = (shader) => {
    shader.uniforms.uvMetres = { value: uvMetres };
    shader.uniforms.uneven = { value: uneven };
    shader.uniforms.thicknessM = { value: thicknessM };
    const head = "attribute vec2 border;\nvarying vec2 vBorder;\nvarying vec2 vClothUv;\nuniform float uvMetres;\n";
    shader.vertexShader = (head + shader.vertexShader).replace(
      "#include <begin_vertex>",
      "#include <begin_vertex>\n  vBorder = border;\n  vClothUv = uvMetres * uv;",
    );
    shader.fragmentShader = `varying vec2 vBorder;\nvarying vec2 vClothUv;\nuniform float uneven;\nuniform float thicknessM;\n${shader.fragmentShader}`.replace(
      "#include <color_fragment>",
      `#include <color_fragment>${BORDER_LINES}${UNEVEN}`,
    );
  };
  material.customProgramCacheKey = () => "drape cloth";
  return material;
}

// The material of a cloth that is dyed in a colour. uvMetres: metres of a unit of its texture coordinates, null without
// any; bordered: whether its geometry has the attribute "border"; plain: cheap to draw, without weave and sheen; nearerM: how
// much nearer to the viewer its outside is drawn than it is, as of what is worn over something else [m].
export function clothMaterial(look, { colour, uvMetres = null, bordered = false, plain = false, nearerM = 0 }) {
  const sides = { side: DoubleSide, shadowSide: DoubleSide };
  const sheer = look.opacity < 1 ? { transparent: true, opacity: look.opacity } : {};
  let material;
  if (plain) {
    material = new MeshLambertMaterial({ ...sides, ...sheer });
  } else {
    const { roughness, sheen, sheenRoughness, grain } = look;
    material = new MeshPhysicalMaterial({ ...sides, ...sheer, roughness, sheen, sheenRoughness, specularIntensity: grain ? 1 : 0.3 });
    if (uvMetres !== null) weave(material, look, uvMetres);
  }
  if (bordered) withBorders(material, { ...look, uvMetres });
  if (nearerM) nearer(material, `${nearerM.toFixed(5)} * smoothstep(0.0, 0.3, normalize(transformedNormal).z)`);
  return dye(material, colour);
}

function weave(material, look, uvMetres) {
  const { normal, shade } = weaveTextures(look.bond, look);
  const repeats = uvMetres / (YARNS * look.pitchM);
  for (const [name, shared] of [["normalMap", normal], ["map", shade]]) {
    material[name] = shared.clone(); // the picture is shared, how often it repeats is not
    material[name].repeat.set(repeats, repeats);
    material[name].needsUpdate = true;
  }
  material.normalScale = new Vector2(1, 1);
  if (look.grain) Object.assign(material, { anisotropy: look.grain, anisotropyRotation: Math.PI / 2 }); // the warp is v
}

// Skin: light that goes in comes out warmer, most where it grazes.
export function skinMaterial(tone = "#c99a80", { plain = false } = {}) {
  if (plain) return new MeshLambertMaterial({ color: tone });
  const color = new Color(tone);
  const sheenColor = color.clone().lerp(new Color("#d9603f"), 0.3);
  return new MeshPhysicalMaterial({ color, sheenColor, sheen: 0.35, sheenRoughness: 0.5, roughness: 0.55, specularIntensity: 0.4 });
}
