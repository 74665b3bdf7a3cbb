// The part of WebGL 2 that MediaPipe Hands uses, on the processor.
//
// MediaPipe draws each picture three times: into a texture, from there the part with the hand for its network, and
// once for display. It then reads the part back, for which it waits. Without a GPU this takes longer than the network,
// and workers of some browsers have no WebGL. Here a texture is a view of the picture, and its pixels are computed
// where they are read.

const FLOATS = 4; // bytes
const ACTIVE_UNIFORMS = 35718;
const PARAMETERS = {
  3379: 8192, // largest texture
  3386: [8192, 8192], // largest viewport
  7938: "WebGL 2.0",
  34024: 8192, // largest renderbuffer
  34921: 16, // vertex attributes
  34965: null, // buffer of indices
  35724: "WebGL GLSL ES 3.00",
};
// Uniforms of MediaPipe's programs, by the one that tells which program it is.
const COPY = ["video_frame", "scale"];
const CUT = ["input_texture", "alpha", "beta", "transform_matrix"];
const POSITION = 0;
const COORDINATE = 1;
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

/** A canvas whose WebGL context computes on the processor. */
export class ProcessorCanvas {
  width = 1;
  height = 1;
  // Emscripten then leaves out a repair of Safari's contexts.
  getContextSafariWebGL2Fixed = true;

  getContext(kind) {
    if (kind !== "webgl2") return null;
    this.context ??= new ProcessorContext(this);
    return this.context;
  }

  /** MediaPipe's copy for display. Nobody needs it. */
  transferToImageBitmap() {
    return null;
  }
}

class ProcessorContext {
  TEXTURE0 = 33984;

  constructor(canvas) {
    this.canvas = canvas;
    this.units = new Map();
    this.unit = this.TEXTURE0;
    this.attributes = [];
  }

  getExtension(name) {
    return this.getSupportedExtensions().includes(name) ? {} : null;
  }

  getSupportedExtensions() {
    return ["EXT_color_buffer_float"];
  }

  getParameter(name) {
    return PARAMETERS[name];
  }

  getContextAttributes() {
    return {};
  }

  getError() {
    return 0;
  }

  // Programs

  createShader() {
    return {};
  }

  shaderSource(shader, source) {
    shader.source = source;
  }

  getShaderParameter() {
    return true;
  }

  createProgram() {
    return { names: [], values: {} };
  }

  attachShader(program, { source }) {
    for (const names of [COPY, CUT]) if (source.includes(`sampler2D ${names[0]};`)) program.names = names;
  }

  getProgramParameter(program, parameter) {
    return parameter === ACTIVE_UNIFORMS ? program.names.length : true;
  }

  getActiveUniform(program, index) {
    return { name: program.names[index], size: 1 };
  }

  getUniformLocation(program, name) {
    return { program, name };
  }

  getAttribLocation() {
    return POSITION;
  }

  useProgram(program) {
    this.program = program;
  }

  uniform1i({ program, name }, value) {
    program.values[name] = value;
  }

  uniform1f({ program, name }, value) {
    program.values[name] = value;
  }

  uniform4fv({ program, name }, values, offset) {
    program.values[name] = values.slice(offset, offset + 4);
  }

  /** MediaPipe's matrices are row by row. */
  uniformMatrix4fv({ program, name }, transpose, values, offset) {
    program.values[name] = values.slice(offset, offset + 16);
  }

  // Corners of what is drawn

  createBuffer() {
    return {};
  }

  bindBuffer(target, buffer) {
    this.buffer = buffer;
  }

  bufferData(target, bytes, usage, offset, length) {
    if (length) this.buffer.values = new Float32Array(bytes.slice(offset, offset + length).buffer);
  }

  vertexAttribPointer(attribute) {
    this.attributes[attribute] = this.buffer;
  }

  createVertexArray() {
    return {};
  }

  // Textures: {picture, map}, where `map` leads from the texture to the picture, both from 0 to 1.

  createTexture() {
    return {};
  }

  activeTexture(unit) {
    this.unit = unit;
  }

  bindTexture(target, texture) {
    this.units.set(this.unit, texture);
  }

  /** @param {ImageData | null} picture null where MediaPipe only sets a size. */
  texImage2D(target, level, format, width, height, picture) {
    if (picture) Object.assign(this.units.get(this.unit), { picture, map: [0, 1, 0, 0, 0, 1] });
  }

