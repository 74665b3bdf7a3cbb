// Geometries of `/scene` as three.js meshes, one for each body.

import * as THREE from "three";
import { mergeGeometries, mergeVertices, toCreasedNormals } from "three/addons/utils/BufferGeometryUtils.js";

const CREASE = Math.PI / 5;

/** Shapes by name, from sizes and the number `n` of edges per circle. */
const SHAPES = {
  box: ([x, y, z]) => new THREE.BoxGeometry(x, y, z),
  ellipsoid: ([a, b, c], n) => new THREE.SphereGeometry(1, n, n / 2).scale(a, b, c),
  // three.js has these along y.
  cylinder: ([radius, length], n) => new THREE.CylinderGeometry(radius, radius, length, n).rotateX(Math.PI / 2),
  capsule: ([radius, length], n) => new THREE.CapsuleGeometry(radius, length, n / 4, n).rotateX(Math.PI / 2),
};

async function fetchMesh(url) {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url}: ${response.status}`);
  const corners = new Float32Array(await response.arrayBuffer());
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
  return mergeVertices(toCreasedNormals(geometry, CREASE));
}

/** Makes one entry of `geometries` in its body's frame, with its colour at every vertex. */
async function makeGeometry({ shape, size, url, color: [red, green, blue], pose }, edges) {
  const geometry = shape === "mesh" ? await fetchMesh(url) : SHAPES[shape](size, edges);
  geometry.deleteAttribute("uv");
  const place = new THREE.Object3D();
  setPose(place, pose);
  place.updateMatrix();
  const { r, g, b } = new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace);
  const colours = new Float32Array(3 * geometry.attributes.position.count);
  for (let i = 0; i < colours.length; i += 3) colours.set([r, g, b], i);
  geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  return geometry.applyMatrix4(place.matrix);
}

/**
 * Makes the meshes of a scene. Geometries of one body with the same opacity share a mesh, because each mesh costs time.
 *
 * @param {object[]} geometries of `/scene`
 * @param {number} edges per circle
 * @returns {Promise<{moving: number | null, mesh: THREE.Mesh}[]>}
 */
export async function makeMeshes(geometries, edges) {
  const groups = new Map();
  for (const entry of geometries) {
    const key = `${entry.moving} ${entry.color[3]}`;
    groups.set(key, [...(groups.get(key) ?? []), entry]);
  }
  return Promise.all(
    Array.from(groups.values(), async (entries) => {
      const { moving, color } = entries[0];
      const opacity = color[3];
      const geometry = mergeGeometries(await Promise.all(entries.map((entry) => makeGeometry(entry, edges))));
      const material = new THREE.MeshStandardMaterial({ vertexColors: true, transparent: opacity < 1, opacity });
      const mesh = new THREE.Mesh(geometry, material);
      mesh.castShadow = opacity === 1;
      mesh.receiveShadow = true;
      mesh.userData.still = moving === null;
      return { moving, mesh };
    }),
  );
}

/** Places an object at a pose qw qx qy qz x y z, which starts at `offset` of `values`. */
export function setPose(object, values, offset = 0) {
  const [qw, qx, qy, qz, x, y, z] = values.slice(offset, offset + 7);
  object.quaternion.set(qx, qy, qz, qw);
  object.position.set(x, y, z);
}
