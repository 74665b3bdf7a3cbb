// Draws a scene of three.js on the processor.
//
// Without a GPU a browser computes WebGL on the processor, which takes many times as long as this. It draws what the
// view has: meshes with an index and normals, in one colour or with colours of vertices or instances, under
// directional and hemisphere lights. Light is computed at vertices, by Lambert's law; nothing casts a shadow.

import * as THREE from "three";

// Numbers of a vertex: x and y in pixels, depth from −1 to 1; red, green and blue from 0 to 255; and x, y, z and w
// before the division by w, which clipping needs.
const SIZE = 10;
const COLOUR = 3;
const CLIP = 6;
const EDGE = 3; // numbers of an edge
const FIXED = 65536;
const OPAQUE = 0xff << 24;
// sRGB of linear light in steps of 1/1024. Rounding never leaves 0 to 255 while it is interpolated.
const SRGB = Float32Array.from({ length: 1025 }, (_, i) => {
  const light = i / 1024;
  return 0.5 + 254 * (light < 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055);
});

/** Draws as THREE.WebGLRenderer does. A mesh with `userData.still` never moves. */
export class ProcessorRenderer {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { willReadFrequently: true });
    this.vertices = new Float32Array(0);
    this.edges = new Float64Array(3 * EDGE);
    // Changes of depth and colour from one pixel to the next.
    this.along = new Float64Array(CLIP);
    this.down = new Float64Array(CLIP);
  }

  /** @param {(time: number) => void} callback runs before each picture of the browser. */
  setAnimationLoop(callback) {
    const run = (time) => {
      requestAnimationFrame(run);
      callback(time);
    };
    requestAnimationFrame(run);
  }

  setSize(width, height) {
    Object.assign(this, { width, height });
    Object.assign(this.canvas, { width, height });
    this.image = this.context.createImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.depths = new Float32Array(width * height);
    this.still = undefined;
  }

  render(scene, camera) {
    if (!this.image) return;
    scene.updateMatrixWorld();
    camera.updateMatrixWorld();
    const toClip = new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    const frustum = new THREE.Frustum().setFromProjectionMatrix(toClip);
    const shown = [];
    scene.traverseVisible((object) => shown.push(object));
    const lights = shown.filter(({ isLight }) => isLight).map(readLight);
    const meshes = shown.filter((mesh) => mesh.isMesh && (!mesh.frustumCulled || frustum.intersectsObject(mesh)));
    const draw = (mesh) => {
      for (const { place, colour } of copies(mesh)) this.#draw(mesh, place, colour, toClip, lights);
    };
    const isStill = (mesh) => mesh.userData.still && !mesh.material.transparent;
    this.#restore([...toClip.elements, ...meshes.filter(isStill).map(({ id }) => id)], () =>
      meshes.filter(isStill).forEach(draw),
    );
    const others = meshes.filter((mesh) => !isStill(mesh));
    others.filter(({ material }) => !material.transparent).forEach(draw);
    others.filter(({ material }) => material.transparent).forEach(draw);
    this.context.putImageData(this.image, 0, 0);
  }

  /** Begins with the picture of what stands still, which is drawn again only for another key. */
  #restore(key, drawStill) {
    const { pixels, depths } = this;
    if (key.join() === this.still?.key) {
      pixels.set(this.still.pixels);
      depths.set(this.still.depths);
      return;
    }
    pixels.fill(0);
    depths.fill(1);
    drawStill();
    this.still = { key: key.join(), pixels: pixels.slice(), depths: depths.slice() };
  }

  #draw({ geometry, material }, place, colour, toClip, lights) {
    const { position, normal, color } = geometry.attributes;
    this.count = position.count;
    const size = SIZE * (this.count + 4); // clipping adds up to four
    if (this.vertices.length < size) this.vertices = new Float32Array(size);
    this.#project(position.array, new THREE.Matrix4().multiplyMatrices(toClip, place).elements);
    const turn = new THREE.Matrix3().getNormalMatrix(place).elements;
    this.#shade(normal.array, turn, material.vertexColors ? color.array : null, colour, lights);
    const index = geometry.index.array;
    const opacity = material.transparent ? material.opacity : 1;
    for (let i = 0; i < index.length; i += 3)
      this.#clip(SIZE * index[i], SIZE * index[i + 1], SIZE * index[i + 2], opacity);
  }

  #project(points, m) {
    const { vertices, count } = this;
    for (let i = 0, at = 0; i < 3 * count; i += 3, at += SIZE) {
      const x = points[i];
      const y = points[i + 1];
      const z = points[i + 2];
      vertices[at + CLIP] = m[0] * x + m[4] * y + m[8] * z + m[12];
      vertices[at + CLIP + 1] = m[1] * x + m[5] * y + m[9] * z + m[13];
      vertices[at + CLIP + 2] = m[2] * x + m[6] * y + m[10] * z + m[14];
      vertices[at + CLIP + 3] = m[3] * x + m[7] * y + m[11] * z + m[15];
      this.#divide(at);
    }
  }

  #divide(at) {
    const { vertices, width, height } = this;
    const w = vertices[at + CLIP + 3];
    vertices[at] = (0.5 + (0.5 * vertices[at + CLIP]) / w) * width;
    vertices[at + 1] = (0.5 - (0.5 * vertices[at + CLIP + 1]) / w) * height;
    vertices[at + 2] = vertices[at + CLIP + 2] / w;
  }

  #shade(normals, m, albedos, { r, g, b }, lights) {
    const { vertices, count } = this;
    for (let i = 0, at = COLOUR; i < 3 * count; i += 3, at += SIZE) {
      const x = m[0] * normals[i] + m[3] * normals[i + 1] + m[6] * normals[i + 2];
      const y = m[1] * normals[i] + m[4] * normals[i + 1] + m[7] * normals[i + 2];
      const z = m[2] * normals[i] + m[5] * normals[i + 1] + m[8] * normals[i + 2];
      const unit = 1 / Math.sqrt(x * x + y * y + z * z);
      let red = 0;
      let green = 0;
      let blue = 0;
      for (const { towards, above, below, half } of lights) {
        const cosine = unit * (towards[0] * x + towards[1] * y + towards[2] * z);
        const share = half ? 0.5 + 0.5 * cosine : Math.max(cosine, 0);
        red += below[0] + share * (above[0] - below[0]);
        green += below[1] + share * (above[1] - below[1]);
        blue += below[2] + share * (above[2] - below[2]);
      }
      vertices[at] = toSrgb(red * r * (albedos ? albedos[i] : 1));
      vertices[at + 1] = toSrgb(green * g * (albedos ? albedos[i + 1] : 1));
      vertices[at + 2] = toSrgb(blue * b * (albedos ? albedos[i + 2] : 1));
    }
  }

  /** Draws the part of a triangle that is behind the near plane. */
  #clip(a, b, c, opacity) {
    const seen = this.#isSeen(a) + this.#isSeen(b) + this.#isSeen(c);
    if (seen === 3) return this.#fill(a, b, c, opacity);
    if (seen === 0) return;
    const corners = [];
    let free = SIZE * this.count;
    for (const [from, to] of [[a, b], [b, c], [c, a]]) {
      if (this.#isSeen(from)) corners.push(from);
      if (this.#isSeen(from) === this.#isSeen(to)) continue;
      this.#cut(from, to, free);
      corners.push(free);
      free += SIZE;
    }
    for (let i = 2; i < corners.length; i++) this.#fill(corners[0], corners[i - 1], corners[i], opacity);
  }

  #isSeen(at) {
    return this.vertices[at + CLIP + 2] > -this.vertices[at + CLIP + 3];
  }

  /** Writes the vertex where an edge meets the near plane. */
  #cut(from, to, free) {
    const { vertices } = this;
    const depth = (at) => vertices[at + CLIP + 2] + vertices[at + CLIP + 3];
    const share = depth(from) / (depth(from) - depth(to));
    for (let i = COLOUR; i < SIZE; i++)
      vertices[free + i] = vertices[from + i] + share * (vertices[to + i] - vertices[from + i]);
    this.#divide(free);
  }

  /** Fills a triangle row by row, where its front is seen and nothing is before it. */
  #fill(a, b, c, opacity) {
    const { vertices: v, along, down, edges, width } = this;
    const ux = v[b] - v[a];
    const uy = v[b + 1] - v[a + 1];
    const wx = v[c] - v[a];
    const wy = v[c + 1] - v[a + 1];
    const area = ux * wy - wx * uy; // negative in front, as y points down
    if (!(area < 0)) return;
    const first = Math.max(Math.ceil(Math.min(v[a + 1], v[b + 1], v[c + 1]) - 0.5), 0);
    const end = Math.min(Math.ceil(Math.max(v[a + 1], v[b + 1], v[c + 1]) - 0.5), this.height);
    if (first >= end) return;
    this.#setEdge(0, a, b);
    this.#setEdge(1, b, c);
    this.#setEdge(2, c, a);
    for (let i = 2; i < CLIP; i++) {
      const u = v[b + i] - v[a + i];
      const w = v[c + i] - v[a + i];
      along[i] = (u * wy - w * uy) / area;
      down[i] = (w * ux - u * wx) / area;
    }
    for (let row = first; row < end; row++) {
      const y = row + 0.5;
      let left = 0;
      let right = width;
      for (let i = 0; i < 3 * EDGE; i += EDGE) {
        const x = Math.ceil(edges[i] + y * edges[i + 1] - 0.5);
        if (edges[i + 2] > 0) left = x > left ? x : left;
        else if (edges[i + 2] < 0) right = x < right ? x : right;
      }
      if (left >= right) continue;
      const dx = left + 0.5 - v[a];
      const dy = y - v[a + 1];
      const from = row * width + left;
      const to = row * width + right;
      const z = v[a + 2] + dx * along[2] + dy * down[2];
      const red = v[a + 3] + dx * along[3] + dy * down[3];
      const green = v[a + 4] + dx * along[4] + dy * down[4];
      const blue = v[a + 5] + dx * along[5] + dy * down[5];
      if (opacity < 1) this.#blend(from, to, z, red, green, blue, opacity);
      else this.#write(from, to, z, red, green, blue);
    }
  }

  /** Notes a line x = offset + slope × y, and whether the triangle is at its right (1) or left (−1). */
  #setEdge(number, from, to) {
    const { vertices: v, edges } = this;
    const height = v[to + 1] - v[from + 1];
    const slope = (v[to] - v[from]) / height;
    edges[EDGE * number] = v[from] - slope * v[from + 1];
    edges[EDGE * number + 1] = slope;
    edges[EDGE * number + 2] = Math.sign(height);
  }

  #write(from, end, z, red, green, blue) {
    const { pixels, depths, along } = this;
    const dz = along[2];
    // Colours are whole numbers of 1/65536, which processors add and shift fastest.
    let r = (FIXED * red) | 0;
    let g = (FIXED * green) | 0;
    let b = (FIXED * blue) | 0;
    const dr = (FIXED * along[3]) | 0;
    const dg = (FIXED * along[4]) | 0;
    const db = (FIXED * along[5]) | 0;
    for (let i = from; i < end; i++) {
      if (z < depths[i]) {
        depths[i] = z;
        pixels[i] = OPAQUE | (b & 0xff0000) | ((g >> 8) & 0xff00) | (r >> 16);
      }
      z += dz;
      r += dr;
      g += dg;
      b += db;
    }
  }

  #blend(from, end, z, red, green, blue, opacity) {
    const { depths, along } = this;
    const { data } = this.image;
    const mix = (i, colour, share) => (data[i] += share * (colour - data[i]));
    for (let i = from; i < end; i++) {
      if (z < depths[i]) {
        depths[i] = z;
        const alpha = opacity + (1 - opacity) * (data[4 * i + 3] / 255);
        mix(4 * i, red, opacity / alpha);
        mix(4 * i + 1, green, opacity / alpha);
        mix(4 * i + 2, blue, opacity / alpha);
        data[4 * i + 3] = 255 * alpha;
      }
      z += along[2];
      red += along[3];
      green += along[4];
      blue += along[5];
    }
  }
}

