// The person's own hand in 3D: a rod for each bone and a ball for each keypoint.

import * as THREE from "three";
import { BONES } from "./skeleton.js";

const UP = new THREE.Vector3(0, 1, 0);
const ALL = new THREE.Vector3(1, 1, 1);
const KEYPOINTS = 21;

export class OwnHand extends THREE.Group {
  /** @param {number} edges per circle */
  constructor(edges) {
    super();
    const many = (geometry, color, count) =>
      new THREE.InstancedMesh(geometry, new THREE.MeshStandardMaterial({ color }), count);
    this.rods = many(new THREE.CylinderGeometry(0.0045, 0.0055, 1, edges / 2), "#fff", BONES.length);
    this.balls = many(new THREE.SphereGeometry(0.0065, edges, edges / 2), "#f4f4f2", KEYPOINTS);
    BONES.forEach(({ colour }, i) => this.rods.setColorAt(i, new THREE.Color(colour)));
    this.add(this.rods, this.balls);
    for (const mesh of this.children) Object.assign(mesh, { castShadow: true, frustumCulled: false });
    this.visible = false;
  }

  /** @param {number[][] | null} points 21 × [x, y, z], m, in the parent's frame; null hides the hand. */
  setPoints(points) {
    this.visible = points !== null;
    if (!points) return;
    const at = points.map((point) => new THREE.Vector3(...point));
    const matrix = new THREE.Matrix4();
    at.forEach((place, i) => this.balls.setMatrixAt(i, matrix.makeTranslation(place)));
    BONES.forEach(({ parent, child }, i) => {
      const along = at[child].clone().sub(at[parent]);
      const middle = at[parent].clone().addScaledVector(along, 0.5);
      const length = ALL.clone().setY(along.length());
      const turn = new THREE.Quaternion().setFromUnitVectors(UP, along.normalize());
      this.rods.setMatrixAt(i, matrix.compose(middle, turn, length));
    });
    for (const mesh of this.children) mesh.instanceMatrix.needsUpdate = true;
  }
}
