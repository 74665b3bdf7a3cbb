// The 3D view of the robot, its object and the person's own hand.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";
import { makeMeshes, setPose } from "./geometry.js";
import { OwnHand } from "./own_hand.js";
import { Sign } from "./sign.js";
import { KEYPOINT_TO_XR } from "./skeleton.js";

// The world W has z up and x ahead of the person; three.js and WebXR have y up and −z ahead.
const WORLD = new THREE.Matrix4().makeBasis(
  new THREE.Vector3(0, 0, -1),
  new THREE.Vector3(-1, 0, 0),
  new THREE.Vector3(0, 1, 0),
);
// The person's hand is drawn to the right of the robot's. The distance is this many metres, but at most this share of
// the viewing distance, and at most this share of half of what a picture shows.
const HAND_DISTANCE = 0.24;
const HAND_DISTANCE_SHARE = 0.28;
const HAND_PICTURE_SHARE = 0.8;
const EDGES = 32; // per circle
const HIGHLIGHT = "#00a892";
// Position of the scene's centre in a headset, m: ahead of the person, who looks past the arm's right side.
const HEADSET_TARGET = new THREE.Vector3(-0.3, 0.95, -0.9);

export class View {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = makeRenderer(canvas);
    this.camera = new THREE.PerspectiveCamera(46, 1, 0.02, 20);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.listenToKeyEvents(canvas);

    this.scene = new THREE.Scene();
    const studio = new THREE.PMREMGenerator(this.renderer);
    this.scene.environment = studio.fromScene(new RoomEnvironment(), 0.04).texture;
    this.scene.environmentIntensity = 0.45;
    this.world = new THREE.Group();
    this.world.applyMatrix4(WORLD);
    this.scene.add(this.world, this.#makeSun());
    this.ownHand = new OwnHand(EDGES);
    this.headsetHand = new OwnHand(EDGES);
    this.sign = new Sign();
    this.sign.visible = false;
    this.scene.add(this.headsetHand, this.sign);
    this.bodies = [];
    this.target = new THREE.Vector3();
    this.view = "overview";

    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.controls.addEventListener("change", () => (this.stale = true));
    this.renderer.setAnimationLoop((time, frame) => this.#draw(time, frame));
  }

  /** Shows a scene, as `/scene` describes it. */
  async load(description) {
    this.description = description;
    this.world.clear();
    this.bodies = description.moving.map(() => new THREE.Group());
    this.world.add(...this.bodies, this.ownHand);
    const meshes = await makeMeshes(description.geometries, EDGES);
    if (this.description !== description) return;
    for (const { moving, mesh } of meshes) (this.bodies[moving] ?? this.world).add(mesh);
    this.highlighted = undefined;
    this.world.updateMatrixWorld();
    this.look();
    this.sun.position.copy(this.target).add(new THREE.Vector3(-0.7, 1.6, 0.9));
    this.sun.target.position.copy(this.target);
    this.stale = true;
  }

  /** Looks at the scene from one of its views, which stays chosen in later scenes. */
  look(name = this.view) {
    this.view = name;
    if (!this.description) return;
    const { eye, target } = this.description.views[name];
    this.target.set(...target).applyMatrix4(WORLD);
    this.controls.target.copy(this.target);
    const far = farther(this.camera.aspect);
    this.camera.position.set(...eye).applyMatrix4(WORLD).sub(this.target).multiplyScalar(far).add(this.target);
    this.controls.update();
    this.stale = true;
  }

  /** Moves everything to a binary message's poses in the next picture. */
  setPoses(values) {
    this.values = values;
    this.stale = true;
  }

  /** Tints the moving body of this name, and no other. */
  highlight(name) {
    if (name === this.highlighted) return;
    this.highlighted = name;
    this.bodies.forEach((body, i) => {
      const colour = this.description.moving[i] === name ? HIGHLIGHT : "#fff";
      body.traverse(({ material }) => material?.color.set(colour));
    });
    this.stale = true;
  }

  /** Shows the joints that a headset sees where they are; null hides them. */
  setOwnJoints(joints) {
    this.headsetHand.setPoints(joints && KEYPOINT_TO_XR.map((joint) => joints[joint]));
  }

  /** Shows the words that a headset needs. */
  setWords(headline, detail) {
    this.sign.write(headline, detail);
  }

  /** Draws in a headset; `onFrame(time, frame, space)` runs before each picture. */
  async enterHeadset(session, onFrame) {
    this.inHeadset = true;
    const { xr } = this.renderer;
    xr.enabled = true;
    xr.setReferenceSpaceType("local-floor");
    await xr.setSession(session);
    this.onFrame = onFrame;
    this.world.position.copy(HEADSET_TARGET).sub(this.target);
    this.sign.position.copy(HEADSET_TARGET).add(new THREE.Vector3(0, 0.55, -0.35));
    this.sign.visible = true;
  }

  leaveHeadset() {
    this.renderer.xr.enabled = false;
    this.inHeadset = this.onFrame = undefined;
    this.world.position.set(0, 0, 0);
    this.sign.visible = false;
    this.setOwnJoints(null);
    this.stale = true;
  }

  #move() {
    const { values } = this;
    const n = this.bodies.length;
    if (values?.length !== 1 + 7 * n + 63) return;
    this.bodies.forEach((body, i) => setPose(body, values, 1 + 7 * i));
    this.#setOwnHand(values.subarray(1 + 7 * n));
  }