/** What a light adds for one direction: `towards` is a unit vector, `above` and `below` colours. */
function readLight(light) {
  const scale = light.intensity / Math.PI;
  const above = light.color.toArray().map((value) => scale * value);
  if (light.isHemisphereLight) {
    const below = light.groundColor.toArray().map((value) => scale * value);
    return { towards: light.up.toArray(), above, below, half: true };
  }
  const from = new THREE.Vector3().setFromMatrixPosition(light.target.matrixWorld);
  const towards = new THREE.Vector3().setFromMatrixPosition(light.matrixWorld).sub(from).normalize();
  return { towards: towards.toArray(), above, below: [0, 0, 0], half: false };
}

/** Places and colours in which a mesh is drawn. */
function* copies(mesh) {
  const { color } = mesh.material;
  if (!mesh.isInstancedMesh) return yield { place: mesh.matrixWorld, colour: color };
  const place = new THREE.Matrix4();
  const colour = color.clone();
  for (let i = 0; i < mesh.count; i++) {
    mesh.getMatrixAt(i, place);
    if (mesh.instanceColor) mesh.getColorAt(i, colour);
    yield { place: place.premultiply(mesh.matrixWorld), colour };
  }
}

const toSrgb = (light) => SRGB[Math.min(Math.max(light, 0), 1) * 1024 | 0];
