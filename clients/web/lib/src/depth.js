// Depth that is not that of where something is: what lies over something else stays over it where the two cross by a little.
const PROJECTED = "#include <project_vertex>"; // in every material of three.js, and in MToon

// The material with its depth that of points nearer to the viewer by so many metres; metres: an expression of GLSL, in which
// mvPosition is the vertex as the camera has it.
export function nearer(material, metres) {
  const { onBeforeCompile, customProgramCacheKey } = material;
  material.onBeforeCompile = function (shader, renderer) {
    onBeforeCompile.call(this, shader, renderer);
    shader.vertexShader = shader.vertexShader.replace(PROJECTED, `${PROJECTED}
      vec4 shifted = projectionMatrix * (mvPosition + vec4(0.0, 0.0, ${metres}, 0.0));
      gl_Position.z = shifted.z / shifted.w * gl_Position.w;`);
  };
  material.customProgramCacheKey = function () {
    return `${onBeforeCompile} ${customProgramCacheKey.call(this)} ${metres}`;
  };
  return material;
}
