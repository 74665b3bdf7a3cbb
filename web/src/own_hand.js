// The person's own hand in 3D: a rod for each bone and a ball for each keypoint.

import * as THREE from "three";
import { BONES } from "./skeleton.js";

const UP = new THREE.Vector3(0, 1, 0);

export class OwnHand extends THREE.Group {
  constructor() {
    super();
    const material = (colour) => new THREE.MeshStandardMaterial({ color: colour, roughness: 0.4 });
    const rod = new THREE.CylinderGeometry(0.0045, 0.0055, 1, 16);
    const ball = new THREE.SphereGeometry(0.0065, 20, 14);
    this.bones = BONES.map((bone) => ({ ...bone, mesh: new THREE.Mesh(rod, material(bone.colour)) }));
    const white = material("#f4f4f2");
    this.balls = Array.from({ length: 21 }, () => new THREE.Mesh(ball, white));
    this.add(...this.bones.map(({ mesh }) => mesh), ...this.balls);
    this.traverse((object) => (object.castShadow = true));
    this.visible = false;
  }

  /** @param {number[][] | null} points 21 × [x, y, z], m, in the parent's frame; null hides the hand. */
  setPoints(points) {
    this.visible = points !== null;
    if (!points) return;
    this.balls.forEach((ball, i) => ball.position.set(...points[i]));
    for (const { parent, child, mesh } of this.bones) {
      const begin = this.balls[parent].position;
      const along = this.balls[child].position.clone().sub(begin);
      mesh.position.copy(begin).addScaledVector(along, 0.5);
      mesh.scale.y = along.length();
      mesh.quaternion.setFromUnitVectors(UP, along.normalize());
    }
  }
}
