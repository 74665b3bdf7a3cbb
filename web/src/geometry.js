// Geometries of `/scene` as three.js meshes.

import * as THREE from "three";
import { mergeVertices, toCreasedNormals } from "three/addons/utils/BufferGeometryUtils.js";

const CREASE = Math.PI / 5;
const meshes = new Map();

const SHAPES = {
  box: ([x, y, z]) => new THREE.BoxGeometry(x, y, z),
  ellipsoid: ([a, b, c]) => new THREE.SphereGeometry(1, 48, 32).scale(a, b, c),
  // three.js has these along y.
  cylinder: ([radius, length]) => new THREE.CylinderGeometry(radius, radius, length, 64).rotateX(Math.PI / 2),
  capsule: ([radius, length]) => new THREE.CapsuleGeometry(radius, length, 16, 32).rotateX(Math.PI / 2),
};

async function fetchMesh(url) {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url}: ${response.status}`);
  const corners = new Float32Array(await response.arrayBuffer());
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
  return mergeVertices(toCreasedNormals(geometry, CREASE));
}

/** Makes the mesh of one entry of `geometries`. */
export async function makeMesh({ shape, size, url, color, pose }) {
  if (shape === "mesh" && !meshes.has(url)) meshes.set(url, fetchMesh(url));
  const geometry = shape === "mesh" ? await meshes.get(url) : SHAPES[shape](size);
  const [red, green, blue, alpha] = color;
  const material = new THREE.MeshStandardMaterial({
    color: new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace),
    roughness: 0.55,
    metalness: 0.05,
    transparent: alpha < 1,
    opacity: alpha,
  });
  const mesh = new THREE.Mesh(geometry, material);
  mesh.castShadow = alpha === 1;
  mesh.receiveShadow = true;
  setPose(mesh, pose);
  return mesh;
}

/** Places an object at a pose qw qx qy qz x y z, which starts at `offset` of `values`. */
export function setPose(object, values, offset = 0) {
  const [qw, qx, qy, qz, x, y, z] = values.slice(offset, offset + 7);
  object.quaternion.set(qx, qy, qz, qw);
  object.position.set(x, y, z);
}