  createFramebuffer() {
    return {};
  }

  bindFramebuffer(target, framebuffer) {
    this.framebuffer = framebuffer;
  }

  framebufferTexture2D(target, attachment, kind, texture) {
    this.framebuffer.texture = texture;
  }

  fenceSync() {
    return {};
  }

  drawArrays() {
    if (!this.framebuffer) return; // for display
    const { names, values } = this.program;
    const { picture, map } = this.units.get(this.TEXTURE0 + values[names[0]]);
    const { scale = [1, 1], transform_matrix = IDENTITY, alpha = 1, beta = 0 } = values;
    const [x, y] = [0, 1].map((axis) => [0, 1, 2].map((corner) => this.#corner(POSITION, corner, axis) * scale[axis]));
    const [u, v] = [0, 1].map((axis) => [0, 1, 2].map((corner) => this.#corner(COORDINATE, corner, axis)));
    const m = transform_matrix;
    const s = u.map((_, i) => m[0] * u[i] + m[1] * v[i] + m[3]);
    const t = u.map((_, i) => m[4] * u[i] + m[5] * v[i] + m[7]);
    const at = (row) => s.map((_, i) => map[row] + map[row + 1] * s[i] + map[row + 2] * t[i]);
    Object.assign(this.framebuffer.texture, { picture, map: [...solve(x, y, at(0)), ...solve(x, y, at(3))], alpha, beta });
  }

  #corner(attribute, corner, axis) {
    return this.attributes[attribute].values[2 * corner + axis];
  }

  /** Writes red, green, blue and opacity of each pixel; outside of the picture the colour is black. */
  readPixels(left, bottom, width, height, format, type, values, offset) {
    const { picture, map, alpha, beta } = this.framebuffer.texture;
    const { data, width: columns, height: rows } = picture;
    const gain = alpha / 255;
    let out = offset;
    for (let j = 0; j < height; j++) {
      const t = (j + 0.5) / height;
      for (let i = 0; i < width; i++, out += FLOATS) {
        const s = (i + 0.5) / width;
        const u = map[0] + map[1] * s + map[2] * t;
        const v = map[3] + map[4] * s + map[5] * t;
        if (u < 0 || u > 1 || v < 0 || v > 1) {
          values.fill(beta, out, out + 4);
          continue;
        }
        const x = Math.min(Math.max(u * columns - 0.5, 0), columns - 1);
        const y = Math.min(Math.max(v * rows - 0.5, 0), rows - 1);
        const left = Math.floor(x);
        const top = Math.floor(y);
        const a = 4 * (top * columns + left);
        const right = left < columns - 1 ? 4 : 0;
        const below = top < rows - 1 ? 4 * columns : 0;
        const fx = x - left;
        const fy = y - top;
        for (let c = 0; c < 4; c++) {
          const above = data[a + c] + fx * (data[a + right + c] - data[a + c]);
          const under = data[a + below + c] + fx * (data[a + below + right + c] - data[a + below + c]);
          values[out + c] = gain * (above + fy * (under - above)) + beta;
        }
      }
    }
  }
}

/** Returns [a, b, c] of a + b s + c t, which is `values` at three corners; s and t go from 0 to 1 where x, y from -1. */
function solve(x, y, values) {
  const [x1, x2, y1, y2] = [x[1] - x[0], x[2] - x[0], y[1] - y[0], y[2] - y[0]];
  const [d1, d2] = [values[1] - values[0], values[2] - values[0]];
  const determinant = x1 * y2 - x2 * y1;
  const b = (d1 * y2 - d2 * y1) / determinant;
  const c = (x1 * d2 - x2 * d1) / determinant;
  return [values[0] - b * (x[0] + 1) - c * (y[0] + 1), 2 * b, 2 * c];
}

// What changes no pixel here.
for (const name of [
  "bindAttribLocation",
  "bindVertexArray",
  "clear",
  "clearColor",
  "colorMask",
  "compileShader",
  "deleteFramebuffer",
  "deleteShader",
  "deleteSync",
  "deleteTexture",
  "disable",
  "disableVertexAttribArray",
  "enableVertexAttribArray",
  "flush",
  "linkProgram",
  "pixelStorei",
  "texParameteri",
  "texStorage2D",
  "texSubImage2D",
  "viewport",
])
  ProcessorContext.prototype[name] = () => {};
