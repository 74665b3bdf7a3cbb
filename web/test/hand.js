// Renders the skinned right hand of @webxr-input-profiles, moving and pinching, as a camera would see it.

import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const HAND = "/node_modules/@webxr-input-profiles/assets/dist/profiles/generic-hand/right.glb";
const FINGERS = ["index-finger", "middle-finger", "ring-finger", "pinky-finger"];
const PHALANGES = ["phalanx-proximal", "phalanx-intermediate", "phalanx-distal"];
/** In the order of XRHand. */
const JOINTS = [
  "wrist",
  ...["metacarpal", "phalanx-proximal", "phalanx-distal", "tip"].map((part) => `thumb-${part}`),
  ...FINGERS.flatMap((finger) => ["metacarpal", ...PHALANGES, "tip"].map((part) => `${finger}-${part}`)),
];

const canvas = document.getElementById("canvas");
const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
const scene = new THREE.Scene();
scene.background = new THREE.Color("#9aa6a8");
const camera = new THREE.PerspectiveCamera(45, 640 / 480, 0.01, 5);
camera.position.z = 0.42;
const sun = new THREE.DirectionalLight("#fff", 2.2);
sun.position.set(0.4, 0.6, 0.8);
scene.add(new THREE.HemisphereLight("#fff", "#865", 1.6), sun);

const { scene: model } = await new GLTFLoader().loadAsync(HAND);
const hand = new THREE.Group().add(model);
scene.add(hand);
hand.updateMatrixWorld(true);
const bones = JOINTS.map((name) => model.getObjectByName(name));
const rest = new Map();
bones.forEach((bone, i) => {
  // The model's bones are siblings; fingers need chains.
  if (i > 0) bones[JOINTS[i].endsWith("metacarpal") ? 0 : i - 1].attach(bone);
});
bones.forEach((bone, i) => rest.set(JOINTS[i], bone.quaternion.clone()));
model.traverse((object) => {
  if (!object.isSkinnedMesh) return;
  object.frustumCulled = false;
  object.material = new THREE.MeshStandardMaterial({ color: "#d9a07c", roughness: 0.6 });
});

function turn(name, x, y = 0, z = 0) {
  const bone = bones[JOINTS.indexOf(name)];
  bone.quaternion.copy(rest.get(name)).multiply(new THREE.Quaternion().setFromEuler(new THREE.Euler(x, y, z)));
}

/**
 * Poses the hand.
 *
 * @param {{curl: number[], thumb: number[], turn: number[]}} posture flexion of the four fingers' joints, rad; x, y
 *   and z of the thumb's metacarpal, and flexion of its other joints, rad; orientation of the hand, rad.
 * @returns {number[][]} the joints, 25 × [x, y, z], m, in camera axes x right, y up, z back.
 */
window.pose = ({ curl, thumb, turn: [x, y, z] }) => {
  FINGERS.forEach((finger, i) => PHALANGES.forEach((part) => turn(`${finger}-${part}`, -curl[i])));
  turn("thumb-metacarpal", ...thumb.slice(0, 3));
  turn("thumb-phalanx-proximal", -thumb[3]);
  turn("thumb-phalanx-distal", -thumb[4]);
  hand.rotation.set(x, Math.PI / 2 + y, Math.PI + z, "ZYX");
  hand.position.set(0, 0, 0);
  hand.updateMatrixWorld(true);
  hand.position.sub(bones[JOINTS.indexOf("middle-finger-phalanx-proximal")].getWorldPosition(new THREE.Vector3()));
  hand.updateMatrixWorld(true);
  return bones.map((bone) => bone.getWorldPosition(new THREE.Vector3()).toArray());
};

/** Returns the picture as a JPEG's data URL; its top row of squares is `number` in binary. */
window.draw = (number) => {
  renderer.render(scene, camera);
  const copy = document.createElement("canvas");
  copy.width = 640;
  copy.height = 480;
  const context = copy.getContext("2d");
  context.drawImage(canvas, 0, 0);
  for (let bit = 0; bit < 8; bit++) {
    context.fillStyle = (number >> bit) & 1 ? "#fff" : "#000";
    context.fillRect(16 * bit, 0, 16, 16);
  }
  return copy.toDataURL("image/jpeg", 0.92);
};
window.ready = true;