  #setOwnHand(p_BK) {
    const { moving, pose } = this.description.hand_base;
    const points = Array.from({ length: 21 }, (_, i) => Array.from(p_BK.subarray(3 * i, 3 * i + 3)));
    this.ownHand.setPoints(points.flat().some(Number.isNaN) ? null : points);
    const base = new THREE.Object3D();
    setPose(base, pose);
    const body = this.bodies[moving];
    this.ownHand.quaternion.copy(body.quaternion).multiply(base.quaternion);
    this.ownHand.position.copy(base.position).applyQuaternion(body.quaternion).add(body.position);
    this.ownHand.position.add(this.#toHand());
  }

  /** Returns the vector from the robot's hand to the person's, in W: to the right in the first picture. */
  #toHand() {
    const [ahead, present] = ["overview", this.view].map((name) => {
      const { eye, target } = this.description.views[name];
      return new THREE.Vector3(...target).sub(new THREE.Vector3(...eye));
    });
    const { aspect, fov } = this.camera;
    const across = present.length() * farther(aspect) * aspect * Math.tan(THREE.MathUtils.degToRad(fov / 2));
    const distance = Math.min(HAND_DISTANCE, HAND_DISTANCE_SHARE * ahead.length(), HAND_PICTURE_SHARE * across);
    return ahead.cross(new THREE.Vector3(0, 0, 1)).setLength(distance);
  }

  #makeSun() {
    this.sun = new THREE.DirectionalLight("#fff6ea", 1.9);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 2048);
    this.sun.shadow.radius = 5;
    this.sun.shadow.normalBias = 0.004;
    Object.assign(this.sun.shadow.camera, { left: -1, right: 1, top: 1, bottom: -1, near: 0.3, far: 4 });
    const lights = new THREE.Group();
    lights.add(this.sun, this.sun.target);
    return lights;
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (this.inHeadset || !width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.stale = true;
  }

  #draw(time, frame) {
    if (frame) this.onFrame?.(time, frame, this.renderer.xr.getReferenceSpace());
    else if (this.inHeadset) return;
    else this.controls.update();
    // Drawing only after a change leaves time for the hand tracker.
    if (!frame && !this.stale) return;
    this.stale = false;
    this.#move();
    this.renderer.render(this.scene, this.camera);
    this.onDraw?.();
  }
}

/** How much farther away a picture that is higher than wide shows as much. */
const farther = (aspect) => Math.max(1, 1 / aspect);

function makeRenderer(canvas) {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.shadowMap.enabled = true;
  renderer.toneMapping = THREE.ACESFilmicToneMapping;
  return renderer;
}
